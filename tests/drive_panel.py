"""Use everything around the panes with mouse and keys, fly and focus; print the results.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from drive_viewer import Driver, tell
from open3d.visualization import gui

from viewer.scenes.edits import Edits
from viewer.scenes.pose import Pose
from viewer.scenes.view_request import Request
from viewer.window.dialogs import inside
from viewer.window.navigation import field_of_view


def told(pose: Pose) -> dict:
    """A pose as plain numbers."""
    return {
        "position": pose.position.tolist(),
        "rotation": pose.rotation.tolist(),
        "angle": field_of_view(pose),
    }


def middle(driver: Driver) -> tuple[int, int]:
    """The middle of the first pane, in window pixels."""
    frame = driver.viewer.stage.panes[0].widget.frame
    return frame.x + frame.width // 2, frame.y + frame.height // 2


def flights(driver: Driver) -> dict:
    """Poses before and after holding keys, with and without shift."""
    found = {}
    stage = driver.viewer.stage
    driver.move(*middle(driver))
    for key in ("w", "s", "a", "d", "q", "e"):
        driver.key("r")
        driver.rest()
        before = told(stage.pose)
        driver.xdotool("keydown", key)
        driver.tick(10)
        driver.xdotool("keyup", key)
        driver.rest()
        found[key] = [before, told(stage.pose)]
    still = stage.pose
    driver.tick(10)
    found["stops"] = stage.pose is still
    return found


def looks(driver: Driver) -> list:
    """Poses before and after a drag that looks around, and after the drag back."""
    viewer = driver.viewer
    driver.key("r")
    driver.rest()
    driver.key("v")
    poses = [told(viewer.stage.pose), viewer.choice.flying]
    driver.drag(viewer.stage.panes[0], back=False)
    poses.append(told(viewer.stage.pose))
    driver.key("v")
    driver.key("r")
    driver.rest()
    return poses


def focuses(driver: Driver) -> dict:
    """The centre after a double click next to it; the view after framing all."""
    viewer, stage = driver.viewer, driver.viewer.stage
    x, y = middle(driver)
    before, size = stage.pose, stage.picture_size
    at = stage.place(stage.panes[0], x + 20, y + 15)
    driver.move(x + 20, y + 15)
    driver.xdotool("click", "--repeat", 2, "--delay", 60, 1)
    driver.wait(lambda: stage.pose is not before)
    driver.rest()
    distance = stage.navigator.distance
    point = stage.pose.position + distance * stage.pose.rotation[2]
    focused = {"at": list(at), "was": before.project(point[None], *size)[0][0].tolist()}
    driver.key("g")
    driver.rest()
    scene = stage.scenes[0]
    pixels, depth = stage.pose.project(scene.positions[scene.opacities > 0.1], *size)
    left, top, right, bottom = stage.pose.framed(*size)
    inside = (
        (depth > 0) & (pixels >= (left, top)).all(axis=1) & (pixels < (right, bottom)).all(axis=1)
    )
    focused["framed"] = float(inside.mean())
    focused["where"] = viewer.visits.where
    return focused


def angles(driver: Driver) -> list[float]:
    """The field of view before and after its slider is dragged."""
    viewer = driver.viewer
    viewer.panel.show("View")
    driver.key("r")
    driver.rest()
    before = field_of_view(viewer.stage.pose)
    frame = viewer.panel.view.look.angle.frame
    driver.move(frame.x + frame.width * 0.6, frame.y + frame.height // 2)
    driver.xdotool("mousedown", 1)
    driver.move(frame.x + frame.width * 0.65, frame.y + frame.height // 2)
    driver.xdotool("mouseup", 1)
    driver.rest()
    return [before, field_of_view(viewer.stage.pose), viewer.visits.where]


def charts(driver: Driver) -> dict:
    """The charts at the bottom, and the effect of clicks in them."""
    viewer, found = driver.viewer, {}
    driver.key("r")
    driver.key("k")
    driver.wait(lambda: len(viewer.dock.survey.decibels) == len(viewer.visits.views.cameras))
    driver.rest()
    found["decibels"] = viewer.dock.survey.decibels
    frame = viewer.dock.canvas.widget.frame
    chart = viewer.dock.chart
    column = next(x for x in range(frame.width) if chart.view_at(x, frame.width) == chart.order[-1])
    driver.move(frame.x + column + 8, frame.y + frame.height - 40)
    driver.xdotool("mousedown", 1)
    driver.xdotool("mouseup", 1)
    driver.rest()
    found["best"], found["went"] = chart.order[-1], viewer.visits.number - viewer.visits.views.first
    driver.key("k")
    driver.wait(lambda: len(viewer.dock.survey.pictures) == len(viewer.visits.viewpoints))
    driver.rest()
    found["pictures"] = [float(np.std(image)) for image in viewer.dock.survey.pictures.values()]
    driver.move(frame.x + 20, frame.y + 20)
    driver.xdotool("mousedown", 1)
    driver.xdotool("mouseup", 1)
    driver.rest()
    found["first"] = viewer.visits.number
    driver.key("k")
    driver.key("k")
    found["histogram"] = histogram(driver)
    return found


def histogram(driver: Driver) -> dict:
    """The range selected by dragging in the opacity histogram."""
    viewer = driver.viewer
    driver.wait(lambda: hasattr(viewer.dock.chart, "scenes"))
    driver.rest()
    frame = viewer.dock.canvas.widget.frame
    driver.move(frame.x + 100, frame.y + 60)
    driver.xdotool("mousedown", 1)
    driver.move(frame.x + 200, frame.y + 60)
    driver.move(frame.x + 160, frame.y + 60)
    driver.xdotool("mouseup", 1)
    driver.rest()
    chart = viewer.dock.chart
    ends = [chart.value_at(x, frame.width) for x in (100, 160)]
    found = {"chosen": chart.chosen, "ends": ends, "name": chart.scenes[0].name}
    viewer.editor.do(Edits.invert)
    return found | {"afterwards": viewer.dock.chart.chosen}


def listed(driver: Driver) -> dict:
    """The list of views by PSNR, and the effect of a click on its second line."""
    viewer, tab = driver.viewer, driver.viewer.panel.view
    tab.order.selected_index = 2
    tab.refresh()
    driver.rest()
    frame = tab.list.frame
    driver.move(frame.x + 30, frame.y + 30)
    driver.xdotool("mousedown", 1)
    driver.xdotool("mouseup", 1)
    driver.rest()
    names = [viewer.visits.viewpoints[k].name for k in tab.places]
    return {"order": names, "went": viewer.visits.viewpoints[viewer.visits.number].name}


def opens(driver: Driver) -> dict:
    """The window after opening cameras, a report, photographs and the previous scene."""
    viewer, folder, found = driver.viewer, driver.folder, {}
    viewer.set_dock("nothing")
    entries = json.loads((folder / "cameras.json").read_text())[1:]
    (folder / "one.json").write_text(json.dumps(entries))
    viewer.loading.open_cameras(str(folder / "one.json"))
    driver.wait(lambda: len(viewer.visits.views.cameras) == 1)
    driver.rest()
    found["where"] = viewer.visits.where
    viewer.loading.open_cameras(str(folder / "cameras.json"))
    driver.wait(lambda: len(viewer.visits.views.cameras) == 2)
    viewer.loading.open_photographs(str(folder / "images"))
    driver.rest()
    found["photographed"] = viewer.visits.photographed
    viewer.loading.open_report(str(folder / "report" / "report.json"))
    driver.wait(lambda: viewer.stage.pruned is not None)
    driver.rest()
    found["layers"] = sorted(viewer.choice.layers)
    viewer.panel.show("Scene")
    driver.rest()
    viewer.loading.ask_recent()
    driver.tick(5)
    buttons = [w for w in inside(viewer.modal.dialog) if isinstance(w, gui.Button)]
    found["recent"] = [Path(button.text).name for button in buttons]
    before = viewer.modal.dialog
    driver.wait(lambda: buttons[0].frame.width > 0)
    driver.click(buttons[0])
    driver.wait(lambda: viewer.modal.dialog is not before)
    labels = [w.text for w in inside(viewer.modal.dialog) if isinstance(w, gui.Label)]
    found["asked"] = labels
    return found


def run(folder: Path) -> dict:
    request = Request(
        folder / "a.ply", folder / "b.egs", str(folder / "cameras.json"), size=(820, 620)
    )
    driver = Driver(folder, request=request)
    driver.rest()
    return {
        "flights": flights(driver),
        "looks": looks(driver),
        "focuses": focuses(driver),
        "angles": angles(driver),
        "charts": charts(driver),
        "listed": listed(driver),
        "opens": opens(driver),
    }


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
