"""Geometry and SH-DC, quantised and put into the order of the stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.entropygs.section import Channel
from gs_codec.coding.morton import canonical_order, encode_morton
from gs_codec.coding.quantise import Quantiser, fit_range, quantise, quantise_positions
from gs_codec.runtime.arrays import current
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Ordered:
    """Geometry and SH-DC of a scene in canonical order, and the order itself.

    Attributes
    ----------
    order : ndarray, shape (N,), int64
        Index in the scene of each Gaussian of the stream.
    codes : ndarray, shape (N,), int64
        Morton codes, ascending.
    cells : ndarray, shape (3, N), uint32
        Quantised positions.
    colours : ndarray, shape (3, N), uint16
        Quantised SH-DC.
    channels : list of Channel
        x, y, z, and f_dc of R, G, B.
    """

    order: NDArray[np.int64]
    codes: NDArray[np.int64]
    cells: NDArray[np.uint32]
    colours: NDArray[np.uint16]
    channels: list[Channel]

    @property
    def depths(self) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
        """Bits of x, y, z and of R, G, B; 0 where constant."""
        quantisers = [channel.quantiser for channel in self.channels]
        return triple_depths(quantisers[:3]), triple_depths(quantisers[3:])


def order_scene(scene: Scene, geometry_depth: int, colour_depth: int) -> Ordered:
    """Quantise geometry and SH-DC and sort by them."""
    positions = [fit_range(row, geometry_depth) for row in scene.positions]
    colours = [fit_range(row, colour_depth) for row in scene.f_dc]
    order, codes, cells, symbols = _sort(scene, positions, colours)
    channels = [
        *(Channel("positions", i, "geometry", q) for i, q in enumerate(positions)),
        *(Channel("f_dc", i, "sh-dc", q) for i, q in enumerate(colours)),
    ]
    keep = current().keep
    codes, cells, symbols = keep(codes[order]), keep(cells[:, order]), keep(symbols[:, order])
    return Ordered(keep(order), codes, cells, symbols, channels)


def order_like(scene: Scene, quantisers: Sequence[Quantiser]) -> NDArray[np.int64]:
    """The order in which `scene` is coded under the quantisers of x, y, z and f_dc."""
    return _sort(scene, quantisers[:3], quantisers[3:])[0]


def triple_depths(quantisers: Sequence[Quantiser]) -> tuple[int, int, int]:
    """Depths of three channels."""
    first, second, third = (quantiser.depth for quantiser in quantisers)
    return first, second, third


def _sort(
    scene: Scene, positions: Sequence[Quantiser], colours: Sequence[Quantiser]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint16]]:
    """Canonical order; and codes, cells and colours in the scene's own order."""
    cells = quantise_positions(scene.positions, positions)
    as_given = np.arange(scene.count)
    symbols = np.stack(
        [quantise(row, q, as_given)[0] for row, q in zip(scene.f_dc, colours, strict=True)]
    )
    codes = encode_morton(cells, triple_depths(positions))
    return canonical_order(codes, *symbols), codes, cells, symbols
