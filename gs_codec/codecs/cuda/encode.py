"""Profiles ``l``, ``m`` and ``s`` on a device: scene to stream, to the bytes of the CPU's encoder.

The device rounds colours, counts tokens and codes passes, a warp for a block. Before, the CPU
chooses lattices, sorts the Gaussians, rounds their shapes and codes the trees of their positions;
it chooses the tables, packs raw bits and puts the file together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged
from gs_codec.codecs.adaptive.blocks import ShapedBlock
from gs_codec.codecs.adaptive.contexts import Pass, passes
from gs_codec.codecs.adaptive.encode import (
    assemble,
    choose_models,
    leading_sections,
    shape_scene,
)
from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, LARGEST
from gs_codec.codecs.cuda.lanes import WIDTH
from gs_codec.codecs.cuda.launch import argument, for_each, unsigned, upload, working_on
from gs_codec.codecs.cuda.places import surround
from gs_codec.codecs.cuda.pushes import push_pass
from gs_codec.codecs.cuda.rounding import find_shares, round_colours, round_diffusing
from gs_codec.codecs.cuda.symbols import Symbols, band_symbols
from gs_codec.coding.context_rans import PassTables, stream_bytes
from gs_codec.coding.rans import LANES, LOWEST
from gs_codec.coding.ycocg import GREEN, LUMA, ORANGE
from gs_codec.config import SH_STREAMS, Config
from gs_codec.egs.file import Section, SectionId
from gs_codec.egs.header import Header
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, sh_bands

_ONE = float(1 << FRACTION_BITS)


def encode_on_device(
    scene: Scene, config: Config, device: str, times: StageTimes, progress: Progress | None = None
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene cleaned by `clean_scene`, of at least one Gaussian, as `encode_adaptive`."""
    shaped = shape_scene(scene, config, None, times, progress)
    header, arranged = shaped.header, shaped.arranged
    listed = passes(len(scene.f_rest) // 3)
    with working_on(device) as place:
        with times.stage("quantise"):
            coder = _Encoder(header, arranged, shaped.blocks, place)
        with times.stage("model"):
            counted = []
            for item, symbols in zip(listed, coder.symbols, strict=True):
                sizes = [each.contexts for each in item.lists]
                counted += np.split(symbols.count(sum(sizes)), np.cumsum(sizes)[:-1])
            models, tables, costs = choose_models(listed, counted)
        with times.stage("code"):
            rows = [models.rows(item) for item in listed]
            coded = coder.code(listed, rows, PassTables.pack(tables))
    extents = run_all(lambda block: block.extent(arranged.lattice.grid), shaped.blocks)
    found = models, costs, coded, coder.clamped
    return assemble(header, arranged, extents, *found, times)


class _Encoder:
    """Rounds the colours of shaped blocks, and has the symbols of all passes."""

    def __init__(
        self, header: Header, arranged: Arranged, shaped: list[ShapedBlock], place: torch.device
    ) -> None:
        self.header, self.arranged, self.shaped, self.place = header, arranged, shaped, place
        self.units = arranged.lattice.units
        self.clamped = sum(block.clamped for block in shaped)
        self.starts = np.array([*(block.start for block in shaped), header.count])
        self.order = self._upload(arranged.order.astype(np.int64))
        self.shifts = self._upload(np.concatenate([block.shifts for block in shaped]))
        places = np.concatenate([block.grid_positions for block in shaped], axis=1)
        self.places = self._upload(places.astype(np.int32))
        near = [self._new((header.count,), kind) for kind in (torch.int32, torch.int64)]
        near.append(self._new((header.count,), torch.float64))
        for_each(surround, header.count, self.places, header.block_size, *near)
        self.symbols = [
            Symbols.of_blocks([block.coded for block in shaped], place),
            self._colours(near),
        ]
        if len(arranged.source.f_rest):
            self.symbols += band_symbols(
                self._levels(near[0]), near[0], self.shifts, header.block_size
            )

    def _upload(self, array: NDArray) -> torch.Tensor:
        return upload(array, self.place)

    def _new(self, shape: tuple[int, ...], kind: torch.dtype) -> torch.Tensor:
        return torch.empty(shape, dtype=kind, device=self.place)

    def _each(self, kernel: object, channels: int, *arguments: object) -> None:
        """Run a kernel that has a thread for each channel of a block."""
        kernel[channels * self.header.block_count, 1](*map(argument, arguments))  # type: ignore[index]

    def _luma_chroma(self, planes: Sequence[torch.Tensor]) -> torch.Tensor:
        """Y, Co, Cg ``(3, N)``, clamped, of R, G, B in the scene's order; see `to_ycocg`."""
        red, green, blue = (plane[self.order].double() for plane in planes)
        luma, twice = (red + green + blue) * LUMA, 2.0 * green - red - blue
        found = torch.stack([luma, (red - blue) * ORANGE, twice * GREEN])
        self.clamped += int((found.abs() > LARGEST).sum())
        return found.clamp_(-LARGEST, LARGEST)

    def _colours(self, near: list[torch.Tensor]) -> Symbols:
        """The pass of SH-DC."""
        count = self.header.count
        found = self._luma_chroma(list(self._upload(self.arranged.source.f_dc)))
        fixed = torch.floor(found * _ONE + 0.5).long()
        levels, contexts = self._new((count, 3), torch.int32), self._new((count, 3), torch.int16)
        own = self.units["sh-dc"], self.shifts, self._upload(self.starts), levels, contexts
        self._each(round_colours, 3, fixed, *near, *own)
        return Symbols.of(levels.view(-1), contexts.view(-1), 3 * np.diff(self.starts))

    def _levels(self, ago: torch.Tensor) -> torch.Tensor:
        """Levels of SH-AC ``(3, K, N)``."""
        planes, count = self.arranged.source.f_rest, self.header.count
        coefficients = len(planes) // 3
        bands = zip(SH_STREAMS, sh_bands(coefficients), strict=False)
        units = [self.units[stream] for stream, band in bands for _ in band]
        values = self._new((3, coefficients, count), torch.float32)
        for k, unit in enumerate(units):
            steps = (unit << self.shifts).double() / _ONE
            found = self._luma_chroma([self._upload(plane) for plane in planes[k::coefficients]])
            values[:, k] = found / steps
        shares = self._new((4, count), torch.float32)
        for_each(find_shares, count, self.places, self.header.block_size, shares)
        levels = self._new((3 * coefficients, count), torch.int32)
        given = values.view(3 * coefficients, count), ago, shares, self._upload(self.starts)
        self._each(round_diffusing, 3 * coefficients, *given, levels)
        return levels.view(3, coefficients, count)

    def code(
        self, listed: list[Pass], rows: list[NDArray[np.uint16]], tables: PassTables
    ) -> list[list[Section]]:
        """Sections of each block."""
        blocks = self.header.block_count
        states = torch.full((blocks, LANES), LOWEST, dtype=torch.int64, device=self.place)
        spans = self._upload(tables.spans.view(np.int32))
        words: list[list[list[bytes]]] = []
        for item, own, symbols in reversed(list(zip(listed, rows, self.symbols, strict=True))):
            words.append(self._push(item, own, symbols, spans, states))
        words.reverse()
        begun = states.cpu().numpy().astype("<u4")
        return [
            [
                *leading_sections(number, begun[number].tobytes(), *block.coded_places()),
                *self._streams(listed, [own[number] for own in words], number),
            ]
            for number, block in enumerate(self.shaped)
        ]

    def _push(
        self,
        item: Pass,
        rows: NDArray[np.uint16],
        symbols: Symbols,
        spans: torch.Tensor,
        states: torch.Tensor,
    ) -> list[list[bytes]]:
        """Code a pass; the words of each stream of each block."""
        blocks, streams = self.header.block_count, len(item.streams)
        total = int(symbols.starts[-1])
        words = self._new((streams, total), torch.int16)
        begins = self._new((blocks, streams), torch.int64)
        push_pass[blocks, WIDTH](
            argument(symbols.tokens), argument(symbols.contexts),
            argument(self._upload(rows.astype(np.int32))), unsigned(spans),
            argument(self._upload(item.cycle)), argument(self._upload(symbols.starts)),
            argument(states), argument(words).view(np.uint16), argument(begins),
        )  # fmt: skip
        counts = self._upload(np.diff(symbols.starts))
        kept = torch.arange(total, device=self.place) >= begins.T.repeat_interleave(counts, dim=1)
        packed = words[kept].cpu().numpy().astype("<i2").tobytes()
        sizes = 2 * (symbols.starts[1:, None] - begins.cpu().numpy())
        ends = np.cumsum(sizes.T.ravel()).reshape(streams, blocks).T
        return [
            [packed[end - size : end] for size, end in zip(*each, strict=True)]
            for each in zip(sizes.tolist(), ends.tolist(), strict=True)
        ]

    def _streams(self, listed: list[Pass], words: list[list[bytes]], block: int) -> list[Section]:
        """Sections of the streams of a block."""
        sections = []
        for item, symbols, own in zip(listed, self.symbols, words, strict=True):
            numbers, levels, widths = symbols.raw_of(block)
            of_stream = item.cycle[numbers % len(item.cycle)]
            for number, (stream, packed) in enumerate(zip(item.streams, own, strict=True)):
                data = stream_bytes(packed, levels, widths * (of_stream == number))
                sections.append(Section.kept(SectionId.of_stream(stream), block, data))
        return sections
