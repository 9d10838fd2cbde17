"""Passes of a block: their streams, contexts and tables.

FORMAT.md, section "Passes", has the same list.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.rotation import TURNS
from gs_codec.coding.frequency_table import shannon_bits
from gs_codec.scene import sh_bands

#: Most classes of shape, and of colour.
MAX_CLASSES = 16

#: Number of contexts by shift; larger shifts share the last.
SHIFT_CONTEXTS = 32

#: Contexts of SH-DC: by colour, then shift, then how much the neighbours disagree.
COLOUR_SHIFTS, ACTIVITIES = 16, 6

#: Least sum of |level| of SH-AC of each energy class; class 0 has none.
ENERGIES = np.array([0, 1, 2, 3, 5, 8, 13, 22, 41], np.int64)

#: Approximate bits that each symbol in use costs in a sent table.
_SYMBOL_BITS = 7.0


@dataclass(frozen=True)
class Pass:
    """A run of symbols of one kind."""

    name: str
    stream: str
    contexts: int


def passes(coefficients: int) -> list[Pass]:
    """The passes of a scene, in stream order, for a number of SH-AC coefficients per colour."""
    listed = [
        Pass("shape class", "classes", 1),
        Pass("colour class", "classes", MAX_CLASSES),
        Pass("opacity", "opacity", SHIFT_CONTEXTS),
        *(Pass(f"scale_{k}", "scaling", SHIFT_CONTEXTS) for k in range(3)),
        *(Pass(name, "rotation", SHIFT_CONTEXTS) for name in TURNS),
        Pass("f_dc", "sh-dc", 3 * COLOUR_SHIFTS * ACTIVITIES),
    ]
    if coefficients:
        listed.append(Pass("SH energy", "sh1", SHIFT_CONTEXTS))
    for band, colour, k in sh_channels(coefficients):
        name = f"f_rest {('Y', 'Co', 'Cg')[colour]}_{k}"
        listed.append(Pass(name, f"sh{band}", len(ENERGIES)))
    return listed


def sh_channels(coefficients: int) -> list[tuple[int, int, int]]:
    """Band, colour and coefficient of each SH-AC pass, in stream order."""
    return [
        (number, colour, k)
        for number, band in enumerate(sh_bands(coefficients), 1)
        for colour in range(3)
        for k in band
    ]


def shift_context(shifts: NDArray) -> NDArray:
    """Contexts ``(n,)`` of shifts."""
    return np.minimum(shifts, SHIFT_CONTEXTS - 1)


def energy_class(levels: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Energy class ``(n,)`` of SH-AC levels ``(channels, n)``, below 2**30 in magnitude."""
    sums = np.abs(levels).sum(axis=0, dtype=np.int64)
    return (np.searchsorted(ENERGIES, sums, side="right") - 1).astype(np.uint8)


def share_tables(histograms: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Merge neighbours of ``histograms (C, A)`` while tables cost more than they save.

    Contexts that do not occur share the table of the one before.

    Returns
    -------
    table_of : ndarray, shape (C,)
        Table that each context uses; rises by 0 or 1 from context to context.
    histograms : ndarray, shape (T, A)
        Histogram of each table.
    """
    used = [int(c) for c in np.flatnonzero(histograms.any(axis=1))]
    if not used:
        return np.zeros(len(histograms), np.int64), histograms[:1]
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
    return np.cumsum(marks), np.array(groups)


def _cost(histogram: NDArray[np.int64]) -> float:
    return shannon_bits(histogram) + _SYMBOL_BITS * np.count_nonzero(histogram)
