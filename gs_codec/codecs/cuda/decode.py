"""Profiles ``l``, ``m`` and ``s`` on a device: stream to tensors.

Headers, checksums and tables are read on the CPU. One warp decodes a block pass by pass, while
another decodes the tree of its positions. Results are checked before they are returned.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import cuda
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.basis import MATRIX_BITS, read_bases
from gs_codec.codecs.adaptive.contexts import passes
from gs_codec.codecs.adaptive.lattice import Lattice, cell_widths, packed_rules
from gs_codec.codecs.adaptive.rotation import TURN_RULES
from gs_codec.codecs.adaptive.section import lattice_of
from gs_codec.codecs.cuda.block_streams import PADDING, Streams
from gs_codec.codecs.cuda.colours import read_colours
from gs_codec.codecs.cuda.lanes import SIMULATED, WIDTH, pack_tables
from gs_codec.codecs.cuda.per_gaussian import (
    THREADS,
    fill_colours,
    fill_shapes,
    find_widths,
    place,
    surround,
)
from gs_codec.codecs.cuda.sh_ac_levels import read_levels
from gs_codec.codecs.cuda.shapes import STREAMS, read_shapes
from gs_codec.codecs.cuda.sums import OF_SHARE, OF_SUM, read_shares, read_sums
from gs_codec.coding.context_rans import BAD_VALUE, PassTables
from gs_codec.coding.morton import axis_tables
from gs_codec.egs.egs_file import EgsFile
from gs_codec.egs.index import check_boxes
from gs_codec.scene import SH_COEFFICIENTS, sh_bands


@contextmanager
def working_on(device: str) -> Iterator[torch.device]:
    """Run kernels and torch on a device, in one stream; yield the device of tensors."""
    place = torch.device("cpu" if SIMULATED else device)
    with warnings.catch_warnings():
        # numba warns that a file of few blocks underuses the device.
        warnings.filterwarnings("ignore", ".*Grid size")
        if SIMULATED:
            yield place
            return
        # numba uses the default stream.
        stream = torch.cuda.default_stream(place)
        with torch.cuda.stream(stream), cuda.gpus[stream.device.index]:
            yield place


def argument(value: Any) -> Any:
    """Convert a value for a kernel; tensors share their memory."""
    if not isinstance(value, torch.Tensor):
        return value
    return value.numpy() if SIMULATED else cuda.as_cuda_array(value, sync=False)


def unsigned(tensor: torch.Tensor) -> Any:
    """Convert a tensor of non-negative 32-bit integers for a kernel."""
    return argument(tensor.view(-1)).view(np.uint32).reshape(tensor.shape)


def staging(count: int, kind: torch.dtype) -> torch.Tensor:
    """Pinned CPU memory, copied to a device asynchronously."""
    return torch.empty(count, dtype=kind, pin_memory=not SIMULATED)


def upload(array: NDArray, place: torch.device) -> torch.Tensor:
    """Copy an array to a device."""
    return torch.from_numpy(np.ascontiguousarray(array)).to(place, non_blocking=True)


def for_each(kernel: Any, count: int, *arguments: Any) -> None:
    """Run a kernel with one thread per Gaussian."""
    # In the simulator one thread processes all Gaussians.
    grid = 1 if SIMULATED else -(-count // THREADS)
    kernel[grid, THREADS](*map(argument, arguments))


def decode_blocks(file: EgsFile, device: str) -> dict[str, torch.Tensor]:
    """Decode all blocks of a file to tensors on a device, in stream order.

    Raises TruncatedStream or CorruptStream.

    Returns
    -------
    dict of str to Tensor
        Float32 ``means (N, 3)``, ``quats (N, 4)``, ``log_scales (N, 3)``, ``logits (N,)``, ``sh (N,
        1 + K, 3)``, as stored in the file.
    """
    count, coefficients = file.header.count, SH_COEFFICIENTS[file.header.sh_degree]
    with working_on(device) as place:
        if count:
            return _Decoder(file, place).decode()
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logits": ()}
    shapes["sh"] = (1 + coefficients, 3)
    return {name: torch.zeros((0, *shape), device=place) for name, shape in shapes.items()}


class _Tables(NamedTuple):
    """Words and raw bits of a file, and the tables of all passes."""

    words: Any
    raw: Any
    runs: Any
    spans: Any


class _Decoder:
    """Decodes the blocks of a file, kernel by kernel."""

    def __init__(self, file: EgsFile, device: torch.device) -> None:
        self.file, self.device = file, device
        self.header = file.header
        self.coefficients = SH_COEFFICIENTS[self.header.sh_degree]
        self.lattice: Lattice
        self.lattice, models = lattice_of(file)
        listed = passes(self.coefficients)
        tables = pack_tables(PassTables.pack(models.tables()))
        names = [name for item in listed for name in item.streams]
        staged = staging(len(file.data) + PADDING, torch.uint8)
        self.streams = Streams.of(file, names, staged.numpy())
        blocks = np.arange(self.header.block_count + 1) * self.header.block_size
        data = staged.to(self.device, non_blocking=True)
        bits = data.view(-1, 4).flip(1).contiguous().view(torch.int32).view(-1)
        self.bytes = argument(data)
        self.tables = _Tables(
            argument(data.view(torch.int16)).view(np.uint16),
            unsigned(bits),
            *(unsigned(self._upload(table.view(np.int32))) for table in tables),
        )
        self.rows = [argument(self._upload(models.rows(i).astype(np.int32))) for i in listed]
        self.reached = self._upload(self.streams.reached)
        self.states = self._upload(self.streams.states.astype(np.uint32).view(np.int32))
        self.faults = self._new((self.header.block_count, 1 + len(names)), torch.int64)
        self.coders = self._new((self.header.block_count, 5), torch.int64)
        self.chains = (
            argument(self.reached),
            argument(self._upload(self.streams.begins)),
            argument(self._upload(self.streams.ends)),
            argument(self._upload(np.minimum(blocks, self.header.count))),
            unsigned(self.states),
        )

    def decode(self) -> dict[str, torch.Tensor]:
        """Decode all attributes and check them."""
        count = self.header.count
        trees = self._new((count,), torch.int64), self._new((count,), torch.uint8)
        planes = self._shapes(*trees)
        shifts, widths, places, means = self._places(trees, planes)
        kinds = torch.int32, torch.int64, torch.float64
        near = [self._new((self.header.count,), kind) for kind in kinds]
        self._each(surround, places, self.header.block_size, *near)
        values = self._new((3, self.header.count), torch.int32)
        unit = self.lattice.units["sh-dc"]
        self._chain(read_colours, 1, STREAMS, *near, unit, shifts, values.view(-1))
        levels = self._levels(near[0], shifts)
        found = {"means": means, **self._floats(planes, values, levels, shifts)}
        self._check(widths, means)
        return found

    def _upload(self, array: NDArray) -> torch.Tensor:
        return upload(array, self.device)

    def _new(self, shape: tuple[int, ...], kind: torch.dtype) -> torch.Tensor:
        return torch.zeros(shape, dtype=kind, device=self.device)

    def _each(self, kernel: Any, *arguments: Any) -> None:
        """Run a kernel with one thread per Gaussian."""
        for_each(kernel, self.header.count, *arguments)

    def _chain(self, kernel: Any, number: int, stream: int | None, *arguments: Any) -> None:
        """Run a kernel with one warp per block, for pass `number`."""
        given = map(argument, arguments)
        first = [] if stream is None else [stream]
        # The first pass has a second warp that reads the tree.
        kernel[self.header.block_count * (2 if number == 0 else 1), WIDTH](
            *self.tables, self.rows[number], *self.chains, *first, *given, argument(self.faults)
        )

    def _rules(self, *names: str) -> list[torch.Tensor]:
        rules = packed_rules([self.lattice.rules[name] for name in names])
        return [self._upload(array) for array in rules]

    def _shapes(
        self, codes: torch.Tensor, lefts: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Decode classes and shapes ``(9, N)`` as integers, and poles ``(N,)``, and the trees.

        From the trees, it fills the position codes without their low bits, and the number of low
        bits.
        """
        lattice, count = self.lattice, self.header.count
        planes, poles = self._new((9, count), torch.int32), self._new((count,), torch.int8)
        names = ("opacity", "scale_0", "scale_1", "scale_2", *TURN_RULES)
        numbers, limits = packed_rules([lattice.rules[name] for name in names])
        of_lanes = ("opacity", *("scaling",) * 3, *("rotation",) * 3)
        units = np.array([0, 0, *(lattice.units[name] for name in of_lanes)])
        rules = np.pad(numbers, ((2, 0), (0, 0))), np.pad(limits, (2, 0)), units
        given = (*rules, np.array(lattice.centres), np.array(lattice.classes))
        trees = self._upload(self.streams.trees), lattice.grid.total_bits, codes, lefts
        self._chain(
            read_shapes, 0, None, *map(self._upload, given), planes.view(-1), poles,
            self.bytes, *trees, self.coders,
        )  # fmt: skip
        return planes, poles

    def _places(
        self, trees: tuple[torch.Tensor, ...], shapes: tuple[torch.Tensor, torch.Tensor]
    ) -> tuple[torch.Tensor, ...]:
        """Shifts of colours, widths of low bits, positions in half steps, and centres."""
        count, grid = self.header.count, self.lattice.grid
        codes, lefts = trees
        shifts, widths = self._new((count,), torch.uint8), self._new((count,), torch.uint8)
        self._each(
            find_widths, *self._rules("position", "colour"), shapes[0], lefts, widths, shifts
        )
        before = torch.cumsum(widths, 0, dtype=torch.int64) - widths
        places, means = self._new((3, count), torch.int32), self._new((count, 3), torch.float32)
        firsts, lasts = (self._upload(column) for column in self.streams.low_bits.T)
        axes = self._upload(axis_tables(grid.bits).astype(np.int32))
        sides, origin = self._upload(cell_widths(grid)), self._upload(np.array(grid.origin))
        low_bits = firsts, lasts, before, widths
        self._each(
            place, self.bytes, *low_bits, lefts, codes, self.header.block_size,
            axes, sides, origin, 0.5 * grid.step, places, means,
        )  # fmt: skip
        return shifts, widths, places, means

    def _levels(self, ago: torch.Tensor, shifts: torch.Tensor) -> torch.Tensor:
        """Levels of SH-AC ``(K, 3, N)``; if there are none, one coefficient of zeros."""
        count, bands = self.header.count, sh_bands(self.coefficients)
        levels = self._new((max(self.coefficients, 1), 3, count), torch.int32)
        left, shares, live = self._new((3, count), torch.int32)
        for number, band in enumerate(bands, 1):
            first, last = number == 1, number == len(bands)
            chain = 1 + number, STREAMS + number
            if first:
                self._chain(read_sums, *chain, shifts, left)
            offset = OF_SUM if first else 0
            self._chain(read_shares, *chain, -1 if last else offset, left, shares, live)
            offset += 0 if last else OF_SHARE
            marks = self._new((count,), torch.int8)
            own = levels[band.start : band.stop].view(-1)
            members = band.stop - band.start
            self._chain(read_levels, *chain, offset, members, ago, shares, live, marks, own)
        return levels

    def _floats(
        self,
        shapes: tuple[torch.Tensor, torch.Tensor],
        values: torch.Tensor,
        levels: torch.Tensor,
        shifts: torch.Tensor,
    ) -> dict[str, torch.Tensor]:
        """Convert everything except centres to floats."""
        count, coefficients = self.header.count, self.coefficients
        sizes = {"quats": (4,), "log_scales": (3,), "logits": (), "sh": (1 + coefficients, 3)}
        found = {name: self._new((count, *size), torch.float32) for name, size in sizes.items()}
        self._each(fill_shapes, *shapes, found["logits"], found["log_scales"], found["quats"])
        bands = enumerate(sh_bands(coefficients), 1)
        units = [self.lattice.units[f"sh{number}"] for number, band in bands for _ in band]
        # A kernel needs an argument even if there are no coefficients.
        steps = self._upload(np.array(units or [0], np.float64))
        own = steps, shifts, coefficients, self.header.block_size, BAD_VALUE, self.faults
        bases = self._bases()
        self._each(fill_colours, values, levels, *bases, *own, found["sh"].view(-1))
        return found

    def _bases(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Matrices of all runs ``(R, K, K)``, and where those of each block begin, and the end."""
        blocks = range(self.header.block_count)
        found = [read_bases(self.file, block) for block in blocks]
        firsts = np.cumsum([0, *(0 if each is None else len(each.entries) for each in found)])
        matrices = [each.matrices / (1 << MATRIX_BITS) for each in found if each is not None]
        # A kernel needs an argument even if there are no bases.
        padded = np.concatenate(matrices or [np.zeros((1, 1, 1))])
        return self._upload(padded), self._upload(firsts)

    def _check(self, widths: torch.Tensor, means: torch.Tensor) -> None:
        """Raise the faults that kernels found."""
        size, whole = self.header.block_size, self.header.count // self.header.block_size
        parts = [means[: whole * size].view(whole, size, 3), means[None, whole * size :]]
        bits = [part.to(torch.int64) for part in (widths[: whole * size], widths[whole * size :])]
        parts = [part for part in parts if part.numel()]
        boxes = torch.cat([torch.cat([x.amin(1), x.amax(1)], 1) for x in parts])
        sums = torch.cat([bits[0].view(whole, size).sum(1), bits[1].sum()[None]])
        low_bits = sums[: self.header.block_count].cpu().numpy() + self.streams.low_bits[:, 0]
        results = self.reached, self.states, self.faults, self.coders, boxes
        checks = [x.cpu().numpy() for x in results]
        self.streams.check(checks[0], low_bits, checks[1].view(np.uint32), *checks[2:4])
        check_boxes(self.file, checks[4])
