"""Bounding boxes of centres and ellipsoids, and the cube that an octree divides.

FORMAT.md, section "Index". Only correctly rounded operations are used for extents, so they are the
same on every machine.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import encode_morton
from gs_codec.runtime.kernels import inlined, kernel

#: Number of values of an extent.
EXTENT = 12

#: Standard deviations at which an ellipsoid ends.
_SIGMAS = 3.0

#: Eighths of an octave per unit of the natural logarithm: 8 / ln(2).
_EIGHTHS = 11.541560327111707

#: Smallest log-scale, in eighths of an octave, that still affects a float32 box.
_LEAST = -1600

#: Largest log-scale, in eighths of an octave.
_MOST = 4000

#: 2**(i / 8), i = 0..7, rounded up.
_POWERS = np.array(
    [
        1.0, 1.0905077326652577, 1.1892071150027212, 1.2968395546510099,
        1.4142135623730951, 1.542210825407941, 1.6817928305074292, 1.8340080864093427,
    ]
)  # fmt: skip

#: 2**(i / 8), from `_LEAST` to `_MOST`.
_SCALES = np.ldexp(
    _POWERS[np.arange(_LEAST, _MOST + 1) & 7], np.arange(_LEAST, _MOST + 1, dtype=np.int32) >> 3
)

#: Upper bound of the rounding errors of eighths of octaves.
_SLACK = 2.0**-20

#: Upper bound of the rounding errors of the entries of a rotation matrix.
_TURN_SLACK = 2.0**-40

_LARGEST = float(np.finfo(np.float32).max)


def block_extent(
    positions: NDArray[np.float32], log_scale: NDArray[np.float32], rot: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Bounding boxes of one or more decoded Gaussians.

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
        Lowest x, y, z of the centres, then the highest; then the same of a box around all
        ellipsoids of 3 standard deviations. Of Gaussians with values that are not finite, only
        finite centres count.
    """
    box = centre_box(positions)
    corners = box.astype(np.float64)
    _extend(positions, log_scale, rot, corners)
    low, high = _outwards(corners[:3], -np.inf), _outwards(corners[3:], np.inf)
    return np.concatenate([box, low, high])


def centre_box(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Lowest, then highest x, y, z of the finite values of ``positions (3, n)``, shape ``(6,)``.

    Zeros on an axis without finite values.
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


def box_text(corners: Iterable[Iterable[float]]) -> str:
    """Format a box for messages, from its lowest and highest corner."""
    low, high = (" ".join(f"{x:.6g}" for x in corner) for corner in corners)
    return f"bounds {low} to {high}"


def centre_bounds(
    positions: NDArray[np.float32],
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Lowest and highest x, y, z of the finite centres in ``positions (3, n)``; None if none."""
    finite = np.isfinite(positions).all(axis=0)
    if not finite.any():
        return None
    if not finite.all():
        positions = positions[:, finite]
    return tuple(positions.min(axis=1).tolist()), tuple(positions.max(axis=1).tolist())


@inlined
def _along(entry, norm, size):
    """Square of the extent of one axis of length `size`, given its entry in a rotation matrix."""
    # A quaternion of norm 0 has no rotation: assume the largest extent.
    turned = abs(entry) / norm if norm > 0.0 else 1.0
    reach = (turned + _TURN_SLACK) * size
    return reach * reach


@kernel
def _extend(positions, log_scale, rot, corners):
    """Extend a box ``(6,)`` by the ellipsoids around centres."""
    size = np.empty(3)
    for i in range(positions.shape[1]):
        w, x = np.float64(rot[0, i]), np.float64(rot[1, i])
        y, z = np.float64(rot[2, i]), np.float64(rot[3, i])
        known = np.isfinite(w + x + y + z)
        for k in range(3):
            known = known and np.isfinite(positions[k, i]) and np.isfinite(log_scale[k, i])
        if not known:
            continue
        for k in range(3):
            eighths = np.float64(log_scale[k, i]) * _EIGHTHS + _SLACK
            eighths = np.ceil(min(max(eighths, np.float64(_LEAST)), np.float64(_MOST)))
            size[k] = _SCALES[np.int64(eighths) - _LEAST]
        ww, xx, yy, zz = w * w, x * x, y * y, z * z
        norm = ww + xx + yy + zz
        for axis in range(3):
            if axis == 0:
                a, b, c = ww + xx - yy - zz, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
            elif axis == 1:
                a, b, c = 2.0 * (x * y + w * z), ww - xx + yy - zz, 2.0 * (y * z - w * x)
            else:
                a, b, c = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), ww - xx - yy + zz
            squared = _along(a, norm, size[0]) + _along(b, norm, size[1]) + _along(c, norm, size[2])
            half = _SIGMAS * np.sqrt(squared)
            corners[axis] = min(corners[axis], positions[axis, i] - half)
            corners[3 + axis] = max(corners[3 + axis], positions[axis, i] + half)


def _outwards(corner: NDArray[np.float64], towards: float) -> NDArray[np.float32]:
    """Round a corner to float32 towards `towards`, so that the box only grows; keep it finite."""
    nearest = np.clip(corner, -_LARGEST, _LARGEST).astype(np.float32)
    with np.errstate(over="ignore"):
        beyond = np.nextafter(nearest, np.float32(towards))
    return np.clip(beyond, np.float32(-_LARGEST), np.float32(_LARGEST))


#: Margin of the cube, relative to the extent of the centres, so that the highest are inside; also
#: the side of the cube around a single position.
EXPANSION = 0.01

#: Depths of cells; in deeper trees most cells would have one Gaussian.
DEPTHS = range(1, 17)


@dataclass(frozen=True)
class Cube:
    """A cube; its cells at depth d are its 8**d equal parts.

    Attributes
    ----------
    low : tuple of float
        The corner with the lowest x, y, z.
    side : float
    """

    low: tuple[float, float, float]
    side: float

    @classmethod
    def around(cls, positions: NDArray) -> Cube:
        """The cube that `Octree.convert_from_point_cloud` puts around finite ``(3, N)``, N > 0."""
        lowest, highest = np.stack([positions.min(axis=1), positions.max(axis=1)]).astype(float)
        centre = (lowest + highest) / 2
        half = float((centre - lowest).max())
        x, y, z = np.minimum(lowest, centre - half).tolist()
        return cls((x, y, z), 2 * half * (1 + EXPANSION) if half else EXPANSION)

    def is_divisible(self, depth: int) -> bool:
        """Whether float64 resolves cells of this depth at the cube's coordinates."""
        farthest = np.abs(self.low).max() + self.side
        return self.side / 2**depth > 4 * np.spacing(farthest)

    def divide(
        self, positions: NDArray, depth: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Assign ``positions (3, N)`` to cells at a depth, with Open3D's arithmetic.

        Returns
        -------
        codes : ndarray, shape (N,), int64
            Morton codes. Shifting them right by 3 bits gives those of the next lower depth.
        inside : ndarray, shape (3, N), float64
            The positions. Rounding puts some in no cell, and Open3D would lose them; these are
            moved into their cell by one unit in the last place.
        """
        inside = positions.astype(np.float64)
        cells = np.zeros(inside.shape, np.uint32)
        borders = np.repeat(np.array(self.low)[:, None], inside.shape[1], axis=1)
        half = self.side
        for _ in range(depth):
            half /= 2
            above = inside >= borders + half
            borders += np.where(above, half, 0.0)
            np.minimum(inside, np.nextafter(borders + half, -np.inf), out=inside)
            cells = 2 * cells + above
        return encode_morton(cells, (depth, depth, depth)), inside
