"""Attributes of Gaussians, with the distributions of trained scenes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from samples.surfaces import SurfacePoints

#: Share of Gaussians whose SH-AC is all zero.
FLAT_COLOUR_SHARE = 0.15

#: Opacity logit below which the trainer removes Gaussians (opacity 0.005).
FAINTEST = -5.29

# Scale of the Laplace distribution of each SH-AC coefficient: smaller in higher bands.
_BAND_SCALE = np.repeat(np.array([0.055, 0.035, 0.025], np.float32), [3, 5, 7])


def noisy(rgb: NDArray, rng: np.random.Generator) -> NDArray:
    """Colours with the noise that training leaves, mostly in brightness."""
    brightness = 0.035 * rng.standard_normal(rgb.shape[1])
    return rgb + brightness + 0.012 * rng.standard_normal(rgb.shape)


def log_scales(spacing: NDArray, axis: NDArray, rng: np.random.Generator) -> NDArray:
    """Log-scales ``(3, N)`` of flat splats, the thin one in row `axis`."""
    z = rng.standard_normal((4, len(spacing)))
    tangent = np.log(0.8 * spacing) + 0.35 * z[0]
    thin = tangent - 2.2 + 0.7 * z[1]
    axes = np.array([tangent + 0.35 * z[2], tangent + 0.35 * z[3], np.minimum(thin, tangent - 0.7)])
    return np.take_along_axis(axes, _axis_order(axis), axis=0)


def _axis_order(axis: NDArray) -> NDArray:
    """Which of (tangent, tangent, normal) is in each row; a cyclic permutation."""
    return (np.arange(3)[:, None] + 2 - axis) % 3


def rotations(points: SurfacePoints, axis: NDArray, rng: np.random.Generator) -> NDArray:
    """Quaternions wxyz ``(4, N)``, norm 0.7-1.3, that align local axis `axis` with the normal."""
    x, y, z = points.normals
    # The smallest rotation from z to the normal; straight down, where it is undefined, 180 degrees
    # about x.
    down = z < -1 + 1e-9
    tilt = np.array([np.where(down, 0, 1 + z), np.where(down, 1, -y), x, 0 * z])
    half = np.pi * rng.random(len(axis))
    spin = np.array([np.cos(half), 0 * z, 0 * z, np.sin(half)])
    # Cyclic permutations of the axes: normal on x, on y, on z.
    cycle = np.array([[0.5, -0.5, -0.5, -0.5], [0.5, 0.5, 0.5, 0.5], [1, 0, 0, 0]]).T[:, axis]
    q = multiply(multiply(tilt, spin), cycle)
    # Training starts at the identity, so w is rarely negative.
    q *= np.where((q[0] < 0) == (rng.random(len(axis)) < 0.95), -1, 1)
    norm = np.clip(1 + 0.1 * rng.standard_normal(len(axis)), 0.7, 1.3)
    return q * (norm / np.sqrt((q**2).sum(axis=0)))


def multiply(p: NDArray, q: NDArray) -> NDArray:
    """Hamilton product of quaternions wxyz ``(4, N)``."""
    a, b, c, d = p
    e, f, g, h = q
    return np.array(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    )


def opacities(count: int, rng: np.random.Generator) -> NDArray:
    """Logits ``(N,)``: nearly opaque ones, and a tail of faint ones down to the trainer's limit."""
    opaque = rng.random(count) < 0.65
    z = rng.standard_normal(count)
    return np.clip(np.where(opaque, 4.5 + 1.8 * z, -1.2 + 1.9 * z), FAINTEST, 14.0)


def fill_sh(f_rest: NDArray[np.float32], gloss: NDArray, rng: np.random.Generator) -> None:
    """Laplace SH-AC: smaller in higher bands, mostly equal in R, G, B, a few Gaussians strong."""
    coefficients, count = len(f_rest) // 3, f_rest.shape[1]
    # A log-normal strength per Gaussian makes the tails heavier than those of a Laplace
    # distribution.
    strength = gloss * np.exp(0.45 * rng.standard_normal(count))
    strength[rng.random(count) < FLAT_COLOUR_SHARE] = 0
    scale = strength.astype(np.float32) * _BAND_SCALE[:coefficients, None]
    common = _laplace((coefficients, count), rng)
    for colour in f_rest.reshape(3, coefficients, count):
        colour[:] = scale * (0.92 * common + 0.39 * _laplace(common.shape, rng))


def _laplace(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    # A difference of exponentials in float32 is twice as fast as Generator.laplace.
    a = rng.standard_exponential(shape, dtype=np.float32)
    return a - rng.standard_exponential(shape, dtype=np.float32)
