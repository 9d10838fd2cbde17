"""Projects: several scenes in one, with Gaussians moved, removed and hidden, as a text file.

A project is a JSON object, written by the window of gs-viewer:

    {
     "project": 1,
     "scenes": [{"path": "room.ply", "name": "room", "gaussians": 41000, "centres": 7}, ...],
     "moves": [{"rows": "0-99,205", "matrix": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]}, ...],
     "removed": "7,300-310",
     "hidden": ""
    }

Paths are relative to the file. ``centres`` is the `centres_checksum` of a scene, which older
projects lack. Rows count the Gaussians of all scenes, in their order, from 0; in ``RDF``. Moves
are applied in their order; a row may be in several.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, printable
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.wording import counted

#: Suffix of project files.
SUFFIX = ".gsproj"

#: Maximum bytes of a project, and maximum number of Gaussians and of moves.
_LONGEST = 1 << 28
_MOST = 1 << 30
_MOST_MOVES = 10_000

#: What damaged text may raise.
_DAMAGE = (KeyError, TypeError, ValueError, OverflowError, RecursionError, AttributeError)

#: A mask ``(N,)``.
Mask = NDArray[np.bool_]


class Source(NamedTuple):
    """A scene of a project: its file, the name shown, and its Gaussians' number and checksum."""

    path: Path
    name: str
    gaussians: int
    centres: int | None = None

    def check(self, positions: NDArray[np.float32]) -> None:
        """Raise InvalidInput if the centres ``(3, N)`` are not those of this scene."""
        from gs_codec.preparation.prepare_report import centres_checksum

        count = positions.shape[1]
        if count != self.gaussians:
            found = counted(count, "Gaussian")
            raise InvalidInput(f"{self.path}: {found}, expected {self.gaussians:,}")
        if self.centres is not None and centres_checksum(positions) != self.centres:
            raise InvalidInput(f"{self.path}: has changed since the project was saved")


class Move(NamedTuple):
    """The rows moved, a mask ``(N,)``, and a matrix ``(4, 4)``."""

    rows: Mask
    matrix: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Project:
    """Scenes and their edits; see the module.

    Attributes
    ----------
    sources : tuple of Source
    moves : tuple of Move
    removed, hidden : ndarray, shape (N,), bool
        N is the sum of the sources' numbers of Gaussians.
    """

    sources: tuple[Source, ...]
    moves: tuple[Move, ...]
    removed: Mask
    hidden: Mask


def read_project(path: str | Path) -> Project:
    """Read a project.

    Raises
    ------
    InvalidInput
        If it cannot be read, or is not a project of this version.
    """
    try:
        with open(path, "rb") as file:
            text = file.read(_LONGEST + 1)
    except OSError as error:
        raise InvalidInput(f"{error.strerror}") from error
    try:
        if len(text) > _LONGEST:
            raise ValueError(f"more than {_LONGEST:,} bytes")
        return _project_of(parse_json(text), Path(path).parent)
    except _DAMAGE as error:
        why = str(error) if isinstance(error, ValueError) else "a field is missing or wrong"
        raise InvalidInput(f"not a project of gs-viewer ({why:.80})") from error


def _project_of(found: Any, folder: Path) -> Project:
    if found["project"] != 1:
        raise ValueError(f"version {found['project']!r:.20}, expected 1")
    sources = tuple(
        Source(
            folder / str(each["path"]),
            printable(str(each["name"])),
            int(each["gaussians"]),
            None if each.get("centres") is None else int(each["centres"]),
        )
        for each in found["scenes"]
    )
    count = sum(source.gaussians for source in sources)
    if not sources or min(source.gaussians for source in sources) < 0 or count > _MOST:
        raise ValueError("number of Gaussians")
    if len(found["moves"]) > _MOST_MOVES:
        raise ValueError("number of moves")
    moves = []
    for each in found["moves"]:
        matrix = np.eye(4)
        matrix[:3] = np.array(each["matrix"], np.float64).reshape(3, 4)
        moves.append(Move(read_rows(each["rows"], count), matrix))
    rows = (read_rows(found[name], count) for name in ("removed", "hidden"))
    return Project(sources, tuple(moves), *rows)


def project_text(project: Project, folder: Path) -> str:
    """The text of a project for a file in a folder."""
    scenes = [
        source._asdict() | {"path": _relative(source.path, folder)} for source in project.sources
    ]
    moves = [
        {"rows": rows_text(rows), "matrix": matrix[:3].tolist()} for rows, matrix in project.moves
    ]
    others = {name: rows_text(getattr(project, name)) for name in ("removed", "hidden")}
    return json.dumps({"project": 1, "scenes": scenes, "moves": moves, **others}, indent=1) + "\n"


def _relative(path: Path, folder: Path) -> str:
    # ".." in a folder that is a link leads elsewhere.
    real = path.parent.resolve() / path.name
    try:
        return Path(os.path.relpath(real, folder.resolve())).as_posix()
    except ValueError:  # on another drive of Windows
        return path.absolute().as_posix()


def rows_text(rows: Mask) -> str:
    """Rows of a mask ``(N,)`` as text, such as ``0-99,205``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.view(np.int8), [0]])))
    runs = edges.reshape(-1, 2) - (0, 1)
    return ",".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs.tolist())


def read_rows(text: str, count: int) -> Mask:
    """The mask ``(count,)`` of a text from `rows_text`; raises ValueError if it is none."""
    rows = np.zeros(count, bool)
    for run in text.split(",") if text else ():
        first, _, last = run.partition("-")
        start, stop = int(first), int(last or first) + 1
        if not 0 <= start < stop <= count:
            raise ValueError(f"rows {run:.20}, expected 0 to {count - 1}")
        rows[start:stop] = True
    return rows


def move_option(matrix: NDArray[np.float64]) -> str:
    """The option of ``gs-codec convert`` that moves all Gaussians by a matrix ``(4, 4)``."""
    shifts = np.array_equal(matrix[:3, :3], np.eye(3))
    name, numbers = ("translate", matrix[:3, 3]) if shifts else ("transform", matrix[:3].ravel())
    return f"--{name}={','.join(f'{number:.17g}' for number in numbers.tolist())}"
