"""Dialogs of the window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from open3d.visualization import gui

from viewer.layers import LAYERS
from viewer.panel import folded

#: Longest line of a dialog, characters.
_WIDTH = 76

_KEYS = (
    ("drag", "turn"),
    ("ctrl + drag, right drag", "shift"),
    ("wheel up, down", "come nearer, go away"),
    ("N, P", "next, previous camera"),
    ("M", "side by side, wipe, flip"),
    ("F", "in one view: A or B"),
    ("left, right", "move the wipe"),
    ("1 ... 5", ", ".join(LAYERS)),
    ("C", "what centres are coloured by"),
    ("O", "open a scene"),
    ("S", "save a picture"),
    ("Backspace", "stop loading"),
    ("H", "this help"),
    ("Q, Esc", "quit"),
)

HELP = "\n".join(f"{keys}: {what}" for keys, what in _KEYS)


def show_message(window: gui.Window, title: str, text: str, closed: Callable[[], None]) -> None:
    """Show a text with a button that is to close it."""
    em = window.theme.font_size
    dialog = gui.Dialog(title)
    box = gui.Vert(0.5 * em, gui.Margins(em, em, em, em))
    for line in [title, *folded(text, _WIDTH)]:
        box.add_child(gui.Label(line))
    button = gui.Button("OK")
    button.set_on_clicked(closed)
    row = gui.Horiz()
    row.add_stretch()
    row.add_child(button)
    row.add_stretch()
    box.add_child(row)
    dialog.add_child(box)
    window.show_dialog(dialog)


def ask_open(window: gui.Window, then: Callable[[str], None]) -> None:
    """Ask for a scene's file."""
    kind = (".ply .egs .splat .spz .sog", "3DGS scenes")
    _ask(window, gui.FileDialog.OPEN, "Open a scene", kind, then)


def ask_save(window: gui.Window, then: Callable[[str], None]) -> None:
    """Ask where to write a picture."""
    kind = (".png", "PNG images (.png)")
    _ask(window, gui.FileDialog.SAVE, "Save a picture", kind, then)


def _ask(
    window: gui.Window,
    purpose: Any,
    title: str,
    kind: tuple[str, str],
    then: Callable[[str], None],
) -> None:
    """Ask for a file of a kind, its suffixes and their description."""
    dialog = gui.FileDialog(purpose, title, window.theme)
    dialog.add_filter(*kind)
    dialog.set_on_cancel(window.close_dialog)

    def done(path: str) -> None:
        window.close_dialog()
        then(path)

    dialog.set_on_done(done)
    window.show_dialog(dialog)
