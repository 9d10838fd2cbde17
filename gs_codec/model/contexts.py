"""Tables for the contexts of a pass: neighbours share one where that is cheaper."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gs_codec.model.table import shannon_bits

#: Approximate bits that each symbol in use costs in a sent table.
_SYMBOL_BITS = 7.0


@dataclass(frozen=True)
class ContextTables:
    """Which table each context uses, and the histogram of each table.

    ``table_of (C,)`` rises by 0 or 1 from context to context; ``histograms (T, A)``.
    """

    table_of: NDArray[np.int64]
    histograms: NDArray[np.int64]


def share_tables(histograms: NDArray[np.int64]) -> ContextTables:
    """Merge neighbours of ``histograms (C, A)`` while tables cost more than they save.

    Contexts that do not occur share the table of the one before.
    """
    used = [int(c) for c in np.flatnonzero(histograms.any(axis=1))]
    if not used:
        return ContextTables(np.zeros(len(histograms), np.int64), histograms[:1])
    tokens = int(np.flatnonzero(histograms.any(axis=0))[-1]) + 1
    groups = [histograms[c, :tokens] for c in used]
    starts = [0, *used[1:]]
    costs = [_cost(group) for group in groups]
    merged = [_cost(a + b) for a, b in pairwise(groups)]
    while len(groups) > 1:
        gains = [costs[i] + costs[i + 1] - merged[i] for i in range(len(merged))]
        best = int(np.argmax(gains))
        if gains[best] <= 0:
            break
        costs[best : best + 2] = [merged[best]]
        groups[best : best + 2] = [groups[best] + groups[best + 1]]
        del starts[best + 1], merged[best]
        for i in (best - 1, best):
            if 0 <= i < len(merged):
                merged[i] = _cost(groups[i] + groups[i + 1])
    marks = np.zeros(len(histograms), np.int64)
    marks[starts[1:]] = 1
    return ContextTables(np.cumsum(marks), np.array(groups))


def _cost(histogram: NDArray[np.int64]) -> float:
    return shannon_bits(histogram) + _SYMBOL_BITS * np.count_nonzero(histogram)
