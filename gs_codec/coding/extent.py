"""Boxes around Gaussians: of their centres, and of their ellipsoids. FORMAT.md, section "Index".

Only correctly rounded operations are used, so that the boxes are the same on every machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Numbers of an extent.
EXTENT = 12

#: An ellipsoid reaches this many standard deviations.
_SIGMAS = 3.0

#: Eighths of an octave in a unit of the natural logarithm: 8 / ln(2).
_EIGHTHS = 11.541560327111707

#: 2**(i / 8), i = 0..7, rounded up.
_POWERS = np.array(
    [
        1.0, 1.0905077326652577, 1.1892071150027212, 1.2968395546510099,
        1.4142135623730951, 1.542210825407941, 1.6817928305074292, 1.8340080864093427,
    ]
)  # fmt: skip

#: Eighths of octaves beyond these differ no more once boxes are float32.
_LEAST, _MOST = -1600.0, 4000.0

#: More than the rounding errors of eighths; of the entries of a rotation matrix.
_SLACK, _TURN_SLACK = 2.0**-20, 2.0**-40

_LARGEST = float(np.finfo(np.float32).max)


def block_extent(
    positions: NDArray[np.float32], log_scale: NDArray[np.float32], rot: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Where decoded Gaussians are, at least one.

    Parameters
    ----------
    positions : ndarray, shape (3, n)
    log_scale : ndarray, shape (3, n)
        Natural logarithm.
    rot : ndarray, shape (4, n)
        Quaternions wxyz of any norm.

    Returns
    -------
    ndarray, shape (12,), float32
        Lowest x, y, z of the centres, highest ones; then the same of a box that holds all
        ellipsoids of 3 standard deviations. Gaussians with a value that is not finite count with
        their finite centres only.
    """
    box = centre_box(positions)
    whole = np.all(
        [np.isfinite(plane).all(axis=0) for plane in (positions, log_scale, rot)], axis=0
    )
    at = positions[:, whole].astype(np.float64)
    half = _half_extents(log_scale[:, whole].astype(np.float64), rot[:, whole].astype(np.float64))
    low = np.minimum(box[:3], (at - half).min(axis=1, initial=np.inf))
    high = np.maximum(box[3:], (at + half).max(axis=1, initial=-np.inf))
    return np.concatenate([box, _outwards(low, -np.inf), _outwards(high, np.inf)])


def centre_box(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Lowest, then highest x, y, z of the finite values of ``positions (3, n)``, ``(6,)``.

    Zeros on an axis without any.
    """
    infinity = np.float32(np.inf)
    finite = np.isfinite(positions)
    if finite.all():
        ends = [positions.min(axis=1), positions.max(axis=1)]
    else:
        low = np.where(finite, positions, infinity).min(axis=1)
        high = np.where(finite, positions, -infinity).max(axis=1)
        ends = [np.where(finite.any(axis=1), end, np.float32(0)) for end in (low, high)]
    # Adding 0 turns -0 into 0: which of the two is the minimum depends on the machine.
    return np.concatenate(ends) + np.float32(0)


def _half_extents(log_scale: NDArray[np.float64], rot: NDArray[np.float64]) -> NDArray[np.float64]:
    """At least how far ellipsoids ``(n,)`` reach from their centres on each axis, ``(3, n)``."""
    eighths = np.ceil(np.clip(log_scale * _EIGHTHS + _SLACK, _LEAST, _MOST)).astype(np.int32)
    scale = np.ldexp(_POWERS[eighths & 7], eighths >> 3)
    w, x, y, z = rot
    ww, xx, yy, zz = rot * rot
    norm = ww + xx + yy + zz
    rows = (
        (ww + xx - yy - zz, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), ww - xx + yy - zz, 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), ww - xx - yy + zz),
    )
    # Without a rotation, an ellipsoid of any.
    some, norm = norm > 0, np.where(norm > 0, norm, 1.0)
    half = np.empty(log_scale.shape)
    for axis, row in enumerate(rows):
        square = np.zeros(len(norm))
        for entry, size in zip(row, scale, strict=True):
            along = (np.where(some, np.abs(entry) / norm, 1.0) + _TURN_SLACK) * size
            square += along * along
        half[axis] = _SIGMAS * np.sqrt(square)
    return half


def _outwards(corner: NDArray[np.float64], towards: float) -> NDArray[np.float32]:
    """A corner in float32, beyond the exact one, but finite."""
    nearest = np.clip(corner, -_LARGEST, _LARGEST).astype(np.float32)
    with np.errstate(over="ignore"):
        beyond = np.nextafter(nearest, np.float32(towards))
    return np.clip(beyond, np.float32(-_LARGEST), np.float32(_LARGEST))
