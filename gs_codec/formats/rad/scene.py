"""Spark's `.rad` files: a tree of levels of detail, whose leaves are the scene.

Every node is a Gaussian; those with children are coarser versions of their descendants. Values are
floats, or bytes between two bounds. SH-AC may be rows of a table in the first chunk.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, printable
from gs_codec.formats.extra_properties import say_left_out
from gs_codec.formats.limits import check_count, most_bytes
from gs_codec.formats.packed_values import (
    largest_restored,
    log_scales_of,
    logits_of,
    sh_of_colours,
)
from gs_codec.formats.rad.file import PROPERTIES, Chunk, RadFile, Values
from gs_codec.runtime.mapped import FileBytes, located, total_bytes
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS, Scene, group_rows, sh_bands

log = logging.getLogger(__name__)

#: Steps between the bounds of logarithms of scales; byte 0 is a scale of 0.
STEPS = 254


def stated_size(path: Path, data: FileBytes) -> tuple[int, int]:
    """Number of Gaussians of all levels, and SH degree, from the header."""
    with located(path):
        return RadFile(path, data).stated_size


def files_beside(path: Path, data: FileBytes) -> list[Path]:
    """The files of the chunks of a `.rad`."""
    with located(path):
        return RadFile(path, data).others


def read_rad(path: Path, data: FileBytes, max_bytes: int | None) -> Scene:
    """Read the leaves of a `.rad` or `.radc` file; see `SceneFile.scene`."""
    with located(path):
        file = RadFile(path, data)
        file_bytes = len(data) + total_bytes(file.others)
        check_count(*file.stated_size, file_bytes, max_bytes)
        leaves, total, count = [], 0, file.stated_size[0]
        for chunk in file.chunks():
            total += chunk.count
            if total <= count:
                leaves.append(_leaves_of(path, chunk))
        if total != count:
            raise InvalidInput(f"chunks of {counted(total, 'Gaussian')}, expected {count:,}")
        left = sum(int(each.sum()) for each in leaves)
        if count and not left:
            raise InvalidInput(f"a tree of {counted(count, 'Gaussian')} without leaves")
        if file.is_part:
            log.warning("%s: one of several files; the others contain the rest of the scene", path)
        return _read_leaves(file, leaves, left, most_bytes(file_bytes, max_bytes))


def _leaves_of(path: Path, chunk: Chunk) -> NDArray[np.bool_]:
    """Which Gaussians of a chunk have no children."""
    unknown = sorted(map(printable, {*chunk.properties} - {*PROPERTIES}))
    if unknown:
        say_left_out(path, unknown)
    if "child_count" not in chunk.properties:
        return np.ones(chunk.count, bool)
    return chunk.read("child_count").numbers[0] == 0


def _read_leaves(file: RadFile, leaves: list[NDArray[np.bool_]], count: int, most: int) -> Scene:
    coefficients = SH_COEFFICIENTS[file.stated_size[1]]
    planes: dict[str, Any] = {
        group: np.zeros((rows, count), np.float32)
        for group, rows in group_rows(coefficients).items()
    }
    rest = planes["f_rest"].reshape(3, coefficients, count)
    tables: dict[int, NDArray] = {}
    start = 0
    for chunk, own in zip(file.chunks(), leaves, strict=True):
        some = slice(start, start + int(own.sum()))
        start = some.stop
        planes["positions"][:, some] = chunk.read("center").scaled()[:, own]
        planes["f_dc"][:, some] = sh_of_colours(chunk.read("rgb").scaled()[:, own])
        planes["opacity"][:, some] = _opacities(chunk.read("alpha"))[:, own]
        planes["log_scale"][:, some] = _log_scales(chunk.read("scales"))[:, own]
        planes["rot"][:, some] = _quaternions(chunk.read("orientation"))[:, own]
        for band, columns in enumerate(sh_bands(coefficients), 1):
            if (code := f"sh{band}_code") in chunk.properties:
                tables[band] = chunk.read(code, most).scaled()
            if (values := _sh(chunk, band, tables)) is not None:
                by_colour = values[:, own].reshape(len(columns), 3, -1).transpose(1, 0, 2)
                rest[:, columns.start : columns.stop, some] = by_colour
    return Scene(**planes)


def _opacities(values: Values) -> NDArray[np.float32]:
    """Logits; bytes of 0 and 1, which have none, are moved by a quarter of a step."""
    end = (values.high - values.low) / 255 / 4
    return logits_of(np.clip(values.scaled(), end, 1 - end))


def _log_scales(values: Values) -> NDArray[np.float32]:
    if values.encoding == "f32":
        return log_scales_of(values.numbers)
    if values.encoding == "ln_f16":
        return values.scaled()
    logarithms = values.low + (values.numbers - 1.0) * ((values.high - values.low) / STEPS)
    return np.where(values.numbers, logarithms, -np.inf).astype(np.float32)


def _quaternions(values: Values) -> NDArray[np.floating]:
    """Quaternions wxyz; bytes are an axis, as a point of an octahedron, and an angle to pi."""
    if values.encoding != "oct88r8":
        return largest_restored(values.scaled(), np.full(values.numbers.shape[1], 3))[[3, 0, 1, 2]]
    u, v, angle = values.numbers / 255
    x, y = 2 * u - 1, 2 * v - 1
    z = 1 - np.abs(x) - np.abs(y)
    folded = np.maximum(-z, 0)
    axis = np.stack([x - np.where(x < 0, -folded, folded), y - np.where(y < 0, -folded, folded), z])
    half = angle * (np.pi / 2)
    return np.vstack([np.cos(half), np.sin(half) * axis / np.sqrt((axis * axis).sum(axis=0))])


def _sh(chunk: Chunk, band: int, tables: dict[int, NDArray]) -> NDArray | None:
    """SH-AC of a band, ``(3 k, N)``, with the colours of a coefficient together; None if absent."""
    if "sh_label" not in chunk.properties:
        name = f"sh{band}"
        return chunk.read(name).scaled() if name in chunk.properties else None
    rows = chunk.read("sh_label").numbers[0]
    number = tables[band].shape[1] if band in tables else 0
    if rows.max(initial=0) >= max(number, 1):
        raise InvalidInput(f"row {rows.max()} of a table of {number:,} (sh{band}_code)")
    return tables[band][:, rows] if number else None
