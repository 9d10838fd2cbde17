"""Passes whose contexts depend on the symbols of the two Gaussians before, in stream order.

So no table of a symbol is known before the symbols of those are decoded. FORMAT.md, section
"Passes".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import Following
from gs_codec.codecs.adaptive.tokens import read_token
from gs_codec.coding.context_rans import PassReader
from gs_codec.coding.fields import BitReader
from gs_codec.coding.rans import LANES
from gs_codec.runtime.kernels import kernel


@kernel
def _read(
    words, position, end, states, spans, slots, rows, bits, used,
    bases, steps, fraction, centre, buckets, levels,
):  # fmt: skip
    """Decode `levels`; returns the positions reached in words (-1: too few) and bits."""
    last, before = np.int64(0), np.int64(0)
    limit = len(buckets) - 1
    contexts = buckets[limit] + 1
    for i in range(len(levels)):
        if i & (LANES - 1) == 0 and position > end:
            return -1, used
        index = min(max(((last + before) >> fraction) + centre, 0), limit)
        row = np.uint64(rows[np.uint64(bases[i] * contexts + buckets[np.uint64(index)])])
        level, position, used = read_token(
            words, position, states, i & (LANES - 1), spans[row], slots[row], bits, used
        )
        levels[i] = level
        before, last = last, level * steps[i]
    return position, used


def following_contexts(
    values: NDArray[np.int64], bases: NDArray[np.integer], rule: Following
) -> NDArray[np.int64]:
    """Contexts ``(n,)`` of values ``(n,)``; each base has the contexts of the rule."""
    sums = np.zeros_like(values)
    sums[1:] = values[:-1]
    sums[2:] += values[:-2]
    indices = (sums >> rule.fraction) + rule.centre
    buckets = rule.buckets[np.clip(indices, 0, len(rule.buckets) - 1)]
    return bases * np.int64(rule.contexts) + buckets


def read_following(
    reader: PassReader,
    bits: BitReader,
    rows: NDArray[np.int64],
    bases: NDArray[np.integer],
    steps: NDArray[np.int64],
    rule: Following,
) -> NDArray[np.int64]:
    """Levels ``(n,)`` of a pass, whose tables are ``rows (contexts,)``; values are level * step.

    Raises
    ------
    CorruptStream
        If there are fewer words than symbols.
    """
    levels = np.empty(len(steps), np.int64)
    reader.decode(_read, rows, bits, bases, steps, *rule, levels)
    return levels
