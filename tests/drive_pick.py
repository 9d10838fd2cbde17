"""Pick Gaussians in the viewer's window with a mouse, and colour centres; print the results.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from drive_viewer import Driver, tell

from viewer.scenes.picked import Picker
from viewer.window.pane import Pane

#: Half the side, in pixels, of the part of a pane that contains a mark.
_AROUND = 64


def click(driver: Driver, pane: Pane, right: int, down: int) -> list:
    """Click in a pane, at an offset from its middle; return the picked and expected one."""
    stage, picking = driver.viewer.stage, driver.viewer.picking
    frame = pane.widget.frame
    x, y = frame.x + frame.width // 2 + right, frame.y + frame.height // 2 + down
    before = picking.hit
    driver.move(x, y)
    driver.xdotool("mousedown", 1)
    driver.xdotool("mouseup", 1)
    driver.wait(lambda: picking.hit is not before and picking.picked is not None)
    wipe = driver.viewer.choice.wipe if driver.viewer.choice.mode == "wipe" else 0
    place = x + 0.5 - (0 if wipe else frame.x), y + 0.5 - frame.y
    which = stage.panes.index(pane)
    expected = Picker(stage.scenes).pick(which, stage.pose, stage.picture_size, place)
    return [vars(picking.hit), vars(expected)]


def marked(driver: Driver) -> list[int]:
    """Number of pixels that the mark changes in each pane, and elsewhere; then clear it."""
    viewer, stage = driver.viewer, driver.viewer.stage
    scene, row = viewer.picking.picked.scene, viewer.picking.hit.row
    place = stage.pose.project(scene.positions[row][None], *stage.picture_size)[0][0]
    with_mark = driver.rest()
    frames = [pane.widget.frame for pane in stage.visible]
    driver.key("Escape")
    driver.wait(lambda: viewer.picking.hit is None)
    changed = np.abs(with_mark - driver.rest()).max(axis=2) > 40
    changed[:, viewer.panel.tabs.frame.x - 4 :] = False
    counts = []
    for frame in frames:
        x, y = (np.array([frame.x, frame.y]) + place).astype(int)
        part = slice(max(y - _AROUND, 0), y + _AROUND), slice(max(x - _AROUND, 0), x + _AROUND)
        counts.append(int(changed[part].sum()))
        changed[part] = False
    return [*counts, int(changed.sum())]


def colours(driver: Driver) -> dict:
    """Captions, legends and scales of centres coloured by bits; a click changes the scale."""
    viewer = driver.viewer
    viewer.choice.layers = {"centres"}
    found: dict = {"scales": [], "legends": []}
    for colouring in ("bits", "block"):
        viewer.set_colouring(colouring)
        driver.rest()
        found[colouring] = [label.text for label in viewer.stage.captions]
        found["scales"].append([viewer.panel.scene.logarithmic.enabled, viewer.choice.scale])
        found["legends"] += [legend.marks for legend in viewer.stage.legends]
    viewer.set_colouring("bits")
    before = driver.scenes(driver.rest())
    driver.click(viewer.panel.scene.logarithmic)
    driver.wait(lambda: viewer.choice.scale == "log")
    found["changed"] = int((np.abs(driver.scenes(driver.rest()) - before) > 12).sum())
    found["legends"] += [legend.marks for legend in viewer.stage.legends]
    return found


def run(folder: Path) -> dict:
    driver = Driver(folder, size=(900, 420))
    viewer, found = driver.viewer, {}
    driver.rest()
    found["first"] = click(driver, viewer.stage.panes[1], 12, 7)
    found["text"] = viewer.panel.pick.text.text
    found["marked"] = marked(driver)
    found["tab"] = list(viewer.panel._named)[viewer.panel.tabs.selected_tab_index]
    found["cleared"] = viewer.panel.pick.text.text
    found["again"] = click(driver, viewer.stage.panes[0], -20, 10)
    seen = viewer.picking.picked.contribution.weight
    driver.drag(viewer.stage.panes[0], back=False)
    driver.wait(lambda: viewer.picking.picked.contribution.weight != seen)
    found["moved"] = marked(driver)
    driver.key("r")
    viewer.set_mode("wipe")
    driver.rest()
    found["wiped"] = click(driver, viewer.stage.panes[1], -30, 0)
    viewer.set_mode("side")
    viewer.panel.show("Scene")
    found["colours"] = colours(driver)
    # Even with a Gaussian picked, requests to close still work; Esc would first clear the pick.
    viewer.choice.layers = {"splats"}
    viewer.refresh()
    driver.rest()
    click(driver, viewer.stage.panes[0], -20, 10)
    subprocess.run(["xdotool", "key", "ctrl+q"], check=True)
    found["closes"] = any(not driver.app.run_one_tick() for _ in range(200))
    return found


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
