"""The SH-AC palette of a SOG scene: as many rows as pay off, and the row of each Gaussian."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Effort
from gs_codec.formats.cells import row_means, split_cells
from gs_codec.formats.codebook import choose_colours, every, make_table, weights_of
from gs_codec.formats.packed_values import planes_of
from gs_codec.formats.sog.nearest_rows import nearest_rows
from gs_codec.runtime.arrays import empty
from gs_codec.scene import sh_bands

#: Maximum number of rows with 16-bit labels.
_MOST = 1 << 16


class _Search(NamedTuple):
    """How long a palette is searched.

    Attributes
    ----------
    rounds : int
        Number of times that rows and labels are updated alternately.
    nearest : int
        Number of blocks of rows that a vector searches; see `nearest_rows`.
    """

    rounds: int
    nearest: int


_SEARCHES: Mapping[Effort, _Search] = {
    "fast": _Search(0, 1),
    "normal": _Search(1, 4),
    "high": _Search(4, 16),
}


class Palette(NamedTuple):
    """SH-AC as rows of levels of a table.

    Attributes
    ----------
    table : ndarray, shape (at most 256,), float32
        Ascending; symmetric about 0, which is one of its values.
    levels : ndarray, shape (rows, 3 * K), uint8
        The rows, most used first; at least one.
    labels : ndarray, shape (N,), int32
        The row of each Gaussian.
    """

    table: NDArray[np.float32]
    levels: NDArray[np.uint8]
    labels: NDArray[np.int32]


def fit_palette(
    f_rest: NDArray[np.float32], steps: NDArray[np.floating], effort: Effort = "normal"
) -> Palette:
    """Fit a palette of mean vectors, with levels and number of rows as fine as the step sizes.

    Parameters
    ----------
    f_rest : ndarray, shape (3 * K, N), float32
    steps : ndarray, shape (3, N)
        Wanted step sizes of each band.
    effort : {"fast", "normal", "high"}
        How long to search for rows.
    """
    search = _SEARCHES[effort]
    depth, count = f_rest.shape
    ratios = _ratios(steps, depth // 3)
    vectors = empty((count, depth), np.float32)
    np.divide(f_rest.T, ratios, out=vectors)
    weights = weights_of(steps[0])
    cells = split_cells(vectors, weights, _MOST)
    labels, number = cells.labels(), len(cells.stops)
    for _ in range(search.rounds):
        rows, _ = row_means(vectors, weights, labels, number)
        labels = nearest_rows(vectors, weights, labels, rows.astype(np.float32), search.nearest)
    rows, total = row_means(vectors, weights, labels, number)
    used = np.flatnonzero(total > 0) if count else np.zeros(1, np.int64)
    row_steps = np.maximum(total[used], 1e-300)[:, None] ** -0.5 * ratios
    values = rows[used] * ratios
    table = _make_table(values.ravel(), row_steps.ravel())
    levels = np.zeros((number, depth), np.uint8)
    by_channel = choose_colours(values.reshape(len(used), 3, -1), row_steps[:, : depth // 3], table)
    levels[used] = by_channel.reshape(-1, depth)
    labels = nearest_rows(vectors, weights, labels, table[levels] / ratios, search.nearest)
    return _by_use(table, levels, labels)


def _ratios(steps: NDArray[np.floating], coefficients: int) -> NDArray[np.float32]:
    """Ratio of the step of each SH-AC of all channels, ``(3 * K,)``, to that of the first band."""
    finest = np.maximum(steps[:, every(steps.size)], np.finfo(np.float32).tiny)
    of_bands = np.median(finest / finest[0], axis=1) if steps.shape[1] else np.ones(3)
    by_band = [of_bands[band] for band, some in enumerate(sh_bands(coefficients)) for _ in some]
    return np.tile(np.array(by_band, np.float32), 3)


def _make_table(values: NDArray[np.float64], steps: NDArray[np.float64]) -> NDArray[np.float32]:
    """A table made from magnitudes, whose least value becomes 0."""
    upper = make_table(np.abs(values), steps, 128)
    upper[0] = 0.0
    return np.concatenate([-upper[:0:-1], upper])


def _by_use(
    table: NDArray[np.float32], levels: NDArray[np.uint8], labels: NDArray[np.int32]
) -> Palette:
    """The palette of used rows, the most used first; one row if none is used."""
    counts = np.bincount(labels, minlength=len(levels))
    sequence = np.argsort(-counts, kind="stable")[: max(np.count_nonzero(counts), 1)]
    places = np.empty(len(levels), np.int32)
    places[sequence] = np.arange(len(sequence), dtype=np.int32)
    renamed = planes_of(1, len(labels), lambda some: places[labels[some]], np.int32)[0]
    return Palette(table, levels[sequence], renamed)
