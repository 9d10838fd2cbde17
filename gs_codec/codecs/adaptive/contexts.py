"""Passes of a block: their streams, and the contexts that select symbols' tables.

FORMAT.md, section "Passes", specifies the same list.
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

#: Maximum number of shape classes, and of colour classes.
MAX_CLASSES = 16

#: Number of contexts by shift; larger shifts share the last.
SHIFT_CONTEXTS = 32

#: Number of buckets for the values of the two previous Gaussians.
BEFORE = 8

#: Number of shifts in a context of SH-DC, which consists of a channel, a shift and an activity.
COLOUR_SHIFTS = 16

#: Number of activities: classes of how much the neighbours' colours differ.
ACTIVITIES = 6

#: Number of buckets for a sum of magnitudes.
SUMS = 16

#: Number of sign sums in a context of an SH-AC level, which consists of the remaining sum of its
#: band, the absolute sum of two neighbours' signs, and the index of the coefficient in its band.
SIGNS = 3

#: Number of coefficients of a band, rounded up to a power of two.
MEMBERS = 8

#: Maximum number of tables of a context list.
MAX_TABLES = 64

#: Approximate cost of a table in the file, in bits.
_TABLE_BITS = 100.0

#: Approximate cost of each symbol in use in a table, in bits.
_SYMBOL_BITS = 7.0


class ContextList(NamedTuple):
    """Contexts of one kind of symbol; neighbouring contexts may share a table."""

    name: str
    stream: str
    contexts: int


@dataclass(frozen=True)
class Pass:
    """A sequence of symbols whose contexts come from one or several lists.

    Without `turns`, all symbols are in one stream; with it, symbol i is in the stream of list ``i %
    len(lists)``.
    """

    lists: tuple[ContextList, ...]
    turns: bool = False

    @property
    def streams(self) -> list[str]:
        """The names of its streams, in order."""
        return list(dict.fromkeys(item.stream for item in self.lists))

    @property
    def cycle(self) -> NDArray[np.int64]:
        """One period of the stream numbers of its symbols."""
        of_list = [self.streams.index(item.stream) for item in self.lists]
        return np.array(of_list if self.turns else [0])


#: The pass for everything but colours: one symbol from each list for each Gaussian.
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

#: The sum of the values of the two previous Gaussians, for opacity and scales, is shifted right by
#: this. Values are in units of 2**-20, so buckets are 1 logit, or 0.5 log-scale, wide.
BEFORE_SHIFTS = np.array([21, 20, 20, 20])
BEFORE_CENTRES = np.array([4, 4, 0, 0])


@inlined
def before_bucket(attribute, total):
    """Bucket of the sum of two values, of opacity (0) or of a scale (1-3)."""
    place = (total >> BEFORE_SHIFTS[attribute]) + BEFORE_CENTRES[attribute]
    return min(max(place, 0), BEFORE - 1)


#: Lower bounds of buckets 1 and up; and a table of the bucket of each sum up to the last bound.
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
    """Merge neighbouring ``histograms (C, A)`` while separate tables cost more than they save.

    Merging continues until at most `MAX_TABLES` remain. Contexts that do not occur share the table
    of the context before.

    Returns
    -------
    table_of : ndarray, shape (C,)
        Table number of each context; it increases by 0 or 1 from one context to the next.
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
    """Bits of two merged histograms, table included; of one histogram, if both are the same."""
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
    """Merge groups ``(G, A)`` into their predecessors; `begins` becomes False for merged ones."""
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
