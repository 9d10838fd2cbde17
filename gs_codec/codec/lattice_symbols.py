"""Passes of a block: the levels of every attribute, their contexts and tokens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.geometry.colour_lattice import code_colours
from gs_codec.kernels import kernel
from gs_codec.lattice.plan import SHIFT_CONTEXTS, energy_class, sh_places
from gs_codec.lattice.shape import ShapeQuantiser
from gs_codec.lattice.tokens import ALPHABET, tokenise


@dataclass(frozen=True)
class PassData:
    """A pass: the token of each symbol ``(n,)``, its context, and the raw bits of some.

    ``raw_levels`` and ``raw_widths`` are of the symbols that have raw bits, in their order.
    """

    tokens: NDArray[np.uint8]
    contexts: NDArray[np.uint16]
    raw_levels: NDArray[np.int64]
    raw_widths: NDArray[np.uint8]

    @classmethod
    def of(cls, levels: NDArray[np.int64], contexts: NDArray[np.integer]) -> PassData:
        """Tokenise levels."""
        tokens, widths = tokenise(levels)
        raw = np.flatnonzero(widths)
        # The same array for all passes of SH-AC, where it is of this type already.
        return cls(tokens, contexts.astype(np.uint16, copy=False), levels[raw], widths[raw])

    def histograms(self, contexts: int) -> NDArray[np.int64]:
        """Counts of tokens ``(contexts, ALPHABET)``."""
        counts = np.zeros((contexts, ALPHABET), np.int64)
        _count(self.tokens, self.contexts, counts)
        return counts


@kernel
def _count(tokens, contexts, counts):
    for i in range(len(tokens)):
        counts[contexts[i], tokens[i]] += 1


def class_passes(shape: NDArray[np.uint8], colour: NDArray[np.uint8]) -> list[PassData]:
    """Passes of the classes; that of colour follows the shape's."""
    alone = PassData.of(shape.astype(np.int64), np.zeros_like(shape))
    return [alone, PassData.of(colour.astype(np.int64), shape)]


def shape_passes(coded: ShapeQuantiser, start: int, stop: int) -> list[PassData]:
    """Passes of opacity, scales and rotation of Gaussians `start` to `stop`."""
    return [
        PassData.of(
            levels[start:stop].astype(np.int64), shift_context(coded.shifts[name][start:stop])
        )
        for name, levels in coded.levels.items()
    ]


def shift_context(shifts: NDArray) -> NDArray:
    """Contexts ``(n,)`` of shifts."""
    return np.minimum(shifts, SHIFT_CONTEXTS - 1)


def dc_pass(
    places: NDArray[np.int64], colours: NDArray[np.int64], unit: int, shifts: NDArray[np.int64]
) -> PassData:
    """The pass of SH-DC: Y, Co, Cg of a Gaussian after the other."""
    levels, contexts, _ = code_colours(places, colours, unit, shifts)
    return PassData.of(levels.T.ravel(), contexts.T.ravel())


def ac_passes(levels: NDArray[np.int64], shifts: NDArray[np.int64]) -> list[PassData]:
    """Passes of SH-AC ``levels (3, K, n)``: energy, then each coefficient where there is any."""
    coefficients = levels.shape[1]
    energy = energy_class(levels.reshape(3 * coefficients, -1))
    listed = [PassData.of(energy, shift_context(shifts))]
    some = np.flatnonzero(energy)
    context = energy[some].astype(np.uint16)
    for _, colour, k in sh_places(coefficients):
        listed.append(PassData.of(levels[colour, k, some], context))
    return listed
