"""Open a window without cameras, and print what it shows before and after estimating views.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

from drive_viewer import Driver, grab, tell

from viewer.scenes.view_request import Request
from viewer.scenes.viewpoints import Views
from viewer.window.loading import Loading
from viewer.window.panel import Panel


def run(folder: Path) -> dict:
    said: list[str] = []
    say = Panel.say

    def record(panel: Panel, text: str, progress: float | None = None) -> None:
        said.append(text)
        say(panel, text, progress)

    Panel.say = record
    go_on, first_views = threading.Event(), Loading._first_views

    def hold(*arguments: Any) -> Views:
        go_on.wait(60)
        return first_views(*arguments)

    Loading._first_views = hold
    driver = Driver(folder, request=Request(folder / "a.ply", size=(300, 560)))
    viewer = driver.viewer
    driver.wait(lambda: bool(viewer.visits.viewpoints))
    before = [0.0]

    def drawn() -> bool:
        viewer.window.post_redraw()
        before[0] = float(driver.scenes(grab(viewer.window)).std())
        return before[0] > 1

    driver.wait(drawn)
    found: dict = {"preview": [viewer.stage.painter.waits, before[0]]}
    go_on.set()
    driver.wait(lambda: viewer.visits.views.chosen)
    found["size"] = [viewer.window.size.width, viewer.window.size.height]
    found["where"] = [viewer.visits.where]
    driver.tick(3)  # wait for the layout
    found["at_first"] = driver.models()
    driver.wait(lambda: len(viewer.visits.viewpoints) > 1)
    found["said"] = list(said)
    found["where"].append(viewer.visits.where)
    found["after"] = driver.models()
    found["drawn"] = float(driver.scenes(driver.rest()).std())
    for key in ("n", "Home", "u"):
        driver.key(key)
        driver.rest()
        found[key] = driver.models()
        found["where"].append(viewer.visits.where)
    viewer.loading.open(str(folder / "b.egs"), 0)
    driver.wait(lambda: viewer.stage.scenes[0].name == "b.egs")
    found["other"] = [viewer.visits.number, viewer.visits.where, viewer.choice.up]
    driver.wait(lambda: len(viewer.visits.viewpoints) > 1)
    # A scene whose up axis is uncertain shows a note until another axis is chosen.
    viewer.visits.put(replace(viewer.visits.views, up_certain=False), 0)
    found["unsure"] = [viewer.panel.status.text]
    driver.key("u")
    found["unsure"].append(viewer.panel.status.text)
    return found


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
