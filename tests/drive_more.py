"""Drive the viewer's window through its layers, layouts and appearances; print the results.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from drive_viewer import Driver, resident, tell
from open3d.visualization import gui

from viewer.pictures.picture import LINE_COLOUR
from viewer.scenes.choice import Appearance
from viewer.scenes.worker import Stale


def layers(driver: Driver, first: np.ndarray) -> dict:
    """Number of pixels of each half of the panes that a layer changes, and that stay changed."""
    found, before = {}, first
    for layer in driver.viewer.panel.scene.boxes:
        driver.toggle(layer)
        after = driver.rest()
        changed = np.abs(driver.scenes(after) - driver.scenes(before)).max(axis=2) > 12
        halves = np.array_split(changed, 2, axis=1)
        found[layer] = [int(half.sum()) for half in halves]
        driver.toggle(layer)
        before = driver.rest()
        apart = np.abs(driver.scenes(before) - driver.scenes(first)).max()
        found[layer].append(int(apart))
    return found


def drags(driver: Driver) -> dict:
    """The cameras after the same drag forth and back, in few and many events, in each layout."""
    viewer, found = driver.viewer, {}
    cases = [
        ("side", 1, "ctrl", (1, 20)),
        ("side", 3, "", (1, 20)),
        ("wipe", 1, "", (1, 50)),
        ("wipe", 1, "ctrl", (1, 20)),
    ]
    for mode, button, key, numbers in cases:
        if mode != viewer.choice.mode:
            viewer.set_mode(mode)
            driver.rest()
        found[f"{mode} {button} {key}"] = driver.drags(numbers, button, key)
    viewer.set_mode("side")
    driver.rest()
    return found


def wheel(driver: Driver) -> list[float]:
    """Distance of the centre at first, after scrolling up, and after scrolling down."""
    navigator, distances = driver.viewer.stage.navigator, []
    frame = driver.viewer.stage.panes[0].widget.frame
    driver.move(frame.x + frame.width / 2, frame.y + frame.height / 2)
    distances.append(navigator.distance)
    for button in (4, 5, 5):
        driver.xdotool("click", button)
        driver.wait(lambda: navigator.distance != distances[-1])
        distances.append(navigator.distance)
    driver.rest()
    return distances


def stop_loading(driver: Driver) -> list[str]:
    """The open scenes after twice cancelling the loading of a scene in place of the second."""
    viewer, scenes = driver.viewer, []
    started, go_on = threading.Event(), threading.Event()
    for stop in (lambda: driver.key("BackSpace"), lambda: driver.click(viewer.panel.stop)):
        started.clear()
        go_on.clear()

        def wait(stale: Stale) -> None:
            started.set()
            go_on.wait(60)

        viewer.worker.submit("save", wait, print, print)  # keeps later work in the queue
        started.wait(60)
        viewer.loading.open(str(driver.folder / "a.ply"), 1)
        driver.tick(5)
        scenes.append(viewer.panel.status.text)
        stop()
        scenes.append(viewer.panel.status.text)
        go_on.set()
        driver.rest()
        scenes.append(viewer.stage.scenes[1].name)
    return scenes


def edge_colours(driver: Driver) -> float:
    """The largest difference of the edges of cells from the colours of the legend."""
    viewer = driver.viewer
    viewer.set_appearance(Appearance(least_opacity=1.0))  # no splats
    image = driver.scenes(driver.rest())
    viewer.set_appearance(Appearance())
    bar = np.concatenate([viewer.stage.legends[0].bar(4096, 1)[0], [LINE_COLOUR]])
    seen = np.unique(image[image.max(axis=2) > 0].reshape(-1, 3), axis=0)
    return max(float(np.abs(255 * bar - colour).max(axis=1).min()) for colour in seen)


def octree(driver: Driver) -> dict:
    """Depths chosen by dragging the slider to its ends, and the screen."""
    viewer, corner = driver.viewer, driver.viewer.window.os_frame
    driver.toggle("octree")
    first = driver.scenes(driver.rest())
    off = edge_colours(driver)
    frame, depths = viewer.panel.scene.depth.frame, []
    y = corner.y + frame.y + frame.height // 2
    columns = np.linspace(frame.x + 10, frame.get_right() - 10, 12).round().astype(int)
    driver.xdotool("mousemove", corner.x + columns[5], y, "mousedown", 1)
    for column in (*columns[5:], *columns[::-1]):
        driver.xdotool("mousemove", corner.x + column, y)
        depths.append(viewer.choice.octree.depth)
    driver.xdotool("mouseup", 1)
    last = driver.scenes(driver.rest())
    viewer.set_octree(replace(viewer.choice.octree, colouring="bits"))
    driver.rest()
    captions = [label.text for label in viewer.stage.captions]
    legends = [legend.title for legend in viewer.stage.legends]
    driver.toggle("octree")
    driver.rest()
    return {
        "depths": depths,
        "changed": int((np.abs(last - first) > 12).sum()),
        "captions": captions,
        "legends": legends,
        "after": len(viewer.stage.legends),
        "off": off,
    }


def appearances(driver: Driver, before: np.ndarray) -> dict:
    """Changes of the panes by appearances and hidden Gaussians, and how far they revert."""
    viewer, found = driver.viewer, {}
    teal = (0.1, 0.5, 0.6)
    first = viewer.stage.scenes[0]
    cases = {
        "background": {"background": teal},
        "scale": {"scale": 0.3},
        "least opacity": {"least_opacity": 1.0},
    }
    for name, changes in cases.items():
        viewer.set_appearance(Appearance(**changes))
        after = driver.scenes(driver.rest())
        found[name] = int((np.abs(after - driver.scenes(before)) > 12).sum())
        if name == "background":
            apart = np.abs(after - np.rint(255 * np.array(teal))).max(axis=2)
            found["teal"] = int((apart <= 1).sum())
        viewer.set_appearance(Appearance())
    driver.rest()
    viewer.stage.drawn = {first: np.zeros(first.count, bool)}
    viewer.refresh()
    halves = np.array_split(driver.scenes(driver.rest()), 2, axis=1)
    found["hidden"] = [float(half.std()) for half in halves]
    found["quality"] = viewer.stage.quality
    viewer.stage.drawn = {}
    viewer.refresh()
    found["apart"] = int(np.abs(driver.scenes(driver.rest()) - driver.scenes(before)).max())
    return found


def pictures(driver: Driver) -> dict:
    """The panes after one was updated and the other got its first picture; MB left by many.

    After 8 pictures, each of 24 pictures of different sizes takes 6 MB.
    """
    stage = driver.viewer.stage
    first, other = (np.full((64, 64, 3), colour, np.float32) for colour in ((1, 0, 0), (0, 1, 0)))
    for number, picture in ((0, first), (0, other), (1, first)):
        stage.panes[number].show_picture(picture)
    screen, frames = driver.rest(), [pane.widget.frame for pane in stage.panes]
    shown = [screen[f.y + f.height // 2, f.x + f.width // 2].tolist() for f in frames]
    before = 0.0
    for k in range(32):
        if k == 8:  # by now the driver has allocated its own memory
            before = resident()
        stage.panes[0].show_picture(np.full((600 + k, 600, 3), 0.5, np.float32))
        driver.tick(redraw=True)
    stage.restyle()
    driver.rest()
    return {"shown": shown, "left": resident() - before}


def run(folder: Path) -> dict:
    driver = Driver(folder, size=(672, 320))
    viewer = driver.viewer
    first = driver.rest()
    found: dict = {"quality": viewer.stage.quality}
    found["layers"] = layers(driver, first)
    found["appearances"] = appearances(driver, first)
    found["pictures"] = pictures(driver)
    found["drags"] = drags(driver)
    found["wheel"] = wheel(driver)
    viewer.window.size = gui.Size(692, 520)
    driver.rest()
    found["octree"] = octree(driver)
    found["near"] = [p.widget.scene.camera.get_near() for p in viewer.stage.panes]
    found["asked"] = [[scene.name for scene in viewer.stage.scenes]]
    viewer.loading.open(str(folder / "a.ply"))
    driver.rest()
    found["asked"].append([scene.name for scene in viewer.stage.scenes])
    viewer.modal.close_dialog()
    viewer.loading.open(str(folder / "report" / "report.json"), 1)
    driver.rest()
    found["message"] = viewer.message
    viewer.dismiss()
    found["stopped"] = stop_loading(driver)
    return found


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
