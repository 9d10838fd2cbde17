"""Keys of the window."""

from __future__ import annotations

from collections.abc import Callable
from operator import methodcaller
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.scenes.choice import LAYERS
from viewer.scenes.edits import Edits
from viewer.window.controls import Controls

#: Step of the wipe line for a key, relative to the width.
_WIPE = 0.02

#: Flight directions of keys along the camera's axes (right, down, forward), and the factor for
#: shift.
_THRUSTS = {
    ord("w"): (0, 0, 1),
    ord("s"): (0, 0, -1),
    ord("a"): (-1, 0, 0),
    ord("d"): (1, 0, 0),
    ord("q"): (0, 1, 0),
    ord("e"): (0, -1, 0),
}
_FASTER = 4.0

_SHIFT = int(gui.KeyName.LEFT_SHIFT), int(gui.KeyName.RIGHT_SHIFT)
_CONTROL = int(gui.KeyName.LEFT_CONTROL), int(gui.KeyName.RIGHT_CONTROL)


class Key(NamedTuple):
    """A key and its action in a viewer; without code, an entry for the mouse or several keys.

    Help lists entries with a name. With shift, a key runs `shifted`, if set.
    """

    name: str
    what: str
    code: int | None = None
    action: Callable[[Controls], object] | None = None
    control: bool = False
    shifted: Callable[[Controls], object] | None = None


def _wipe(way: int) -> Callable[[Controls], object]:
    """An action that moves the wipe."""
    return lambda viewer: viewer.set_wipe(viewer.choice.wipe + way * _WIPE)


def _edit(letter: str, what: str, step: Callable[[Edits], None]) -> Key:
    """A key that, with ctrl, applies a step to the edited scene."""
    code = ord(letter.lower())
    return Key(f"ctrl + {letter}", what, code, lambda viewer: viewer.editor.do(step), control=True)


def _tool(letter: str, tool: str, what: str) -> Key:
    """A key that chooses a tool of the editor."""
    return Key(letter, what, ord(letter.lower()), lambda viewer: viewer.editor.set_tool(tool))


KEYS = (
    Key("drag", "turn the camera; while flying, look around"),
    Key("ctrl + drag, right drag", "pan"),
    Key("wheel up, down", "move closer, farther away"),
    Key("click, double click", "pick a Gaussian, centre it"),
    Key("W A S D, Q E", "fly forward, left, back, right, down, up; faster with shift"),
    Key(
        "V",
        "drags turn the camera, or look around",
        ord("v"),
        lambda v: v.set_flying(not v.choice.flying),
    ),
    Key("N, P", "next, previous view", ord("n"), lambda v: v.visits.go(1)),
    Key("", "", ord("p"), lambda v: v.visits.go(-1)),
    Key("R", "return to the view after moving away", ord("r"), lambda v: v.visits.reset()),
    Key("Home", "overview", int(gui.KeyName.HOME), lambda v: v.visits.overview()),
    Key("G", "show the whole scene", ord("g"), lambda v: v.frame_all()),
    Key("U", "next up axis", ord("u"), lambda v: v.visits.next_up()),
    Key("I", "add this view to the camera path", ord("i"), lambda v: v.timeline.keep()),
    Key(
        "space",
        "play the sequence or, without one, fly along the camera path; again: stop",
        ord(" "),
        lambda v: v.play(),
    ),
    Key("comma, period", "previous, next frame", ord(","), lambda v: v.player.go(-1)),
    Key("", "", ord("."), lambda v: v.player.go(1)),
    Key("Y", "measure distances by clicks, or pick", ord("y"), lambda v: v.measure()),
    Key("ctrl + N", "annotate by clicks, or pick", ord("n"), lambda v: v.annotate(), True),
    Key("T", "convert B: reverse its y and z axes", ord("t"), lambda v: v.loading.turn()),
    Key("M", "side by side, wipe, flip", ord("m"), lambda v: v.next_mode()),
    Key("F", "in one view, switch between A and B", ord("f"), lambda v: v.flip()),
    Key(
        "left, right",
        "move the line of the wipe, which can also be dragged",
        int(gui.KeyName.LEFT),
        _wipe(-1),
    ),
    Key("", "", int(gui.KeyName.RIGHT), _wipe(1)),
    Key(f"1 ... {len(LAYERS)}", ", ".join(LAYERS)),
    *(
        Key("", "", ord(str(number)), methodcaller("toggle", layer))
        for number, layer in enumerate(LAYERS, 1)
    ),
    Key("C", "colour centres by the next quantity", ord("c"), lambda v: v.next_colouring()),
    Key("K", "show the next chart below", ord("k"), lambda v: v.next_dock()),
    _tool("X", "box", "select by boxes; again: turn the camera"),
    _tool("L", "lasso", "select by lassos; again: turn the camera"),
    _tool("Z", "polygon", "select by polygons: click their corners, Enter closes"),
    Key("", "", int(gui.KeyName.ENTER), lambda v: v.editor.finish()),
    _tool("B", "brush", "select with a brush"),
    Key("[, ]", "smaller, larger brush", ord("["), lambda v: v.editor.resize_brush(-1)),
    Key("", "", ord("]"), lambda v: v.editor.resize_brush(1)),
    _tool("J", "sphere", "select by spheres around the Gaussian under the mouse"),
    Key("shift, ctrl, both + drag with these", "add to the selection, remove from it, intersect"),
    _edit("A", "select all", Edits.select_all),
    _edit("D", "select nothing", Edits.select_none),
    _edit("I", "invert the selection", Edits.invert),
    _edit("H", "hide the selection", Edits.hide),
    Key(
        "Delete",
        "delete the selection",
        int(gui.KeyName.DELETE),
        lambda v: v.editor.do(Edits.delete),
    ),
    Key(
        "ctrl + Z",
        "undo; with shift, redo",
        ord("z"),
        lambda v: v.editor.do(Edits.undo),
        True,
        lambda v: v.editor.do(Edits.redo),
    ),
    _edit("Y", "redo", Edits.redo),
    Key("O", "open a scene", ord("o"), lambda v: v.loading.ask_open()),
    Key("ctrl + R", "reload changed files", ord("r"), lambda v: v.loading.reload_all(), True),
    Key(
        "ctrl + S",
        "save a picture; with shift, the scene",
        ord("s"),
        lambda v: v.ask_save(),
        True,
        lambda v: v.editor.ask_save(),
    ),
    Key("Backspace", "stop loading", int(gui.KeyName.BACKSPACE), lambda v: v.loading.stop()),
    Key("H", "this help", ord("h"), lambda v: v.help()),
    Key("Esc", "close the dialog (Enter is OK), or clear the pick, or quit"),
    Key("ctrl + Q", "quit", ord("q"), lambda v: v.window.close(), control=True),
)

_KEYS = {(key.code, key.control): key for key in KEYS}


def help_text() -> str:
    """A line for each action of keys and mouse."""
    return "\n".join(f"{key.name}: {key.what}" for key in KEYS if key.name)


class Keys:
    """Handles the keys of a window, and tracks which are held.

    Parameters
    ----------
    viewer : Controls
    """

    def __init__(self, viewer: Controls) -> None:
        self._viewer = viewer
        self._held: set[int] = set()

    def event(self, event: gui.KeyEvent) -> bool:
        """Handle a key event; return whether it had any effect."""
        down, key = event.type == gui.KeyEvent.Type.DOWN, int(event.key)
        (self._held.add if down else self._held.discard)(key)
        if self._viewer.modal.key(event):
            self._held.clear()
            return True
        return down and self.press(key, bool(self._held.intersection(_CONTROL)))

    def press(self, key: int, control: bool = False) -> bool:
        """Run the action of a key; return whether it has one."""
        known = _KEYS.get((key, control))
        action = known and ((self.shifted and known.shifted) or known.action)
        if action is not None:
            action(self._viewer)
        return action is not None or key in _THRUSTS

    @property
    def shifted(self) -> bool:
        """Whether shift is held."""
        return bool(self._held.intersection(_SHIFT))

    @property
    def thrust(self) -> NDArray[np.float64] | None:
        """Flight direction of the held keys, along the camera's axes; None if none is held."""
        if self._held.intersection(_CONTROL):
            return None
        thrust = np.zeros(3)
        for key in self._held.intersection(_THRUSTS):
            thrust += _THRUSTS[key]
        if self.shifted:
            thrust *= _FASTER
        return thrust if thrust.any() else None
