"""Captures: cameras are placed according to the style, and scenes have traces of training."""

import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import find_image, read_image
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.scene import GROUPS
from samples import generate
from samples.captures.capture import Capture, capture
from samples.captures.photograph import Photographer
from samples.captures.rigs import RIGS, cameras_of, frame_of


@cache
def _small(style: str, iterations: int = 40) -> Capture:
    return capture(style, 800, 3, iterations, width=40)


@cache
def _cameras(style: str) -> list[Camera]:
    """Cameras in metres, z up."""
    return cameras_of(RIGS[style], np.random.default_rng(7), width=40)


def _axes(cameras: list[Camera]) -> np.ndarray:
    return np.array([camera.rotation[2] for camera in cameras])


def _centres(cameras: list[Camera]) -> np.ndarray:
    return np.array([camera.position for camera in cameras])


def _azimuths(cameras: list[Camera]) -> np.ndarray:
    x, y, _ = _centres(cameras).T
    return np.sort(np.degrees(np.arctan2(y, x)))


def _psnr(made: Capture) -> float:
    held_out = [i for i, camera in enumerate(made.cameras) if camera.split == "test"]
    cameras, images = (tuple(part[i] for i in held_out) for part in (made.cameras, made.images))
    return ReferenceViews(cameras, images, True, (0.0, 0.0, 0.0)).quality(made.scene).psnr


def _in_view(points: np.ndarray, camera: Camera) -> np.ndarray:
    x, y, z = camera.rotation @ (points - camera.position[:, None])
    u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
    return (z > 0) & (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)


@pytest.mark.parametrize("style", RIGS)
def test_every_eighth_camera_is_for_tests(style: str) -> None:
    cameras = _cameras(style)
    assert [c.split == "test" for c in cameras] == [i % 8 == 4 for i in range(len(cameras))]
    assert {c.split for c in cameras} == {"train", "test"}
    assert len({c.name for c in cameras}) == len(cameras)


def test_orbit_surrounds_what_it_looks_at() -> None:
    cameras = _cameras("orbit")
    azimuths = _azimuths(cameras)
    assert np.diff(azimuths, append=azimuths[0] + 360).max() < 20
    towards = -_centres(cameras) / np.linalg.norm(_centres(cameras), axis=1)[:, None]
    assert np.einsum("vi,vi->v", towards, _axes(cameras)).min() > np.cos(np.radians(15))


def test_arc_keeps_to_one_side() -> None:
    cameras = _cameras("arc")
    assert 90 < np.ptp(_azimuths(cameras)) < 150
    distance = np.linalg.norm(_centres(cameras)[:, :2], axis=1)
    assert 1.5 < distance.min() < distance.max() < 3.5
    assert _axes(cameras).mean(axis=0)[1] > 0.7


def test_room_is_seen_all_around_from_both_rooms() -> None:
    cameras = _cameras("room")
    x, y, _ = _centres(cameras).T
    assert np.linalg.norm(_axes(cameras).mean(axis=0)) < 0.3
    for room in (x < 4.9, x > 5.1):
        assert np.hypot(*_axes(cameras)[room, :2].mean(axis=0)) < 0.4
    assert ((x > 0) & (x < 10) & (y > 0) & (y < 4)).all()


def test_forward_looks_one_way_from_a_small_plane() -> None:
    cameras = _cameras("forward")
    assert (_axes(cameras) @ [0, 1, 0]).min() > np.cos(np.radians(20))
    assert np.ptp(_centres(cameras), axis=0).max() < 1.5
    assert np.ptp(_centres(cameras)[:, 1]) < 0.3


def test_aerial_looks_down_and_aslant() -> None:
    down = -_axes(_cameras("aerial"))[:, 2]
    assert down.min() > 0.5
    assert (down > 0.98).sum() > 40
    assert (down < 0.9).sum() > 20
    assert _centres(_cameras("aerial"))[:, 2].min() > 50


def test_wall_is_seen_from_three_heights_and_looked_at_from_one_side() -> None:
    cameras = _cameras("wall")
    x, y, z = _centres(cameras).T
    assert y.max() < -0.2
    assert np.ptp(np.degrees(np.arctan2(x, -y))) > 110
    assert [np.sum(np.abs(z - height) < 0.3) for height in (0.1, -0.6, 1.05)] == [28, 16, 6]
    towards = _axes(cameras)
    assert towards[:, 1].min() > 0.1
    assert towards[:, 2].min() < -0.6 < 0.3 < towards[:, 2].max()


def test_corridor_is_walked_looking_ahead_and_at_its_end_back() -> None:
    cameras = _cameras("corridor")
    ahead = _axes(cameras)[:, 0]
    assert ahead[:58].min() > 0.7
    assert ahead[58:].max() < -0.7
    assert np.ptp(_centres(cameras), axis=0)[0] > 10 * np.ptp(_centres(cameras), axis=0)[1:].max()


def test_strip_has_few_photographs_of_any_heading_that_look_down() -> None:
    cameras = _cameras("strip")
    assert len(cameras) == 18
    assert -_axes(cameras)[:6, 2].max() > 0.35
    assert -_axes(cameras)[6:, 2].max() > 0.9
    rights = np.array([camera.rotation[0] for camera in cameras])
    assert np.linalg.norm(rights.mean(axis=0)) < 0.7
    up = frame_of(RIGS["strip"], np.random.default_rng(4)).turn[:, 2]
    assert 0.7 < -up[2] < 0.999


def test_turntable_has_two_rings_of_even_angles() -> None:
    cameras = _cameras("turntable")
    heights = np.round(_centres(cameras)[:, 2], 6)
    assert len(set(heights)) == 2
    for height in set(heights):
        ring = _azimuths([c for c, z in zip(cameras, heights, strict=True) if z == height])
        np.testing.assert_allclose(np.diff(ring), 15)


def test_sky_is_hundreds_of_times_as_far_as_the_sculpture() -> None:
    cameras = _cameras("sky")
    photographer = Photographer(RIGS["sky"].place())
    _, hits = photographer.photograph(cameras[20], np.random.default_rng(0))
    assert np.quantile(hits.distances, 0.2) < 8
    far = hits.distances.max()
    assert 300 < far / np.linalg.norm(cameras[20].position) < 500


def test_floaters_are_of_the_share_that_the_style_says() -> None:
    few, many = (capture(style, 400, 1, 0, width=30) for style in ("orbit", "floaters"))
    shares = []
    for made in (few, many):
        centres = np.array([camera.position for camera in made.cameras])
        apart = np.linalg.norm(made.scene.positions.T[:, None] - centres, axis=2).min(axis=1)
        shares.append((apart < 0.5 * np.median(apart)).mean())
    assert shares[1] > shares[0] + 0.04


def test_exposure_changes_from_the_first_photograph_to_the_last() -> None:
    rig, rng = RIGS["wall"], np.random.default_rng([1, list(RIGS).index("wall")])
    cameras = cameras_of(rig, rng, width=24)
    photographer = Photographer(rig.place())
    plain = [photographer.photograph(camera, rng)[0] for camera in cameras]
    made = capture("wall", 150, 1, 0, width=24)
    np.testing.assert_array_equal(made.images[0], plain[0])
    np.testing.assert_allclose(made.images[-1], np.exp(-0.5) * plain[-1], rtol=1e-5)


def test_far_has_one_gaussian_at_a_million() -> None:
    made = capture("far", 150, 1, 0, width=24)
    distance = np.linalg.norm(made.scene.positions, axis=0)
    assert (distance > 1e5).sum() == 1
    assert distance.max() == 1e6


def test_scenes_differ_in_their_unit_and_in_where_up_points() -> None:
    rng = np.random.default_rng(5)
    frames = {style: frame_of(rig, rng) for style, rig in RIGS.items()}
    units = [frame.unit for frame in frames.values()]
    assert max(units) / min(units) > 100
    for style, frame in frames.items():
        np.testing.assert_allclose(frame.turn @ frame.turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame.turn) == pytest.approx(1)
        expected = RIGS[style].up
        if expected is not None:
            assert frame.turn[:, 2] @ expected > 0.9
    assert frames["orbit"].turn[:, 2] @ frames["aerial"].turn[:, 2] < 0.5


def test_camera_in_the_scene_sees_what_it_saw_in_the_place() -> None:
    rng = np.random.default_rng(2)
    camera, frame = _cameras("arc")[3], frame_of(RIGS["arc"], rng)
    points = rng.uniform((-1, -1, 0), (1, 1, 2), (20, 3))
    before = camera.rotation @ (points - camera.position).T
    moved = frame.camera(camera)
    after = moved.rotation @ (frame.points(points) - moved.position).T
    np.testing.assert_allclose(after, RIGS["arc"].unit * before, atol=1e-9)


def test_photographs_show_points_where_they_are() -> None:
    camera = replace(_cameras("orbit")[0], split=None)
    image, hits = Photographer(RIGS["orbit"].place()).photograph(camera, np.random.default_rng(0))
    assert image.shape == (camera.height, camera.width, 3)
    assert 0 <= image.min() < 0.3
    assert 0.7 < image.max() <= 1
    x, y, z = camera.rotation @ (hits.points - camera.position[:, None])
    down, across = np.indices(image.shape[:2]).reshape(2, -1)
    assert np.abs(camera.fx * x / z + camera.cx - across - 0.5).max() < 0.51
    assert np.abs(camera.fy * y / z + camera.cy - down - 0.5).max() < 0.51
    assert (np.einsum("in,in->n", hits.normals, hits.points - camera.position[:, None]) <= 0).all()


@pytest.mark.thorough
def test_seed_decides_everything() -> None:
    first, again = (capture("arc", 200, 3, 10, width=30) for _ in range(2))
    other = capture("arc", 200, 4, 0, width=30)
    for group in GROUPS:
        a, b = getattr(first.scene, group), getattr(again.scene, group)
        np.testing.assert_array_equal(a, b, group)
    assert all(np.array_equal(a, b) for a, b in zip(first.images, again.images, strict=True))
    assert np.abs(first.cameras[0].position - other.cameras[0].position).max() > 0.1


@pytest.mark.thorough
@pytest.mark.parametrize("style", RIGS)
def test_gaussians_grow_with_the_distance_of_the_nearest_camera(style: str) -> None:
    made = _small(style)
    points = made.scene.positions.astype(float)
    nearest = np.full(made.scene.count, np.inf)
    for camera in made.cameras:
        if camera.split == "train":
            distance = np.linalg.norm(points - camera.position[:, None], axis=0)
            nearest = np.where(_in_view(points, camera), np.fmin(nearest, distance), nearest)
    seen = np.isfinite(nearest)
    assert seen.mean() > 0.97, "Gaussians lie where no camera looks"
    size = np.sort(made.scene.log_scale[:, seen], axis=0)[1:].mean(axis=0)
    slope, _ = np.polyfit(np.log(nearest[seen]), size, 1)
    assert 0.5 < slope < 2


@pytest.mark.thorough
def test_training_fits_held_out_views_and_every_attribute() -> None:
    before, after = _small("arc", iterations=0), _small("arc")
    assert _psnr(after) > _psnr(before) + 3
    assert np.all(before.scene.f_rest == 0)
    assert np.abs(after.scene.f_rest).mean() > 1e-3
    flat = [np.ptp(made.scene.log_scale, axis=0).mean() for made in (before, after)]
    assert flat[1] > flat[0]
    assert after.scene.opacity.min() > -5.3


def test_cli_writes_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = partial(capture, width=24)
    monkeypatch.setattr(generate, "capture", small)
    out = tmp_path / "scene"
    options = ["--gaussians", "150", "--seed", "2", "--iterations", "2"]
    generate.main(["--capture", "forward", *options, str(out)])
    made = small("forward", 150, 2, iterations=2)
    back, cameras = read_ply(out / "point_cloud.ply"), read_cameras(out)
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(back, group), getattr(made.scene, group), group)
    assert {path.name for path in out.iterdir()} == {"point_cloud.ply", "cameras.json", "images"}
    for read, camera, image in zip(cameras, made.cameras, made.images, strict=True):
        stored = read_image(find_image(out / "images", read.name))
        np.testing.assert_allclose(stored, image, atol=0.5 / 255 + 1e-6)
        assert (read.name, read.split, read.fx) == (camera.name, camera.split, camera.fx)
        np.testing.assert_allclose(read.rotation, camera.rotation, atol=1e-12)
        np.testing.assert_array_equal(read.position, camera.position)
    assert json.loads((out / "cameras.json").read_text())[4]["split"] == "test"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--capture", "tripod"], "invalid choice: 'tripod'"),
        (["--capture", "arc", "--sh-degree", "3"], "--sh-degree: not with --capture"),
        (["--capture", "arc", "--cameras", "c.json"], "--cameras: not with --capture"),
        (["--capture", "arc", "--gaussians", "99"], "count: 99, expected 100-100000"),
        (["--capture", "arc", "--seed", "-1"], "seed: -1, expected 0 or more"),
        (["--iterations", "5"], "--iterations: expected --capture too"),
    ],
)
def test_cli_refuses_bad_arguments(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        generate.main([*arguments, str(tmp_path / "scene")])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("out", ["no/such/scene", "file"])
def test_cli_refuses_outputs_that_cannot_be_folders(
    out: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit):
        generate.main(["--capture", "arc", str(tmp_path / out)])
    assert "expected a folder, or a new one" in capsys.readouterr().err


def test_unknown_style_is_refused() -> None:
    with pytest.raises(InvalidInput, match="style 'tripod': expected one of orbit, arc, room"):
        capture("tripod")
