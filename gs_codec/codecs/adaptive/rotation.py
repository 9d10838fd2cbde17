"""Rotation as a roll about one axis of a Gaussian and two tilts of that axis.

The more two axes differ in length, the more visible is a turn in their plane: the roll of a needle
about its longest axis hardly shows, nor does that of a disc about its shortest. The *pole* is
whichever of these two axes has the coarser step size for turns about it. The quaternion is a roll
about the pole, followed by the smallest turn that brings the pole to its direction. In the rolled
frame, the two components of that smallest turn (the tilts) are turns about the Gaussian's other two
axes. So each of the three numbers has its own step size. FORMAT.md, section "Lattices".
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, StepRule, packed_rules, rule_shift
from gs_codec.runtime.kernels import inlined, kernel

#: Rules for turns about the longest, the middle and the shortest axis.
TURN_RULES = ("turn_0", "turn_1", "turn_2")

#: Passes: the roll about the pole, the tilts about the middle axis and about the third.
TURNS = ("roll", "tilt_0", "tilt_1")

#: The rules that each pass may use; the pole selects one.
_RULES_OF = {"roll": ("turn_0", "turn_2"), "tilt_0": ("turn_1",), "tilt_1": ("turn_0", "turn_2")}

#: Sines of half angles have at most about this step size; with larger steps only level 0 exists.
LARGEST_STEP = 0.75


def rules_of(name: str) -> tuple[str, ...]:
    """Rules that a pass of opacity, scaling or rotation may use."""
    return _RULES_OF.get(name, (name,))


@inlined
def _alike(first, second):
    """Octaves added to the step size of a turn between two axes of these fixed-point log-scales."""
    difference = abs(first - second)
    if difference >= 1 << (FRACTION_BITS - 1):
        return 0
    return FRACTION_BITS - math.frexp(np.float64(difference))[1]


@kernel
def _likeness(scales, out):
    for i in range(out.shape[1]):
        for k in range(3):
            out[k, i] = _alike(scales[(k + 1) % 3, i], scales[(k + 2) % 3, i])


def likeness(scales: NDArray[np.int64]) -> NDArray[np.int64]:
    """Octaves added to turns about each axis, ``(3, n)``, for the likeness of the other two axes.

    ``scales (3, n)`` are fixed-point log-scales.
    """
    out = np.empty(scales.shape, np.int64)
    _likeness(scales, out)
    return out


@inlined
def turns_of(numbers, limits, rule, octaves, opacity, first, second, third):
    """Shifts of a Gaussian's roll and two tilts, and its pole.

    The rules of turns begin at number `rule`; `octaves` is the class of the Gaussian.
    """
    alike = _alike(second, third)
    longest = rule_shift(numbers, limits, rule, octaves, opacity, first, second, third, alike)
    alike = _alike(third, first)
    middle = rule_shift(numbers, limits, rule + 1, octaves, opacity, first, second, third, alike)
    alike = _alike(first, second)
    shortest = rule_shift(numbers, limits, rule + 2, octaves, opacity, first, second, third, alike)
    if shortest > longest:
        return shortest, middle, longest, 2
    return longest, middle, shortest, 0


@kernel
def _turn_shifts(numbers, limits, classes, opacity, scales, shifts, poles):
    for i in range(len(poles)):
        shifts[0, i], shifts[1, i], shifts[2, i], poles[i] = turns_of(
            numbers, limits, 0, np.int64(classes[i]), opacity[i],
            scales[0, i], scales[1, i], scales[2, i],
        )  # fmt: skip


def turn_shifts(
    rules: Mapping[str, StepRule],
    classes: NDArray[np.integer],
    opacity: NDArray[np.int64],
    scales: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int8]]:
    """Shifts ``(3, n)`` of `TURNS`, and the poles ``(n,)``: 0 the longest axis, 2 the shortest.

    ``opacity (n,)`` and ``scales (3, n)`` are fixed-point values.
    """
    numbers, limits = packed_rules([rules[name] for name in TURN_RULES])
    shifts = np.empty((3, len(classes)), np.int64)
    poles = np.empty(len(classes), np.int8)
    _turn_shifts(numbers, limits, classes, opacity, scales, shifts, poles)
    return shifts, poles


@kernel
def _quaternions(turns, poles, rot):
    for i in range(len(poles)):
        roll = min(max(turns[0, i], -1.0), 1.0)
        real = math.sqrt(1.0 - roll * roll)
        middle, third = turns[1, i], turns[2, i]
        square = middle * middle + third * third
        norm = math.sqrt(max(square, 1.0))
        upright = math.sqrt(max(1.0 - square, 0.0))
        middle, third = middle / norm, third / norm
        rot[0, i] = real * upright
        rot[1 + poles[i], i] = roll * upright
        # Axes in cyclic order from the pole: the middle axis comes first after pole 0, second after
        # pole 2.
        sign = 1.0 - poles[i]
        rot[2, i] = real * middle - sign * (roll * third)
        rot[3 - poles[i], i] = real * third + sign * (roll * middle)


def turned_quaternions(turns: NDArray[np.float64], poles: NDArray[np.int8]) -> NDArray[np.float32]:
    """Unit quaternions wxyz ``(4, n)`` with real parts >= 0.

    ``turns (3, n)`` are sines of half the angles of `TURNS`; values out of range are clamped.
    """
    rot = np.empty((4, len(poles)), np.float32)
    _quaternions(turns, poles, rot)
    return rot


@kernel
def _split_roll(vectors, poles, rolls, swings):
    for i in range(len(poles)):
        p = poles[i]
        a, b = (p + 1) % 3, (p + 2) % 3
        x, y, z = vectors[p, i], vectors[a, i], vectors[b, i]
        w = math.sqrt(max(1.0 - (x * x + y * y + z * z), 0.0))
        # Half turns about the axes do not change the Gaussian.
        if w * w + x * x < y * y + z * z:
            w, x, y, z = -y, -z, w, x
        if abs(x) > abs(w):
            w, x, y, z = -x, w, z, -y
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        norm = math.sqrt(w * w + x * x)
        cosine, sine = w / norm, x / norm
        rolls[i] = sine
        swings[0, i] = y * cosine - z * sine
        swings[1, i] = y * sine + z * cosine


def split_roll(
    vectors: NDArray[np.float64], poles: NDArray[np.int8]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Split quaternions with vector parts ``(3, n)`` into rolls ``(n,)`` and swings ``(2, n)``.

    All are sines of half angles, within 45 degrees. A swing has two components in the unrolled
    frame, along the axes that follow the pole in cyclic order.
    """
    rolls, swings = np.empty(len(poles)), np.empty((2, len(poles)))
    _split_roll(vectors, poles, rolls, swings)
    return rolls, swings


def tilts_of(
    swings: NDArray[np.float64], rolls: NDArray[np.float64], poles: NDArray[np.int8]
) -> NDArray[np.float64]:
    """Convert swings to tilts ``(2, n)`` about the middle and third axis, given decoded rolls."""
    sines = np.clip(rolls, -1.0, 1.0)
    double = 2.0 * sines * np.sqrt(1.0 - sines * sines)
    cosines = 1.0 - 2.0 * sines * sines
    first = swings[0] * cosines + swings[1] * double
    second = swings[1] * cosines - swings[0] * double
    return np.where(poles == 0, [first, second], [second, first])
