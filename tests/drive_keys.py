"""Press keys of the viewer's window many times, also in its dialogs; print the results.

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


def many(driver: Driver) -> int:
    """Press many keys without waiting for their effects; return their number."""
    pressed = 0
    for keys in ("mf", "nmf15", "mf5", "5fm", "p5mf"):
        for _ in range(8):
            for key in keys:
                driver.viewer.keys.press(ord(key))
                driver.tick(1 + pressed % 2, redraw=True)
                pressed += 1
    return pressed


def resize(driver: Driver) -> int:
    """Resize the window many times while it lays out its parts; return the number of sizes."""
    window, rng = driver.viewer.window, np.random.default_rng(1)
    sizes = rng.integers((400, 300), (800, 520), (20, 2))
    for width, height in sizes.tolist():
        window.size = gui.Size(width, height)
        for _ in range(3):
            driver.tick(int(rng.integers(1, 4)), pause=0.002)
            driver.viewer.stage.arrange()
    window.size = gui.Size(480, 360)
    driver.rest()
    return len(sizes)


def dialogs(driver: Driver) -> dict:
    """The effect of keys while a dialog is open, and after it."""
    found: dict = {}
    for end in ("Escape", "Return"):
        for key in ("h", "n", "m", "1", "q"):
            driver.key(key)
        found[f"before {end}"] = state(driver)
        driver.key(end)
        found[end] = state(driver)
    for name, end in (("quiet mnn", "Return"), ("q", "Escape")):
        driver.key("ctrl+s")
        found[f"typed {name}"] = type_name(driver, name, end)
        found[f"{end} after {name}"] = state(driver)
    driver.rest()
    subprocess.run(["xdotool", "key", "Escape"], check=True)
    found["closes"] = any(not driver.app.run_one_tick() for _ in range(100))
    return found


def type_name(driver: Driver, name: str, end: str) -> tuple[list, str]:
    """Type a name into the open dialog, and a key; return the state in between, and the name."""
    field = driver.type_path(name)
    found = state(driver), field.text_value
    driver.key(end)
    driver.wait(lambda: driver.viewer.modal.dialog is None)
    return found


def state(driver: Driver) -> list:
    """Whether a dialog is open, and state that keys not meant for it would change."""
    choice = driver.viewer.choice
    is_open = driver.viewer.modal.dialog is not None
    return [is_open, driver.viewer.visits.number, choice.mode, sorted(choice.layers)]


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # pictures are saved there
    # A software driver is slow with large frames.
    driver = Driver(Path(sys.argv[1]), images=Path(sys.argv[1]) / "images", size=(632, 400))
    driver.rest()
    found: dict = {"resized": resize(driver), "pressed": many(driver)}
    found["first"] = state(driver)
    tell(found | dialogs(driver))
