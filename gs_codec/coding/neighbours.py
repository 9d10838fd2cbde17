"""Exact nearest-neighbour search in a tree of boxes (k-d tree), each halved in turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all

#: Maximum number of points in a leaf.
_LEAF = 12

#: Query positions per task.
_CHUNK = 1 << 13


class Neighbours:
    """A set of points that can be searched for the nearest ones to a position.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Finite; duplicates are allowed.
    """

    def __init__(self, points: NDArray) -> None:
        self._points = np.array(points, np.float64, order="C")
        count = len(self._points)
        self._indices = np.arange(count)
        leaves = 1
        while leaves * _LEAF < count:
            leaves *= 2
        self._boxes = np.zeros((2 * leaves - 1, 2, 3))
        _halve_all(self._points, self._indices, self._boxes)

    def nearest(
        self, places: NDArray, number: int, within: float = np.inf
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Find the nearest points, the nearest first.

        Parameters
        ----------
        places : ndarray, shape (M, 3)
            Finite.
        number : int
            Number of points to find for each position.
        within : float, optional
            Ignore points at this distance or farther.

        Returns
        -------
        distances : ndarray, shape (M, number)
            Infinity if there are fewer points.
        indices : ndarray, shape (M, number)
            N if there are fewer points.
        """
        places = np.ascontiguousarray(places, np.float64)
        distances = np.full((len(places), number), float(within) ** 2)
        indices = np.full(distances.shape, len(self._points))
        arrays = self._points, self._indices, self._boxes, places, distances, indices
        starts = range(0, len(places) if number else 0, _CHUNK)
        run_all(lambda start: _search(*arrays, start, min(start + _CHUNK, len(places))), starts)
        return distances, indices


@kernel
def _halve_all(points, indices, boxes):
    """Compute the bounds of each box, and sort the points so that each half is a contiguous range.

    The halves of box k are boxes 2 k + 1 and 2 k + 2.
    """
    waiting = np.empty((64, 3), np.int64)
    waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, 0, len(points)
    top = 1
    while top > 0:
        top -= 1
        box, first, end = waiting[top, 0], waiting[top, 1], waiting[top, 2]
        axis = _bound(points, first, end, boxes, box)
        if 2 * box + 1 < len(boxes):
            middle = (first + end) // 2
            _partition(points, indices, first, end, middle, axis)
            for half in range(2):
                waiting[top, 0] = 2 * box + 1 + half
                waiting[top, 1] = middle if half else first
                waiting[top, 2] = end if half else middle
                top += 1


@inlined
def _bound(points, first, end, boxes, box):
    """Lowest and highest coordinates of a range of points; return the axis of largest extent."""
    axis, longest = 0, -1.0
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in range(first, end):
            low, high = min(low, points[i, k]), max(high, points[i, k])
        boxes[box, 0, k], boxes[box, 1, k] = low, high
        if high - low > longest:
            axis, longest = k, high - low
    return axis


@inlined
def _partition(points, indices, first, end, middle, axis):
    """Partition points so that none before the middle exceeds one after it (quickselect)."""
    low, high = first, end - 1
    while low < high:
        pivot = points[(low + high) // 2, axis]
        i, j = low, high
        while i <= j:
            while points[i, axis] < pivot:
                i += 1
            while points[j, axis] > pivot:
                j -= 1
            if i <= j:
                for k in range(3):
                    points[i, k], points[j, k] = points[j, k], points[i, k]
                indices[i], indices[j] = indices[j], indices[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break


@inlined
def _squared_distance(boxes, box, x, y, z):
    """Squared distance of a position from a box; 0 inside it."""
    dx = max(boxes[box, 0, 0] - x, 0.0, x - boxes[box, 1, 0])
    dy = max(boxes[box, 0, 1] - y, 0.0, y - boxes[box, 1, 1])
    dz = max(boxes[box, 0, 2] - z, 0.0, z - boxes[box, 1, 2])
    return dx * dx + dy * dy + dz * dz


@kernel
def _search(points, indices, boxes, places, distances, found, start, stop):
    """Fill rows of `distances`, initialised with the squared limit, and of `found`."""
    number = distances.shape[1]
    waiting, away = np.empty((64, 3), np.int64), np.empty(64)
    for row in range(start, stop):
        x, y, z = places[row, 0], places[row, 1], places[row, 2]
        waiting[0, 0], waiting[0, 1], waiting[0, 2] = 0, 0, len(points)
        away[0] = 0.0
        top = 1
        while top > 0:
            top -= 1
            if away[top] >= distances[row, number - 1]:
                continue
            box, first, end = waiting[top, 0], waiting[top, 1], waiting[top, 2]
            if 2 * box + 1 < len(boxes):
                left = _squared_distance(boxes, 2 * box + 1, x, y, z)
                right = _squared_distance(boxes, 2 * box + 2, x, y, z)
                middle = (first + end) // 2
                nearer = 0 if left <= right else 1
                for turn in range(2):  # push the nearer half last, so that it is visited first
                    half = nearer if turn else 1 - nearer
                    waiting[top, 0] = 2 * box + 1 + half
                    waiting[top, 1] = middle if half else first
                    waiting[top, 2] = end if half else middle
                    away[top] = right if half else left
                    top += 1
                continue
            for i in range(first, end):
                dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
                distance = dx * dx + dy * dy + dz * dz
                if distance < distances[row, number - 1]:
                    place = number - 1
                    while place > 0 and distances[row, place - 1] > distance:
                        distances[row, place] = distances[row, place - 1]
                        found[row, place] = found[row, place - 1]
                        place -= 1
                    distances[row, place] = distance
                    found[row, place] = indices[i]
        for k in range(number):
            none = found[row, k] == len(points)
            distances[row, k] = np.inf if none else np.sqrt(distances[row, k])
