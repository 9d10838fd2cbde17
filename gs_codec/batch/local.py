"""Scenes in folders of this machine."""

from __future__ import annotations

import glob
import hashlib
import os
import stat
from collections.abc import Iterable
from pathlib import Path

from gs_codec.batch.places import SUFFIXES, Spot, Stamp, local_path
from gs_codec.errors import InvalidInput, one_line
from gs_codec.io.atomic import leftovers


class LocalPlace:
    """See `Place`."""

    shared = True
    local = True

    def find(self, pattern: str) -> list[tuple[str, Spot]]:
        """See `Place.find`; hidden files and folders match only where a dot is written."""
        text = os.path.abspath(local_path(pattern))
        if os.path.isdir(text):
            root, found = text, glob.iglob(glob.escape(text) + "/**", recursive=True)
            paths = [path for path in found if path.lower().endswith(SUFFIXES)]
        elif os.path.lexists(text) or not glob.has_magic(text):
            root, paths = os.path.dirname(text), [text] if os.path.lexists(text) else []
        else:
            root, paths = fixed_part(text), glob.glob(text, recursive=True)
        files = sorted(path for path in set(paths) if not os.path.isdir(path))
        return [(os.path.relpath(path, root), Spot(path)) for path in files]

    def spot(self, folder: str, name: str) -> Spot:
        """See `Place.spot`."""
        return Spot(os.path.join(os.path.abspath(local_path(folder)), name))

    def shown(self, spot: Spot) -> str:
        """See `Place.shown`."""
        return spot.path

    def check_folder(self, folder: str) -> None:
        """See `Place.check_folder`."""
        path = os.path.abspath(local_path(folder))
        try:
            os.makedirs(path, exist_ok=True)
        except OSError as error:
            raise InvalidInput(f"{path}: {one_line(error)}, expected a folder") from error
        if not os.access(path, os.W_OK):
            raise InvalidInput(f"{path}: no permission to write there")

    def stamp(self, spot: Spot) -> Stamp | None:
        """See `Place.stamp`."""
        try:
            found = os.stat(spot.path)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InvalidInput(f"{spot.path}: {one_line(error)}") from error
        return Stamp(found.st_size, found.st_mtime_ns)

    def sha256(self, spot: Spot) -> str:
        """See `Place.sha256`."""
        return file_sha256(spot.path)

    def fetch(self, spot: Spot, folder: Path) -> Path:
        """See `Place.fetch`; what could not be read to an end is refused."""
        try:
            mode = os.stat(spot.path).st_mode
        except OSError as error:
            raise InvalidInput(f"{spot.path}: {one_line(error)}") from error
        if not stat.S_ISREG(mode):
            raise InvalidInput(f"{spot.path}: not a regular file")
        return Path(spot.path)

    def store(self, file: Path, spot: Spot) -> None:
        """Files of this machine are written where they belong."""
        raise NotImplementedError

    def sweep(self, spots: Iterable[Spot]) -> None:
        """See `Place.sweep`."""
        for folder, names in by_folder(spots).items():
            try:
                entries = os.listdir(folder)
            except OSError:  # nothing was ever written there
                continue
            for entry in leftovers(entries, names):
                os.unlink(os.path.join(folder, entry))


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file.

    Raises
    ------
    InvalidInput
        If it cannot be read.
    """
    digest, block = hashlib.sha256(), bytearray(1 << 20)
    try:
        with open(path, "rb", buffering=0) as file:
            while length := file.readinto(block):
                digest.update(memoryview(block)[:length])
    except OSError as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from error
    return digest.hexdigest()


def fixed_part(pattern: str, wild: str = "*?[") -> str:
    """The folder of a glob up to which nothing in it is wild."""
    fixed = []
    for part in pattern.split("/")[:-1]:
        if any(sign in part for sign in wild):
            break
        fixed.append(part)
    return "/".join(fixed) or "/"


def by_folder(spots: Iterable[Spot]) -> dict[str, set[str]]:
    """Names of files by the folder they are in."""
    folders: dict[str, set[str]] = {}
    for spot in spots:
        folder, _, name = spot.path.rpartition("/")
        folders.setdefault(folder or "/", set()).add(name)
    return folders
