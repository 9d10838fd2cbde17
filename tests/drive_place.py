"""Join, place and save scenes in a real viewer window; print the results as JSON.

Run by test_viewer_select.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
from drive_edit import answer, draw, undo
from drive_viewer import Driver, tell
from open3d.visualization import gui

from viewer.window.dialogs import inside


def handle(driver: Driver, kind: str, axis: int) -> tuple[int, int]:
    """A pixel of a handle, in the first pane."""
    stage = driver.viewer.stage
    gizmo = driver.viewer.editor.tools["place"]._gizmo(stage.pose, stage.picture_size)
    line = next(h.line for h in gizmo.handles if (h.kind, h.axis) == (kind, axis))
    x, y = line[5] if len(line) > 2 else line.mean(axis=0)
    return round(x), round(y)


def drags(driver: Driver, found: dict) -> None:
    """Drag each kind of handle; drag one forth and back, and beside the handles."""
    viewer, pane = driver.viewer, driver.viewer.stage.panes[0]
    edits = viewer.editor.edits
    driver.click(viewer.panel.place.buttons["handles"])
    driver.wait(lambda: viewer.editor.tool == "place")
    shown = driver.scenes(driver.rest())
    red = (shown[..., 0] > 200) & (shown[..., 1] < 130) & (shown[..., 2] < 130)
    found["red"] = int(red.sum())
    for kind, axis in (("shift", 3), ("move", 0), ("turn", 1), ("scale", 3)):
        before, (x, y) = edits.scene, handle(driver, kind, axis)
        draw(driver, pane, [(x, y), (x + 10, y + 4), (x + 20, y + 10)])
        driver.wait(lambda: edits.scene is not before)  # noqa: B023
        driver.rest()
        found[kind] = edits.scene.moves[-1].matrix.tolist()
        undo(driver)
        driver.rest()
    x, y = handle(driver, "shift", 3)
    draw(driver, pane, [(x, y), (x + 30, y + 9), (x, y)])
    driver.rest()
    found["back"] = float(np.abs(edits.scene.positions - edits.whole.positions).max())
    undo(driver)
    driver.rest()
    pose = viewer.stage.pose
    draw(driver, pane, [(4, 4), (60, 9)])
    driver.rest()
    found["beside"] = viewer.stage.pose is not pose, len(edits.scene.moves)


def numbers(driver: Driver, found: dict) -> None:
    """Place the selection by numbers."""
    viewer, tab = driver.viewer, driver.viewer.panel.place
    edits = viewer.editor.edits
    viewer.editor.select_range("opacity", 0.5, np.inf)
    tab.shift.vector_value, tab.angles.vector_value = [0.1, 0.2, 0.3], [0, 90, 0]
    tab.factor.double_value = 0.5
    driver.click(tab.buttons["Apply"])
    driver.wait(lambda: bool(edits.scene.moves))
    found["numbers"] = edits.scene.moves[-1].matrix.tolist()
    found["middle"] = np.median(edits.whole.positions[edits.selected], axis=0).tolist()
    found["moved"] = int((edits.scene.positions != edits.whole.positions).any(axis=1).sum())


def scenes(driver: Driver, found: dict) -> None:
    """Add, name, hide, show, remove; save a project, show the command, open the project."""
    viewer, tab = driver.viewer, driver.viewer.panel.place
    edits = viewer.editor.edits
    driver.click(tab.buttons["Add"])
    driver.type_path("b.egs")
    driver.key("Return")
    driver.wait(lambda: len(edits.parts) == 2)
    driver.rest()
    tab.list.selected_index = 1
    found["caption"] = viewer.stage.captions[0].text
    for text, done in (
        ("Hide", lambda: edits.hidden_count == 3000),
        ("Hide", lambda: edits.hidden_count == 0),
        ("Select", lambda: edits.count == 3000),
        ("Remove", lambda: len(edits.parts) == 1),
    ):
        driver.click(tab.buttons[text])
        driver.wait(done)
        driver.rest()
        tab.list.selected_index = 1
    undo(driver)
    viewer.editor.do(lambda edits: edits.rename(1, "coded"))
    driver.click(tab.buttons["Command"])  # asks for the project first
    driver.type_path("both")
    driver.key("Return")
    driver.wait(lambda: Path("both.gsproj").exists())
    driver.tick(10, redraw=True)
    labels = [w.text for w in inside(viewer.modal.dialog) if isinstance(w, gui.Label)]
    found["command"] = " ".join(labels[1].split("\n\n")[0].split("\n"))
    answer(driver, "OK")
    found["unsaved"] = edits.unsaved
    count = edits.scene.count
    viewer.loading.open("both.gsproj", 0)
    driver.wait(lambda: viewer.editor.edits is not edits)
    driver.rest()
    again = viewer.editor.edits
    found["again"] = [part[1:3] for part in again.parts], again.scene.count == count
    again.undo()
    viewer.editor.save("both.ply")
    driver.rest()


def run(folder: Path) -> dict:
    driver = Driver(folder, size=(900, 580))
    driver.rest()
    driver.viewer.panel.show("Place")
    driver.rest()
    found: dict = {}
    drags(driver, found)
    numbers(driver, found)
    scenes(driver, found)
    return found


if __name__ == "__main__":
    os.chdir(sys.argv[1])
    tell(run(Path(sys.argv[1])))
