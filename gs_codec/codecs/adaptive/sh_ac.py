"""Levels of SH-AC, coefficient by coefficient, as what is left of the sum of a band.

A Gaussian has symbols while something is left, under contexts by what is left and by the signs of
the same coefficient of its two nearest neighbours. FORMAT.md, section "Passes", "SH-AC".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import SIGNS, SUM_BUCKETS
from gs_codec.codecs.adaptive.tokens import flipped, read_token
from gs_codec.coding.context_rans import PassReader
from gs_codec.coding.fields import BitReader
from gs_codec.coding.nearest import Nearest
from gs_codec.coding.rans import LANES
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import inlined, kernel

_LAST_BUCKET = len(SUM_BUCKETS) - 1
_CONTEXTS = (SUM_BUCKETS * SIGNS).astype(np.uint8)


@dataclass
class BandSums:
    """Sums of the magnitudes of a band's levels, as far as they are not coded yet.

    ``left (n,)`` are of all Gaussians; ``live[:count]`` are those of whom something is left.
    ``near (n, 2)`` are the nearest neighbours of each; the number of none is n.
    """

    left: NDArray[np.int32]
    live: NDArray[np.uint32]
    count: int
    near: NDArray[np.uint32]

    @classmethod
    def of(cls, sums: NDArray[np.int64], near: NDArray[np.uint32]) -> BandSums:
        """Before the first coefficient."""
        live = np.flatnonzero(sums > 0).astype(np.uint32)
        return cls(sums.astype(np.int32), live, len(live), near)

    def copy(self) -> BandSums:
        """The same, not to change with this one."""
        return BandSums(self.left.copy(), self.live.copy(), self.count, self.near)


def two_nearest(nearest: Nearest) -> NDArray[np.uint32]:
    """The two nearest neighbours ``(n, 2)``; the number of none is n."""
    near = nearest.near[:, :2].astype(np.uint32)
    # The first Gaussian has no neighbour, the second has one.
    near[:1] = near[1:2, 1] = len(near)
    return near


@inlined
def _sign(value):
    return np.int64(value > 0) - np.int64(value < 0)


@inlined
def _sum_of_signs(signs, near, i):
    return np.int64(signs[near[i, 0]]) + np.int64(signs[near[i, 1]])


@inlined
def _context(left, sign):
    return np.int64(_CONTEXTS[np.uint64(min(left, _LAST_BUCKET))]) + abs(sign)


@kernel
def _code(levels, near, signs, last, left, live, count, coded, contexts):
    """Fill `coded` and `contexts`, one for each live Gaussian; returns how many stay so."""
    kept = 0
    signs[:] = 0
    for j in range(count):
        i = live[j]
        sign = _sum_of_signs(signs, near, i)
        contexts[j] = _context(np.int64(left[i]), sign)
        level = np.int64(levels[i])
        signs[i] = _sign(level)
        coded[j] = flipped(_sign(level) if last else level, sign >> 63)
        left[i] -= abs(level)
        live[kept] = i
        kept += np.int64(left[i] > 0)
    return kept


@kernel
def _read(
    words, position, end, states, spans, slots, rows, bits, used,
    near, signs, last, left, live, count, levels,
):  # fmt: skip
    """Decode `levels` of the live Gaussians; `signs` are scratch memory.

    Returns the positions reached in words (-1: too few) and bits, and how many Gaussians stay
    live; -1 if a level exceeds what was left.
    """
    kept = 0
    signs[:] = 0
    for j in range(count):
        if j & (LANES - 1) == 0 and position > end:
            return -1, used, 0
        i = np.uint64(live[np.uint64(j)])
        rest = np.int64(left[i])
        sign = _sum_of_signs(signs, near, i)
        row = np.uint64(rows[np.uint64(_context(rest, sign))])
        level, position, used = read_token(
            words, position, states, j & (LANES - 1), spans[row], slots[row], bits, used
        )
        if last:
            if abs(level) != 1:
                return position, used, -1
            level *= rest
        rest -= abs(level)
        if rest < 0:
            return position, used, -1
        level = flipped(level, sign >> 63)
        levels[i] = level
        signs[i] = _sign(level)
        left[i] = rest
        live[np.uint64(kept)] = i
        kept += np.int64(rest > 0)
    return position, used, kept


def code_coefficient(
    levels: NDArray[np.int32], sums: BandSums, last: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Integers to code, and their contexts, of levels ``(n,)``; the sums become what is left.

    Parameters
    ----------
    levels : ndarray, shape (n,)
    sums : BandSums
    last : bool
        Whether it is the last coefficient of its band, which takes all that is left.
    """
    coded, contexts = np.empty((2, sums.count), np.int64)
    signs = np.empty(len(levels) + 1, np.int8)
    sums.count = _code(
        levels, sums.near, signs, last, sums.left, sums.live, sums.count, coded, contexts
    )
    return coded, contexts


def read_coefficient(
    reader: PassReader,
    bits: BitReader,
    rows: NDArray[np.int64],
    sums: BandSums,
    last: bool,
    levels: NDArray[np.int32],
) -> None:
    """The inverse of `code_coefficient`, by tables ``rows (contexts,)``, into ``levels (n,)``.

    Levels must be 0 before.

    Raises
    ------
    CorruptStream
        If there are fewer words than symbols, or a level exceeds what was left of its sum.
    """
    signs = np.empty(len(levels) + 1, np.int8)
    remaining = (sums.left, sums.live, sums.count)
    [kept] = reader.decode(_read, rows, bits, sums.near, signs, last, *remaining, levels)
    if kept < 0:
        raise CorruptStream(f"{reader.where}: a level of SH-AC beyond its sum")
    sums.count = kept
