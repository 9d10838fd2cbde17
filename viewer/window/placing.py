"""Several scenes in one, placed by handles and numbers: adding, projects, and the command line."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import gs_codec
from gs_codec.cli.output import print_text
from viewer.scenes.gizmo import about
from viewer.scenes.opened import Opened
from viewer.scenes.saving import command_of, open_file, save_project
from viewer.scenes.typed_paths import PROJECTS, SCENES
from viewer.scenes.worker import Stale
from viewer.window import dialogs
from viewer.window.editor import Editor
from viewer.window.place_tool import PlaceTool
from viewer.window.shared import Host

#: Programs that copy their input to the clipboard, which Open3D cannot do.
_COPIERS = (
    ("wl-copy",),
    ("xclip", "-selection", "clipboard"),
    ("xsel", "--clipboard", "--input"),
    ("pbcopy",),
    ("clip",),
)


class Placing:
    """The scenes joined in the edited scene, and where they are.

    Parameters
    ----------
    viewer : Host
    editor : Editor
    """

    def __init__(self, viewer: Host, editor: Editor) -> None:
        self._viewer, self._editor = viewer, editor
        self._project: tuple[object, Path] = None, Path()
        editor.tools["place"] = PlaceTool(viewer, editor)

    def place(
        self, shift: list[float], angles: list[float], factor: float, around_middle: bool
    ) -> None:
        """Scale and turn the selection, or the whole scene, about its middle or 0, and shift it."""
        edits = self._editor.edits
        if edits is not None and factor > 0:
            middle = edits.middle if around_middle else np.zeros(3)
            matrix = about(middle, shift, angles, factor)
            self._editor.do(lambda edits: edits.move(matrix))

    def scale_all(self, factor: float) -> None:
        """Scale the whole scene about 0, and the camera's place with it: the picture stays."""
        matrix = about(np.zeros(3), factor=factor)
        self._editor.do(lambda edits: edits.move(matrix, everything=True))
        self._viewer.panel.say(f"scaled by {factor:.6g}")

    def ask_add(self) -> None:
        """Ask for a scene, and join it to the edited one."""
        if self._editor.edits is None:
            self._viewer.fail(gs_codec.GsCodecError("add a scene: open one first"))
        else:
            self._viewer.files.ask_open("Add a scene", SCENES, self.add)

    def add(self, path: str) -> None:
        """Join a scene to the edited one, in the background."""
        viewer, edits = self._viewer, self._editor.edits

        def read(stale: Stale) -> Opened:
            progress = viewer.worker.progress(stale, viewer.panel.show_progress)
            return open_file(path, progress, viewer.request.max_bytes)

        def done(scene: Opened) -> None:
            viewer.panel.say("")
            if edits is None or edits not in self._editor.all:
                viewer.panel.say(f"{scene.name} not added, because another scene was opened")
                return
            self._editor.number = self._editor.all.index(edits)
            if scene.whole is not None or edits.whole.system_given:
                why = "only a scene of a file can be added, to one that was not turned"
                viewer.fail(gs_codec.GsCodecError(f"{path}: {why}"))
                return
            if self._editor.number == 0:
                viewer.stage.put_pruned(None)
            self._editor.do(lambda edits: edits.add(scene))

        viewer.load(f"loading {Path(path).name}", read, done)

    def select_part(self, number: int) -> None:
        """Select a scene of those joined."""
        self._editor.do(lambda edits: edits.select(edits.part(number)))

    def remove_part(self, number: int) -> None:
        """Delete a scene of those joined."""
        self._editor.do(lambda edits: edits.keep(~edits.part(number), "remove"))

    # Projects and commands

    def ask_save(self, then: Callable[[], None] = lambda: None) -> None:
        """Ask where to save the project, save it, and then call `then`."""
        edits = self._editor.edits
        if edits is not None:
            path, save = edits.scene.path, partial(self.save, then=then)
            self._viewer.files.ask_save("Save the project", PROJECTS, save, "", path)

    def save(self, path: str, then: Callable[[], None] = lambda: None) -> None:
        """Save the edited scenes, as files and edits, in a project."""
        edits = self._editor.edits
        if edits is None:
            return
        try:
            save_project(edits, Path(path))
        except (OSError, gs_codec.GsCodecError) as error:
            self._viewer.fail(error)
            return
        self._project = edits.now, Path(path)
        edits.mark_saved(edits.scene, in_project=True)
        self._viewer.panel.say(f"{Path(path).name} saved")
        self._viewer.panel.refresh()
        then()

    def command(self) -> None:
        """Show the command with the same result; edits by hand are saved as a project first."""
        edits = self._editor.edits
        if edits is None:
            return
        now, path = self._project
        if edits.options is None and now is not edits.now:
            self.ask_save(self.command)
            return
        try:
            text = command_of(edits, path)
        except (OSError, gs_codec.GsCodecError) as error:
            self._viewer.fail(error)
            return
        print_text(text)
        copied = "clipboard and in the terminal" if _copy(text) else "terminal, to be copied"
        text += f"\n\nIt is in the {copied}."
        modal = self._viewer.modal
        dialogs.show_message(modal, "The same edits on the command line", text, modal.close_dialog)


def _copy(text: str) -> bool:
    """Copy a text to the clipboard; return whether a program for this is installed."""
    for program, *options in _COPIERS:
        if shutil.which(program):
            # Some stay in the background, and would hold the streams of this process open.
            nowhere = subprocess.DEVNULL
            done = subprocess.run(
                [program, *options],
                input=text.encode(),
                stdout=nowhere,
                stderr=nowhere,
                check=False,
            )
            return done.returncode == 0
    return False
