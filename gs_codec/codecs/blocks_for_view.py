"""Select the blocks and levels of detail that a camera needs. FORMAT.md, section "Selection".

All arithmetic is binary64, with operations that are rounded alike everywhere, so every reader
selects the same blocks.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gs_codec.egs.egs_file import EgsFile
from gs_codec.egs.header import FANOUT
from gs_codec.egs.index import check_errors, errors_of, index_of, within


@runtime_checkable
class View(Protocol):
    """The camera attributes that selection needs; see `Camera`."""

    @property
    def width(self) -> int:
        """Image width, pixels."""

    @property
    def height(self) -> int:
        """Image height, pixels."""

    @property
    def fx(self) -> float:
        """Horizontal focal length, pixels."""

    @property
    def fy(self) -> float:
        """Vertical focal length, pixels."""

    @property
    def cx(self) -> float:
        """Principal point, x, pixels."""

    @property
    def cy(self) -> float:
        """Principal point, y, pixels."""

    @property
    def rotation(self) -> NDArray[np.float64]:
        """World-to-camera rotation, shape (3, 3)."""

    @property
    def position(self) -> NDArray[np.float64]:
        """Camera centre in the world, shape (3,)."""


class Seen(NamedTuple):
    """The blocks of a level, as seen in a view; each array is ``(blocks,)``.

    Attributes
    ----------
    counts : ndarray, int64
        Number of Gaussians.
    in_view : ndarray, bool
    distances : ndarray, float64
        Distance from the camera to the box of the block's ellipsoids, scene units.
    errors : ndarray, float64
        Error in pixels; 0 at level 0.
    """

    counts: NDArray[np.int64]
    in_view: NDArray[np.bool_]
    distances: NDArray[np.float64]
    errors: NDArray[np.float64]


def select_blocks(
    levels: Sequence[EgsFile], view: View, budget: int | None, tolerance: float
) -> list[list[int]]:
    """Select the blocks of each level to draw; returns their numbers, ascending.

    Raises CorruptStream if a level's errors are below those of the finer level.

    Parameters
    ----------
    levels : sequence of EgsFile
        The file, then its levels, from fine to coarse.
    view : View
    budget : int, optional
        Maximum number of Gaussians.
    tolerance : float
        Maximum error in pixels of a block that is drawn in place of finer ones.
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
    """The nearest blocks that fit into the budget, ascending."""
    kept = []
    for block in sorted(blocks, key=lambda block: (seen.distances[block], block)):
        budget -= int(seen.counts[block])
        if budget < 0:
            break
        kept.append(block)
    return sorted(kept)


def _look(levels: Sequence[EgsFile], view: View) -> list[Seen]:
    """Evaluate all levels for a view."""
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
        # An error of 0 stays 0 at any distance; any other error is infinite inside the box.
        scaled = errors.astype(np.float64) * max(view.fx, view.fy)
        pixels = np.full(len(errors), np.inf)
        np.divide(scaled, distances, out=pixels, where=distances > 0)
        pixels[errors == 0] = 0.0
        found.append(Seen(counts, _in_view(boxes, view), distances, pixels))
        before = errors
    return found


def _distances(boxes: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Distances ``(blocks,)`` from the camera to boxes ``(blocks, 6)``; 0 inside."""
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
