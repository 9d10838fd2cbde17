"""`.splat` files of antimatter15's viewer: 32 bytes per Gaussian, without SH-AC.

Centre and linear scales are float32. Red, green, blue, opacity and the quaternion components wxyz
are one byte each.
"""

from __future__ import annotations

from collections.abc import Sized
from pathlib import Path

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.format_table import SPLAT
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.limits import check_count
from gs_codec.formats.packed_values import (
    Clipped,
    check_finite,
    linear_scales,
    log_scales_of,
    opacities_of,
    sh_of_colours,
    sigmoid,
    unit_quaternions,
)
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_C0, Scene

_ROW = np.dtype(
    [("position", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("rot", "u1", 4)]
)

#: Bytes of a Gaussian.
RECORD = _ROW.itemsize


def read_splat(path: Path, data: memoryview, max_bytes: int | None) -> Scene:
    """Read the bytes of a `.splat` file; see `SceneFile.scene`."""
    with located(path):
        if len(data) % RECORD:
            raise InvalidInput(
                f"{counted(len(data), 'byte')}, expected a multiple of {RECORD} (.splat records)"
            )
        check_count(len(data) // RECORD, 0, len(data), max_bytes)
        rows = np.frombuffer(bytes(data), _ROW)
        scales = rows["scale"]
        odd = int(np.count_nonzero(~((scales >= 0) & (scales < np.inf)).all(axis=1)))
        if 2 * odd > len(rows):
            raise InvalidInput(
                f"scales below 0 or not finite in {odd:,} of {counted(len(rows), 'record')}, "
                "not a .splat scene"
            )
    colour = rows["colour"].T
    return Scene(
        np.ascontiguousarray(rows["position"].T),
        sh_of_colours(colour[:3] / 255),
        np.empty((0, len(rows)), np.float32),
        opacities_of(path, colour[3]),
        np.ascontiguousarray(log_scales_of(rows["scale"].T)),
        np.ascontiguousarray((rows["rot"].T.astype(np.float32) - 128) / 128),
    )


def stated_size(path: Path, data: Sized) -> tuple[int, int]:
    """Number of Gaussians in a file of this size, and their SH degree."""
    return len(data) // RECORD, 0


def pack_splat(scene: Scene) -> tuple[bytes, tuple[str, ...]]:
    """The bytes of a `.splat` file, and sentences on what it cannot represent.

    Raises InvalidInput if there are no Gaussians, a value is not finite, or a scale is too large
    for a float32.
    """
    check_finite(scene, ".splat")
    if not scene.count:
        raise InvalidInput("no Gaussians, .splat needs at least one")
    rows, clipped = np.empty(scene.count, _ROW), Clipped()
    rows["position"] = scene.positions.T
    with np.errstate(under="ignore"):
        rows["scale"] = linear_scales(scene.log_scale, ".splat", clipped).T
    colour = 255 * (0.5 + SH_C0 * scene.f_dc.astype(np.float64))
    rows["colour"][:, :3] = clipped.limited("colours", np.rint(colour), 0, 255).T
    rows["colour"][:, 3] = np.rint(255 * sigmoid(scene.opacity[0].astype(np.float64)))
    rot = np.rint(128 * unit_quaternions(scene.rot))
    # A byte represents -128 but not 128; the negated quaternion is the same rotation.
    rows["rot"] = 128 + np.where((rot > 127).any(axis=0), -rot, rot).T
    return rows.tobytes(), (SPLAT.rounding, *clipped.sentences(), *left_out_of(scene, SPLAT))
