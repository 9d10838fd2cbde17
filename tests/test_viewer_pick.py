"""Picking a Gaussian: the one at a pixel, its properties, and its mark."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes import encode_by, made_up_guide, random_scene

import gs_codec
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.edit.project_file import Move
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.registry import open_scene as open_file
from gs_codec.scene import ANTIALIASED
from viewer.pictures.drawer import splats
from viewer.pictures.marker import draw_marker, marker, measure_lines
from viewer.pictures.picture import Shown, draw_scene
from viewer.scenes.appearance import Look
from viewer.scenes.matched import NEAREST, Match
from viewer.scenes.opened import Opened, Pruned, keep, open_scene, turned
from viewer.scenes.picked import Hit, Picker
from viewer.scenes.picked_text import picked_sections
from viewer.scenes.pose import Pose, look_at

POSE = Pose(np.eye(3), np.array([0.0, 0.0, -4.0]))
SIZE = (48, 32)
COUNT = 1200


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene of large visible Gaussians, and other versions of it."""
    folder = tmp_path_factory.mktemp("pick")
    scene = random_scene(COUNT, 2, seed=70)
    scene = replace(scene, log_scale=(scene.log_scale + 2).clip(max=-1).astype(np.float32))
    write_ply(folder / "a.ply", scene)
    write_ply(folder / "half.ply", scene.take(np.arange(0, COUNT, 2)))
    for profile in ("paper-m", "lossless"):
        data = encode_scene(scene, Config(profile, block_size=1024))[0]
        (folder / f"{profile}.egs").write_bytes(data)
    guided = encode_by(scene, Config("m", block_size=1024), made_up_guide())
    (folder / "m.egs").write_bytes(guided)
    gs_codec.decode_file(folder / "m.egs", folder / "decoded.ply")
    gs_codec.convert_file(folder / "a.ply", folder / "a.spz")
    return folder


@pytest.fixture(scope="module")
def a(files) -> Opened:
    return open_scene(files / "a.ply")


# Which


def test_the_pixel_follows_the_colour_of_its_gaussian_by_its_weight(a):
    """In the picture displayed by the window."""
    picker, camera = Picker([a]), POSE.camera(*SIZE)
    alpha = gs_codec.render(a.cloud, [camera]).draw(camera).alpha
    solid = np.argsort(-alpha, axis=None)[[0, 300, 600]]
    for row, column in np.stack(np.unravel_index(solid, alpha.shape), axis=1):
        hit = picker.pick(0, POSE, SIZE, (column + 0.9, row + 0.1))
        bright = []
        for colour in (20, 21):  # so that no channel is clipped at 0
            f_dc = a.cloud.point["f_dc"].numpy().copy()
            f_dc[hit.row] += colour / 0.28209479177387814
            cloud = a.cloud.clone()
            cloud.point["f_dc"] = type(cloud.point["f_dc"])(f_dc)
            bright.append(gs_codec.render(cloud, [camera]).draw(camera).colour[row, column])
        np.testing.assert_allclose(bright[1] - bright[0], hit.weight, atol=1e-5)


def test_no_other_gaussian_has_a_larger_weight(a):
    from gs_codec.cameras.inria import as_camera
    from gs_codec.rendering.pixel import pixel_weights

    rows, weights = pixel_weights(a.gaussians, as_camera(POSE.camera(*SIZE)), 24, 16)
    assert len(rows) > 5
    hit = Picker([a]).pick(0, POSE, SIZE, (24.5, 16.5))
    assert hit == Hit(0, int(rows[np.argmax(weights)]), float(weights.max()))


def test_empty_pixels_pick_nothing(a):
    away = replace(POSE, position=np.array([0.0, 0.0, 50.0]))
    assert Picker([a]).pick(0, away, SIZE, (24.5, 16.5)) is None
    assert Picker([a]).pick(0, away, SIZE, (24.5, 16.5), ("centres",)) is None


def test_points_on_top_are_picked_where_they_are_drawn(a):
    labels = (np.arange(COUNT) % 4 == 1).astype(np.uint8) * 2
    picker = Picker([a], Pruned(("geometry", "importance"), labels))
    places, depth = POSE.project(a.positions, *SIZE)
    inside = (places > 1).all(axis=1) & (places < np.array(SIZE) - 1).all(axis=1)
    gone = np.flatnonzero(inside & (depth > 0) & (labels > 0))
    frontmost = int(gone[np.argmin(depth[gone])])
    at = tuple(places[frontmost])
    hit = picker.pick(0, POSE, SIZE, at, ("splats", "pruned"))
    assert hit == Hit(0, frontmost)
    assert picker.describe(hit, POSE).pruned_by == "importance"
    splat = picker.pick(0, POSE, SIZE, at, ("splats",))
    assert splat.weight is not None
    every = np.flatnonzero(inside & (depth > 0))
    nearest = int(every[np.argmin(depth[every])])
    at = tuple(places[nearest])
    assert picker.pick(0, POSE, SIZE, at, ("centres",)) == Hit(0, nearest)
    for over in ("splats", "error"):
        assert picker.pick(0, POSE, SIZE, at, ("centres", over)).weight is not None
    kept = int(np.flatnonzero(labels == 0)[0])
    assert picker.describe(Hit(0, kept), POSE).pruned_by == ""


@pytest.mark.parametrize("layers", [("splats",), ("centres",)])
def test_hidden_gaussians_are_not_picked(a, layers):
    picker, at = Picker([a]), (24.5, 16.5)
    row = picker.pick(0, POSE, SIZE, at, layers).row
    others = picker.pick(0, POSE, SIZE, at, layers, Look(drawn=np.arange(COUNT) != row))
    assert others.row != row
    assert picker.pick(0, POSE, SIZE, at, layers, Look(drawn=np.zeros(COUNT, bool))) is None


# What is known


def test_a_pick_has_the_attributes_of_its_row(a, files):
    found = Picker([a]).describe(Hit(0, 77), POSE)
    with open_file(files / "a.ply") as file:
        scene = file.scene("drop", None).take(np.array([77]))
    np.testing.assert_array_equal(found.position, scene.positions[:, 0])
    np.testing.assert_allclose(found.scales, np.exp(scene.log_scale[:, 0]), rtol=1e-6)
    norm = np.linalg.norm(scene.rot)
    np.testing.assert_allclose(np.abs(found.rotation @ scene.rot[:, 0]), norm, rtol=1e-6)
    assert found.rotation[0] >= 0
    angle, axis = found.turn
    half = np.radians(angle) / 2
    np.testing.assert_allclose(found.rotation, [np.cos(half), *(np.sin(half) * axis)], atol=1e-9)
    assert found.opacity == pytest.approx(1 / (1 + np.exp(-scene.opacity[0, 0])), rel=1e-5)
    colour = 255 * np.clip(0.5 + 0.28209479177387814 * scene.f_dc[:, 0], 0, 1)
    np.testing.assert_allclose(found.colour, colour, rtol=1e-4)
    sh = scene.f_rest.reshape(3, 8)
    assert found.sh_energy == pytest.approx([np.sum(sh[:, :3] ** 2), np.sum(sh[:, 3:] ** 2)])
    assert found.coded is found.difference is None


def test_contributions_equal_the_renderers_sums(a):
    pose = replace(POSE, frame=(60, 40))
    camera = pose.camera(60, 40)
    sums = gs_codec.render(a.cloud, [camera], accumulate=True).draw(camera).accumulations
    picker = Picker([a])
    for row in (int(np.argmax(sums.weight)), 5, 6):
        found = picker.describe(Hit(0, row), pose).contribution
        assert found.weight == pytest.approx(sums.weight[row])
        assert found.pixels == sums.pixels[row]
        assert found.size == (60, 40)
        assert found.share == pytest.approx(sums.weight[row] / 2400)


@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_bits_are_those_of_the_file(files, profile):
    scene = open_scene(files / f"{profile}.egs")
    found = Picker([scene]).describe(Hit(0, 1100), POSE).coded
    assert found.block == 1100 // scene.info.block_size
    assert [each.name for each in found.streams] == [each.name for each in scene.info.streams]
    assert sum(each.bits for each in found.streams) == pytest.approx(scene.bits[1100])
    assert bool(found.steps) == (profile != "lossless")


def test_a_file_that_has_changed_is_refused(files, tmp_path):
    path = tmp_path / "scene.egs"
    path.write_bytes((files / "m.egs").read_bytes())
    picker = Picker([open_scene(path)])
    path.write_bytes(gs_codec.encode(to_cloud(random_scene(9))))
    with pytest.raises(gs_codec.GsCodecError, match="changed after it was opened"):
        picker.describe(Hit(0, 3), POSE)


# What belongs together

BY = {
    "m.egs": "stored order",
    "paper-m.egs": "stored order",
    "lossless.egs": "stored order",
    "decoded.ply": "stored order",
    "a.spz": "Morton order",
    "a.ply": "index",
    "half.ply": NEAREST,
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", BY)
def test_gaussians_are_matched_like_by_compare(a, files, name):
    other = open_scene(files / name)
    match = Match(a, other)
    assert match.matched_by == BY[name]
    found = [match.difference(1, row) for row in range(other.count)]
    # Every Gaussian of the other scene has a distinct partner.
    assert len({each.row for each in found}) == other.count
    if name == "half.ply":
        assert [each.row for each in found] == list(range(0, COUNT, 2))
    else:
        groups = gs_codec.compare(files / "a.ply", files / name).groups
        worst = {(group.name, group.unit): group.max for group in groups}
        assert max(abs(each.opacity) for each in found) == pytest.approx(
            worst["opacity", "0-1"], rel=1e-3, abs=1e-9
        )
        positions = max(each.position for each in found)
        assert worst["positions", "scene units"] <= positions * (1 + 1e-4) + 1e-12
        assert positions <= np.sqrt(3) * worst["positions", "scene units"] * (1 + 1e-4) + 1e-12
        scales = np.log1p(np.array([each.scales for each in found]))
        assert np.abs(scales).max() == pytest.approx(worst["scaling", "log"], rel=1e-3, abs=1e-6)
    for row in (0, 1, other.count // 2):
        back = match.difference(0, found[row].row)
        assert back.row == row
        assert back.position == pytest.approx(found[row].position)
        assert back.opacity == pytest.approx(-found[row].opacity)
        assert back.colour == pytest.approx(found[row].colour)


def test_differences_are_those_of_the_attributes(a):
    scene = a.gaussians
    other = replace(
        scene,
        positions=scene.positions + np.float32([[0.03], [0.0], [0.04]]),
        log_scale=scene.log_scale + np.float32(np.log(1.1)),
        f_dc=scene.f_dc + np.float32(10 / 255 / 0.28209479177387814),
    )
    found = Match(a, Opened("other", to_cloud(other))).difference(0, 9)
    assert (found.row, found.matched_by) == (9, "index")
    assert found.position == pytest.approx(0.05, rel=1e-3)
    assert found.scales == pytest.approx([1 / 1.1 - 1] * 3, rel=1e-4)
    assert found.rotation == pytest.approx(0, abs=1e-3)
    assert found.colour == pytest.approx(10, rel=1e-3)
    assert (found.opacity, found.sh) == (0, 0)


def test_unrelated_scenes_are_matched_by_their_centres(a):
    other = Opened("other", to_cloud(random_scene(COUNT, 0, seed=71)))
    match = Match(a, other)
    assert match.matched_by == NEAREST
    found = match.difference(0, 4)
    apart = np.linalg.norm(other.positions - a.positions[4], axis=1)
    assert found.row == np.argmin(apart)
    assert found.position == pytest.approx(apart.min(), rel=1e-5)
    empty = Opened("empty", to_cloud(random_scene(3, 0).take(np.arange(0))))
    assert Match(a, empty).difference(0, 4) is None


def test_a_manually_converted_scene_is_not_matched_by_its_order(a, files):
    """The order refers to stored positions."""
    by_hand = turned(open_scene(files / "m.egs"))
    assert Match(a, by_hand).matched_by == NEAREST
    assert Match(a, turned(by_hand)).difference(0, 4) is not None


def test_opacity_compensation_is_that_of_the_picture(files, tmp_path):
    with open_file(files / "a.ply") as file:
        scene = file.scene("drop", None)
    write_ply(tmp_path / "mip.ply", replace(scene, comments=(ANTIALIASED,)))
    mip = open_scene(tmp_path / "mip.ply")
    camera = POSE.camera(*SIZE)
    seen = splats({}, mip, POSE, *SIZE)
    expected = gs_codec.render(tmp_path / "mip.ply", [camera]).draw(camera).colour
    np.testing.assert_array_equal(seen, expected)
    assert np.abs(seen - splats({}, open_scene(files / "a.ply"), POSE, *SIZE)).max() > 1e-3


# Text and mark


def test_the_text_is_complete(a, files):
    b = open_scene(files / "m.egs")
    picker = Picker([a, b], Pruned(("geometry",), np.ones(COUNT, np.uint8)))
    hit = picker.pick(0, POSE, SIZE, (24.5, 16.5))
    first = dict(picked_sections(picker.describe(hit, POSE)))
    attributes = dict(first["Gaussian of A"])
    assert attributes["row, from 0"] == f"{hit.row:,} of 1,200"
    assert attributes["pruned by"] == "geometry"
    assert first["Bits unknown: not an .egs file"] == []
    assert dict(first["In this view, 600x400"])["of the clicked pixel"].endswith(" %")
    row = picker.describe(hit, POSE).difference.row
    assert f"Error against B's {row:,}" in first
    sections = picked_sections(picker.describe(Hit(1, row), POSE))
    titles = [title for title, _ in sections]
    assert titles[0] == "Gaussian of B"
    assert titles[2] == f"Error against A's {hit.row:,}"
    bits = dict(sections[3][1])
    assert titles[3] == f"Bits: {b.bits[row]:.1f}"
    assert bits["geometry"].endswith(" b")
    assert bits["header"].endswith(" f")
    steps = dict(sections[4][1])
    assert list(steps) == [
        "position, scene units", "opacity, logit", "scaling, log", "rotation, sin half angle",
        "sh-dc, SH", "sh1, SH", "sh2, SH",
    ]  # fmt: skip


def test_a_mark_goes_around_its_gaussian_and_is_seen_on_any_background(a):
    row = Picker([a]).pick(0, POSE, SIZE, (24.5, 16.5)).row
    outline, ring = marker(a, row, POSE, *SIZE)
    place = POSE.project(a.positions[row][None], *SIZE)[0][0]
    np.testing.assert_allclose(ring.mean(axis=0), place, atol=1e-6)
    assert np.linalg.norm(outline - place, axis=1).min() > 6.9
    for level in (0, 127, 255):
        canvas = Image.new("RGB", SIZE, (level,) * 3)
        draw_marker(canvas, [outline, ring])
        changed = np.abs(np.asarray(canvas, int) - level).max(axis=2) > 100
        assert changed.sum() > 20
    behind = replace(POSE, position=a.positions[row] + np.array([0.0, 0.0, 1.0]))
    assert marker(a, row, behind, *SIZE) == []


def test_invisible_gaussians_are_marked_by_a_circle(a):
    faint = a.gaussians
    faint = replace(faint, opacity=np.full_like(faint.opacity, -20))
    scene = Opened("faint", to_cloud(faint))
    outline, _ = marker(scene, 5, POSE, *SIZE)
    place = POSE.project(scene.positions[5][None], *SIZE)[0][0]
    np.testing.assert_allclose(np.linalg.norm(outline - place, axis=1), 7)


def test_places_far_from_0_have_all_their_digits(a):
    far = np.array([[1.0, 0, 0, 500_000], [0, 1, 0, -4e6], [0, 0, 1, 0], [0, 0, 0, 1]])
    every = np.ones(COUNT, bool)
    scene = keep(a, every, (Move(every, far),))
    sections = dict(picked_sections(Picker([scene]).describe(Hit(0, 5), POSE)))
    text = dict(sections["Gaussian of A"])["x, y, z, units"]
    shown = np.array(text.split(), np.float64)
    np.testing.assert_allclose(shown, scene.positions[5], rtol=1e-7, atol=5e-4)


def test_pictures_that_are_saved_have_the_mark(a):
    plain = Shown(("splats",), scenes=(a,))
    row = Picker([a]).pick(0, POSE, SIZE, (24.5, 16.5)).row
    views: dict = {}
    before, _ = draw_scene(a, POSE, *SIZE, plain, views)
    after, _ = draw_scene(a, POSE, *SIZE, replace(plain, marked=(a, row)), views)
    assert (np.abs(after - before).max(axis=2) > 0.2).sum() > 20


@pytest.mark.parametrize("size", [1.0, 1e-5])
def test_a_measured_line_is_cut_where_it_comes_before_the_camera(size):
    pose = look_at(np.array([0.0, 0, -4 * size]), np.zeros(3))
    assert measure_lines([], pose, 90, 60) == []
    line, *rings = measure_lines(size * np.array([[0.0, 0, 0], [1, 0, 0]]), pose, 90, 60)
    np.testing.assert_allclose(line[0], (45, 30))
    np.testing.assert_allclose([ring.mean(axis=0) for ring in rings], line, atol=1e-9)
    cut, *rings = measure_lines(size * np.array([[0.0, 0, 0], [1, 0, -6]]), pose, 90, 60)
    assert len(rings) == 1
    assert np.isfinite(cut).all()
    np.testing.assert_allclose(cut[0], (45, 30))
    assert np.sign(cut[1][0] - 45) == np.sign(line[1][0] - 45)
    assert measure_lines(size * np.array([[0.0, 0, -5], [1, 0, -6]]), pose, 90, 60) == []
