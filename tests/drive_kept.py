"""Drive the viewer's window while jobs run, or fail; print what is kept.

Run by test_viewer_kept.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from drive_edit import answer
from drive_viewer import Driver, tell
from open3d.visualization import gui
from PIL import Image

import gs_codec
from gs_codec.files.annotations import Annotation
from viewer.scenes.choice import MODES, Appearance
from viewer.scenes.edits import Edits
from viewer.scenes.opened import open_scene
from viewer.scenes.saving import save_project
from viewer.scenes.trial_list import Trials
from viewer.scenes.typed_paths import PICTURES
from viewer.scenes.worker import Stale, Worker
from viewer.window.file_dialog import FileDialog, FileQuestion


def held(worker: Worker) -> threading.Event:
    """Keep a thread busy until the event is set."""
    started, go_on = threading.Event(), threading.Event()

    def wait(stale: Stale) -> None:
        started.set()
        go_on.wait(60)

    worker.submit("held", wait, print, print)
    started.wait(60)
    return go_on


def saves(driver: Driver) -> list[bool]:
    """Whether files exist that were saved one after the other, while threads were busy."""
    viewer, paths = (
        driver.viewer,
        [driver.folder / name for name in ("1.ply", "2.ply", "1.png", "2.png")],
    )
    events = [held(viewer.worker), held(viewer.editor.worker)]
    for path in paths:
        (viewer.editor.save if path.suffix == ".ply" else viewer.save)(str(path))
    for event in events:
        event.set()
    driver.rest()
    return [path.exists() for path in paths]


def brush(driver: Driver) -> list:
    """Numbers of Gaussians and of selected ones after Delete and Esc in strokes of the brush.

    The last is whether Esc brings the panes back.
    """
    viewer, found = driver.viewer, []
    viewer.editor.set_tool("brush")
    frame = viewer.stage.panes[0].widget.frame
    x, y = frame.x + frame.width // 2, frame.y + frame.height // 2
    for key in ("", "Delete", "Escape"):
        driver.move(frame.x + 5, frame.y + 5)
        before = driver.scenes(driver.rest())
        y += 60 * (key == "Escape")  # where none are deleted
        driver.move(x, y)
        driver.xdotool("mousedown", 1)
        driver.move(x + 10, y)
        if key:
            driver.key(key)
        driver.move(x + 20, y + 5)
        driver.xdotool("mouseup", 1)
        driver.move(frame.x + 5, frame.y + 5)
        after = driver.scenes(driver.rest())
        found.append([viewer.stage.scenes[0].count, viewer.editor.edits.count])
    viewer.editor.set_tool("brush")
    viewer.editor.do(Edits.undo)
    viewer.editor.do(Edits.undo)
    return [*found, bool(np.array_equal(before, after))]


def buttons(driver: Driver) -> list:
    """Numbers selected by a drag, without and with another button, and whether the pose stays."""
    viewer, pose, found = driver.viewer, driver.viewer.stage.pose, []
    frame = viewer.stage.panes[0].widget.frame
    corners = [frame.x + k * frame.width // 8 for k in (1, 3, 5, 7)]
    viewer.editor.set_tool("box")
    for other in (False, True):
        driver.move(corners[0], frame.y + 20)
        driver.xdotool("mousedown", 1)
        driver.move(corners[1], frame.y + frame.height // 3)
        if other:
            driver.xdotool("mousedown", 3)
            driver.move(corners[2], frame.y + frame.height // 2)
            driver.xdotool("mouseup", 3)
        driver.move(corners[3], frame.get_bottom() - 20)
        driver.xdotool("mouseup", 1)
        driver.rest()
        found.append(viewer.editor.edits.count)
        viewer.editor.do(Edits.select_none)
    viewer.editor.set_tool("box")
    return [*found, viewer.stage.pose is pose]


def fails(driver: Driver) -> list:
    """What is said about photographs of cameras that failed, and whether scenes can be edited."""
    viewer, request = driver.viewer, driver.viewer.request
    bad = driver.folder / "bad.json"
    bad.write_text("{")
    viewer.request = replace(request, cameras=str(bad))
    viewer.loading.begin()
    driver.wait(lambda: viewer.message is not None)
    viewer.dismiss()
    viewer.message = None
    viewer.loading.open_photographs(str(driver.folder / "images"))
    found = [viewer.message[1]]
    viewer.dismiss()
    viewer.request = request
    driver.rest()
    return [*found, [edits.scene for edits in viewer.editor.all] == viewer.stage.scenes]


def transparent(driver: Driver) -> list[list[int]]:
    """Colours of a photograph on the background of the scenes, and on one chosen later."""
    viewer, found = driver.viewer, []
    folder = driver.folder / "clear"
    folder.mkdir()
    Image.new("RGBA", (200, 150), (255, 0, 0, 51)).save(folder / "view0.png")
    viewer.loading.open_photographs(str(folder))
    for background in ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        viewer.set_appearance(Appearance(background=background))
        image, frame = driver.rest(), viewer.visits.photograph.frame
        found.append(image[frame.y + frame.height // 2, frame.x + frame.width // 2].tolist())
    viewer.set_appearance(Appearance())
    viewer.request = replace(viewer.request, images=None)
    viewer.visits.reset()
    driver.rest()
    return found


def several(driver: Driver) -> list:
    """What is said about a scene, cameras and a reload while a scene is loaded, and its name."""
    viewer, found = driver.viewer, []
    event = held(viewer.worker)
    viewer.loading.open(str(driver.folder / "b.egs"), 0)
    for load in (
        lambda: viewer.loading.open(str(driver.folder / "a.ply"), 1),
        lambda: viewer.loading.open_cameras(str(driver.folder / "cameras.json")),
        viewer.loading.reload_all,
    ):
        load()
        found.append(viewer.message[1])
        viewer.dismiss()
    found.append(viewer.panel.doing)
    event.set()
    driver.rest()
    found.append([scene.name for scene in viewer.stage.scenes])
    viewer.loading.open(str(driver.folder / "a.ply"), 0)
    driver.rest()
    return found


def added(driver: Driver) -> list:
    """Names of the scenes after A was extended while B was chosen; then, after A was replaced."""
    viewer, stage, found = driver.viewer, driver.viewer.stage, []
    for replaces in (False, True):
        viewer.editor.set_number(0)
        event = held(viewer.worker)
        viewer.placing.add(str(driver.folder / "a.ply"))
        viewer.editor.set_number(1)
        if replaces:
            scenes = [open_scene(driver.folder / "a.ply"), stage.scenes[1]]
            viewer.loading.show(scenes, viewer.visits.views, None)
        event.set()
        driver.rest()
        found += [[each.name for each in stage.scenes], " ".join(viewer.panel.status.text.split())]
        for edits in viewer.editor.all:
            edits.mark_saved(edits.scene)
    return found


def reload(driver: Driver) -> list:
    """What the panel says after a scene was edited while its file was read again."""
    viewer = driver.viewer
    event = held(viewer.worker)
    viewer.loading.reload(0, driver.folder / "a.ply")
    viewer.editor.number = 0
    viewer.editor.do(lambda edits: edits.keep(np.arange(edits.scene.count) > 9, "delete"))
    event.set()
    driver.rest()
    found = [" ".join(viewer.panel.status.text.split()), viewer.panel.doing]
    viewer.editor.do(Edits.undo)
    return found


def reload_turned(driver: Driver) -> list[str]:
    """The coordinate systems of B, converted from another one, before and after a reload."""
    viewer, found = driver.viewer, []
    viewer.loading.turn()
    driver.rest()
    found.append(viewer.stage.scenes[1].system)
    viewer.loading.reload(1, driver.folder / "b.egs")
    driver.rest()
    found.append(viewer.stage.scenes[1].system)
    viewer.loading.turn()
    driver.rest()
    return [*found, viewer.stage.scenes[1].system]


def reload_project(driver: Driver) -> list[int]:
    """Numbers of Gaussians of a project, and after a key that reloads files that have changed."""
    viewer, project = driver.viewer, driver.folder / "in.gsproj"
    shutil.copy(driver.folder / "a.ply", driver.folder / "c.ply")
    edits = Edits(open_scene(driver.folder / "c.ply"))
    edits.keep(np.arange(edits.scene.count) > 9, "delete")
    save_project(edits, project)
    viewer.loading.open(str(project), 0)
    driver.rest()
    found = [viewer.stage.scenes[0].count]
    os.utime(driver.folder / "c.ply", (1, 1))
    viewer.loading.reload_all()
    driver.rest()
    found.append(viewer.stage.scenes[0].count)
    viewer.loading.open(str(driver.folder / "a.ply"), 0)
    driver.rest()
    return found


def watched_project(driver: Driver) -> list:
    """Change and watch a file whose edits a project has; reload it with a key, and discard them."""
    viewer, path = driver.viewer, driver.folder / "d.ply"
    shutil.copy(driver.folder / "a.ply", path)
    viewer.loading.open(str(path), 0)
    driver.rest()
    edits, found = viewer.editor.all[0], []
    viewer.editor.number = 0
    viewer.editor.do(lambda edits: edits.keep(np.arange(edits.scene.count) > 9, "delete"))
    viewer.annotating.notes = [Annotation([1.0, 2.0, 3.0], "")]
    viewer.placing.place([0.0, 0.0, 0.5], [0.0, 0.0, 90.0], 1.0, False)
    viewer.placing.scale_all(2.0)
    found.append([round(x, 6) for x in viewer.annotating.notes[0].position])
    away = viewer.stage.pose.position
    viewer.placing.save(str(driver.folder / "d.gsproj"))
    found.append(edits.unsaved)
    viewer.watching.set_on(True)
    os.utime(path, (1, 1))
    driver.wait(lambda: "changed" in viewer.panel.status.text)
    driver.rest()
    found += [viewer.stage.scenes[0].count, edits.unsaved]
    viewer.placing.save(str(driver.folder / "e.gsproj"))
    found.append(viewer.message[1].removeprefix(str(path)))
    viewer.dismiss()
    viewer.watching.set_on(False)
    driver.key("ctrl+r")
    answer(driver, "Discard the edits")
    driver.wait(lambda: viewer.stage.scenes[0].whole is None)
    driver.rest()
    found.append([round(x, 6) for x in viewer.annotating.notes[0].position])
    found.append(float(np.abs(2 * viewer.stage.pose.position - away).max()))
    viewer.annotating.notes = []
    viewer.loading.open(str(driver.folder / "a.ply"), 0)
    driver.rest()
    return found


def memory(driver: Driver) -> list[str]:
    """What is said if memory is short in a step, and in a job, and if a file cannot be read."""
    viewer, found = driver.viewer, []

    def fail(_: object) -> None:
        raise MemoryError

    viewer.editor.do(fail)
    driver.tick(5)
    found.append(viewer.message[1])
    viewer.dismiss()
    viewer.worker.submit("fail", fail, print, viewer.fail)
    driver.wait(lambda: viewer.message is not None)
    found.append(viewer.message[1])
    viewer.dismiss()
    viewer.fail(PermissionError(13, "Permission denied", "a.ply"))
    found.append(viewer.message[1])
    viewer.dismiss()
    driver.rest()
    return found


def question(driver: Driver) -> list:
    """Whether a dialog stays open while jobs fail, and what is said after it."""
    viewer = driver.viewer
    viewer.ask_save()
    dialog = viewer.modal.dialog
    for text in ("first", "second", "first"):
        viewer.fail(gs_codec.GsCodecError(text))
    driver.tick(5)
    found = [viewer.modal.dialog is dialog]
    driver.key("Escape")
    for _ in range(2):
        driver.wait(lambda: viewer.message is not None)
        found.append(viewer.message[1])
        viewer.dismiss()
    driver.rest()
    return [*found, viewer.message]


def lengths(driver: Driver) -> list:
    """Number of points after two quick clicks, their text, and that of another scene."""
    viewer, stage = driver.viewer, driver.viewer.stage
    viewer.measuring.toggle()
    event = held(viewer.worker)
    wide, high = stage.picture_size
    for x in (0.5, 0.55):
        viewer.measuring.click(stage.panes[0], (x * wide, high / 2))
    event.set()
    driver.rest()
    found = [len(viewer.measuring.points)]
    viewer.measuring.set_length(7)
    found.append(viewer.measuring.text)
    event = held(viewer.worker)
    viewer.measuring.click(stage.panes[0], (0.6 * wide, high / 2))
    viewer.measuring.toggle()
    event.set()
    driver.rest()
    found.append(len(viewer.measuring.points))
    viewer.measuring.toggle()
    viewer.loading.open(str(driver.folder / "a.ply"), 0)
    driver.rest()
    found += [viewer.measuring.unit, viewer.measuring.text]
    viewer.measuring.toggle()
    return found


def tiny(driver: Driver) -> list[list[int]]:
    """Sizes of pictures saved from a tiny window, in each layout."""
    viewer, sizes, before = driver.viewer, [], driver.viewer.window.size
    viewer.window.size = gui.Size(1, 1)
    driver.tick(10, redraw=True)
    dialog = FileDialog(viewer.modal, FileQuestion("Open", PICTURES, driver.folder), print)
    dialog.field.text_value = "none.png"
    dialog.accept()
    driver.tick(5)
    dialog.cancel()
    for mode in MODES:
        viewer.set_mode(mode)
        driver.tick(5)
        path = driver.folder / f"{mode}.png"
        viewer.save(str(path))
        driver.wait(lambda: viewer.panel.status.text.startswith(path.name))  # noqa: B023
        with Image.open(path) as image:
            sizes.append(list(image.size))
    viewer.set_mode(MODES[0])
    viewer.window.size = before
    driver.rest()
    return sizes


def full(driver: Driver) -> list:
    """What is said if there is no folder for temporary files, and whether anything is encoded."""
    viewer, folder = driver.viewer, tempfile.tempdir
    tempfile.tempdir = str(driver.folder / "none")
    viewer.encoding.encode(viewer.panel.rate.settings)
    tempfile.tempdir = folder
    found = [viewer.message[1], viewer.encoding.doing]
    viewer.dismiss()
    return found


def measured(driver: Driver) -> list[str]:
    """What measured views are called, of trials with cameras and without any."""
    encoding, rate, found = driver.viewer.encoding, driver.viewer.panel.rate, []
    for cameras in (gs_codec.read_cameras(driver.folder / "cameras.json"), ()):
        encoding.trials = Trials(driver.viewer.stage.scenes[0], driver.folder, cameras)
        found.append(rate._kind())
    encoding.trials = None
    return found


def limit(driver: Driver) -> list[str]:
    """What is said about scenes opened or added that are larger than --max-bytes."""
    viewer, request, found = driver.viewer, driver.viewer.request, []
    viewer.request = replace(request, max_bytes=1000)
    for load in (lambda path: viewer.loading.open(path, 1), viewer.placing.add):
        load(str(driver.folder / "a.ply"))
        driver.wait(lambda: viewer.message is not None or not viewer.worker.busy)
        found.append(viewer.message[1] if viewer.message else "")
        viewer.dismiss()
        driver.rest()
    viewer.request = request
    return found


def escape(driver: Driver) -> bool:
    """Whether Esc clears the pick, and does not close, after the window was closed and stayed."""
    viewer = driver.viewer
    viewer.editor.do(lambda edits: edits.keep(np.arange(edits.scene.count) > 9, "delete"))
    driver.key("ctrl+q")
    driver.wait(lambda: viewer.modal.dialog is not None)
    driver.tick(5)
    driver.key("Escape")
    driver.wait(lambda: viewer.modal.dialog is None)
    viewer.editor.do(Edits.undo)
    driver.rest()
    pane, (wide, high) = viewer.stage.panes[0], viewer.stage.picture_size
    viewer.picking.click(pane, (wide / 2, high / 2))
    driver.wait(lambda: viewer.picking.hit is not None)
    driver.rest()
    driver.key("Escape")
    driver.wait(lambda: viewer.picking.hit is None)
    return True


def close(driver: Driver) -> list:
    """Whether a window closes while it saves, if that fails, while it films, and afterwards.

    Then whether a file exists, and the number of frames.
    """
    viewer, window, found = driver.viewer, driver.viewer.window, []
    viewer.timeline.keep()
    viewer.timeline.keep()
    viewer.timeline.set_seconds(1)
    viewer.timeline.set_fps(5)
    film = held(viewer.timeline._films)
    viewer.timeline.film(str(driver.folder / "frames"))
    for name in ("none/3.ply", "3.ply"):
        event = held(viewer.editor.worker)
        viewer.editor.save(str(driver.folder / name))
        window.close()
        found.append(any(not driver.app.run_one_tick() for _ in range(50)))
        event.set()
        if name == "none/3.ply":
            driver.wait(lambda: viewer.message is not None)
            driver.tick(20)
            viewer.dismiss()
            driver.rest()
    driver.wait((driver.folder / "3.ply").exists)
    driver.rest()
    for choices in (("Discard it", "Cancel"), ("Finish it, then close",)):
        window.close()
        for choice in choices:
            answer(driver, choice)
        found.append(any(not driver.app.run_one_tick() for _ in range(50)))
    film.set()
    found.append(any(not driver.app.run_one_tick() for _ in range(1000)))
    frames = len(list((driver.folder / "frames").iterdir()))
    return [*found, (driver.folder / "3.ply").exists(), frames]


if __name__ == "__main__":
    driver = Driver(Path(sys.argv[1]))
    driver.rest()
    steps = (
        transparent,
        several,
        added,
        reload_turned,
        reload_project,
        watched_project,
        question,
        memory,
        saves,
        brush,
        buttons,
        fails,
        reload,
        lengths,
        tiny,
        full,
        measured,
        limit,
        escape,
        close,
    )
    tell({step.__name__: step(driver) for step in steps})
