"""Errors between two versions of a scene, by attribute; the result of `compare`.

Differences of ellipsoids in scale and rotation, independent of their parameterisation.

The same ellipsoid can be written with its axes in any order, rotated to match, and with half turns
about them. If two axes are equal, rotations about the third have no effect; if all are equal, no
rotation has.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.axes import nearest_quaternions, sort_axes, with_real_part
from gs_codec.errors import InvalidInput
from gs_codec.metrics.comparison import Comparison, GroupError
from gs_codec.runtime.wording import counted
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
        for whole, some in zip(found, _errors_in_part(*pair), strict=True):
            whole[..., part] = some
    return found


def _errors_in_part(
    first: tuple[NDArray[np.float32], NDArray[np.float32]],
    second: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> ShapeErrors:
    pair = [(log_scale, _unit(rot)) for log_scale, rot in (first, second)]
    stored = ShapeErrors(
        differences(first[0], second[0]), _rotation_differences(first[1], second[1]), _turn(*pair)
    )
    # With axes sorted from the longest.
    log_scales, vectors = zip(
        *(sort_axes(log_scale, unit.astype(np.float32))[1:] for log_scale, unit in pair),
        strict=True,
    )
    first_rot, second_rot = map(with_real_part, vectors)
    near = nearest_quaternions(vectors[1], first_rot)
    moved = ShapeErrors(
        differences(*log_scales),
        _rotation_differences(first_rot, near),
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


def _rotation_differences(first: NDArray, second: NDArray) -> NDArray[np.float64]:
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


def compare_scenes(first: Scene, second: Scene, matched_by: str = "index") -> Comparison:
    """Compare Gaussian by Gaussian, in the order given.

    Positions, f_dc, f_rest, opacity (logit), log-scales and rotation components are compared as
    stored; opacity also after the sigmoid, rotation also as an angle in degrees. An ellipsoid has
    several equivalent parameterisations; the nearest is compared. Rotations about an axis do not
    count if the other two axes are equal within 5 %. Missing SH bands count as zero. Opacities of 0
    and 1, whose logit is infinite, are compared only after the sigmoid. Raises InvalidInput if the
    scenes differ in their number of Gaussians.
    """
    if first.count != second.count:
        raise InvalidInput(
            f"{counted(first.count, 'Gaussian')} against {second.count:,}: they do not match, so "
            'there are no errors by attribute: compare rendered views (cameras="auto")'
        )
    coefficients = max(len(first.f_rest), len(second.f_rest)) // 3
    with np.errstate(over="ignore"):
        shapes = shape_errors(first, second)
        groups = (
            _group("positions", "scene units", first.positions, second.positions),
            _group("f_dc", "SH", first.f_dc, second.f_dc),
            _group("f_rest", "SH", _padded(first, coefficients), _padded(second, coefficients)),
            _group("opacity", "logit", *_finite(first.opacity, second.opacity)),
            _group("opacity", "0-1", _sigmoid(first.opacity), _sigmoid(second.opacity)),
            _errors("scaling", "log", shapes.log_scale, 3 * first.count),
            _errors("rotation", "stored", shapes.rot, 4 * first.count),
            _errors("rotation", "degrees", shapes.turn[None], first.count),
        )
    kept = tuple(group for group in groups if group.name != "f_rest" or coefficients)
    return Comparison((first.count, second.count), matched_by, kept)


def _group(name: str, unit: str, first: NDArray, second: NDArray) -> GroupError:
    """Errors over all rows, one row at a time to bound memory."""
    rows = (differences(a, b) for a, b in zip(first, second, strict=True))
    return _errors(name, unit, rows, first.size)


def _errors(name: str, unit: str, rows: Iterable[NDArray], size: int) -> GroupError:
    largest = total = 0.0
    for error in rows:
        largest = float(np.maximum(largest, error.max(initial=0.0)))
        total += float(error @ error)
    return GroupError(name, unit, largest, float(np.sqrt(total / max(size, 1))))


def _finite(first: NDArray, second: NDArray) -> tuple[NDArray, NDArray]:
    """Columns of both in which no value is infinite."""
    there = ~(np.isinf(first) | np.isinf(second)).any(axis=0)
    return first[:, there], second[:, there]


def _padded(scene: Scene, coefficients: int) -> NDArray[np.float32]:
    own = len(scene.f_rest) // 3
    planes, missing = scene.f_rest.reshape(3, own, scene.count), coefficients - own
    padded = np.pad(planes, ((0, 0), (0, missing), (0, 0))) if missing else planes
    return padded.reshape(3 * coefficients, scene.count)


def _sigmoid(logit: NDArray) -> NDArray[np.float64]:
    return 1.0 / (1.0 + np.exp(-logit.astype(np.float64)))
