"""Storage: where scenes are read and written, on this machine or at a URL."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol
from urllib.parse import unquote, urlsplit

from gs_codec.batch.redaction import without_secrets

#: Suffixes of the files in a folder that are taken as scenes.
SUFFIXES = (".ply", ".splat", ".spz", ".sog")


@dataclass(frozen=True)
class Spot:
    """A file in a storage.

    Parameters
    ----------
    path : str
        Path in the file system of the storage.
    base : str
        The URL that was given for the storage; empty on this machine.
    """

    path: str
    base: str = ""

    def __repr__(self) -> str:
        """Text without secrets, because libraries may log it."""
        return f"Spot({without_secrets(self.path)!r}, {without_secrets(self.base)!r})"


@dataclass(frozen=True)
class Stamp:
    """Size and modification stamp of a file, to detect changes.

    Parameters
    ----------
    size : int
        Bytes; -1 if the storage does not say.
    modified : int or str
        Nanoseconds on this machine; elsewhere what the storage has: a time, an ETag, or empty.
    """

    size: int
    modified: int | str


class Storage(Protocol):
    """What a batch needs of a storage; errors name it and are `InvalidInput` or `MissingTool`."""

    #: Whether other processes of this machine see the same files.
    shared: bool
    #: Whether the files are on this machine, and used without a copy.
    local: bool

    def find(self, pattern: str) -> list[tuple[str, Spot]]:
        """Scenes that a file, folder or glob matches, named relative to its fixed part."""

    def spot(self, folder: str, name: str) -> Spot:
        """The file with a name, which may contain folders, below a folder or its URL."""

    def shown(self, spot: Spot) -> str:
        """Name of a file for messages, without secrets."""

    def check_folder(self, folder: str) -> None:
        """Make a folder if the storage has folders; refuse one that cannot be written to."""

    def stamp(self, spot: Spot) -> Stamp | None:
        """Size and modification stamp of a file; None if it does not exist."""

    def sha256(self, spot: Spot) -> str:
        """Checksum of a file."""

    def fetch(self, spot: Spot, folder: Path) -> Path:
        """Path of the file on this machine; a remote file is first copied to `folder`."""

    def store(self, file: Path, spot: Spot, mark: str) -> None:
        """Copy a file to the storage, whole or not at all; `mark` identifies the batch."""

    def sweep(self, spots: Iterable[Spot], mark: str) -> None:
        """Remove half-written copies of these files that a batch with this mark left."""


def is_url(text: str) -> bool:
    """Whether this is a URL of remote storage; ``file://`` is not."""
    return "://" in text and not text.startswith("file://")


def local_path(text: str) -> str:
    """The plain path of a path or ``file://`` URL."""
    return unquote(urlsplit(text).path) if text.startswith("file://") else text
