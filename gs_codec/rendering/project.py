"""Project Gaussians to splats: EWA projection as in the 3DGS rasteriser, view-dependent colour.

Everything is in float64, because a Gaussian on the wrong side of a threshold changes the image
visibly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.harmonics import sh_basis
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import GROUPS, SH_C0, Scene

#: Added to the variance of a splat along both axes, square pixels.
LOW_PASS = 0.3

#: Minimum alpha of a splat in a pixel to be drawn.
MIN_ALPHA = 1.0 / 255.0

#: Side of a tile, in pixels.
TILE = 16

#: Maximum exponent q of a drawn splat, where its alpha equals `MIN_ALPHA`.
_FARTHEST = 2.0 * math.log(1.0 / MIN_ALPHA)

#: Number of Gaussians whose colours are computed together.
_BLOCK = 128

#: Fields of a splat: centre (pixel index), conic as a triangular factor, largest exponent q,
#: opacity, colour, depth.
CENTRE_X, CENTRE_Y, FACTOR_XX, FACTOR_XY, FACTOR_YY, REACH, OPACITY, RED, GREEN, BLUE, DEPTH = (
    range(11)
)


class Splats(NamedTuple):
    """V projected Gaussians, V <= N.

    ``fields (V, 11)`` float64 as listed above: ``q = (FACTOR_XX dx + FACTOR_XY dy)^2 +
    (FACTOR_YY dy)^2``, alpha = OPACITY exp(-q / 2), which is below `MIN_ALPHA` where
    q > REACH. ``tiles (V, 4)`` int32: first and end tile column, first and end tile row.
    ``gaussians (V,)`` int64: their indices in the scene.
    """

    fields: NDArray[np.float64]
    tiles: NDArray[np.int32]
    gaussians: NDArray[np.int64]


def camera_arguments(camera: Camera) -> tuple[NDArray, NDArray, NDArray, int, int]:
    """Convert a camera for kernels: rotation, position, intrinsics, width and height.

    The intrinsics are focal lengths, principal point and minimum depth.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near])
    return camera.rotation, camera.position, intrinsics, camera.width, camera.height


def project(scene: Scene, camera: Camera, antialiased: bool, start: int, stop: int) -> Splats:
    """Project Gaussians `start` to `stop`; skip those that cannot be visible."""
    count = stop - start
    fields = np.empty((count, DEPTH + 1))
    tiles = np.empty((count, 4), np.int32)
    gaussians = np.empty(count, np.int64)
    planes = [np.asarray(getattr(scene, group)) for group in GROUPS]
    first = 0
    rows = all(plane.flags.c_contiguous for plane in planes)
    if not rows and any(plane.flags.forc for plane in planes):
        # Compiling a kernel takes seconds, so there is one for planar layout and one for an
        # optimiser's interleaved layout. Gaussians in other layouts are copied.
        first, planes = start, [np.ascontiguousarray(plane[:, start:stop]) for plane in planes]
    seen = _project(
        *planes,
        *camera_arguments(camera),
        antialiased,
        start - first,
        stop - first,
        fields,
        tiles,
        gaussians,
    )
    return Splats(fields[:seen], tiles[:seen], gaussians[:seen] + first)


@kernel
def _project(
    positions, f_dc, f_rest, opacity, log_scale, rot, rotation, position, intrinsics,
    width, height, antialiased, start, stop, fields, tiles, gaussians,
):  # fmt: skip
    fx, fy, cx, cy, near = intrinsics
    columns = (width + TILE - 1) // TILE
    rows = (height + TILE - 1) // TILE
    seen = np.int64(0)
    for i in range(start, stop):
        dx = positions[0, i] - position[0]
        dy = positions[1, i] - position[1]
        dz = positions[2, i] - position[2]
        x, y, z = rotated(rotation, dx, dy, dz)
        if not near < z < np.inf or not _are_finite(opacity, log_scale, i):
            continue
        x /= z
        y /= z
        u = fx * x + cx - 0.5
        v = fy * y + cy - 0.5
        near_x, near_y = clamped_slopes(x, y, fx, fy, cx, cy, width, height)
        widest = math.exp(2.0 * max(log_scale[0, i], log_scale[1, i], log_scale[2, i]))
        if _is_outside(u, widest * (fx / z) ** 2 * (1.0 + near_x * near_x), columns):
            continue
        if _is_outside(v, widest * (fy / z) ** 2 * (1.0 + near_y * near_y), rows):
            continue
        alpha = 1.0 / (1.0 + math.exp(-np.float64(opacity[0, i])))
        axes = _screen_axes(log_scale, rot, i, rotation, near_x, near_y, fx / z, fy / z)
        xx, xy, yy, sharp = covariance(axes)
        determinant = sharp + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
        xx += LOW_PASS
        yy += LOW_PASS
        if not 0.0 < determinant < np.inf:
            continue
        if antialiased:
            alpha *= math.sqrt(max(0.000025, sharp / determinant))
        if not alpha >= MIN_ALPHA:
            continue
        reach = 2.0 * math.log(alpha / MIN_ALPHA)
        box = tiles[seen]
        if not _cover(u, v, xx, yy, determinant, reach, columns, rows, box):
            continue
        field = fields[seen]
        field[CENTRE_X] = u
        field[CENTRE_Y] = v
        field[FACTOR_XX] = math.sqrt(yy / determinant)
        field[FACTOR_XY] = -xy / math.sqrt(yy * determinant)
        field[FACTOR_YY] = 1.0 / math.sqrt(yy)
        field[REACH] = reach
        field[OPACITY] = alpha
        field[DEPTH] = z
        gaussians[seen] = i
        seen += 1
    _fill_colours(positions, f_dc, f_rest, position, gaussians[:seen], fields)
    return _keep_finite(fields, tiles, gaussians, seen)


@kernel
def _fill_colours(positions, f_dc, f_rest, position, gaussians, fields):
    """Fill in the colours as seen from the camera, channel by channel, in memory order."""
    coefficients = len(f_rest) // 3
    basis, bases, colours = np.zeros(15), np.zeros((15, _BLOCK)), np.empty((3, _BLOCK))
    for first in range(0, len(gaussians), _BLOCK):
        block = gaussians[first : first + _BLOCK]
        for j in range(len(block)):
            i = block[j]
            dx = positions[0, i] - position[0]
            dy = positions[1, i] - position[1]
            dz = positions[2, i] - position[2]
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            sh_basis(dx / distance, dy / distance, dz / distance, coefficients, basis)
            for k in range(coefficients):
                bases[k, j] = basis[k]
        for channel in range(3):
            colour = colours[channel]
            for j in range(len(block)):
                colour[j] = 0.5 + SH_C0 * f_dc[channel, block[j]]
            for k in range(coefficients):
                values, weights = f_rest[channel * coefficients + k], bases[k]
                for j in range(len(block)):
                    colour[j] += weights[j] * values[block[j]]
        for j in range(len(block)):
            for channel in range(3):
                fields[first + j, RED + channel] = colours[channel, j]


@kernel
def _keep_finite(fields, tiles, gaussians, count):
    """Remove splats whose colours are not finite; return the number that remain."""
    kept = 0
    for j in range(count):
        field = fields[j]
        finite = (abs(field[RED]) < np.inf) & (abs(field[GREEN]) < np.inf)
        if not finite & (abs(field[BLUE]) < np.inf):
            continue
        if kept < j:
            gaussians[kept] = gaussians[j]
            for k in range(DEPTH + 1):
                fields[kept, k] = field[k]
            for k in range(4):
                tiles[kept, k] = tiles[j, k]
        for channel in range(RED, BLUE + 1):
            fields[kept, channel] = max(0.0, field[channel])
        kept += 1
    return kept


@inlined
def _are_finite(opacity, log_scale, i):
    """Whether opacity and log-scales are finite; other values are checked after projection."""
    largest = max(abs(log_scale[0, i]), abs(log_scale[1, i]), abs(log_scale[2, i]))
    return abs(opacity[0, i]) < np.inf and largest < np.inf


@inlined
def covariance(axes):
    """Covariance xx, xy, yy of a splat before the low-pass, and its determinant."""
    xx = xy = yy = sharp = 0.0
    for axis in range(3):
        x, y = axes[axis]
        xx += x * x
        xy += x * y
        yy += y * y
        # Cauchy-Binet formula: xx yy - xy xy would cancel for needles.
        other = axes[(axis + 1) % 3]
        sharp += (x * other[1] - y * other[0]) ** 2
    return xx, xy, yy, sharp


@inlined
def _is_outside(centre, variance, tiles):
    """Whether a splat of at most this variance along an image axis touches none of its tiles.

    A quick test that gives the same result as `_cover`.
    """
    # Tiles begin a pixel early because of the margin; one more makes rounding irrelevant.
    gap = max(centre - tiles * TILE, -centre - TILE) - 2.0
    return (gap > 0.0) & (gap * gap > _FARTHEST * (variance + LOW_PASS))


@inlined
def _screen_axes(log_scale, rot, i, rotation, x, y, pixels_x, pixels_y):
    """The Gaussian's axes in the image, pixels (EWA splatting)."""
    _, turn = quaternion_turn(rot, i)
    scales = (
        math.exp(np.float64(log_scale[0, i])),
        math.exp(np.float64(log_scale[1, i])),
        math.exp(np.float64(log_scale[2, i])),
    )
    return (
        _screen_axis(scales[0], rotation, turn, 0, x, y, pixels_x, pixels_y),
        _screen_axis(scales[1], rotation, turn, 1, x, y, pixels_x, pixels_y),
        _screen_axis(scales[2], rotation, turn, 2, x, y, pixels_x, pixels_y),
    )


@inlined
def _screen_axis(scale, rotation, turn, axis, x, y, pixels_x, pixels_y):
    qx, qy, qz = rotated(rotation, turn[0][axis], turn[1][axis], turn[2][axis])
    return pixels_x * scale * (qx - x * qz), pixels_y * scale * (qy - y * qz)


@inlined
def clamped_slopes(x, y, fx, fy, cx, cy, width, height):
    """Slopes at which the Jacobian is evaluated, clamped to 1.3 times the field of view."""
    margin_x = 0.15 * width / fx
    margin_y = 0.15 * height / fy
    return (
        min((width - cx) / fx + margin_x, max(-cx / fx - margin_x, x)),
        min((height - cy) / fy + margin_y, max(-cy / fy - margin_y, y)),
    )


@inlined
def quaternion_turn(rot, i):
    """Norm and unit quaternion wxyz, and rotation matrix by rows; zero gives the identity."""
    a, b, c, d = (
        np.float64(rot[0, i]), np.float64(rot[1, i]), np.float64(rot[2, i]), np.float64(rot[3, i]),
    )  # fmt: skip
    norm = math.sqrt(a * a + b * b + c * c + d * d)
    if norm == 0.0:
        a = norm = 1.0
    a /= norm
    b /= norm
    c /= norm
    d /= norm
    turn = (
        (1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)),
        (2.0 * (b * c + a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b)),
        (2.0 * (b * d - a * c), 2.0 * (c * d + a * b), 1.0 - 2.0 * (b * b + c * c)),
    )
    return (norm, a, b, c, d), turn


@inlined
def rotated(rotation, x, y, z):
    """Rotate a vector from world axes to camera axes."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@inlined
def _cover(u, v, xx, yy, determinant, reach, columns, rows, box):
    """Fill `box` with the splat's tiles: 3DGS' 3-sigma square, cropped where alpha is too low."""
    mid = 0.5 * (xx + yy)
    radius = np.ceil(3.0 * math.sqrt(mid + math.sqrt(max(0.1, mid * mid - determinant))))
    # One pixel of margin, so that rounding has no effect.
    wide = math.sqrt(reach * xx) + 1.0
    high = math.sqrt(reach * yy) + 1.0
    box[0] = max(to_tile(u - radius, columns), to_tile(u - wide, columns))
    box[1] = min(to_tile(u + radius + TILE - 1, columns), to_tile(u + wide + TILE, columns))
    box[2] = max(to_tile(v - radius, rows), to_tile(v - high, rows))
    box[3] = min(to_tile(v + radius + TILE - 1, rows), to_tile(v + high + TILE, rows))
    return box[0] < box[1] and box[2] < box[3]


@inlined
def to_tile(pixel, tiles):
    """Tile of a pixel, 0 to `tiles`; 0 for NaN."""
    return np.int64(min(np.float64(tiles), max(0.0, pixel / TILE)))
