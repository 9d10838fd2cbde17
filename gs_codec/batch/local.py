"""Storage in folders of this machine, and locations of files."""

from __future__ import annotations

import glob
import hashlib
import logging
import os
import re
import stat
from collections import Counter, deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from urllib.parse import unquote, urlsplit

from gs_codec.errors import GsCodecError, InvalidInput, one_line
from gs_codec.format_table import BATCHED, GLTF, LCC, SOG, STREAMED, TILESET, UNBUNDLED
from gs_codec.formats.registry import open_scene, scene_files
from gs_codec.runtime.atomic import leftovers, make_folder, possible_name, remove_leftover
from gs_codec.runtime.redaction import without_secrets
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

#: Ends of the names of files that describe a scene of several files.
_DESCRIPTIONS = (TILESET, STREAMED, UNBUNDLED, *LCC.read)

#: Ends of the names of tiles and chunks.
_PARTS = (TILESET, STREAMED, UNBUNDLED, *GLTF.batched, *SOG.batched)


@dataclass(frozen=True)
class Location:
    """A file in a storage.

    Parameters
    ----------
    path : str
        Path in the file system of the storage.
    base : str
        URL of the storage; empty on this machine.
    """

    path: str
    base: str = ""

    def __repr__(self) -> str:
        """Text without secrets, because libraries may log it."""
        return f"Location({without_secrets(self.path)!r}, {without_secrets(self.base)!r})"


@dataclass(frozen=True)
class Stamp:
    """Size and modification stamp of a file, to detect changes.

    Parameters
    ----------
    size : int
        Bytes; -1 if unknown.
    modified : int or str
        Nanoseconds on this machine, added over all files of a scene; for remote storage a time, an
        ETag, or empty.
    """

    size: int
    modified: int | str


class LocalStorage:
    """A folder, file or glob on this machine; `RemoteStorage` has the same methods.

    Parameters
    ----------
    base : str
        A path or a ``file://`` URL.
    """

    def __init__(self, base: str) -> None:
        plain = unquote(urlsplit(base).path) if base.startswith("file://") else base
        self.path = _with_slashes(os.path.abspath(plain))

    def find(self, suffixes: tuple[str, ...] = BATCHED) -> list[tuple[str, Location]]:
        """The matching scenes, named relative to the part of the path without wildcards.

        In a folder, files with the suffixes match, except for parts of other scenes; see
        `scenes_among`. Hidden files and folders match only if the pattern includes the dot. A file
        or folder with several links is counted once.
        """
        if os.path.isdir(self.path):
            root, found = self.path, matching_paths(glob.escape(self.path) + "/**/*")
            paths = scenes_among(map(_with_slashes, found), suffixes, _others)
        elif self.is_missing():
            return []
        elif os.path.lexists(self.path):
            root, paths = os.path.dirname(self.path), [self.path]
        else:
            root, paths = fixed_part(self.path), matching_paths(self.path)
        files = _each_once(root, [path for path in set(paths) if not os.path.isdir(path)])
        return [
            (_with_slashes(os.path.relpath(path, root)), Location(_with_slashes(path)))
            for path in sorted(files)
        ]

    def is_missing(self) -> bool:
        """Whether it neither exists nor is a glob."""
        return not (os.path.lexists(self.path) or glob.has_magic(self.path))

    def location(self, name: str) -> Location:
        """The location of a file by name, which may contain folders; see `possible_name`."""
        return Location(_with_slashes(os.path.join(self.path, possible_name(name))))

    def shown(self, location: Location) -> str:
        """Name of a file for messages, without secrets."""
        return location.path

    def check_folder(self) -> None:
        """Create the folder if it is missing; reject one that is not writable."""
        if not os.access(make_folder(self.path), os.W_OK):
            raise InvalidInput(f"{self.path}: no write permission")

    def stamp(self, location: Location) -> Stamp | None:
        """Size and modification stamp of a file, or of all files of a scene; None if missing."""
        try:
            found = [os.stat(path) for path in present_files(location.path)]
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InvalidInput(f"{location.path}: {one_line(error)}") from error
        return Stamp(sum(each.st_size for each in found), sum(each.st_mtime_ns for each in found))

    def sha256(self, location: Location) -> str:
        """Checksum of a file, or of all files of a scene."""
        return file_sha256(*present_files(location.path))

    def fetch(self, location: Location, folder: Path) -> Path:
        """Path of a regular file; remote storage copies it to `folder` first."""
        try:
            mode = os.stat(location.path).st_mode
        except OSError as error:
            raise InvalidInput(f"{location.path}: {one_line(error)}") from error
        if not stat.S_ISREG(mode):
            raise InvalidInput(f"{location.path}: not a regular file")
        return Path(location.path)

    def sweep(self, locations: Iterable[Location], mark: str) -> None:
        """Remove incomplete copies of these files left by a batch with this mark.

        On this machine the mark does not matter: any copy that no process is writing is removed.
        """
        for folder, names in by_folder(locations).items():
            try:
                entries = os.listdir(folder)
            except OSError:  # nothing was ever written there
                continue
            for entry in leftovers(entries, names):
                remove_leftover(os.path.join(folder, entry))


def scenes_among(
    paths: Iterable[str],
    suffixes: tuple[str, ...],
    others: Callable[[str], Iterable[str]] = lambda path: (),
) -> list[str]:
    """The paths with the suffixes, without the tiles and chunks of other scenes.

    `others` finds the other files of a scene. Where it finds none, `.glb` and `.sog` files below
    the folder of tiles or chunks are skipped. A warning counts what is skipped.
    """
    scenes, parts, folders = list[str](), set[str](), dict[PurePath, str]()
    skipped: Counter[str] = Counter()
    # Outer folders first, and in each of them descriptions first.
    for path in sorted(paths, key=lambda path: (path.count("/"), not _is(path, _DESCRIPTIONS))):
        above = folders and _is(path, _PARTS) and folders.keys() & {*PurePath(path).parents}
        if path in parts:
            continue
        if above:
            skipped[folders[above.pop()]] += 1
            continue
        files = set(others(path)) if _is(path, _DESCRIPTIONS) else set()
        parts |= files
        if _is(path, suffixes):
            scenes.append(path)
        elif files:
            skipped[path] += len(files)
        elif _is(path, (f"/{TILESET}", f"/{STREAMED}")):
            folders[PurePath(path).parent] = path
    if skipped:
        several, number = counted(len(skipped), "scene"), counted(skipped.total(), "file")
        text = "skipped %s of several files, such as %s, and %s of them; convert each to one file"
        log.warning(text, several, without_secrets(min(skipped)), number)
    return scenes


def _is(path: str, ends: tuple[str, ...]) -> bool:
    return path.lower().endswith(ends)


def _others(path: str) -> list[str]:
    with suppress(GsCodecError), open_scene(path) as file:
        return [_with_slashes(str(part)) for part in file.parts]
    return []


def _with_slashes(path: str) -> str:
    """A path as patterns and storage elsewhere have it; Windows accepts both."""
    return path.replace(os.sep, "/")


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
    """A folder and its visible subfolders; each link is followed once, last."""
    found: list[str] = []
    waiting, seen = deque([root]), set[str]()
    while waiting:
        start = waiting.popleft()
        above = os.path.realpath(os.path.dirname(start)) if start != root else ""
        for folder, names, _ in os.walk(start, onerror=_warn):
            real = os.path.realpath(folder)
            if real in seen or f"{above}/".startswith(f"{real.rstrip('/')}/"):
                log.warning("%s: links to %s, a parent or already read; skipped", folder, real)
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
    """The paths without duplicates of the same file; the file itself is preferred to links."""
    real_root, taken = os.path.realpath(root), dict[str, str]()
    real = {path: os.path.realpath(path) for path in paths}

    def is_link(path: str) -> bool:
        return real[path] != os.path.normpath(os.path.join(real_root, os.path.relpath(path, root)))

    for path in sorted(real, key=lambda path: (is_link(path), path)):
        if real[path] in taken:
            log.warning("%s: the same file as %s, skipped", path, taken[real[path]])
        taken.setdefault(real[path], path)
    return list(taken.values())


def present_files(path: str | Path) -> list[Path]:
    """A file, and the other files of its scene that exist."""
    first, *beside = scene_files(path) if os.path.isfile(path) else [Path(path)]
    return [first, *(each for each in beside if each.is_file())]


def file_sha256(*paths: str | Path) -> str:
    """SHA-256 of the bytes of files, one after another."""
    digest, block = hashlib.sha256(), bytearray(1 << 20)
    for path in paths:
        try:
            with open(path, "rb", buffering=0) as file:
                while length := file.readinto(block):
                    digest.update(memoryview(block)[:length])
        except OSError as error:
            raise InvalidInput(f"{path}: {one_line(error)}") from error
    return digest.hexdigest()


def fixed_part(pattern: str, wild: str = "*?[") -> str:
    """The leading folders of a glob, up to the first wildcard."""
    fixed = []
    for part in pattern.split("/")[:-1]:
        if any(sign in part for sign in wild):
            break
        fixed.append(part)
    return "/".join(fixed) or "/"


def by_folder(locations: Iterable[Location]) -> dict[str, set[str]]:
    """File names, grouped by folder."""
    folders: dict[str, set[str]] = {}
    for location in locations:
        folder, _, name = location.path.rpartition("/")
        folders.setdefault(folder or "/", set()).add(name)
    return folders
