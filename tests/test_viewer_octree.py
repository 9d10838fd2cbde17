"""The viewer's octree layer: cells, colours, cubes, and updates while a slider moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import open3d as o3d
import pytest
from PIL import Image
from scenes import random_scene

import gs_codec
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from viewer.pictures.cubes import Cubes, draw_cubes
from viewer.pictures.layers import Points, heat
from viewer.pictures.octree_cells import Octree
from viewer.pictures.picture import Shown, draw_scene
from viewer.pictures.screenshot import draw_request
from viewer.pictures.ticks import scale_marks
from viewer.scenes.choice import OctreeChoice
from viewer.scenes.opened import Opened, open_scene
from viewer.scenes.pose import Pose, look_at
from viewer.scenes.view_request import Request
from viewer.window.octree_layer import OctreeLayer
from viewer.window.pane import _box

COUNT = 2500


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene, its encoding in three blocks, with a paper profile, and in its own order."""
    folder = tmp_path_factory.mktemp("octree")
    scene = random_scene(COUNT, 1, seed=41)
    write_ply(folder / "a.ply", scene)
    for name, config in {
        "blocks": Config("m", block_size=1024),
        "one": Config("paper-m"),
        "ordered": Config("lossless", keep_order=True),
    }.items():
        (folder / f"{name}.egs").write_bytes(encode_scene(scene, config)[0])
    return folder


def opened(scene, name: str = "cloud") -> Opened:
    return Opened(name, to_cloud(scene))


# Bits


def test_a_file_that_has_changed_is_refused(files, tmp_path):
    path = tmp_path / "scene.egs"
    path.write_bytes((files / "one.egs").read_bytes())
    scene = open_scene(path)
    path.write_bytes(gs_codec.encode(to_cloud(random_scene(9))))
    with pytest.raises(gs_codec.GsCodecError, match="changed after it was opened"):
        _ = scene.bits
    path.unlink()
    with pytest.raises(gs_codec.GsCodecError, match="changed after it was opened"):
        _ = scene.bits


def test_unknown_bits_are_explained(files):
    ply, ordered = open_scene(files / "a.ply"), open_scene(files / "ordered.egs")
    assert ply.bits is ordered.bits is None
    assert ply.bits_unknown == "not an .egs file"
    assert ordered.bits_unknown == "stored in the original order"
    shown = Shown(("octree",), scenes=(ply, ordered), octree=OctreeChoice(3, "bits"))
    assert shown.captions == [
        "A: a.ply, bits unknown: not an .egs file",
        "B: ordered.egs, bits unknown: stored in the original order",
    ]
    assert replace(shown, layers=()).captions == ["A: a.ply", "B: ordered.egs"]
    tree = Octree([ply, ordered])
    for scene in (ply, ordered):
        cells = tree.cells(scene, shown.octree)
        assert cells.legend is None
        assert len(np.unique(cells.colours)) == 1
    with pytest.raises(gs_codec.GsCodecError, match=r"octree-colour bits: a\.ply is not an"):
        draw_request(Request(files / "a.ply", octree=shown.octree))


# Cells


@pytest.mark.parametrize("depth", [1, 4, 9, 12])
def test_cells_are_the_leaves_of_to_octree(files, depth):
    scene = open_scene(files / "a.ply")
    octree, found = gs_codec.to_octree(scene.cloud, depth), []

    def visit(node, info):
        if isinstance(node, o3d.geometry.OctreePointColorLeafNode):
            found.append((*(info.origin + info.size / 2), len(node.indices)))
        return False

    octree.traverse(visit)
    cells = Octree([scene]).cells(scene, OctreeChoice(depth))
    leaves = np.array(sorted(found))
    order = np.lexsort(cells.middles.T[::-1])
    np.testing.assert_allclose(cells.middles[order], leaves[:, :3], atol=1e-5)
    most = leaves[:, 3].max()
    marks = scale_marks(1, max(most, 4), "log")
    colours = heat(np.log(leaves[:, 3]), 0, np.log(marks[-1]))
    np.testing.assert_allclose(cells.colours[order], colours, atol=1e-6)
    assert cells.legend.marks[0] == "1"
    assert float(cells.legend.marks[-1].replace(",", "")) == pytest.approx(marks[-1], rel=5e-3)
    assert cells.sides.max() <= 0.95 * octree.size / 2**depth
    fullest = cells.sides[order][leaves[:, 3] == most]
    assert (fullest == cells.sides.max()).all()


def test_very_far_centres_leave_cells_to_the_others():
    scene = random_scene(1000, 0, seed=5)
    positions = scene.positions.copy()
    positions[0, :3] = 1e9, -1e9, 1e5
    moved = opened(replace(scene, positions=positions))
    cells = Octree([moved]).cells(moved, OctreeChoice(8))
    assert len(cells.middles) > 300
    assert np.abs(cells.middles).max() < 100
    low, high = _box(moved.positions, moved.lengths)
    assert max(np.abs(low).max(), np.abs(high).max()) < 10


def test_two_scenes_have_one_grid_and_one_scale():
    first = random_scene(1000, 0, seed=5)
    far = np.concatenate([first.positions[:, :50] + np.float32(0.01), [[9.0]] * 3], axis=1)
    second = replace(first.take(np.arange(51)), positions=far.astype(np.float32))
    a, b = opened(first), opened(second)
    tree, choice = Octree([a, b]), OctreeChoice(5)
    both = [tree.cells(scene, choice) for scene in (a, b)]
    assert both[0].legend == both[1].legend
    shares = [cells.sides / (1.01 * 9) for cells in both]
    assert max(shares[0]) > max(shares[1])  # because it has more Gaussians per cell
    apart = Octree([a]).cells(a, choice)
    assert apart.legend != both[0].legend
    side = tree._side(5)
    steps = (both[0].middles[0] - both[1].middles) / side
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)


@pytest.mark.parametrize("depth", [1, 4, 12])
@pytest.mark.parametrize("name", ["blocks", "one"])
def test_bits_of_cells_are_means_of_their_gaussians(files, name, depth):
    scene = open_scene(files / f"{name}.egs")
    assert scene.bits.sum() == pytest.approx(8 * scene.file_bytes)
    cells = Octree([scene]).cells(scene, OctreeChoice(depth, "bits"))
    low, high = np.quantile(scene.bits, (0.02, 0.98))
    low, *_, high = marks = scale_marks(low, high, "linear")
    assert cells.legend.marks == tuple(f"{x:.3g}" for x in marks)
    octree, means = gs_codec.to_octree(scene.cloud, depth), []

    def visit(node, info):
        if isinstance(node, o3d.geometry.OctreePointColorLeafNode):
            middle = info.origin + info.size / 2
            means.append((*middle.tolist(), scene.bits[node.indices].mean()))
        return False

    octree.traverse(visit)
    order = np.lexsort(cells.middles.T[::-1])
    colours = heat(np.array(sorted(means))[:, 3], low, high)
    np.testing.assert_allclose(cells.colours[order], colours, atol=1e-5)


def test_too_many_cells_are_points(files):
    scene = open_scene(files / "a.ply")
    tree = Octree([scene])
    cubes = tree.cells(scene, OctreeChoice(8))
    points = tree.cells(scene, OctreeChoice(8), cubes=len(cubes.middles) - 1, points=100)
    assert isinstance(points, Points)
    assert 50 <= len(points.positions) <= 100
    assert points.legend == cubes.legend
    assert isinstance(tree.cells(scene, OctreeChoice(8), cubes=len(cubes.middles)), Cubes)


def test_two_scenes_are_both_cubes_or_both_points():
    many, few = opened(random_scene(500, 0)), opened(random_scene(20, 0))
    tree = Octree([many, few])
    for scene in (many, few):
        assert isinstance(tree.cells(scene, OctreeChoice(12), cubes=100), Points)
        assert isinstance(tree.cells(scene, OctreeChoice(1), cubes=100), Cubes)


@pytest.mark.parametrize("colouring", ["occupancy", "bits"])
def test_edge_scenes_have_cells_too(colouring):
    empty = opened(random_scene(3, 0).take(np.arange(0)))
    single = opened(random_scene(1, 0))
    wrong = random_scene(9, 0)
    wrong.positions[1, 4] = np.nan
    for depth in (1, 12):
        for scenes in ([empty], [empty, empty], [single], [single, empty], [opened(wrong)]):
            tree = Octree(scenes)
            held = tree.cells(scenes[0], OctreeChoice(depth, colouring))
            assert np.isfinite(held.middles).all()
            assert np.isfinite(held.colours).all()
            assert len(held.middles) <= min(scenes[0].count, 8)


# Pictures


def test_nearer_cubes_hide_others_and_backs_are_not_drawn():
    colours = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    middles = np.array([[0, 0, 0], [0, 0, 3], [2.0, 0, 0]], np.float32)
    for order in ([0, 1, 2], [2, 1, 0]):
        canvas = Image.new("RGB", (60, 40))
        sides = np.array([1.0, 1.0, 0.5], np.float32)
        cubes = Cubes(middles[order], sides[order], colours[order])
        draw_cubes(canvas, cubes, Pose(np.eye(3), np.array([0.0, 0.0, -4.0])))
        image = np.asarray(canvas)
        np.testing.assert_array_equal(image[20, 30], [153, 0, 0])  # facing z: 0.6
        assert not (image[..., 1] > 0).any()  # the second is behind the first
        assert set(np.unique(image[..., 2])) == {0, 153, 204}  # its front and its left side


def test_outlined_cubes_show_what_is_behind_them_in_their_colours():
    cubes = Cubes(
        np.zeros((1, 3), np.float32), np.ones(1, np.float32), np.array([[1, 0.5, 0]]), filled=False
    )
    canvas = Image.new("RGB", (60, 40), (9, 9, 9))
    draw_cubes(canvas, cubes, Pose(np.eye(3), np.array([0.0, 0.0, -4.0])))
    found = {tuple(pixel) for pixel in np.asarray(canvas).reshape(-1, 3).tolist()}
    assert found == {(9, 9, 9), (255, 128, 0)}
    assert canvas.getpixel((30, 20)) == (9, 9, 9)
    np.testing.assert_array_equal(cubes.boxes, [[[-0.5] * 3, [0.5] * 3]])


def test_cells_hide_neither_centres_nor_splats(files):
    scene = open_scene(files / "a.ply")
    pose = look_at(np.array([0.0, 0, -3]), np.zeros(3))
    layers = Shown(("centres",), scenes=(scene,), octree=OctreeChoice(2))
    plain = draw_scene(scene, pose, 300, 200, layers, {})[0]
    seen = (plain > 0).any(axis=2)
    both = draw_scene(scene, pose, 300, 200, replace(layers, layers=("centres", "octree")), {})[0]
    same = np.abs(both - plain)[seen].max(axis=1) < 1 / 255
    assert same.mean() > 0.5
    alone = OctreeChoice(3)
    assert alone.among(["octree", "boxes"]).filled
    assert not any(alone.among(["octree", other]).filled for other in ("splats", "pruned"))


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0.3, 1, 0.2), (-1, -1, -1)])
def test_faces_are_anticlockwise_from_outside(direction):
    """Otherwise the window would draw the insides of cubes."""
    cubes = Cubes(np.zeros((1, 3), np.float32), np.full(1, 2, np.float32), np.ones((1, 3)))
    corners = cubes.faces()[0][:, 0]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    np.testing.assert_allclose(across / 4, middles, atol=1e-6)
    assert (
        sorted(map(tuple, np.rint(middles).tolist()))
        == sorted(tuple(sign * row) for row in np.eye(3).tolist() for sign in (1, -1) if True)
        or len(np.unique(middles, axis=0)) == 6
    )
    canvas = Image.new("RGB", (40, 40))
    way = np.array(direction, float)
    draw_cubes(canvas, cubes, look_at(9 * way / np.linalg.norm(way), np.zeros(3)))
    assert len(np.unique(np.asarray(canvas).reshape(-1, 3), axis=0)) == 1 + np.count_nonzero(way)


def test_a_camera_inside_a_cell_sees_those_around(files):
    scene = open_scene(files / "a.ply")
    inside = Pose(np.eye(3), scene.positions[0].astype(float))
    shown = Shown(("octree",), scenes=(scene,), octree=OctreeChoice(5))
    image, legends = draw_scene(scene, inside, 60, 40, shown, {})
    assert np.isfinite(image).all()
    assert legends[0].title.startswith("Gaussians in a cell")


# The window's layer


class Pane:
    """Replaces a pane of the window."""

    def __init__(self, scene: Opened) -> None:
        self.scene, self.shown = scene, []

    def show_cells(self, cells: Cubes | Points | None) -> None:
        self.shown.append(cells)


@pytest.fixture
def slid(files):
    """A layer, its worker (which runs nothing by itself), and a pane."""
    worker, pane = Mock(), Pane(open_scene(files / "a.ply"))
    layer = OctreeLayer(worker, Mock(), Mock())
    layer.put([pane], 12_000, 250_000)
    return layer, worker.submit, pane


def finish(submit: Mock) -> None:
    """Run the last submitted job."""
    _, job, done, _ = submit.call_args.args
    done(job(lambda: False))


def test_cells_follow_a_moving_slider_and_end_at_its_last_value(slid):
    layer, submit, pane = slid
    for depth in (3, 4, 5, 6):
        layer.show(OctreeChoice(depth))
    assert submit.call_count == 1
    finish(submit)  # depth 3: shown although the slider has moved on
    assert len(pane.shown) == 1
    assert submit.call_count == 2
    finish(submit)
    assert submit.call_count == 2
    assert [len(each.middles) for each in pane.shown] == [
        len(Octree([pane.scene]).cells(pane.scene, OctreeChoice(depth)).middles) for depth in (3, 6)
    ]
    layer.show(OctreeChoice(6))
    assert submit.call_count == 2  # nothing changes


def test_cells_ready_after_the_layer_is_off_are_not_shown(slid):
    layer, submit, pane = slid
    layer.show(OctreeChoice(3))
    layer.show(None)
    finish(submit)
    assert pane.shown == []
    assert layer.legend is None
    layer.show(OctreeChoice(3))
    finish(submit)
    assert layer.legend is not None
    layer.show(None)
    assert pane.shown[-1] is None
    assert layer.legend is None


def test_a_failed_drawing_is_reported_and_does_not_stop_the_next(slid):
    layer, submit, pane = slid
    layer.show(OctreeChoice(3))
    submit.call_args.args[3](MemoryError("too many"))
    layer._failed.assert_called_once()
    layer.show(OctreeChoice(4))
    finish(submit)
    assert len(pane.shown) == 1
