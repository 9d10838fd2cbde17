"""Use the camera path and other tools of a real viewer window; print the results as JSON.

Run by test_viewer_tools.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from drive_edit import answer
from drive_viewer import Driver, tell

from gs_codec.formats.ply.writer import write_ply
from samples.generate import generate
from viewer.pictures.drawer import depth_at
from viewer.scenes.edits import Edits
from viewer.scenes.opened import Opened


def press(driver: Driver, name: str) -> None:
    """Click a button of the path tab."""
    driver.click(driver.viewer.panel.path.buttons[name])


def save(driver: Driver, button: str, name: str) -> None:
    """Save with a button, under a typed name."""
    press(driver, button)
    driver.type_path(name)
    driver.key("Return")
    driver.wait(lambda: driver.viewer.modal.dialog is None)


def hold(driver: Driver, time: float, *further: float) -> None:
    """Press the mouse on the timeline at a time, drag it to further times, and release it."""
    frame, chart = driver.viewer.dock.canvas.widget.frame, driver.viewer.timeline.chart
    columns = [frame.x + chart.column(each, frame.width) for each in (time, *further)]
    driver.move(columns[0], frame.y + frame.height // 2)
    driver.xdotool("mousedown", 1)
    for column in columns[1:]:
        driver.move(column, frame.y + frame.height // 2)
    driver.xdotool("mouseup", 1)
    driver.tick(5)


def keyframes(driver: Driver, found: dict) -> None:
    """Keep keyframes with a key and a button; change their times with the mouse."""
    viewer, timeline = driver.viewer, driver.viewer.timeline
    buttons = viewer.panel.path.buttons
    found["enabled"] = [[text for text, button in buttons.items() if button.enabled]]
    driver.key("i")
    driver.wait(lambda: len(timeline.path.poses) == 1)
    driver.key("n")
    driver.rest()
    for count in (2, 3):
        press(driver, "Keep")
        driver.wait(lambda count=count: len(timeline.path.poses) == count)
        driver.drag(viewer.stage.panes[0], back=False)
    press(driver, "Set")
    driver.wait(lambda: timeline.path.poses[2] is viewer.stage.pose)
    driver.rest()
    found["enabled"].append([text for text, button in buttons.items() if button.enabled])
    press(driver, "Timeline")
    driver.rest()
    times = [timeline.path.times]
    for further in ((3.0,), (3.6, 2.5, 5.0, 9.0), (1.0, 2.0)):
        hold(driver, times[-1][1], *further)
        times.append(timeline.path.times)
    found["times"], found["chosen"] = times, timeline.chosen
    found["at key"] = viewer.stage.pose is timeline.path.poses[1]
    hold(driver, 0.5, 1.5, 1.0)
    driver.rest()
    [expected] = timeline.path.at([timeline.now])
    moved = viewer.stage.pose.position - expected.position
    found["scrubbed"] = [timeline.now, float(np.abs(moved).max())]
    driver.key("i")
    driver.wait(lambda: len(timeline.path.poses) == 4)
    found["between"] = timeline.path.times
    press(driver, "Drop")
    driver.wait(lambda: len(timeline.path.poses) == 3)


def flights(driver: Driver, found: dict) -> None:
    """Fly, film, save and open the path."""
    viewer, timeline = driver.viewer, driver.viewer.timeline
    path = timeline.path
    timeline.set_seconds(1.0)
    timeline.set_fps(5)
    viewer.visits.overview()
    driver.rest()
    begun = driver.models()
    driver.key("space")
    driver.wait(lambda: timeline.flying)
    driver.rest()
    ends = [np.abs(viewer.stage.pose.position - pose.position).max() for pose in path.poses]
    found["ends"], found["flown"] = ends, driver.models() != begun
    if find_spec("imageio_ffmpeg") is not None:
        save(driver, "Film", "film")
        driver.wait(lambda: not timeline.filming and "saved" in viewer.panel.status.text)
        found["film"] = viewer.panel.status.text
        save(driver, "Film", "stopped")
        timeline.close()
    kept = timeline.path
    timeline.set_seconds(1e9)
    timeline.film("long.mp4")
    driver.wait(lambda: viewer.message is not None)
    found["long"] = viewer.message[1]
    viewer.dismiss()
    timeline.path = kept
    save(driver, "Save", "path")
    driver.wait(Path("path.json").exists)
    found["unsaved"] = [timeline.ask_unsaved(print)]
    timeline.drop()
    timeline.open("path.json")
    answer(driver, "Discard it")
    driver.wait(lambda: len(timeline.path.poses) == 3)
    pairs = zip(kept.poses, timeline.path.poses, strict=True)
    found["apart"] = [float(np.abs(a.position - b.position).max()) for a, b in pairs]
    found["again"] = [timeline.path.times, timeline.path.fps]
    found["unsaved"].append(timeline.ask_unsaved(print))
    timeline.open("nothing.json")
    driver.wait(lambda: viewer.message is not None)
    found["message"] = viewer.message
    viewer.dismiss()


def measure(driver: Driver, found: dict) -> None:
    """Measure between two clicked points, with a drag between them, and set a known length."""
    viewer, measuring, stage = driver.viewer, driver.viewer.measuring, driver.viewer.stage
    viewer.visits.go_to(1)
    before = driver.scenes(driver.rest())
    driver.key("y")
    driver.wait(lambda: measuring.on)
    pane, expected = stage.panes[0], []
    for count, place in ((1, (80, 100)), (2, (100, 110))):
        frame, size = pane.widget.frame, stage.picture_size
        driver.move(frame.x + place[0], frame.y + place[1])
        driver.xdotool("mousedown", 1)
        driver.xdotool("mouseup", 1)
        driver.wait(lambda count=count: len(measuring.points) == count)
        at = place[0] + 0.5, place[1] + 0.5
        pixel, depth = stage.pose.project(measuring.points[-1][None], *size)
        look = stage.shown.look(pane.scene)
        seen = depth_at(stage.views, pane.scene, stage.pose, at, size, look)
        expected.append([*np.abs(pixel[0] - at).tolist(), abs(float(depth[0]) - seen)])
        driver.drag(pane, back=True)
    found["off"] = expected
    points = measuring.points
    found["distance"] = [measuring.distance, float(np.linalg.norm(points[1] - points[0]))]
    measuring.set_length(2 * measuring.distance)
    driver.key("r")
    found["drawn"] = int((np.abs(driver.scenes(driver.rest()) - before).max(axis=2) > 60).sum())
    found["measured"] = [stage.tag.label.text, viewer.panel.pick.measure._said.text]
    centres, tab = viewer.stage.scenes[0].positions, viewer.panel.pick.measure
    viewer.editor.do(lambda edits: edits.select(np.arange(len(centres)) == 0))
    place = stage.pose.position
    driver.click(tab.scale)
    driver.wait(lambda: not measuring.points)
    scaled = viewer.stage.scenes[0].positions
    found["scaled"] = [float(np.abs(scaled - 2 * centres).max()), viewer.editor.edits.options[-1]]
    seen = stage.pose.position
    found["after scaling"] = [measuring.unit, viewer.panel.status.text]
    driver.key("ctrl+z")
    driver.wait(lambda: viewer.stage.scenes[0].positions is centres)
    found["seen from"] = [np.abs(at - place).max() for at in (seen / 2, stage.pose.position)]
    viewer.editor.do(Edits.select_none)
    viewer.visits.go_to(1)
    driver.key("Escape")
    driver.wait(lambda: not measuring.on)
    found["left"] = int(np.abs(driver.scenes(driver.rest()) - before).max())
    found["picked"] = viewer.picking.hit is not None


def annotate(driver: Driver, found: dict) -> None:
    """Annotate two clicked points, choose the first again, and save them."""
    viewer, notes, stage = driver.viewer, driver.viewer.annotating, driver.viewer.stage
    viewer.measure()
    before = driver.scenes(driver.rest())
    driver.key("ctrl+n")
    driver.wait(lambda: notes.on)
    found["annotates alone"] = not viewer.measuring.on
    pane, tab, places = stage.panes[0], viewer.panel.pick.notes, ((80, 100), (100, 110), (81, 101))
    for place, count, chosen in zip(places, (1, 2, 2), (0, 1, 0), strict=True):
        driver.move(pane.widget.frame.x + place[0], pane.widget.frame.y + place[1])
        driver.xdotool("mousedown", 1)
        driver.xdotool("mouseup", 1)
        driver.wait(
            lambda count=count, chosen=chosen: (len(notes.notes), notes.chosen) == (count, chosen)
        )
        driver.rest()
    points = np.array([note.position for note in notes.notes])
    pixels = stage.pose.project(points, *stage.picture_size)[0]
    found["annotated"] = float(np.abs(pixels - np.array(places[:2]) - 0.5).max())
    driver.click(tab.title)
    driver.xdotool("type", "Ear")
    driver.wait(lambda: notes.notes[0].title == "Ear")
    found["titled"] = notes.titles
    found["rings"] = int((np.abs(driver.scenes(driver.rest()) - before).max(axis=2) > 60).sum())
    found["tag"] = stage.tag.label.text
    viewer.flip()
    driver.rest()
    viewer.flip()
    image, frame = driver.rest(), stage.tag.label.frame
    found["over B"] = int(image[frame.y : frame.y + 20, frame.x : frame.get_right()].max())
    viewer.set_mode("side")
    driver.rest()
    viewer.window.close()
    answer(driver, "Cancel")
    driver.rest()
    driver.click(tab.buttons["Save"])
    driver.type_path("notes")
    driver.key("Return")
    driver.wait(Path("notes.json").exists)
    driver.rest()
    driver.click(tab.buttons["Remove"])
    driver.wait(lambda: len(notes.notes) == 1)
    notes.remove()
    notes.open("notes.json")
    found["asks again"] = notes.ask_unsaved(print)
    driver.rest()
    driver.key("Escape")
    driver.wait(lambda: not notes.on)
    wide = pane.widget.frame.width
    after = driver.scenes(driver.rest())
    found["without rings"] = int(np.abs(after - before)[:, :wide].max())


def follow(driver: Driver, found: dict) -> None:
    """Place all of A, a selection, all, and B, and undo each: what was put on A, and its pixels."""
    viewer, editor, stage = driver.viewer, driver.viewer.editor, driver.viewer.stage
    measuring = viewer.measuring
    measuring.points, measuring.unit = list(stage.scenes[0].positions[:2].astype(float)), 3.0

    def put() -> tuple[list, list]:
        points = [*(note.position for note in viewer.annotating.notes), *measuring.points]
        poses = viewer.timeline.path.poses
        pixels = [pose.project(points, 640, 480)[0] for pose in poses]
        return [*points, *(pose.position for pose in poses)], pixels

    def select(number: int, rows: slice) -> None:
        editor.set_number(number)
        chosen = np.zeros(editor.edits.scene.count, bool)
        chosen[rows] = True
        editor.do(lambda edits: edits.select(chosen))

    measuring.points[1] = measuring.points[0] + (0, 0, 1e-5)
    viewer.panel.refresh()
    found["digits"] = viewer.panel.pick.measure.length.decimal_precision
    measuring.points[1] = measuring.points[0] + 1
    length = measuring.unit * measuring.distance
    points, pixels = put()
    found["put"], found["follows"] = len(points), []
    for number, rows in ((0, slice(0)), (0, slice(9)), (0, slice(None)), (1, slice(0))):
        select(number, rows)
        viewer.placing.place([1, 2, 3], [30, 40, 50], 2.0, True)
        matrix = editor.edits.scene.moves[-1].matrix
        moved, seen = put()
        stays = np.abs(np.array(moved) - points).max() < 1e-9
        goes = np.abs(points @ matrix[:3, :3].T + matrix[:3, 3] - moved).max()
        apart = np.abs(np.array(seen) - pixels).max()
        lengths = abs(measuring.unit * measuring.distance - length)
        editor.do(Edits.undo)
        back = np.abs(np.array(put()[0]) - points).max()
        close = max(goes, apart, lengths, back) < 1e-6
        found["follows"].append("stays" if stays else "goes" if close else "is lost")
    select(0, slice(0))
    viewer.forget()


def late(driver: Driver, found: dict) -> None:
    """Stop annotating after a click, before its point is found."""
    viewer, notes = driver.viewer, driver.viewer.annotating
    while notes.notes:  # where the clicks are
        notes.choose(0)
        notes.remove()
    viewer.annotate()
    driver.rest()
    viewer.panel.say("nothing to annotate there")  # of a click before
    notes.click(viewer.stage.panes[0], (80.5, 100.5))
    driver.wait(lambda: bool(notes.notes))
    found["said"] = viewer.panel.status.text
    notes.remove()
    notes.click(viewer.stage.panes[0], (80.5, 100.5))
    viewer.annotate()
    driver.rest()
    found["late"] = len(notes.notes)


def write(path: Path, seed: int) -> None:
    """Write a scene, later than any before."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_ply(path, generate(1000 + seed, 1, seed))
    os.utime(path, (2e9 + seed, 2e9 + seed))


def watch(driver: Driver, found: dict) -> None:
    """Change an open file, with and without reloading it, damage it, and add a later one."""
    viewer, stage, watching = driver.viewer, driver.viewer.stage, driver.viewer.watching
    path, later = (Path(f"model/iteration_{k}/cloud.ply") for k in (7, 30))
    write(path, 1)
    viewer.loading.open(str(path), 0)
    driver.wait(lambda: stage.scenes[0].count == 1001)
    driver.drag(stage.panes[0], back=False)
    driver.rest()
    pose, counts = stage.pose, []

    def reloaded() -> None:
        driver.wait(lambda: stage.scenes[0].count not in (1001, *counts))
        driver.rest()
        counts.append(stage.scenes[0].count)

    write(path, 2)
    driver.wait(lambda: "changed" in viewer.panel.status.text)
    found["changed"] = [stage.scenes[0].count, viewer.panel.status.text]
    driver.key("ctrl+r")
    reloaded()
    viewer.panel.show("Scene")
    driver.rest()
    driver.click(viewer.panel.scene.watch)
    driver.wait(lambda: watching.on)
    write(path, 3)
    reloaded()
    path.write_bytes(b"ply")
    driver.wait(lambda: "not reloaded" in viewer.panel.status.text)
    write(later, 4)
    reloaded()
    found["reloaded"] = [counts, stage.pose is pose, str(stage.scenes[0].path)]
    viewer.editor.do(Edits.select_all)
    viewer.editor.do(lambda edits: edits.keep(np.arange(1004) > 3, "test"))
    write(later, 5)
    driver.wait(lambda: "changed" in viewer.panel.status.text)
    found["edited"] = stage.scenes[0].count
    viewer.editor.do(lambda edits: edits.mark_saved(edits.scene))
    viewer.loading.show([Opened("cloud", stage.scenes[0].cloud)], viewer.visits.views, None)
    driver.rest()
    viewer.panel.say("")
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        driver.tick()
    found["cloud"] = viewer.panel.status.text


def run(folder: Path) -> dict:
    driver, found = Driver(folder, size=(702, 400)), {}
    driver.rest()
    driver.viewer.panel.show("Path")
    driver.rest()
    keyframes(driver, found)
    flights(driver, found)
    measure(driver, found)
    annotate(driver, found)
    follow(driver, found)
    late(driver, found)
    watch(driver, found)
    return found


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # where paths are saved
    tell(run(Path(sys.argv[1])))
