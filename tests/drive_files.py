"""Drive the file dialogs of the viewer's window; print the results.

Run by test_viewer_window.py, in a separate process and on a separate display.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np
from drive_viewer import Driver, grab, tell
from open3d.visualization import gui

from gs_codec.runtime import compiling
from viewer.pictures.picture import picture
from viewer.scenes.recent import remember
from viewer.scenes.view_request import Request
from viewer.window.dialogs import inside
from viewer.window.x11 import Keyboard


def said(driver: Driver) -> list[str]:
    """What the open dialog shows: the text in its field, labels, and its first button."""
    dialog = driver.viewer.modal.dialog
    if dialog is None:
        return []
    widgets = list(inside(dialog))
    fields = [w.text_value for w in widgets if isinstance(w, gui.TextEdit)]
    labels = [" ".join(w.text.split()) for w in widgets if isinstance(w, gui.Label)]
    buttons = [w.text for w in widgets if isinstance(w, gui.Button) and w.text != "Open folder"]
    return [*fields, *filter(None, labels), buttons[0]]


def enter(driver: Driver, text: str, key: str = "Return") -> list[str]:
    """What the dialog shows after a text and a key; nothing once it has closed."""
    if text:
        driver.type_path(text)
    before = said(driver)
    driver.key(key)
    driver.wait(lambda: said(driver) != before)
    return said(driver)


def opens(driver: Driver) -> dict:
    """Open scenes by all kinds of paths, valid and invalid."""
    viewer, found = driver.viewer, {}
    wrong = ("none.ply", "folder/none.ply", "empty.ply", "pipe.ply", "folder")
    for name in wrong:
        driver.key("o")
        driver.wait(lambda: bool(said(driver)))
        found[name] = enter(driver, name)
        enter(driver, "", "Escape")
    driver.key("o")
    found["damaged"] = enter(driver, "damaged.ply")
    driver.wait(lambda: viewer.message is not None)
    found["message"] = viewer.message
    viewer.dismiss()
    driver.key("o")
    driver.wait(lambda: bool(said(driver)))
    driver.tick(20)  # until the field accepts keys
    driver.key("ctrl+v")
    driver.wait(lambda: said(driver)[0].startswith("file:"))
    found["pasted"] = enter(driver, "")
    driver.rest()
    odd = str(driver.folder / os.fsdecode(b"\xff.ply"))
    viewer.loading.open(odd)
    driver.rest()
    found["scenes"] = [scene.name for scene in viewer.stage.scenes]
    found["captions"] = [label.text for label in viewer.stage.captions]
    viewer.loading.ask_recent()
    found["recent"] = said(driver)
    driver.key("Escape")
    driver.wait(lambda: not said(driver))
    viewer.fail(OSError(2, "No such file or directory", odd))
    found["odd"] = said(driver)
    viewer.dismiss()
    return found


def saves(driver: Driver) -> dict:
    """Save pictures under the suggested name, an existing name, and an invalid one."""
    found: dict = {}
    driver.key("ctrl+s")
    driver.wait(lambda: bool(said(driver)))
    found["suggested"] = said(driver)
    found["saved"] = enter(driver, "")
    driver.rest()
    written = Path("a.png").stat().st_mtime_ns
    for name in ("a.jpg", "none/a.png"):
        driver.key("ctrl+s")
        found[name] = enter(driver, name)
        enter(driver, "", "Escape")
    driver.key("ctrl+s")
    driver.wait(lambda: bool(said(driver)))
    found["again"] = said(driver)
    found["exists"] = enter(driver, "a")
    driver.rest()
    found["kept"] = Path("a.png").stat().st_mtime_ns == written
    found["replaced"] = enter(driver, "")
    driver.rest()
    found["written"] = Path("a.png").stat().st_mtime_ns != written
    return found


def resized(driver: Driver) -> float:
    """Share of a pane's pixels that differ from its picture after a resize."""
    stage = driver.viewer.stage
    driver.viewer.window.size = gui.Size(620, 300)
    share = 1.0
    for _ in range(20):  # on a busy machine, a new size takes long to reach the screen
        driver.tick(10, redraw=True)
        screen, frame, size = driver.rest(), stage.panes[0].widget.frame, stage.picture_size
        drawn = picture(stage.views, stage.scenes[0], stage.pose, *size, stage.shown, 1)
        shown = screen[frame.y : frame.get_bottom(), frame.x : frame.get_right()]
        apart = np.abs(shown - np.rint(255 * drawn[:, : shown.shape[1]])).max(axis=2)
        share = float((apart > 2).mean())
        if share < 0.05:
            break
    return share


def narrow(driver: Driver) -> dict:
    """What a narrow window cuts off, and heights of the scrolling parts of tabs."""
    viewer, found = driver.viewer, {}
    viewer.window.size = gui.Size(400, 480)
    tabs = viewer.panel.tabs
    driver.wait(lambda: viewer.window.post_redraw() or tabs.frame.get_right() == 400)
    driver.rest()
    parts = [w for w in inside(tabs) if isinstance(w, gui.ScrollableVert)]
    found["parts"] = [part.frame.height for part in parts]
    buttons = [w for w in inside(tabs) if isinstance(w, gui.Button | gui.Checkbox)]
    found["buttons"] = len(buttons)
    found["cut"] = [w.frame.get_right() for w in buttons if w.frame.get_right() > 400]
    found["panes"] = [pane.widget.frame.width for pane in viewer.stage.visible]
    return found


def ghosts(driver: Driver) -> int:
    """Number of screen values that differ after a dialog was open in an empty window."""
    before = still(driver)
    driver.key("h")
    driver.wait(lambda: bool(said(driver)))
    driver.tick(10, redraw=True)
    driver.key("Escape")
    driver.wait(lambda: not said(driver))
    return int((still(driver) != before).sum())


def still(driver: Driver) -> np.ndarray:
    """Screenshot of a window without scenes, once it no longer changes."""
    now = grab(driver.viewer.window)
    for _ in range(100):
        before = now
        driver.tick(10, redraw=True)
        now = grab(driver.viewer.window)
        if (now == before).all():
            break
    return now


def notices(driver: Driver) -> list[str]:
    """Notices over the panes while the window is empty, and while kernels are compiled."""
    notice = driver.viewer.notice.label
    driver.wait(lambda: notice.visible)
    lines = [notice.text]
    compiling._Compiled.begun = time.monotonic() - 5
    driver.wait(lambda: notice.text != lines[0])
    lines.append(notice.text)
    compiling._Compiled.begun = None
    driver.wait(lambda: notice.text == lines[0])
    return lines


def starts(driver: Driver) -> list[list]:
    """The buttons of the empty window, and the dialog that the first opens."""
    buttons = driver.viewer.start.buttons
    shown = [button.text for button in buttons if button.visible]
    driver.click(buttons[0])
    driver.wait(lambda: bool(said(driver)))
    dialog = said(driver)
    enter(driver, "", "Escape")
    return [shown, dialog]


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    os.chdir(folder)
    os.environ["HOME"] = str(folder)
    remember(folder / "b.egs")
    Keyboard.clipboard = lambda self: f"file://{folder}/a.ply\n"
    driver = Driver(folder, request=Request(None, size=(592, 360)))
    driver.tick(5, redraw=True)
    driver.move(100, 100)
    found = {"ghosts": ghosts(driver), "notices": notices(driver)}
    found["starts"] = starts(driver)
    found |= opens(driver) | saves(driver)
    found["resized"] = resized(driver)
    tell(found | {"narrow": narrow(driver)})
