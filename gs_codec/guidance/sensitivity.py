"""Sensitivity of images to each attribute of each Gaussian, to second order.

A small change of an attribute x adds a squared error of ``sum (dC / dx)^2`` times its square: the
diagonal of the Gauss-Newton matrix. Changes of several Gaussians or attributes in one pixel are
treated as independent, like rounding errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.step_sizes import Sensitivity
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.sh_weights import zero_weights
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import (
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    LOW_PASS,
    TILE,
    camera_arguments,
    clamped_slopes,
    covariance,
    quaternion_turn,
    rotated,
)
from gs_codec.rendering.tiles_float32 import (
    BEHIND,
    LEAST_LEFT,
    MOST_ALPHA,
    draw_tile,
    open_tile,
    put_tile,
    turn_back,
    uncover,
    walk_back,
)
from gs_codec.rendering.tiles_float64 import tile_bounds
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import prefetch, repeated, total, where
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import Scene

#: Columns of the sums over a splat's pixels. g is the squared derivative of the pixel by ln alpha;
#: (e, f) is the offset from the centre, in axes where q = e^2 + f^2. Columns: g, g e^2, g e f,
#: g f^2, g e^4, g e^3 f, g e^2 f^2, g e f^3, g f^4, and (alpha T)^2.
G, G_EE, G_EF, G_FF, G_EEEE, G_EEEF, G_EEFF, G_EFFF, G_FFFF, SQUARED_WEIGHT = range(10)

#: Number of these columns.
_SUMS = SQUARED_WEIGHT + 1

_ZERO = np.float32(0)


@kernel
def sum_moments(fields, splats, starts, columns, background, colour, sums):
    """Draw all tiles of a view into an image ``(H, W, 3)``, and add them to ``sums (V, 10)``."""
    height, width, _ = colour.shape
    light, drawn = np.empty(BEHIND, np.float32), np.empty((len(splats), TILE), np.uint16)
    zero = repeated(_ZERO)
    none = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    for tile in range(len(starts) - 1):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        open_tile(x0, x1, y0, y1, light)
        start, stop = starts[tile], starts[tile + 1]
        reached = draw_tile(fields, splats, start, stop, x0, y0, height, LEAST_LEFT, light, drawn)
        put_tile(light, x0, x1, y0, y1, background, colour)
        turn_back(background, light)
        for pair in range(start, reached):
            prefetch(sums, splats[pair] * _SUMS)
            prefetch(sums, splats[pair] * _SUMS + SQUARED_WEIGHT)
        walk_back(
            _take_moments, _total_moments, none, fields, splats, start, reached, x0, y0, height,
            light, drawn, sums,
        )  # fmt: skip


@inlined
def _take_moments(light, at, alpha, red, green, blue, place, sums):
    e, f, ff, _ = place
    weight, by_red, by_green, by_blue = uncover(light, at, alpha, red, green, blue)
    g = by_red * by_red + by_green * by_green + by_blue * by_blue
    # An alpha at its limit does not change.
    g = where(alpha < MOST_ALPHA, g, repeated(_ZERO))
    ge, gf = g * e, g * f
    gee, gef, gff = ge * e, ge * f, gf * f
    return (
        sums[G] + g,
        sums[G_EE] + gee,
        sums[G_EF] + gef,
        sums[G_FF] + gff,
        sums[G_EEEE] + gee * e * e,
        sums[G_EEEF] + gee * e * f,
        sums[G_EEFF] + gee * ff,
        sums[G_EFFF] + gef * ff,
        sums[G_FFFF] + gff * ff,
        sums[SQUARED_WEIGHT] + weight * weight,
    )


@inlined
def _total_moments(pair, splat, u, sums, totals):
    row = totals[splat]
    for k in range(_SUMS):
        row[k] += np.float64(total(sums[k]))


@inlined
def second_moment(total, u, v):
    """Sum of ``g (o . u) (o . v)`` over the pixels, o being their offsets (e, f)."""
    return (
        total[G_EE] * u[0] * v[0]
        + total[G_EF] * (u[0] * v[1] + u[1] * v[0])
        + total[G_FF] * u[1] * v[1]
    )


@inlined
def fourth_moment(total, u, v):
    """Sum of ``g ((o . u) (o . v))^2`` over the pixels."""
    ee, ef, ff = u[0] * v[0], u[0] * v[1] + u[1] * v[0], u[1] * v[1]
    return (
        total[G_EEEE] * ee * ee
        + total[G_EEEF] * 2.0 * ee * ef
        + total[G_EEFF] * (ef * ef + 2.0 * ee * ff)
        + total[G_EFFF] * 2.0 * ef * ff
        + total[G_FFFF] * ff * ff
    )


#: Columns of the sums over views; log-scale and rotation have three columns each.
_POSITIONS, _LOG_SCALE, _ROT, _OPACITY, _COLOUR, _COLUMNS = 0, 1, 4, 7, 8, 9

#: Number of views per thread before results are added in order.
_VIEWS_A_THREAD = 4


class Seen(NamedTuple):
    """Measurements of a scene in views.

    Attributes
    ----------
    sensitivity : Sensitivity
        0 for Gaussians not drawn in any view, which includes those with values that are not finite.
    weights : ndarray, shape (views, N), float32
        Contribution of each view to `sensitivity.colour`, as in `squared_weights`.
    images : tuple of ndarray, each shape (H, W, 3), float32
        Renders of the scene.
    """

    sensitivity: Sensitivity
    weights: NDArray[np.float32]
    images: tuple[NDArray[np.float32], ...]


def sensitivity(scene: Scene, views: ReferenceViews, progress: Progress | None = None) -> Seen:
    """Squared error over views, pixels and colours from small changes of each attribute.

    The set and order of splats in each pixel is treated as constant. The error of pixels where a
    change moves a splat across the alpha threshold is not counted; it matters most for very small
    changes. A change of position moves the centre of the splat; its effect on the splat's shape and
    on view-dependent colour is ignored. An alpha at its limit does not change. `colour` is the sum
    of (alpha T)^2, even where a colour is clamped at black. The images of `views` are not used.
    """
    cameras = views.cameras
    advance = step_counter(progress, "sensitivity", len(cameras))
    totals = np.zeros((scene.count, _COLUMNS))
    weights = zero_weights(len(cameras), scene.count)
    images: list[NDArray[np.float32]] = []
    size = _VIEWS_A_THREAD * available_threads()
    for start in range(0, len(cameras), size):
        looks = run_all(
            lambda camera: _look(scene, camera, views.background),
            cameras[start : start + size],
            advance=advance,
        )
        for gaussians, found, image in looks:
            _add_up(gaussians, found, len(images), totals, weights.T)
            images.append(image)
    columns = np.ascontiguousarray(totals.T)
    summed = Sensitivity(
        columns[_POSITIONS],
        columns[_LOG_SCALE:_ROT],
        columns[_ROT:_OPACITY],
        columns[_OPACITY],
        columns[_COLOUR],
    )
    return Seen(summed, weights, tuple(images))


def _look(
    scene: Scene, camera: Camera, background: Sequence[float]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float32]]:
    """Visible Gaussians ``(V,)``, ascending, their contributions ``(V, 9)``, and the image."""
    frame = make_frame(scene, camera)
    fields, _, gaussians = frame.splats
    sums = np.zeros((len(fields), _SUMS))
    image = np.empty((camera.height, camera.width, 3), np.float32)
    behind = np.array(background, np.float64)
    sum_moments(fields, *frame.lists, frame.columns, behind, image, sums)
    found = np.zeros((len(fields), _COLUMNS))
    _to_attributes(
        scene.positions,
        scene.opacity,
        scene.log_scale,
        scene.rot,
        *camera_arguments(camera),
        scene.antialiased,
        fields,
        gaussians,
        sums,
        found,
    )
    return gaussians, found, image


@kernel
def _add_up(gaussians, found, view, totals, weights):
    for splat in range(len(gaussians)):
        i = gaussians[splat]
        weights[i, view] = found[splat, _COLOUR]
        for column in range(_COLUMNS):
            totals[i, column] += found[splat, column]


@kernel
def _to_attributes(
    positions, opacity, log_scale, rot, rotation, position, intrinsics, width, height,
    antialiased, fields, gaussians, sums, found,
):  # fmt: skip
    """Fill ``found (V, 9)``, initially 0, from the sums over the pixels of each splat."""
    fx, fy, cx, cy, _ = intrinsics
    for place in range(len(gaussians)):
        i = gaussians[place]
        if sums[place, SQUARED_WEIGHT] == 0.0:
            continue
        # Tuples, because views of arrays count their references.
        total, factors = _moments_of(sums, place), _factors_of(fields, place)
        x, y, z = rotated(
            rotation,
            positions[0, i] - position[0],
            positions[1, i] - position[1],
            positions[2, i] - position[2],
        )
        x /= z
        y /= z
        pixels = fx / z, fy / z
        found[place, _POSITIONS] = _by_position(total, factors, rotation, x, y, pixels)
        x, y = clamped_slopes(x, y, fx, fy, cx, cy, width, height)
        _, turn = quaternion_turn(rot, i)
        units = (
            _unit_axis(rotation, turn, 0, x, y, pixels),
            _unit_axis(rotation, turn, 1, x, y, pixels),
            _unit_axis(rotation, turn, 2, x, y, pixels),
        )
        offsets = (
            _offset(factors, units[0][0], units[0][1]),
            _offset(factors, units[1][0], units[1][1]),
            _offset(factors, units[2][0], units[2][1]),
        )
        scales = (
            math.exp(np.float64(log_scale[0, i])),
            math.exp(np.float64(log_scale[1, i])),
            math.exp(np.float64(log_scale[2, i])),
        )
        for k in range(3):
            m = (k + 1) % 3
            variance, other = scales[k] * scales[k], scales[m] * scales[m]
            stretched = _by_covariance(total, scales, units, offsets, k, k, antialiased)
            turned = _by_covariance(total, scales, units, offsets, k, m, antialiased)
            found[place, _LOG_SCALE + k] = variance**2 * stretched
            # A turn in the plane of two axes is a turn about the third.
            found[place, _ROT + (k + 2) % 3] = (variance - other) ** 2 * turned
        found[place, _OPACITY] = total[G] / (1.0 + math.exp(np.float64(opacity[0, i]))) ** 2
        found[place, _COLOUR] = total[SQUARED_WEIGHT]
        for column in range(_COLUMNS):
            # Products of very large values may overflow, and rounding may make moments negative.
            if not 0.0 <= found[place, column] < np.inf:
                found[place, column] = 0.0


@inlined
def _moments_of(sums, place):
    """A row of sums as a tuple."""
    return (
        sums[place, 0], sums[place, 1], sums[place, 2], sums[place, 3], sums[place, 4],
        sums[place, 5], sums[place, 6], sums[place, 7], sums[place, 8], sums[place, 9],
    )  # fmt: skip


@inlined
def _factors_of(fields, splat):
    """Factors of the conic of a splat."""
    return fields[splat, FACTOR_XX], fields[splat, FACTOR_XY], fields[splat, FACTOR_YY]


@inlined
def _unit_axis(rotation, turn, axis, x, y, pixels):
    """An axis of a Gaussian, of length 1, projected to pixels."""
    qx, qy, qz = rotated(rotation, turn[0][axis], turn[1][axis], turn[2][axis])
    return pixels[0] * (qx - x * qz), pixels[1] * (qy - y * qz)


@inlined
def _by_position(total, factors, rotation, x, y, pixels):
    """Sensitivity to position, averaged over the axes; (x, y) are slopes to the optical axis."""
    mean = 0.0
    for k in range(3):
        step = _offset(
            factors,
            pixels[0] * (rotation[0, k] - x * rotation[2, k]),
            pixels[1] * (rotation[1, k] - y * rotation[2, k]),
        )
        mean += second_moment(total, step, step) / 3.0
    return mean


@inlined
def _offset(factors, x, y):
    """Transform an image vector to the axes in which q is a sum of squares."""
    return factors[0] * x + factors[1] * y, factors[2] * y


@inlined
def _by_covariance(total, scales, units, offsets, k, m, antialiased):
    """Sensitivity to a change of the covariance by ``u_k u_m^T + u_m u_k^T``.

    u are the Gaussian's axes of length 1, projected to pixels. ln alpha changes by
    ``(o . u_k) (o . u_m)``; if antialiased, its compensation changes as well.
    """
    fourth = fourth_moment(total, offsets[k], offsets[m])
    if not antialiased:
        return fourth
    axes = (
        (scales[0] * units[0][0], scales[0] * units[0][1]),
        (scales[1] * units[1][0], scales[1] * units[1][1]),
        (scales[2] * units[2][0], scales[2] * units[2][1]),
    )
    xx, _, yy, sharp = covariance(axes)
    determinant = sharp + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
    if not sharp / determinant > 0.000025:
        return fourth
    by_sharp = 0.0
    for j in range(3):
        x, y = axes[j]
        by_sharp += (x * units[k][1] - y * units[k][0]) * (x * units[m][1] - y * units[m][0])
    along = units[k][0] * units[m][0] + units[k][1] * units[m][1]
    added = by_sharp / sharp - (by_sharp + LOW_PASS * along) / determinant
    second = second_moment(total, offsets[k], offsets[m])
    return fourth + 2.0 * added * second + added * added * total[G]
