"""SOG scenes, versions 1 and 2: values are pixels of WebP or PNG images that `meta.json` describes.

The files are in one zip (`.sog`), or next to `meta.json`. Centres are stored as 16-bit logarithms,
SH-AC as rows of a palette. All other values are bytes: table indices in version 2, positions
between two bounds in version 1.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.extra_properties import say_left_out
from gs_codec.formats.limits import check_count
from gs_codec.formats.packed_values import largest_restored, opacities_of, planes_of
from gs_codec.formats.ply.dialects import say_flat, with_flat
from gs_codec.formats.sog.files import (
    FIRST_TAG,
    PALETTE_COLUMNS,
    Meta,
    Unit,
    opened_files,
    read_pixels,
    unit_of,
)
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.runtime.wording import counted
from gs_codec.scene import ANTIALIASED, FLAT, SH_COEFFICIENTS, Scene

log = logging.getLogger(__name__)

#: Images may have this many pixels, and palettes this many rows, in addition to two pixels or one
#: row per Gaussian.
SPARE = 1 << 16

#: Model of flat Gaussians.
_FLAT = "2dgs"

#: Loads the pixels of an image, given its name, the maximum rows without `SPARE`, and pixels per
#: row.
_Load = Callable[..., NDArray[np.uint8]]


@contextmanager
def _opened(path: Path, data: memoryview | FileBytes) -> Iterator[tuple[Unit, int]]:
    """Open the scene of a `.sog` or `meta.json`; yields it, and the size of all its files."""
    with located(path), opened_files(path, data) as (files, name):
        unit = unit_of(files, name)
        yield unit, unit.stored_bytes or len(data)


def read_sog(path: Path, data: memoryview, max_bytes: int | None) -> Scene:
    """Read the bytes of a `.sog` file, or the scene of a `meta.json`; see `SceneFile.scene`."""
    with _opened(path, data) as (unit, file_bytes):
        scene, untold = scene_of_unit(path, unit, file_bytes, max_bytes)
    say_unread(path, {unit.meta.model}, untold)
    return scene


def say_unread(where: str | Path, models: set[str], untold: int) -> None:
    """Log what the files of a scene have that is not read as such: models, and rotations."""
    if _FLAT in models:
        say_flat(where)
    unknown = sorted(models - {"default", "antialiased", _FLAT})
    say_left_out(where, others=[f"unknown model {model!a:.40}" for model in unknown])
    if untold:
        many = counted(untold, "rotation")
        log.warning("%s: %s without a value, set to the identity", where, many)


def scene_of_unit(
    where: str | Path, unit: Unit, file_bytes: int, max_bytes: int | None, spare: int = SPARE
) -> tuple[Scene, int]:
    """Read a scene from files with `file_bytes` in total; messages begin with `where`.

    `spare` replaces `SPARE`, with less for each of many scenes. Also returns the number of
    rotations without a value; for these and the unknown model, see `say_unread`.
    """
    meta = unit.meta
    is_flat = meta.model == _FLAT

    def load(name: str, rows: int, width: int = 1) -> NDArray[np.uint8]:
        most = (rows + spare) * width
        # A pixel is four bytes; no writer makes a file twice as large as its pixels.
        return read_pixels(unit.files.read(name, 8 * most), name, most)

    check_count(meta.count, meta.bands or 0, file_bytes, max_bytes)
    colours = _values(meta, "sh0", load)
    if meta.version == 1:
        opacity = meta.tables["sh0"][colours[3], 3][None]
    else:
        opacity = opacities_of(where, colours[3])
    log_scale = _looked_up(meta.tables["scales"], _values(meta, "scales", load))
    rot, untold = _quaternions(_values(meta, "quats", load))
    scene = Scene(
        _centres(meta, load),
        _looked_up(meta.tables["sh0"], colours),
        _read_palette(meta, load, file_bytes, max_bytes),
        opacity,
        with_flat(log_scale[:2]) if is_flat else log_scale,
        rot,
        comments=(FLAT,) if is_flat else (ANTIALIASED,) if meta.antialiased else (),
    )
    return scene, untold


def files_beside(path: Path, data: FileBytes) -> list[Path]:
    """The images of a `meta.json`; a zip has none."""
    with _opened(path, data) as (unit, _):
        return unit.files.paths(unit.images)


def stated_size(path: Path, data: memoryview) -> tuple[int, int]:
    """Number of Gaussians and SH degree stated in `meta.json`; degree 3 if unknown."""
    with _opened(path, data) as (unit, _):
        return unit.meta.stated_size


def _values(meta: Meta, group: str, load: _Load, image: int = 0) -> NDArray[np.uint8]:
    """Bytes ``(4, N)`` of the Gaussians: one pixel each, in order."""
    name = meta.files[group][image]
    # The sides of images are rounded up to multiples of four.
    pixels = load(name, 2 * meta.count).reshape(-1, 4)
    if len(pixels) < meta.count:
        raise InvalidInput(
            f"image '{name}': {counted(len(pixels), 'pixel')}, expected {meta.count:,}"
        )
    return np.ascontiguousarray(pixels[: meta.count].T)


def _looked_up(table: NDArray[np.float32], values: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Look up the first three bytes of each Gaussian in the columns of a table."""

    def look_up(some: slice) -> NDArray[np.float32]:
        return _defined(np.stack([table[values[i, some], i] for i in range(3)]))

    return planes_of(3, values.shape[1], look_up)


def _defined(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Reject NaN in planes: tables have NaN beyond the end of their codebook."""
    if np.isnan(planes).any():
        raise InvalidInput("a byte beyond its codebook")
    return planes


def _centres(meta: Meta, load: _Load) -> NDArray[np.float32]:
    low, high = (_values(meta, "means", load, image) for image in range(2))
    ends = meta.means[:, :, None]

    def unfold(some: slice) -> NDArray[np.float64]:
        share = (low[:3, some] | high[:3, some].astype(np.int64) << 8) / 65535
        logarithm = ends[0] * (1 - share) + ends[1] * share
        return np.sign(logarithm) * np.expm1(np.abs(logarithm))

    with np.errstate(over="ignore"):  # infinite centres are reported later, as in a PLY
        return planes_of(3, meta.count, unfold)


def _quaternions(values: NDArray[np.uint8]) -> tuple[NDArray[np.float32], int]:
    """Quaternions, and the number of those without a value, which are set to the identity."""
    untold = values[3] < FIRST_TAG

    def restore(some: slice) -> NDArray[np.float32]:
        three = (values[:3, some] / 127.5 - 1) * np.sqrt(0.5)
        rot = largest_restored(three, values[3, some].astype(np.int64) - FIRST_TAG)
        rot[:, untold[some]] = np.array([[1], [0], [0], [0]], np.float32)
        return rot

    return planes_of(4, len(untold), restore), int(untold.sum())


def _read_palette(
    meta: Meta, load: _Load, file_bytes: int, max_bytes: int | None
) -> NDArray[np.float32]:
    """SH-AC ``(3 * K, N)``: each Gaussian has a row of the palette."""
    if "shN" not in meta.files:
        return np.empty((0, meta.count), np.float32)
    name = meta.files["shN"][0]
    pixels = load(name, meta.count, SH_COEFFICIENTS[3])
    height, width, _ = pixels.shape
    widths = [PALETTE_COLUMNS * k for k in SH_COEFFICIENTS]
    degree = widths.index(width) if width in widths else 0
    if not degree or meta.bands not in (None, degree):
        expected = widths[1:] if meta.bands is None else widths[meta.bands]
        raise InvalidInput(f"image '{name}': {counted(width, 'pixel')} wide, expected {expected}")
    check_count(meta.count, degree, file_bytes, max_bytes)
    low, high, *_ = _values(meta, "shN", load, 1)
    rows = low | high.astype(np.uint16) << 8
    there = min(meta.palette, height * PALETTE_COLUMNS)
    if rows.max(initial=0) >= max(there, 1):
        raise InvalidInput(f"row {rows.max()} of a palette of {there}")
    table = meta.tables["shN"]
    colours = pixels.reshape(height * PALETTE_COLUMNS, -1, 4)[..., :3]
    palette = table[colours, np.arange(3)].transpose(2, 1, 0).reshape(-1, len(colours))

    return planes_of(len(palette), meta.count, lambda some: _defined(palette[:, rows[some]]))
