"""PlayCanvas's PLY of packed properties (`.compressed.ply`), in chunks of 256 Gaussians.

Centres and scales are stored relative to the bounds of their chunk, with 11, 10 and 11 bits for x,
y and z. A quaternion is stored as three components of 10 bits and the index of the fourth, a
colour channel or opacity as a byte.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.far import bring_nearer
from gs_codec.coding.morton import spatial_order
from gs_codec.errors import InvalidInput
from gs_codec.format_table import COMPRESSED_PLY
from gs_codec.formats.attribute_steps import ShGrid
from gs_codec.formats.extra_properties import left_out_of, say_degree_4
from gs_codec.formats.limits import check_count
from gs_codec.formats.packed_values import (
    Clipped,
    check_finite,
    largest_omitted,
    largest_restored,
    opacities_of,
    sh_of_colours,
    sigmoid,
    spans,
)
from gs_codec.formats.ply.body import Ply
from gs_codec.formats.ply.ply_header import PlyHeader
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import DEGREE_4, SH_C0, SH_COEFFICIENTS, Scene, stated_comments

PACKED_ELEMENTS = ("chunk", "vertex", "sh")

_CHUNK = 256
_PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")

#: Properties of a chunk. Files from before 2024 have no colour bounds, which are then 0 and 1.
_BOUNDS = [f"{end}_{of}{axis}" for of in ("", "scale_") for axis in "xyz" for end in ("min", "max")]
_COLOUR_BOUNDS = [f"{end}_{axis}" for axis in "rgb" for end in ("min", "max")]

#: Bits of centres and scales on each axis.
_BITS = (11, 10, 11)


def is_packed(header: PlyHeader) -> bool:
    """Whether a PLY file has packed properties."""
    vertex = header.elements.get("vertex")
    return vertex is not None and _PACKED[0] in vertex.types


def beyond_packed(header: PlyHeader) -> list[str]:
    """Properties of a packed PLY that are not read."""
    known = {"vertex": _PACKED, "chunk": [*_BOUNDS, *_COLOUR_BOUNDS]}
    return [
        name
        for element, names in known.items()
        if element in header.elements
        for name in header.elements[element].types
        if name not in names
    ]


def read_packed(ply: Ply, max_bytes: int | None) -> Scene:
    """Read the Gaussians of a packed PLY; see `SceneFile.scene`."""
    elements = ply.header.elements
    if "chunk" not in elements:
        raise InvalidInput("packed properties without element 'chunk'")
    vertex, chunk, sh = elements["vertex"], elements["chunk"], elements.get("sh")
    has_colours = any(name in chunk.types for name in _COLOUR_BOUNDS)
    bounds = _BOUNDS + _COLOUR_BOUNDS if has_colours else _BOUNDS
    _check_types("vertex", vertex.types, _PACKED, "u4")
    _check_types("chunk", chunk.types, bounds, "f4")
    chunks = -(-vertex.count // _CHUNK)
    if chunk.count != chunks:
        raise InvalidInput(f"element 'chunk': {counted(chunk.count, 'row')}, expected {chunks:,}")
    coefficients = 0 if sh is None else _check_sh(sh.types, sh.count, vertex.count)
    if coefficients == DEGREE_4:
        say_degree_4(ply.path)
    degree = SH_COEFFICIENTS.index(min(coefficients, SH_COEFFICIENTS[-1]))
    check_count(vertex.count, degree, len(ply.data), max_bytes)
    rows, limits = ply.rows("vertex").all(), ply.rows("chunk").all()
    position, rotation, scale, colour = (rows[name].astype(np.uint32) for name in _PACKED)
    rgba = np.stack([(colour >> shift) & 255 for shift in (24, 16, 8, 0)]).astype(np.uint8)
    shares = rgba[:3] / 255
    if has_colours:
        shares = _between(limits, "", "rgb", shares)
    return Scene(
        _between(limits, "", "xyz", _split(position)).astype(np.float32),
        sh_of_colours(shares),
        _read_sh(ply, coefficients, vertex.count),
        opacities_of(ply.path, rgba[3]),
        _between(limits, "scale_", "xyz", _split(scale)).astype(np.float32),
        _quaternions(rotation),
        comments=ply.header.comments,
    )


def stated_size(header: PlyHeader) -> tuple[int, int]:
    """Number of Gaussians and SH degree in the header of a packed PLY."""
    sh = header.elements.get("sh")
    coefficients = 0 if sh is None else len(sh.types) // 3
    degree = SH_COEFFICIENTS.index(coefficients) if coefficients in SH_COEFFICIENTS else 3
    return header.elements["vertex"].count, degree


def _check_types(element: str, types: dict[str, str], names: Sequence[str], code: str) -> None:
    wrong = [name for name in names if types.get(name) != code]
    if wrong:
        found = types.get(wrong[0], "missing")
        raise InvalidInput(f"element '{element}': {wrong[0]} is {found}, expected {code}")


def _check_sh(types: dict[str, str], count: int, gaussians: int) -> int:
    """Check element `sh`; return its SH-AC coefficients per colour channel."""
    if len(types) not in [3 * k for k in (*SH_COEFFICIENTS, DEGREE_4)]:
        raise InvalidInput(
            f"element 'sh': {counted(len(types), 'property')}, expected 9, 24, 45 or 72"
        )
    if count != gaussians:
        raise InvalidInput(f"element 'sh': {counted(count, 'row')}, expected {gaussians:,}")
    _check_types("sh", types, [f"f_rest_{i}" for i in range(len(types))], "u1")
    return len(types) // 3


def _split(packed: NDArray[np.uint32]) -> NDArray[np.float64]:
    """Split into 11, 10 and 11 bits, from the highest, each scaled to 0-1."""
    return np.stack([(packed >> 21) / 2047, ((packed >> 11) & 1023) / 1023, (packed & 2047) / 2047])


def _between(limits: NDArray, prefix: str, axes: str, shares: NDArray) -> NDArray[np.float64]:
    """Interpolate shares (0-1) between the bounds of their chunks."""
    values = np.empty_like(shares)
    for value, share, axis in zip(values, shares, axes, strict=True):
        with np.errstate(invalid="ignore"):  # a bound may be infinite or NaN
            ends = [limits[f"{end}_{prefix}{axis}"].astype(np.float64) for end in ("min", "max")]
            low, high = (np.repeat(end, _CHUNK)[: len(share)] for end in ends)
            value[:] = low * (1 - share) + high * share
    return values


def _quaternions(packed: NDArray[np.uint32]) -> NDArray[np.float32]:
    three = np.stack([(packed >> shift) & 1023 for shift in (20, 10, 0)])
    return largest_restored((three / 1023 - 0.5) * np.sqrt(2), (packed >> 30).astype(np.int64))


def _read_sh(ply: Ply, coefficients: int, count: int) -> NDArray[np.float32]:
    """SH-AC: a byte is the middle of one of 256 equal bins from -4 to 4; 0 and 255 are the ends."""
    kept = min(coefficients, SH_COEFFICIENTS[-1])
    planes = np.empty((3, kept, count), np.float32)
    if kept:
        share = (np.arange(256) + 0.5) / 256
        share[[0, 255]] = 0, 1
        values = ((share - 0.5) * 8).astype(np.float32)
        rows = ply.rows("sh").all()
        for colour, k in np.ndindex(3, kept):
            planes[colour, k] = values[rows[f"f_rest_{colour * coefficients + k}"]]
    return planes.reshape(3 * kept, count)


def pack_ply(scene: Scene) -> tuple[bytes, tuple[str, ...]]:
    """Bytes of a packed PLY, in Morton order; sentences on what it cannot represent.

    The range of a chunk covers all its values: clipping outliers gains nothing (measured on
    centres, scales and colours). Far Gaussians come last and are moved onto the box of the others,
    because one chunk has both near and far ones. Raises InvalidInput if a value is not finite.
    """
    check_finite(scene, ".compressed.ply")
    nearer, moved = bring_nearer(scene)
    scene = nearer.take(spatial_order(scene.positions, scene.log_scale))
    columns, ranges = _packed_shares(scene)
    vertex = np.empty(scene.count, [(name, "<u4") for name in _PACKED])
    vertex["packed_position"] = _joined(columns[:3], _BITS)
    vertex["packed_scale"] = _joined(columns[3:6], _BITS)
    alpha = np.rint(255 * sigmoid(scene.opacity.astype(np.float64)))
    vertex["packed_color"] = _joined([*columns[6:], alpha[0].astype(np.uint32)], (8, 8, 8, 8))
    three, largest = largest_omitted(scene.rot)
    fields = np.rint((three * np.sqrt(0.5) + 0.5) * 1023).astype(np.uint32)
    vertex["packed_rotation"] = _joined([largest.astype(np.uint32), *fields], (2, 10, 10, 10))
    clipped = Clipped()
    sh = _packed_sh(scene, clipped)
    data = b"".join([_header_of(scene).encode(), ranges.tobytes(), vertex.tobytes(), sh.tobytes()])
    left_out = left_out_of(scene, COMPRESSED_PLY)
    return data, (COMPRESSED_PLY.rounding, *moved, *clipped.sentences(), *left_out)


def _header_of(scene: Scene) -> str:
    coefficients = SH_COEFFICIENTS[scene.sh_degree]
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {line}" for line in stated_comments(scene.coordinates, scene.antialiased)]
    lines += [f"element chunk {-(-scene.count // _CHUNK)}"]
    for prefix, axes in (("", "xyz"), ("scale_", "xyz"), ("", "rgb")):
        for end in ("min", "max"):
            lines += [f"property float {end}_{prefix}{axis}" for axis in axes]
    lines += [f"element vertex {scene.count}", *(f"property uint {name}" for name in _PACKED)]
    if coefficients:
        lines.append(f"element sh {scene.count}")
        lines += [f"property uchar f_rest_{i}" for i in range(3 * coefficients)]
    return "\n".join([*lines, "end_header\n"])


def _joined(columns: Sequence[NDArray[np.uint32]], bits: Sequence[int]) -> NDArray[np.uint32]:
    """Join columns into 32 bits, from the highest."""
    packed = np.zeros(len(columns[0]), np.uint32)
    for column, width in zip(columns, bits, strict=True):
        packed = packed << np.uint32(width) | column
    return packed


def _packed_shares(scene: Scene) -> tuple[list[NDArray[np.uint32]], NDArray[np.float32]]:
    """Nine columns of centres, scales and colours; and the ranges ``(chunks, 18)`` as stored."""
    planes = [*scene.positions, *scene.log_scale, *(SH_C0 * scene.f_dc.astype(np.float64) + 0.5)]
    chunks = -(-scene.count // _CHUNK)
    ranges = np.empty((chunks, 3, 2, 3), "<f4")

    def pack(column: int) -> NDArray[np.uint32]:
        levels = (1 << (*_BITS, *_BITS, 8, 8, 8)[column]) - 1
        packed = np.empty(scene.count, np.uint32)
        for some in spans(scene.count):
            short = -(some.stop - some.start) % _CHUNK
            values = np.pad(planes[column][some], (0, short), "edge").reshape(-1, _CHUNK)
            ends = np.stack([values.min(axis=1), values.max(axis=1)]).astype(np.float32)
            ranges[some.start // _CHUNK :, column // 3, :, column % 3][: len(values)] = ends.T
            low, high = ends.astype(np.float64)[:, :, None]
            share = (values - low) / np.where(high > low, high - low, 1.0)
            packed[some] = np.rint(np.clip(share, 0, 1) * levels).ravel()[: some.stop - some.start]
        return packed

    return run_all(pack, range(9)), ranges.reshape(chunks, 18)


def sh_grid(count: int) -> ShGrid:
    """The levels of SH-AC of a file."""
    return ShGrid(np.full((3, count), 8 / 256, np.float32), 0.5)


def _packed_sh(scene: Scene, clipped: Clipped) -> NDArray[np.uint8]:
    """SH-AC ``(N, 3 * K)``; see `_read_sh`."""
    packed = np.empty((scene.count, len(scene.f_rest)), np.uint8)
    for some in spans(scene.count):
        bins = np.floor((scene.f_rest[:, some].astype(np.float64) / 8 + 0.5) * 256)
        # The outermost bins represent -4 and 4 themselves.
        packed[some] = clipped.limited("SH", bins, 0, 255).T
    return packed
