"""Placing, joining and projects in the viewer, without a window."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import assert_same_floats, random_scene

import gs_codec
from gs_codec.formats.cloud import from_cloud, to_cloud
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import ANTIALIASED
from viewer.pictures.screenshot import shown_of
from viewer.scenes.edits import Edits
from viewer.scenes.gizmo import _RING, Gizmo, about
from viewer.scenes.opened import Opened, joined, open_scene, turned
from viewer.scenes.pose import look_at
from viewer.scenes.saving import command_of, open_file, save_project, save_scene
from viewer.scenes.selecting import (
    around,
    by_rule,
    in_range,
    inside_box,
    range_options,
    rule_options,
)
from viewer.scenes.view_request import Request


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Two scenes in the working directory."""
    scene = random_scene(300, 2, seed=51)
    scene.positions[:, 250:270] += 40  # a separate cluster
    write_ply(tmp_path / "a.ply", scene)
    write_ply(tmp_path / "b.ply", random_scene(200, 1, seed=52))
    monkeypatch.chdir(tmp_path)
    return tmp_path


TURN = about(np.array([1.0, 2.0, 3.0]), (4, 5, 6), (10, 20, 30), 1.5)
SHIFT = about(np.zeros(3), (0.5, 0, -1))


def run(line: str, run_codec) -> Path:
    """Run a command line; return its output."""
    words = shlex.split(line)
    assert words[:2] == ["gs-codec", "convert"]
    assert run_codec(*words[1:], "--overwrite")[0] == 0
    return Path(next(word for word in words if "-edited" in word))


def test_a_matrix_scales_and_turns_about_a_centre_and_shifts():
    np.testing.assert_allclose(TURN @ [1, 2, 3, 1], [5, 7, 9, 1])
    cloud = to_cloud(random_scene(50, 2, seed=1))
    edit = gs_codec.edit
    expected = edit.translate(cloud, (-1, -2, -3))
    expected = edit.translate(edit.scale(edit.rotate(expected, (10, 20, 30)), 1.5), (5, 7, 9))
    moved = edit.transform(cloud, TURN)
    for name in ("positions", "log_scale", "f_rest"):
        found = moved.point[name].numpy()
        np.testing.assert_allclose(found, expected.point[name].numpy(), atol=2e-5)


def test_all_is_moved_and_moved_back_exactly(folder, run_codec):
    scene = open_scene("a.ply")
    edits = Edits(scene)
    edits.move(SHIFT)
    np.testing.assert_allclose(edits.scene.positions, scene.positions + SHIFT[:3, 3], atol=1e-6)
    assert edits.unsaved
    assert not edits.scene.is_stored
    assert edits.scene.title == "a.ply, edited"
    edits.move(TURN)
    once = edits.scene
    assert len(once.moves) == 1  # so that it is rounded once
    expected = gs_codec.edit.transform(scene.cloud, TURN @ SHIFT)
    assert_same_floats(from_cloud(once.cloud), from_cloud(expected))
    save_scene(once, folder / "saved.ply")
    target = run(command_of(edits, Path()), run_codec)
    assert target.read_bytes() == (folder / "saved.ply").read_bytes()
    edits.undo()
    edits.undo()
    assert edits.scene is scene
    edits.redo()
    edits.redo()
    assert_same_floats(from_cloud(edits.scene.cloud), from_cloud(once.cloud))


def test_a_selection_is_moved_alone_and_saved_by_a_project(folder, run_codec):
    scene, edits = open_scene("a.ply"), Edits(open_scene("a.ply"))
    some = np.arange(300) % 3 == 0
    edits.select(some)
    np.testing.assert_allclose(edits.middle, np.median(scene.positions[some], axis=0))
    edits.move(TURN)
    assert edits.options is None
    np.testing.assert_array_equal(edits.scene.positions[~some], scene.positions[~some])
    edits.delete()
    edits.select(np.arange(200) < 50)
    edits.hide()
    save_project(edits, folder / "p.gsproj")
    target = run(command_of(edits, folder / "p.gsproj"), run_codec)
    save_scene(edits.scene, folder / "saved.ply")
    assert target.read_bytes() == (folder / "saved.ply").read_bytes()
    again = Edits(open_file("p.gsproj"))
    assert_same_floats(from_cloud(again.scene.cloud), from_cloud(edits.scene.cloud))
    np.testing.assert_array_equal(again.drawn, edits.drawn)
    assert again.project.moves[0].matrix.tolist() == TURN.tolist()


def test_pictures_of_a_project_lack_what_is_hidden(folder):
    edits = Edits(open_scene("a.ply"))
    edits.select(np.arange(300) < 200)
    edits.hide()
    save_project(edits, folder / "p.gsproj")
    request = Request("p.gsproj")
    scenes = request.scenes()
    shown = shown_of(request, scenes)
    np.testing.assert_array_equal(shown.look(scenes[0]).drawn, edits.drawn)


def test_watching_what_cannot_be_reloaded_is_refused(folder):
    save_project(Edits(open_scene("a.ply")), folder / "p.gsproj")
    for source in ("p.gsproj", gs_codec.read("a.ply")):
        with pytest.raises(gs_codec.GsCodecError, match="no effect on clouds and projects"):
            Request(source, watch=True).scenes()
        assert len(Request(source, "a.ply", watch=True).scenes()) == 2


def test_shears_are_refused_and_change_nothing(folder):
    edits = Edits(open_scene("a.ply"))
    with pytest.raises(gs_codec.GsCodecError, match="stretches or shears"):
        edits.move(np.diag([1.0, 2.0, 1.0, 1.0]))
    assert edits.undone_next == ""
    assert edits.scene.moves == ()


def test_scenes_are_joined_placed_hidden_named_and_removed(folder, run_codec):
    edits, other = Edits(open_scene("a.ply")), open_scene("b.ply")
    edits.select(np.arange(300) < 100)
    edits.delete()
    edits.add(other)
    assert [(n, name, count, hidden) for n, name, count, hidden in edits.parts] == [
        (0, "a.ply", 200, False), (1, "b.ply", 200, False),
    ]  # fmt: skip
    edits.select(edits.part(1))
    edits.move(SHIFT)
    moved = edits.scene.positions[200:]
    np.testing.assert_allclose(moved, other.positions + SHIFT[:3, 3], atol=1e-6)
    edits.rename(1, "chair")
    edits.hide_part(0)
    assert (~edits.drawn).sum() == 200
    assert edits.parts[0][3]
    save_project(edits, folder / "in.gsproj")
    text = (folder / "in.gsproj").read_text()
    assert '"path": "b.ply"' in text
    again = Edits(open_file(folder / "in.gsproj"))
    assert again.parts == edits.parts
    assert_same_floats(from_cloud(again.scene.cloud), from_cloud(edits.scene.cloud))
    target = run(command_of(edits, folder / "in.gsproj"), run_codec)
    save_scene(edits.scene, folder / "saved.ply")
    assert target.read_bytes() == (folder / "saved.ply").read_bytes()
    edits.raise_part(1)
    assert [part[1] for part in edits.parts] == ["chair", "a.ply"]
    save_project(edits, folder / "in.gsproj")
    save_scene(edits.scene, folder / "saved.ply", project=edits.project)
    target = run(command_of(edits, folder / "in.gsproj"), run_codec)
    assert target.read_bytes() == (folder / "saved.ply").read_bytes()
    again = Edits(open_file(folder / "in.gsproj"))
    assert [part[1:] for part in again.parts] == [part[1:] for part in edits.parts]
    found, rows = from_cloud(again.scene.cloud), np.r_[200:400, :200]
    assert_same_floats(found, from_cloud(edits.scene.cloud).take(rows))
    assert not again.unsaved
    edits.undo()
    assert [part[1] for part in edits.parts] == ["a.ply", "chair"]
    edits.hide_part(0)
    assert edits.drawn is None
    edits.keep(~edits.part(0), "remove")
    assert [part[1] for part in edits.parts] == ["chair"]
    while edits.undone_next != "delete":
        edits.undo()
    assert [part[:2] for part in edits.parts] == [(0, "a.ply")]
    assert edits.scene.count == 200
    edits.undo()
    assert edits.scene.count == 300
    while edits.redone_next:
        edits.redo()
    assert edits.parts == [(1, "chair", 200, False)]


def test_joined_scenes_are_antialiased_if_the_first_is(folder):
    for name in ("a.ply", "b.ply"):
        write_ply(folder / name, replace(read_ply(name), comments=(ANTIALIASED,)))
    assert joined([open_scene("a.ply"), open_scene("b.ply")]).gaussians.antialiased


def test_a_scene_added_while_another_is_saved_is_unsaved(folder):
    edits = Edits(open_scene("a.ply"))
    saved = edits.scene
    edits.add(open_scene("b.ply"))
    edits.mark_saved(saved)
    assert edits.unsaved
    edits.mark_saved(edits.scene)
    assert not edits.unsaved


def test_joined_scenes_equal_merged_ones(folder, run_codec):
    edits = Edits(open_scene("a.ply"))
    edits.add(open_scene("b.ply"))
    assert edits.options == ()
    assert edits.scene.name == "a.ply + b.ply"
    assert not edits.scene.is_stored
    target = run(command_of(edits, Path()), run_codec)
    assert_same_floats(read_ply(target, "drop"), from_cloud(edits.scene.cloud, "drop"))


def test_without_an_added_scene_the_command_does_not_add_it(folder, run_codec):
    edits = Edits(open_scene("a.ply"))
    edits.add(open_scene("b.ply"))
    edits.undo()
    save_project(edits, folder / "p.gsproj")
    target = run(command_of(edits, folder / "p.gsproj"), run_codec)
    assert_same_floats(read_ply(target, "drop"), from_cloud(edits.scene.cloud, "drop"))


def test_steps_before_axes_are_reversed_are_no_options(folder):
    edits = Edits(open_scene("a.ply"))
    edits.keep(edits.scene.positions[:, 1] > 0, "crop", ("--filter=y>0",))
    edits.turn(turned(edits.whole))
    assert edits.options is None
    with pytest.raises(gs_codec.GsCodecError, match="axes were reversed; save the scene"):
        save_project(edits, folder / "p.gsproj")
    edits.undo()
    assert edits.options == ()
    edits.redo()
    assert edits.options is None


@pytest.mark.parametrize("step", ["range", "ends", "box", "cluster", "sphere"])
def test_steps_are_written_as_options(folder, run_codec, step):
    edits = Edits(open_scene("a.ply"))
    scene = edits.scene
    if step in ("range", "ends"):
        low, high = (0.3, np.inf) if step == "range" else (-0.5, 0.4)
        name = "opacity" if step == "range" else "x"
        edits.select(in_range(scene, name, low, high), means=range_options(name, low, high))
        if step == "ends":
            edits.invert()
        edits.delete()
    elif step == "box":
        corners = [-1.0, -1, -1, 0.7, 1, 1]
        option = f"--crop-box={','.join(map(str, corners))}"
        edits.keep(inside_box(scene, corners[:3], corners[3:]), "crop", (option,))
    elif step == "cluster":
        rule = "outside the largest cluster"
        edits.select(by_rule(scene, rule), means=(rule_options(rule), ()))
        edits.move(SHIFT)
        edits.undo()
        edits.delete()
    else:
        centres = scene.positions.astype(float)
        reach = np.sort(np.linalg.norm(centres - centres[7], axis=1))[99]  # one is on the surface
        chosen, kept = around(scene, "sphere", 7, float(reach), 0)
        assert chosen.sum() == 100
        edits.select(chosen, means=((), kept))
        edits.invert()
        edits.delete()
    assert edits.options
    assert edits.scene.count < 300
    save_scene(edits.scene, folder / "saved.ply")
    line = command_of(edits, Path())
    assert "--edits" not in line
    assert run(line, run_codec).read_bytes() == (folder / "saved.ply").read_bytes()
    edits.select(np.arange(edits.scene.count) < 5)
    edits.delete()
    assert edits.options is None
    edits.undo()
    edits.undo()
    assert edits.options


def test_clouds_have_no_command(folder):
    edits = Edits(Opened("cloud", to_cloud(random_scene(9, 0))))
    with pytest.raises(gs_codec.GsCodecError, match="a cloud or a frame"):
        command_of(edits, Path())


def test_a_project_in_a_folder_that_is_a_link_finds_its_scenes(folder):
    (folder / "deep" / "real").mkdir(parents=True)
    (folder / "link").symlink_to(folder / "deep" / "real")
    save_project(Edits(open_scene("a.ply")), folder / "link" / "p.gsproj")
    for place in ("link", "deep/real"):
        assert open_file(f"{place}/p.gsproj").count == 300


def test_a_project_of_changed_scenes_is_refused(folder):
    save_project(Edits(open_scene("a.ply")), folder / "p.gsproj")
    write_ply(folder / "a.ply", random_scene(299, 2, seed=51))
    with pytest.raises(gs_codec.GsCodecError, match=r"a\.ply: 299 Gaussians, expected 300"):
        open_file("p.gsproj")
    write_ply(folder / "a.ply", random_scene(300, 2, seed=51))
    said = r"a\.ply: has changed since the project was saved"
    with pytest.raises(gs_codec.GsCodecError, match=said):
        open_file("p.gsproj")
    text = (folder / "p.gsproj").read_text()
    (folder / "p.gsproj").write_text(re.sub(r',\s*"centres": \d+', "", text))  # as older ones
    assert open_file("p.gsproj").count == 300
    (folder / "q.gsproj").write_text("{}")
    with pytest.raises(gs_codec.GsCodecError, match=r"q\.gsproj: not a project of gs-viewer"):
        open_file("q.gsproj")


# Handles

#: Of the corner of a ring where a drag begins.
ANGLE = 2 * np.pi * 5 / 64


@pytest.mark.parametrize("kind", ["shift", "move", "turn", "scale"])
def test_a_drag_of_a_handle_follows_the_mouse(kind):
    centre, size = np.array([0.3, -0.2, 1.0]), (640, 400)
    pose = look_at(np.array([3.0, -2.0, -4.0]), np.array([0.0, 0.0, 1.0]))
    gizmo = Gizmo(centre, pose, size)
    for handle in (each for each in gizmo.handles if each.kind == kind):
        at = 5 if len(handle.line) > 2 else 1
        start, end = handle.line[at], handle.line[at] + (9, 4)
        found = gizmo.at(tuple(start))
        assert found.kind == kind or np.abs(found.line - start).min() < 8
        matrix = gizmo.dragged(handle, tuple(start), tuple(end))
        nothing = gizmo.dragged(handle, tuple(start), tuple(start))
        np.testing.assert_allclose(nothing, np.eye(4), atol=1e-12)
        scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
        assert scale == pytest.approx(1) or kind == "scale"
        pixel = pose.project((matrix @ [*centre, 1])[None, :3], *size)[0][0]
        if kind == "shift":
            np.testing.assert_allclose(pixel - gizmo.middle, (9, 4), atol=0.5)
        elif kind == "move":
            along = handle.line[1] - handle.line[0]
            along /= np.linalg.norm(along)
            moved = np.linalg.norm(pixel - gizmo.middle)
            assert moved == pytest.approx(abs(along @ (9, 4)), rel=0.3, abs=0.5)
            others = np.delete(matrix[:3, 3], handle.axis)
            np.testing.assert_allclose(others, 0, atol=1e-12)
        else:
            np.testing.assert_allclose(pixel, gizmo.middle, atol=1e-6)
        if kind == "turn":
            np.testing.assert_allclose(matrix[:3, handle.axis], np.eye(3)[handle.axis])
            ring = (_RING * gizmo._unit) * np.insert([np.cos(ANGLE), np.sin(ANGLE)], handle.axis, 0)
            after = pose.project((matrix @ [*(centre + ring), 1])[None, :3], *size)[0][0]
            tangent = handle.line[at + 1] - handle.line[at - 1]
            tangent /= np.linalg.norm(tangent)
            assert (after - start) @ tangent == pytest.approx(tangent @ (9, 4), rel=0.3, abs=1)


def test_no_handle_is_behind_the_camera_or_far_from_the_mouse():
    pose = look_at(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert not Gizmo(np.array([0.0, 0.0, -1.0]), pose, (64, 64)).handles
    assert Gizmo(np.array([0.0, 0.0, -1.0]), pose, (64, 64)).at((3, 3)) is None
    assert Gizmo(np.array([0.0, 0.0, 1.0]), pose, (640, 400)).at((3, 3)) is None
