"""Classes, opacity, scales and rotation; the earlier attributes set the step sizes of later ones.

FORMAT.md, section "Passes", the shape pass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import (
    BEFORE,
    SHAPE_OFFSETS,
    SHAPE_PASS,
    SHIFT_CONTEXTS,
    before_bucket,
)
from gs_codec.codecs.adaptive.lattice import (
    FIXED_LIMIT,
    LARGEST,
    TOO_LARGE,
    Lattice,
    from_lattice,
    packed_rules,
    rule_shift,
    to_fixed,
    to_float,
    to_lattice,
)
from gs_codec.codecs.adaptive.rotation import (
    LARGEST_STEP,
    TURN_RULES,
    TURNS,
    split_roll,
    tilts_of,
    turn_shifts,
    turns_of,
)
from gs_codec.codecs.adaptive.tokens import read_token
from gs_codec.coding.context_rans import BAD_CLASS, BAD_VALUE, MORE_BITS, OUT_OF_WORDS, PassReader
from gs_codec.runtime.kernels import inlined, kernel

#: ``code(name, shifts, unit, poles) -> levels``; an encoder quantises to these levels. Poles come
#: from `turn_shifts`; before rotation they are None.
Coder = Callable[[str, NDArray[np.int64], int, NDArray[np.int8] | None], NDArray[np.int64]]


@dataclass(frozen=True)
class Shape:
    """Fixed-point logits ``(n,)``; log-scales, descending, and turns ``(3, n)``; poles ``(n,)``."""

    opacity: NDArray[np.int64]
    scales: NDArray[np.int64]
    turns: NDArray[np.int64]
    poles: NDArray[np.int8]


def walk_shape(lattice: Lattice, classes: NDArray[np.int64], code: Coder) -> Shape:
    """Walk the attributes in stream order, for encoding and decoding.

    `code` returns the levels of each attribute, given its name, its shifts ``(n,)``, its unit, and
    the poles; see `Coder`.
    """
    count = len(classes)
    scales = np.zeros((3, count), np.int64)
    none = np.zeros(count, np.int64)
    shifts = lattice.rules["opacity"].shifts(classes, 1, none, scales)
    unit = lattice.units["opacity"]
    levels = code("opacity", shifts, unit, None)
    opacity = from_lattice(levels, lattice.centres[0], unit, shifts)
    unit = lattice.units["scaling"]
    for k in range(3):
        shifts = lattice.rules[f"scale_{k}"].shifts(classes, 1, opacity, scales)
        levels = code(f"scale_{k}", shifts, unit, None)
        if k == 0:
            scales[k] = from_lattice(levels, lattice.centres[1], unit, shifts)
        else:
            scales[k] = scales[k - 1] - from_lattice(levels, 0, unit, shifts)
    unit = lattice.units["rotation"]
    by_turn, poles = turn_shifts(lattice.rules, classes, opacity, scales)
    turns = np.empty((3, count), np.int64)
    for turn, name, shifts in zip(turns, TURNS, by_turn, strict=True):
        turn[:] = from_lattice(code(name, shifts, unit, poles), 0, unit, shifts)
    return Shape(opacity, scales, turns, poles)


@inlined
def _before_context(attribute, shift, total):
    """Context of opacity (0) or a scale (1-3), from the sum of the two previous values."""
    context = BEFORE * min(shift, SHIFT_CONTEXTS - 1) + before_bucket(attribute, total)
    return SHAPE_OFFSETS[2 + attribute] + context


@kernel
def _contexts(levels, shifts, steps, contexts):
    """Fill ``contexts (n, 9)`` of ``levels (9, n)``; shifts and steps cover the last seven."""
    for i in range(contexts.shape[0]):
        last, before = max(i - 1, 0), max(i - 2, 0)
        some, more = np.int64(i > 0), np.int64(i > 1)
        contexts[i, 0] = levels[0, last] * some + levels[0, before] * more
        contexts[i, 1] = SHAPE_OFFSETS[1] + levels[0, i]
        for k in range(7):
            if k < 4:
                total = levels[2 + k, last] * steps[k, last] * some
                total += levels[2 + k, before] * steps[k, before] * more
                contexts[i, 2 + k] = _before_context(k, shifts[k, i], total)
            else:
                shift = min(shifts[k, i], SHIFT_CONTEXTS - 1)
                contexts[i, 2 + k] = SHAPE_OFFSETS[2 + k] + shift


def shape_pass(
    classes: NDArray[np.integer],
    levels: Mapping[str, NDArray[np.int64]],
    shifts: Mapping[str, NDArray[np.int64]],
    units: Mapping[str, int],
) -> tuple[NDArray[np.int64], NDArray[np.uint16]]:
    """Integers to code and their contexts, ``(n, 9)``, of the shape pass.

    ``classes (2, n)`` are shape and colour classes; levels, shifts ``(n,)`` and units are given by
    attribute.
    """
    names = [item.name for item in SHAPE_PASS.lists[2:]]
    streams = [item.stream for item in SHAPE_PASS.lists[2:]]
    coded = np.stack([*classes.astype(np.int64), *(levels[name] for name in names)])
    finer = np.stack([shifts[name] for name in names])
    steps = np.array([[units[stream]] for stream in streams]) << finer
    contexts = np.empty(coded.shape[::-1], np.uint16)
    _contexts(coded, finer, steps, contexts)
    return coded.T, contexts


@kernel
def _read(
    words, ends, states, spans, slots, rows, bits, reached,
    numbers, limits, units, centres, most, classes, opacity, scales, turns, poles,
):  # fmt: skip
    """Decode classes ``(2, n)`` and shapes; rules are those of opacity, scales and turns."""
    # Positions in words and bits of the four streams, as local variables so that they stay in
    # registers.
    p0, p1, p2, p3 = reached[0]
    u0, u1, u2, u3 = reached[1]
    limit, symbol = 8 * (len(bits) - MORE_BITS), 0
    last, before = np.zeros(5, np.int64), np.zeros(5, np.int64)
    shifts = np.zeros(3, np.int64)
    for i in range(len(poles)):
        if p0 > ends[0] or p1 > ends[1] or p2 > ends[2] or p3 > ends[3]:
            return OUT_OF_WORDS
        if max(u0, u1, u2, u3) > limit:
            return OUT_OF_WORDS
        row = rows[last[4] + before[4]]
        first, p0, u0 = read_token(words, p0, states, symbol, spans, slots, row, bits, u0, True)
        if not 0 <= first < most[0]:
            return BAD_CLASS
        before[4], last[4] = last[4], first
        row = rows[SHAPE_OFFSETS[1] + first]
        second, p0, u0 = read_token(
            words, p0, states, symbol + 1, spans, slots, row, bits, u0, True
        )
        if not 0 <= second < most[1]:
            return BAD_CLASS
        classes[0, i], classes[1, i] = first, second

        shift = rule_shift(numbers, limits, 0, first, 0, 0, 0, 0, 0)
        row = rows[_before_context(0, shift, last[0] + before[0])]
        level, p1, u1 = read_token(
            words, p1, states, symbol + 2, spans, slots, row, bits, u1, False
        )
        before[0], last[0] = last[0], level * (units[0] << shift)
        logit = centres[0] + last[0]
        largest = abs(logit)

        longest = middle = np.int64(0)
        value = centres[1]
        for k in range(1, 4):
            shift = rule_shift(numbers, limits, k, first, logit, longest, middle, 0, 0)
            row = rows[_before_context(k, shift, last[k] + before[k])]
            level, p2, u2 = read_token(
                words, p2, states, symbol + 2 + k, spans, slots, row, bits, u2, False
            )
            before[k], last[k] = last[k], level * (units[1] << shift)
            value += last[k] if k == 1 else -last[k]
            largest = max(largest, abs(value))
            if k == 1:
                longest = value
            elif k == 2:
                middle = value
        opacity[i], scales[0, i], scales[1, i], scales[2, i] = logit, longest, middle, value

        shifts[0], shifts[1], shifts[2], poles[i] = turns_of(
            numbers, limits, 4, first, logit, longest, middle, value
        )
        for k in range(3):
            row = rows[SHAPE_OFFSETS[6 + k] + min(shifts[k], SHIFT_CONTEXTS - 1)]
            level, p3, u3 = read_token(
                words, p3, states, symbol + 6 + k, spans, slots, row, bits, u3, False
            )
            turns[k, i] = level * (units[2] << shifts[k])
            largest = max(largest, abs(turns[k, i]))
        if largest >= FIXED_LIMIT:
            return BAD_VALUE
        symbol += 9
    reached[0, 0], reached[0, 1], reached[0, 2], reached[0, 3] = p0, p1, p2, p3
    reached[1, 0], reached[1, 1], reached[1, 2], reached[1, 3] = u0, u1, u2, u3
    return 0


def read_shapes(
    reader: PassReader,
    sections: Sequence[memoryview],
    rows: NDArray[np.uint16],
    lattice: Lattice,
    count: int,
) -> tuple[NDArray[np.int64], Shape]:
    """Decode the shape pass: shape and colour classes ``(2, n)``, and shapes.

    Raises TruncatedStream or CorruptStream.
    """
    names = ("opacity", "scale_0", "scale_1", "scale_2", *TURN_RULES)
    units = np.array([lattice.units[name] for name in ("opacity", "scaling", "rotation")])
    classes, opacity = np.empty((2, count), np.int64), np.empty(count, np.int64)
    scales, turns = np.empty((2, 3, count), np.int64)
    shape = Shape(opacity, scales, turns, np.empty(count, np.int8))
    reader.decode(
        sections, _read, rows,
        *packed_rules([lattice.rules[name] for name in names]), units,
        np.array(lattice.centres), np.array(lattice.classes), classes,
        opacity, scales, turns, shape.poles,
    )  # fmt: skip
    return classes, shape


class ShapeQuantiser:
    """The `Coder` of an encoder: quantises the attributes, and keeps levels, shifts and units.

    Gaussians whose axes differ by at most half a step get no rotation. For the others, `targets`
    has the turns before rounding, each given the decoded values of the turns before it.
    """

    def __init__(
        self,
        lattice: Lattice,
        opacity: NDArray,
        scales: NDArray[np.float64],
        vectors: NDArray[np.float64],
    ) -> None:
        self.lattice = lattice
        self.opacity = opacity
        self.scales = scales
        self.vectors = vectors
        self.levels: dict[str, NDArray[np.int64]] = {}
        self.shifts: dict[str, NDArray[np.int64]] = {}
        self.targets: dict[str, NDArray[np.float64]] = {}
        self.clamped = 0
        self._last = np.zeros(0)
        self._swings = np.zeros((2, 0))
        self._round = np.zeros(0, bool)

    def __call__(
        self, name: str, shifts: NDArray[np.int64], unit: int, poles: NDArray[np.int8] | None
    ) -> NDArray[np.int64]:
        """Quantise an attribute to levels."""
        group = "rotation" if name in TURNS else "opacity" if name == "opacity" else "scaling"
        centre, limit = 0, LARGEST
        if group == "opacity":
            values, centre = self.opacity, self.lattice.centres[0]
        elif poles is not None:
            self._aim(name, poles)
            uncoded = self._round | (to_float(unit << shifts) > LARGEST_STEP)
            values = np.where(uncoded, 0.0, self.targets[name])
        elif name == "scale_0":
            values, centre = self.scales[0], self.lattice.centres[1]
        else:
            # Each scale is clamped to the limit, but their difference can exceed it.
            scales = self.scales[int(name[-1])]
            self.clamped += int(np.count_nonzero(np.abs(scales) > LARGEST))
            values, limit = self._last - np.clip(scales, -LARGEST, LARGEST), TOO_LARGE
        fixed, clamped = to_fixed(values, limit)
        self.clamped += clamped
        levels = to_lattice(fixed, centre, unit, shifts)
        self.levels[name] = levels
        self.shifts[name] = shifts
        if group == "scaling":
            coded = to_float(from_lattice(levels, centre, unit, shifts))
            self._last = coded if name == "scale_0" else self._last - coded
        return levels

    def _aim(self, name: str, poles: NDArray[np.int8]) -> None:
        """Set the target of the next turn; two tilts follow the roll."""
        if name == "roll":
            step = to_float(self.lattice.units["scaling"] << self.shifts["scale_0"])
            self._round = self.scales[0] - self.scales[2] <= 0.5 * step
            self.targets[name], self._swings = split_roll(self.vectors, poles)
        elif name == "tilt_0":
            steps = to_float(self.lattice.units["rotation"] << self.shifts["roll"])
            tilts = tilts_of(self._swings, self.levels["roll"] * steps, poles)
            self.targets["tilt_0"], self.targets["tilt_1"] = tilts
