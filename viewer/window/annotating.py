"""Annotating: points chosen by clicks, each with a title and a text, for `gs-codec share`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.files.annotations import Annotation, read_annotations, write_annotations
from gs_codec.runtime.wording import counted
from viewer.pictures.marker import measure_lines
from viewer.scenes.pose import Pose, placed
from viewer.scenes.typed_paths import NOTES
from viewer.window import dialogs
from viewer.window.measuring import find_point, say_unless_loading
from viewer.window.mouse import Place
from viewer.window.pane import Pane
from viewer.window.shared import Host

#: A click this near to an annotation chooses it, pixels.
_NEAR = 8.0

#: Maximum length of a name, characters.
_LONGEST = 22


class Annotating:
    """Annotations of the scenes shown; clicks add and choose them.

    Attributes
    ----------
    on : bool
        Whether clicks do so, and annotations are shown.
    notes : list of Annotation
        Those without a title are named by their numbers; see `titles`.
    chosen : int or None
        Index of one of them.
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self.on = False
        self.notes: list[Annotation] = []
        self._saved: list[Annotation] = []
        self.chosen: int | None = None
        viewer.stage.overlays["notes"] = self._rings
        viewer.modal.cancels.append(self.stop)

    @property
    def titles(self) -> list[str]:
        """The title of each."""
        return [note.title.strip() or f"Annotation {k}" for k, note in enumerate(self.notes, 1)]

    @property
    def names(self) -> list[str]:
        """The number of each, and at least the beginning of its title."""
        names = [f"{k}: {title}" for k, title in enumerate(self.titles, 1)]
        most = _LONGEST
        return [name if len(name) <= most else f"{name[: most - 3]}..." for name in names]

    def toggle(self) -> None:
        """Let clicks annotate, or pick Gaussians again; annotations are kept."""
        self.on = not self.on
        say_unless_loading(self._viewer, "")
        self._viewer.panel.show("Pick")
        self._put(self.notes, self.chosen)

    def stop(self) -> bool:
        """Let clicks pick Gaussians again; return whether they annotated."""
        was = self.on
        if was:
            self.toggle()
        return was

    def click(self, pane: Pane, at: Place) -> None:
        """Choose the annotation at a pixel of a pane's picture, or add one there."""
        stage = self._viewer.stage
        if stage.pose is None:
            return
        places = [_place(note, stage.pose, stage.picture_size) for note in self.notes]
        away = [np.inf if place is None else math.dist(place, at) for place in places]
        if away and min(away) < _NEAR:
            self.choose(int(np.argmin(away)))
            return

        def done(point: NDArray[np.float64]) -> None:
            position = [float(f"{value:.10g}") for value in point]
            notes = [*self.notes, Annotation(position, "")]
            self._put(notes, len(notes) - 1)

        find_point(self._viewer, "annotate", pane, at, lambda: self.on, done)

    def choose(self, index: int) -> None:
        """Choose an annotation."""
        self.chosen = index
        self._viewer.panel.refresh()

    def set_title(self, title: str) -> None:
        """Change the title of the chosen annotation."""
        self._change(lambda note: replace(note, title=title))

    def set_text(self, text: str) -> None:
        """Change the text of the chosen annotation."""
        self._change(lambda note: replace(note, text=text))

    def _change(self, change: Callable[[Annotation], Annotation]) -> None:
        chosen = self.chosen
        if chosen is not None:
            changed = change(self.notes[chosen])
            self.notes = [*self.notes[:chosen], changed, *self.notes[chosen + 1 :]]
            self._viewer.panel.refresh()

    def remove(self) -> None:
        """Remove the chosen annotation."""
        if self.chosen is not None:
            notes = [*self.notes[: self.chosen], *self.notes[self.chosen + 1 :]]
            self._put(notes, min(self.chosen, len(notes) - 1) if notes else None)

    def follow(self, matrix: NDArray) -> None:
        """Move the annotations by a matrix ``(4, 4)``."""
        places = [placed(np.array(note.position), matrix).tolist() for note in self.notes]
        pairs = zip(self.notes, places, strict=True)
        self._put([replace(note, position=place) for note, place in pairs], self.chosen)

    def _put(self, notes: list[Annotation], chosen: int | None) -> None:
        self.notes, self.chosen = notes, chosen
        self._viewer.stage.arrange()
        self._viewer.panel.refresh()

    @property
    def tag(self) -> tuple[str, NDArray[np.float64] | None]:
        """Number and title of the chosen one, and its pixel in the picture, if it is seen."""
        stage = self._viewer.stage
        if not self.on or self.chosen is None or stage.seen is None:
            return "", None
        place = _place(self.notes[self.chosen], stage.seen, stage.picture_size)
        return self.names[self.chosen], place

    def _rings(self, pose: Pose, width: int, height: int) -> list[NDArray[np.float64]]:
        """A ring at each annotation."""
        notes = self.notes if self.on else []
        points = [[np.array(note.position)] for note in notes]
        return [ring for one in points for ring in measure_lines(one, pose, width, height)]

    # Files

    def ask_save(self, then: Callable[[], None] = lambda: None) -> None:
        """Ask where to save the annotations, save them, and then call `then`."""

        def save(path: str) -> None:
            self.save(path, then)

        self._viewer.files.ask_save("Save the annotations", NOTES, save, "-notes")

    def save(self, path: str, then: Callable[[], None] = lambda: None) -> None:
        """Save the annotations, and then call `then`."""
        try:
            named = zip(self.notes, self.titles, strict=True)
            write_annotations(path, [replace(note, title=title) for note, title in named])
        except (OSError, gs_codec.GsCodecError) as error:
            self._viewer.fail(error)
            return
        self._saved = self.notes
        self._viewer.panel.say(f"{Path(path).name} saved: {counted(len(self.notes), 'annotation')}")
        then()

    def ask_open(self) -> None:
        """Ask for a file of annotations, and add them to those shown."""
        self._viewer.files.ask_open("Open annotations", NOTES, self.open)

    def open(self, path: str) -> None:
        """Add the annotations of a file to those shown."""
        try:
            found = read_annotations(path)
        except gs_codec.GsCodecError as error:
            self._viewer.fail(error)
            return
        notes = [*self.notes, *found]
        self._saved = self._saved if self._unsaved else notes
        self._put(notes, len(notes) - 1 if notes else None)

    @property
    def _unsaved(self) -> bool:
        return bool(self.notes) and self.notes != self._saved

    def ask_unsaved(self, then: Callable[[], None]) -> bool:
        """Ask what to do with unsaved annotations, if any, before calling `then`.

        Returns
        -------
        bool
            Whether it asked; if not, `then` is not called.
        """
        if not self._unsaved:
            return False

        def discard() -> None:
            self._saved = self.notes
            then()

        text = f"{counted(len(self.notes), 'annotation')}, not saved."
        choices = [("Save as ...", lambda: self.ask_save(then)), ("Discard them", discard)]
        dialogs.ask_among(self._viewer.modal, "Unsaved annotations", text, choices)
        return True


def _place(note: Annotation, pose: Pose, size: tuple[int, int]) -> NDArray[np.float64] | None:
    """Pixel of an annotation; None behind the camera."""
    pixels, depth = pose.project(np.array([note.position]), *size)
    return pixels[0] if depth[0] > 0 else None
