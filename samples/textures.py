"""Textures: reflectance of surfaces as functions of the point in space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Texture = Callable[[Array], Array]
Colour = tuple[float, float, float]


def mix(a: Colour, b: Colour, share: Array) -> Array:
    """Blend from `a`, where `share` is 0, to `b`, where it is 1: colours ``(3, N)``."""
    return np.multiply.outer(a, 1 - share) + np.multiply.outer(b, share)


def waves(points: Array, frequency: float) -> Array:
    """Noise-like sum of sines in [-1, 1], four octaves along skewed directions."""
    total = np.zeros(points.shape[1])
    for octave in range(4):
        x, y, z = points * (frequency * 1.9**octave)
        warp = 1.7 * octave + np.sin(0.7 * z + 0.3 * y)
        total += np.sin(x + 0.6 * y + warp) * np.cos(0.8 * y - z + 0.5 * x - warp) / 1.6**octave
    return total / 2.35


def checker(size: float, a: Colour, b: Colour, turn: float = 0.0) -> Texture:
    """Checks in space: cubes of two alternating colours, rotated about z."""
    cos, sin = np.cos(turn), np.sin(turn)

    def texture(p: Array) -> Array:
        # The offset keeps cell borders away from faces at round coordinates.
        turned = np.array([cos * p[0] + sin * p[1], cos * p[1] - sin * p[0], p[2]])
        cell = np.floor(turned / size + 0.137).sum(axis=0) % 2
        return mix(a, b, cell) * (1 + 0.06 * waves(p, 9.0))

    return texture


def stripes(along: Callable[[Array], Array], period: float, a: Colour, b: Colour) -> Texture:
    """Two colours that alternate, with slightly soft edges, in `along`."""

    def texture(p: Array) -> Array:
        share = 0.5 + 0.5 * np.tanh(6 * np.sin(2 * np.pi * along(p) / period))
        return mix(a, b, share) * (1 + 0.05 * waves(p, 12.0))

    return texture


def marble(base: Colour, vein: Colour) -> Texture:
    """Dark veins where a sine, pushed about by noise, crosses zero."""

    def texture(p: Array) -> Array:
        phase = 9 * p[0] + 5 * p[2] - 4 * p[1] + 3.5 * waves(p, 8.0)
        return mix(base, vein, np.exp(-5 * np.abs(np.sin(phase))))

    return texture


def wood(dark: Colour, light: Colour) -> Texture:
    """Year rings about an axis along x, cut lengthwise, with a fine grain."""

    def texture(p: Array) -> Array:
        rings = 15 * np.hypot(p[1] + 0.11, p[2] + 0.35) + 1.2 * waves(p * [[0.4], [2], [2]], 2.0)
        share = (rings % 1.0) ** 2
        return mix(light, dark, share) * (1 + 0.08 * waves(p * [[1], [12], [12]], 6.0))

    return texture


def rainbow(p: Array) -> Array:
    """Hue that turns with height and azimuth, softly banded."""
    hue = 5.0 * p[2] + 3.0 * p[0] + 0.6 * waves(p, 5.0)
    return (0.55 + 0.33 * np.cos(hue + np.array([[0.0], [2.1], [4.2]]))) * (
        1 + 0.10 * np.sin(9 * hue)
    )


def mottled(base: Colour, frequency: float, depth: float) -> Texture:
    """One colour, uneven by `depth` of itself."""
    return lambda p: np.multiply.outer(base, 1 + depth * waves(p, frequency))


def leaves(base: Colour, frequency: float = 6.0) -> Texture:
    """One colour, with dark gaps of two sizes."""

    def texture(p: Array) -> Array:
        coarse, fine = waves(p, frequency), waves(p[::-1], 4.1 * frequency)
        return np.multiply.outer(base, 1 + 0.45 * coarse + 0.55 * fine) + 0.05 * np.fmax(coarse, 0)

    return texture


def bricks(width: float, height: float, brick: Colour, joint: Colour) -> Texture:
    """Courses of bricks of uneven tone, and the joints between."""

    def texture(p: Array) -> Array:
        row = np.floor(p[2] / height)
        along = (p[0] + p[1]) / width + 0.5 * (row % 2)
        between = (p[2] / height % 1 < 0.16) | (along % 1 < 0.1)
        tone = 1 + 0.16 * np.sin(7.7 * np.floor(along) + 3.1 * row) + 0.06 * waves(p, 5.0)
        return mix(brick, joint, between.astype(float)) * tone

    return texture
