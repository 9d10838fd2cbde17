"""Select, edit and save in a real viewer window; print the results as JSON.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from drive_viewer import Driver, tell
from open3d.visualization import gui

from viewer.window.dialogs import Modal, inside
from viewer.window.pane import Pane


def draw(driver: Driver, pane: Pane, corners: list, key: str = "") -> np.ndarray:
    """Drag the mouse along pixels of a pane, holding a key; return the screen before release."""
    frame, corner = pane.widget.frame, driver.viewer.window.os_frame
    places = [(corner.x + frame.x + x, corner.y + frame.y + y) for x, y in corners]
    if key:
        driver.xdotool("keydown", key)
    driver.xdotool("mousemove", *places[0], "mousedown", 1)
    for place in places[1:]:
        driver.xdotool("mousemove", *place)
    image = driver.rest()
    driver.xdotool("mouseup", 1)
    driver.tick(5)
    if key:
        driver.xdotool("keyup", key)
    return image


def selected(driver: Driver) -> list[int]:
    """Rows in the file of the Gaussians selected in the edited scene."""
    edits = driver.viewer.editor.edits
    return edits.scene.rows[edits.selected].tolist()


def find(driver: Driver, text: str) -> gui.Button:
    """A button of the open dialog, once it can be clicked."""
    driver.wait(lambda: driver.viewer.modal.dialog is not None)
    driver.tick(5, redraw=True)
    buttons = [w for w in inside(driver.viewer.modal.dialog) if isinstance(w, gui.Button)]
    return next(button for button in buttons if button.text == text)


def answer(driver: Driver, text: str) -> None:
    """Click a button of the open dialog."""
    modal = driver.viewer.modal
    button, dialog = find(driver, text), modal.dialog
    driver.click(button)
    driver.wait(lambda: modal.dialog is not dialog)


def undo(driver: Driver) -> None:
    """Undo with ctrl + Z."""
    edits = driver.viewer.editor.edits
    step = edits.undone_next
    driver.key("ctrl+z")
    driver.wait(lambda: edits.redone_next == step)


def replaces(modal: Modal) -> list[gui.Widget]:
    """The button of a dialog that overwrites a file, if it has one."""
    buttons = [w for w in inside(modal.dialog) if isinstance(w, gui.Button)]
    return [button for button in buttons if button.text == "Replace"]


def save(driver: Driver, name: str) -> None:
    """Save the edited scene with ctrl + shift + S and a typed name."""
    driver.key("ctrl+shift+s")
    driver.type_path(name)
    driver.key("Return")
    modal = driver.viewer.modal
    driver.wait(lambda: modal.dialog is None or bool(replaces(modal)))


def regions(driver: Driver, found: dict) -> None:
    """Select with boxes and lassos, adding and removing, in both panes."""
    viewer = driver.viewer
    first, second = viewer.stage.panes
    pose, size = viewer.stage.pose, viewer.stage.picture_size
    found["pose"] = [pose.rotation.tolist(), pose.position.tolist(), pose.lens(*size)]
    before = driver.scenes(driver.rest())
    driver.key("x")
    drawn = driver.scenes(draw(driver, first, [(60, 40), (100, 60), (150, 160)]))
    side = drawn[50:150, 58:63].max(axis=2)
    found["stroke"] = [int(side.max(axis=1).min()), int(side.min(axis=1).max())]
    found["box"] = selected(driver)
    marked = driver.scenes(driver.rest())
    found["marked"] = int((np.abs(marked - before).max(axis=2) > 60).sum())
    found["label"] = viewer.panel.edit.count.text
    driver.key("l")
    draw(driver, first, [(160, 60), (220, 80), (200, 200), (110, 210)], "shift")
    found["added"] = selected(driver)
    edge = first.widget.frame.width - 1, 100  # right edge of the pane
    found["edge"] = edge
    draw(driver, first, [(110, 100), (edge[0] + 90, 100), (120, 220)], "ctrl")
    found["removed"] = selected(driver)
    draw(driver, second, [(60, 40), (150, 40), (150, 160), (60, 160)])
    found["other"] = viewer.editor.number, selected(driver)
    viewer.editor.set_number(0)


def steps(driver: Driver, found: dict) -> None:
    """Delete, undo, redo and hide with keys."""
    viewer = driver.viewer
    stage, pose, original = viewer.stage, viewer.stage.pose, viewer.stage.scenes[0]
    counts, found["quality"] = [original.count], [stage.quality]
    before = driver.scenes(driver.rest())
    for key in ("Delete", "ctrl+z", "ctrl+shift+z", "ctrl+z", "ctrl+y"):
        driver.key(key)
        driver.wait(lambda: stage.scenes[0].count != counts[-1])
        image = driver.scenes(driver.rest())
        counts.append(stage.scenes[0].count)
        found.setdefault("changed", []).append(int((np.abs(image - before) > 12).sum()))
        found["quality"].append(stage.quality)
    found["counts"], found["same pose"] = counts, stage.pose is pose
    found["captions"] = [label.text for label in stage.captions]
    found["numbers"] = viewer.panel.scene.numbers.text
    driver.key("ctrl+z")
    found["back"] = stage.scenes[0] is original
    edits = viewer.editor.all[0]
    before = driver.scenes(driver.rest())
    driver.key("ctrl+h")
    driver.wait(lambda: edits.hidden_count > 0)
    found["hidden"] = [edits.hidden_count, edits.count]
    hidden = driver.scenes(driver.rest())
    found["hidden changed"] = int((np.abs(hidden - before).max(axis=2) > 12).sum())
    driver.click(viewer.panel.edit.buttons["Show all"])
    driver.wait(lambda: not edits.hidden_count)


def saving(driver: Driver, found: dict) -> None:
    """Edit with the actions of `convert`, and save."""
    viewer, tab = driver.viewer, driver.viewer.panel.edit
    edits = viewer.editor.all[0]
    viewer.editor.select_range("opacity", 0.5, np.inf)
    driver.click(tab.buttons["Invert"])
    driver.wait(lambda: edits.count == (edits.scene.opacities < 0.5).sum())
    driver.click(tab.buttons["Delete"])
    driver.wait(lambda: edits.scene is not edits.whole)
    save(driver, "filtered")  # without a suffix
    driver.rest()
    found["said"] = viewer.panel.status.text
    found["unsaved"] = [edits.unsaved]
    undo(driver)
    found["unsaved"].append(edits.unsaved)
    tab.low.vector_value, tab.high.vector_value = found["corners"]
    driver.click(tab.buttons["Crop"])
    driver.wait(lambda: edits.scene is not edits.whole)
    save(driver, "cropped.ply")
    driver.rest()
    undo(driver)
    tab.rule.selected_text = "outside the largest cluster"
    before = edits.count
    driver.click(tab.buttons["Select"])
    driver.wait(lambda: edits.count not in (0, before))
    driver.key("Delete")
    driver.wait(lambda: edits.scene is not edits.whole)
    Path("cluster.ply").write_bytes(b"old")
    save(driver, "cluster.ply")
    driver.rest()
    found["asked"] = Path("cluster.ply").read_bytes() == b"old"
    driver.click(replaces(driver.viewer.modal)[0])
    driver.wait(lambda: driver.viewer.modal.dialog is None)
    driver.rest()


def unsaved(driver: Driver, found: dict) -> None:
    """Open a scene in place of an edited one, and close the window."""
    viewer, path = driver.viewer, str(driver.folder / "b.egs")
    edits = viewer.editor.all[0]
    undo(driver)
    shown = []
    for choice in ("Cancel", "Discard the edits"):
        viewer.loading.open(path, 0)
        driver.tick(5)
        answer(driver, choice)
        driver.rest()
        shown.append((viewer.stage.scenes[0].name, edits.unsaved))
    found["opened"] = shown
    viewer.editor.do(lambda edits: edits.keep(np.arange(edits.scene.count) > 0, "test"))
    first, second = viewer.stage.scenes
    whole = viewer.editor.edits.whole
    viewer.loading.show([whole, second], viewer.visits.views, None)  # like other parts do
    answer(driver, "Cancel")
    found["kept"] = viewer.stage.scenes[0] is first is not whole
    viewer.window.close()
    driver.tick(5)
    found["asks"] = viewer.modal.dialog is not None
    driver.key("Escape")
    driver.wait(lambda: viewer.modal.dialog is None)
    viewer.window.close()
    frame = find(driver, "Discard the edits").frame
    driver.move(frame.x + frame.width / 2, frame.y + frame.height / 2)
    driver.xdotool("mousedown", 1)
    subprocess.run(["xdotool", "mouseup", "1"], check=True)
    found["closes"] = any(not driver.app.run_one_tick() for _ in range(200))


def run(folder: Path) -> dict:
    driver = Driver(folder, size=(900, 580))
    driver.rest()
    driver.viewer.panel.show("Edit")
    found: dict = {"corners": ((-1.5, -1.25, -1.0), (0.75, 1.0, 2.0))}
    regions(driver, found)
    steps(driver, found)
    saving(driver, found)
    unsaved(driver, found)
    return found


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # where scenes are saved
    tell(run(Path(sys.argv[1])))
