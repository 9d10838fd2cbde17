"""Rows of the elements of PLY files."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain, islice, takewhile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.extra_properties import say_left_out
from gs_codec.formats.limits import refusing
from gs_codec.formats.ply.dialects import layout_names, with_halves
from gs_codec.formats.ply.ply_header import Element, PlyHeader, read_header
from gs_codec.formats.ply.writer import TILE, for_tiles
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.runtime.wording import counted

#: ``nan(ind)``, ``nan(snan)``, ``1.#QNAN``, ``1.#IND00``; ``1.#INF``.
_NOT_A_NUMBER = re.compile(rb"\b(?:nan\(\w*\)|1\.#(?:[qs]nan|ind)\d*)", re.IGNORECASE)
_INFINITY = re.compile(rb"\b1\.#inf\d*", re.IGNORECASE)


@dataclass(frozen=True)
class Rows:
    """Rows of an element, read tile by tile.

    Attributes
    ----------
    dtype : numpy.dtype
        Type of a row; its fields are the properties.
    count : int
        Number of rows.
    read : callable
        ``read(start, stop)`` returns these rows, ``(stop - start,)``.
    """

    dtype: np.dtype
    count: int
    read: Callable[[int, int], NDArray]

    def __len__(self) -> int:
        return self.count

    def for_tiles(self, use: Callable[[slice, NDArray], None]) -> None:
        """Call ``use(place, rows)`` with all rows, tile by tile, from several threads."""
        for_tiles(lambda a, b: use(slice(a, b), self.read(a, b)), self.count)

    def all(self) -> NDArray:
        """All rows at once."""
        return self.read(0, self.count)

    def pick(self, index: slice | NDArray[np.int64]) -> Rows:
        """The rows selected by `index`; a slice must have step 1."""
        if isinstance(index, slice):
            first, end, _ = index.indices(self.count)
            size = max(end - first, 0)
            return Rows(self.dtype, size, lambda a, b: self.read(first + a, first + b))

        def read(start: int, stop: int) -> NDArray:
            wanted = index[start:stop]
            found = np.empty(len(wanted), self.dtype)
            for tile in np.unique(wanted // TILE).tolist():
                own, first = wanted // TILE == tile, tile * TILE
                rows = self.read(first, min(first + TILE, self.count))
                found[own] = rows[wanted[own] - first]
            return found

        return Rows(self.dtype, len(index), read)


@dataclass(frozen=True)
class Ply:
    """A PLY file; `data` has all its bytes."""

    path: Path
    header: PlyHeader
    data: FileBytes

    def rows(self, name: str) -> Rows:
        """Rows of an element; those of a text file are all read at once.

        Raises InvalidInput if rows are missing, or have list properties.
        """
        element = self.header.elements[name]
        if element.lists:
            raise InvalidInput(
                f"property '{next(iter(element.lists))}' is a list, expected a scalar"
            )
        before = list(takewhile(lambda other: other is not element, self.header.elements.values()))
        if self.header.byte_order:
            return self._binary_rows(element, before)
        return self._text_rows(element, sum(e.count for e in before if e.types or e.lists))

    def _binary_rows(self, element: Element, before: list[Element]) -> Rows:
        start = self.header.size
        for other in before:
            if other.lists and other.count:
                raise InvalidInput(
                    f"element '{other.name}' with lists before '{element.name}', expected after"
                )
            start += other.count * other.dtype("<").itemsize
        dtype = element.dtype(self.header.byte_order)
        end = start + element.count * dtype.itemsize
        if end > len(self.data):
            there = max(len(self.data) - start, 0) // max(dtype.itemsize, 1)
            raise InvalidInput(
                f"element '{element.name}': {counted(element.count, 'row')}, but the "
                f"file ends in row {there}"
            )
        if element is self._last:
            self._say_surplus(element, len(self.data) - end, "byte")

        def read(first: int, last: int) -> NDArray:
            data = np.empty((last - first) * dtype.itemsize, np.uint8)
            self.data.read_into(data, start + first * dtype.itemsize)
            return data.view(dtype) if dtype.itemsize else np.empty(last - first, dtype)

        return Rows(dtype, element.count, read)

    @property
    def _last(self) -> Element:
        return next(reversed(self.header.elements.values()))

    def _say_surplus(self, last: Element, surplus: int, unit: str) -> None:
        """Log what follows the rows of the last element, if anything."""
        if surplus:
            said = f"{counted(surplus, unit)} after the last {last.name}"
            say_left_out(self.path, others=[said])

    def _text_rows(self, element: Element, skipped: int) -> Rows:
        body = _plain_numbers(bytes(self.data[self.header.size :]))
        # A number takes at least a digit and a space.
        if 2 * (skipped + element.count * max(len(element.types), 1)) > len(body) + 1:
            raise InvalidInput(
                f"element '{element.name}': {counted(element.count, 'row')} of "
                f"{counted(len(element.types), 'number')} after {skipped:,} of others, "
                f"but {counted(len(body), 'byte')} of text"
            )
        lines = io.TextIOWrapper(io.BytesIO(body), "latin-1")
        filled = (line for line in lines if line.strip())
        wanted = islice(filled, skipped, skipped + element.count)
        table = np.empty((0, len(element.types)))
        if element.count:
            with refusing(f"element '{element.name}'"), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # no lines at all: reported below
                table = np.loadtxt(wanted, np.float64, comments=None, ndmin=2, encoding="latin-1")
        if table.shape != (element.count, len(element.types)):
            raise InvalidInput(
                f"element '{element.name}': {counted(len(table), 'row')} of "
                f"{counted(table.shape[1], 'number')}, "
                f"expected {element.count:,} of {len(element.types)}"
            )
        if element is self._last:
            self._say_surplus(element, sum(1 for _ in chain(wanted, filled)), "line")
        rows = _typed(table, element)
        return Rows(rows.dtype, len(rows), lambda first, last: rows[first:last])


def _plain_numbers(body: bytes) -> bytes:
    """The rows of a text file, with Microsoft's spellings of infinity and NaN replaced."""
    if b"(" not in body and b"#" not in body:
        return body
    return _INFINITY.sub(b"inf", _NOT_A_NUMBER.sub(b"nan", body))


def _typed(table: NDArray[np.float64], element: Element) -> NDArray:
    """Convert numbers parsed from text to the row types in the header."""
    rows = np.empty(len(table), element.dtype("<"))
    for column, name in zip(table.T, element.types, strict=True):
        with np.errstate(all="ignore"):
            rows[name] = column
        if rows.dtype[name].kind != "f" and not np.array_equal(rows[name], column):
            raise InvalidInput(
                f"property '{name}': a number that is not a valid {rows.dtype[name].name}"
            )
    return rows


def ply_of(path: str | Path, data: FileBytes) -> Ply:
    """Read the header of a PLY file from its bytes; raises like `read_header`."""
    with located(path):
        header = read_header(data)
        if "vertex" in header.elements:
            vertex = header.elements["vertex"]
            vertex.types = layout_names(vertex.types)
            if header.byte_order:
                vertex.types = with_halves(vertex.types)
    return Ply(Path(path), header, data)
