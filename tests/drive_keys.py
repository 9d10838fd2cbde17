"""Presses keys of the viewer's window many times, and through its dialogs; prints what came of it.

Run by test_viewer_window.py, in a process of its own, on a display of its own.
"""

from __future__ import annotations

import sys
from pathlib import Path

from drive_viewer import Driver, tell


def many(driver: Driver) -> int:
    """How many keys are pressed while nothing waits for what they change."""
    pressed = 0
    for keys in ("mf", "nmf15", "mf5", "5fm", "p5mf"):
        for _ in range(20):
            for key in keys:
                driver.viewer.press(ord(key))
                driver.tick(1 + pressed % 2)
                pressed += 1
    return pressed


if __name__ == "__main__":
    driver = Driver(Path(sys.argv[1]), images=Path(sys.argv[1]) / "images")
    driver.rest()
    tell({"pressed": many(driver)})
