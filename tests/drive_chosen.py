"""Opens a window without cameras, and prints what it shows before and after views are chosen.

Run by test_viewer_window.py, in a process of its own, on a display of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from drive_viewer import Driver, tell

from viewer.scenes.request import Request
from viewer.window.panel import Panel


def run(folder: Path) -> dict:
    said: list[str] = []
    say = Panel.say

    def record(panel: Panel, text: str, progress: float | None = None) -> None:
        said.append(text)
        say(panel, text, progress)

    Panel.say = record
    driver = Driver(folder, request=Request(folder / "a.ply", size=(640, 320)))
    viewer = driver.viewer
    driver.wait(lambda: bool(viewer.visits.viewpoints))
    found: dict = {"where": [viewer.visits.where]}
    driver.wait(lambda: np.ptp(driver.models()) > 1)  # laid out
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
    return found


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
