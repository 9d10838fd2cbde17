"""Annotations of a scene for pages: points with a title and a text."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gs_codec.cameras.json_fields import (
    as_list,
    as_numbers,
    as_object,
    as_text,
    get,
    load_json,
    short,
)
from gs_codec.errors import InvalidInput
from gs_codec.runtime.atomic import atomic_writer

#: Maximum number of annotations of a page, and characters of a title and of a text.
_MOST, _TITLE, _TEXT = 200, 200, 5000

#: Control characters except tabs and line ends, and lone surrogates.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")


@dataclass(frozen=True)
class Annotation:
    """A point of a scene, in the axes of its cameras, with a title and a text.

    Attributes
    ----------
    position : list of float
        x, y, z.
    title, text : str
        Plain text.
    view : int, optional
        Number of the view that the page goes to when the annotation is opened; by default the page
        turns to the point.
    """

    position: list[float]
    title: str
    text: str = ""
    view: int | None = None


def read_annotations(path: str | Path) -> list[Annotation]:
    """Read annotations: a JSON list of objects with the fields of `Annotation`.

    Raises InvalidInput if the file cannot be read, or has too many or invalid annotations.
    """
    path = Path(path)
    return _annotations(str(path), as_list(str(path), "annotations", load_json(path)))


def write_annotations(path: str | Path, notes: Sequence[Annotation]) -> None:
    """Write annotations atomically, as `read_annotations` reads them.

    Raises InvalidInput if there are too many or invalid ones, or OSError.
    """
    entries = [{k: v for k, v in asdict(note).items() if v is not None} for note in notes]
    _annotations(str(path), entries)
    with atomic_writer(Path(path)) as file:
        file.write((json.dumps(entries, indent=1, ensure_ascii=False) + "\n").encode())


def _annotations(where: str, entries: Sequence[Any]) -> list[Annotation]:
    if len(entries) > _MOST:
        raise InvalidInput(f"{where}: {len(entries):,} annotations, expected at most {_MOST}")
    return [_annotation(f"{where}: annotation {k}", entry) for k, entry in enumerate(entries, 1)]


def _annotation(where: str, entry: Any) -> Annotation:
    fields = as_object(where, entry, "position, title and text")
    unknown = sorted(set(fields) - set(Annotation.__dataclass_fields__))
    if unknown:
        expected = ", ".join(Annotation.__dataclass_fields__)
        raise InvalidInput(f"{where}: unknown field {unknown[0]!a}, expected {expected}")
    view = fields.get("view")
    if view is not None and not (type(view) is int and view >= 0):
        raise InvalidInput(f"{where}: view {short(view)}, expected a view's number")
    return Annotation(
        as_numbers(where, "position", get(where, fields, "position"), 3),
        _plain(where, "title", get(where, fields, "title"), _TITLE),
        _plain(where, "text", fields.get("text", ""), _TEXT),
        view,
    )


def _plain(where: str, key: str, value: Any, most: int) -> str:
    text = as_text(where, key, value).strip()
    if len(text) > most:
        raise InvalidInput(f"{where}: {key} of {len(text):,} characters, expected at most {most:,}")
    if not text and key == "title":
        raise InvalidInput(f"{where}: empty title")
    found = _UNPRINTABLE.search(text)
    if found:
        raise InvalidInput(f"{where}: {key} contains U+{ord(found[0]):04X}, expected text")
    return text
