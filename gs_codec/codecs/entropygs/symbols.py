"""Symbols of a scene in stream order, and models of the rANS-coded ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.entropygs.models import Choice, choose_model
from gs_codec.codecs.entropygs.section import RANS_STREAMS, Channel, channel_order
from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.coding.morton import canonical_order, encode_morton
from gs_codec.coding.quantise import (
    Quantiser,
    fit_centred,
    fit_range,
    quantise,
    quantise_positions,
)
from gs_codec.config import Config
from gs_codec.report import ChannelCost, Progress, step_counter
from gs_codec.runtime.arrays import current, empty
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Ordered:
    """Geometry and SH-DC of a scene in canonical order, and the order itself.

    Attributes
    ----------
    order : ndarray, shape (N,), int64
        Index in the scene of each Gaussian, in stream order.
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


def order_scene(scene: Scene, depths: Mapping[str, int]) -> Ordered:
    """Quantise geometry and SH-DC and sort by them; `depths` are those of a paper profile."""
    channels = [
        Channel(group, index, stream, fit_range(getattr(scene, group)[index], depths[stream]))
        for group, index, stream in channel_order(0)[:6]
    ]
    order, codes, cells, colours = _sort(scene, [channel.quantiser for channel in channels])
    keep = current().keep
    codes, cells, colours = keep(codes[order]), keep(cells[:, order]), keep(colours[:, order])
    return Ordered(keep(order), codes, cells, colours, channels)


def order_like(scene: Scene, quantisers: Sequence[Quantiser]) -> NDArray[np.int64]:
    """The order in which `scene` is coded with the quantisers of x, y, z and f_dc."""
    return _sort(scene, quantisers)[0]


def triple_depths(quantisers: Sequence[Quantiser]) -> tuple[int, int, int]:
    """Depths of three channels."""
    first, second, third = (quantiser.depth for quantiser in quantisers)
    return first, second, third


def _sort(
    scene: Scene, quantisers: Sequence[Quantiser]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint16]]:
    """Canonical order; codes, cells and colours in the scene's own order."""
    cells = quantise_positions(scene.positions, quantisers[:3])
    as_given = np.arange(scene.count)
    pairs = zip(scene.f_dc, quantisers[3:], strict=True)
    colours = np.stack([quantise(row, quantiser, as_given)[0] for row, quantiser in pairs])
    codes = encode_morton(cells, triple_depths(quantisers[:3]))
    return canonical_order(codes, *colours), codes, cells, colours


@dataclass(frozen=True)
class Coded:
    """The rANS-coded channels, with their symbols in canonical order.

    Attributes
    ----------
    channels : list of Channel
        All channels, in stream order; those without a model are constant.
    symbols : ndarray, shape (C, N), uint16
        Symbols of the varying channels, like `tables` and `costs`.
    tables : list of FrequencyTable
    costs : list of ChannelCost
    rectified : int
        Number of SH-AC values clamped to their Laplace range.
    """

    channels: list[Channel]
    symbols: NDArray[np.uint16]
    tables: list[FrequencyTable]
    costs: list[ChannelCost]
    rectified: int

    @property
    def streams(self) -> dict[str, list[int]]:
        """Rows of `symbols` by their stream, in stream order."""
        streams: dict[str, list[int]] = {}
        for row, cost in enumerate(self.costs):
            streams.setdefault(cost.stream, []).append(row)
        return streams


def quantise_and_model(
    scene: Scene, order: NDArray[np.int64], config: Config, progress: Progress | None = None
) -> Coded:
    """Quantise all channels except geometry and SH-DC, in `order`, and choose their models."""
    depths = config.resolved_depths()

    def fit(key: tuple[str, int, str]) -> tuple[Channel, float | None]:
        group, index, stream = key
        quantiser, scale = fit_channel(
            getattr(scene, group)[index], group, depths[stream], config.laplace_scales
        )
        return Channel(group, index, stream, quantiser), scale

    keys = [key for key in channel_order(len(scene.f_rest) // 3) if key[2] in RANS_STREAMS]
    fitted = run_all(fit, keys)
    varying = [row for row, (channel, _) in enumerate(fitted) if channel.quantiser.depth]
    symbols = empty((len(varying), scene.count), np.uint16)

    def work(row: int) -> tuple[Choice, int]:
        channel, scale = fitted[varying[row]]
        values = getattr(scene, channel.group)[channel.index]
        symbols[row], histogram, clamped = quantise(values, channel.quantiser, order)
        return choose_model(histogram, scale, config.models), clamped

    advance = step_counter(progress, "quantise", len(varying))
    results = run_all(work, range(len(varying)), advance=advance)
    channels = [channel for channel, _ in fitted]
    costs = []
    for row, (choice, _) in zip(varying, results, strict=True):
        channels[row] = replace(channels[row], model=choice.model)
        costs.append(_cost(channels[row], choice))
    tables = [choice.table for choice, _ in results]
    return Coded(channels, symbols, tables, costs, sum(clamped for _, clamped in results))


def fit_channel(
    values: NDArray[np.float32], group: str, depth: int, laplace_scales: float | None = None
) -> tuple[Quantiser, float | None]:
    """Quantiser of a channel ``(N,)``, and for SH-AC its Laplace scale in steps."""
    if group == "f_rest":
        return fit_centred(values, depth, laplace_scales)
    return fit_range(values, depth), None


def _cost(channel: Channel, choice: Choice) -> ChannelCost:
    return ChannelCost(
        channel.name,
        channel.stream,
        choice.model.kind,
        choice.bits,
        choice.parametric_bits,
        choice.shannon_bits,
    )
