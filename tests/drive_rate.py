"""Encode a scene in the viewer's window, in several ways, and print the results.

Run by test_viewer_more.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drive_viewer import Driver, give_up, tell

from viewer.scenes.opened import Progress
from viewer.scenes.trial_list import EncodingSettings, Trials
from viewer.scenes.view_request import Request

#: Maximum seconds of an encode on a busy machine that compiles kernels.
_PATIENCE = 240


class Rates:
    """Clicks in the tab of rates."""

    def __init__(self, driver: Driver) -> None:
        self.driver, self.encoding = driver, driver.viewer.encoding
        self.tab = driver.viewer.panel.rate
        self.begun: list[EncodingSettings] = []
        encode = self.encoding.encode

        def begin(settings: EncodingSettings) -> None:
            self.begun.append(settings)
            encode(settings)

        self.encoding.encode = begin

    def wait(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + _PATIENCE
        while not done():
            if time.monotonic() > end:
                give_up(f"never done: {self.encoding.doing}, {self.driver.viewer.message}")
            self.driver.tick(2)

    def encode(self) -> None:
        """Click on Encode."""
        before = len(self.begun)
        self.driver.click(self.tab.start)
        self.wait(lambda: len(self.begun) > before)

    def finish(self) -> None:
        """Wait until everything is encoded and measured."""
        self.wait(lambda: self.encoding.doing is None)
        self.driver.rest()

    def choose(self, profile: str, wish: int, value: float | None = None) -> None:
        """Set the options of an encode without the mouse."""
        self.tab.profile.selected_text, self.tab.wish.selected_index = profile, wish
        self.tab.refresh()
        if value is not None:
            self.tab.number.double_value = value
            self.tab.set_value(value)
        self.driver.tick(3, redraw=True)

    def slide(self) -> None:
        """Drag the slider from its left end to a quarter of its width."""
        frame, corner = self.tab.slider.frame, self.driver.viewer.window.os_frame
        y = corner.y + frame.y + frame.height // 2
        self.driver.xdotool("mousemove", corner.x + frame.x + 10, y, "mousedown", 1)
        for share in (0.1, 0.2, 0.25):
            self.driver.xdotool("mousemove", corner.x + frame.x + round(share * frame.width), y)
        self.driver.xdotool("mouseup", 1)
        self.driver.tick(3, redraw=True)

    def select(self, line: int) -> None:
        """Click on a line of the list."""
        frame, em = self.tab.list.frame, self.driver.viewer.window.theme.font_size
        self.driver.move(frame.x + 60, frame.y + (line + 0.5) * 1.25 * em)
        self.driver.xdotool("mousedown", 1)
        self.driver.xdotool("mouseup", 1)
        self.wait(lambda: self.tab.list.selected_index == line)

    def files(self) -> list[str]:
        """Names of the trial files."""
        return sorted(path.name for path in self.encoding.trials.folder.iterdir())

    def state(self) -> dict[str, Any]:
        """The visible state, and messages."""
        names = [scene.name for scene in self.driver.viewer.stage.scenes]
        return {"names": names, "lines": self.tab.lines, "told": self.tab.numbers_text}


def encodings(rates: Rates) -> dict:
    """Encode with a profile; to a size set by the slider; stop one; and one out of reach."""
    driver, viewer = rates.driver, rates.driver.viewer
    found: dict = {"empty": rates.state()}
    rates.encode()
    rates.finish()
    found["m"] = rates.state()
    rates.choose("s", 2)
    rates.slide()
    found["bits"] = rates.tab.settings.value
    rates.encode()
    rates.finish()
    found["sized"] = rates.state()
    found["quality"] = viewer.stage.quality
    found |= stop(rates)
    found["coarsest"] = []
    for number in (100.0, 100.0, 0.001, 1.0):
        rates.choose("m", 0, number)
        found["coarsest"].append([rates.tab.number.double_value, rates.tab.settings.value])
    rates.choose("m", 1, 0.001)
    rates.encode()
    rates.wait(lambda: viewer.message is not None)
    found["refused"] = viewer.message
    driver.key("Escape")
    driver.rest()
    return found


def stop(rates: Rates) -> dict:
    """The display while a scene is encoded, and what is left after Cancel."""
    driver, visits, encode = rates.driver, rates.driver.viewer.visits, Trials.encode
    started, go_on = threading.Event(), threading.Event()

    def held(trials: Trials, settings: EncodingSettings, progress: Progress) -> Any:
        def slow(stage: str, done: int, total: int) -> None:
            progress(stage, done, total)
            started.set()
            go_on.wait(_PATIENCE)

        return encode(trials, settings, slow)

    Trials.encode = held  # type: ignore[method-assign, assignment]
    rates.choose("l", 0)
    rates.encode()
    rates.wait(lambda: started.is_set() and ":" in (rates.encoding.doing or "?")[0])
    found: dict = {"doing": rates.encoding.doing[0]}
    driver.key("n")
    driver.rest()
    found["meanwhile"] = [visits.number, rates.encoding.encodes]
    driver.click(rates.tab.stop)
    rates.wait(lambda: rates.encoding.doing is None)
    go_on.set()
    rates.wait(lambda: not rates.encoding.worker.busy)
    Trials.encode = encode  # type: ignore[method-assign]
    driver.rest()
    return found | {"stopped": rates.state(), "files": rates.files()}


def history(rates: Rates) -> dict:
    """Trials in both panes, one of them saved, and the source again."""
    driver, viewer = rates.driver, rates.driver.viewer
    found: dict = {}
    rates.select(2)
    driver.click(rates.tab.as_a)
    rates.wait(lambda: rates.encoding.letters(1) == "A")
    driver.rest()
    found["both"] = rates.state() | {"quality": viewer.stage.quality, "at": viewer.visits.number}
    driver.click(rates.tab.save)
    driver.type_path("saved")
    driver.key("Return")
    rates.wait((driver.folder / "saved.egs").exists)
    driver.rest()
    rates.select(0)
    driver.click(rates.tab.as_a)
    rates.wait(lambda: rates.encoding.letters(0) == "A")
    driver.rest()
    found["back"] = rates.state()
    return found


def run(folder: Path) -> dict:
    cameras = str(folder / "cameras.json")
    request = Request(folder / "a.ply", cameras=cameras, view=0, size=(760, 480))
    driver = Driver(folder, request=request)
    driver.rest()
    driver.viewer.panel.show("Rate")
    driver.tick(3, redraw=True)
    rates = Rates(driver)
    found = encodings(rates) | history(rates)
    files = rates.encoding.trials.folder.parent
    found["left"] = [files.exists()]
    subprocess.run(["xdotool", "key", "Escape"], check=True)
    found["closes"] = any(not driver.app.run_one_tick() for _ in range(100))
    found["left"].append(files.exists())
    return found


if __name__ == "__main__":
    os.chdir(sys.argv[1])  # the trial is saved there
    tell(run(Path(sys.argv[1])))
