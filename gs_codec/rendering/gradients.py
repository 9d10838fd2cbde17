"""Derivatives of the loss of a view with respect to all attributes of all Gaussians.

Let C be the colour of a pixel, S_k the light behind splat k, and w_k = alpha_k T_k its weight. Then
``dC / dc_k = w_k`` and ``dC / dalpha_k = T_k c_k - S_k / (1 - alpha_k)`` (Kerbl et al. 2023,
Appendix C, which goes back to front).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.harmonics import sh_basis, sh_slope
from gs_codec.rendering.image_loss import differentiate_loss
from gs_codec.rendering.project import (
    BLUE,
    LOW_PASS,
    RED,
    camera_arguments,
    clamped_slopes,
    covariance,
    quaternion_turn,
    rotated,
)
from gs_codec.rendering.tiles_float32 import (
    BY_BLUE,
    BY_RED,
    MOMENT,
    MOMENT_X,
    MOMENT_XX,
    MOMENT_XY,
    MOMENT_Y,
    MOMENT_YY,
    sum_gradients,
)
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import SH_C0, Scene, channel_count

#: Derivative of a loss by an image, and the mean squared error, of that image and a target.
Loss = Callable[[NDArray, NDArray], tuple[NDArray, float]]

#: First f_dc column of a row of slopes.
_F_DC = 3

#: First f_rest column.
_F_REST = 6


@kernel
def differentiate_gaussians(
    positions, f_rest, opacity, log_scale, rot, rotation, position, intrinsics,
    width, height, antialiased, sums, chosen, start, stop, slopes,
):  # fmt: skip
    """Fill ``slopes (stop - start, 14 + 3 K)``, with columns in the order of `GROUPS`.

    They are the derivatives of Gaussians ``chosen[start:stop]``, computed from ``sums (M, 9)`` of
    `sum_gradients`.
    """
    fx, fy, cx, cy, _ = intrinsics
    to_world = rotation.T
    basis, weights = np.zeros(15), np.zeros(15)
    by_turn = np.empty((3, 3))
    after = _F_REST + len(f_rest)
    for j in range(stop - start):
        i = chosen[start + j]
        total, slope = sums[start + j], slopes[j]
        dx = positions[0, i] - position[0]
        dy = positions[1, i] - position[1]
        dz = positions[2, i] - position[2]
        by_dx, by_dy, by_dz = _differentiate_colour(
            f_rest, i, dx, dy, dz, total, basis, weights, slope
        )
        x, y, z = rotated(rotation, dx, dy, dz)
        x /= z
        y /= z
        near_x, near_y = clamped_slopes(x, y, fx, fy, cx, cy, width, height)
        quaternion, turn = quaternion_turn(rot, i)
        pixels = fx, fy, near_x, near_y
        scales = (
            math.exp(np.float64(log_scale[0, i])) / z,
            math.exp(np.float64(log_scale[1, i])) / z,
            math.exp(np.float64(log_scale[2, i])) / z,
        )
        (first, depth_0), (second, depth_1), (third, depth_2) = (
            _screen_axis(rotation, turn, 0, scales[0], pixels),
            _screen_axis(rotation, turn, 1, scales[1], pixels),
            _screen_axis(rotation, turn, 2, scales[2], pixels),
        )
        axes, depths = (first, second, third), (depth_0, depth_1, depth_2)
        (by_u, by_v), by_axes = _differentiate_conic(axes, total, antialiased)
        by_x, by_y, by_z = fx * by_u, fy * by_v, 0.0
        for k in range(3):
            along = axes[k][0] * by_axes[k][0] + axes[k][1] * by_axes[k][1]
            slope[after + 1 + k] = along
            by_z -= along / z
            by_qx = fx * scales[k] * by_axes[k][0]
            by_qy = fy * scales[k] * by_axes[k][1]
            if near_x == x:
                by_x -= depths[k] * by_qx
            if near_y == y:
                by_y -= depths[k] * by_qy
            by_qz = -near_x * by_qx - near_y * by_qy
            by_turn[k, 0], by_turn[k, 1], by_turn[k, 2] = rotated(to_world, by_qx, by_qy, by_qz)
        by_z -= (x * by_x + y * by_y) / z
        world_x, world_y, world_z = rotated(to_world, by_x / z, by_y / z, by_z)
        slope[0], slope[1], slope[2] = by_dx + world_x, by_dy + world_y, by_dz + world_z
        slope[after] = total[MOMENT] / (1.0 + math.exp(np.float64(opacity[0, i])))
        _differentiate_turn(rot, i, quaternion, by_turn, slope[after + 4 :])


@inlined
def _screen_axis(rotation, turn, axis, scale, pixels):
    """An axis of a Gaussian in the image, and its direction's component along the optical axis."""
    fx, fy, x, y = pixels
    qx, qy, qz = rotated(rotation, turn[0][axis], turn[1][axis], turn[2][axis])
    return (fx * scale * (qx - x * qz), fy * scale * (qy - y * qz)), qz


@inlined
def _differentiate_colour(f_rest, i, dx, dy, dz, total, basis, weights, slope):
    """Fill the columns of f_dc and f_rest; return the derivative by the viewing direction."""
    coefficients = len(f_rest) // 3
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    x, y, z = dx / distance, dy / distance, dz / distance
    sh_basis(x, y, z, coefficients, basis)
    weights[:] = 0.0
    for channel in range(3):
        row, by_value = channel * coefficients, total[BY_RED + channel]
        slope[_F_DC + channel] = SH_C0 * by_value
        for k in range(coefficients):
            slope[_F_REST + row + k] = basis[k] * by_value
            weights[k] += f_rest[row + k, i] * by_value
    by_x, by_y, by_z = sh_slope(x, y, z, coefficients, weights)
    along = x * by_x + y * by_y + z * by_z
    return (
        (by_x - along * x) / distance,
        (by_y - along * y) / distance,
        (by_z - along * z) / distance,
    )


@inlined
def _differentiate_conic(axes, total, antialiased):
    """Derivatives by the centre, and by the projected axes."""
    xx, xy, yy, sharp = covariance(axes)
    determinant = sharp + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS
    a = (yy + LOW_PASS) / determinant
    b = -xy / determinant
    c = (xx + LOW_PASS) / determinant
    # With conic K and second moments M, the derivative by the covariance is K M K / 2.
    mxx, mxy, myy = total[MOMENT_XX], total[MOMENT_XY], total[MOMENT_YY]
    by_xx = 0.5 * (a * a * mxx + 2.0 * a * b * mxy + b * b * myy)
    by_xy = a * b * mxx + (a * c + b * b) * mxy + b * c * myy
    by_yy = 0.5 * (b * b * mxx + 2.0 * b * c * mxy + c * c * myy)
    if antialiased and sharp / determinant > 0.000025:
        by_determinant = -0.5 * total[MOMENT] / determinant
        by_sharp = 0.5 * total[MOMENT] / sharp + by_determinant
        by_xx += by_sharp * yy + LOW_PASS * by_determinant
        by_xy -= 2.0 * by_sharp * xy
        by_yy += by_sharp * xx + LOW_PASS * by_determinant
    by_axes = (
        (
            2.0 * axes[0][0] * by_xx + axes[0][1] * by_xy,
            2.0 * axes[0][1] * by_yy + axes[0][0] * by_xy,
        ),
        (
            2.0 * axes[1][0] * by_xx + axes[1][1] * by_xy,
            2.0 * axes[1][1] * by_yy + axes[1][0] * by_xy,
        ),
        (
            2.0 * axes[2][0] * by_xx + axes[2][1] * by_xy,
            2.0 * axes[2][1] * by_yy + axes[2][0] * by_xy,
        ),
    )
    x, y = total[MOMENT_X], total[MOMENT_Y]
    return (a * x + b * y, b * x + c * y), by_axes


@inlined
def _differentiate_turn(rot, i, quaternion, columns, slope):
    """Derivative by the stored quaternion, from the derivative by the rotation's columns."""
    norm, a, b, c, d = quaternion
    (g00, g10, g20), (g01, g11, g21), (g02, g12, g22) = (
        (columns[0, 0], columns[0, 1], columns[0, 2]),
        (columns[1, 0], columns[1, 1], columns[1, 2]),
        (columns[2, 0], columns[2, 1], columns[2, 2]),
    )
    by_a = b * (g21 - g12) + c * (g02 - g20) + d * (g10 - g01)
    by_b = a * (g21 - g12) + c * (g01 + g10) + d * (g02 + g20) - 2.0 * b * (g11 + g22)
    by_c = a * (g02 - g20) + b * (g01 + g10) + d * (g12 + g21) - 2.0 * c * (g00 + g22)
    by_d = a * (g10 - g01) + b * (g02 + g20) + c * (g12 + g21) - 2.0 * d * (g00 + g11)
    along = a * by_a + b * by_b + c * by_c + d * by_d
    # A zero quaternion counts as the identity; its derivative is 0.
    size = max(abs(rot[0, i]), abs(rot[1, i]), abs(rot[2, i]), abs(rot[3, i]))
    factor = 2.0 / norm if size > 0.0 else 0.0
    slope[0] = factor * (by_a - along * a)
    slope[1] = factor * (by_b - along * b)
    slope[2] = factor * (by_c - along * c)
    slope[3] = factor * (by_d - along * d)


class Differentiated(NamedTuple):
    """A view of a scene, its mean squared error, and the derivatives of its loss by splat.

    ``chosen (M,)`` lists, ascending, the visible Gaussians: those whose sums are not all 0.
    ``sums (M, 9)`` are their sums of `sum_gradients`.
    """

    scene: Scene
    camera: Camera
    squared_error: float
    sums: NDArray[np.float64]
    chosen: NDArray[np.int64]

    def slopes(self, start: int, stop: int, sh_ac: bool = True) -> NDArray[np.float32]:
        """Derivatives ``(stop - start, 14 + 3 K)`` by attributes of ``chosen[start:stop]``.

        Columns are the channels of the groups, in the order of `GROUPS`. Without `sh_ac`, those of
        f_rest are omitted, and colours count as the same in all directions.
        """
        scene, f_rest = self.scene, self.scene.f_rest if sh_ac else self.scene.f_rest[:0]
        slopes = np.empty((stop - start, channel_count(len(f_rest) // 3)), np.float32)
        differentiate_gaussians(
            *(scene.positions, f_rest, scene.opacity, scene.log_scale, scene.rot),
            *camera_arguments(self.camera),
            scene.antialiased,
            self.sums,
            self.chosen,
            start,
            stop,
            slopes,
        )
        return slopes


def differentiate(
    scene: Scene,
    camera: Camera,
    target: NDArray[np.float32],
    background: Sequence[float],
    loss: Loss = differentiate_loss,
) -> Differentiated:
    """Render a view and propagate its loss back to the splats (Kerbl et al. 2023, Appendix A).

    Derivatives have float32 precision. Otherwise they are exact, except that, as in 3DGS, the set
    and order of splats in each pixel is treated as constant. The derivative is 0 for an alpha at
    its limit and for a colour below 0. Beyond 1.3 times the field of view, the projection's
    Jacobian is that at the edge.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    target : ndarray, shape (H, W, 3), float32
    background : sequence of three float
        RGB behind everything.
    loss : callable
        The loss: `differentiate_loss`, that of 3DGS, or `differentiate_squares`.
    """
    frame = make_frame(scene, camera)
    colour, state = frame.draw_float32(background)
    by_colour, squared_error = loss(colour, target)
    pairs = np.empty((frame.pairs, MOMENT_YY + 1))
    behind = np.array(background, np.float64)
    frame.over_tiles(sum_gradients, behind, by_colour, *state, pairs)
    sums, chosen = frame.sum_pairs(pairs), frame.splats.gaussians
    sums[:, BY_RED : BY_BLUE + 1][frame.splats.fields[:, RED : BLUE + 1] <= 0.0] = 0.0
    count = _keep_changing(sums, chosen)
    return Differentiated(scene, camera, squared_error, sums[:count], chosen[:count])


@kernel
def _keep_changing(sums, gaussians):
    """Move rows that are not all 0, and their Gaussians, to the front; return their number."""
    count = 0
    for i in range(len(sums)):
        changing = False
        for value in sums[i]:
            changing |= value != 0.0
        if changing:
            for k in range(sums.shape[1]):
                sums[count, k] = sums[i, k]
            gaussians[count] = gaussians[i]
            count += 1
    return count
