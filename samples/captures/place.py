"""A place to capture: surfaces and lights."""

from __future__ import annotations

import math
from dataclasses import dataclass

from samples.shapes import Point
from samples.surfaces import Surface
from samples.textures import Colour


@dataclass(frozen=True)
class Light:
    """A lamp, or the sun.

    Parameters
    ----------
    position : Point
    radius : float
        Radius of the light, which softens its shadows.
    power : float
        Power at the lamp itself.
    reach : float
        Distance at which the power is halved.
    """

    position: Point
    radius: float = 0.04
    power: float = 1.7
    reach: float = math.inf


@dataclass(frozen=True)
class Place:
    """Surfaces that enclose all rays, and lights; metres, z up.

    Parameters
    ----------
    surfaces : tuple of Surface
    lights : tuple of Light
    above : Colour
        Colour that glossy surfaces reflect from above.
    """

    surfaces: tuple[Surface, ...]
    lights: tuple[Light, ...]
    above: Colour = (0.75, 0.78, 0.82)
