"""Rotate, mirror, scale and translate scenes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gs_codec.coding.clean import identity_for_zero
from gs_codec.errors import InvalidInput
from gs_codec.formats.packed_values import spans
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.scene import (
    NORMALS,
    SH_COEFFICIENTS,
    Scene,
    offset_of,
    sh_bands,
    sh_values,
    with_offset,
)

#: Tolerance for scaling axes differently, because matrices in files are rounded.
_ALIKE = 1e-4

#: Decimals of weights; 0 and 1 are then exact.
_DECIMALS = 14

#: Number of Gaussians summed at once, so that sums stay in the processor's cache.
_SOME = 1024

#: Directions that distinguish all SH of a degree. Bands are homogeneous, so lengths do not matter.
_DIRECTIONS = np.array([each for each in product((-1.0, 0.0, 1.0), repeat=3) if any(each)])


def move_scene(scene: Scene, matrix: ArrayLike) -> Scene:
    """Rotate, mirror, scale and translate a scene: centres, shapes, SH and normals.

    Computed in float64 and rounded once. If axes are only swapped or negated, centres and shapes
    stay bit-exact, and so do SH that only change sign. Raises InvalidInput if the matrix shears,
    scales axes differently, or scales by 0.

    Parameters
    ----------
    scene : Scene
    matrix : array_like, shape (4, 4)
        Multiplies centres, as columns ``(x, y, z, 1)``, from the left.

    Returns
    -------
    Scene
        The same object if the matrix is the identity.
    """
    try:
        wide = np.asarray(matrix, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"matrix {matrix!r:.40}: expected 4 rows of 4 numbers") from error
    if np.array_equal(wide, np.eye(4)):
        return scene
    turn, factor = _turn_and_factor(wide)
    # The part that is also applied to the ellipsoids' own axes: all of it if axes are only swapped
    # or negated, otherwise the reflection. The rest is a rotation.
    swaps = np.isin(turn, (-1, 0, 1)).all()
    own = turn if swaps else np.eye(3) * np.round(np.linalg.det(turn))
    axial = np.eye(4)
    axial[1:, 1:] = own * np.round(np.linalg.det(own))
    sh = sh_turn(turn, scene.sh_degree)
    rot = scene.rot if swaps else identity_for_zero(scene)[0].rot
    offset = offset_of(scene.comments)
    if offset is not None:
        shifts = np.array_equal(wide[:3, :3], np.eye(3))
        offset = tuple(np.subtract(offset, wide[:3, 3])) if shifts else None
        scene = replace(scene, comments=with_offset(scene.comments, offset))
    return replace(
        scene,
        positions=_weighted(scene.positions, factor * turn, wide[:3, 3]),
        log_scale=_weighted(scene.log_scale, np.abs(own), np.full(3, np.log(factor))),
        rot=_weighted(rot, _product(_quaternion(turn @ own.T)) @ axial),
        f_rest=_weighted(scene.f_rest, np.kron(np.eye(3), sh)),
        extra=_with_normals(scene.extra, turn),
    )


def sh_turn(turn: NDArray[np.float64], sh_degree: int) -> NDArray[np.float64]:
    """Matrix ``(K, K)`` that converts SH-AC coefficients of a colour to those of a rotated scene.

    In direction ``turn @ d`` they give the same colour as the original ones in `d`.
    """
    count = SH_COEFFICIENTS[sh_degree]
    turned, before = np.zeros((2, count, len(_DIRECTIONS)))
    for directions, basis in ((_DIRECTIONS, turned), (_DIRECTIONS @ turn, before)):
        x, y, z = directions.T
        sh_values(x, y, z, count, basis)
    weights = np.zeros((count, count))
    for band in sh_bands(count):
        each = slice(band.start, band.stop)
        weights[each, each] = np.linalg.lstsq(turned[each].T, before[each].T, rcond=None)[0]
    return np.round(weights, _DECIMALS)


def rotation_of(quaternion: ArrayLike) -> NDArray[np.float64]:
    """The rotation matrix ``(3, 3)`` of a quaternion wxyz of any norm except 0, which gives NaN."""
    with np.errstate(invalid="ignore", over="ignore"):
        unit = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    conjugate = np.diag([1.0, -1.0, -1.0, -1.0])
    # Multiply from the left, and by the conjugate from the right.
    return (_product(unit) @ conjugate @ _product(unit) @ conjugate)[1:, 1:]


def _turn_and_factor(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """The orthogonal part of a matrix, and its scale."""
    if matrix.shape == (4, 4) and np.isfinite(matrix).all() and (matrix[3] == (0, 0, 0, 1)).all():
        left, scales, right = np.linalg.svd(matrix[:3, :3])
        with np.errstate(over="ignore", under="ignore"):
            factor = float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
        if 0 < factor < np.inf and scales[0] <= (1 + _ALIKE) * scales[2]:
            return np.round(left @ right, _DECIMALS), factor
    raise InvalidInput(
        "placed by a matrix that stretches or shears, expected one that turns, mirrors, shifts, "
        "and scales all axes alike"
    )


def _quaternion(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The unit quaternion wxyz of a rotation matrix."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    # Four times the products of its components.
    products = np.array([
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ])  # fmt: skip
    largest = products[np.argmax(np.diag(products))]
    return largest / np.linalg.norm(largest)


def _product(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix that multiplies a quaternion wxyz from the left by this one."""
    w, x, y, z = quaternion
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def _with_normals(extra: Mapping[str, NDArray], turn: NDArray[np.float64]) -> dict[str, NDArray]:
    """Extra properties, with normals rotated."""
    turned = dict(extra)
    if set(NORMALS) <= set(extra):
        planes = np.stack([extra[name] for name in NORMALS]).astype(np.float32)
        for name, plane in zip(NORMALS, _weighted(planes, turn), strict=True):
            turned[name] = plane.astype(extra[name].dtype)
    return turned


def _weighted(
    planes: NDArray[np.float32], weights: NDArray, shifts: ArrayLike = 0.0
) -> NDArray[np.float32]:
    """Weighted sums of planes, plus shifts; planes that only change sign stay bit-exact."""
    if np.array_equal(weights, np.eye(len(planes))) and not np.any(shifts):
        return planes
    sums = empty(planes.shape, np.float32)
    all_shifts = np.broadcast_to(np.asarray(shifts, np.float64), len(planes)).copy()

    def fill(some: slice) -> None:
        _sum_planes(planes, weights, all_shifts, sums, some.start, some.stop)

    with using_threads(None, planes.shape[1]):
        run_all(fill, spans(planes.shape[1]))
    return sums


@kernel
def _sum_planes(planes, weights, shifts, sums, first, last):
    """Fill columns of `sums` with weighted sums of planes, and shifts, in float64."""
    wide = np.empty(_SOME)
    for start in range(first, last, _SOME):
        stop = min(start + _SOME, last)
        for row in range(len(weights)):
            to, number, only = sums[row, start:stop], 0, 0
            for k in range(len(planes)):
                if weights[row, k] != 0.0:
                    number, only = number + 1, k
            if number == 1 and abs(weights[row, only]) == 1.0 and shifts[row] == 0.0:
                plane = planes[only, start:stop]
                for i in range(len(to)):
                    to[i] = plane[i] if weights[row, only] > 0.0 else -plane[i]
                continue
            wide[:] = shifts[row]
            for k in range(len(planes)):
                weight, plane = weights[row, k], planes[k, start:stop]
                if weight != 0.0:
                    for i in range(len(plane)):
                        wide[i] += weight * np.float64(plane[i])
            for i in range(len(to)):
                to[i] = np.float32(wide[i])
