"""Which blocks at which level a camera needs. FORMAT.md, section "Selection".

All is done in binary64 with operations that are rounded alike everywhere, so every reader selects
the same blocks.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gs_codec.egs.egs_file import EgsFile
from gs_codec.egs.header import FANOUT
from gs_codec.egs.index import index_of
from gs_codec.egs.levels import check_errors, errors_of, within


@runtime_checkable
class View(Protocol):
    """What selection needs of a camera; see `Camera`."""

    @property
    def width(self) -> int:
        """Pixels."""

    @property
    def height(self) -> int:
        """Pixels."""

    @property
    def fx(self) -> float:
        """Focal length, pixels."""

    @property
    def fy(self) -> float:
        """Focal length, pixels."""

    @property
    def cx(self) -> float:
        """Principal point, pixels."""

    @property
    def cy(self) -> float:
        """Principal point, pixels."""

    @property
    def rotation(self) -> NDArray[np.float64]:
        """World to camera, shape (3, 3)."""

    @property
    def position(self) -> NDArray[np.float64]:
        """Centre in the world, shape (3,)."""


class Seen(NamedTuple):
    """What a view shows of a level's blocks, each ``(blocks,)``.

    Attributes
    ----------
    counts : ndarray, int64
        Gaussians.
    in_view : ndarray, bool
    distances : ndarray, float64
        From the camera to the block's second box, scene units.
    errors : ndarray, float64
        Pixels; 0 of level 0.
    """

    counts: NDArray[np.int64]
    in_view: NDArray[np.bool_]
    distances: NDArray[np.float64]
    errors: NDArray[np.float64]


def select_blocks(
    levels: Sequence[EgsFile], view: View, budget: int | None, tolerance: float
) -> list[list[int]]:
    """Numbers of the blocks of each level to draw, ascending.

    Parameters
    ----------
    levels : sequence of EgsFile
        The file, and its levels, each of which is coarser than the one before.
    view : View
    budget : int, optional
        Most Gaussians.
    tolerance : float
        Largest error in pixels of a block that is drawn in place of finer ones.

    Raises
    ------
    CorruptStream
        If a level's errors are below those of the one before.
    """
    seen = _look(levels, view)
    chosen: list[list[int]] = [[] for _ in levels]
    top = len(levels) - 1
    first = np.flatnonzero(seen[top].in_view).tolist()
    total = int(seen[top].counts[first].sum())
    if budget is not None and total > budget:
        chosen[top] = _nearest(seen[top], first, budget)
        return chosen
    queue = [(-seen[top].errors[block], -top, block) for block in first]
    heapq.heapify(queue)
    while queue and -queue[0][0] > tolerance:
        _, level, block = queue[0]
        finer = seen[-level - 1]
        own = range(FANOUT * block, min(FANOUT * (block + 1), len(finer.counts)))
        children = [child for child in own if finer.in_view[child]]
        more = int(finer.counts[children].sum()) - int(seen[-level].counts[block])
        if budget is not None and total + more > budget:
            break
        heapq.heappop(queue)
        total += more
        for child in children:
            heapq.heappush(queue, (-finer.errors[child], level + 1, child))
    for _, level, block in queue:
        chosen[-level].append(block)
    return [sorted(blocks) for blocks in chosen]


def _nearest(seen: Seen, blocks: list[int], budget: int) -> list[int]:
    """The nearest of some blocks, as many as a budget holds, ascending."""
    kept = []
    for block in sorted(blocks, key=lambda block: (seen.distances[block], block)):
        budget -= int(seen.counts[block])
        if budget < 0:
            break
        kept.append(block)
    return sorted(kept)


def _look(levels: Sequence[EgsFile], view: View) -> list[Seen]:
    """What a view shows of all levels."""
    found = []
    before = np.zeros(levels[0].header.block_count, np.float32)
    for number, file in enumerate(levels):
        header, boxes = file.header, index_of(file)[:, 6:].astype(np.float64)
        errors = errors_of(file) if number else before
        if number:
            with within(number):
                check_errors(before, errors)
        spans = [header.block_range(block) for block in range(header.block_count)]
        counts = np.array([stop - start for start, stop in spans], np.int64)
        distances = _distances(boxes, view)
        # An error of 0 is none from anywhere, any other is infinite from within the box.
        scaled = errors.astype(np.float64) * max(view.fx, view.fy)
        pixels = np.full(len(errors), np.inf)
        np.divide(scaled, distances, out=pixels, where=distances > 0)
        pixels[errors == 0] = 0.0
        found.append(Seen(counts, _in_view(boxes, view), distances, pixels))
        before = errors
    return found


def _distances(boxes: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Distances ``(blocks,)`` from the camera to boxes ``(blocks, 6)``; 0 from within."""
    place = np.asarray(view.position, np.float64)
    x, y, z = np.maximum(np.maximum(boxes[:, :3] - place, place - boxes[:, 3:]), 0.0).T
    return np.sqrt(x * x + y * y + z * z)


def _in_view(boxes: NDArray[np.float64], view: View) -> NDArray[np.bool_]:
    """Which boxes ``(blocks, 6)`` have corners on the inner side of every edge of a view."""
    corners = [[3 * (number >> axis & 1) + axis for axis in range(3)] for number in range(8)]
    x, y, z = (boxes[:, corners] - np.asarray(view.position, np.float64)).transpose(2, 0, 1)
    across, down, ahead = ((a * x + b * y) + c * z for a, b, c in view.rotation)
    edges = (
        ahead > 0,
        view.fx * across + view.cx * ahead >= 0,
        view.fx * across + (view.cx - view.width) * ahead <= 0,
        view.fy * down + view.cy * ahead >= 0,
        view.fy * down + (view.cy - view.height) * ahead <= 0,
    )
    return np.all([edge.any(axis=1) for edge in edges], axis=0)
