"""Bits and step sizes of each Gaussian of a file."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive import costs as adaptive
from gs_codec.codecs.adaptive.decode import Blocks
from gs_codec.codecs.entropygs.section import channels_of
from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS
from gs_codec.egs.egs_file import SCENE_SECTIONS, EgsFile, section_label
from gs_codec.runtime.threads import run_all, using_threads


@dataclass(frozen=True)
class StreamBits:
    """Bits of a Gaussian in one stream.

    Attributes
    ----------
    name : str
        Name, as in `Info.streams`.
    bits : float
    shared : {"", "block", "file"}
        Empty if the bits are proportional to the code length of the Gaussian's own symbols; else
        they are an equal share of the stream's bits in the block, or in the file.
    """

    name: str
    bits: float
    shared: Literal["", "block", "file"]


@dataclass(frozen=True)
class CodedGaussian:
    """How a file codes one Gaussian.

    Attributes
    ----------
    block : int
        Number of its block.
    streams : tuple of StreamBits
        In the order of `Info.streams`; the sum over all Gaussians is the size of the stream.
    steps : dict of str to tuple of float
        Step sizes by stream, one for all of its channels or one for each; empty for `lossless`. For
        profiles `l`, `m` and `s` as in `BlockCosts`; otherwise those of the stored channels.
    """

    block: int
    streams: tuple[StreamBits, ...]
    steps: dict[str, tuple[float, ...]]


class _Costs:
    """Bits of the Gaussians of a file, block by block."""

    def __init__(self, file: EgsFile) -> None:
        self.file = file
        count = max(file.header.count, 1)
        self.once = defaultdict(float, {"header": 8 * file.header_size / count})
        self.by_block = [defaultdict[str, float](float) for _ in range(file.header.block_count)]
        self.names = ["header"]
        for (section, block), size in sorted(file.sizes.items()):
            name = section_label(section)
            if section in SCENE_SECTIONS or block >= len(self.by_block):
                self.once[name] += 8 * size / count
            else:
                self.by_block[block][name] += 8 * size
            if name != self.names[-1]:
                self.names.append(name)

    @cached_property
    def _blocks(self) -> Blocks:
        return Blocks(self.file, self.file.header.sh_degree)

    def block(self, number: int) -> adaptive.BlockCosts:
        """Own bits and step sizes of the Gaussians of a block; empty if they have none."""
        if self.file.header.profile not in ADAPTIVE_PROFILES:
            return adaptive.BlockCosts({}, {})
        return adaptive.block_costs(self._blocks, number)

    def streams(
        self, number: int, own: dict[str, NDArray[np.float64]]
    ) -> dict[str, NDArray[np.float64]]:
        """Bits ``(n,)`` of the Gaussians of a block in all of its streams.

        A stream's bits are shared in proportion to the code lengths of its symbols, if there are
        any.
        """
        start, stop = self.file.header.block_range(number)
        bits = {}
        for name, size in self.by_block[number].items():
            known = own.get(name)
            if known is None or not known.any():
                known = np.ones(stop - start)
            bits[name] = known * (size / known.sum())
        return bits


def gaussian_bits(file: EgsFile) -> NDArray[np.float64]:
    """Bits of each Gaussian ``(N,)`` of a valid file, in stream order; their sum is the file's.

    With profiles `l`, `m` and `s`, the bits of streams are shared in proportion to the code lengths
    of a Gaussian's own symbols, and the common bits of a block (most of the position bits) equally.
    With other profiles, each Gaussian has the mean bits of its block. Sections of the whole file
    are shared by all Gaussians. Raises CorruptStream or TruncatedStream.
    """
    header, costs = file.header, _Costs(file)
    bits = np.full(header.count, sum(costs.once.values()))

    def work(number: int) -> None:
        own = bits[slice(*header.block_range(number))]
        for each in costs.streams(number, costs.block(number).bits).values():
            own += each

    with using_threads(None, header.count):
        run_all(work, range(header.block_count))
    return bits


def describe_gaussian(file: EgsFile, index: int) -> CodedGaussian:
    """How a file codes a Gaussian, by its index in stream order.

    The sections in `DESCRIPTIONS` must have been read; only the block of the Gaussian is decoded.
    Raises CorruptStream or TruncatedStream.
    """
    block = index // file.header.block_size
    place = index - file.header.block_range(block)[0]
    costs = _Costs(file.read(lambda _, number: number == block))
    found = costs.block(block)
    in_block = costs.streams(block, found.bits)
    streams = []
    for name in costs.names:
        if name in costs.once:
            streams.append(StreamBits(name, costs.once[name], "file"))
        if name in in_block:
            shared: Literal["", "block"] = "" if name in found.bits else "block"
            streams.append(StreamBits(name, float(in_block[name][place]), shared))
    steps = {name: tuple(rows[:, place].tolist()) for name, rows in found.steps.items()}
    return CodedGaussian(block, tuple(streams), steps or _channel_steps(file))


def _channel_steps(file: EgsFile) -> dict[str, tuple[float, ...]]:
    """Step sizes of the channels of a `paper` profile, by stream."""
    steps: dict[str, tuple[float, ...]] = {}
    if file.header.profile != LOSSLESS:
        for channel in channels_of(file):
            steps[channel.stream] = (*steps.get(channel.stream, ()), channel.quantiser.step)
    return steps
