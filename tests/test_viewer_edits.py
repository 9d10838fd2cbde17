"""Selecting and editing scenes in the viewer, without a window."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from scenes import assert_same_floats, random_scene
from windows import crossings

import gs_codec
from gs_codec.edit import Action
from gs_codec.files.conversion import convert_file
from gs_codec.formats.cloud import from_cloud, to_cloud
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from viewer.scenes import edits as editing
from viewer.scenes.appearance import Look
from viewer.scenes.edits import HOW, Edits
from viewer.scenes.opened import Opened, Pruned, open_scene, turned
from viewer.scenes.pose import look_at
from viewer.scenes.region import REGIONS, Region, in_polygon, in_region
from viewer.scenes.saving import save_scene
from viewer.scenes.selecting import around, by_rule, grown, in_range, inside_box, rules, shrunk
from viewer.window.watching import Watching


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    """A scene with comments and an extra property, which the viewer does not load."""
    path = tmp_path_factory.mktemp("edits") / "scene.ply"
    extra = {"label": np.arange(700, dtype="<i4") % 7}
    scene = random_scene(700, 2, seed=41)
    scene.positions[:, 300:330] += 40  # a separate cluster
    write_ply(path, replace(scene, extra=extra, comments=("trained",)))
    return path


@pytest.fixture
def scene(file) -> Opened:
    return open_scene(file)


# What is selected


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 40])
def test_a_polygon_follows_the_even_odd_rule(number):
    rng = np.random.default_rng(number)
    corners = [tuple(corner) for corner in rng.integers(0, 20, (number, 2)).tolist()]
    points = np.concatenate([rng.uniform(-2, 22, (500, 2)), rng.integers(0, 20, (200, 2))])
    expected = [crossings(x, y, corners) % 2 == 1 for x, y in points.tolist()]
    assert any(expected) == (number > 2)
    np.testing.assert_array_equal(in_polygon(points, corners), expected)


def test_a_region_selects_drawn_centres_in_front_of_the_camera(scene):
    size, focal = (640, 400), 0.866 * 400
    middle = np.median(scene.positions, axis=0)
    pose = look_at(scene.positions[0].astype(float) + 0.01, middle.astype(float))
    box = Region("box", (500, 320))
    box.extend((9, 400))
    box.extend((120, 60))
    expected, behind = [], 0
    for point in scene.positions.tolist():
        x, y, depth = pose.rotation @ (np.array(point) - pose.position)
        u, v = focal * x / depth + 320, focal * y / depth + 200
        inside = 120 <= u < 500 and 60 <= v < 320
        behind += inside and depth <= 0.2
        expected.append(inside and depth > 0.2)
    assert behind
    assert 20 < sum(expected) < 680
    np.testing.assert_array_equal(in_region(scene, pose, size, box), expected)
    drawn = np.arange(700) % 2 == 0
    found = in_region(scene, pose, size, box, Look(drawn=drawn))
    np.testing.assert_array_equal(found, expected & drawn)


def test_nan_centres_are_in_no_region():
    gaussians = random_scene(4, 0)
    gaussians.positions[:] = [[0, np.nan, np.inf, 0], [0, 0, 0, -np.inf], [1, 1, 1, 1]]
    pose, box = look_at(np.zeros(3), np.array([0.0, 0.0, 1.0])), Region("box", (0, 0))
    box.extend((9, 9))
    assert in_region(Opened("", to_cloud(gaussians)), pose, (9, 9), box).tolist() == [1, 0, 0, 0]
    assert not in_region(Opened("", to_cloud(random_scene(0, 0))), pose, (9, 9), box).size


def test_a_lasso_follows_the_mouse_and_a_click_draws_nothing():
    lasso = Region("lasso", (0, 0))
    for place in ((1, 1), (10, 0), (11, 1), (10, 10)):
        lasso.extend(place)
    assert lasso.corners == [(0, 0), (10, 0), (10, 10)]
    for kind in REGIONS:
        assert Region(kind, (5, 5)).corners == [(5, 5)]


def test_a_polygon_is_closed_by_a_click_at_its_first_corner():
    polygon = Region("polygon", (10, 10))
    for place in ((40, 10), (41, 11), (20, 60)):
        assert not polygon.closes((12, 11)) or len(polygon.path) > 2
        assert polygon.extend(place)
    assert polygon.corners == [(10, 10), (40, 10), (41, 11), (20, 60)]
    assert polygon.closes((12, 11))
    assert not polygon.closes((20, 10))


def test_a_brush_covers_everything_near_its_path():
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 100, (2000, 2))
    brush, expected = Region("brush", (20, 30), 7.5), np.zeros(2000, bool)
    path = [(20, 30), (60, 35), (60, 80), (58, 20)]
    for place in path[1:]:
        brush.extend(place)
    for start, end in zip(path[:-1], path[1:], strict=True):
        for share in np.linspace(0, 1, 400):
            at = (1 - share) * np.array(start) + share * np.array(end)
            expected |= np.linalg.norm(points - at, axis=1) <= 7.5
    found = brush.covers(points)
    assert 100 < found.sum() < 1500
    assert (found != expected).sum() < 5  # at the edge, by sampling
    dot = Region("brush", (50, 50), 10)
    np.testing.assert_array_equal(
        dot.covers(points), np.linalg.norm(points - (50, 50), axis=1) <= 10
    )


def walls() -> Opened:
    """Two walls of 20 x 20 opaque Gaussians, one behind the other, and a large one between."""
    scene = random_scene(801, 0, seed=5)
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=-1).reshape(-1, 2) - 9.5
    scene.positions[:2, :400] = scene.positions[:2, 400:800] = 0.1 * grid.T
    scene.positions[2, :400], scene.positions[2, 400:800] = 4, 6
    scene.positions[:, 800] = 0.0, 1.2, 4.5
    scene.log_scale[:] = np.log(0.06)
    scene.log_scale[:, 800] = np.log(0.3)
    scene.opacity[:] = 5
    scene.f_dc[:] = 0
    scene.f_dc[0, 400:800] = 1
    return Opened("walls", to_cloud(scene))


def test_regions_select_what_is_seen_and_by_footprints():
    scene, size = walls(), (200, 200)
    pose = look_at(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    box = Region("box", (75, 75))
    box.extend((125, 125))

    def found(**options: bool) -> set[int]:
        return set(np.flatnonzero(in_region(scene, pose, size, box, **options)).tolist())

    centres, front = found(), found(front=True)
    assert {k // 400 for k in centres} == {0, 1}
    assert front == {k for k in centres if k < 400}
    assert 800 not in centres  # below the box, by its centre
    wide = found(footprint=True)
    assert wide >= centres | {800}
    seen = found(footprint=True, front=True)
    assert len(front - seen) < 2  # seen only outside the box
    assert seen < set(range(400))
    hidden = np.arange(801) >= 400
    assert found(front=True, look=Look(drawn=hidden)) == centres - front


def test_spheres_colours_and_floods_around_a_gaussian():
    scene = walls()
    places, row = scene.positions.astype(float), 210
    away = np.linalg.norm(places - places[row], axis=1)
    assert (away <= 0.35).sum() > 20
    sphere, options = around(scene, "sphere", row, 0.35, 0)
    np.testing.assert_array_equal(sphere, away <= 0.35)
    assert [option.split("=")[0] for option in options] == ["--crop-sphere"]
    assert around(scene, "sphere", row, 0.35, 0, away <= 0.4)[1] == options
    part, options = around(scene, "sphere", row, 0.35, 0, away <= 0.3)
    np.testing.assert_array_equal(part, away <= 0.3)
    assert options == ()
    assert not around(scene, "sphere", row, 0, 0)[0][:row].any()
    blue, options = around(scene, "colour", row, 0, 10)
    assert options == ()
    assert np.flatnonzero(blue).tolist() == [*range(400), 800]
    flood, _ = around(scene, "flood", row, 0, 255)
    assert np.flatnonzero(flood).tolist() == [*range(400)]
    drawn = ~np.isin(np.arange(801) // 20, (3, 4)) & (np.arange(801) < 800)
    part, _ = around(scene, "flood", row, 0, 10, drawn)
    assert np.flatnonzero(part).tolist() == [*range(100, 400)]
    assert not around(scene, "flood", row, 0, 10, drawn & (np.arange(801) != row))[0].any()


def test_a_selection_grows_and_shrinks_by_neighbours():
    scene = walls()
    block = (np.arange(801) < 400) & (np.arange(801) % 20 < 10)
    more = grown(scene, block)
    assert (more & ~block)[:400].sum() >= 20  # at least the next column
    assert not more[400:800].any()
    assert (shrunk(scene, more) >= block).all()
    less = shrunk(scene, block)
    assert not less[9:400:20].any()
    assert (block & ~less)[:400].reshape(20, 20).any(axis=1).all()
    rows = np.arange(801) % 20 != 15
    left = Edits(scene)
    left.keep(rows, "test")
    assert not grown(left.scene, block[rows])[left.scene.rows % 20 > 15].any()


@pytest.mark.parametrize(
    ("name", "low", "high", "value"),
    [
        ("opacity", 0.3, 0.999, lambda g: 1 / (1 + np.exp(-g.opacity[0].astype(float)))),
        ("longest scale", 0.01, 0.05, lambda g: np.exp(g.log_scale.max(axis=0).astype(float))),
        ("z", -0.5, 1.0, lambda g: g.positions[2]),
        ("SH energy", 0.1, 0.2, lambda g: (g.f_rest.astype(float) ** 2).sum(axis=0)),
    ],
)
def test_a_range_of_a_quantity(scene, file, name, low, high, value):
    values = value(read_ply(file, "drop"))
    chosen = in_range(scene, name, low, high)
    assert 5 < chosen.sum() < 690
    np.testing.assert_array_equal(chosen, (values >= low) & (values <= high))


def test_a_range_includes_its_ends_and_no_nan():
    gaussians = random_scene(4, 0)
    gaussians.positions[0] = [1, 2, np.nan, 2.0000002]
    assert in_range(Opened("", to_cloud(gaussians)), "x", 1, 2).tolist() == [1, 1, 0, 0]


def test_unknown_quantities_are_refused(scene):
    with pytest.raises(gs_codec.GsCodecError, match=r"quantity 'size': scene\.ply has none"):
        in_range(scene, "size", 0, 1)


def test_rules_select_the_gaussians_statistics_count(file):
    """With a scene in which every share has some Gaussians."""
    some = read_ply(file, "drop")
    for k, (group, value) in enumerate(
        {"log_scale": 3.0, "f_dc": np.nan, "opacity": -9.0}.items(), 10
    ):
        getattr(some, group)[0, k] = value
    cloud = to_cloud(some.take(np.array([*range(700), 5, 6])))
    cloud.point.f_dc.numpy()[700] += 1
    shares = gs_codec.edit.statistics(cloud).shares
    names = rules(Pruned(("geometry",), np.zeros(702, np.uint8)))
    assert names[: len(shares)] == [share.name for share in shares]
    assert names[len(shares) :] == ["floaters", "outside the largest cluster", "pruned by geometry"]
    scene = Opened("", cloud)
    for share in shares:
        assert by_rule(scene, share.name).sum() == share.count > 0
    assert np.flatnonzero(by_rule(scene, "same centre")).tolist() == [700, 701]
    assert np.flatnonzero(by_rule(scene, "duplicate")).tolist() == [701]


# Undo and redo


def test_random_steps_match_plain_sets_and_are_undone(scene):
    """Random steps with undo and redo, against sets of file rows."""
    rng = np.random.default_rng(42)
    edits, everything = Edits(scene), frozenset(range(scene.count))
    states = [(frozenset(), frozenset(), everything)]
    now = 0
    for _ in range(300):
        selected, hidden, left = states[now]
        rows = np.array(sorted(left))
        what = rng.choice([*HOW, "all", "invert", "hide", "show", "delete", "undo", "redo"])
        chosen = rng.random(len(rows)) < 0.1
        picked = frozenset(rows[chosen].tolist()) - hidden
        after = {
            "replace": (picked, hidden, left),
            "add": (selected | picked, hidden, left),
            "remove": (selected - picked, hidden, left),
            "intersect": (selected & picked, hidden, left),
            "all": (left - hidden, hidden, left),
            "invert": (left - hidden - selected, hidden, left),
            "hide": (frozenset(), hidden | selected, left),
            "show": (selected, frozenset(), left),
            "delete": (frozenset(), hidden, left - selected),
        }.get(what)
        if what == "delete" and len(selected) > 0.2 * len(left):
            continue  # so that some remain at the end
        if what in HOW:
            edits.select(chosen, what)
        else:
            steps = {"all": edits.select_all, "show": edits.show_all}
            (steps.get(what) or getattr(edits, what))()
        if after is None:
            now = max(now - 1, 0) if what == "undo" else min(now + 1, len(states) - 1)
        elif after != states[now]:
            now += 1
            states[now:] = [after]
        assert state(edits) == states[now]
        assert edits.count == len(states[now][0])
        assert bool(edits.undone_next) == (now > 0)
        assert bool(edits.redone_next) == (now < len(states) - 1)
        assert edits.unsaved == (states[now][2] != everything)
    assert len(states[now][2]) < scene.count
    assert len(states) > 30


def state(edits: Edits) -> tuple[frozenset, frozenset, frozenset]:
    """The file rows that are selected, hidden, and remaining."""
    rows = edits.scene.rows
    hidden = frozenset() if edits.drawn is None else frozenset(rows[~edits.drawn].tolist())
    return frozenset(rows[edits.selected].tolist()), hidden, frozenset(rows.tolist())


def test_undoing_brings_the_old_objects_back(scene):
    edits = Edits(scene)
    edits.select(np.arange(scene.count) < 100)
    edits.delete()
    first = edits.scene
    assert first is not scene
    edits.undo()
    assert edits.scene is scene
    assert edits.selected.sum() == 100
    edits.redo()
    assert edits.scene is first


def test_remaining_gaussians_refer_to_rows_of_the_file(tmp_path):
    path = tmp_path / "a.egs"
    gs_codec.write(path, to_cloud(random_scene(3000, 1, 43)), gs_codec.Config(block_size=1024))
    whole, edits = open_scene(path), Edits(open_scene(path))
    left = np.arange(3000) % 3 != 1
    size = whole.info.block_size
    left[size : 2 * size] = False
    edits.keep(left, "test")
    scene = edits.scene
    np.testing.assert_array_equal(scene.rows, np.flatnonzero(left))
    assert_same_floats(from_cloud(scene.cloud), from_cloud(whole.cloud).take(left))
    np.testing.assert_array_equal(scene.bits, whole.bits[left])
    assert len(whole.blocks) == 3
    assert len(scene.blocks) == 2
    block = whole.positions[2 * size :][left[2 * size :]]
    np.testing.assert_allclose(scene.blocks[1], np.quantile(block, (0.02, 0.98), axis=0), rtol=1e-6)
    labels = (np.arange(3000) % 4).astype(np.uint8)
    pruned = Pruned(("geometry", "importance", "error"), labels)
    np.testing.assert_array_equal(by_rule(scene, "pruned by importance", pruned), labels[left] == 2)


def test_an_edited_scene_can_be_edited_further(scene):
    before, kept = Edits(scene), np.arange(scene.count) % 3 > 0
    before.keep(kept, "crop")
    edits = Edits(before.scene)
    assert edits.scene is before.scene
    assert edits.unsaved
    edits.keep(np.arange(edits.scene.count) % 2 > 0, "crop")
    edits.select_all()
    rows = np.flatnonzero(kept)[1::2]
    np.testing.assert_array_equal(edits.scene.rows, rows)
    assert edits.count == edits.scene.count == len(rows)
    edits.undo()
    edits.undo()
    edits.undo()
    assert edits.scene is before.scene


def test_the_drawn_mask_is_the_same_array_until_it_changes(scene):
    edits = Edits(scene)
    edits.select(np.arange(scene.count) < 100)
    edits.hide()
    drawn = edits.drawn
    assert np.flatnonzero(~drawn).tolist() == list(range(100))
    edits.select(np.arange(scene.count) < 200)
    assert edits.drawn is drawn
    edits.delete()
    assert (len(edits.drawn), (~edits.drawn).sum()) == (600, 100)


def test_the_number_of_undo_steps_is_limited(scene, monkeypatch):
    monkeypatch.setattr(editing, "_STEPS", 3)
    edits = Edits(scene)
    for k in range(5):
        edits.select(np.arange(scene.count) == k)
    for _ in range(5):
        edits.undo()
    assert edits.undone_next == ""
    assert np.flatnonzero(edits.selected).tolist() == [1]


def test_steps_that_change_nothing_are_none(scene):
    edits = Edits(scene)
    edits.select_none()
    edits.show_all()
    edits.delete()
    assert (edits.undone_next, edits.scene) == ("", scene)


def test_a_scene_is_never_deleted_completely(scene):
    edits = Edits(scene)
    edits.select_all()
    with pytest.raises(gs_codec.GsCodecError, match="delete: no Gaussian would be left"):
        edits.delete()
    assert edits.scene is scene


# What is saved


def saved_edits(scene: Opened, kept: np.ndarray, target: Path) -> bytes:
    """The bytes saved after deleting all but some Gaussians in two steps."""
    edits = Edits(scene)
    edits.select(~kept & (np.arange(scene.count) % 2 == 0))
    edits.delete()
    edits.select(~kept[edits.scene.rows])
    edits.delete()
    save_scene(edits.scene, target)
    return target.read_bytes()


def kept_by(action: Action, scene: Opened) -> np.ndarray:
    """The Gaussians that an action keeps, as determined by the window."""
    if action.name == "crop-box":
        return inside_box(scene, action.arguments[:3], action.arguments[3:])
    if action.name == "remove-floaters":
        return ~by_rule(scene, "floaters")
    if action.name == "keep-largest-cluster":
        return ~by_rule(scene, "outside the largest cluster")
    name, _, number = action.arguments
    return in_range(scene, name, number, np.inf)


ACTIONS = (
    Action("crop-box", "-0.5,-1,-1,1,1.5,0.8"),
    Action("filter", "opacity>=0.05"),
    Action("remove-floaters"),
    Action("keep-largest-cluster"),
)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("suffix", [".ply", ".egs", ".spz", ".csv"])
@pytest.mark.parametrize("action", ACTIONS, ids=str)
def test_saved_scenes_equal_converts(file, scene, action, suffix, tmp_path):
    done = convert_file(file, tmp_path / f"b{suffix}", actions=[action])
    assert 0 < done.count < scene.count
    data = saved_edits(scene, kept_by(action, scene), tmp_path / f"a{suffix}")
    assert data == (tmp_path / f"b{suffix}").read_bytes()


@pytest.mark.parametrize("source", ["said.ply", "fixed.spz", "coded.egs"])
def test_scenes_of_other_systems_are_saved_like_convert(file, source, tmp_path):
    source = tmp_path / source
    if source.name == "said.ply":
        write_ply(source, turn_axes(read_ply(file, "keep"), "RUB"))
    else:
        convert_file(file, source)
    action = ACTIONS[0]
    convert_file(source, tmp_path / "b.ply", actions=[action])
    scene = open_scene(source)
    data = saved_edits(scene, kept_by(action, scene), tmp_path / "a.ply")
    assert data == (tmp_path / "b.ply").read_bytes()


def test_a_converted_scene_is_saved_converted(file, tmp_path):
    convert_file(file, tmp_path / "b.ply", coordinates="RUB:RDF", actions=ACTIONS[:1])
    scene = turned(open_scene(file))
    data = saved_edits(scene, kept_by(ACTIONS[0], scene), tmp_path / "a.ply")
    assert data == (tmp_path / "b.ply").read_bytes()
    again = turned(scene)
    convert_file(file, tmp_path / "d.ply", actions=ACTIONS[:1])
    data = saved_edits(again, kept_by(ACTIONS[0], again), tmp_path / "c.ply")
    assert data == (tmp_path / "d.ply").read_bytes()


def test_edits_are_kept_when_a_scene_is_converted(scene):
    edits = Edits(scene)
    edits.select(np.arange(scene.count) < 100)
    edits.delete()
    edits.select(np.arange(edits.scene.count) < 7)
    expected = turned(scene)
    edits.turn(expected)
    np.testing.assert_array_equal(edits.scene.positions, expected.positions[100:])
    assert edits.scene.title == "scene.ply, edited, converted from RUB"
    assert edits.count == 7
    edits.undo()
    edits.undo()
    np.testing.assert_array_equal(edits.scene.positions, expected.positions)


def test_a_cloud_is_saved_too(file, tmp_path):
    cloud = gs_codec.read(file, "keep")
    kept = np.arange(700) % 5 != 0
    saved_edits(Opened("cloud", cloud), kept, tmp_path / "a.ply")
    assert_same_floats(read_ply(tmp_path / "a.ply", "drop"), from_cloud(cloud, "drop").take(kept))


def test_saving_reports_output_and_losses(scene, tmp_path):
    edits = Edits(scene)
    edits.keep(np.arange(scene.count) < 50, "test")
    assert edits.unsaved
    said = save_scene(edits.scene, tmp_path / "a.splat")
    assert said[0] == "a.splat saved: 50 Gaussians, 1.60 kB"
    assert said[1] == "opacity, colour and rotation rounded to 8 bits"
    edits.mark_saved(edits.scene)
    assert not edits.unsaved
    edits.undo()
    assert edits.unsaved


def test_a_file_that_has_changed_is_not_saved(file, tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes(file.read_bytes())
    scene = open_scene(path)
    os.utime(path, ns=(0, 0))
    with pytest.raises(gs_codec.GsCodecError, match=r"a\.ply: changed after it was opened"):
        save_scene(scene, tmp_path / "b.ply")
    assert not (tmp_path / "b.ply").exists()


@pytest.mark.parametrize("name", ["meta.json", "lod-meta.json", "tileset.json"])
def test_a_change_of_any_file_of_a_scene_is_noticed(file, tmp_path, name):
    gs_codec.convert_file(file, tmp_path / name)
    scene = open_scene(tmp_path / name)
    others = [path for path in scene.files if path.name != name]
    assert {*others} == {path for path in tmp_path.rglob("*") if path.is_file()} - {scene.path}
    loading = SimpleNamespace(reload=Mock())
    shown = SimpleNamespace(scenes=[scene])
    worker, request = SimpleNamespace(busy=False), SimpleNamespace(watch=True)
    viewer = SimpleNamespace(worker=worker, request=request, stage=shown)
    watching = Watching(viewer, loading, SimpleNamespace(unsaved=[]))
    for path in others:
        before = path.stat()
        os.utime(path, ns=(0, 0))
        with pytest.raises(gs_codec.GsCodecError, match=f"{name}: changed after it was opened"):
            scene.check_unchanged()
        loading.reload.reset_mock()
        for _ in range(3):
            watching._looked = -np.inf
            watching.tick()
        loading.reload.assert_called_once_with(0, scene.path)
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        watching._looked = -np.inf
        watching.tick()
    scene.check_unchanged()


def test_unwritable_outputs_are_reported(scene, file, tmp_path):
    with pytest.raises(gs_codec.GsCodecError, match="input and output are the same file"):
        save_scene(scene, file)
    with pytest.raises(gs_codec.GsCodecError, match=r"suffix '\.xyz', expected"):
        save_scene(scene, tmp_path / "a.xyz")
