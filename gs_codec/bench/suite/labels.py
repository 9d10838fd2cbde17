"""Labels beside marks, none on another nor on a mark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Where a label may stand: angles, and distances in points; the nearest to the right first.
_ANGLES = np.deg2rad([0, 30, -30, 180, 150, -150, 60, -60, 90, -90, 120, -120])
_DISTANCES = (8.0, 15.0, 24.0, 34.0, 46.0, 60.0)

#: How often each label is placed: where others came to stand is known from the second time.
_PASSES = 3

#: Half the width of a mark with its margin, in points.
_MARK = 5.0

Box = NDArray[np.float64]

#: A line: x and y of its corners.
Drawn = tuple[Sequence[float], Sequence[float]]


@dataclass(frozen=True)
class Label:
    """Text for a place in data coordinates."""

    x: float
    y: float
    text: str
    colour: str
    bold: bool = False


def place_labels(axis: Axes, labels: Sequence[Label], lines: Sequence[Drawn]) -> None:
    """Write labels where they overlap least; limits and layout must be final.

    Parameters
    ----------
    axis : Axes
    labels : sequence of Label
        Each stands beside a mark, which others keep off.
    lines : sequence of (x, y)
        Lines drawn, which labels keep off.
    """
    if not labels:
        return
    figure = axis.figure
    point = figure.dpi / 72
    marks = axis.transData.transform([(label.x, label.y) for label in labels])
    texts = [
        axis.annotate(
            label.text, (label.x, label.y), (0, 0), textcoords="offset points",
            fontsize=8, color=label.colour, weight="bold" if label.bold else "normal",
            va="center", ha="center", zorder=5,
        )
        for label in labels
    ]  # fmt: skip
    sizes = np.array([text.get_window_extent().size for text in texts]) + 1.5 * point
    fixed = [_around(mark, np.full(2, 2 * _MARK * point)) for mark in marks]
    fixed += [_around(spot, np.full(2, 3.5 * point)) for spot in _along(axis, lines, point)]
    frame = axis.get_window_extent()
    inside = np.array([frame.min, frame.max])
    offsets = _arrange(marks, sizes, np.array(fixed), inside, point)
    for label, text, mark, size, offset in zip(labels, texts, marks, sizes, offsets, strict=True):
        text.set_position(tuple(offset / point))
        if (np.abs(offset) > size / 2 + 14 * point).any():
            _lead(axis, mark, offset, size, label.colour)


def _arrange(marks: Box, sizes: Box, fixed: Box, inside: Box, point: float) -> Box:
    """Offsets of labels from their marks: one after the other, then each again."""
    near = np.hypot(*(marks[:, None] - marks).transpose(2, 0, 1)) < 60 * point
    offsets = np.zeros_like(marks)
    placed = np.zeros(len(marks), bool)
    for i in [*np.argsort(-near.sum(axis=1), kind="stable")] * _PASSES:
        placed[i] = False
        others = marks[placed] + offsets[placed]
        halves = sizes[placed] / 2
        taken = np.concatenate([fixed, np.stack([others - halves, others + halves], axis=1)])
        offsets[i] = _best(marks[i], sizes[i], taken, inside, point)
        placed[i] = True
    return offsets


def _best(mark: Box, size: Box, taken: Box, inside: Box, point: float) -> Box:
    """The offset whose box covers least of what is taken; of equals, the first."""
    best, least = np.zeros(2), np.inf
    for rank, (distance, angle) in enumerate((d, a) for d in _DISTANCES for a in _ANGLES):
        way = np.array([np.cos(angle), np.sin(angle)])
        # To the box's rim from its middle, sideways by its width, else by its height.
        offset = way * distance * point + np.sign(np.round(way, 6)) * size / 2 * (
            np.abs(way) > (0.3, 0.6)
        )
        box = _around(mark + offset, size)
        outside = np.maximum(inside[0] - box[0], 0).sum() + np.maximum(box[1] - inside[1], 0).sum()
        cost = _covered(box, taken) + 40 * point * outside + 0.2 * point**2 * rank
        if cost < least:
            best, least = offset, cost
    return best


def _covered(box: Box, taken: Box) -> float:
    """Area of a box that others cover, each for itself."""
    low, high = np.maximum(taken[:, 0], box[0]), np.minimum(taken[:, 1], box[1])
    return float(np.prod(np.maximum(high - low, 0), axis=1).sum())


def _around(middle: Box, size: Box) -> Box:
    return np.array([middle - size / 2, middle + size / 2])


def _along(axis: Axes, lines: Sequence[Drawn], point: float) -> list[Box]:
    """Spots along lines, in pixels, close enough to keep labels off them."""
    spots: list[Box] = []
    for x, y in lines:
        corners = axis.transData.transform(np.column_stack([x, y]))
        for start, end in zip(corners[:-1], corners[1:], strict=True):
            steps = int(np.hypot(*(end - start)) / (4 * point)) + 1
            spots += list(start + np.linspace(0, 1, steps)[:, None] * (end - start))
    return spots


def _lead(axis: Axes, mark: Box, offset: Box, size: Box, colour: str) -> None:
    """A thin line from a mark to its label that stands apart."""
    near = np.clip(mark, mark + offset - size / 2, mark + offset + size / 2)
    ends = axis.transData.inverted().transform([mark, near])
    axis.plot(*ends.T, color=colour, lw=0.6, alpha=0.6, zorder=1.5)
