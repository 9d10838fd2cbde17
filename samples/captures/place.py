"""A place to be captured: surfaces and lights."""

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
        Its shadows are soft by this much.
    power : float
        Of a lamp, right at it.
    reach : float
        Distance at which it has half its power.
    """

    position: Point
    radius: float = 0.04
    power: float = 1.7
    reach: float = math.inf


@dataclass(frozen=True)
class Place:
    """Surfaces that no ray leaves, and what lights them; metres, z up.

    Parameters
    ----------
    surfaces : tuple of Surface
    lights : tuple of Light
    above : Colour
        What glossy surfaces reflect from above.
    """

    surfaces: tuple[Surface, ...]
    lights: tuple[Light, ...]
    above: Colour = (0.75, 0.78, 0.82)
