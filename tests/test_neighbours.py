"""Nearest neighbours equal those of an exhaustive search."""

from __future__ import annotations

import numpy as np
import pytest

from gs_codec.coding.neighbours import Neighbours
from gs_codec.runtime.threads import using_threads


def points_of(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    spread = rng.random((count, 3))
    if kind == "copies":
        return spread[rng.integers(0, max(count // 7, 1), count)]
    return {
        "even": spread,
        "far": np.exp(rng.normal(0, 8, (count, 3))) * rng.choice([-1, 1], (count, 3)),
        "line": spread * [1.0, 0.0, 0.0],
        "one place": np.full((count, 3), 0.25),
    }[kind]


@pytest.mark.parametrize("kind", ["even", "copies", "far", "line", "one place"])
@pytest.mark.parametrize("count", [1, 2, 12, 13, 500])
def test_nearest_are_those_of_all(kind, count):
    rng = np.random.default_rng(count)
    points = points_of(kind, count, rng)
    places = np.concatenate([points[:60], points_of(kind, 40, rng)])
    expected = np.sqrt(((places[:, None] - points) ** 2).sum(axis=2))
    number = min(count, 9)
    distances, indices = Neighbours(points).nearest(places, number)
    np.testing.assert_allclose(distances, np.sort(expected, axis=1)[:, :number], rtol=1e-14)
    np.testing.assert_array_equal(np.take_along_axis(expected, indices, 1), distances)
    assert all(len(set(row)) == number for row in indices.tolist())


def test_where_there_are_no_more_points():
    points = np.array([[0.0, 0, 0], [3.0, 0, 0]])
    distances, indices = Neighbours(points).nearest([[1.0, 0, 0]], 3)
    assert distances.tolist() == [[1.0, 2.0, np.inf]]
    assert indices.tolist() == [[0, 1, 2]]
    distances, indices = Neighbours(points).nearest([[1.0, 0, 0]], 2, within=2.0)
    assert distances.tolist() == [[1.0, np.inf]]
    assert indices.tolist() == [[0, 2]]
    distances, indices = Neighbours(np.empty((0, 3))).nearest([[1.0, 0, 0]], 1)
    assert (distances.tolist(), indices.tolist()) == ([[np.inf]], [[0]])
    assert Neighbours(points).nearest(np.empty((0, 3)), 2)[1].shape == (0, 2)
    assert Neighbours(points).nearest(points, 0)[0].shape == (2, 0)


def test_threads_do_not_change_them():
    points = points_of("copies", 30_000, np.random.default_rng(5))
    found = []
    for threads in (1, 3):
        with using_threads(threads):
            found.append(Neighbours(points).nearest(points, 4))
    np.testing.assert_array_equal(found[0], found[1])
