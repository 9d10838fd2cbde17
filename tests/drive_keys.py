"""Presses keys of the viewer's window many times, and through its dialogs; prints what came of it.

Run by test_viewer_window.py, in a process of its own, on a display of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from drive_viewer import Driver, tell
from open3d.visualization import gui

from viewer.window.dialogs import inside


def many(driver: Driver) -> int:
    """How many keys are pressed while nothing waits for what they change."""
    pressed = 0
    for keys in ("mf", "nmf15", "mf5", "5fm", "p5mf"):
        for _ in range(8):
            for key in keys:
                driver.viewer.keys.press(ord(key))
                driver.tick(1 + pressed % 2, redraw=True)
                pressed += 1
    return pressed


def dialogs(driver: Driver) -> dict:
    """What keys do while a dialog is open, and after it."""
    viewer, found = driver.viewer, {}
    for end in ("Escape", "Return"):
        for key in ("h", "n", "m", "1", "q"):
            driver.key(key)
        found[f"before {end}"] = state(driver)
        driver.key(end)
        found[end] = state(driver)
    for name, end in (("quiet mnn", "Return"), ("q", "Escape")):
        driver.key("ctrl+s")
        driver.tick(5)
        field = next(w for w in inside(viewer.modal.dialog) if isinstance(w, gui.TextEdit))
        driver.click(field)
        driver.xdotool("type", name)
        driver.tick(5)
        found[f"typed {name}"] = state(driver), field.text_value
        driver.xdotool("keydown", end)  # as by a hand, which takes more than a frame
        driver.xdotool("keyup", end)
        driver.tick(5)
        found[f"{end} after {name}"] = state(driver)
    driver.rest()
    subprocess.run(["xdotool", "key", "Escape"], check=True)
    found["closes"] = any(not driver.app.run_one_tick() for _ in range(100))
    return found


def state(driver: Driver) -> list:
    """Whether a dialog is open; what keys change that are not for it."""
    choice = driver.viewer.choice
    is_open = driver.viewer.modal.dialog is not None
    return [is_open, driver.viewer.visits.number, choice.mode, sorted(choice.layers)]


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # where pictures are saved
    driver = Driver(Path(sys.argv[1]), images=Path(sys.argv[1]) / "images")
    driver.rest()
    found = {"pressed": many(driver)}
    driver.rest()
    found["first"] = state(driver)
    tell(found | dialogs(driver))
