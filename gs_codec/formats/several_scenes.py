"""What holds several scenes: a folder, a pattern such as ``frames/*.ply``, or a zip."""

from __future__ import annotations

import glob
from contextlib import suppress
from pathlib import Path, PurePath, PurePosixPath

from gs_codec.errors import InvalidInput
from gs_codec.format_table import BATCHED, STREAMED, TILESET, UNBUNDLED
from gs_codec.formats.zip_file import opened_zip
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted

#: Suffix of a zip of scenes.
ZIP_SUFFIX = ".zip"


def scenes_in(source: str | Path) -> tuple[str, list[PurePath]]:
    """``"folder"``, ``"pattern"`` or ``"zip"``, and the files in it; ``""`` for any other file.

    Files of folders and zips are scenes; those of patterns may be of any kind. Raises InvalidInput
    if a zip is damaged.
    """
    path = Path(source)
    if path.is_dir():
        return "folder", sorted(e for e in path.iterdir() if _is_scene(e.name) and e.is_file())
    if glob.has_magic(str(source)) and not path.exists():
        matching = map(Path, glob.glob(str(source), recursive=True))
        return "pattern", sorted(e for e in matching if e.is_file())
    if path.suffix.lower() != ZIP_SUFFIX or not path.is_file():
        return "", []
    with located(path), opened_zip(path) as archive:
        if archive.named(STREAMED) or archive.named(TILESET):
            return "", []  # the other files are parts of one scene
        entries = [PurePosixPath(name) for name in archive.names]
    # macOS adds files that only have attributes.
    return "zip", [e for e in entries if _is_scene(e.name) and "__MACOSX" not in e.parts]


def _is_scene(name: str) -> bool:
    """Whether a file in a folder or zip is a scene; names with a dot in front are hidden."""
    return name.lower().endswith(BATCHED) and not name.startswith(".")


def refuse_several(path: str | Path) -> None:
    """Raise InvalidInput if a path that should be one file holds several scenes, or is a folder."""
    kind, found = "", list[PurePath]()
    with suppress(InvalidInput, OSError):  # reported when it is opened
        kind, found = scenes_in(path)
    # Frames may have any meta.json beside them.
    names = (TILESET, STREAMED) if found else (TILESET, STREAMED, UNBUNDLED)
    if beside := [name for name in names if kind == "folder" and (Path(path) / name).is_file()]:
        raise InvalidInput(f"{path}: files of one scene; expected {Path(path) / beside[0]}")
    if len(found) > 1:
        raise InvalidInput(
            f"{path}: a {kind} of {counted(len(found), 'file')}, expected one file; if they are "
            "the frames of a sequence, encode them first"
        )
