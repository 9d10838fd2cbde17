"""Drive the viewer's window while jobs run, or fail; print what is kept.

Run by test_viewer_kept.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path

from drive_viewer import Driver, tell

from viewer.scenes.worker import Stale, Worker


def held(worker: Worker) -> threading.Event:
    """Keep a thread busy until the event is set."""
    started, go_on = threading.Event(), threading.Event()

    def wait(stale: Stale) -> None:
        started.set()
        go_on.wait(60)

    worker.submit("held", wait, print, print)
    started.wait(60)
    return go_on


def saves(driver: Driver) -> list[bool]:
    """Whether files exist that were saved one after the other, while threads were busy."""
    viewer, paths = (
        driver.viewer,
        [driver.folder / name for name in ("1.ply", "2.ply", "1.png", "2.png")],
    )
    events = [held(viewer.worker), held(viewer.editor.worker)]
    for path in paths:
        (viewer.editor.save if path.suffix == ".ply" else viewer.save)(str(path))
    for event in events:
        event.set()
    driver.rest()
    return [path.exists() for path in paths]


if __name__ == "__main__":
    driver = Driver(Path(sys.argv[1]))
    driver.rest()
    tell({"saves": saves(driver)})
