"""Building blocks of layers: points, legends, colour maps, boxes, errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: The colour map viridis at evenly spaced values.
_VIRIDIS = np.array(
    [
        (68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141),
        (39, 173, 129), (92, 200, 99), (170, 220, 50), (253, 231, 37),
    ]
) / 255.0  # fmt: skip

#: Okabe and Ito's palette without black; distinct to most colour-blind people.
_KINDS = np.array(
    [
        (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (0, 114, 178),
        (213, 94, 0), (204, 121, 167),
    ]
) / 255.0  # fmt: skip

#: Brightness of these colours in successive passes through the palette.
_ROUNDS = (1.0, 0.7, 0.45)

#: Colour for unknown values.
UNKNOWN = (0.45, 0.45, 0.45)

#: Colour of the selection: on no colour map, and visible on dark, light and grey.
SELECTED = (1.0, 0.25, 0.95)

#: Edges of a box.
EDGES = 12

#: Start of the scale of errors: a quarter of a level of 255.
_LEAST_ERROR = 0.25 / 255

#: Length of that scale in doublings: up to 64 levels.
_DOUBLINGS = 8


@dataclass(frozen=True)
class Legend:
    """Legend of a colour scale or palette.

    Attributes
    ----------
    title : str
    marks : tuple of str
        For a heat map, five evenly spaced values, from the first colour to the last; otherwise one
        per colour in `kinds`.
    kinds : tuple of RGB colours, 0-1
        Empty for a heat map.
    """

    title: str
    marks: tuple[str, ...]
    kinds: tuple[tuple[float, float, float], ...] = ()

    @property
    def places(self) -> NDArray[np.float64]:
        """Positions of the marks along the bar, 0-1."""
        count = len(self.marks)
        return (np.arange(count) + 0.5) / count if self.kinds else np.linspace(0, 1, count)

    def bar(self, width: int, height: int) -> NDArray[np.float32]:
        """The bar of colours, ``(height, width, 3)``, 0-1."""
        if self.kinds:
            kind = np.arange(width) * len(self.kinds) // width
            return np.broadcast_to(np.array(self.kinds, np.float32)[kind], (height, width, 3))
        return np.broadcast_to(heat(np.linspace(0, 1, width), 0, 1), (height, width, 3))


@dataclass(frozen=True, eq=False)
class Points:
    """Positions and colours ``(n, 3)`` float32, colours 0-1, and an optional legend."""

    positions: NDArray[np.float32]
    colours: NDArray[np.float32]
    legend: Legend | None = None


def heat(values: NDArray, low: float, high: float) -> NDArray[np.float32]:
    """Heat-map colours ``(..., 3)`` of values, from dark to bright."""
    scaled = np.clip((np.asarray(values) - low) / ((high - low) or 1.0), 0, 1)
    scaled = np.nan_to_num(scaled) * (len(_VIRIDIS) - 1)
    known = np.arange(len(_VIRIDIS))
    channels = [np.interp(scaled, known, _VIRIDIS[:, k]) for k in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def error_heat(errors: NDArray) -> NDArray[np.float32]:
    """Colours ``(..., 3)`` of errors, 0-1, on a fixed logarithmic scale."""
    steps = np.log2(np.maximum(errors, _LEAST_ERROR) / _LEAST_ERROR)
    return heat(steps, 0, _DOUBLINGS)


def error_legend(title: str) -> Legend:
    """The legend of `error_heat`."""
    marks = 255 * _LEAST_ERROR * 2.0 ** np.arange(0, _DOUBLINGS + 1, 2)
    return Legend(f"{title}, of 255", tuple(f"{mark:g}" for mark in marks))


def legend_of(title: str, values: NDArray) -> Legend:
    """A legend of values with three significant digits, or all digits of larger ones."""
    return Legend(title, tuple(f"{v:.3g}" if v < 1000 else f"{v:,.0f}" for v in values))


def reason_colour(index: int) -> tuple[float, float, float]:
    """The colour of a reason for pruning, by its index."""
    red, green, blue = _KINDS[index % len(_KINDS)].tolist()
    return red, green, blue


def block_colour(index: int) -> tuple[float, float, float]:
    """The colour of a block, by its index; the first 21 are distinct."""
    brightness = _ROUNDS[index // len(_KINDS) % len(_ROUNDS)]
    red, green, blue = (brightness * _KINDS[index % len(_KINDS)]).tolist()
    return red, green, blue


def box_lines(boxes: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Corners ``(8 n, 3)`` and edges ``(12 n, 2)`` of boxes ``(n, 2, 3)``."""
    corners = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)])
    edges = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
    points = np.empty((len(boxes), 8, 3))
    for axis in range(3):
        points[:, :, axis] = boxes[:, corners[:, axis], axis]
    lines = np.array(edges)[None] + 8 * np.arange(len(boxes))[:, None, None]
    return points.reshape(-1, 3), lines.reshape(-1, 2).astype(np.int32)


def error_image(first: NDArray, second: NDArray) -> NDArray[np.float32]:
    """Heat map of the error of each pixel between two images ``(H, W, 3)``."""
    errors = np.sqrt(np.mean((np.clip(first, 0, 1) - np.clip(second, 0, 1)) ** 2, axis=2))
    return error_heat(errors)


#: The legend of `error_image`.
PIXEL_LEGEND = error_legend("error of a pixel")
