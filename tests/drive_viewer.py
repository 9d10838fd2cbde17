"""Drive a real viewer window with a mouse and keys, and print the results as JSON.

Run by test_viewer_window.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NoReturn

import numpy as np
from open3d.visualization import gui
from PIL import ImageGrab

from viewer.scenes.view_request import Request
from viewer.window.dialogs import inside
from viewer.window.main_window import Viewer
from viewer.window.pane import Pane
from viewer.window.panel import divided


def grab(window: gui.Window) -> np.ndarray:
    """Screenshot of a window, RGB."""
    frame = window.os_frame
    box = (frame.x, frame.y, frame.get_right(), frame.get_bottom())
    return np.asarray(ImageGrab.grab(box).convert("RGB"), np.int16)


def resident() -> float:
    """Resident memory, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def tell(found: dict) -> NoReturn:
    """Print the results and exit; Open3D cannot shut down properly outside Application.run."""
    print("RESULT " + json.dumps(found), flush=True)
    os._exit(0)


def die(*error: Any) -> NoReturn:
    """Exit after an exception; see `tell`."""
    traceback.print_exception(*error)
    os._exit(1)


sys.excepthook = die


def give_up(reason: str) -> NoReturn:
    """Exit with the reason of a failure; see `tell`."""
    traceback.print_stack()
    print(reason, file=sys.stderr, flush=True)
    os._exit(1)


class Driver:
    def __init__(
        self,
        folder: Path,
        images: Path | None = None,
        size: tuple[int, int] = (760, 480),
        request: Request | None = None,
        device: Literal["gpu", "cpu"] = "cpu",
    ) -> None:
        self.folder = folder
        self.app = gui.Application.instance
        self.app.initialize()
        request = request or Request(
            folder / "a.ply",
            folder / "b.egs",
            cameras=str(folder / "cameras.json"),
            images=images,
            pruned=folder / "report",
            layers=("splats",),
            size=size,
        )
        self.viewer = Viewer(request, device)
        self.begun = False

    def tick(self, count: int = 1, pause: float = 0.01, redraw: bool = False) -> None:
        """Let the window process events; with `redraw`, force it to draw frames."""
        for _ in range(count):
            if redraw:
                self.viewer.window.post_redraw()
            if not self.app.run_one_tick():
                give_up("the window has closed")  # using a closed window would crash
            time.sleep(pause)

    def rest(self) -> np.ndarray:
        """Tick until the window is stable; return its screenshot."""
        before, equal = None, 0
        for _ in range(2000):
            if self.viewer.busy or not self.viewer.stage.panes:
                self.tick()
                before = None
                continue
            # Few frames, because a software driver is slow.
            self.tick(1, pause=0.09, redraw=True)
            now = grab(self.viewer.window)
            # A frame may be pending: a software driver on a busy machine is slow, most of all with
            # the first.
            self.begun = self.begun or np.ptp(self.scenes(now)) > 0
            same = self.begun and before is not None and np.array_equal(now, before)
            equal = equal + 1 if same else 0
            if equal == 2:
                return now
            before = now
        return give_up("the window never rests")

    def scenes(self, image: np.ndarray) -> np.ndarray:
        """The part of the window without the panel and captions."""
        viewer = self.viewer
        _, room = divided(viewer.window.content_rect, viewer.window.theme.font_size)
        right = room.get_right() - 4  # exclude round corners
        return image[viewer.stage.caption_height : room.get_bottom(), :right]

    def xdotool(self, *arguments: object) -> None:
        subprocess.run(["xdotool", *map(str, arguments)], check=True)
        self.tick(2)

    def move(self, x: float, y: float) -> None:
        frame = self.viewer.window.os_frame
        self.xdotool("mousemove", frame.x + round(x), frame.y + round(y))

    def toggle(self, layer: str) -> None:
        """Click on a layer's checkbox, and wait for its effect."""
        viewer = self.viewer
        wanted = viewer.choice.layers ^ {layer}
        self.click(viewer.panel.scene.boxes[layer])
        self.wait(lambda: viewer.choice.layers == wanted)

    def wait(self, done: Callable[[], bool]) -> None:
        """Tick until the effect of a click is visible."""
        end = time.monotonic() + 60
        while time.monotonic() < end:
            if done():
                return
            self.tick(2)
        give_up("a click does not come through")

    def type_path(self, text: str) -> gui.TextEdit:
        """Type a path into the dialog that opens; return its field."""
        self.wait(lambda: self.viewer.modal.dialog is not None)
        field = next(w for w in inside(self.viewer.modal.dialog) if isinstance(w, gui.TextEdit))
        self.xdotool("type", text)
        self.wait(lambda: field.text_value == text)
        return field

    def click(self, widget: gui.Widget) -> None:
        frame = widget.frame
        self.move(frame.x + frame.height / 2, frame.y + frame.height / 2)
        self.xdotool("mousedown", 1)
        self.xdotool("mouseup", 1)

    def drag(self, pane: Pane, button: int = 1, events: int = 5, back: bool = True) -> list:
        """Drag a pane by (60, 20) from its middle, in `events` events, and back; return cameras."""
        frame, corner = pane.widget.frame, self.viewer.window.os_frame
        x, y = corner.x + frame.get_left() + frame.width // 2, corner.y + frame.height // 2
        steps = [
            (x + round(60 * k / events), y + round(20 * k / events)) for k in range(events + 1)
        ]
        self.xdotool("mousemove", *steps[0], "mousedown", button)
        models = []
        for way in (steps[1:], steps[-2::-1]) if back else (steps[1:],):
            moves = [("mousemove", *step, "sleep", 0.01) for step in way]
            process = subprocess.Popen(["xdotool", *map(str, itertools.chain(*moves))])
            while process.poll() is None:  # frames are drawn between the events
                self.tick()
            self.tick(3)
            self.wait(lambda: self.viewer.stage.seen is self.viewer.stage.pose)
            models.append(self.models())
        self.xdotool("mouseup", button)
        return models

    def drags(self, numbers: tuple[int, ...], button: int = 1, key: str = "") -> list[list]:
        """The cameras at first, and after the same drag forth and back in each number of events."""
        models = [[self.models()]]
        for events in numbers:
            if key:
                self.xdotool("keydown", key)
            models.append(self.drag(self.viewer.stage.panes[events % 2], button, events))
            if key:
                self.xdotool("keyup", key)
        return models

    def key(self, name: str) -> None:
        self.xdotool("key", name)

    def models(self) -> list[list]:
        return [
            np.array(p.widget.scene.camera.get_model_matrix()).tolist()
            for p in self.viewer.stage.panes
        ]


def outlined(driver: Driver, image: np.ndarray) -> list[float]:
    """Share of the upper side of the frame's outline that is visible in each picture."""
    stage, shares = driver.viewer.stage, []
    if driver.viewer.choice.mode == "side":
        frames = [pane.widget.frame for pane in stage.visible]
    else:
        pane = stage.visible[0].widget.frame
        frames = [gui.Rect(pane.x, pane.y, *stage.size)]
    for frame in frames:
        left, top, right, _ = map(round, stage.pose.framed(frame.width, frame.height))
        rows = image[frame.y + top - 2 : frame.y + top + 3, frame.x + left : frame.x + right]
        shares.append(float((rows.min(axis=2).max(axis=0) > 200).mean()))
    return shares


def slide(driver: Driver) -> float:
    """Position of a wipe after dragging its line 60 pixels to the right."""
    frame, corner = driver.viewer.stage.divider.widget.frame, driver.viewer.window.os_frame
    x, y = corner.x + frame.get_left() + frame.width // 2, corner.y + frame.get_bottom() - 20
    driver.xdotool("mousemove", x, y, "mousedown", 1)
    for step in (20, 40, 60):
        driver.xdotool("mousemove", x + step, y)
    driver.xdotool("mouseup", 1)
    driver.rest()
    return driver.viewer.choice.wipe


def views(driver: Driver, found: dict) -> None:
    """Step through views, and flip two scenes."""
    viewer = driver.viewer
    driver.key("n")
    driver.rest()
    found["number"] = viewer.visits.number
    driver.key("p")
    driver.rest()
    found["back"] = driver.models()
    driver.key("Home")
    driver.rest()
    found["where"].append(viewer.visits.where)
    driver.key("n")
    driver.rest()
    driver.toggle("error")
    driver.key("f")
    a = driver.rest()
    found["flipped"] = [viewer.stage.captions[0].text]
    found["front_first"] = viewer.choice.front
    driver.key("f")
    b = driver.rest()
    found["outlined"] += outlined(driver, a) + outlined(driver, b)
    found["flipped"].append(viewer.stage.captions[0].text)
    found["flip_changed"] = int((np.abs(driver.scenes(a) - driver.scenes(b)) > 12).sum())


def wipes(driver: Driver, found: dict) -> None:
    """Wipe between two scenes, and save a picture."""
    viewer, folder = driver.viewer, driver.folder
    viewer.set_mode("wipe")
    wiped = driver.rest()
    found["outlined"] += outlined(driver, wiped)
    half = driver.scenes(wiped)
    found["wiped_quality"] = viewer.stage.quality
    found["dragged"], found["wide"] = slide(driver), viewer.stage.size[0]
    viewer.set_wipe(0.2)
    fifth = driver.scenes(driver.rest())
    found["line"] = int(fifth[-20:, viewer.stage.divider.widget.frame.x + 1].min())
    columns = np.flatnonzero((np.abs(half - fifth) > 12).any(axis=(0, 2))) / half.shape[1]
    found["wipe_changed"] = [float(columns.min()), float(columns.max())]
    viewer.save(str(folder / "saved.png"))
    driver.rest()


def run(folder: Path) -> dict:
    driver = Driver(folder, size=(672, 320))
    viewer = driver.viewer
    found: dict = {}
    first = driver.rest()
    found["drawn"] = float(driver.scenes(first).std())
    found["quality"] = viewer.stage.quality
    found["speed"] = viewer.panel.speed.text
    found["captions"] = [label.text for label in viewer.stage.captions]
    found["where"] = [viewer.visits.where]
    found["outlined"] = outlined(driver, first)
    viewer.help()
    driver.tick(10, redraw=True)
    driver.key("Escape")
    driver.wait(lambda: viewer.modal.dialog is None)
    found["ghosts"] = int((driver.rest() != first).sum())
    found["at_first"] = driver.models()
    driver.drag(viewer.stage.panes[0], back=False)
    moved = driver.rest()
    found["after_drag"] = driver.models()
    found["drag_changed"] = int((np.abs(driver.scenes(moved) - driver.scenes(first)) > 12).sum())
    found["where"].append(viewer.visits.where)
    driver.key("r")
    driver.rest()
    found["where"].append(viewer.visits.where)
    found["drags"] = driver.drags((1, 5, 50))
    views(driver, found)
    wipes(driver, found)
    driver.key("m")
    driver.rest()
    found["mode"] = viewer.choice.mode
    return found


if __name__ == "__main__":
    tell(run(Path(sys.argv[1])))
