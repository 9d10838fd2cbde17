"""Select with each tool in a real viewer window; print the results as JSON.

Run by test_viewer_select.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from drive_edit import draw, selected
from drive_viewer import Driver, tell

from viewer.scenes.edits import Edits
from viewer.scenes.picked import Picker
from viewer.scenes.saving import command_of
from viewer.window.pane import Pane


def click(driver: Driver, pane: Pane, *places: tuple[int, int]) -> None:
    """Click at pixels of a pane."""
    frame = pane.widget.frame
    for x, y in places:
        driver.move(frame.x + x, frame.y + y)
        driver.xdotool("mousedown", 1)
        driver.xdotool("mouseup", 1)


def choose(driver: Driver, tool: str) -> None:
    """Click a tool's button."""
    editor = driver.viewer.editor
    driver.click(driver.viewer.panel.edit.buttons[tool])
    driver.wait(lambda: editor.tool == tool)


def changed(driver: Driver) -> list[int]:
    """The selection once a tool that works in the background has changed it."""
    driver.wait(lambda: not driver.viewer.editor.worker.busy)
    driver.tick(3)
    return selected(driver)


def polygons(driver: Driver, pane: Pane, found: dict) -> None:
    """Polygons closed by Enter and by a click; one dropped by Esc."""
    driver.key("z")
    driver.wait(lambda: driver.viewer.editor.tool == "polygon")
    corners = [(60, 40), (150, 30), (160, 120), (80, 160)]
    click(driver, pane, *corners)
    before = driver.scenes(driver.rest())
    frame = pane.widget.frame
    driver.move(frame.x + 30, frame.y + 100)
    driver.tick(3)
    after = driver.scenes(driver.rest())
    found["rubber"] = int((np.abs(after - before).max(axis=2) > 60).sum())
    driver.key("Return")
    found["polygon"] = corners, selected(driver)
    click(driver, pane, (60, 40), (150, 30), (160, 120), (63, 42))
    found["closed"] = selected(driver)
    click(driver, pane, (20, 20), (90, 20), (90, 200))
    driver.key("Escape")
    driver.tick(5)
    found["dropped"] = selected(driver), driver.viewer.editor.finish()


def brushes(driver: Driver, pane: Pane, found: dict) -> None:
    """Paint, with the selection shown at once; then intersect, and resize the brush."""
    viewer, editor = driver.viewer, driver.viewer.editor
    driver.key("b")
    driver.wait(lambda: editor.tool == "brush")
    viewer.editor.selecting.radius = 15
    clean = driver.scenes(driver.rest())
    path = [(70, 70), (120, 80), (120, 150)]
    painted = driver.scenes(draw(driver, pane, path))
    magenta = (painted[..., 0] > 200) & (painted[..., 1] < 120) & (painted[..., 2] > 200)
    found["painted"] = int(magenta.sum()), int((np.abs(painted - clean) > 60).any(axis=2).sum())
    found["brush"] = path, selected(driver)
    viewer.panel.edit.how.selected_index = 3
    editor.selecting.how = "intersect"
    draw(driver, pane, [(90, 60), (90, 200)])
    found["intersected"] = selected(driver)
    editor.selecting.how = "replace"
    for key in ("bracketright", "bracketright", "bracketleft"):
        driver.key(key)
        driver.tick(3)
    found["radius"] = editor.selecting.radius


def seeds(driver: Driver, pane: Pane, found: dict) -> None:
    """Spheres, colours and floods at a Gaussian, grown and shrunk."""
    viewer = driver.viewer
    at = (130, 110)
    stage, pixel = viewer.stage, (at[0] + 0.5, at[1] + 0.5)
    hit = Picker(stage.scenes).pick(0, stage.pose, stage.picture_size, pixel)
    found["seed"] = hit.row
    driver.key("j")
    driver.wait(lambda: viewer.editor.tool == "sphere")
    draw(driver, pane, [at, (150, 110), (180, 110)])
    found["sphere"] = changed(driver)
    viewer.editor.do(Edits.invert)
    viewer.editor.do(Edits.delete)
    driver.rest()
    found["command"] = command_of(viewer.editor.edits, Path())
    viewer.editor.save("sphere.ply")
    changed(driver)
    for _ in range(2):
        viewer.editor.do(Edits.undo)
    driver.rest()
    for tool in ("colour", "flood"):
        choose(driver, tool)
        click(driver, pane, at)
        found[tool] = changed(driver)
    for button in ("Grow", "Shrink"):
        driver.click(viewer.panel.edit.buttons[button])
        driver.tick(3)
        found[button] = changed(driver)


def visible(driver: Driver, pane: Pane, found: dict) -> None:
    """A box by centres or footprints, all depths or only what is seen."""
    tab, options = driver.viewer.panel.edit, driver.viewer.editor.selecting
    choose(driver, "box")
    for footprint in (False, True):
        for front in (False, True):
            for box, wanted in ((tab.footprint, footprint), (tab.front, front)):
                if box.checked != wanted:
                    driver.click(box)
            driver.wait(lambda: (options.footprint, options.front) == (footprint, front))  # noqa: B023
            draw(driver, pane, [(70, 60), (160, 150)])
            found[f"{footprint} {front}"] = changed(driver)


def run(folder: Path) -> dict:
    driver = Driver(folder, size=(900, 580))
    driver.rest()
    driver.viewer.panel.show("Edit")
    driver.rest()
    stage = driver.viewer.stage
    pose, size = stage.pose, stage.picture_size
    found: dict = {"pose": [pose.rotation.tolist(), pose.position.tolist(), pose.lens(*size)]}
    pane = stage.panes[0]
    polygons(driver, pane, found)
    brushes(driver, pane, found)
    seeds(driver, pane, found)
    visible(driver, pane, found)
    found["idle"] = driver.viewer.panel.status.text
    return found


if __name__ == "__main__":
    os.chdir(sys.argv[1])
    tell(run(Path(sys.argv[1])))
