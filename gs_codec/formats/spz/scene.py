"""Niantic's `.spz` files: versions 1 to 4 read, 3 and 4 written.

Centres are 24-bit fixed point (version 1: float16). Opacities, colours, log-scales and SH are one
byte per value. Quaternions xyzw are stored as their first three components, one byte each; from
version 3, as the index of the largest component and 10 bits for each of the others.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.far import Box, draw_nearer, find_far
from gs_codec.coding.morton import spatial_order
from gs_codec.config import Effort
from gs_codec.format_table import SPZ
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.packed_values import (
    Clipped,
    check_finite,
    largest_omitted,
    largest_restored,
    multiples,
    opacities_of,
    planes_of,
    sigmoid,
    spans,
)
from gs_codec.formats.spz.file import (
    ANTIALIASED,
    SYSTEM,
    Bytes,
    SpzHeader,
    pack_streams,
    read_streams,
)
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.mapped import located
from gs_codec.scene import SH_COEFFICIENTS, Scene, sh_bands, stated_comments

_COLOUR_SCALE = 0.15

#: Fraction bits to write, if the farthest centre leaves room for them.
_WRITTEN_BITS = 16

#: Maximum fixed-point magnitude of a centre's coordinate.
_FARTHEST = (1 << 23) - 1

#: Maximum magnitude of a quaternion component.
_LONGEST = 511

#: Minimum half width, in fixed-point units, of the box onto which far centres are moved: rounding
#: to coarse steps then stays in range.
_DRAWN = 15 << 19


def read_spz(path: Path, view: memoryview, max_bytes: int | None) -> Scene:
    """Read the bytes of an `.spz` file; see `SceneFile.scene`.

    A comment of the scene names its coordinate system.
    """
    with located(path):
        return scene_of_streams(path, *read_streams(path, view, max_bytes))


def scene_of_streams(path: Path, header: SpzHeader, streams: list[Bytes], system: str) -> Scene:
    """The scene in a file whose streams were read by `read_streams`."""
    count = header.count
    positions, alphas, colours, scales, rotations, sh = (
        np.frombuffer(stream, np.uint8).reshape(count, size).T
        for stream, size in zip(streams, header.sizes, strict=True)
    )
    sh = sh[: 3 * SH_COEFFICIENTS[header.read_degree]]
    rotate = _first_three if header.version < 3 else _smallest_three
    return Scene(
        planes_of(3, count, lambda some: _positions(positions[:, some], header)),
        planes_of(3, count, lambda some: (colours[:, some] / 255 - 0.5) / _COLOUR_SCALE),
        planes_of(len(sh), count, lambda some: _f_rest(sh[:, some])),
        opacities_of(path, alphas[0]),
        planes_of(3, count, lambda some: scales[:, some] / np.float32(16) - 10),
        planes_of(4, count, lambda some: rotate(rotations[:, some])),
        comments=stated_comments(system, bool(header.flags & ANTIALIASED)),
    )


def _f_rest(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Reorder SH-AC to ``(3 * K, n)``: all coefficients of one colour channel together."""
    by_colour = rows.reshape(len(rows) // 3, 3, rows.shape[1]).transpose(1, 0, 2)
    return (by_colour.reshape(rows.shape).astype(np.float32) - 128) / 128


def centre_range(path: Path, data: bytes) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lowest and highest coordinates of centres in a file that `pack_spz` made."""
    header, streams, _ = read_streams(path, memoryview(data), sys.maxsize)
    rows = np.frombuffer(streams[0], np.uint8).reshape(header.count, -1).T
    centres = _positions(rows, header)
    return centres.min(axis=1), centres.max(axis=1)


def _positions(rows: NDArray[np.uint8], header: SpzHeader) -> NDArray[np.float32]:
    if header.version == 1:
        with np.errstate(invalid="ignore"):  # signalling NaN
            return np.ascontiguousarray(rows.T).view("<f2").T.astype(np.float32, order="C")
    low, middle, high = (rows[i::3].astype(np.int32) for i in range(3))
    fixed = low | middle << 8 | (high ^ 128) - 128 << 16
    return (fixed * 2.0**-header.fraction_bits).astype(np.float32)


def _first_three(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    xyz = rows / 127.5 - 1
    return largest_restored(xyz, np.zeros(rows.shape[1], np.int64))


def _smallest_three(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    packed = np.ascontiguousarray(rows.T).view("<u4")[:, 0]
    fields = np.stack([(packed >> shift) & 1023 for shift in (20, 10, 0)]).astype(np.int64)
    three = np.where(fields & 512, -1.0, 1.0) * (fields & 511) * (np.sqrt(0.5) / 511)
    return largest_restored(three, (packed >> 30).astype(np.int64))[[3, 0, 1, 2]]


def pack_spz(
    scene: Scene,
    version: int = 3,
    steps: AttributeSteps | None = None,
    effort: Effort = "normal",
    system: str = SYSTEM,
    clipped: Clipped | None = None,
) -> tuple[bytes, tuple[str, ...]]:
    """Bytes of an `.spz` file of version 3 or 4; sentences on what it cannot represent.

    Gaussians are in Morton order. Far Gaussians are moved
    nearer if they would cost the others fraction bits. Raises InvalidInput if a value is not
    finite.

    Parameters
    ----------
    scene : Scene
    version : {3, 4}
    steps : AttributeSteps, optional
        Values are rounded to multiples of the format's step, up to about these steps, for a smaller
        file. Default: full accuracy of the format.
    effort : {"fast", "normal", "high"}
        How long to compress.
    system : str
        Coordinate system of the values, which is not stated. Default: the format's own.
    clipped : Clipped, optional
        Counts what is clipped, without a sentence.
    """
    check_finite(scene, ".spz")
    order = spatial_order(scene.positions, scene.log_scale)
    steps = AttributeSteps.least(scene) if steps is None else steps.take(order)
    found = find_far(scene.positions, scene.log_scale)
    ends = scene.positions if found is None else np.stack([found.near.low, found.near.high])
    farthest = float(np.abs(ends).max(initial=0.0))
    bits = _fraction_bits(farthest)
    edge = np.full(3, max(farthest, _DRAWN * 2.0**-bits))
    nearer, moved = draw_nearer(scene, found, Box(-edge, edge))
    turned = turn_axes(nearer.take(order), system)
    flags = ANTIALIASED if scene.antialiased else 0
    header = SpzHeader(version, scene.count, scene.sh_degree, bits, flags)
    streams = [empty((scene.count, size), np.uint8) for size in header.sizes]
    own = Clipped() if clipped is None else clipped
    for some in spans(scene.count):
        part = turned.between(some.start, some.stop)
        packed = _bytes_of(part, steps.between(some), bits, own)
        for stream, rows in zip(streams, packed, strict=True):
            stream[some] = rows.T
    said = () if clipped is not None else (*own.sentences(), *_fitting(scene, own))
    lost = (SPZ.rounding, *moved, *said, *left_out_of(scene, SPZ))
    return pack_streams(header, streams, effort), lost


def _fitting(scene: Scene, clipped: Clipped) -> Iterator[str]:
    """A sentence on the power of ten that scales a scene into the range, if one does."""
    before = clipped.counts.get("log-scales")
    if not before:
        return
    low, high = -10, 255 / 16 - 10
    middle = float(np.median(np.clip(scene.log_scale, -99, 99)))  # no float holds e^1000
    power = round(((low + high) / 2 - middle) / math.log(10))
    scaled = scene.log_scale + np.float32(power * math.log(10))
    if np.count_nonzero(((scaled < low) | (scaled > high)).any(axis=0)) <= before / 2:
        yield f"scaled by {10.0**power:g}, the scene would fit the format's range better"


def _fraction_bits(farthest: float) -> int:
    """Number of fraction bits that fit with a coordinate of this magnitude."""
    room = math.floor(math.log2(_FARTHEST / farthest)) if farthest else _WRITTEN_BITS
    return min(max(room, 0), _WRITTEN_BITS)


def _bytes_of(
    scene: Scene, steps: AttributeSteps, bits: int, clipped: Clipped
) -> tuple[NDArray, ...]:
    """Bytes ``(size, n)`` of each attribute."""
    unit = 2.0**-bits
    centres = multiples(scene.positions / unit, steps.positions / unit)
    fixed = clipped.limited("centres", centres, -_FARTHEST, _FARTHEST).astype(np.int32)
    share = sigmoid(scene.opacity.astype(np.float64))
    alphas = multiples(255 * share, 255 * share[0] * (1 - share[0]) * steps.opacity)
    colours = (_COLOUR_SCALE * scene.f_dc.astype(np.float64) + 0.5) * 255
    scales = multiples((scene.log_scale.astype(np.float64) + 10) * 16, 16 * steps.log_scale)
    return (
        np.stack([fixed >> shift & 255 for shift in (0, 8, 16)], axis=1).reshape(9, -1),
        np.clip(alphas, 0, 255),
        clipped.limited("colours", np.rint(colours), 0, 255),
        clipped.limited("log-scales", scales, 0, 255),
        _packed_rotations(scene.rot, steps.rot),
        _packed_sh(scene, steps, clipped),
    )


def _packed_rotations(rot: NDArray[np.float32], steps: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Index of the largest component xyzw, then a sign bit and 9 bits of each other."""
    three, largest = largest_omitted(rot[[1, 2, 3, 0]])
    by_unit = _LONGEST / np.sqrt(0.5)
    levels = multiples(three * by_unit, steps * by_unit)
    # Coarse rounding may leave nothing for the largest component, which readers compute from the
    # others.
    long = (levels * levels).sum(axis=0) > by_unit**2
    levels[:, long] = multiples(three[:, long] * by_unit, steps[long] * by_unit, np.trunc)
    levels = np.clip(levels, -_LONGEST, _LONGEST).astype(np.int32)
    fields = np.where(levels < 0, 512, 0) | np.abs(levels)
    packed = largest << 30 | fields[0] << 20 | fields[1] << 10 | fields[2]
    return packed.astype("<u4")[:, None].view(np.uint8).T


def _packed_sh(scene: Scene, steps: AttributeSteps, clipped: Clipped) -> NDArray:
    """SH-AC ``(3 * K, n)``, with the colours of a coefficient together; see `_f_rest`."""
    rest = scene.f_rest.reshape(3, -1, scene.count).astype(np.float64)
    packed = np.empty((rest.shape[1], 3, scene.count))
    for band, coefficients in enumerate(sh_bands(rest.shape[1])):
        for k in coefficients:
            packed[k] = multiples(128 * rest[:, k], 128 * steps.f_rest[band]) + 128
    return clipped.limited("SH", packed.reshape(-1, scene.count), 0, 255)
