"""Symbols and models of the channels that rANS codes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.entropygs.models import Choice, choose_model
from gs_codec.codecs.entropygs.section import RANS_STREAMS, Channel, channel_order
from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.coding.quantise import Quantiser, fit_centred, fit_range, quantise
from gs_codec.coding.sent_tables import SentModel, encode_tables
from gs_codec.config import Config
from gs_codec.report import ChannelCost, Progress, step_counter
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Coded:
    """The rANS-coded channels of a scene, in canonical order.

    Attributes
    ----------
    channels : list of Channel
        Those that are not constant, in stream order.
    symbols : ndarray, shape (C, N), uint16
    histograms : list of ndarray, shape (2**depth,), int64
    tables : list of FrequencyTable
    costs : list of ChannelCost
    constants : list of Channel
        Those that are constant.
    rectified : int
        SH-AC values moved to the edge of their Laplace range.
    """

    channels: list[Channel]
    symbols: NDArray[np.uint16]
    histograms: list[NDArray[np.int64]]
    tables: list[FrequencyTable]
    costs: list[ChannelCost]
    constants: list[Channel]
    rectified: int


def quantise_and_model(
    scene: Scene, order: NDArray[np.int64], config: Config, progress: Progress | None = None
) -> Coded:
    """Quantise all channels but geometry and SH-DC, in `order`, and choose their models."""
    depths = config.resolved_depths()
    keys = [p for p in channel_order(len(scene.f_rest) // 3) if p[2] in RANS_STREAMS]
    symbols = empty((len(keys), scene.count), np.uint16)

    def work(row: int) -> tuple[Channel, NDArray[np.int64], Choice | None, int]:
        group, index, stream = keys[row]
        quantiser, scale = fit_channel(getattr(scene, group)[index], group, depths[stream])
        symbols[row], histogram, clamped = quantise(getattr(scene, group)[index], quantiser, order)
        channel = Channel(group, index, stream, quantiser)
        if not quantiser.depth:
            return channel, histogram, None, clamped
        choice = choose_model(histogram, scale, sent_table_bytes)
        return replace(channel, model=choice.model), histogram, choice, clamped

    advance = step_counter(progress, "quantise", len(keys))
    results = run_all(work, range(len(keys)), advance=advance)
    return _collect(results, symbols)


def fit_channel(
    values: NDArray[np.float32], group: str, depth: int
) -> tuple[Quantiser, float | None]:
    """Quantiser of a channel ``(N,)``, and the Laplace scale in steps if it is of SH-AC."""
    if group == "f_rest":
        return fit_centred(values, depth)
    return fit_range(values, depth), None


def _collect(
    results: list[tuple[Channel, NDArray[np.int64], Choice | None, int]],
    symbols: NDArray[np.uint16],
) -> Coded:
    rows, channels, histograms, choices = [], [], [], []
    for row, (channel, histogram, choice, _) in enumerate(results):
        if choice is not None:
            rows.append(row)
            channels.append(channel)
            histograms.append(histogram)
            choices.append(choice)
    if len(rows) < len(results):
        varying = empty((len(rows), symbols.shape[1]), symbols.dtype)
        for kept, row in zip(varying, rows, strict=True):
            kept[:] = symbols[row]
        symbols = varying
    return Coded(
        channels=channels,
        symbols=symbols,
        histograms=histograms,
        tables=[choice.table for choice in choices],
        costs=[_cost(*pair) for pair in zip(channels, choices, strict=True)],
        constants=[channel for channel, _, choice, _ in results if choice is None],
        rectified=sum(clamped for *_, clamped in results),
    )


def _cost(channel: Channel, choice: Choice) -> ChannelCost:
    return ChannelCost(
        channel.name,
        channel.stream,
        choice.model.kind,
        choice.bits,
        choice.parametric_bits,
        choice.shannon_bits,
    )


def sent_table_bytes(model: SentModel) -> int:
    """Bytes of one sent table, coded on its own."""
    return 1 + len(encode_tables([model.weights], [model.mantissa]))
