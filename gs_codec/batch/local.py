"""Storage on this machine: scenes in local folders."""

from __future__ import annotations

import glob
import hashlib
import logging
import os
import re
import stat
from collections import deque
from collections.abc import Iterable
from pathlib import Path

from gs_codec.batch.storage import SUFFIXES, Spot, Stamp, local_path
from gs_codec.errors import InvalidInput, one_line
from gs_codec.runtime.atomic import leftovers, remove_leftover

log = logging.getLogger(__name__)


class LocalStorage:
    """See `Storage`."""

    shared = True
    local = True

    def find(self, pattern: str) -> list[tuple[str, Spot]]:
        """See `Storage.find`; hidden files and folders match only if the pattern writes the dot.

        A file or folder that several links lead to is taken once.
        """
        text = os.path.abspath(local_path(pattern))
        if os.path.isdir(text):
            root, found = text, matching_paths(glob.escape(text) + "/**/*")
            paths = [path for path in found if path.lower().endswith(SUFFIXES)]
        elif os.path.lexists(text) or not glob.has_magic(text):
            root, paths = os.path.dirname(text), [text] if os.path.lexists(text) else []
        else:
            root, paths = fixed_part(text), matching_paths(text)
        files = _each_once(root, [path for path in set(paths) if not os.path.isdir(path)])
        return [(os.path.relpath(path, root), Spot(path)) for path in sorted(files)]

    def spot(self, folder: str, name: str) -> Spot:
        """See `Storage.spot`."""
        return Spot(os.path.join(os.path.abspath(local_path(folder)), name))

    def shown(self, spot: Spot) -> str:
        """See `Storage.shown`."""
        return spot.path

    def check_folder(self, folder: str) -> None:
        """See `Storage.check_folder`."""
        path = os.path.abspath(local_path(folder))
        try:
            os.makedirs(path, exist_ok=True)
        except OSError as error:
            raise InvalidInput(f"{path}: {one_line(error)}, expected a folder") from error
        if not os.access(path, os.W_OK):
            raise InvalidInput(f"{path}: no permission to write there")

    def stamp(self, spot: Spot) -> Stamp | None:
        """See `Storage.stamp`."""
        try:
            found = os.stat(spot.path)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InvalidInput(f"{spot.path}: {one_line(error)}") from error
        return Stamp(found.st_size, found.st_mtime_ns)

    def sha256(self, spot: Spot) -> str:
        """See `Storage.sha256`."""
        return file_sha256(spot.path)

    def fetch(self, spot: Spot, folder: Path) -> Path:
        """See `Storage.fetch`; only regular files are accepted."""
        try:
            mode = os.stat(spot.path).st_mode
        except OSError as error:
            raise InvalidInput(f"{spot.path}: {one_line(error)}") from error
        if not stat.S_ISREG(mode):
            raise InvalidInput(f"{spot.path}: not a regular file")
        return Path(spot.path)

    def store(self, file: Path, spot: Spot, mark: str) -> None:
        """Not used: outputs on this machine are written directly to their path."""
        raise NotImplementedError

    def sweep(self, spots: Iterable[Spot], mark: str) -> None:
        """See `Storage.sweep`; on this machine, any file that no process writes is left over."""
        for folder, names in by_folder(spots).items():
            try:
                entries = os.listdir(folder)
            except OSError:  # nothing was ever written there
                continue
            for entry in leftovers(entries, names):
                remove_leftover(os.path.join(folder, entry))


def matching_paths(pattern: str) -> list[str]:
    """Paths that an absolute glob matches; ``**`` visits each real folder once."""
    pattern = re.sub(r"(/\*\*)+/", "/**/", f"{pattern}/")
    head, wild, rest = pattern.partition("/**/")
    if not wild:
        return glob.glob(pattern.rstrip("/"))
    folders = [below for folder in glob.glob(head or "/") for below in _folders(folder)]
    rest = rest or "*"
    return [path for below in folders for path in matching_paths(f"{glob.escape(below)}/{rest}")]


def _folders(root: str) -> list[str]:
    """A folder and its subfolders that are not hidden; each link is followed once, after them."""
    found: list[str] = []
    waiting, seen = deque([root]), set[str]()
    while waiting:
        start = waiting.popleft()
        above = os.path.realpath(os.path.dirname(start)) if start != root else ""
        for folder, names, _ in os.walk(start, onerror=_warn):
            real = os.path.realpath(folder)
            if real in seen or f"{above}/".startswith(f"{real.rstrip('/')}/"):
                log.warning("%s: leads to %s, a parent or read before; skipped", folder, real)
                names.clear()
                continue
            seen.add(real)
            found.append(folder)
            names[:] = sorted(name for name in names if not name.startswith("."))
            below = [os.path.join(folder, name) for name in names]
            waiting += [path for path in below if os.path.islink(path)]
    return found


def _warn(error: OSError) -> None:
    log.warning("%s: %s, skipped", error.filename, one_line(error))


def _each_once(root: str, paths: Iterable[str]) -> list[str]:
    """The paths without duplicates of the same file; a file itself is preferred to its links."""
    real_root, taken = os.path.realpath(root), dict[str, str]()
    real = {path: os.path.realpath(path) for path in paths}

    def is_link(path: str) -> bool:
        return real[path] != os.path.normpath(os.path.join(real_root, os.path.relpath(path, root)))

    for path in sorted(real, key=lambda path: (is_link(path), path)):
        if real[path] in taken:
            log.warning("%s: the same file as %s, skipped", path, taken[real[path]])
        taken.setdefault(real[path], path)
    return list(taken.values())


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
    """The leading folders of a glob that have no wildcards."""
    fixed = []
    for part in pattern.split("/")[:-1]:
        if any(sign in part for sign in wild):
            break
        fixed.append(part)
    return "/".join(fixed) or "/"


def by_folder(spots: Iterable[Spot]) -> dict[str, set[str]]:
    """File names, grouped by folder."""
    folders: dict[str, set[str]] = {}
    for spot in spots:
        folder, _, name = spot.path.rpartition("/")
        folders.setdefault(folder or "/", set()).add(name)
    return folders
