"""The viewer without a window: layers, poses, pictures, its command line."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from scenes import random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.cameras.up import UNSURE, UPS, up_of
from gs_codec.cameras.widest import widest_view
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.edit.project_file import Move
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.preparation.prepare_report import centres_checksum
from viewer.main import app
from viewer.pictures import screenshot
from viewer.pictures.centres import centres, pruned_centres
from viewer.pictures.drawer import measure
from viewer.pictures.layers import (
    UNKNOWN,
    Points,
    box_lines,
    error_image,
    error_legend,
    heat,
)
from viewer.pictures.picture import (
    Shown,
    caption_lines,
    draw_points,
    draw_scene,
    labelled,
    outlined,
    wipe_line,
    wiped,
)
from viewer.pictures.screenshot import draw_request
from viewer.scenes.choice import COLOURINGS, LAYERS, OctreeChoice
from viewer.scenes.numbers import facts, quality_text
from viewer.scenes.opened import Opened, keep, open_scene, read_pruned, thinned, turned
from viewer.scenes.pose import Pose, look_at, moved, of_camera, overview
from viewer.scenes.view_request import Request, find_views, first_view, parse_layers
from viewer.scenes.viewpoints import Views, choose_views, find_viewpoints, given_views
from viewer.scenes.worker import Worker
from viewer.window.view_survey import Survey

STRAIGHT = Pose(np.eye(3), np.array([0.0, 0.0, -4.0]))


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene, its encoding, a third of it, and a report on the removed Gaussians."""
    folder = tmp_path_factory.mktemp("viewer")
    scene = random_scene(900, 1, seed=300)
    write_ply(folder / "a.ply", scene)
    (folder / "b.egs").write_bytes(encode_scene(scene, Config("m"))[0])
    blocks = random_scene(2000, 1, seed=302)
    (folder / "blocks.egs").write_bytes(encode_scene(blocks, Config("m", block_size=1024))[0])
    labels = (np.arange(900) % 3).astype(np.uint8)
    write_ply(folder / "kept.ply", scene.take(np.flatnonzero(labels == 0)))
    report = folder / "report"
    report.mkdir()
    np.save(report / "labels.npy", labels)
    removed = {"geometry": 300, "importance": 300}
    told = {"removed": removed, "centres_crc32c": centres_checksum(scene.positions)}
    (report / "report.json").write_text(json.dumps(told))
    return folder


def viewer(*arguments, **environment) -> subprocess.CompletedProcess:
    """Run `gs-viewer` in a separate process."""
    code = "import sys; sys.argv[0] = 'gs-viewer'; from viewer.main import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | environment,
        cwd=Path(__file__).parent.parent,
    )


# Scenes and reports


def test_a_scene_has_facts_about_itself(files):
    scene, coded = open_scene(files / "a.ply"), open_scene(files / "b.egs")
    assert (scene.count, scene.sh_degree, scene.info) == (900, 1, None)
    assert scene.file_bytes == (files / "a.ply").stat().st_size
    assert scene.raw_bytes == 900 * 4 * 23
    assert coded.info.profile == "m"
    assert not len(scene.blocks)
    assert not len(coded.blocks)
    assert ((scene.opacities > 0) & (scene.opacities < 1)).all()


def test_gaussians_that_cannot_be_drawn_are_counted(tmp_path):
    scene = random_scene(50, 1, seed=9)
    scene.positions[0, :7] = np.nan
    scene.opacity[:, 5:10] = np.inf  # opacity 1
    scene.f_rest[2, 20] = -np.inf
    write_ply(tmp_path / "a.ply", scene)
    assert ("  NaN, not drawn", "8") in facts(open_scene(tmp_path / "a.ply"))
    write_ply(tmp_path / "b.ply", scene.take(np.arange(7, 20)))
    assert [name for name, _ in facts(open_scene(tmp_path / "b.ply"))][:2] == [
        "Gaussians",
        "SH degree",
    ]


def test_the_size_is_that_of_all_files_of_a_scene(files, tmp_path):
    gs_codec.convert_file(files / "a.ply", tmp_path / "meta.json")
    expected = sum(each.stat().st_size for each in tmp_path.iterdir())
    assert open_scene(tmp_path / "meta.json").file_bytes == expected


def test_boxes_contain_most_of_their_blocks(tmp_path):
    scene = random_scene(3000, 0, seed=301)
    scene.positions[:, ::100] *= 50
    (tmp_path / "c.egs").write_bytes(encode_scene(scene, Config("m", block_size=1024))[0])
    coded = open_scene(tmp_path / "c.egs")
    assert len(coded.blocks) == 3
    for k, (low, high) in enumerate(coded.blocks):
        block = coded.positions[k * coded.info.block_size :][: coded.info.block_size]
        assert 0.8 < np.mean((block >= low).all(axis=1) & (block <= high).all(axis=1)) < 1
        assert (high - low < np.ptp(block, axis=0)).all()


def test_scenes_of_another_system_are_converted_and_say_so(files, tmp_path):
    scene = read_ply(files / "a.ply")
    other = turn_axes(scene, "RUB")
    write_ply(tmp_path / "said.ply", other)
    write_ply(tmp_path / "unsaid.ply", replace(other, comments=()))
    first, said, unsaid = (
        open_scene(path)
        for path in (files / "a.ply", tmp_path / "said.ply", tmp_path / "unsaid.ply")
    )
    assert Shown((), scenes=(first, said)).captions == [
        "A: a.ply",
        "B: said.ply, converted from RUB",
    ]
    assert first.title == "a.ply"
    np.testing.assert_array_equal(said.positions, first.positions)
    assert np.any(unsaid.positions != first.positions)
    by_hand = turned(unsaid)
    np.testing.assert_array_equal(by_hand.positions, first.positions)
    assert by_hand.title == "unsaid.ply, converted from RUB"
    pose = replace(STRAIGHT, frame=(60, 40))
    assert measure({}, (first, by_hand), pose) == "the same"
    again = turned(by_hand)
    np.testing.assert_array_equal(again.positions, unsaid.positions)
    assert again.title == "unsaid.ply"


def test_reports_of_other_scenes_are_refused(files):
    scene = open_scene(files / "a.ply")
    pruned = read_pruned(files / "report", scene)
    assert pruned.counts == {"geometry": 300, "importance": 300}
    # Coordinate systems and edits do not make it another scene.
    left = keep(scene, pruned.labels == 1)
    for other in (turned(scene), left, turned(turned(scene))):
        assert read_pruned(files / "report", other).counts == pruned.counts
    points = pruned_centres(scene, pruned)
    np.testing.assert_array_equal(points.positions, scene.positions[pruned.labels > 0])
    assert len(np.unique(points.colours, axis=0)) == 2
    with pytest.raises(gs_codec.GsCodecError, match=r"report: report of another scene than b.egs"):
        read_pruned(files / "report", open_scene(files / "b.egs"))
    with pytest.raises(gs_codec.GsCodecError, match=r"900 Gaussians, kept.ply has 300"):
        read_pruned(files / "report", open_scene(files / "kept.ply"))
    with pytest.raises(gs_codec.GsCodecError, match=r"no report of prepare \(No such file"):
        read_pruned(files, scene)


@pytest.mark.parametrize("report", ["", "[]", "{}", '{"removed": 3}'])
@pytest.mark.parametrize("labels", [b"", b"abc"])
def test_a_damaged_report_is_named_in_plain_words(files, tmp_path, report, labels):
    (tmp_path / "report.json").write_text(report)
    (tmp_path / "labels.npy").write_bytes(labels)
    with pytest.raises(gs_codec.GsCodecError, match=r"no report of prepare \(damaged\)"):
        read_pruned(tmp_path, open_scene(files / "a.ply"))


# Colours and shapes


def test_heat_goes_from_dark_to_bright():
    colours = heat(np.array([-1.0, 0.0, 0.5, 1.0, 2.0, np.nan]), 0, 1)
    np.testing.assert_array_equal(colours[0], colours[1])
    np.testing.assert_array_equal(colours[3], colours[4])
    assert (np.diff(colours[[1, 2, 3]].sum(axis=1)) > 0.2).all()
    assert np.isfinite(colours).all()
    assert np.isfinite(heat(np.zeros(3), 0, 0)).all()


@pytest.mark.parametrize(("count", "most"), [(10, 3), (10, 10), (7, 100), (0, 5), (5, 0)])
def test_thinning_respects_the_maximum(count, most):
    left = np.arange(count)[thinned(count, most)]
    assert len(left) <= max(most, 1)
    assert len(left) == count or len(left) > most / 2 or not most


def test_errors_are_to_the_nearest_centre(files):
    scene = open_scene(files / "a.ply")
    changed = scene.cloud.clone()
    f_dc = changed.point["f_dc"].numpy().copy()
    f_dc[5] = -f_dc[5] + 0.5
    changed.point["f_dc"] = type(changed.point["f_dc"])(f_dc)
    other = Opened("changed", changed)
    for each in (other, scene):
        points = centres(each, "error", [scene, other])
        assert points.legend == error_legend("colour error")
        brightness = points.colours.sum(axis=1)
        assert brightness.argmax() == 5
        assert (brightness[np.arange(900) != 5] == brightness.min()).all()
    alone = centres(scene, "error", [scene])
    assert (alone.colours == np.float32(UNKNOWN)).all()
    assert alone.legend is None


def test_two_scenes_share_one_range_of_sizes(files):
    scene = open_scene(files / "a.ply")
    larger = scene.cloud.clone()
    log_scale = larger.point["log_scale"].numpy() + np.float32(2)
    larger.point["log_scale"] = type(larger.point["log_scale"])(log_scale)
    other = Opened("larger", larger)
    first, second = (centres(each, "scale", [scene, other]) for each in (scene, other))
    assert first.legend == second.legend
    assert second.colours.sum() > 1.2 * first.colours.sum()


@pytest.mark.parametrize("colouring", COLOURINGS)
def test_centres_of_an_empty_scene(colouring):
    empty = Opened("empty", to_cloud(random_scene(3, 0, seed=1).take(np.arange(0))))
    assert centres(empty, colouring, [empty]).positions.shape == (0, 3)
    assert overview(empty.positions, empty.opacities).position.shape == (3,)


def test_boxes_have_twelve_edges_along_axes():
    corners, edges = box_lines(np.array([[[0, 0, 0], [1, 2, 3]], [[5, 5, 5], [6, 6, 6]]]))
    assert len(edges) == 24
    lengths = np.abs(corners[edges[:, 0]] - corners[edges[:, 1]])
    assert ((lengths > 0).sum(axis=1) == 1).all()
    assert sorted(lengths[:12].sum(axis=1)) == [1] * 4 + [2] * 4 + [3] * 4


def test_the_scale_of_errors_never_changes():
    first = np.full((20, 20, 3), 0.5)
    near, far = (first + error / 255 for error in (1, 16))
    far[:10] = near[:10]
    image = error_image(first, far)
    np.testing.assert_array_equal(error_image(first, near)[:10], image[:10])
    legend = error_legend("error")
    assert legend.marks == ("0.25", "1", "4", "16", "64")
    bar = legend.bar(5, 1)[0]
    np.testing.assert_allclose(image[0, 0], bar[legend.marks.index("1")], atol=1e-6)
    np.testing.assert_allclose(image[-1, 0], bar[legend.marks.index("16")], atol=1e-6)


# Poses


def test_poses_show_their_target_in_the_middle():
    pose = look_at(np.array([1.0, -2.0, -5.0]), np.array([0.3, 0.1, 0.2]))
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    pixel, depth = pose.project(np.array([[0.3, 0.1, 0.2]]), 300, 200)
    np.testing.assert_allclose(pixel, [[150, 100]], atol=1e-9)
    assert depth[0] > 0


def test_poses_draw_what_their_cameras_draw(files):
    scene = open_scene(files / "a.ply")
    camera = STRAIGHT.camera(60, 40)
    views = gs_codec.render(scene.cloud, [camera])
    again = of_camera(views.cameras[0])
    np.testing.assert_array_equal(again.rotation, STRAIGHT.rotation)
    drawn = views.draw(again.camera(60, 40))
    np.testing.assert_array_equal(drawn.colour, views.draw(camera).colour)
    assert drawn.colour.max() > 0.05


@pytest.fixture(scope="module")
def seen(files):
    """A scene, and views estimated for it."""
    scene = open_scene(files / "a.ply")
    return scene, choose_views(scene, count=5)


@pytest.mark.thorough
@pytest.mark.usefixtures("few_cameras")
def test_without_cameras_the_first_viewpoint_is_the_first_estimated_camera(seen, files):
    scene, views = seen
    expected = gs_codec.render(scene.cloud, "auto").cameras
    for request in (Request(files / "a.ply"), Request(files / "a.ply", cameras="auto")):
        found = find_views(request, scene)
        [first] = find_viewpoints(scene, found, found.ups[0])
        assert first.name == "overview"
        assert first_view(request, found) == 0
        np.testing.assert_array_equal(first.pose.position, expected[0].position)
        np.testing.assert_allclose(first.pose.rotation, expected[0].rotation, atol=1e-12)
        assert first.pose.frame == (expected[0].width, expected[0].height)
    names = [viewpoint.name for viewpoint in find_viewpoints(scene, views, views.ups[0])]
    assert names == ["overview", "auto_01", "auto_02", "auto_03", "auto_04"]


@pytest.mark.thorough
@pytest.mark.usefixtures("few_cameras")
def test_estimated_views_are_selected_by_number(seen, files):
    scene, _ = seen
    request = Request(files / "a.ply", cameras="auto", view=3)
    views = find_views(request, scene)
    viewpoint = find_viewpoints(scene, views, views.ups[0])[first_view(request, views)]
    assert viewpoint.name == "auto_03"
    expected = gs_codec.render(scene.cloud, "auto").cameras
    np.testing.assert_array_equal(viewpoint.pose.position, expected[3].position)
    with pytest.raises(gs_codec.GsCodecError, match=f"view 99: expected 0 to {len(expected) - 1}"):
        find_views(replace(request, view=99), scene)


@pytest.mark.thorough
@pytest.mark.parametrize("up", UPS)
def test_viewpoints_are_upright_for_the_requested_axis(seen, up):
    scene, views = seen
    asked = find_views(Request(up=up), scene)
    for viewpoint in (*find_viewpoints(scene, views, up), *find_viewpoints(scene, asked, up)):
        right, down, _ = viewpoint.pose.rotation
        assert right @ UPS[up] == pytest.approx(0, abs=1e-9)
        assert down @ UPS[up] <= 0
        assert np.linalg.det(viewpoint.pose.rotation) == pytest.approx(1)
    turned_by_hand = find_viewpoints(scene, views, up)[1].pose
    np.testing.assert_allclose(turned_by_hand.rotation[2], views.cameras[1].rotation[2], atol=1e-9)
    [first] = find_viewpoints(scene, asked, up)
    pixels, depth = first.pose.project(scene.positions, 60, 40)
    inside = (pixels > 0) & (pixels < [60, 40]) & (depth[:, None] > 0)
    assert inside.all(axis=1).mean() > 0.5
    np.testing.assert_array_equal(asked.up, views.up)


@pytest.mark.parametrize("up", [None, "z"])
@pytest.mark.parametrize("name", ["empty", "invisible", "nowhere"])
def test_empty_scenes_have_an_overview(name, up):
    scene = random_scene(50, 0, seed=304)
    scene.opacity[:] = -20
    if name == "nowhere":
        scene.positions[0] = np.nan
    shown = Opened(name, to_cloud(scene.take(np.arange(0)) if name == "empty" else scene))
    views = find_views(Request(up=up), shown)
    assert not views.cameras
    assert views.ups == [*UPS]
    [first] = find_viewpoints(shown, views, up or views.ups[0])
    expected = overview(shown.positions, shown.opacities, UPS[up or "-y"])
    np.testing.assert_array_equal(first.pose.extrinsics, expected.extrinsics)
    assert np.isfinite(expected.extrinsics).all()
    assert first_view(Request(up=up), views) == 0


def test_one_solid_gaussian_is_no_overview_of_a_transparent_scene():
    positions = random_scene(50, 0, seed=305).positions.T
    opacities = np.full(50, 0.1)
    opacities[7] = 0.9
    found, expected = overview(positions, opacities), overview(positions, np.ones(50))
    np.testing.assert_array_equal(found.extrinsics, expected.extrinsics)


def test_cameras_of_a_file_determine_the_up_axis(files):
    up = np.array([0.36, -0.48, 0.8])
    looks = np.random.default_rng(303).normal(size=(20, 3))
    cameras = [replace(look_at(np.zeros(3), look, up), frame=(60, 40)) for look in looks]
    np.testing.assert_allclose(up_of([camera.rotation for camera in cameras]), up, atol=2e-3)
    given = gs_codec.render(files / "a.ply", [camera.camera(60, 40) for camera in cameras]).cameras
    views = given_views(given)
    assert views.ups[0] == "cameras"
    assert Views().ups[0] == "-y"
    viewpoints = find_viewpoints(open_scene(files / "a.ply"), views, "cameras")
    assert [viewpoint.name for viewpoint in viewpoints[:2]] == ["overview", "view"]
    assert first_view(Request(cameras=given), views) == 1
    assert viewpoints[0].pose.rotation[0] @ up == pytest.approx(0, abs=1e-2)
    np.testing.assert_array_equal(viewpoints[3].pose.rotation, given[2].rotation)


def test_the_overview_of_given_cameras_is_from_the_one_that_shows_most(files):
    scene = open_scene(files / "a.ply")
    middle = np.median(scene.positions, axis=0).astype(np.float64)
    size = float(np.quantile(np.abs(scene.positions - middle), 0.8))
    side, up = np.array([1.0, 0, 0]), np.array([0.0, 0, 1.0])
    poses = [look_at(middle + far * size * side, middle, up) for far in (0.5, 1, 4)]
    away = look_at(middle + 9 * size * side, middle + 99 * size * side, up)
    cameras = [as_camera(pose.camera(60, 40)) for pose in (*poses, away)]
    assert widest_view(scene.gaussians, cameras) == 2
    overview = find_viewpoints(scene, given_views(cameras), "-y")[0]
    np.testing.assert_array_equal(overview.pose.position, cameras[2].position)
    assert overview.pose.rotation[1][1] > 0.9  # upright with respect to the requested axis
    assert widest_view(scene.gaussians, cameras[3:]) == 0


@pytest.mark.usefixtures("few_cameras")
def test_an_uncertain_up_axis_is_reported(caplog, tmp_path, capsys):
    # Without SH-AC, the up axis cannot be estimated.
    write_ply(tmp_path / "a.ply", random_scene(3000, 0, seed=8))
    path, size = str(tmp_path / "a.ply"), ["--width", "64", "--height", "64"]
    film = ["--turntable", str(tmp_path / "film"), "--frames", "2"]
    for asked in (["--screenshot", str(tmp_path / "a.png")], film):
        for up, expected in (([], [UNSURE]), (["--up=z"], [])):
            caplog.clear()
            app([path, *asked, *size, *up, "--overwrite"], standalone_mode=False)
            assert [record.getMessage() for record in caplog.records] == expected
    scene = open_scene(tmp_path / "a.ply")
    assert not find_views(Request(), scene).up_certain
    assert find_views(Request(up="z"), scene).up_certain


# Pictures


def test_captions_are_wrapped_in_small_pictures():
    image, name = np.zeros((90, 120, 3), np.float32), "A: a long name of a scene.ply, edited"
    lines = caption_lines(name, 120)
    assert " ".join(lines) == name
    assert len(lines) > 1
    assert "".join(caption_lines("x" * 99, 120)) == "x" * 99
    assert caption_lines("short\nsecond", 120) == ["short", "second"]
    assert caption_lines("any", 3) == ["a", "n", "y"]
    wide = np.asarray(labelled(np.zeros((90, 600, 3), np.float32), [(0, name)], []))
    small = np.asarray(labelled(image, [(0, name)], []))
    assert (small == 255).sum() == pytest.approx((wide == 255).sum(), rel=0.1)  # all letters
    assert small[:, 118:].max() == 0


@pytest.mark.one_in(3)
@pytest.mark.usefixtures("few_cameras")
@pytest.mark.parametrize(("width", "height"), [(200, 100), (80, 100), (100, 300)])
def test_pictures_show_all_that_their_camera_sees(files, width, height):
    camera = gs_codec.render(gs_codec.read(files / "a.ply"), "auto").cameras[0]
    pose = of_camera(camera)
    corners = np.array([[-0.5, -0.5], [0.5, 0.5]]) * (camera.width, camera.height)
    rays = np.column_stack([corners / (camera.fx, camera.fy), np.ones(2)])
    pixels, _ = pose.project(rays @ camera.rotation + camera.position, width, height)
    sides = pixels[1] - pixels[0]
    assert np.all(sides <= np.array([width, height]) + 1e-6)
    assert np.isclose(sides, (width, height)).any()


def test_the_nearest_point_is_on_top():
    image = np.zeros((40, 60, 3), np.float32)
    positions = np.array([[0, 0, 1], [0, 0, 0], [0, 0, 2], [0, 0, -9]], np.float32)
    colours = np.eye(4, 3, dtype=np.float32)
    draw_points(image, Points(positions, colours), STRAIGHT, 3)
    lit = np.argwhere(image.any(axis=2))
    assert len(lit) == 9
    np.testing.assert_array_equal(image[20, 30], [0, 1, 0])
    draw_points(image, Points(positions[:0], colours[:0]), STRAIGHT, 3)


def test_points_half_outside_are_cut():
    image = np.zeros((40, 60, 3), np.float32)
    edge = np.array([[4 * 30 / (0.866 * 40), 0, 0]], np.float32)
    draw_points(image, Points(edge, np.ones((1, 3), np.float32)), STRAIGHT, 4)
    assert 0 < image.any(axis=2).sum() < 16


@pytest.mark.parametrize("layer", LAYERS)
def test_every_layer_is_visible(files, layer):
    a, b = open_scene(files / "a.ply"), open_scene(files / "blocks.egs")
    shown = Shown((layer,), scenes=(a, b), pruned=read_pruned(files / "report", a))
    changed = {}
    for scene in (a, b):
        images = [
            draw_scene(scene, STRAIGHT, 90, 60, replace(shown, layers=x), {})[0]
            for x in ((), (layer,))
        ]
        changed[scene] = np.any(np.abs(images[1] - images[0]) > 0.05)
        assert images[1].shape == (60, 90, 3)
    assert changed[b] == (layer != "pruned")
    assert changed[a] == (layer != "boxes")


@pytest.mark.parametrize("layer", ["centres", "boxes", "octree"])
def test_layers_of_a_tiny_scene_are_those_of_a_large_one(files, layer):
    scene, matrix = open_scene(files / "blocks.egs"), np.diag([1e-5, 1e-5, 1e-5, 1])
    every = np.ones(scene.count, bool)
    tiny = keep(scene, every, (Move(every, matrix),))
    large, small = (
        draw_scene(each, pose, 90, 60, Shown((layer,), scenes=(each,)), {})[0]
        for each, pose in ((scene, STRAIGHT), (tiny, moved(STRAIGHT, matrix)))
    )
    assert large.any()
    assert (np.abs(large - small).max(axis=2) > 0.1).mean() < 0.02


def test_wipes_show_both():
    image = wiped(np.zeros((10, 80, 3)), np.full((10, 80, 3), 0.5), 0.25)
    assert not image[:, :16].any()
    assert (image[:, 16:24] == image[0, 16]).all()
    assert image[0, 16].min() > 0.8
    assert (image[:, 24:] == 0.5).all()


@pytest.mark.parametrize("wipe", [0.0, 0.5, 1.0])
def test_a_wipe_leaves_some_of_both(wipe):
    start, stop = wipe_line(wipe, 40)
    assert 0 < start < stop < 40


def test_measurements_use_the_cameras_frame(files):
    camera = gs_codec.render(files / "a.ply", [STRAIGHT.camera(60, 40)]).cameras[0]
    camera = replace(camera, cx=25.0, cy=22.0)
    scenes = [open_scene(files / name) for name in ("a.ply", "b.egs")]
    pose = of_camera(camera)
    expected = gs_codec.compare(files / "a.ply", files / "b.egs", [camera]).mean.between
    assert measure({}, scenes, pose) == quality_text(expected)
    assert pose.measured == (60, 40)
    assert replace(pose, frame=(6400, 4000)).measured == (1600, 1000)
    assert measure({}, scenes, replace(pose, frame=(8, 8))) == "frame of 8x8: too small"


def test_the_frame_is_outlined_and_measured_whatever_the_layout(files, monkeypatch):
    captions = []
    labelled = screenshot.labelled
    monkeypatch.setattr(
        screenshot, "labelled", lambda *given: captions.append(given[1][-1][1]) or labelled(*given)
    )
    poses = [STRAIGHT.camera(60, 40) | {"img_name": "view"}]
    (files / "one.json").write_text(json.dumps(poses))
    request = Request(files / "a.ply", files / "b.egs", cameras=str(files / "one.json"))
    for mode, size in (("side", (300, 120)), ("wipe", (300, 120)), ("flip", (90, 300))):
        draw_request(replace(request, mode=mode, size=size))
    lines = {caption.partition("\n")[2] for caption in captions if caption.startswith("B")}
    assert len(lines) == 1
    assert lines.pop().endswith("in the frame, 60x40")
    image = outlined(
        np.zeros((100, 90, 3)), of_camera(gs_codec.render(files / "a.ply", poses).cameras[0])
    )
    rows = np.flatnonzero(image.any(axis=(1, 2)))
    assert (rows[0], rows[-1]) == (20, 79)


@pytest.mark.thorough
def test_pictures_have_the_requested_size(files):
    for mode in ("side", "wipe", "flip"):
        request = Request(files / "a.ply", files / "b.egs", mode=mode, size=(300, 120))
        assert draw_request(request)[0].size == (300, 120)
    side, flip = (
        draw_request(Request(files / "a.ply", files / "b.egs", mode=mode, size=(300, 120)))[0]
        for mode in ("side", "flip")
    )
    assert np.any(np.asarray(side) != np.asarray(flip))


# The worker


def finish(worker: Worker, calls: list) -> None:
    """Wait until the worker is idle, and run its callbacks."""
    for _ in range(1000):
        if not worker.busy:
            break
        time.sleep(0.01)
    for call in calls:
        call()


def test_only_the_newest_job_of_a_kind_reports():
    calls, told = [], []
    worker = Worker(calls.append)
    started, go_on = threading.Event(), threading.Event()

    def first(stale):
        started.set()
        go_on.wait(10)
        return stale()

    worker.submit("picture", first, lambda result: told.append(("first", result)), told.append)
    assert started.wait(10)
    worker.submit(
        "picture", lambda _: 2, lambda result: told.append(("second", result)), told.append
    )
    worker.submit("other", lambda _: 1 / 0, told.append, lambda error: told.append(type(error)))
    go_on.set()
    finish(worker, calls)
    assert told == [("second", 2), ZeroDivisionError]
    worker.submit("picture", lambda _: 3, told.append, told.append)
    worker.cancel("picture")
    worker.end()


def test_views_of_another_scene_are_drawn_while_the_last_is_still_being_drawn(monkeypatch):
    calls, started, go_on = [], threading.Event(), threading.Event()

    def splats(views, scene, *_):
        started.set()
        go_on.wait(10)
        return scene

    monkeypatch.setattr("viewer.window.view_survey.splats", splats)
    stage = SimpleNamespace(scenes=["first"], views={})
    viewer = SimpleNamespace(stage=stage, worker=Worker(calls.append), fail=print)
    points = [SimpleNamespace(pose=SimpleNamespace(frame=(4, 3))) for _ in range(2)]
    visits = SimpleNamespace(viewpoints=points, views=SimpleNamespace(first=0))
    survey = Survey(viewer, visits, lambda: None)
    survey.ask("pictures", True)
    assert started.wait(10)
    stage.scenes = ["second"]
    survey.ask("pictures", True)
    go_on.set()
    for _ in range(2):  # one after the other
        finish(viewer.worker, calls)
        calls.clear()
    assert survey.pictures == {0: "second", 1: "second"}
    viewer.worker.end()


def test_another_thread_does_not_wait_for_the_first_and_ends_with_it():
    told, go_on, done = [], threading.Event(), threading.Event()
    worker = Worker(lambda call: call())
    worker.submit("load", lambda _: go_on.wait(10), told.append, told.append)
    other = worker.another()
    other.submit("picture", lambda _: 1, lambda result: (told.append(result), done.set()), print)
    assert done.wait(10)
    assert told == [1]
    worker.end()
    go_on.set()
    other.submit("picture", lambda _: 2, told.append, told.append)
    other.submit("picture", lambda _: 3, told.append, told.append)
    time.sleep(0.05)
    assert told == [1]


def test_jobs_report_progress_and_end_when_stale():
    calls, told, went_on = [], [], []
    worker = Worker(calls.append)
    shown, go_on = threading.Event(), threading.Event()

    def job(stale):
        progress = worker.progress(stale, told.append)
        progress("decode", 1, 4)
        shown.set()
        go_on.wait(10)
        progress("decode", 2, 4)
        went_on.append(True)

    worker.submit("load", job, told.append, told.append)
    assert shown.wait(10)
    calls.pop()()
    assert told == [0.25]
    worker.cancel("load")
    go_on.set()
    finish(worker, calls)
    assert told == [0.25]
    assert not went_on
    worker.end()


def test_reading_reports_progress(files):
    steps = []
    request = Request(files / "a.ply", files / "b.egs")
    request.scenes(lambda stage, done, total: steps.append(done / total))
    assert steps == sorted(steps)
    assert 0.5 < steps[0] <= steps[-1] == 1.0


# The command line


def test_layers_of_a_list():
    assert parse_layers("centres, boxes,", None) == ("centres", "boxes")
    assert parse_layers(None, None) == ("splats",)
    assert parse_layers(None, Path("report")) == ("splats", "pruned")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"layers": ("centers",)}, "layers 'centers': expected splats"),
        ({"colouring": "red"}, "colour 'red'"),
        ({"mode": "both"}, "mode 'both'"),
        ({"size": (10, 100)}, "size 10x100"),
        ({"view": 3}, "view: needs cameras"),
        ({"images": Path("x")}, "images: need cameras from a file"),
        ({"images": Path("x"), "cameras": "auto"}, "images: need cameras from a file"),
        ({"images": Path("/none"), "cameras": "c.json"}, "/none: no such folder"),
        ({"up": "w"}, "up 'w': expected -y, y, -z"),
        ({"a": None, "cameras": "auto"}, "no scene"),
        ({"octree": OctreeChoice(0)}, "octree-depth 0: expected 1 to 12"),
        ({"octree": OctreeChoice(13)}, "octree-depth 13: expected 1 to 12"),
        ({"octree": OctreeChoice(4, "size")}, "octree-colour 'size': expected occupancy, bits"),
    ],
)
def test_invalid_options_are_refused(wrong, said):
    with pytest.raises(gs_codec.GsCodecError, match=said):
        Request(**({"a": Path("a.ply")} | wrong)).check()


def test_screenshots_need_no_display(files, tmp_path):
    out = tmp_path / "out.png"
    result = viewer(
        files / "a.ply", files / "b.egs", "--pruned", files / "report", "--width", "400",
        "--height", "200", "--layers", "splats,centres,pruned,boxes,octree", "--octree-depth", "3",
        "--octree-colour", "bits", "--up=-y", "--screenshot", out,
        DISPLAY="",
    )  # fmt: skip
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    with Image.open(out) as image:
        assert image.size == (400, 200)
    assert os.listdir(tmp_path) == ["out.png"]


def test_a_missing_photograph_is_reported_and_the_rest_drawn(files, tmp_path, run_viewer):
    poses = [STRAIGHT.camera(40, 30) | {"img_name": f"view{k}"} for k in range(2)]
    (tmp_path / "cameras.json").write_text(json.dumps(poses))
    (tmp_path / "images").mkdir()
    Image.new("RGB", (40, 30), (200, 0, 0)).save(tmp_path / "images" / "view1.png")
    asked = [files / "a.ply", "--cameras", tmp_path / "cameras.json", "--gt-images",
             tmp_path / "images", "--width", "200", "--height", "80"]  # fmt: skip
    status, _, err = run_viewer(*asked, "--screenshot", tmp_path / "0.png")
    assert status == 0
    assert err.startswith("gs-viewer: no photograph of ")
    assert "no image 'view0'" in err
    assert len(err.splitlines()) == 1
    second = [*asked, "--view", "1", "--screenshot", tmp_path / "1.png"]
    assert run_viewer(*second) == (0, "", "")
    assert run_viewer(*second)[0] == 2  # the output exists
    assert run_viewer(*second, "--overwrite") == (0, "", "")
    reds = [
        np.sum(np.asarray(Image.open(tmp_path / f"{k}.png"))[..., 0].astype(int) > 190)
        for k in range(2)
    ]
    assert reds[1] > reds[0] + 1000


def test_photographs_are_never_executed(files, tmp_path, monkeypatch, run_viewer):
    """PostScript with the name of a picture: Pillow would pass it to Ghostscript."""
    for name in ("bin", "images"):
        (tmp_path / name).mkdir()
    program, ran = tmp_path / "bin" / "gs", tmp_path / "ran"
    program.write_text(f"#!/bin/sh\ntouch {ran}\n")
    program.chmod(0o755)
    script = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n"
    (tmp_path / "images" / "view.png").write_bytes(script)
    poses = [STRAIGHT.camera(40, 30) | {"img_name": "view"}]
    (tmp_path / "cameras.json").write_text(json.dumps(poses))
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    status, _, err = run_viewer(
        files / "a.ply", "--cameras", tmp_path / "cameras.json", "--gt-images", tmp_path / "images",
        "--screenshot", tmp_path / "out.png",
    )  # fmt: skip
    assert not ran.exists()
    assert status == 2
    assert "view.png: not an image" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing.ply", "--screenshot", "x.png"], "nothing.ply: No such file"),
        (["pyproject.toml", "--screenshot", "x.png"], "pyproject.toml: begins with"),
        (["--screenshot", "x.png"], "no scene to draw"),
        (["viewer/error.png", "--screenshot", "x.png"], "error.png: a PNG image, not a scene"),
        (["a.ply", "--colour", "red"], "colour 'red': expected colour"),
        (["a.ply", "--unknown"], "No such option"),
        (["a.ply", "--screenshot", "x.jpg"], "x.jpg: expected .png"),
        (["a.ply", "--screenshot", "none/x.png"], "none/x.png: no directory 'none'"),
        (["a.ply", "--screenshot", "x.png", "--mode", "flip"], "mode flip: expected two scenes"),
        (["a.ply", "--turntable", "x", "--layers", "error"], "layers error: expected two scenes"),
        (["a.ply", "--screenshot", "x.png", "--layers", "pruned"], "layers pruned: needs a report"),
        (["a.ply", "--octree-depth", "13"], "octree-depth 13: expected 1 to 12"),
        (["a.ply", "--turntable", "x", "--octree-depth", "3"], "need the layer octree"),
        (["a.ply", "--screenshot", "x.png", "--colour", "sh"], "colour sh: needs the layer centr"),
    ],
)
def test_errors_are_one_line(arguments, said, run_viewer, monkeypatch):
    monkeypatch.chdir(Path(__file__).parent.parent)
    status, _, err = run_viewer(*arguments)
    assert status == 2
    assert err.startswith("gs-viewer: error: ")
    assert said in err
    assert len(err.splitlines()) == 1


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays of X11")
@pytest.mark.parametrize(
    ("name", "display", "said"),
    [
        ("a.ply", "", "DISPLAY is not set"),
        ("a.ply", ":9999", ":9999"),
        ("none.ply", "", "none.ply: No such file"),
    ],
)
def test_a_missing_display_is_reported(files, name, display, said):
    result = viewer(files / name, DISPLAY=display)
    assert result.returncode == 2
    assert said in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.thorough
def test_lines_of_the_readmes_draw_pictures(files, tmp_path, monkeypatch):
    monkeypatch.chdir(files)
    for name, copy in {
        "a.ply": "scene.ply",
        "b.egs": "scene.egs",
        "kept.ply": "smaller.ply",
    }.items():
        shutil.copy(files / name, files / copy)
    poses = [STRAIGHT.camera(40, 30) | {"img_name": f"view{k}"} for k in range(4)]
    for name in ("cameras.json", "path.json"):
        (files / name).write_text(json.dumps(poses))
    root = Path(__file__).parent.parent
    text = (root / "README.md").read_text() + (root / "viewer" / "README.md").read_text()
    lines = re.findall(r"^    gs-viewer (scene[^#\n]*)", text, re.MULTILINE)
    drawn = [line for line in lines if "--web" not in line]  # see test_served.py for that
    assert len(drawn) >= 7
    for k, line in enumerate(drawn):
        wanted = [*shlex.split(line), "--width", "120", "--height", "80"]
        film = {"--turntable", "--flythrough"}.intersection(wanted)
        out = tmp_path / (f"frames{k}" if film else f"{k}.png")
        for option in film:
            wanted[wanted.index(option) + 1] = str(out)
        wanted += ["--frames", "2"] if film else ["--screenshot", str(out)]
        result = CliRunner().invoke(app, wanted)
        assert result.exit_code == 0, (line, result.output, result.exception)
        assert out.exists()


def test_the_version_and_help(run_viewer, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    assert run_viewer("--version")[1].startswith(f"gs-viewer {gs_codec.__version__}")
    shown = run_viewer("--help")[1]
    assert "--screenshot" in shown
    assert "--pruned" in shown
