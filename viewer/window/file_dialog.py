"""A dialog that asks for a file to open or save, or for a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, SupportsInt

from open3d.visualization import gui

from gs_codec.cli.main import describe_error
from gs_codec.errors import InvalidInput
from viewer.scenes.typed_paths import (
    UP,
    Kind,
    check_readable,
    first_folder,
    listed,
    suggested,
    to_write,
    typed_path,
)
from viewer.window.dialogs import Modal, folded, shortened
from viewer.window.stage import Stage
from viewer.window.x11 import BACKSPACE, Keyboard

#: Width of the dialog, in font sizes; the least is for tiny windows.
_WIDTH, _LEAST = 34.0, 4.0

#: Characters per line for each font size of width.
_CHARACTERS = 2.0

#: Maximum number of rows in the list.
_ROWS = 12

#: Height of the rest of the dialog, in rows.
_OTHERS = 11

#: Number of frames until a text field stops being edited.
_ENDS = 2

#: Number of frames until a text field takes a key.
_TAKES = 1

#: Number of lines for error messages.
_LINES = 3

_RED = gui.Color(1.0, 0.45, 0.4)


class FileQuestion(NamedTuple):
    """A request to the dialog.

    Attributes
    ----------
    title : str
    kind : Kind
    folder : Path
        First folder to list.
    saves : bool
        Whether the file is to be written.
    name : str
        Suggested name.
    """

    title: str
    kind: Kind
    folder: Path
    saves: bool = False
    name: str = ""


class FileDialog:
    """A list of files and a text field for a path.

    A click copies a name into the field; a double click or Enter opens it. Errors appear in the
    dialog. An existing file is overwritten only after confirmation: Save must be pressed twice.

    Parameters
    ----------
    modal : Modal
    question : FileQuestion
    then : callable
        Called with the path.
    ended : callable
        Called when the dialog is closed, before `then`.
    """

    def __init__(
        self,
        modal: Modal,
        question: FileQuestion,
        then: Callable[[str], None],
        ended: Callable[[], None] = lambda: None,
    ) -> None:
        self._modal, self._question, self._then, self._ended = modal, question, then, ended
        self._keyboard = Keyboard()
        self._steps: Iterator[bool] = iter(())
        # Text being put into the field until it takes keys; whether the next key replaces it.
        self._typed: str | None = None
        self._selected = self._edited = False
        self._folder = question.folder
        self._replaced: Path | None = None
        em = modal.theme.font_size
        wide = max(min(_WIDTH * em, modal.room[0] - 4 * em), _LEAST * em)
        self._line = int(_CHARACTERS * wide / em)
        self.dialog = gui.Dialog(question.title)
        box = gui.Vert(0.4 * em, gui.Margins(em, 0.6 * em, em, 0.6 * em))
        self.dialog.add_child(box)
        box.add_child(gui.Horiz(0, gui.Margins(int(wide), 0, 0, 0)))
        box.add_child(gui.Label(question.title))
        self._where = gui.Label("")
        self.list = gui.ListView()
        rows = int(modal.room[1] / (1.5 * em)) - _OTHERS
        self.list.set_max_visible_items(min(max(rows, 1), _ROWS))
        self.list.set_on_selection_changed(self._picked)
        self.field = gui.TextEdit()
        self.field.placeholder_text = "name or path"
        self.field.set_on_text_changed(lambda _: self._forget())
        self.said = gui.Label((_LINES - 1) * "\n")
        self.said.text_color = _RED
        for widget in (self._where, self.field, self.said, self.list):
            box.add_child(widget)
        box.add_child(self._buttons(em))
        modal.show_dialog(self.dialog, self._enter, self.cancel, self._work)
        self._go_to(question.folder)

    def _buttons(self, em: float) -> gui.Horiz:
        """The format, and the buttons that close the dialog."""
        row = gui.Horiz(0.5 * em)
        kind = self._question.kind
        self.format = gui.Combobox()
        for suffix in kind.suffixes:
            self.format.add_item(suffix)
        self.format.visible = self._question.saves and len(kind.suffixes) > 1
        if self.format.visible:
            self.format.selected_text = kind.suffix_of(self._question.name) or kind.suffixes[0]
            row.add_child(self.format)
        self.format.set_on_selection_changed(self._format_chosen)
        if kind.folders:
            folder = gui.Button("Open folder")
            folder.tooltip = "Open the listed folder as a sequence: its files are the frames."
            folder.set_on_clicked(lambda: self._end(self._folder))
            row.add_child(folder)
        row.add_stretch()
        self.accepts = gui.Button("Save" if self._question.saves else "Open")
        self.accepts.set_on_clicked(self.accept)
        cancels = gui.Button("Cancel")
        cancels.set_on_clicked(self.cancel)
        for button in (self.accepts, cancels):
            row.add_child(button)
        return row

    def cancel(self) -> None:
        """Close the dialog."""
        self.release()
        self._modal.close_dialog()
        self._ended()

    def release(self) -> None:
        """Stop listening to keys."""
        self._keyboard.close()

    def accept(self) -> None:
        """Accept the path in the field if it is valid; list it if it is a folder."""
        question, text = self._question, self.field.text_value
        try:
            path = typed_path(text, self._folder, question.saves)
            chosen = not question.kind.suffixes and (not text.strip() or path == self._folder)
            if path.is_dir() and not chosen and (text.strip() or question.kind.suffixes):
                self._go_to(path)
                return
            path = self._checked(path)
        except (InvalidInput, OSError) as error:
            self._say(describe_error(error))
            return
        if question.saves and path.exists() and path != self._replaced:
            self._say(f"{path.name} already exists. Press Enter or Replace to overwrite it.")
            self._replaced, self.accepts.text = path, "Replace"
            self._modal.lay_out()
            return
        self._end(path)

    def _end(self, path: Path) -> None:
        self.cancel()
        self._then(str(path))

    def _checked(self, path: Path) -> Path:
        """The path to accept; `InvalidInput` if it is not valid."""
        if self._question.saves:
            if not self.field.text_value.strip():
                raise InvalidInput("type a name")
            return to_write(path, self._question.kind, self.format.selected_text)
        if self._question.kind.suffixes and not self.field.text_value.strip():
            raise InvalidInput("type a name or choose one")
        check_readable(path, self._question.kind)
        return path

    def _go_to(self, folder: Path) -> None:
        """List a folder."""
        try:
            folder = folder.resolve()
            names = listed(folder, self._question.kind)
        except (InvalidInput, OSError, RuntimeError) as error:
            self._say(describe_error(error))
            return
        self._folder = folder
        self._where.text = shortened(str(folder), self._line)
        self.list.set_items(names)
        self._put(self._question.name, selected=True)

    def _picked(self, name: str, twice: bool) -> None:
        """Copy a name from the list into the field; on a double click, open it."""
        if name.endswith("/") and twice:
            self._go_to(self._folder / name)
        elif name != UP and (self._question.kind.suffixes == () or not name.endswith("/")):
            self._put(name.rstrip("/"))
            if twice:
                self._steps = self._accept_soon()

    def _format_chosen(self, suffix: str, _: SupportsInt) -> None:
        """Change the suffix of the name in the field."""
        kind, name = self._question.kind, self.field.text_value
        if name:
            self._put(kind.named(name, suffix))

    def _say(self, text: str) -> None:
        """Show an error, and keep editing the text."""
        self._put(self.field.text_value)
        lines = folded(shortened(text, (_LINES - 1) * self._line), self._line)
        self.said.text = "\n".join([*lines, ""][:_LINES])

    def _forget(self) -> None:
        """Clear the error and the confirmation, because the path has changed."""
        self._replaced = None
        self.accepts.text = "Save" if self._question.saves else "Open"
        self.said.text = (_LINES - 1) * "\n"

    # Keys

    def _enter(self) -> None:
        """Accept the path on Enter, if `_work` cannot see keys."""
        if not self._keyboard.listens:
            self.accept()

    def _work(self) -> bool:
        """Handle pressed keys; see `Modal.show_dialog`."""
        for pressed in self._keyboard.pressed():
            if pressed.enters:
                self._steps = self._accept_soon()
            elif pressed.pastes:
                self._put(self._keyboard.clipboard().strip().split("\n")[0])
            elif pressed.text and self._typed is not None:
                self._type(pressed.text)
        return bool(next(self._steps, False))

    def _accept_soon(self) -> Iterator[bool]:
        """Accept the path once the field contains everything typed before."""
        yield from _ENDS * [True]
        if self._typed is not None:
            self.field.text_value = self._typed
        self.accept()

    def _put(self, text: str, selected: bool = False) -> None:
        """Put a text into the field and focus it; the next key replaces it if `selected`."""
        self._typed, self._selected = text, selected
        self._forget()
        self._steps = self._settle()

    def _type(self, text: str) -> None:
        """Append to the text being put into the field."""
        before = "" if self._selected else self._typed or ""
        self._typed = before[:-1] if text == BACKSPACE else before + text
        self._selected = False

    def _settle(self) -> Iterator[bool]:
        """Wait until the field has the text and no more keys are pending, then let it take keys.

        A field being edited ignores new text, so editing is ended first. Tab focuses the field and
        selects its text.
        """
        text = None
        while text != self._typed:
            text = self._typed
            if self._edited:
                self.field.visible = False
                yield from _ENDS * [True]
            self.field.text_value, self.field.visible = text or "", True
            while not self._keyboard.listens:
                yield False
            self._edited = True
            for key in ("Tab",) if self._selected else ("Tab", "End"):
                yield from self._press(key)
        self._typed = None

    def _press(self, key: str) -> Iterator[bool]:
        """Send a press and release of a key to the field."""
        yield from _TAKES * [True]
        self._keyboard.send(key, True)
        try:
            yield from _TAKES * [True]
        finally:
            self._keyboard.send(key, False)


class Files:
    """Asks for files: at first in the folder of the scene, later in that of the last file.

    Parameters
    ----------
    modal : Modal
    stage : Stage
    """

    def __init__(self, modal: Modal, stage: Stage) -> None:
        self._modal, self._stage = modal, stage
        self._last: Path | None = None

    def _folder(self, scene: Path) -> Path:
        return first_folder(scene, self._last)

    def ask_open(self, title: str, kind: Kind, then: Callable[[str], None]) -> None:
        """Ask for a file of a kind, or a folder."""
        self._ask(FileQuestion(title, kind, self._folder(self._shown)), then)

    def ask_save(
        self,
        title: str,
        kind: Kind,
        then: Callable[[str], None],
        mark: str = "",
        scene: Path | None = None,
    ) -> None:
        """Ask where to write a file made from the scene shown, or from `scene`; see `suggested`."""
        source = self._shown if scene is None else scene
        folder = self._folder(source)
        name = suggested(folder, source, kind.suffixes[0], mark)
        self._ask(FileQuestion(title, kind, folder, True, name), then)

    @property
    def _shown(self) -> Path:
        """Path of the first scene's file."""
        scenes = self._stage.scenes
        return scenes[0].path if scenes else Path()

    def _ask(self, question: FileQuestion, then: Callable[[str], None]) -> None:
        def chosen(path: str) -> None:
            self._last = Path(path).parent
            then(path)

        FileDialog(self._modal, question, chosen)
