"""Passes of a block: their streams, and the contexts that choose the tables of their symbols.

FORMAT.md, section "Passes", has the same list.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.rotation import TURNS
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import sh_bands

#: Most classes of shape, and of colour.
MAX_CLASSES = 16

#: Number of contexts by shift; larger shifts share the last.
SHIFT_CONTEXTS = 32

#: Buckets of the values of the two Gaussians before.
BEFORE = 8

#: Number of shifts in a context of SH-DC, which is a colour, a shift and an activity.
COLOUR_SHIFTS = 16

#: Number of activities: how much the neighbours' colours differ.
ACTIVITIES = 6

#: Buckets of a sum of magnitudes.
SUMS = 16

#: Number of sign sums in a context of an SH-AC level, which is what is left of its band's sum, the
#: absolute sum of the signs of two neighbours, and the place of the coefficient in its band.
SIGNS = 3

#: Number of places in a band, rounded up to a power of two.
MEMBERS = 8

#: Most tables of a list of contexts.
MAX_TABLES = 64

#: Approximate bits of a table in the file.
_TABLE_BITS = 100.0

#: Approximate bits of each symbol in use in a table.
_SYMBOL_BITS = 7.0


class ContextList(NamedTuple):
    """Contexts of one kind of symbol; neighbours in the list may share a table."""

    name: str
    stream: str
    contexts: int


@dataclass(frozen=True)
class Pass:
    """A run of symbols whose contexts are of one or several lists.

    Without `turns`, all of its symbols are of one stream; else symbol i is of the stream of list
    ``i % len(lists)``.
    """

    lists: tuple[ContextList, ...]
    turns: bool = False

    @property
    def streams(self) -> list[str]:
        """Its streams, in order."""
        return list(dict.fromkeys(item.stream for item in self.lists))

    @property
    def cycle(self) -> NDArray[np.int64]:
        """Number of the stream of each symbol, which repeats."""
        of_list = [self.streams.index(item.stream) for item in self.lists]
        return np.array(of_list if self.turns else [0])


#: The pass of everything but colours: one symbol from each list for each Gaussian.
SHAPE_PASS = Pass(
    (
        ContextList("shape class", "classes", 2 * MAX_CLASSES - 1),
        ContextList("colour class", "classes", MAX_CLASSES),
        ContextList("opacity", "opacity", SHIFT_CONTEXTS * BEFORE),
        *(ContextList(f"scale_{k}", "scaling", SHIFT_CONTEXTS * BEFORE) for k in range(3)),
        *(ContextList(name, "rotation", SHIFT_CONTEXTS) for name in TURNS),
    ),
    turns=True,
)

#: First context of each list of the shape pass.
SHAPE_OFFSETS = np.array([0, *accumulate(item.contexts for item in SHAPE_PASS.lists)])

#: Of opacity and scales: values of the two Gaussians before, added, are shifted down by this, and
#: moved up by that. Values are in units of 2**-20, so buckets are 1 logit, or 0.5 log-scale, wide.
BEFORE_SHIFTS = np.array([21, 20, 20, 20])
BEFORE_CENTRES = np.array([4, 4, 0, 0])


@inlined
def before_bucket(attribute, total):
    """Bucket of the sum of two values of opacity (0) or a scale (1-3)."""
    place = (total >> BEFORE_SHIFTS[attribute]) + BEFORE_CENTRES[attribute]
    return min(max(place, 0), BEFORE - 1)


#: Least sums of the buckets from 1 up; and the bucket of each sum that is not larger than the last.
_LEAST_SUMS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192])
SUM_BUCKETS = np.searchsorted(_LEAST_SUMS, np.arange(193), side="right").astype(np.uint8)


@inlined
def sum_bucket(total):
    """Bucket of a sum of magnitudes: twice its log2 rounded down, plus its second bit."""
    return np.int64(SUM_BUCKETS[np.uint64(min(total, len(SUM_BUCKETS) - 1))])


def passes(coefficients: int) -> list[Pass]:
    """The passes of a block, in order, for a number of SH-AC coefficients per colour."""
    listed = [
        SHAPE_PASS,
        Pass((ContextList("f_dc", "sh-dc", 3 * COLOUR_SHIFTS * ACTIVITIES),)),
    ]
    bands = len(sh_bands(coefficients))
    for band in range(1, bands + 1):
        stream = f"sh{band}"
        lists = [
            ContextList(f"{stream} {colour}", stream, SUMS * SIGNS * MEMBERS)
            for colour in ("Y", "Co", "Cg")
        ]
        if band < bands:
            lists.insert(0, ContextList(f"SH sum_{band}", stream, SUMS))
        if band == 1:
            lists.insert(0, ContextList("SH sum", stream, COLOUR_SHIFTS * SUMS))
        listed.append(Pass(tuple(lists)))
    return listed


def share_tables(histograms: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Merge neighbours of ``histograms (C, A)`` while tables cost more than they save.

    More are merged if there are more than `MAX_TABLES`. Contexts that do not occur share the table
    of the one before.

    Returns
    -------
    table_of : ndarray, shape (C,)
        Table that each context uses; rises by 0 or 1 from context to context.
    histograms : ndarray, shape (T, A)
        Histogram of each table, A up to the last token that occurs.
    """
    used = np.flatnonzero(histograms.any(axis=1))
    if not len(used):
        return np.zeros(len(histograms), np.int64), histograms[:1]
    tokens = int(np.flatnonzero(histograms.any(axis=0))[-1]) + 1
    groups = np.ascontiguousarray(histograms[used, :tokens])
    begins = np.ones(len(used), np.bool_)
    _merge(groups, begins)
    marks = np.zeros(len(histograms), np.int64)
    marks[used[begins][1:]] = 1
    return np.cumsum(marks), groups[begins]


@inlined
def _log2(value):
    """Base-2 logarithm of a positive number; the same on every machine, to 1e-10."""
    mantissa, exponent = math.frexp(value)
    if mantissa < math.sqrt(0.5):
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    z = (mantissa - 1.0) / (mantissa + 1.0)
    square = z * z
    series = 1.0 / 11.0
    for odd in (9.0, 7.0, 5.0, 3.0, 1.0):
        series = series * square + 1.0 / odd
    return exponent + 2.0 * z * series * 1.4426950408889634


@kernel
def _cost(groups, first, second):
    """Bits of two histograms under one table, with the table; of one, if it is twice the same."""
    total, bits = np.int64(0), _TABLE_BITS
    for a in range(groups.shape[1]):
        count = groups[first, a]
        if second != first:
            count += groups[second, a]
        if count > 0:
            total += count
            bits += _SYMBOL_BITS - count * _log2(np.float64(count))
    return bits + total * _log2(np.float64(total))


@kernel
def _merge(groups, begins):
    """Merge groups ``(G, A)`` into ones before; `begins` stays True for those that are left."""
    count = len(groups)
    after = np.arange(1, count + 1)
    costs, gains = np.empty(count), np.full(count, -np.inf)
    for i in range(count):
        costs[i] = _cost(groups, i, i)
    for i in range(count - 1):
        gains[i] = costs[i] + costs[i + 1] - _cost(groups, i, i + 1)
    left = count
    while left > 1:
        best = np.int64(0)
        for i in range(1, count):
            if gains[i] > gains[best]:
                best = i
        if gains[best] <= 0.0 and left <= MAX_TABLES:
            break
        gone = after[best]
        for a in range(groups.shape[1]):
            groups[best, a] += groups[gone, a]
        begins[gone], gains[gone], after[best] = False, -np.inf, after[gone]
        costs[best] = _cost(groups, best, best)
        left -= 1
        before = best - 1
        while before >= 0 and not begins[before]:
            before -= 1
        gains[best] = -np.inf
        if after[best] < count:
            nxt = after[best]
            gains[best] = costs[best] + costs[nxt] - _cost(groups, best, nxt)
        if before >= 0:
            gains[before] = costs[before] + costs[best] - _cost(groups, before, best)
