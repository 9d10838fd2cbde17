"""Write a tree of levels of detail as a `.rad`: values as bytes between two bounds, as in Spark.

More precision would be lost: Spark keeps the same bits in memory.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from itertools import accumulate, pairwise, starmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Effort
from gs_codec.format_table import RAD
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.packed_values import Clipped, multiples, sigmoid, unit_quaternions
from gs_codec.formats.rad.file import CHUNK_MAGIC, MAGIC, UNIT, VERSION
from gs_codec.formats.rad.scene import STEPS
from gs_codec.formats.spz.file import GZIP_LEVELS
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_C0, SH_COEFFICIENTS, Scene, sh_bands

#: Number of Gaussians of a chunk: Spark's viewer expects this number.
CHUNK = 1 << 16

#: Bounds of colours, unless they are closer together.
_COLOURS = (-1.0, 2.0)

#: Maximum distance between the bounds of log-scales: 254 steps of 1/16.
_SCALES = 15.875

#: Maximum bound of SH-AC.
_SH = 1.0

#: Minimum distance between bounds, relative to them if they are above 1.
_NARROWEST = 1e-3

#: Axes of smaller rotations do not matter.
_LEAST_SINE = 1e-6


def pack_tree(
    scene: Scene, steps: AttributeSteps, children: NDArray[np.integer], effort: Effort
) -> tuple[bytes, tuple[str, ...]]:
    """The bytes of a `.rad` file of a tree, and sentences on values that it cannot represent.

    Of the Gaussians after the first, each takes the next ``children (N,)`` in order.
    """
    bounds, common = _bounds(scene), {"maxSh": scene.sh_degree}
    starts = np.where(children, 1 + np.cumsum(children) - children, 0)
    if children.any():
        common["lodTree"] = True

    def chunk(some: slice) -> tuple[bytes, Clipped]:
        part, clipped = scene.between(some.start, some.stop), Clipped()
        values = dict(_values(part, steps.between(some), bounds, clipped))
        if children.any():
            values["child_count", "u16"] = children[some].astype("<u2")
            values["child_start", "u32"] = starts[some].astype("<u4")
        about = {"version": VERSION, "base": some.start, "count": part.count} | common
        return _chunk(about, values, bounds, effort), clipped

    ends = [*range(0, scene.count, CHUNK), scene.count]
    chunks, clipped = zip(*run_all(chunk, starmap(slice, pairwise(ends))), strict=True)
    sizes = [len(data) for data in chunks]
    offsets = accumulate(sizes, initial=0)
    about = {"version": VERSION, "type": "gsplat", "count": scene.count, **common}
    about |= {"chunkSize": CHUNK, "allChunkBytes": sum(sizes)}
    about["chunks"] = [{"offset": a, "bytes": n} for a, n in zip(offsets, sizes, strict=False)]
    about["splatEncoding"] = _encoding(bounds, "lodTree" in common)
    lost = RAD.rounding, *Clipped.sum(clipped).sentences()
    return b"".join([_described(MAGIC, about), *chunks]), lost


def _bounds(scene: Scene) -> dict[str, tuple[float, float]]:
    """The bounds of bytes, float32."""
    colours = 0.5 + SH_C0 * np.array([scene.f_dc.min(), scene.f_dc.max()], np.float64)
    low, high = float(scene.log_scale.min()), float(scene.log_scale.max())
    bounds = {
        "alpha": (0.0, 1.0),
        "rgb": (max(colours[0], _COLOURS[0]), min(colours[1], _COLOURS[1])),
        "scales": (max(low, high - _SCALES), high),
    }
    rest = scene.f_rest.reshape(3, SH_COEFFICIENTS[scene.sh_degree], scene.count)
    for band, columns in enumerate(sh_bands(rest.shape[1]), 1):
        most = min(float(np.abs(rest[:, columns.start : columns.stop]).max()), _SH)
        bounds[f"sh{band}"] = (-most, most)
    narrow = {name: _NARROWEST * max(1.0, abs(low)) for name, (low, _) in bounds.items()}
    ends = [(low, max(high, low + narrow[name])) for name, (low, high) in bounds.items()]
    return dict(zip(bounds, map(tuple, np.array(ends, np.float32).tolist()), strict=True))


def _encoding(bounds: dict[str, tuple[float, float]], has_tree: bool) -> dict[str, Any]:
    """Bounds for Spark's memory."""
    kept = {"rgbMin": bounds["rgb"][0], "rgbMax": bounds["rgb"][1], "lodOpacity": has_tree}
    kept |= {"lnScaleMin": bounds["scales"][0], "lnScaleMax": bounds["scales"][1]}
    return kept | {f"sh{band}Max": bounds.get(f"sh{band}", (0, _SH))[1] for band in (1, 2, 3)}


def _values(
    scene: Scene, steps: AttributeSteps, bounds: dict[str, tuple[float, float]], clipped: Clipped
) -> Iterator[tuple[tuple[str, str], NDArray]]:
    """Name and encoding of each property, and its values ``(rows, n)``."""

    def levels(
        name: str, what: str, values: NDArray, step: NDArray, most: int, start: float
    ) -> NDArray[np.float64]:
        """Whole levels from 0 to `most` between the bounds; `start` is the value of level 0."""
        low, high = bounds[name]
        unit = (high - start) / most
        inside = clipped.limited(what, values.astype(np.float64), low, high)
        found = multiples((inside - start) / unit, step / unit)
        return np.clip(found, (low - start) / unit, most)

    centres = _centres(scene.positions, steps.positions)[..., None].view(np.uint8)
    yield ("center", "f32_lebytes"), np.moveaxis(centres, 2, 0)
    share = sigmoid(scene.opacity.astype(np.float64))
    step = share[0] * (1 - share[0]) * steps.opacity
    yield ("alpha", "r8"), levels("alpha", "opacities", share, step, 255, 0)
    rgb = 0.5 + SH_C0 * scene.f_dc.astype(np.float64)
    colours = levels("rgb", "colours", rgb, SH_C0 * steps.f_dc, 255, bounds["rgb"][0])
    yield ("rgb", "r8_delta"), np.diff(colours.astype(np.uint8), axis=1, prepend=np.uint8(0))
    logarithms = levels(
        "scales", "log-scales", scene.log_scale, steps.log_scale, STEPS, bounds["scales"][0]
    )
    yield ("scales", "ln_0r8"), 1 + logarithms
    yield ("orientation", "oct88r8"), _rotations(scene.rot, steps.rot).T
    rest = scene.f_rest.reshape(3, SH_COEFFICIENTS[scene.sh_degree], scene.count)
    for band, columns in enumerate(sh_bands(rest.shape[1]), 1):
        name, own = f"sh{band}", rest[:, columns.start : columns.stop].transpose(1, 0, 2)
        found = levels(name, "SH", own.reshape(-1, scene.count), steps.f_rest[band - 1], 127, 0)
        yield (name, "s8"), found.astype(np.int8)


def _centres(positions: NDArray[np.float32], steps: NDArray) -> NDArray[np.float32]:
    """Centres rounded to multiples of powers of two up to their steps."""
    with np.errstate(divide="ignore", invalid="ignore"):
        unit = np.exp2(np.floor(np.log2(steps)))
        rounded = np.rint(positions / unit) * unit
    return np.where(unit > 0, rounded, positions).astype("<f4")


def _rotations(rot: NDArray[np.float32], steps: NDArray) -> NDArray[np.float64]:
    """Axes as points of an octahedron, and angles, as three bytes each; see `_quaternions`."""
    wide = unit_quaternions(rot)
    wide *= np.copysign(1.0, wide[0])
    half = np.arccos(np.minimum(wide[0], 1))
    sine = np.sin(half)
    axis = np.where(sine > _LEAST_SINE, wide[1:], [[1.0], [0.0], [0.0]])
    axis = axis / np.abs(axis).sum(axis=0)
    folded = (1 - np.abs(axis[1::-1])) * np.copysign(1.0, axis[:2])
    flat = 127.5 * (1 + np.where(axis[2] < 0, folded, axis[:2]))
    points = multiples(flat, 127.5 * steps / np.maximum(sine, _LEAST_SINE))
    angles = multiples(half * (510 / np.pi), 510 / np.pi * steps)
    return np.clip(np.vstack([points, angles]), 0, 255)


def _chunk(
    about: dict[str, Any],
    values: dict[tuple[str, str], NDArray],
    bounds: dict[str, tuple[float, float]],
    effort: Effort,
) -> bytes:
    """A chunk with this description; one-byte values may be floats."""
    payload, properties = [], []
    offset = 0
    for (name, encoding), rows in values.items():
        packer = zlib.compressobj(GZIP_LEVELS[effort], zlib.DEFLATED, -15)
        plain = rows.astype(np.uint8) if rows.dtype == np.float64 else rows
        data = packer.compress(np.ascontiguousarray(plain).data.cast("B")) + packer.flush()
        own = {"offset": offset, "bytes": len(data), "property": name, "encoding": encoding}
        ends = dict(zip(("min", "max"), bounds.get(name, ()), strict=False))
        properties.append(own | {"compression": "gz"} | ends)
        payload.append(data + bytes(-len(data) % UNIT))
        offset += len(payload[-1])
    about |= {"payloadBytes": offset, "properties": properties}
    return b"".join([_described(CHUNK_MAGIC, about), offset.to_bytes(UNIT, "little"), *payload])


def _described(magic: bytes, about: dict[str, Any]) -> bytes:
    text = json.dumps(about, separators=(",", ":")).encode()
    return magic + len(text).to_bytes(4, "little") + text + bytes(-len(text) % UNIT)
