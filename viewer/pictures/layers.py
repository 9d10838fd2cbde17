"""Layers of a scene: centres and their colours, pruned Gaussians, boxes of blocks, errors."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewer.scenes.opened import Opened, Pruned

#: The colour map viridis at evenly spaced values.
_VIRIDIS = np.array(
    [
        (68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141),
        (39, 173, 129), (92, 200, 99), (170, 220, 50), (253, 231, 37),
    ]
) / 255.0  # fmt: skip

#: Colours of the reasons for pruning, in order.
_REASONS = np.array([(0, 220, 255), (255, 160, 0), (255, 40, 80), (190, 90, 255)]) / 255.0

#: Colour of what is selected: on no colour map, and seen on dark, light and grey by everybody.
SELECTED = (1.0, 0.25, 0.95)

#: Edges of a box.
EDGES = 12

#: Step of hue between the boxes of successive blocks, turns, so that neighbours look different.
_HUE_STEP = 0.381966

#: Quantiles of the sizes that get the first and the last colour.
_SIZES = (0.01, 0.99)

#: The scale of errors: from a quarter of a level of 255 to 64 levels, in eight doublings.
_LEAST_ERROR, _DOUBLINGS = 0.25 / 255, 8


@dataclass(frozen=True)
class Legend:
    """Legend of a heat map: five evenly spaced values, from the first colour to the last."""

    title: str
    marks: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Points:
    """Positions and colours ``(n, 3)`` float32, colours 0-1, and an optional legend."""

    positions: NDArray[np.float32]
    colours: NDArray[np.float32]
    legend: Legend | None = None


def heat(values: NDArray, low: float, high: float) -> NDArray[np.float32]:
    """Colours ``(..., 3)`` of values, from dark to bright."""
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


def heat_bar(width: int, height: int) -> NDArray[np.float32]:
    """The colours of `heat` from its lowest value to its highest, ``(height, width, 3)``."""
    return np.broadcast_to(heat(np.linspace(0, 1, width), 0, 1), (height, width, 3))


def reason_colour(index: int) -> tuple[float, float, float]:
    """The colour of a reason for pruning, by its index."""
    red, green, blue = _REASONS[index % len(_REASONS)].tolist()
    return red, green, blue


def thinned(count: int, most: int) -> slice:
    """A slice that takes at most `most` of `count` items, evenly spaced in stored order."""
    return slice(None, None, max(1, -(-count // max(most, 1))))


def block_colour(index: int) -> tuple[float, float, float]:
    """The colour of a block, by its index."""
    return colorsys.hsv_to_rgb(index * _HUE_STEP % 1, 0.65, 0.95)


def centres(
    scene: Opened, colouring: str, scenes: Sequence[Opened], most: int | None = None
) -> Points:
    """Centres of a scene, at most `most`, and their colours.

    Parameters
    ----------
    scene : Opened
    colouring : {"colour", "opacity", "scale", "error"}
        SH-DC; opacity; the longest axis; the distance in colour from the nearest centre of the
        other scene.
    scenes : sequence of Opened
        All scenes shown; the first sets the range of sizes. If there is only one, ``error`` is not
        known, and its own colours are shown.
    most : int, optional
    """
    some = thinned(scene.count, most or scene.count)
    positions = scene.positions[some]
    others = [other for other in scenes if other is not scene]
    if colouring == "opacity":
        legend = Legend("opacity", ("0", "0.25", "0.5", "0.75", "1"))
        return Points(positions, heat(scene.opacities[some], 0, 1), legend)
    if colouring == "scale":
        sizes = scenes[0].sizes
        low, high = (float(np.quantile(sizes, q)) if sizes.size else 0.0 for q in _SIZES)
        marks = tuple(f"{10**size:.2g}" for size in np.linspace(low, high, 5))
        legend = Legend("longest axis, scene units", marks)
        return Points(positions, heat(scene.sizes[some], low, high), legend)
    if colouring == "error" and others:
        errors = colour_errors(scene, others[0], some)
        return Points(positions, error_heat(errors), error_legend("colour error"))
    return Points(positions, scene.colours[some])


def colour_errors(scene: Opened, reference: Opened, some: slice) -> NDArray[np.float32]:
    """Root-mean-square difference over RGB from the SH-DC colour of the nearest centre."""
    from scipy.spatial import cKDTree

    colours = scene.colours[some]
    if not reference.count:
        return np.zeros(len(colours), np.float32)
    finite = np.isfinite(reference.positions).all(axis=1)
    tree = cKDTree(reference.positions[finite])
    positions = np.nan_to_num(scene.positions[some])
    nearest = tree.query(positions, workers=-1)[1]
    known = reference.colours[finite][nearest]
    return np.sqrt(np.mean((colours - known) ** 2, axis=1))


def pruned_centres(scene: Opened, pruned: Pruned, most: int | None = None) -> Points:
    """Pruned Gaussians, at most `most`, in the colours of the reasons."""
    labels = pruned.of(scene).labels
    gone = np.flatnonzero(labels)
    gone = gone[thinned(len(gone), most or len(gone))]
    palette = np.array([reason_colour(k) for k in range(max(len(pruned.reasons), 1))], np.float32)
    return Points(scene.positions[gone], palette[labels[gone] - 1])


def selected_centres(scene: Opened, selected: NDArray[np.bool_], most: int) -> Points:
    """Centres of the selected Gaussians ``(N,)``, at most `most`, in `SELECTED`."""
    rows = np.flatnonzero(selected)
    rows = rows[thinned(len(rows), most)]
    return Points(scene.positions[rows], np.full((len(rows), 3), SELECTED, np.float32))


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
