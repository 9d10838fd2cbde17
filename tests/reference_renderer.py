"""Slow float64 renderer of 3DGS scenes: every pixel against every Gaussian, nearest first.

It shares no code with ``gs_codec`` and has no tiles, lists or sorting keys. Pixels that depend on a
comparison closer than `MARGIN` are marked, because rounding may decide it either way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

NEAR = 0.2
LOW_PASS = 0.3
MAX_ALPHA = 0.99
MIN_ALPHA = 1 / 255
MIN_TRANSMITTANCE = 1e-4
BLOCK = 16

#: Relative distance to a limit below which a comparison counts as undecided.
MARGIN = 1e-8


@dataclass
class Reference:
    """An image, the contribution of each Gaussian, and the unreliable pixels."""

    colour: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    weight: np.ndarray
    squared_weight: np.ndarray
    transmittance: np.ndarray
    pixels: np.ndarray
    stopped: np.ndarray  # (H, W): a Gaussian was skipped because too little light would pass
    undecided: np.ndarray  # (H, W)
    affected: np.ndarray  # (N,): touched an undecided pixel


class Splat(NamedTuple):
    """A projected Gaussian; pixel (row j, column i) is at (i, j)."""

    mean: np.ndarray
    covariance: np.ndarray  # including the low-pass
    determinant: float
    shrink: float  # factor on the determinant from the low-pass, in antialiased mode
    deviation: float  # along the long axis, pixels


def rotation_of(quaternion):
    norm = np.sqrt(np.sum(quaternion**2))
    w, x, y, z = quaternion / norm if norm > 0 else np.array([1.0, 0.0, 0.0, 0.0])
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def project(point, log_scale, quaternion, camera, antialiased):
    """The splat of a Gaussian at `point` in camera axes; None if it is not drawn."""
    x, y, z = point
    if not z > NEAR:
        return None
    # Beyond 0.3 half image sizes outside, the linearisation would diverge.
    beyond_x, beyond_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    slope_x = np.clip(
        x / z, -camera.cx / camera.fx - beyond_x, (camera.width - camera.cx) / camera.fx + beyond_x
    )
    slope_y = np.clip(
        y / z, -camera.cy / camera.fy - beyond_y, (camera.height - camera.cy) / camera.fy + beyond_y
    )
    jacobian = np.array(
        [
            [camera.fx / z, 0.0, -camera.fx * slope_x / z],
            [0.0, camera.fy / z, -camera.fy * slope_y / z],
        ]
    )
    root = jacobian @ camera.rotation @ rotation_of(quaternion) * np.exp(log_scale)
    covariance = root @ root.T + LOW_PASS * np.eye(2)
    mean = np.array(
        [camera.fx * x / z + camera.cx - 0.5, camera.fy * y / z + camera.cy - 0.5],
    )
    # Cauchy-Binet: a c - b b would cancel for needles.
    minors = [
        root[0, i] * root[1, j] - root[0, j] * root[1, i] for i, j in ((0, 1), (0, 2), (1, 2))
    ]
    sharp = sum(minor**2 for minor in minors)
    determinant = sharp + LOW_PASS * np.sum(root**2) + LOW_PASS**2
    if not np.isfinite([*mean, *covariance.flat, determinant]).all() or determinant <= 0:
        return None
    shrink = np.sqrt(max(0.000025, sharp / determinant)) if antialiased else 1.0
    middle = (covariance[0, 0] + covariance[1, 1]) / 2
    largest = middle + np.sqrt(max(0.1, middle**2 - determinant))
    return Splat(mean, covariance, determinant, shrink, np.sqrt(largest))


def covers(splat, columns, rows, camera, slack=0.0):
    """Which pixels are in a block that the three-sigma box of the splat touches."""
    radius = np.ceil(3 * splat.deviation * (1 + slack))
    inside = np.ones(columns.shape, bool)
    for centre, index, side in zip(
        splat.mean, (columns, rows), (camera.width, camera.height), strict=True
    ):
        reach = radius + slack * (1 + abs(centre))
        first = np.clip(np.trunc((centre - reach) / BLOCK), 0, -(-side // BLOCK))
        last = np.clip(np.trunc((centre + reach + BLOCK - 1) / BLOCK), 0, -(-side // BLOCK))
        inside &= (first <= index // BLOCK) & (index // BLOCK < last)
    return inside


def sh_basis(direction):
    """The 16 real spherical harmonics up to degree 3, with the signs of 3DGS."""
    x, y, z = direction
    return np.array(
        [
            0.28209479177387814,
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    )


def colour_of(f_dc, f_rest, offset):
    direction = offset / np.sqrt(np.sum(offset**2))
    per_colour = f_rest.reshape(3, -1)
    basis = sh_basis(direction)[: 1 + per_colour.shape[1]]
    return np.maximum(np.column_stack([f_dc, per_colour]) @ basis + 0.5, 0.0)


def render_reference(scene, camera, background=(0.0, 0.0, 0.0), antialiased=False):
    """The image of `scene` as defined by the rasteriser of INRIA's trainer."""
    groups = ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot")
    planes = {name: getattr(scene, name).astype(np.float64) for name in groups}
    finite = np.isfinite(np.concatenate(list(planes.values()))).all(axis=0)
    with np.errstate(all="ignore"):
        offsets = planes["positions"].T - camera.position
        points = np.array([camera.rotation @ offset for offset in offsets]).reshape(-1, 3)
        opacities = 1 / (1 + np.exp(-planes["opacity"][0]))
        image = Canvas(scene.count, camera)
        for n in np.argsort(points[:, 2], kind="stable"):
            splat = finite[n] and project(
                points[n], planes["log_scale"][:, n], planes["rot"][:, n], camera, antialiased
            )
            if splat:
                colour = colour_of(planes["f_dc"][:, n], planes["f_rest"][:, n], offsets[n])
                image.add(n, splat, opacities[n] * splat.shrink, colour, points[n, 2])
    return image.finished(np.asarray(background, np.float64))


class Canvas:
    """The pixels, while Gaussians are added nearest first."""

    def __init__(self, count, camera):
        shape = (camera.height, camera.width)
        self.camera = camera
        self.rows, self.columns = np.indices(shape)
        self.colour = np.zeros((*shape, 3))
        self.depth = np.zeros(shape)
        self.transmittance = np.ones(shape)
        self.stopped = np.zeros(shape, bool)
        self.undecided = np.zeros(shape, bool)
        self.sums = np.zeros((3, count))
        self.pixels = np.zeros(count, np.int64)
        self.affected = np.zeros(count, bool)

    def add(self, n, splat, opacity, colour, depth):
        (a, b), (_, c) = splat.covariance / splat.determinant
        dx, dy = splat.mean[0] - self.columns, splat.mean[1] - self.rows
        power = -0.5 * (c * dx * dx + a * dy * dy) + b * dx * dy
        alpha = np.minimum(MAX_ALPHA, opacity * np.exp(power))
        passing = self.transmittance * (1 - alpha)

        drawn = covers(splat, self.columns, self.rows, self.camera) & ~self.stopped
        drawn &= (power <= 0) & (alpha >= MIN_ALPHA)
        stopping = drawn & (passing < MIN_TRANSMITTANCE)

        visible = covers(splat, self.columns, self.rows, self.camera, MARGIN)
        visible &= alpha >= MIN_ALPHA * (1 - MARGIN)
        terms = 0.5 * (c * dx * dx + a * dy * dy) + np.abs(b * dx * dy)
        doubtful = ~covers(splat, self.columns, self.rows, self.camera, -MARGIN)
        doubtful |= (np.abs(power) < MARGIN * terms) & (terms > 0)
        doubtful |= np.abs(alpha / MIN_ALPHA - 1) < MARGIN
        doubtful |= np.abs(passing / MIN_TRANSMITTANCE - 1) < MARGIN
        self.undecided |= visible & doubtful & ~self.stopped
        self.affected[n] = (visible & self.undecided).any()

        self.stopped |= stopping
        drawn &= ~stopping
        weight = np.where(drawn, alpha * self.transmittance, 0.0)
        self.sums[:, n] = (
            weight.sum(),
            (weight**2).sum(),
            self.transmittance[drawn].sum(),
        )
        self.pixels[n] = drawn.sum()
        self.colour += weight[:, :, None] * colour
        self.depth += weight * depth
        self.transmittance = np.where(drawn, passing, self.transmittance)

    def finished(self, background):
        alpha = 1 - self.transmittance
        total = np.where(alpha > 0, alpha, 1.0)  # the weights of a pixel sum to its alpha
        return Reference(
            self.colour + self.transmittance[:, :, None] * background,
            alpha,
            self.depth / total,
            *self.sums,
            self.pixels,
            self.stopped,
            self.undecided,
            self.affected,
        )
