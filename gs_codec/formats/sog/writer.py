"""Write SOG version 2; see `sog` for the format."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.far import bring_nearer
from gs_codec.coding.morton import spatial_order
from gs_codec.config import Effort
from gs_codec.errors import InvalidInput
from gs_codec.format_table import SOG, UNBUNDLED
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.codebook import choose_colours, choose_levels, make_table
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.images import write_webp
from gs_codec.formats.packed_values import (
    Clipped,
    check_finite,
    largest_omitted,
    planes_of,
    sigmoid,
    spans,
)
from gs_codec.formats.sog.files import FIRST_TAG, PALETTE_COLUMNS
from gs_codec.formats.sog.palette import fit_palette
from gs_codec.formats.zip_file import write_zip
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene, render_mode

#: Maximum pixels along a side of an image.
_LARGEST_SIDE = (1 << 14) - 4

#: Far Gaussians are moved onto a box this many times as large as that of the others. Coordinates
#: are logarithmic, so a factor of four makes their steps only a third to a half longer.
REACH = 4.0

#: Maximum magnitude of SH, because distances to palette rows are in float32.
_LARGEST_SH = 2.0**12

#: How hard WebP compresses; see `write_webp`. 20 makes files 0.5 to 1.4 % larger.
_QUALITIES: Mapping[Effort, int] = {"fast": 20, "normal": 80, "high": 80}

_BYTES = np.arange(256.0)

#: The entry of a group of attributes in `meta.json`, and its images by name.
_Group = tuple[dict[str, object], dict[str, NDArray[np.uint8]]]


def pack_sog(
    scene: Scene, steps: AttributeSteps | None = None, effort: Effort = "normal"
) -> tuple[bytes, tuple[str, ...]]:
    """Bytes of a `.sog` file, in Morton order; sentences on what it cannot represent.

    Raises InvalidInput if a value is not finite, or an image would have more pixels than WebP
    allows.

    Parameters
    ----------
    scene : Scene
    steps : AttributeSteps, optional
        Required accuracy; values are then stored in few bits. Default: full accuracy of the format.
    effort : {"fast", "normal", "high"}
        How long to search for rows of the palette, and to compress images.
    """
    check_finite(scene, ".sog")
    order = spatial_order(scene.positions, scene.log_scale)
    steps = AttributeSteps.least(scene) if steps is None else steps
    nearer, moved = bring_nearer(scene, REACH)
    files, (rounded, *lost) = sog_files_of(nearer.take(order), steps.take(order), effort)
    archive = io.BytesIO()
    write_zip(archive, files)
    return archive.getvalue(), (rounded, *moved, *lost)


def sog_files_of(
    scene: Scene, steps: AttributeSteps, effort: Effort
) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """The files of a scene by name, `meta.json` first, in the scene's order."""
    check_finite(scene, ".sog")
    if scene.count > _LARGEST_SIDE**2:
        raise InvalidInput(f"{counted(scene.count, 'Gaussian')}, .sog holds {_LARGEST_SIDE**2:,}")
    turned, clipped = turn_axes(scene), Clipped()
    f_rest = planes_of(
        len(turned.f_rest),
        scene.count,
        lambda some: clipped.limited("SH", turned.f_rest[:, some], -_LARGEST_SH, _LARGEST_SH),
    )
    turned = replace(turned, f_rest=f_rest)
    meta: dict[str, object] = {"version": 2, "count": scene.count}
    meta["asset"] = {"generator": "gs_codec"}
    if scene.antialiased:
        # As specified, and as splat-transform reads it.
        meta |= {"antialias": True, "model": "antialiased"}
    elif render_mode(scene.comments) == "2dgs":
        meta["model"] = "2dgs"
    images: dict[str, NDArray[np.uint8]] = {}
    groups = dict(_GROUPS)
    if scene.sh_degree:
        groups["shN"] = partial(_sh, effort=effort)
    for name, pack in groups.items():
        described, of_group = pack(turned, steps)
        meta[name] = described | {"files": list(of_group)}
        images |= of_group
    quality = _QUALITIES[effort]
    written = run_all(lambda pixels: write_webp(pixels, quality), images.values())
    files = {UNBUNDLED: json.dumps(meta).encode(), **dict(zip(images, written, strict=True))}
    return files, (SOG.rounding, *clipped.sentences(), *left_out_of(scene, SOG))


def _image(channels: Sequence[NDArray]) -> NDArray[np.uint8]:
    """An image with one pixel per Gaussian, of up to four bytes; missing bytes are 0, 0, 255."""
    count = len(channels[0])
    width = 4 * max(math.ceil(math.sqrt(count) / 4), 1)
    height = 4 * max(math.ceil(count / width / 4), 1)
    pixels = empty((height * width, 4), np.uint8)
    pixels[:] = 0, 0, 0, 255
    for channel, values in enumerate(channels):
        pixels[:count, channel] = values
    return pixels.reshape(height, width, 4)


def _centres(scene: Scene, steps: AttributeSteps) -> _Group:
    def pack(axis: int) -> tuple[float, float, NDArray, NDArray]:
        values = scene.positions[axis]
        logarithm = planes_of(1, scene.count, lambda some: _logarithm(values[some]), np.float64)[0]
        ends = logarithm if scene.count else np.zeros(1)
        least, most = float(ends.min()), float(ends.max())
        unit = (most - least) / 65535 or 1.0

        def place(some: slice) -> NDArray[np.float64]:
            share = (logarithm[some] - least) / unit
            high = np.rint(share).astype(np.int64) >> 8
            # A step of the logarithm spans more far from the origin.
            wanted = steps.positions[some] / (1 + np.abs(values[some].astype(np.float64))) / unit
            return np.stack([share - (high << 8), wanted, high])

        share, wanted, high = planes_of(3, scene.count, place, np.float64)
        return least, most, choose_levels(share, wanted, _BYTES), high

    mins, maxs, low, high = zip(*run_all(pack, range(3)), strict=True)
    images = {"means_l.webp": _image(low), "means_u.webp": _image(high)}
    return {"mins": mins, "maxs": maxs}, images


def _logarithm(values: NDArray[np.float32]) -> NDArray[np.float64]:
    wide = values.astype(np.float64)
    return np.copysign(np.log1p(np.abs(wide)), wide)


def _scales(scene: Scene, steps: AttributeSteps) -> _Group:
    table = make_table(scene.log_scale, steps.log_scale)
    levels = _levels(scene.log_scale, steps.log_scale, table)
    return {"codebook": numbers(table)}, {"scales.webp": _image(levels)}


def _rotations(scene: Scene, steps: AttributeSteps) -> _Group:
    by_unit = 255 * math.sqrt(0.5)

    def place(some: slice) -> NDArray[np.float64]:
        three, largest = largest_omitted(scene.rot[:, some])
        exact = by_unit * three + 127.5
        return np.vstack([exact, by_unit * steps.rot[some], FIRST_TAG + largest])

    *exact, wanted, tag = planes_of(5, scene.count, place, np.float64)
    levels = _levels(exact, [wanted] * 3, _BYTES)
    for some in spans(scene.count):
        part = np.stack([plane[some] for plane in levels])
        # Coarse rounding may leave nothing for the largest component, which readers compute from
        # the others.
        long = np.flatnonzero(((part - 127.5) ** 2).sum(axis=0) > by_unit**2)
        for plane, unrounded in zip(levels, exact, strict=True):
            plane[some][long] = np.rint(unrounded[some][long])
    return {}, {"quats.webp": _image([*levels, tag])}


def _colours(scene: Scene, steps: AttributeSteps) -> _Group:
    def place(some: slice) -> NDArray[np.float64]:
        share = sigmoid(scene.opacity[0, some].astype(np.float64))
        return np.stack([255 * share, 255 * share * (1 - share) * steps.opacity[some]])

    share, wanted = planes_of(2, scene.count, place, np.float64)
    alpha = choose_levels(share, wanted, _BYTES)
    table = make_table(scene.f_dc, steps.f_dc)
    colours = choose_colours(scene.f_dc.T[:, :, None], steps.f_dc[:, None], table)
    return {"codebook": numbers(table)}, {"sh0.webp": _image([*colours[:, :, 0].T, alpha])}


def _sh(scene: Scene, steps: AttributeSteps, effort: Effort) -> _Group:
    palette = fit_palette(scene.f_rest, steps.f_rest, effort)
    rows, coefficients = len(palette.levels), len(scene.f_rest) // 3
    height = -(-rows // PALETTE_COLUMNS)
    pixels = np.zeros((height * PALETTE_COLUMNS, coefficients, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[:rows, :, :3] = palette.levels.reshape(rows, 3, coefficients).transpose(0, 2, 1)
    images = {
        "shN_centroids.webp": pixels.reshape(height, -1, 4),
        "shN_labels.webp": _image([palette.labels & 255, palette.labels >> 8]),
    }
    described = {"count": rows, "bands": scene.sh_degree, "codebook": numbers(palette.table)}
    return described, images


def _levels(
    planes: Sequence[NDArray] | NDArray, steps: Sequence[NDArray] | NDArray, table: NDArray
) -> list[NDArray[np.uint8]]:
    return run_all(lambda i: choose_levels(planes[i], steps[i], table), range(3))


def numbers(table: NDArray[np.float32]) -> list[float]:
    """The shortest decimal numbers that round to these float32 values."""
    return [float(str(value)) for value in table]


_GROUPS: Mapping[str, Callable[[Scene, AttributeSteps], _Group]] = {
    "means": _centres,
    "scales": _scales,
    "quats": _rotations,
    "sh0": _colours,
}
