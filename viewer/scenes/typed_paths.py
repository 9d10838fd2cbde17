"""Paths typed or pasted into a dialog, and the names that a dialog lists and suggests."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from urllib.parse import unquote, urlsplit

from gs_codec.edit.project_file import SUFFIX
from gs_codec.errors import InvalidInput, one_line, printable
from gs_codec.files.suffixes import WRITTEN
from gs_codec.formats.registry import SUFFIXES
from gs_codec.formats.several_scenes import ZIP_SUFFIX
from gs_codec.runtime.atomic import check_writable

#: Maximum number of listed files and folders.
MOST = 1000

#: List entry of the parent folder.
UP = "../"


@dataclass(frozen=True)
class Kind:
    """A kind of file; without suffixes, a folder.

    Attributes
    ----------
    name : str
    suffixes : tuple of str
        The first is added to names typed without a suffix.
    folders : bool
        Whether a folder may be opened instead.
    """

    name: str
    suffixes: tuple[str, ...] = ()
    folders: bool = False

    def suffix_of(self, name: str) -> str:
        """The longest suffix of this kind that a name has; "" if none."""
        return max((s for s in self.suffixes if name.lower().endswith(s)), key=len, default="")

    def named(self, name: str, suffix: str) -> str:
        """The name with its suffix of this kind replaced."""
        return name[: len(name) - len(self.suffix_of(name))] + suffix


#: Scenes that can be read and written, and the other kinds of file that the window asks for.
PROJECTS = Kind("projects", (SUFFIX,))
SCENES = Kind("3DGS scenes", (*SUFFIXES, SUFFIX))
SEQUENCES = Kind("3DGS scenes and sequences", (*SCENES.suffixes, ZIP_SUFFIX), folders=True)
SAVED_SCENES = Kind("3DGS scenes", tuple(suffix for suffix in WRITTEN if suffix[0] == "."))
TRIALS = Kind("gs_codec files", (".egs",))
PICTURES = Kind("PNG images", (".png",))
FILMS = Kind("films", (".mp4",))
POSES = Kind("cameras", (".json",))
NOTES = Kind("annotations", (".json",))
CAMERAS = Kind("cameras", (".json", ".bin", ".txt"))
REPORTS = Kind("reports of prepare", ("report.json",))
FOLDERS = Kind("folders")


def typed_path(text: str, folder: Path, saves: bool = False) -> Path:
    """Parse a typed path.

    Parameters
    ----------
    text : str
        Only the first line is used. It may be quoted, begin with ``~``, or be the URL of a local
        file (``file://``).
    folder : Path
        Folder for relative paths; the working directory is used if the file does not exist there.
    saves : bool
        Whether the file is to be written: then `folder` is used in any case.

    Raises
    ------
    InvalidInput
        If no path can be so.
    """
    line = (text.strip().splitlines() or [""])[0].strip()
    if len(line) > 1 and line[0] == line[-1] and line[0] in "'\"":
        line = line[1:-1]
    try:
        if line.startswith("file://"):
            line = unquote(urlsplit(line).path)
        with suppress(OSError):
            os.lstat(line)  # another error for NUL, or what is not Unicode
    except ValueError as error:
        raise InvalidInput(f"{line}: not a path") from error
    path = Path(os.path.expanduser(line))
    inside = folder / path
    elsewhere = not saves and os.path.exists(path) and not os.path.exists(inside)
    return path.absolute() if elsewhere else inside


def first_folder(scene: Path, last: Path | None = None) -> Path:
    """The folder to list first: the last one, that of a scene, or the working directory.

    If it was removed, one around it.
    """
    try:
        folder = last or (scene.absolute().parent if scene.name else Path.cwd())
    except FileNotFoundError:  # the working directory was removed
        folder = Path(os.sep)
    return next((each for each in (folder, *folder.parents) if each.is_dir()), folder)


def check_readable(path: Path, kind: Kind) -> None:
    """Check that a file or folder can be opened.

    Raises
    ------
    InvalidInput
        If it does not exist or cannot be read.
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
    """The path of a file to write; adds a suffix if it has none.

    Raises
    ------
    InvalidInput
        If the suffix does not belong to this kind, or the file cannot be written.
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
    """The subfolders of a folder, each with a trailing slash, and its files of a kind.

    `UP` comes first. Omits hidden entries, names that widgets cannot show, and entries after the
    first `MOST`.

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
    """Whether a widget can show a name; not if it is not Unicode, as names on Linux may be."""
    return printable(name) == name


def suggested(folder: Path, scene: Path, suffix: str, mark: str = "") -> str:
    """Suggest a new file name for a file made from a scene.

    Parameters
    ----------
    folder, scene : Path
        Target folder; file of the scene, an empty path if it has none.
    suffix : str
        Suffix of the new file.
    mark : str
        Text before the suffix.
    """
    stem = printable(SEQUENCES.named(SAVED_SCENES.named(scene.name, ""), "")) or "scene"
    numbers = chain([""], (f"-{k}" for k in count(2)))
    names = (f"{stem}{mark}{number}{suffix}" for number in numbers)
    return next(name for name in names if not os.path.lexists(folder / name))
