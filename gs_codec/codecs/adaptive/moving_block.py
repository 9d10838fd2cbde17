"""What changes from one frame of a sequence to the next, in a block of its key frame.

Every Gaussian of a key frame stays in its place of the stream, and keeps its classes and its basis.
A frame codes which *parts* of which Gaussians change (shape, rotation, place, SH-DC, SH-AC), and
integers: multiples of the step sizes that the rules of the key frame give at the current values.
They are added to decoded values, so errors do not accumulate. One function both encodes and
decodes, so the two cannot differ. FORMAT.md, section "Motion".
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.basis import Bases, bounds
from gs_codec.codecs.adaptive.decode import Blocks, DecodedBlock
from gs_codec.codecs.adaptive.lattice import (
    FIXED_LIMIT,
    FRACTION_BITS,
    TOO_LARGE,
    Lattice,
    cell_widths,
    from_grid,
    to_float,
)
from gs_codec.codecs.adaptive.rotation import turn_shifts, turned_quaternions
from gs_codec.coding.binary import bit_length, code_bit, code_integer, new_contexts
from gs_codec.coding.ycocg import fill_colours, from_ycocg
from gs_codec.config import SH_STREAMS
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import sh_bands

#: What may change in a Gaussian, in the order of the stream: opacity and log-scales, rotation,
#: centre, SH-DC, SH-AC.
SHAPE, TURN, PLACE, DC, AC = range(5)

#: The part that each attribute group of a scene belongs to.
GROUP_PARTS = {
    "opacity": SHAPE,
    "log_scale": SHAPE,
    "rot": TURN,
    "positions": PLACE,
    "f_dc": DC,
    "f_rest": AC,
}

#: Number of values of each part but SH-AC.
CHANNELS = (4, 3, 3, 3)

#: Gaussians that share a flag: whether any of them changes.
_RUN = 16

#: Number of predictions of a change: none; the Gaussian's own last change; that of the Gaussian
#: coded before; its own, plus what that one's differs from its last.
MODES = 4

#: Integers have fewer bits than this.
_MAGNITUDES = 32
_PER_CLASS = 4 * _MAGNITUDES

#: Classes of a value by the bit length of the previous difference of its channel.
_ACTIVITIES = 6

#: Contexts of flags, and of modes.
_FLAGS = 4 + 8 * 5
_MODE_CONTEXTS = 3

#: Largest centre, in half steps of the grid.
PLACE_LIMIT = 1 << 30

#: Largest level of SH-AC.
_LEVEL_LIMIT = 1 << 30

#: First context of each part.
_FIRST = [_FLAGS]
for _channels in CHANNELS:
    _FIRST.append(_FIRST[-1] + _MODE_CONTEXTS + _channels * _ACTIVITIES * _PER_CLASS)


def contexts_of(coefficients: int) -> int:
    """Number of contexts of a block."""
    return _FIRST[AC] + 6 * coefficients * _PER_CLASS


@kernel
def _code_flags(state, data, contexts, before, flags):
    """Code ``flags (5, n)``; `before` are those of the last frame."""
    parts, count = flags.shape
    last = np.zeros(parts, np.int64)
    ran = np.int64(0)
    for start in range(0, count, _RUN):
        stop = min(start + _RUN, count)
        was = some = False
        for i in range(start, stop):
            for part in range(parts):
                was |= before[part, i] != 0
                some |= flags[part, i] != 0
        ran = np.int64(code_bit(state, data, contexts, 2 * np.int64(was) + ran, some))
        if not ran:
            continue
        for i in range(start, stop):
            earlier = np.int64(0)
            for part in range(parts):
                context = 4 + 8 * part + 4 * np.int64(before[part, i] != 0) + 2 * last[part]
                bit = code_bit(state, data, contexts, context + earlier, flags[part, i] != 0)
                flags[part, i] = last[part] = np.int64(bit)
                earlier |= last[part]


@inlined
def _predicted(mode, own, other, other_before):
    if mode == 0:
        return np.int64(0)
    if mode == 1:
        return own
    return other if mode == 2 else own + other - other_before


@inlined
def _nearest_multiple(value, step):
    return (2 * value + step) // (2 * step)


@kernel
def _count_bits(members, steps, levels, before, bits):
    """Approximate bits of ``levels (C, m)`` with each prediction, ``(MODES,)``."""
    channels = len(levels)
    other, other_before = np.zeros((2, channels), np.int64)
    for j in range(len(members)):
        for c in range(channels):
            step, own = steps[c, j], before[c, members[j]]
            for mode in range(MODES):
                expected = _predicted(mode, own, other[c], other_before[c])
                rest = levels[c, j] - _nearest_multiple(expected, step)
                bits[mode] += 1 + 2 * bit_length(abs(rest))
            other[c], other_before[c] = levels[c, j] * step, own


@kernel
def _code_changes(state, data, contexts, base, members, steps, levels, before, mode):
    """Code ``levels (C, m)`` of changes of `members`; return the mode of prediction.

    ``before (C, n)`` are the changes in the last frame, in the units of ``steps (C, m)``.
    """
    channels = len(levels)
    high = np.int64(code_bit(state, data, contexts, base, mode > 1))
    low = np.int64(code_bit(state, data, contexts, base + 1 + high, mode & 1))
    mode = 2 * high + low
    base += 3
    other, other_before, activity = np.zeros((3, channels), np.int64)
    for j in range(len(members)):
        for c in range(channels):
            step, own = steps[c, j], before[c, members[j]]
            expected = _predicted(mode, own, other[c], other_before[c])
            level = _nearest_multiple(expected, step)
            context = base + (_ACTIVITIES * c + activity[c]) * _PER_CLASS
            rest = code_integer(state, data, contexts, context, _MAGNITUDES, levels[c, j] - level)
            activity[c] = min(bit_length(abs(rest)), _ACTIVITIES - 1)
            levels[c, j] = level + rest
            other[c], other_before[c] = levels[c, j] * step, own


@kernel
def _code_levels(state, data, contexts, base, levels):
    """Code changes of levels of SH-AC, ``(3, K, m)``."""
    coefficients = levels.shape[1]
    for j in range(levels.shape[2]):
        some = np.int64(0)
        for channel in range(3):
            for k in range(coefficients):
                context = base + (2 * (channel * coefficients + k) + some) * _PER_CLASS
                found = code_integer(
                    state, data, contexts, context, _MAGNITUDES, np.int64(levels[channel, k, j])
                )
                levels[channel, k, j] = found
                some = np.int64(found != 0)


@kernel
def _code_bits(state, data, contexts, words):
    """Code 32-bit ``words``, each bit with an even chance."""
    for i in range(len(words)):
        word = np.int64(0)
        for shift in range(31, -1, -1):
            contexts[0] = 32768 << 8
            bit = code_bit(state, data, contexts, 0, (words[i] >> shift) & 1)
            word = 2 * word + (1 if bit else 0)
        words[i] = word


@dataclass
class Changes:
    """What an encoder codes in a frame: flags ``(5, n)``, and levels of the flagged Gaussians.

    ``far`` are the new centres of flagged far Gaussians, ``(3, f)``.
    """

    flags: NDArray[np.uint8]
    levels: dict[int, NDArray[np.int64]] = field(default_factory=dict)
    far: NDArray[np.float32] = field(default_factory=lambda: np.zeros((3, 0), np.float32))


@dataclass
class Frame:
    """Decoded integers of a block in a frame, and the state of its coder.

    ``shape (4, n)`` are opacity and log-scales, ``places (3, n)`` centres in half steps,
    ``colours (3, n)`` SH-DC; ``levels (3, K, n)`` are SH-AC with step sizes by ``shifts (n,)``;
    ``rot (4, n)`` are float64; ``far (3, f)``; ``flags (5, n)`` and ``moves`` are the last changes.
    """

    shape: NDArray[np.int64]
    rot: NDArray[np.float64]
    places: NDArray[np.int64]
    colours: NDArray[np.int64]
    shifts: NDArray[np.int64]
    levels: NDArray[np.int32]
    far: NDArray[np.float32]
    flags: NDArray[np.uint8]
    moves: list[NDArray[np.int64]]
    contexts: NDArray[np.int32]


class MovingBlock:
    """A block of a key frame, and its state in the current frame."""

    def __init__(self, blocks: Blocks, block: int, found: DecodedBlock) -> None:
        self.where = f"block {block}"
        self.start = blocks.file.header.block_range(block)[0]
        self.lattice: Lattice = blocks.lattice
        self.classes = found.classes
        self.bases: Bases | None = found.bases
        self.units = np.array(
            [
                self.lattice.units[stream]
                for stream, band in zip(SH_STREAMS, sh_bands(found.levels.shape[1]), strict=False)
                for _ in band
            ],
            np.int64,
        )
        self._widths = cell_widths(self.lattice.grid)
        self._lefts = found.dropped + found.low_bits
        shape, count = found.shape, len(found.shifts)
        rot = turned_quaternions(to_float(shape.turns), shape.poles).astype(np.float64)
        self.frame = Frame(
            np.concatenate([shape.opacity[None], shape.scales]),
            rot,
            found.grid_positions,
            found.colours,
            found.shifts,
            found.levels,
            found.far,
            np.zeros((5, count), np.uint8),
            [np.zeros((channels, count), np.int64) for channels in CHANNELS],
            new_contexts(contexts_of(found.levels.shape[1])),
        )

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return self.classes.shape[1]

    def steps(
        self, part: int, shape: NDArray[np.int64], members: NDArray[np.integer]
    ) -> NDArray[np.int64]:
        """Step sizes ``(C, m)`` of a part but SH-AC, given the shapes ``(4, n)`` of all."""
        rules, units = self.lattice.rules, self.lattice.units
        classes, opacity, scales = self._known(shape, members)
        if part == SHAPE:
            none = np.zeros_like(scales)
            of_opacity = rules["opacity"].shifts(classes[0], 1, none[0], none)
            of_scales = (
                rules[f"scale_{k}"].shifts(classes[0], 1, opacity, scales) for k in range(3)
            )
            unit = np.array([units["opacity"], *3 * [units["scaling"]]], np.int64)
            return unit[:, None] << np.stack([of_opacity, *of_scales])
        if part == TURN:
            (roll, middle, other), poles = turn_shifts(rules, classes[0], opacity, scales)
            first = poles == 0
            by_axis = [np.where(first, roll, other), middle, np.where(first, other, roll)]
            return units["rotation"] << np.stack(by_axis)
        if part == PLACE:
            dropped = rules["position"].shifts(classes[0], 3, opacity, scales)
            widths = self._widths[:, np.minimum(dropped, self._lefts[members])]
            return 2 * (1 << widths)
        shifts = self.colour_shifts(shape, members)
        return np.stack(3 * [units["sh-dc"] << shifts])

    def colour_shifts(
        self, shape: NDArray[np.int64], members: NDArray[np.integer]
    ) -> NDArray[np.int64]:
        """Shifts ``(m,)`` of the step sizes of colours."""
        classes, opacity, scales = self._known(shape, members)
        return self.lattice.rules["colour"].shifts(classes[1], 1, opacity, scales)

    def _known(
        self, shape: NDArray[np.int64], members: NDArray[np.integer]
    ) -> tuple[NDArray[np.int64], ...]:
        """Classes ``(2, m)``, opacity ``(m,)`` and log-scales ``(3, m)`` of some Gaussians."""
        own = np.ascontiguousarray(shape[:, members])
        return np.ascontiguousarray(self.classes[:, members]), own[0], own[1:]

    def walk(self, state: NDArray, data: NDArray, wanted: Changes | None) -> Frame:
        """Code a frame and return it; `wanted` is what an encoder codes, None for a decoder.

        Raises CorruptStream if a value is out of range.
        """
        last = self.frame
        found = replace(
            last,
            flags=np.zeros_like(last.flags) if wanted is None else wanted.flags.copy(),
            moves=[np.zeros_like(before) for before in last.moves],
            contexts=last.contexts.copy(),
        )
        _code_flags(state, data, found.contexts, last.flags, found.flags)
        for part in range(AC):
            members = np.flatnonzero(found.flags[part])
            if part == PLACE:
                first = self.count - last.far.shape[1]
                found.far = self._code_far(state, data, members[members >= first] - first, wanted)
                members = members[members < first]
            if len(members):
                self._code_part(part, members, found, state, data, wanted)
        members = np.flatnonzero(found.flags[AC])
        if len(members) and len(self.units):
            self._code_ac(members, found, state, data, wanted)
        return found

    def _code_part(
        self,
        part: int,
        members: NDArray[np.integer],
        found: Frame,
        state: NDArray,
        data: NDArray,
        wanted: Changes | None,
    ) -> None:
        """Code the changes of a part, and add them to the values of a frame."""
        steps = np.ascontiguousarray(self.steps(part, found.shape, members))
        levels, mode, before = np.zeros(steps.shape, np.int64), 0, self.frame.moves[part]
        if wanted is not None:
            levels[:] = wanted.levels[part]
            bits = np.zeros(MODES, np.int64)
            _count_bits(members, steps, levels, before, bits)
            mode = int(np.argmin(bits))
        coder = state, data, found.contexts
        _code_changes(*coder, _FIRST[part], members, steps, levels, before, mode)
        changed = levels * steps
        limit = PLACE_LIMIT if part == PLACE else FIXED_LIMIT
        if np.abs(changed).max() >= 2 * limit:
            raise CorruptStream(f"{self.where}: a change out of range")
        found.moves[part][:, members] = changed
        if part == TURN:
            found.rot = found.rot.copy()
            found.rot[:, members] = turned(found.rot[:, members], to_float(changed))
            return
        name = {SHAPE: "shape", PLACE: "places", DC: "colours"}[part]
        values = getattr(found, name).copy()
        values[:, members] += changed
        if np.abs(values[:, members]).max() >= limit:
            raise CorruptStream(f"{self.where}: a value out of range")
        setattr(found, name, values)

    def _code_ac(
        self,
        members: NDArray[np.integer],
        found: Frame,
        state: NDArray,
        data: NDArray,
        wanted: Changes | None,
    ) -> None:
        """Code the levels of SH-AC."""
        shifts = self.colour_shifts(found.shape, members)
        old = rescaled(found.levels[:, :, members], shifts - found.shifts[members])
        rest = np.zeros(old.shape, np.int64)
        if wanted is not None:
            rest[:] = wanted.levels[AC] - old
        _code_levels(state, data, found.contexts, _FIRST[AC], rest)
        if np.abs(old + rest).max() >= _LEVEL_LIMIT:
            raise CorruptStream(f"{self.where}: a level out of range")
        found.levels, found.shifts = found.levels.copy(), found.shifts.copy()
        found.levels[:, :, members], found.shifts[members] = old + rest, shifts

    def _code_far(
        self, state: NDArray, data: NDArray, members: NDArray, wanted: Changes | None
    ) -> NDArray[np.float32]:
        """Code the centres of far Gaussians that move; return those of all."""
        far = self.frame.far
        if not len(members):
            return far
        words = np.zeros(3 * len(members), np.int64)
        if wanted is not None:
            words[:] = wanted.far.T.ravel().view(np.uint32)
        _code_bits(state, data, new_contexts(1), words)
        found = words.astype(np.uint32).view(np.float32).reshape(-1, 3).T
        if not np.isfinite(found).all():
            raise CorruptStream(f"{self.where}: a centre that is not finite")
        far = far.copy()
        far[:, members] = found
        return far

    def fill(self, frame: Frame, planes: dict[str, NDArray[np.float32]]) -> None:
        """Move to a coded frame, and write what changes to the planes of the key frame's scene.

        Raises CorruptStream if a value is out of range.
        """
        self.frame = frame
        members = [np.flatnonzero(row) for row in frame.flags]
        some = members[SHAPE]
        planes["opacity"][0, self.start + some] = to_float(frame.shape[0, some])
        planes["log_scale"][:, self.start + some] = to_float(frame.shape[1:, some])
        some = members[TURN]
        planes["rot"][:, self.start + some] = frame.rot[:, some]
        some = members[PLACE]
        positions = from_grid(frame.places[:, some], self.lattice.grid)
        is_far = some >= self.count - frame.far.shape[1]
        positions[:, is_far] = frame.far[:, some[is_far] - self.count + frame.far.shape[1]]
        planes["positions"][:, self.start + some] = positions
        some = members[DC]
        planes["f_dc"][:, self.start + some] = from_ycocg(to_float(frame.colours[:, some]))
        some = members[AC]
        if not len(some) or not len(self.units):
            return
        levels, shifts = np.ascontiguousarray(frame.levels[:, :, some]), frame.shifts[some]
        out = np.empty(levels.shape, np.float32)
        if self.bases is None:
            fits = fill_colours(levels, self.units, shifts, TOO_LARGE, out)
        else:
            ends = np.searchsorted(some, bounds(len(self.bases.entries), self.count))
            fits = self.bases.fill(levels, ends, self.units[0], shifts, TOO_LARGE, out)
        if not fits:
            raise CorruptStream(f"{self.where}: a value out of range")
        planes["f_rest"][:, self.start + some] = out.reshape(-1, len(some))


def rescaled(levels: NDArray[np.int32], more: NDArray[np.int64]) -> NDArray[np.int64]:
    """Levels ``(3, K, m)`` for step sizes that are 2 to the power of ``more (m,)`` times as large.

    Rounded to nearest, half up; those that would be too large become 0.
    """
    wide = levels.astype(np.int64)
    finer = np.minimum(np.maximum(-more, 0), FRACTION_BITS + 11)
    coarser = np.maximum(more, 0)
    half = (1 << coarser) >> 1
    fits = np.abs(wide) >> (30 - np.minimum(finer, 30)) == 0
    return (np.where(fits, wide << finer, np.int64(0)) + half) >> coarser


def turned(rot: NDArray[np.float64], turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions ``(4, m)`` after turns about their own axes; real parts >= 0.

    ``turns (3, m)`` are sines of half the angles about the three axes.
    """
    x, y, z = turns
    square = (x * x + y * y) + z * z
    norm = np.sqrt(np.maximum(square, 1.0))
    w = np.sqrt(np.maximum(1.0 - square, 0.0))
    x, y, z = x / norm, y / norm, z / norm
    a, b, c, d = rot
    found = np.stack(
        [
            ((a * w - b * x) - c * y) - d * z,
            ((a * x + b * w) + c * z) - d * y,
            ((a * y - b * z) + c * w) + d * x,
            ((a * z + b * y) - c * x) + d * w,
        ]
    )
    a, b, c, d = found
    length = np.sqrt(((a * a + b * b) + c * c) + d * d)
    return found / np.where(a < 0.0, -length, length)
