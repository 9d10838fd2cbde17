"""Dialogs of the window, and the handling of Esc."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from open3d.visualization import gui

from gs_codec.errors import printable

#: Maximum line length of a dialog, characters.
_WIDTH = 76

#: Number of frames after a dialog until its text field stops taking keys.
_FRAMES = 4


class Modal:
    """The dialog of a window, and the handling of Esc. An open dialog gets all keys.

    Open3D asks to close the window whenever Esc goes down, repeats or goes up, before it reports
    the key.

    Attributes
    ----------
    dialog : gui.Dialog or None
    cancels : list of callable
        Functions that Esc calls before it closes the window; each returns whether it ended
        anything.
    theme : gui.Theme
    """

    def __init__(self, window: gui.Window) -> None:
        self._window = window
        self.dialog: gui.Dialog | None = None
        self._enter: Callable[[], None] | None = None
        self._work: Callable[[], bool] | None = None
        self._escape: Callable[[], None] = self.close_dialog
        self._escaping = self._close_requested = self._closing = False
        self._fading = 0
        self.cancels: list[Callable[[], bool]] = []
        self.theme = window.theme

    def show_dialog(
        self,
        dialog: gui.Dialog,
        enter: Callable[[], None] | None = None,
        escape: Callable[[], None] | None = None,
        work: Callable[[], bool] | None = None,
    ) -> None:
        """Show a dialog with actions for Enter and Esc; without `escape`, Esc closes it.

        While it is open, each tick of the window calls `work`, which returns whether to draw.
        """
        self.dialog, self._enter, self._escape = dialog, enter, escape or self.close_dialog
        self._work = work
        self._window.show_dialog(dialog)
        self._window.post_redraw()

    def close_dialog(self) -> None:
        """Close the dialog."""
        self.dialog, self._work, self._fading = None, None, _FRAMES
        self._window.close_dialog()

    def key(self, event: gui.KeyEvent) -> bool:
        """Handle a key event; return whether the dialog took it."""
        down = event.type == gui.KeyEvent.Type.DOWN
        if event.key == gui.KeyName.ESCAPE:
            self._escaping = down
            if down and self._close_requested:
                self._close_requested = not any(cancel() for cancel in self.cancels)
        if self.dialog is None:
            return False
        # While a text is edited, Open3D reports only key releases.
        if event.key == gui.KeyName.ENTER and not down and self._enter is not None:
            self._enter()
        return True

    def close(self) -> bool:
        """Whether the window may close when asked to; closes an open dialog instead."""
        if self.dialog is not None:
            self._escape()
            self._escaping = True
            return False
        if self._escaping:
            self._escaping = False
            return False
        # Esc or the window's close button: Open3D reports the key only afterwards.
        closing, self._closing = self._closing, False
        self._close_requested = not closing
        return closing

    def tick(self) -> bool:
        """Let the dialog work; return whether to draw the window.

        Closes the window if asked to, unless Esc ended something instead.
        """
        if self._close_requested:
            self._close_requested, self._closing = False, True
            # Deferred, because Open3D is iterating over its windows.
            gui.Application.instance.post_to_main_thread(self._window, self._window.close)
        self._fading = max(self._fading - 1, 0)
        worked = self._work is not None and self._work()
        return worked or self._fading > 0

    @property
    def room(self) -> tuple[int, int]:
        """Maximum width and height of a dialog, pixels."""
        size = self._window.size
        return size.width, size.height

    def lay_out(self) -> None:
        """Resize the dialog to its contents."""
        self._window.set_needs_layout()


def show_message(window: Modal, title: str, text: str, closed: Callable[[], None]) -> None:
    """Show a text with an OK button, which calls `closed`."""
    dialog, box = _box(window, title, text)
    _add_button(box, "OK", closed)
    window.show_dialog(dialog, closed, closed)


def _box(window: Modal, title: str, text: str) -> tuple[gui.Dialog, gui.Vert]:
    """A dialog with a title and a text, and a box for more widgets."""
    em = window.theme.font_size
    dialog = gui.Dialog(title)
    box = gui.Vert(0.5 * em, gui.Margins(em, em, em, em))
    for part in (title, "\n".join(folded(text, _WIDTH))):
        box.add_child(gui.Label(part))
    dialog.add_child(box)
    return dialog, box


def _add_button(box: gui.Vert, text: str, action: Callable[[], None]) -> None:
    """Add a button, centred in its row."""
    button = gui.Button(text)
    button.set_on_clicked(action)
    row = gui.Horiz()
    row.add_stretch()
    row.add_child(button)
    row.add_stretch()
    box.add_child(row)


def ask_among(
    window: Modal, title: str, text: str, choices: Sequence[tuple[str, Callable[[], None]]]
) -> None:
    """Ask the user to choose one of several actions, each a button, or none."""
    dialog, box = _box(window, title, text)
    for name, action in choices:

        def chosen(action: Callable[[], None] = action) -> None:
            window.close_dialog()
            action()

        _add_button(box, name, chosen)
    _add_button(box, "Cancel", window.close_dialog)
    window.show_dialog(dialog)


def ask_pane(window: Modal, name: str, scenes: Sequence[str], then: Callable[[int], None]) -> None:
    """Ask which of two scenes to replace."""
    choices = [
        (f"{letter}: {scene}", partial(then, index))
        for index, (letter, scene) in enumerate(zip("AB", scenes, strict=True))
    ]
    ask_among(window, "Open", f"Show {name} instead of", choices)


def ask_recent(window: Modal, paths: Sequence[Path], then: Callable[[str], None]) -> None:
    """Ask which of several files to open."""
    said = "Recent files" if paths else "No recent files."
    choices = [(shortened(str(path), _WIDTH), partial(then, str(path))) for path in paths]
    ask_among(window, "Recent", said, choices)


def shortened(path: str, most: int) -> str:
    """The end of a path, at most `most` characters."""
    path = printable(path)
    return path if len(path) <= most else "..." + path[3 - most :]


def inside(widget: gui.Widget) -> Iterator[gui.Widget]:
    """All widgets inside a widget, at any depth."""
    for child in widget.get_children():
        yield child
        yield from inside(child)


def folded(text: str, width: int) -> list[str]:
    """The lines of a text, wrapped to at most `width` characters.

    Unprintable characters are escaped, because widgets reject names that are not Unicode.
    """
    lines = (
        textwrap.wrap(printable(line), width, break_on_hyphens=False) for line in text.splitlines()
    )
    return [part for parts in lines for part in parts or [""]]
