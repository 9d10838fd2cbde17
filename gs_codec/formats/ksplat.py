"""Read `.ksplat` files of mkkellogg's viewer (GaussianSplats3D).

A file has a header, then a header for each section, all of fixed size; then the sections, each with
a few tables and a row per Gaussian. Values are float32 (level 0), or half floats with centres as
16-bit offsets from the middle of a bucket (level 1), with SH-AC as bytes between two bounds in
addition (level 2). Red, green, blue and opacity are a byte each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.limits import check_count
from gs_codec.formats.packed_values import opacities_of, sh_of_colours
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS, Scene, sh_bands

_HEADER = np.dtype({
    "names": ["version", "sections", "count", "loaded", "level", "bounds"],
    "formats": [("u1", 2), "<u4", "<u4", "<u4", "<u2", ("<f4", 2)],
    "offsets": [0, 4, 12, 16, 20, 36],
    "itemsize": 4096,
})  # fmt: skip
_SECTION = np.dtype({
    "names": [
        "loaded", "count", "size", "buckets", "side", "bytes", "range", "full", "others", "degree",
    ],
    "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
    "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
    "itemsize": 1024,
})  # fmt: skip

#: Bounds of SH-AC if a file states 0.
_BOUNDS = (-1.5, 1.5)

#: Range of centres if a file states 0.
_RANGE = 32767

#: Types of centres, of scales and rotation, and of SH-AC, by level.
_TYPES = (("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))


@dataclass(frozen=True)
class _Section:
    """A section: header, rows, and the centres of buckets ``(buckets, 3)`` with their lengths."""

    header: np.void
    rows: NDArray
    buckets: NDArray[np.float32]
    lengths: NDArray[np.uint32]


def _headers(data: memoryview) -> tuple[np.void, NDArray]:
    if len(data) < _HEADER.itemsize:
        raise InvalidInput(f"{counted(len(data), 'byte')}, expected a header of {_HEADER.itemsize}")
    header = _counted(np.frombuffer(data, _HEADER, 1))[0]
    major, minor = header["version"].tolist()
    if (major, minor) != (0, 1) or header["level"] >= len(_TYPES):
        found = f"version {major}.{minor}, level {header['level']}"
        raise InvalidInput(f".ksplat: {found}, expected 0.1, level 0 to {len(_TYPES) - 1}")
    number = int(header["sections"])
    if _HEADER.itemsize + number * _SECTION.itemsize > len(data):
        raise InvalidInput(
            f".ksplat: {counted(number, 'section')}, more than the file has room for"
        )
    sections = _counted(np.frombuffer(data, _SECTION, number, _HEADER.itemsize))
    total = int(sections["count"].sum(dtype=np.int64))
    if total != header["count"] or (sections["degree"] > 2).any():
        degree = sections["degree"].max(initial=0)
        raise InvalidInput(
            f".ksplat: sections of {counted(total, 'Gaussian')} and SH degree {degree}, "
            f"expected {header['count']:,} and at most 2"
        )
    return header, sections


def _counted(headers: NDArray) -> NDArray:
    """Headers with the number of Gaussians; some writers state only the number of loaded ones."""
    counted = headers.copy()
    counted["count"] = np.where(headers["count"], headers["count"], headers["loaded"])
    return counted


def stated_size(path: Path, data: memoryview) -> tuple[int, int]:
    """Number of Gaussians and SH degree, from the header."""
    with located(path):
        return _size(*_headers(data))


def _size(header: np.void, sections: NDArray) -> tuple[int, int]:
    return int(header["count"]), int(sections["degree"].max(initial=0))


def read_ksplat(path: Path, data: memoryview, max_bytes: int | None) -> Scene:
    """Read the bytes of a `.ksplat` file; see `SceneFile.scene`."""
    with located(path):
        header, sections = _headers(data)
        count, degree = _size(header, sections)
        check_count(count, degree, len(data), max_bytes)
        found = _sections(data, header, sections)
    planes = {
        "positions": np.empty((3, count), np.float32),
        "f_rest": np.zeros((3, SH_COEFFICIENTS[degree], count), np.float32),
        "log_scale": np.empty((3, count), np.float32),
        "rot": np.empty((4, count), np.float32),
    }
    colour = np.empty((4, count), np.uint8)
    start = 0
    for section in found:
        some = slice(start, start + len(section.rows))
        start = some.stop
        with located(path):
            planes["positions"][:, some] = _centres(section)
        with np.errstate(divide="ignore", invalid="ignore"):  # reported later
            planes["log_scale"][:, some] = np.log(section.rows["scale"].T.astype(np.float64))
        planes["rot"][:, some] = section.rows["rot"].T
        colour[:, some] = section.rows["colour"].T
        _put_sh(planes["f_rest"][:, :, some], section.rows["sh"], header)
    return Scene(
        planes["positions"],
        sh_of_colours(colour[:3] / 255),
        planes["f_rest"].reshape(3 * SH_COEFFICIENTS[degree], count),
        opacities_of(path, colour[3]),
        planes["log_scale"],
        planes["rot"],
    )


def _sections(data: memoryview, header: np.void, sections: NDArray) -> list[_Section]:
    """The sections; each must be within the file."""
    found, start = [], _HEADER.itemsize + len(sections) * _SECTION.itemsize
    centre, shape, sh = _TYPES[header["level"]]
    for section in sections:
        channels = 3 * SH_COEFFICIENTS[section["degree"]]
        row = np.dtype([
            ("centre", centre, 3), ("scale", shape, 3), ("rot", shape, 4), ("colour", "u1", 4),
            ("sh", sh, (channels,)),
        ])  # fmt: skip
        count, buckets, others = (int(section[name]) for name in ("count", "buckets", "others"))
        first = start + 4 * others
        rows = first + int(section["bytes"]) * buckets
        end = rows + count * row.itemsize
        if end > len(data) or section["bytes"] not in (0, 12):
            raise InvalidInput(
                f".ksplat: section of {counted(end - start, 'byte')} at {start}, of a "
                f"file of {len(data):,}"
            )
        in_buckets = buckets if section["bytes"] else 0
        found.append(
            _Section(
                section,
                np.frombuffer(data, row, count, rows),
                np.frombuffer(data, "<f4", 3 * in_buckets, first).reshape(-1, 3),
                np.frombuffer(data, "<u4", others, start),
            )
        )
        start = end
    return found


def _centres(section: _Section) -> NDArray[np.float32]:
    """Centres ``(3, n)``; 16-bit ones are relative to the middle of their bucket."""
    rows, header = section.rows["centre"], section.header
    if rows.dtype.kind == "f":
        return rows.T
    full = int(header["full"])
    lengths = np.concatenate([
        np.full(min(full, len(section.buckets)), int(header["size"])),
        section.lengths.astype(np.int64),
    ])  # fmt: skip
    if len(lengths) != len(section.buckets) or lengths.sum() != len(rows):
        raise InvalidInput(
            f".ksplat: {counted(len(section.buckets), 'bucket')} of "
            f"{counted(lengths.sum(), 'Gaussian')}, "
            f"expected {full + len(section.lengths):,} of {len(rows):,}"
        )
    middle = int(header["range"]) or _RANGE
    step = float(header["side"]) / 2 / middle
    with np.errstate(over="ignore", invalid="ignore"):
        offsets = step * (rows.astype(np.float64) - middle)
        return (offsets + np.repeat(section.buckets, lengths, axis=0)).T.astype(np.float32)


def _put_sh(planes: NDArray[np.float32], sh: NDArray, header: np.void) -> None:
    """Set planes ``(3, K, n)`` from rows ``(n, 3k)``: band by band, each colour together."""
    values = sh.T
    if sh.dtype.kind == "u":
        low, high = (
            float(bound) if bound and not math.isnan(bound) else default
            for bound, default in zip(header["bounds"], _BOUNDS, strict=True)
        )
        with np.errstate(over="ignore", invalid="ignore"):
            values = values / 255.0 * (high - low) + low
    for band in sh_bands(len(values) // 3):
        rows = values[3 * band.start : 3 * band.stop]
        planes[:, band.start : band.stop] = rows.reshape(3, len(band), -1)
