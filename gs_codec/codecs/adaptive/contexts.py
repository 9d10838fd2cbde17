"""Passes of a block: their streams, contexts and tables.

FORMAT.md, section "Passes", has the same list.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

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

#: Bucket of a sum of magnitudes: twice its log2 rounded down, plus its second bit; at most 15.
SUM_BUCKETS = np.array(
    [
        0,
        1,
        *(min(2 * n.bit_length() - 2 + (n >> n.bit_length() - 2) % 2, 15) for n in range(2, 193)),
    ]
)

#: Contexts of an SH-AC coefficient: by what is left of its band's sum, then its neighbours' signs.
SIGNS = 3
SH_CONTEXTS = (int(SUM_BUCKETS[-1]) + 1) * SIGNS

#: Most coefficients of a band; those of a band and colour share a list of contexts.
_MEMBERS = 8

#: Most tables of a list of contexts.
MAX_TABLES = 64

#: Approximate bits that a sent table costs, and each symbol in use in it.
_TABLE_BITS, _SYMBOL_BITS = 100.0, 7.0


class Following(NamedTuple):
    """How the values v, w of the two Gaussians before choose one of several contexts.

    The context is ``buckets[((v + w) >> fraction) + centre]``, the index clamped to the array.
    """

    fraction: int
    centre: int
    buckets: NDArray[np.int64]

    @property
    def contexts(self) -> int:
        """Number of contexts."""
        return int(self.buckets[-1]) + 1


#: Passes whose contexts depend on the Gaussians before. Sums are of two values in units of 2**-20:
#: contexts are steps of 1 of a logit, of 0.5 of a log-scale.
FOLLOWING = {
    "shape class": Following(0, 0, np.arange(2 * MAX_CLASSES - 1)),
    "opacity": Following(21, 4, np.arange(8)),
    "scale_0": Following(20, 4, np.arange(8)),
    "scale_1": Following(20, 0, np.arange(8)),
    "scale_2": Following(20, 0, np.arange(8)),
    "SH sum": Following(0, 0, SUM_BUCKETS),
}


@dataclass(frozen=True)
class Pass:
    """A run of symbols of one kind.

    Context c of the pass is context ``members * c + member`` of a list of contexts, which several
    passes may have in common; without the name `listed`, it has one of its own.
    """

    name: str
    stream: str
    contexts: int
    listed: str = ""
    member: int = 0
    members: int = 1

    @property
    def contexts_listed(self) -> tuple[str, int]:
        """Name of its list of contexts, and their number."""
        return self.listed or self.name, self.members * self.contexts

    def rows(self, listed: NDArray[np.int64]) -> NDArray[np.int64]:
        """Tables of its contexts, of those of its list."""
        return np.ascontiguousarray(listed[self.member :: self.members])


def passes(coefficients: int) -> list[Pass]:
    """The passes of a scene, in stream order, for a number of SH-AC coefficients per colour."""
    following = {name: rule.contexts for name, rule in FOLLOWING.items()}
    listed = [
        Pass("shape class", "classes", following["shape class"]),
        Pass("colour class", "classes", MAX_CLASSES),
        Pass("opacity", "opacity", SHIFT_CONTEXTS * following["opacity"]),
        *(
            Pass(f"scale_{k}", "scaling", SHIFT_CONTEXTS * following[f"scale_{k}"])
            for k in range(3)
        ),
        *(Pass(name, "rotation", SHIFT_CONTEXTS) for name in TURNS),
        Pass("f_dc", "sh-dc", 3 * COLOUR_SHIFTS * ACTIVITIES),
    ]
    bands = sh_bands(coefficients)
    if bands:
        listed.append(Pass("SH sum", "sh1", COLOUR_SHIFTS * following["SH sum"]))
    for band, members in enumerate(bands, 1):
        stream = f"sh{band}"
        if band < len(bands):
            listed.append(Pass(f"SH sum_{band}", stream, int(SUM_BUCKETS[-1]) + 1))
        listed += [
            Pass(f"f_rest {colour}_{k}", stream, SH_CONTEXTS, f"{stream} {colour}", j, _MEMBERS)
            for colour in ("Y", "Co", "Cg")
            for j, k in enumerate(members)
        ]
    return listed


def context_lists(listed: list[Pass]) -> dict[str, int]:
    """Number of contexts of each list that passes have tables from, by name, in stream order."""
    return dict(item.contexts_listed for item in listed)


def shift_context(shifts: NDArray, contexts: int = SHIFT_CONTEXTS) -> NDArray:
    """Contexts ``(n,)`` of shifts."""
    return np.minimum(shifts, contexts - 1)


def sum_context(sums: NDArray) -> NDArray:
    """Contexts ``(n,)`` of sums of magnitudes."""
    return SUM_BUCKETS[np.minimum(sums, len(SUM_BUCKETS) - 1)]


def share_tables(histograms: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Merge neighbours of ``histograms (C, A)`` while tables cost more than they save.

    More are merged if there are more than `MAX_TABLES`. Contexts that do not occur share the table
    of the one before.

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
    gains = np.array([a + b for a, b in pairwise(costs)]) - merged
    while len(gains):
        best = int(np.argmax(gains))
        if gains[best] <= 0 and len(groups) <= MAX_TABLES:
            break
        groups[best : best + 2] = [groups[best] + groups[best + 1]]
        costs[best : best + 2] = [_cost(groups[best])]
        del starts[best + 1]
        gains = np.delete(gains, best)
        for i in range(max(best - 1, 0), min(best + 1, len(gains))):
            gains[i] = costs[i] + costs[i + 1] - _cost(groups[i] + groups[i + 1])
    marks = np.zeros(len(histograms), np.int64)
    marks[starts[1:]] = 1
    return np.cumsum(marks), np.array(groups)


def _cost(histogram: NDArray[np.int64]) -> float:
    used = np.count_nonzero(histogram)
    return shannon_bits(histogram) + _TABLE_BITS + _SYMBOL_BITS * used
