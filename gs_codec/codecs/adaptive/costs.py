"""What each Gaussian of profiles ``l``, ``m`` and ``s`` takes: the information of its symbols."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.colour import code_colours
from gs_codec.codecs.adaptive.decode import Blocks, DecodedBlock
from gs_codec.codecs.adaptive.rotation import TURNS
from gs_codec.codecs.adaptive.sh_ac import code_bands, two_nearest
from gs_codec.codecs.adaptive.shape import shape_pass, walk_shape
from gs_codec.codecs.adaptive.tokens import RAW_WIDTHS, token_of
from gs_codec.coding.context_rans import PRECISION, SPAN_BITS
from gs_codec.egs.file import EgsFile
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all


@kernel
def _add(spans, rows, values, contexts, counts, costs):
    """Add the bits of values, ``counts[i]`` for each: of tokens by the tables, and raw ones."""
    symbol = 0
    for i in range(len(costs)):
        for _ in range(counts[i]):
            token = token_of(np.int64(values[symbol]))
            frequency = (
                np.int64(spans[(np.int64(rows[contexts[symbol]]) << SPAN_BITS) + token]) & 0xFFFF
            )
            costs[i] += PRECISION - np.log2(frequency) + RAW_WIDTHS[token]
            symbol += 1


def symbol_bits(file: EgsFile) -> NDArray[np.float64]:
    """Bits of the symbols of each Gaussian ``(N,)``, without those of positions.

    Raises
    ------
    CorruptStream, TruncatedStream
    """
    blocks, costs = Blocks(file, file.header.sh_degree), np.zeros(file.header.count)

    def work(number: int) -> None:
        own = costs[slice(*file.header.block_range(number))]
        coded = _coded_again(blocks, blocks.read(number))
        for rows, (values, contexts, counts) in zip(blocks.rows, coded, strict=True):
            _add(blocks.tables.spans, rows, values.ravel(), contexts.ravel(), counts, own)

    run_all(work, range(file.header.block_count))
    return costs


def _coded_again(
    blocks: Blocks, found: DecodedBlock
) -> list[tuple[NDArray[np.integer], NDArray[np.uint16], NDArray[np.uint8]]]:
    """Integers, contexts and symbols of each Gaussian, of each pass of a decoded block."""
    lattice, shape = blocks.lattice, found.shape
    levels: dict[str, NDArray[np.int64]] = {}
    by_name: dict[str, NDArray[np.int64]] = {}
    fixed = {
        "opacity": shape.opacity - lattice.centres[0],
        "scale_0": shape.scales[0] - lattice.centres[1],
        "scale_1": shape.scales[0] - shape.scales[1],
        "scale_2": shape.scales[1] - shape.scales[2],
        **dict(zip(TURNS, shape.turns, strict=True)),
    }

    def known(name: str, shifts: NDArray[np.int64], unit: int, _: object) -> NDArray[np.int64]:
        levels[name], by_name[name] = fixed[name] // (unit << shifts), shifts
        return levels[name]

    walk_shape(lattice, found.classes[0], known)
    shapes = shape_pass(found.classes, levels, by_name, lattice.units)
    unit = lattice.units["sh-dc"]
    dc = code_colours(found.nearest, found.colours, unit, found.shifts)[:2]
    ac = code_bands(found.levels, two_nearest(found.nearest), found.shifts)
    every = np.ones(len(found.shifts), np.uint8)
    return [(*shapes, 9 * every), (*dc, 3 * every), *ac]
