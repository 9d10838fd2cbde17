"""Opacities of 0 and 1, flat Gaussians, and scenes that become empty."""

from __future__ import annotations

from dataclasses import replace

import foreign
import numpy as np
import open3d as o3d
import pytest
from scenes import assert_same_floats, random_scene, thorough

import gs_codec
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.distributed.encoding import encode_in_tasks
from gs_codec.distributed.sources import open_sources
from gs_codec.distributed.tasks import Crew
from gs_codec.edit.apply import Action
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.files.writing import write_scene
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.tensors import tensors_of
from gs_codec.scene import GROUPS, Scene
from gs_codec.workers.interface import Serial

COUNT = 40
SAID = (
    "opacity 0 or 1 in 12 Gaussians and a scale of 0 in 8 Gaussians, "
    "read as finite values that look the same"
)


def with_ends(seed: int = 5) -> Scene:
    """Ten Gaussians of opacity 1, two of 0; six are flat, and two have no extent at all."""
    scene = random_scene(COUNT, 1, seed)
    scene.opacity[0, :10], scene.opacity[0, 10:12] = np.inf, -np.inf
    scene.log_scale[2, 20:26] = -np.inf
    scene.log_scale[:, 26:28] = -np.inf
    return scene


def assert_finite_ends(scene: Scene, source: Scene) -> None:
    """All Gaussians of `with_ends`, in the same order, with almost the same other values."""
    assert scene.count == COUNT
    np.testing.assert_allclose(scene.opacity[0, :12], np.repeat([17.328679, -17.328679], [10, 2]))
    shorter = source.log_scale[:2, 20:26].min(axis=0)
    np.testing.assert_allclose(scene.log_scale[2, 20:26], shorter - 10, rtol=1e-5)
    np.testing.assert_allclose(scene.log_scale[:, 26:28], -30)
    np.testing.assert_allclose(scene.log_scale[:, :20], source.log_scale[:, :20], atol=1e-5)
    np.testing.assert_allclose(scene.opacity[0, 12:], source.opacity[0, 12:], atol=1e-5)


def as_ply(scene, path):
    write_ply(path, scene)


def as_lossless(scene, path):
    path.write_bytes(encode_scene(scene, Config("lossless", keep_order=True))[0])


def as_checkpoint(scene, path):
    write_scene(path, scene, Config())


@pytest.mark.parametrize(
    ("name", "write"),
    [("a.ply", as_ply), ("a.egs", as_lossless), ("a.pt", as_checkpoint), ("a.ckpt", as_checkpoint)],
)
def test_infinite_values_become_finite_in_all_readers(name, write, tmp_path, caplog):
    scene = with_ends()
    write(scene, tmp_path / name)
    assert_finite_ends(read_scene(tmp_path / name), scene)
    assert caplog.messages == [f"{tmp_path / name}: {SAID}"]
    cloud = gs_codec.read(tmp_path / name)
    np.testing.assert_allclose(cloud.point.opacity.numpy()[:10], 17.328679)


@pytest.mark.parametrize("suffix", ["glb", "usda"])
def test_opacities_and_scales_in_linear_form_are_read_by_the_same_rule(suffix, tmp_path, caplog):
    if suffix == "usda":
        pytest.importorskip("pxr")
    scene = with_ends()
    # Indistinguishable from 0 and 1 in float32.
    finite = {"opacity": np.clip(scene.opacity, -300, 300)}
    flat = np.where(np.isneginf(scene.log_scale), -200, scene.log_scale)
    path = tmp_path / f"a.{suffix}"
    write_scene(path, replace(scene, **finite, log_scale=flat.astype(np.float32)), Config())
    assert f"{path}: scales of 8 Gaussians clipped to the format's range" in caplog.messages
    caplog.clear()
    back = read_scene(path)
    assert back.count == COUNT
    np.testing.assert_allclose(back.opacity[0, :10], 17.328679)
    assert (back.opacity[0, 10:12] < -17).all()
    assert np.isfinite(back.log_scale).all()
    assert (back.log_scale[2, 20:28] <= -103).all()
    assert caplog.messages[0].endswith("Gaussians, read as finite values that look the same")


def test_splat_of_scale_0_is_encoded(tmp_path, caplog):
    rows = foreign.splat_rows(30, seed=6)
    rows["s"][:9, 1] = 0
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    report = encode_file(tmp_path / "a.splat", tmp_path / "a.egs", Config("m"))
    assert (report.count, report.dropped) == (30, 0)
    said = "a scale of 0 in 9 Gaussians, read as finite values that look the same"
    assert caplog.messages[0] == f"{tmp_path / 'a.splat'}: {said}"
    assert [line.split(":")[0] for line in caplog.messages[1:]] == [str(tmp_path / "a.egs")]


def test_clouds_and_tensors_are_read_by_the_same_rule(tmp_path, caplog):
    scene = with_ends()
    cloud = gs_codec.from_tensors(tensors_of(scene))
    assert caplog.messages == [SAID]
    raw = o3d.t.geometry.PointCloud()
    for name in cloud.point:
        raw.point[name] = cloud.point[name]
    raw.point["opacity"] = o3d.core.Tensor(scene.opacity.T.copy())
    raw.point["log_scale"] = o3d.core.Tensor(scene.log_scale.T.copy())
    del raw.point["scale"]
    caplog.clear()
    assert gs_codec.encode(raw, Config("m")) == gs_codec.encode(cloud, Config("m"))
    assert caplog.messages == [SAID]
    assert gs_codec.edit.remove_nonfinite(raw).point.positions.shape[0] == COUNT
    gs_codec.write(tmp_path / "a.ply", raw)
    assert_finite_ends(read_ply(tmp_path / "a.ply"), scene)
    exact = gs_codec.decode(gs_codec.encode(raw, Config("lossless", keep_order=True)))
    np.testing.assert_array_equal(exact.point.opacity.numpy(), scene.opacity.T)


@pytest.mark.parametrize("profile", ["m", "paper-m"])
def test_no_gaussian_with_infinite_values_is_dropped(profile, tmp_path):
    write_ply(tmp_path / "a.ply", with_ends())
    config = Config(profile, nonfinite="drop")
    report = encode_file(tmp_path / "a.ply", tmp_path / "a.egs", config)
    assert (report.count, report.dropped) == (COUNT, 0)
    actions = [Action("remove-nan")]
    done = convert_file(tmp_path / "a.ply", tmp_path / "b.ply", actions=actions)
    assert (done.count, done.dropped) == (COUNT, 0)


@pytest.mark.parametrize("nonfinite", ["error", "drop"])
def test_lossless_keeps_infinite_values(nonfinite, tmp_path):
    scene = with_ends()
    config = Config("lossless", keep_order=True, nonfinite=nonfinite)
    write_ply(tmp_path / "a.ply", scene)
    for code in (encode_file, convert_file):
        code(tmp_path / "a.ply", tmp_path / "a.egs", config, overwrite=True)
        decode_file(tmp_path / "a.egs", tmp_path / "b.ply", overwrite=True)
        assert_same_floats(scene, read_ply(tmp_path / "b.ply"))
    assert_same_floats(scene, decode_scene((tmp_path / "a.egs").read_bytes()))


def test_finite_values_render_the_same(tmp_path):
    scene = with_ends()
    near = replace(
        scene,
        opacity=np.clip(scene.opacity, -16, 16),
        log_scale=np.maximum(scene.log_scale, np.float32(-20)),
    )
    write_ply(tmp_path / "a.ply", scene)
    write_ply(tmp_path / "b.ply", near)
    camera = gs_codec.Camera("a", 64, 64, 40, 40, 32, 32, np.eye(3), np.array([0, 0, -4]))
    views = [list(gs_codec.render(tmp_path / f"{name}.ply", [camera])) for name in "ab"]
    images = [rendering.colour for [(_, rendering)] in views]
    assert images[0].max() > 0.3
    assert np.abs(images[0] - images[1]).max() < 1e-3


def all_damaged(path) -> None:
    scene = random_scene(30, 1)
    write_ply(path, replace(scene, f_dc=np.full_like(scene.f_dc, np.nan)))


def test_nothing_left_is_an_error(tmp_path):
    source = tmp_path / "a.ply"
    all_damaged(source)
    said = f"{source}: no Gaussian is left of 30: all contain NaN or infinity"
    for profile in ("m", "paper-m", "lossless"):
        with pytest.raises(InvalidInput, match=said):
            encode_file(source, tmp_path / "a.egs", Config(profile, nonfinite="drop"))
    for name in ("b.ply", "b.csv", "b.splat", "b.egs"):
        with pytest.raises(InvalidInput, match=said):
            convert_file(source, tmp_path / name, Config(nonfinite="drop"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ply"]


def test_a_part_may_be_dropped_as_a_whole(tmp_path, caplog):
    """A scene in spans, one of which is damaged, and all of which have infinite ends."""
    scene = random_scene(3000, 1, seed=3)
    scene.f_dc[:, :1100] = np.nan
    scene.opacity[:, ::100] = np.inf
    write_ply(tmp_path / "a.ply", scene)
    config = Config("m", block_size=1024, nonfinite="drop")
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs", config)
    caplog.clear()
    sources = open_sources([tmp_path / "a.ply"], "error")
    report = encode_in_tasks(Crew(Serial("")), sources, tmp_path / "b.egs", config, 1024)
    assert (report.count, report.dropped) == (1900, 1100)
    assert (tmp_path / "a.egs").read_bytes() == (tmp_path / "b.egs").read_bytes()
    assert caplog.messages == [
        "opacity 0 or 1 in 30 Gaussians, read as finite values that look the same"
    ]
    all_damaged(tmp_path / "c.ply")
    sources = open_sources([tmp_path / "c.ply"], "error")
    with pytest.raises(InvalidInput, match="no Gaussian is left of 30"):
        encode_in_tasks(Crew(Serial("")), sources, tmp_path / "c.egs", config, 1024)


def extreme_scenes() -> dict[str, Scene]:
    """Scenes that every writer accepts, or rejects in one line."""
    tiny, far, clear, one = (random_scene(12, 1, seed) for seed in range(4))
    tiny.log_scale[:, ::2] = -200
    far.positions[:] = 1e20
    clear.opacity[0, ::2], clear.opacity[0, 1::2] = 3e38, -3e38
    clear.rot[:, ::3] = 0
    one.positions[:] *= np.float32(1e37)
    huge = replace(tiny, log_scale=np.full_like(tiny.log_scale, 89))
    return {"tiny": tiny, "far": far, "clear": clear, "one": one.take(np.arange(1)), "huge": huge}


NAMES = (
    "a.ply", "a.compressed.ply", "a.splat", "a.glb", "a.gltf", thorough("a.usda"), "a.spz", "a.sog",
    thorough("meta.json"), "lod-meta.json", "a.pt", "a.ckpt", "a.egs",
)  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_every_written_scene_can_be_read(name, tmp_path):
    if name == "a.usda":
        pytest.importorskip("pxr")
    for case, scene in extreme_scenes().items():
        folder = tmp_path / case
        folder.mkdir()
        if case == "huge" and name in ("a.splat", "a.glb", "a.gltf", "a.usda"):
            with pytest.raises(InvalidInput, match=r"log-scale 89\.0, .* holds up to 88\.0"):
                write_scene(folder / name, scene, Config())
            continue
        write_scene(folder / name, scene, Config())
        back = read_scene(folder / name)
        assert back.count == scene.count
        assert all(np.isfinite(getattr(back, group)).all() for group in GROUPS), case
        if case == "tiny":
            assert (back.log_scale.min(axis=1) < -9).all()
            assert (np.sort(back.log_scale)[:, 6:] > -10).all()
