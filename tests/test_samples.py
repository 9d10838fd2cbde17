"""The generated scene: reproducible, of the requested size, with the documented distribution."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import ROOT, python

from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import read_scene
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene
from samples import generate as module
from samples.generate import TARGET, generate, main, orbit_cameras, sequence
from samples.motion import MOTIONS, SHARE
from samples.surfaces import ROOM_RADIUS, still_life


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate(20_000, 3, seed=5)


def _rotation_matrices(rot: np.ndarray) -> np.ndarray:
    """Matrices ``(3, 3, N)`` of quaternions wxyz ``(4, N)`` of any norm."""
    w, x, y, z = rot / np.linalg.norm(rot, axis=0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _same(a: Scene, b: Scene) -> bool:
    return all(np.array_equal(getattr(a, group), getattr(b, group)) for group in GROUPS)


def test_seed_determines_every_attribute(scene: Scene) -> None:
    assert _same(scene, generate(20_000, 3, seed=5))
    other = generate(20_000, 3, seed=6)
    assert not any(np.array_equal(getattr(scene, g), getattr(other, g)) for g in GROUPS)


def test_sh_degree_does_not_change_other_attributes(scene: Scene) -> None:
    plain = generate(20_000, 0, seed=5)
    for group in set(GROUPS) - {"f_rest"}:
        np.testing.assert_array_equal(getattr(plain, group), getattr(scene, group), group)


@pytest.mark.thorough
def test_another_process_writes_the_same_bytes(tmp_path: Path) -> None:
    here, there = tmp_path / "here.ply", tmp_path / "there.ply"
    write_ply(here, generate(300, 1, seed=9))
    command = [sys.executable, module.__file__, str(there)]
    options = ["--gaussians", "300", "--sh-degree", "1", "--seed", "9"]
    subprocess.run([*command, *options], check=True, cwd=tmp_path)
    digests = {hashlib.sha256(path.read_bytes()).hexdigest() for path in (here, there)}
    assert len(digests) == 1


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [0, 1, 2, 17, 5000])
def test_exact_size_and_sane_values(count: int, degree: int) -> None:
    scene = generate(count, degree, seed=2)
    assert (scene.count, scene.sh_degree, scene.has_normals) == (count, degree, True)
    assert len(scene.f_rest) == 3 * SH_COEFFICIENTS[degree]
    assert all(np.isfinite(getattr(scene, group)).all() for group in GROUPS)
    norms = np.linalg.norm(scene.rot, axis=0)
    assert np.all((norms > 0.699) & (norms < 1.301))


def test_chunks_fill_the_scene_without_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_CHUNK", 64)
    scene = generate(64 * 3 + 1, 3, seed=1)
    assert np.all(np.linalg.norm(scene.rot, axis=0) > 0.699)
    assert len(np.unique(scene.positions, axis=1).T) == scene.count


def test_sh_ac_is_heavy_tailed_and_common_to_the_colours(scene: Scene) -> None:
    ac = scene.f_rest.reshape(3, 15, -1)
    lit = np.any(ac != 0, axis=(0, 1))
    assert 0.1 < 1 - lit.mean() < 0.2
    for k in range(15):
        colours = ac[:, k, lit].astype(float)
        assert np.corrcoef(colours)[np.triu_indices(3, 1)].min() > 0.7
        centred = colours - colours.mean(axis=1, keepdims=True)
        kurtosis = (centred**4).mean(axis=1) / (centred**2).mean(axis=1) ** 2
        assert kurtosis.min() > 5
    band = [np.abs(ac[:, a:b]).mean() for a, b in ((0, 3), (3, 8), (8, 15))]
    assert band[0] > band[1] > band[2]


def test_splats_on_the_sphere_lie_flat(scene: Scene) -> None:
    centre, radius = np.array([[-0.85], [0.40], [0.28]]), 0.28
    outward = scene.positions - centre
    distance = np.linalg.norm(outward, axis=0)
    on = np.flatnonzero((np.abs(distance - radius) < 0.02) & (scene.positions[2] > 0.1))
    outward = outward[:, on] / distance[on]
    turn, scale = _rotation_matrices(scene.rot[:, on]), np.exp(scene.log_scale[:, on])
    covariance = np.einsum("ijn,jn,kjn->nik", turn, scale**2, turn)
    values, vectors = np.linalg.eigh(covariance)
    cosine = np.abs(np.einsum("ni,in->n", vectors[:, :, 0], outward))
    assert len(on) > 500
    assert np.quantile(cosine, 0.02) > 0.99
    assert np.mean(values[:, 0] < 0.25 * values[:, 1]) > 0.9
    # Each of the three axes is the thin one somewhere, so that all rotations are visible.
    assert set(scene.log_scale[:, on].argmin(axis=0)) == {0, 1, 2}


def test_splats_shrink_as_their_number_grows() -> None:
    few, many = (np.median(generate(n, 0).log_scale) for n in (2000, 32_000))
    assert few - many == pytest.approx(np.log(4), abs=0.1)


def test_floaters_are_few_far_large_and_faint(scene: Scene) -> None:
    distance = np.linalg.norm(scene.positions, axis=0)
    far = distance > ROOM_RADIUS
    assert 0.01 < far.mean() < 0.02
    assert np.median(scene.log_scale[:, far]) > np.median(scene.log_scale[:, ~far]) + 1
    assert scene.opacity[0, far].max() < 0


def test_opacity_has_an_opaque_majority_and_a_faint_tail(scene: Scene) -> None:
    opacity = 1 / (1 + np.exp(-scene.opacity[0]))
    assert np.mean(opacity > 0.9) > 0.45
    assert np.mean(opacity < 0.1) > 0.05
    assert opacity.min() > 0.0049


def test_every_surface_is_inside_the_room_and_sampled() -> None:
    life = still_life()
    points = life.sample(20_000, np.random.default_rng(0))
    assert np.linalg.norm(points.positions, axis=0).max() < ROOM_RADIUS
    assert np.allclose(np.linalg.norm(points.normals, axis=0), 1)
    assert np.bincount(points.part, minlength=len(life.surfaces)).min() > 20
    colours = life.colours(points)
    assert colours.min() >= 0
    assert colours.max() <= 1.2


def test_cameras_look_at_the_target() -> None:
    cameras = orbit_cameras(24)
    assert json.loads(json.dumps(cameras)) == cameras
    assert [camera["id"] for camera in cameras] == list(range(24))
    for camera in cameras:
        rotation, position = np.array(camera["rotation"]), np.array(camera["position"])
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        right, down, depth = rotation.T @ (np.array(TARGET) - position)
        assert (right, down) == pytest.approx((0, 0), abs=1e-12)
        assert depth > 1
        assert rotation[2, 1] < 0, "the down column must point down in a z-up world"
    assert len({camera["position"][2] for camera in cameras}) == 2


def test_cli_writes_what_generate_makes(tmp_path: Path) -> None:
    out, cameras = tmp_path / "scene.ply", tmp_path / "cameras.json"
    main([str(out), "--gaussians", "123", "--sh-degree", "2", "--cameras", str(cameras)])
    back = read_ply(out)
    assert _same(back, generate(123, 2))
    assert back.has_normals
    assert json.loads(cameras.read_text()) == orbit_cameras()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--gaussians", "-1"], "count: -1, expected 0-100000000"),
        (["--gaussians", "many"], "invalid int value: 'many'"),
        (["--sh-degree", "4"], "sh_degree: 4, expected 0-3"),
        (["--seed", "-1"], "seed: -1, expected 0 or more"),
        (["--cameras", "no/such/c.json"], "no/such/c.json: cannot be written"),
    ],
)
def test_cli_refuses_bad_arguments(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "scene.ply"
    with pytest.raises(SystemExit) as stop:
        main([str(out), *arguments])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_existing_output_is_kept_unless_overwritten(tmp_path: Path, capsys) -> None:
    out = tmp_path / "scene.ply"
    out.write_text("old")
    arguments = [str(out), "--gaussians", "5"]
    for refused in (arguments, [str(tmp_path), "--capture", "orbit"]):
        with pytest.raises(SystemExit):
            main(refused)
        assert " or pass --overwrite\n" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([str(tmp_path / "f"), "--sequence", "walker", "--overwrite"])
    assert "--overwrite: not with --sequence" in capsys.readouterr().err
    assert out.read_text() == "old"
    main([*arguments, "--overwrite"])
    assert read_ply(out).count == 5


@pytest.mark.parametrize("name", ["documentation", "levels_picture", "picture", "visualizer"])
def test_programs_state_their_arguments(name: str) -> None:
    status, out, err = python(str(ROOT / "samples" / f"{name}.py"))
    assert (status, out) == (2, "")
    assert f"{name}.py: error: the following arguments are required: " in err


def test_documentation_replaces_no_other_folder(tmp_path: Path) -> None:
    (tmp_path / "letter").touch()
    status, _, err = python(str(ROOT / "samples" / "documentation.py"), str(tmp_path))
    assert (status, (tmp_path / "letter").exists()) == (2, True)
    assert err.endswith("not empty, expected a site built before, or a new folder\n")


@pytest.mark.parametrize("bad", [{"count": 1.5}, {"count": "7"}, {"sh_degree": -1}, {"seed": None}])
def test_generate_refuses_bad_arguments(bad: dict) -> None:
    with pytest.raises(InvalidInput, match=next(iter(bad))):
        generate(**{"count": 3, **bad})


@pytest.mark.parametrize("bad", [{"count": 0}, {"width": 0}, {"height": 2.0}])
def test_orbit_cameras_refuses_bad_arguments(bad: dict) -> None:
    with pytest.raises(InvalidInput, match=next(iter(bad))):
        orbit_cameras(**bad)


#: What changes in a tracked sequence without noise.
CHANGES = {
    "object": {"positions", "rot"},
    "walker": {"positions", "rot"},
    "light": {"f_dc", "f_rest"},
    "appearing": {"opacity"},
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_only_what_moves_changes(motion: str) -> None:
    first, *_, last = frames = list(sequence(motion, 3, 2000, 1, seed=4, fps=1.2))
    assert all(
        _same(a, b) for a, b in zip(frames, sequence(motion, 3, 2000, 1, 4, fps=1.2), strict=True)
    )
    differ = {group: getattr(first, group) != getattr(last, group) for group in GROUPS}
    assert {group for group, where in differ.items() if where.any()} == CHANGES[motion]
    moving = np.any(differ[min(CHANGES[motion])], axis=0).mean()
    assert moving == pytest.approx(SHARE, abs=0.03) or (motion == "light" and 0.1 < moving < 0.6)


@pytest.mark.parametrize("motion", ["object", "walker"])
def test_gaussians_turn_with_what_they_are_on(motion: str) -> None:
    first, last = sequence(motion, 2, 4000, 0, seed=4, fps=2)
    moving = np.flatnonzero(np.any(first.rot != last.rot, axis=0))
    turns = np.einsum(
        "ijn,kjn->nik",
        _rotation_matrices(last.rot[:, moving]),
        _rotation_matrices(first.rot[:, moving]),
    )
    surfaces, rigid = np.unique(turns.round(3), axis=0, return_inverse=True)
    assert 0 < len(surfaces) < 60
    largest = np.flatnonzero(rigid == np.bincount(rigid.ravel()).argmax())
    turn, (a, b) = turns[largest[0]], (s.positions[:, moving[largest]] for s in (first, last))
    moved = turn @ (a - a[:, :1]) + b[:, :1]
    np.testing.assert_allclose(moved, b, atol=1e-3)


def test_what_appears_is_left_out_of_untracked_frames_until_then() -> None:
    tracked = [scene.count for scene in sequence("appearing", 4, 3000, 0, fps=2)]
    assert tracked == [3000] * 4
    frames = list(sequence("appearing", 4, 3000, 0, tracked=False, fps=2))
    counts = [scene.count for scene in frames]
    assert counts == sorted(counts)
    assert counts[0] / 3000 == pytest.approx(1 - SHARE, abs=0.03)
    assert counts[-1] == 3000
    assert np.isin(frames[1].f_dc, frames[2].f_dc).mean() < 0.01


def test_noise_differs_in_each_frame_and_has_the_requested_strength() -> None:
    still = list(sequence("object", 2, 2000, 1))
    noisy = list(sequence("object", 2, 2000, 1, noise=1))
    twice = next(sequence("object", 2, 2000, 1, noise=2))
    for group in GROUPS:
        apart = [getattr(a, group) - getattr(b, group) for a, b in zip(noisy, still, strict=True)]
        assert np.all((apart[0] != apart[1]).any(axis=0) | (group == "f_rest"))
        double = getattr(twice, group) - getattr(still[0], group)
        assert double.std() == pytest.approx(2 * apart[0].std(), rel=1e-3)
    assert np.all(noisy[0].f_rest[still[0].f_rest == 0] == 0)


def test_cli_writes_the_frames_of_a_sequence(tmp_path: Path) -> None:
    options = ["--sequence", "walker", "--frames", "2", "--gaussians", "50", "--sh-degree", "0"]
    main([str(tmp_path / "f"), *options, "--kind", "untracked", "--noise", "--fps", "5"])
    frames = sequence("walker", 2, 50, 0, tracked=False, noise=1, fps=5)
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == ["0000.ply", "0001.ply"]
    for number, frame in enumerate(frames):
        assert _same(read_ply(tmp_path / "f" / f"{number:04d}.ply"), frame)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sequence", "dance"], "invalid choice: 'dance'"),
        (["--sequence", "light", "--frames", "0"], "frames: 0, expected 1 or more"),
        (["--sequence", "light", "--fps", "nan"], "fps: nan, expected more than 0"),
        (["--sequence", "light", "--noise", "-1"], "noise: -1.0, expected 0 or more"),
        (["--sequence", "light", "--capture", "orbit"], "--sequence: not with --capture"),
        (["--frames", "3"], "--frames: expected --sequence too"),
    ],
)
def test_cli_refuses_bad_sequences(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([str(tmp_path / "frames"), *arguments])
    assert message in capsys.readouterr().err
    assert not (tmp_path / "frames").exists()
    (tmp_path / "0007.ply").touch()
    with pytest.raises(SystemExit):
        main([str(tmp_path), "--sequence", "light"])
    assert "expected an empty or new folder" in capsys.readouterr().err


@pytest.mark.thorough
def test_training_compensates_for_coding(tmp_path, capsys) -> None:
    pytest.importorskip("torch")
    from samples import trainer

    write_ply(tmp_path / "a.ply", generate(1500, 1, seed=2))
    (tmp_path / "c.json").write_text(json.dumps(orbit_cameras(6)))
    arguments = [str(tmp_path / name) for name in ("a.ply", "c.json", "b.pt")]
    options = ["--iterations", "40", "--every", "25", "--width", "60"]
    assert trainer.main([*arguments, *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [int(line.split()[0]) for line in lines] == [0, 25, 40]
    quality = [float(line.split()[2]) for line in lines]
    assert quality[2] > quality[1] > quality[0]
    assert read_scene(tmp_path / "b.pt").count == 1500
    assert trainer.main([str(tmp_path / "none.ply"), *arguments[1:]]) == 2
    assert capsys.readouterr().err == f"trainer: {tmp_path}/none.ply: No such file or directory\n"
