"""Where scenes lie: on this machine, or at a URL."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote, urlsplit

from gs_codec.batch.redaction import without_secrets

#: What files of a folder are scenes.
SUFFIXES = (".ply", ".splat", ".spz", ".sog")


@dataclass(frozen=True)
class Spot:
    """A file at a place.

    Parameters
    ----------
    path : str
        As the file system of the place names it.
    base : str
        The URL that was given for the place; empty on this machine.
    """

    path: str
    base: str = ""

    def __repr__(self) -> str:
        """Without secrets, as libraries may log it."""
        return f"Spot({without_secrets(self.path)!r}, {without_secrets(self.base)!r})"


@dataclass(frozen=True)
class Stamp:
    """What tells whether a file is still the same.

    Parameters
    ----------
    size : int
        Bytes; -1 where the place does not say.
    modified : int or str
        Nanoseconds, or whatever the place has: a time, an ETag, nothing.
    """

    size: int
    modified: int | str


class Place(Protocol):
    """What a batch asks of a place; errors name it and are `InvalidInput` or `MissingTool`."""

    #: Whether other processes of this machine see the same files.
    shared: bool
    #: Whether files are used where they lie, without a copy on this machine.
    local: bool

    def find(self, pattern: str) -> list[tuple[str, Spot]]:
        """Scenes that a file, folder or glob matches, with their names below its fixed part."""

    def spot(self, folder: str, name: str) -> Spot:
        """The file of a name, which may have folders, in a folder as it was given."""

    def shown(self, spot: Spot) -> str:
        """What to call a file, without secrets."""

    def check_folder(self, folder: str) -> None:
        """Make a folder where that is how it is done, and refuse one to write nothing to."""

    def stamp(self, spot: Spot) -> Stamp | None:
        """Size and age of a file; None if there is none."""

    def sha256(self, spot: Spot) -> str:
        """Checksum of a file."""

    def fetch(self, spot: Spot, folder: Path) -> Path:
        """The file on this machine, copied to `folder` unless it is."""

    def store(self, file: Path, spot: Spot, mark: str) -> None:
        """Copy a file there; it appears whole or not at all. `mark` is that of the batch."""

    def sweep(self, spots: Iterable[Spot], mark: str) -> None:
        """Remove what a batch with this mark left half-written of these files."""


def is_url(text: str) -> bool:
    """Whether this is anywhere but among this machine's files."""
    return "://" in text and not text.startswith("file://")


def local_path(text: str) -> str:
    """The path of a path or ``file://`` URL."""
    return unquote(urlsplit(text).path) if text.startswith("file://") else text
