"""Bits and step sizes of each Gaussian of profiles ``l``, ``m`` and ``s``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.colour import code_colours
from gs_codec.codecs.adaptive.decode import Blocks, DecodedBlock
from gs_codec.codecs.adaptive.lattice import cell_sides, to_float
from gs_codec.codecs.adaptive.rotation import TURNS
from gs_codec.codecs.adaptive.section import FAR_BYTES
from gs_codec.codecs.adaptive.sh_ac import code_bands, two_nearest
from gs_codec.codecs.adaptive.shape import shape_pass, walk_shape
from gs_codec.codecs.adaptive.tokens import RAW_WIDTHS, token_of
from gs_codec.coding.context_rans import PRECISION, SPAN_BITS
from gs_codec.config import SH_STREAMS
from gs_codec.egs.egs_file import EgsFile
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all

_LOW_BITS = "low-bits"
_FAR = "far"


@dataclass(frozen=True)
class BlockCosts:
    """Bits and step sizes of the Gaussians of a block.

    Attributes
    ----------
    bits : dict of str to ndarray, shape (n,), float64
        Code length of a Gaussian's own symbols, by stream. For positions, only ``low-bits`` counts:
        the bits of ``geometry`` are shared by several Gaussians.
    steps : dict of str to ndarray, shape (k, n), float64
        Step sizes by stream, in the attribute's own domain: sides of a cell along x, y and z
        (``geometry``; 0 for far Gaussians), logit, log-scale (the longest, and the differences of
        the next two), sine of half an angle (roll and two tilts), SH (the same for Y, Co and Cg;
        in a local basis, before the factors of components).
    """

    bits: dict[str, NDArray[np.float64]]
    steps: dict[str, NDArray[np.float64]]


@kernel
def _add(spans, rows, values, contexts, owners, cycle, costs):
    """Add the bits of values (tokens and raw bits) to ``costs (streams, n)``."""
    for symbol in range(len(values)):
        token = token_of(np.int64(values[symbol]))
        row = np.int64(rows[contexts[symbol]])
        frequency = np.int64(spans[(row << SPAN_BITS) + token]) & 0xFFFF
        stream = cycle[symbol % len(cycle)]
        costs[stream, owners[symbol]] += PRECISION - np.log2(frequency) + RAW_WIDTHS[token]


def block_costs(blocks: Blocks, number: int) -> BlockCosts:
    """Decode block `number`; return the bits and step sizes of its Gaussians.

    Raises CorruptStream or TruncatedStream.
    """
    found = blocks.read(number)
    coded, shifts = _coded_again(blocks, found)
    bits = {_LOW_BITS: found.low_bits.astype(np.float64)}
    if found.far.size:
        bits[_FAR] = np.zeros(len(found.shifts))
        bits[_FAR][-found.far.shape[1] :] = 8 * FAR_BYTES
    for item, rows, symbols in zip(blocks.passes, blocks.rows, coded, strict=True):
        values, contexts, owners = symbols
        costs = np.zeros((len(item.streams), len(found.shifts)))
        _add(blocks.tables.spans, rows, values.ravel(), contexts.ravel(), owners, item.cycle, costs)
        bits |= zip(item.streams, costs, strict=True)
    return BlockCosts(bits, _steps(blocks, found, shifts))


def gaussian_classes(file: EgsFile) -> NDArray[np.uint8]:
    """Shape and colour class of each Gaussian ``(2, N)``, in stream order.

    A class counts octaves of step size above the finest. Raises CorruptStream or TruncatedStream.
    """
    blocks, classes = Blocks(file, 0), np.zeros((2, file.header.count), np.uint8)

    def work(number: int) -> None:
        classes[:, slice(*file.header.block_range(number))] = blocks.read(number).classes

    run_all(work, range(file.header.block_count))
    return classes


#: Integers of a pass, their contexts, and their owners, each ``(symbols,)``.
_Symbols = tuple[NDArray[Any], NDArray[np.uint16], NDArray[np.integer]]


def _coded_again(
    blocks: Blocks, found: DecodedBlock
) -> tuple[list[_Symbols], dict[str, NDArray[np.int64]]]:
    """Re-encode a decoded block: the symbols of each pass, and the shifts of its shapes."""
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
    values, contexts = shape_pass(found.classes, levels, by_name, lattice.units)
    unit, every = lattice.units["sh-dc"], np.arange(len(found.shifts))
    levels_dc, contexts_dc, _ = code_colours(found.nearest, found.colours, unit, found.shifts)
    ac = code_bands(found.levels, two_nearest(found.nearest), found.shifts, owned=True)
    shapes: _Symbols = values.ravel(), contexts.ravel(), every.repeat(9)
    return [shapes, (levels_dc.ravel(), contexts_dc.ravel(), every.repeat(3)), *ac], by_name


def _steps(
    blocks: Blocks, found: DecodedBlock, shifts: dict[str, NDArray[np.int64]]
) -> dict[str, NDArray[np.float64]]:
    """Compute `BlockCosts.steps` of a decoded block."""
    units = blocks.lattice.units
    groups = {
        "opacity": ("opacity",),
        "scaling": ("scale_0", "scale_1", "scale_2"),
        "rotation": TURNS,
    }
    steps = {"geometry": cell_sides(found.dropped, blocks.lattice.grid)}
    steps["geometry"][:, len(found.shifts) - found.far.shape[1] :] = 0
    for stream, names in groups.items():
        steps[stream] = to_float(units[stream] << np.stack([shifts[name] for name in names]))
    for stream in ("sh-dc", *SH_STREAMS[: len(blocks.bands)]):
        steps[stream] = to_float(units[stream] << found.shifts)[None]
    return steps
