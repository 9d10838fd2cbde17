"""Symbols of an encoder's passes on a device: integers, their contexts and tokens, by torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.blocks import PassData
from gs_codec.codecs.adaptive.contexts import COLOUR_SHIFTS, MEMBERS, SIGNS, SUM_BUCKETS, SUMS
from gs_codec.codecs.adaptive.tokens import ALPHABET, DIRECT, DIRECT_BITS, KEPT_BITS, RAW_WIDTHS
from gs_codec.codecs.cuda.launch import upload
from gs_codec.codecs.cuda.sums import OF_SHARE, OF_SUM
from gs_codec.scene import sh_bands

_OF_COLOUR = SUMS * SIGNS * MEMBERS


@dataclass(frozen=True)
class Symbols:
    """A pass of all blocks: tokens and contexts ``(n,)``, those of a block side by side.

    ``starts (blocks + 1,)`` tell where; ``raw`` has the numbers of the symbols with raw bits, what
    they are and the bits' widths, on the CPU.
    """

    tokens: torch.Tensor
    contexts: torch.Tensor
    starts: NDArray[np.int64]
    raw: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]

    @classmethod
    def of(cls, values: torch.Tensor, contexts: torch.Tensor, counts: NDArray[np.int64]) -> Symbols:
        """Tokenise integers ``(n,)``, of which blocks have ``counts``."""
        tokens = _tokens(values)
        widths = upload(RAW_WIDTHS.astype(np.uint8), values.device)[tokens.int()]
        some = torch.nonzero(widths)[:, 0]
        raw = some.cpu().numpy(), values[some].long().cpu().numpy(), widths[some].cpu().numpy()
        return cls(tokens, contexts.to(torch.int16), np.cumsum([0, *counts]), raw)

    @classmethod
    def of_blocks(cls, blocks: Sequence[PassData], place: torch.device) -> Symbols:
        """A pass that the CPU has made of each block."""
        starts = np.cumsum([0, *(len(block.tokens) for block in blocks)])
        numbers = [each.raw_symbols + at for each, at in zip(blocks, starts, strict=False)]
        levels = np.concatenate([block.raw_levels for block in blocks])
        widths = np.concatenate([block.raw_widths for block in blocks])
        tokens = upload(np.concatenate([block.tokens for block in blocks]), place)
        contexts = np.concatenate([block.contexts for block in blocks]).astype(np.int16)
        return cls(
            tokens, upload(contexts, place), starts, (np.concatenate(numbers), levels, widths)
        )

    def count(self, contexts: int) -> NDArray[np.int64]:
        """How often each token occurs in each context, ``(contexts, ALPHABET)``."""
        place = self.contexts.long() * ALPHABET + self.tokens
        counts = torch.bincount(place, minlength=contexts * ALPHABET)
        return counts.cpu().numpy().reshape(contexts, ALPHABET)

    def raw_of(self, block: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]:
        """Numbers within a block of its symbols with raw bits, what they are, and widths."""
        numbers, levels, widths = self.raw
        own = slice(*np.searchsorted(numbers, self.starts[block : block + 2]))
        return numbers[own] - self.starts[block], levels[own], widths[own]


def _tokens(values: torch.Tensor) -> torch.Tensor:
    """As `tokens.token_of`."""
    sizes = values.abs()
    lengths = torch.frexp(sizes.double())[1]
    kept = (sizes >> (lengths - 1 - KEPT_BITS).clamp(min=0)) & ((1 << KEPT_BITS) - 1)
    large = DIRECT + ((lengths - 1 - DIRECT_BITS) << KEPT_BITS) + kept
    return (2 * torch.where(sizes >= DIRECT, large, sizes) + (values < 0)).to(torch.uint8)


class _Listed:
    """Symbols that some Gaussians have, kind by kind within each block."""

    def __init__(self, block_size: int) -> None:
        self.block_size = block_size
        self.rows: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = []

    def add(self, values: torch.Tensor, contexts: torch.Tensor, some: torch.Tensor) -> None:
        """Append a symbol ``(N,)``, of those Gaussians for which `some` is set."""
        self.rows.append((values.int(), contexts.to(torch.int16), some))

    def symbols(self) -> Symbols:
        values, contexts, some = (torch.stack(each) for each in zip(*self.rows, strict=True))
        blocks = -(-values.shape[1] // self.block_size)
        padding = (0, blocks * self.block_size - values.shape[1])

        def by_block(rows: torch.Tensor) -> torch.Tensor:
            rows = torch.nn.functional.pad(rows, padding)
            return rows.view(len(rows), blocks, self.block_size).transpose(0, 1)

        chosen = by_block(some)
        counts = chosen.sum((1, 2)).cpu().numpy()
        return Symbols.of(by_block(values)[chosen], by_block(contexts)[chosen], counts)


def band_symbols(
    levels: torch.Tensor, ago: torch.Tensor, shifts: torch.Tensor, block_size: int
) -> list[Symbols]:
    """The passes of ``levels (3, K, N)`` of SH-AC, as `sh_ac.code_bands`.

    ``ago (N,)`` has how many Gaussians ago the nearest came, as `surround` gives them.
    """
    count, place = levels.shape[2], levels.device
    buckets = upload(SUM_BUCKETS.astype(np.int64), place)
    everywhere = torch.ones(count, dtype=torch.bool, device=place)
    numbers = torch.arange(count, device=place)

    def bucket(sums: torch.Tensor) -> torch.Tensor:
        return buckets[sums.clamp(max=len(SUM_BUCKETS) - 1)]

    def before(values: torch.Tensor, apart: torch.Tensor | int) -> torch.Tensor:
        """Values of Gaussians so far before in the block, 0 where there are none."""
        there = torch.as_tensor((numbers % block_size >= apart) & (torch.as_tensor(apart) > 0))
        return torch.where(there, values[(numbers - apart).clamp(min=0)], 0)

    bands = [levels[:, band.start : band.stop] for band in sh_bands(levels.shape[1])]
    sizes = [band.abs().sum((0, 1), dtype=torch.int64) for band in bands]
    left = torch.stack(sizes).sum(0)
    coded = []
    for number, (band, share) in enumerate(zip(bands, sizes, strict=True), 1):
        listed, offset = _Listed(block_size), 0
        if number == 1:
            few = shifts.long().clamp(max=COLOUR_SHIFTS - 1)
            total = before(left, 1) + before(left, 2)
            listed.add(left, SUMS * few + bucket(total), everywhere)
            offset = OF_SUM
        if number < len(bands):
            listed.add(share, offset + bucket(left), left > 0)
            left, offset = left - share, offset + OF_SHARE
        rest, members = share, band.shape[1]
        for k in range(3 * members):
            colour, member = divmod(k, members)
            level = band[colour, member]
            signs = level.sign()
            near = before(signs, ago & 255) + before(signs, (ago >> 8) & 255)
            value = signs if k == 3 * members - 1 else level
            context = (SIGNS * bucket(rest) + near.abs()) * MEMBERS
            context = offset + _OF_COLOUR * colour + context + member
            listed.add(torch.where(near < 0, -value, value), context, rest > 0)
            rest = rest - level.abs()
        coded.append(listed.symbols())
    return coded
