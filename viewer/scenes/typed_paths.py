"""Paths that people type or paste into a dialog, and what a dialog lists and suggests."""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from urllib.parse import unquote, urlsplit

from gs_codec.errors import InvalidInput, one_line, printable
from gs_codec.files.suffixes import WRITTEN
from gs_codec.formats.registry import SUFFIXES
from gs_codec.runtime.atomic import check_writable

#: Most files and folders of a folder that are listed.
MOST = 1000

#: What leads to the folder above, in a list.
UP = "../"


@dataclass(frozen=True)
class Kind:
    """A kind of file; without suffixes, a folder.

    Attributes
    ----------
    name : str
    suffixes : tuple of str
        The first is that of names that are typed without one.
    """

    name: str
    suffixes: tuple[str, ...] = ()

    def suffix_of(self, name: str) -> str:
        """The longest suffix of the kind that a name has; "" without one."""
        return max((s for s in self.suffixes if name.lower().endswith(s)), key=len, default="")

    def named(self, name: str, suffix: str) -> str:
        """The name with another suffix of the kind."""
        return name[: len(name) - len(self.suffix_of(name))] + suffix


#: Scenes that are read and written, and the other kinds of file that the window asks for.
SCENES = Kind("3DGS scenes", SUFFIXES)
SAVED_SCENES = Kind("3DGS scenes", tuple(suffix for suffix in WRITTEN if suffix[0] == "."))
TRIES = Kind("gs_codec files", (".egs",))
PICTURES = Kind("PNG images", (".png",))
POSES = Kind("cameras", (".json",))
CAMERAS = Kind("cameras", (".json", ".bin", ".txt"))
REPORTS = Kind("reports of prepare", ("report.json",))
FOLDERS = Kind("folders")


def typed_path(text: str, folder: Path) -> Path:
    """The path that a text means.

    Parameters
    ----------
    text : str
        May be in quotes, begin with ``~``, or be the address of a local file (``file://``); only
        the first line counts.
    folder : Path
        What relative paths are relative to; if there is no such file, to the working directory.
    """
    line = (text.strip().splitlines() or [""])[0].strip()
    if len(line) > 1 and line[0] == line[-1] and line[0] in "'\"":
        line = line[1:-1]
    if line.startswith("file://"):
        line = unquote(urlsplit(line).path)
    path = Path(os.path.expanduser(line))
    inside = folder / path
    return path.absolute() if os.path.exists(path) and not os.path.exists(inside) else inside


def check_readable(path: Path, kind: Kind) -> None:
    """Check that a file, or a folder, can be opened.

    Raises
    ------
    InvalidInput
        If there is none, or it cannot be read.
    """
    what = "file" if kind.suffixes else "folder"
    if not os.path.lexists(path):
        raise InvalidInput(f"{path}: no such {what}")
    if not (path.is_file() if kind.suffixes else path.is_dir()):
        raise InvalidInput(f"{path}: not a {what}")
    try:
        if not kind.suffixes:
            os.scandir(path).close()
        else:
            with path.open("rb") as file:
                if not file.read(1):
                    raise InvalidInput(f"{path}: an empty file")
    except OSError as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from error


def to_write(path: Path, kind: Kind, suffix: str) -> Path:
    """The path of a file to be written, with a suffix if it has none.

    Raises
    ------
    InvalidInput
        If its suffix is not one of the kind, or it cannot be written.
    """
    if not path.suffix:
        path = path.with_name(path.name + suffix)
    elif not kind.suffix_of(path.name):
        raise InvalidInput(f"{path.name}: suffix '{path.suffix}', expected {_either(kind)}")
    check_writable(path)
    return path


def _either(kind: Kind) -> str:
    *first, last = kind.suffixes
    return f"{', '.join(first)} or {last}" if first else last


def listed(folder: Path, kind: Kind) -> list[str]:
    """The folders in a folder, each with a slash at its end, and the files of a kind.

    Hidden ones are left out, those that no widget can show, and those after the first `MOST`; `UP`
    comes first.

    Raises
    ------
    InvalidInput
        If the folder cannot be read.
    """
    folders, files = [], []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith("."):
                    continue
                if entry.is_dir():
                    folders.append(f"{entry.name}/")
                elif kind.suffix_of(entry.name):
                    files.append(entry.name)
    except OSError as error:
        raise InvalidInput(f"{folder}: {one_line(error)}") from error
    names = [*sorted(folders, key=str.casefold), *sorted(files, key=str.casefold)]
    return [UP, *filter(is_shown, names)][:MOST]


def is_shown(name: str) -> bool:
    """Whether a widget can show a name: not if it is no text, as names on Linux may be."""
    return printable(name) == name


def suggested(folder: Path, scene: Path, suffix: str, mark: str = "") -> str:
    """The name of a file that is made from a scene, one that the folder does not have.

    Parameters
    ----------
    folder, scene : Path
        Where it is to be; the file of the scene, an empty path if it has none.
    suffix : str
        Of the kind of file.
    mark : str
        What comes before the suffix.
    """
    stem = printable(SCENES.named(SAVED_SCENES.named(scene.name, ""), "")) or "scene"
    numbers = chain([""], (f"-{k}" for k in count(2)))
    names = (f"{stem}{mark}{number}{suffix}" for number in numbers)
    return next(name for name in names if not os.path.lexists(folder / name))
