"""Differences of ellipsoids in scale and rotation, independent of their parameterisation.

The same ellipsoid can be written with its axes in any order, rotated to match, and with half turns
about them. If two axes are equal, rotations about the third have no effect; if all are equal, no
rotation has.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.axes import nearest_quaternions, sort_axes
from gs_codec.scene import Scene

#: Axes count as equal if their log-scales differ by less than this in one of the scenes.
EQUAL = 0.05

#: Relative difference, and radians, by which another parameterisation must be nearer to be used.
_ROUNDING = 1e-5

#: Maximum number of Gaussians processed at once.
_CHUNK = 1 << 18

_IDENTITY = np.array([[1.0], [0.0], [0.0], [0.0]])


class ShapeErrors(NamedTuple):
    """Errors of each Gaussian, in the parameterisation that is nearest to the other scene's.

    Attributes
    ----------
    log_scale : ndarray, shape (3, N)
    rot : ndarray, shape (4, N)
        Errors of the stored components, for the better sign; of unit quaternions if axes are
        swapped.
    turn : ndarray, shape (N,)
        Smallest rotation that aligns the axes of distinct lengths with the other's, in degrees.
    """

    log_scale: NDArray[np.float64]
    rot: NDArray[np.float64]
    turn: NDArray[np.float64]


def shape_errors(first: Scene, second: Scene) -> ShapeErrors:
    """Compare scales and rotations, Gaussian by Gaussian; errors are at least 0."""
    found = ShapeErrors(*(np.empty((*rows, first.count)) for rows in ((3,), (4,), ())))
    for start in range(0, first.count, _CHUNK):
        part = slice(start, start + _CHUNK)
        pair = ((each.log_scale[:, part], each.rot[:, part]) for each in (first, second))
        for whole, some in zip(found, _errors(*pair), strict=True):
            whole[..., part] = some
    return found


def _errors(
    first: tuple[NDArray[np.float32], NDArray[np.float32]],
    second: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> ShapeErrors:
    pair = [(log_scale, _unit(rot)) for log_scale, rot in (first, second)]
    stored = ShapeErrors(
        differences(first[0], second[0]), _apart_of_either_sign(first[1], second[1]), _turn(*pair)
    )
    # With axes sorted from the longest.
    log_scales, vectors = zip(
        *(sort_axes(log_scale, unit.astype(np.float32))[1:] for log_scale, unit in pair),
        strict=True,
    )
    first_rot, second_rot = map(_with_real_part, vectors)
    near = nearest_quaternions(vectors[1], first_rot)
    moved = ShapeErrors(
        differences(*log_scales),
        _apart_of_either_sign(first_rot, near),
        _turn((log_scales[0], first_rot), (log_scales[1], second_rot)),
    )
    nearer = _cost(moved) < (1 - _ROUNDING) * _cost(stored) - _ROUNDING
    log_scale, rot, turn = (np.where(nearer, a, b) for a, b in zip(moved, stored, strict=True))
    # If axes are nearly equal, either may be the longer; then components differ a lot.
    farther = np.linalg.norm(moved.rot, axis=0) > np.linalg.norm(stored.rot, axis=0)
    return ShapeErrors(log_scale, np.where(farther, stored.rot, rot), turn)


def _cost(errors: ShapeErrors) -> NDArray[np.float64]:
    return np.linalg.norm(errors.log_scale, axis=0) + np.radians(errors.turn)


def differences(first: NDArray, second: NDArray) -> NDArray[np.float64]:
    """Absolute differences; 0 for equal infinities."""
    with np.errstate(invalid="ignore"):
        return np.where(first == second, 0.0, np.abs(first.astype(np.float64) - second))


def _apart_of_either_sign(first: NDArray, second: NDArray) -> NDArray[np.float64]:
    """Differences of quaternions; q and -q are the same rotation."""
    same, opposite = differences(first, second), differences(first, -second)
    return np.where(np.linalg.norm(opposite, axis=0) < np.linalg.norm(same, axis=0), opposite, same)


def _turn(first: tuple[NDArray, NDArray], second: tuple[NDArray, NDArray]) -> NDArray[np.float64]:
    """Smallest rotation between ellipsoids given by log-scales and unit quaternions, in degrees."""
    a, b = first[1], second[1]
    parts = _relative(a, b) ** 2
    # Half turns about axes change nothing, so any component may be the real part.
    *small, largest = np.sort(parts, axis=0)
    turn = 2 * np.arctan2(np.sqrt(sum(small)), np.sqrt(largest))
    equal = _equal_axes(first[0]) | _equal_axes(second[0])
    for axis in range(3):
        # Only this axis has a direction: measure the angle between two lines.
        alone = parts[0] + parts[axis + 1]
        others = parts.sum(axis=0) - alone
        lines = np.arctan2(2 * np.sqrt(np.maximum(alone * others, 0)), np.abs(alone - others))
        turn = np.where(equal[axis], np.minimum(lines, turn), turn)
    same = (a == b).all(axis=0) | (a == -b).all(axis=0) | (equal.sum(axis=0) > 1)
    return np.where(same, 0.0, np.degrees(turn))


def _equal_axes(log_scale: NDArray) -> NDArray[np.bool_]:
    """Whether the two other axes are equal, for each axis, ``(3, N)``."""
    with np.errstate(invalid="ignore"):
        return np.abs(log_scale[[1, 2, 0]] - log_scale[[2, 0, 1]]) < EQUAL


def _relative(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """The rotation from unit quaternions ``a (4, N)`` to `b`, in the axes of `a`."""
    (w, x, y, z), (p, q, r, s) = a, b
    return np.stack(
        [
            w * p + x * q + y * r + z * s,
            (w * q - x * p) - (y * s - z * r),
            (w * r - y * p) - (z * q - x * s),
            (w * s - z * p) - (x * r - y * q),
        ]
    )


def _unit(rot: NDArray[np.float32]) -> NDArray[np.float64]:
    """Normalised quaternions; the identity where the norm is 0."""
    values = rot.astype(np.float64)
    norm = np.linalg.norm(values, axis=0)
    with np.errstate(invalid="ignore"):
        return np.where(norm == 0, _IDENTITY, values / np.where(norm == 0, 1.0, norm))


def _with_real_part(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    real = np.sqrt(np.maximum(1.0 - (vectors * vectors).sum(axis=0), 0.0))
    return np.concatenate([real[None], vectors])
