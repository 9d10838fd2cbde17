"""Levels of SH-AC, coefficient by coefficient, given the sum of magnitudes of a band.

Each level is subtracted from that sum, and a Gaussian has symbols until the remaining sum is 0. The
context of a symbol is the remaining sum, and the signs of the same coefficient of the two nearest
neighbours. Symbols of one coefficient hardly depend on one another, so a processor decodes several
at a time. FORMAT.md, section "Passes", "SH-AC".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import COLOUR_SHIFTS, MEMBERS, SIGNS, SUMS, sum_bucket
from gs_codec.codecs.adaptive.tokens import flipped, read_token
from gs_codec.coding.context_rans import BAD_SUM, MORE_BITS, OUT_OF_WORDS, PassReader
from gs_codec.coding.nearest import Nearest
from gs_codec.coding.rans import LANES
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import sh_bands

#: Number of contexts for the sum of all bands, which come first in the first pass.
_OF_SUM = COLOUR_SHIFTS * SUMS

#: Number of contexts for a band's share, which come next unless the band is the last.
_OF_SHARE = SUMS

#: Number of contexts for the levels of a colour.
_OF_COLOUR = SUMS * SIGNS * MEMBERS


def two_nearest(nearest: Nearest) -> NDArray[np.uint8]:
    """Distances back to each Gaussian's two nearest neighbours, ``(n, 2)``; 0 for none."""
    ago = (np.arange(len(nearest.near))[:, None] - nearest.near[:, :2]).astype(np.uint8)
    # The second Gaussian has only one neighbour.
    ago[1:2, 1] = 0
    return ago


@inlined
def _sign(value):
    return np.int64(value > 0) - np.int64(value < 0)


@inlined
def _sum_of_signs(signs, near, i):
    # A distance of 0 refers to the Gaussian itself, whose sign is still 0.
    first, second = np.uint64(i) - np.uint64(near[i, 0]), np.uint64(i) - np.uint64(near[i, 1])
    return np.int64(signs[first]) + np.int64(signs[second])


@inlined
def _context(left, sign):
    """Context of a coefficient, before adding its index in the band."""
    return (SIGNS * sum_bucket(left) + abs(sign)) * MEMBERS


@kernel
def _code(levels, near, shifts, first, last, left, shares, values, contexts, owners):
    """Fill `values`, `contexts` and, unless None, `owners`; return the number of symbols."""
    count, members = len(left), levels.shape[1]
    symbol, offset = 0, 0
    if first:
        before = previous = np.int64(0)
        for i in range(count):
            context = SUMS * min(shifts[i], COLOUR_SHIFTS - 1) + sum_bucket(previous + before)
            values[symbol], contexts[symbol] = left[i], context
            if owners is not None:
                owners[symbol] = i
            symbol += 1
            before, previous = previous, left[i]
        offset = _OF_SUM
    if not last:
        for i in range(count):
            if left[i] > 0:
                values[symbol], contexts[symbol] = shares[i], offset + sum_bucket(left[i])
                if owners is not None:
                    owners[symbol] = i
                symbol += 1
            left[i] -= shares[i]
        offset += _OF_SHARE
    signs = np.empty(count, np.int8)
    for k in range(3 * members):
        colour, place = k // members, k % members
        signs[:] = 0
        for i in range(count):
            rest = shares[i]
            if rest == 0:
                continue
            sign = _sum_of_signs(signs, near, i)
            level = np.int64(levels[colour, place, i])
            signs[i] = _sign(level)
            shares[i] = rest - abs(level)
            if k == 3 * members - 1:
                level = _sign(level)
            values[symbol] = flipped(level, sign >> 63)
            contexts[symbol] = offset + _OF_COLOUR * colour + _context(rest, sign) + place
            if owners is not None:
                owners[symbol] = i
            symbol += 1
    return symbol


@inlined
def _read_sums(
    words, end, states, spans, slots, rows, bits, limit, shifts, sums
):  # fmt: skip
    """Decode the sums of all bands, first in a pass; return a fault and the positions reached."""
    position = used = before = previous = np.int64(0)
    for i in range(len(sums)):
        if position > end or used > limit:
            return OUT_OF_WORDS, position, used
        context = SUMS * min(shifts[i], COLOUR_SHIFTS - 1) + sum_bucket(previous + before)
        row = rows[np.uint64(context)]
        sums[i], position, used = read_token(
            words, position, states, i, spans, slots, row, bits, used, True
        )
        if sums[i] < 0:
            return BAD_SUM, position, used
        before, previous = previous, sums[i]
    return 0, position, used


@inlined
def _read_shares(
    words, end, states, spans, slots, rows, bits, limit, symbol, position, used, offset,
    left, shares,
):  # fmt: skip
    """Decode a band's shares of the remaining sums; return a fault, next symbol and positions."""
    for i in range(len(left)):
        shares[i] = 0
        if left[i] == 0:
            continue
        if position > end or used > limit:
            return OUT_OF_WORDS, symbol, position, used
        row = rows[np.uint64(offset + sum_bucket(left[i]))]
        share, position, used = read_token(
            words, position, states, symbol, spans, slots, row, bits, used, True
        )
        symbol += 1
        if not 0 <= share <= left[i]:
            return BAD_SUM, symbol, position, used
        shares[i] = share
        left[i] -= share
    return 0, symbol, position, used


@kernel
def _read(
    words, ends, states, spans, slots, rows, bits, reached,
    near, shifts, first, last, left, levels,
):  # fmt: skip
    """Decode ``levels (3, k, n)``, initially 0; `left` becomes the sum left for later bands."""
    count, members = len(left), levels.shape[1]
    end, limit = ends[0], 8 * (len(bits) - MORE_BITS)
    fault, symbol, position, used, offset = 0, 0, np.int64(0), np.int64(0), 0
    if first:
        fault, position, used = _read_sums(
            words, end, states, spans, slots, rows, bits, limit, shifts, left
        )
        symbol, offset = count, _OF_SUM
    shares = left.astype(np.int32)
    if not last and fault == 0:
        fault, symbol, position, used = _read_shares(
            words, end, states, spans, slots, rows, bits, limit, symbol, position, used, offset,
            left, shares,
        )  # fmt: skip
        offset += _OF_SHARE
    if fault != 0:
        return fault
    live, lives = np.empty(count, np.uint16), 0
    for i in range(count):
        live[np.uint64(lives)] = i
        lives += np.int64(shares[i] > 0)
    signs = np.empty(count, np.int8)
    for k in range(3 * members):
        colour, place = k // members, k % members
        plane = levels[colour, place]
        begin = offset + _OF_COLOUR * colour + place
        signs[:] = 0
        kept = 0
        for j in range(lives):
            if symbol & (LANES - 1) == 0 and (position > end or used > limit):
                return OUT_OF_WORDS
            i = np.uint64(live[np.uint64(j)])
            rest = np.int64(shares[i])
            sign = _sum_of_signs(signs, near, i)
            row = rows[np.uint64(begin + _context(rest, sign))]
            level, position, used = read_token(
                words, position, states, symbol, spans, slots, row, bits, used, True
            )
            symbol += 1
            if k == 3 * members - 1:
                # A sign; any other value exceeds the remaining sum.
                level = level * rest if abs(level) == 1 else rest + 1
            rest -= abs(level)
            if rest < 0:
                return BAD_SUM
            level = flipped(level, sign >> 63)
            plane[i] = level
            signs[i] = _sign(level)
            shares[i] = rest
            live[np.uint64(kept)] = i
            kept += np.int64(rest > 0)
        lives = kept
    reached[0, 0], reached[1, 0] = position, used
    return 0


def code_bands(
    levels: NDArray[np.int32],
    near: NDArray[np.uint8],
    shifts: NDArray[np.int64],
    owned: bool = False,
) -> list[tuple[NDArray[np.int64], NDArray[np.uint16], NDArray[np.int64]]]:
    """Integers to code, their contexts and their owners, each ``(symbols,)``, for each band.

    Parameters
    ----------
    levels : ndarray, shape (3, K, n)
    near : ndarray, shape (n, 2)
        Result of `two_nearest`.
    shifts : ndarray, shape (n,)
        Shifts of the colours' step sizes.
    owned : bool
        Whether to return the Gaussian that each symbol belongs to; otherwise owners are empty.
    """
    bands = [levels[:, band.start : band.stop] for band in sh_bands(levels.shape[1])]
    shares = [np.abs(band).sum(axis=(0, 1), dtype=np.int64) for band in bands]
    left = np.sum(shares, axis=0)
    coded = []
    for number, (band, share) in enumerate(zip(bands, shares, strict=True), 1):
        most = len(left) * (2 + band.shape[0] * band.shape[1])
        values, contexts = np.empty(most, np.int64), np.empty(most, np.uint16)
        owners = np.empty(most if owned else 0, np.int64)
        ends = number == 1, number == len(bands)
        # None is known at compile time, so encoders avoid a branch for each symbol.
        known_owners = owners if owned else None
        found = _code(band, near, shifts, *ends, left, share, values, contexts, known_owners)
        coded.append((values[:found], contexts[:found], owners[:found]))
    return coded


def read_bands(
    reader: PassReader,
    sections: Sequence[memoryview],
    rows: Sequence[NDArray[np.uint16]],
    levels: NDArray[np.int32],
    near: NDArray[np.uint8],
    shifts: NDArray[np.int64],
) -> None:
    """Invert `code_bands`, writing to ``levels (3, K, n)``, initially 0.

    `rows` has the table numbers ``(contexts,)`` of each band of the scene; K may cover fewer bands.
    Raises TruncatedStream or CorruptStream.
    """
    left = np.zeros(len(shifts), np.int64)
    for number, band in enumerate(sh_bands(levels.shape[1]), 1):
        ends = number == 1, number == len(rows)
        plane = levels[:, band.start : band.stop]
        arguments = (near, shifts, *ends, left, plane)
        reader.decode(sections[number - 1 : number], _read, rows[number - 1], *arguments)
