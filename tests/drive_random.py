"""Operate a window at random for some seconds by keys, mouse and sliders; print memory use.

Run by hand, on a separate display: ``python tests/drive_random.py FOLDER [SECONDS [SEED]]``, with
a.ply, b.egs, cameras.json and report in the folder.
"""

from __future__ import annotations

import faulthandler
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from drive_viewer import Driver, resident, tell
from open3d.visualization import gui

from viewer.window.dialogs import inside
from viewer.window.keys import KEYS

#: Keys to press: all with an effect, except quit.
_PRESSED = [(k.code, k.control) for k in KEYS if k.code is not None and k.name != "ctrl + Q"]

#: Widgets of the panel to click at random, except text fields.
_CLICKED = (gui.Checkbox, gui.Button, gui.Slider, gui.ListView, gui.Combobox)


class Monkey:
    """Does random things to a window.

    Attributes
    ----------
    done : dict of str to int
        Number of times each thing was done.
    """

    def __init__(self, driver: Driver, seed: int) -> None:
        self.driver, self.rng = driver, np.random.default_rng(seed)
        self.done: dict[str, int] = {}

    def step(self) -> None:
        """Do one random thing, and let the window run for some frames."""
        names = ["press", "click", "drag", "wheel", "click_panel", "load", "resize", "stop"]
        weights = np.array([5, 2, 4, 2, 5, 0.5, 0.3, 0.3])
        name = str(self.rng.choice(names, p=weights / weights.sum()))
        self.done[name] = self.done.get(name, 0) + 1
        getattr(self, name)()
        self.driver.tick(int(self.rng.integers(1, 6)), pause=0.005)
        if self.driver.viewer.modal.dialog is not None and self.rng.random() < 0.7:
            self.driver.key(str(self.rng.choice(["Escape", "Return"])))

    def _place(self) -> tuple[int, int]:
        """A random screen pixel inside the window."""
        frame = self.driver.viewer.window.os_frame
        x, y = self.rng.uniform(0.02, 0.98, 2)
        return int(frame.x + x * frame.width), int(frame.y + y * frame.height)

    def press(self) -> None:
        if self.driver.viewer.modal.dialog is None:
            self.driver.viewer.keys.press(*_PRESSED[int(self.rng.integers(len(_PRESSED)))])

    def click(self) -> None:
        repeat = int(self.rng.integers(1, 3))
        x, y = self._place()
        self.driver.xdotool("mousemove", x, y, "click", "--repeat", repeat, "--delay", 30, 1)

    def drag(self) -> None:
        button = int(self.rng.choice([1, 1, 1, 3]))
        self.driver.xdotool("mousemove", *self._place(), "mousedown", button)
        for _ in range(int(self.rng.integers(1, 5))):
            self.driver.xdotool("mousemove", *self._place())
        self.driver.xdotool("mouseup", button)

    def wheel(self) -> None:
        x, y = self._place()
        self.driver.xdotool("mousemove", x, y, "click", int(self.rng.choice([4, 5])))

    def click_panel(self) -> None:
        tabs = self.driver.viewer.panel.tabs
        if self.rng.random() < 0.3:
            tabs.selected_tab_index = int(self.rng.integers(len(tabs.get_children())))
            return
        tab = tabs.get_children()[tabs.selected_tab_index]
        widgets = [w for w in inside(tab) if isinstance(w, _CLICKED) and w.visible and w.enabled]
        if widgets:
            frame = widgets[int(self.rng.integers(len(widgets)))].frame
            x, y = self.rng.uniform(0.1, 0.9, 2)
            self.driver.move(frame.x + x * frame.width, frame.y + y * frame.height)
            self.driver.xdotool("click", 1)

    def load(self) -> None:
        names = ["a.ply", "b.egs", "cameras.json", "report/report.json"]
        name = str(self.rng.choice(names))
        loading, path = self.driver.viewer.loading, str(self.driver.folder / name)
        if self.driver.viewer.modal.dialog is not None:
            return
        if name == "cameras.json":
            loading.open_cameras(path)
        elif name.startswith("report"):
            loading.open_report(path)
        else:
            loading.open(path, int(self.rng.integers(2)))

    def resize(self) -> None:
        width, height = self.rng.integers((400, 300), (1200, 780))
        self.driver.viewer.window.size = gui.Size(int(width), int(height))

    def stop(self) -> None:
        self.driver.viewer.loading.stop()


def run(folder: Path, seconds: float, seed: int) -> dict:
    driver = Driver(folder, size=(900, 600))
    driver.rest()
    monkey = Monkey(driver, seed)
    memory, begun = [resident()], time.monotonic()
    while time.monotonic() - begun < seconds:
        monkey.step()
        if time.monotonic() - begun > len(memory) * seconds / 20:
            memory.append(resident())
    while driver.viewer.modal.dialog is not None:
        driver.key("Escape")
        driver.tick(5)
    driver.rest()
    for edits in driver.viewer.editor.all:
        edits.mark_saved(edits.scene)  # otherwise closing would ask to save
    return {"memory": memory, "done": monkey.done, "closes": closes(driver)}


def closes(driver: Driver) -> bool:
    """Whether the window closes on request, discarding unsaved edits."""
    driver.viewer.window.close()
    for _ in range(100):
        if not driver.app.run_one_tick():
            return True
        dialog = driver.viewer.modal.dialog  # not earlier, because the tick may have freed it
        buttons = [w for w in inside(dialog) if isinstance(w, gui.Button)] if dialog else []
        for button in buttons:
            if button.text.startswith("Discard"):
                driver.move(button.frame.x + 10, button.frame.y + 10)
                driver.xdotool("mousedown", 1)
                subprocess.run(["xdotool", "mouseup", "1"], check=True)
    return False


if __name__ == "__main__":
    faulthandler.enable()  # Open3D may end the process
    numbers = [float(each) for each in sys.argv[2:]]
    os.chdir(sys.argv[1])  # pictures are saved there
    seconds, seed = [*numbers, *(20.0, 1.0)[len(numbers) :]]
    tell(run(Path(sys.argv[1]).absolute(), seconds, int(seed)))
