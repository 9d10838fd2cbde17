"""Which values of a block change in a frame, and by how many steps: the encoder of `motion`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, LARGEST, to_fixed
from gs_codec.codecs.adaptive.moving_block import (
    AC,
    CHANNELS,
    DC,
    PLACE,
    PLACE_LIMIT,
    SHAPE,
    TURN,
    Changes,
    Frame,
    MovingBlock,
    rescaled,
)
from gs_codec.coding.axes import reordered, sort_axes
from gs_codec.coding.binary import encode_binary
from gs_codec.coding.ycocg import take_colours, to_ycocg
from gs_codec.scene import GROUPS, Scene, take_columns

#: Changes of a value below this share of its step size are not coded, so that a trainer's noise
#: costs nothing.
_STILL = 0.125

#: Fraction of a step from which a change of each part is rounded up. More than half saves bytes,
#: but also quality where it is centres, whose errors dominate those of views.
_UP = {SHAPE: 0.6, TURN: 0.6, PLACE: 0.5, DC: 0.6}

#: Turns with larger steps show no rotation; such a step instead makes them 0.
_MOST_TURN = 3 << (FRACTION_BITS - 2)
_NEVER = 1 << 60

#: A far Gaussian moves if its centre does by this share of its distance from the grid's origin.
_FAR_STEP = 1e-3


class BlockEncoder:
    """Encodes the frames of a block after its key frame.

    Parameters
    ----------
    block : MovingBlock
    members : ndarray, shape (n,)
        Index in the source of each Gaussian of the block.
    source : Scene
        The key frame's source.
    """

    def __init__(self, block: MovingBlock, members: NDArray[np.integer], source: Scene) -> None:
        self.block, self.members = block, members
        # The axes stay in the order of the key frame.
        scales, rot = take_columns(source.log_scale, members), take_columns(source.rot, members)
        self._axes, _, _ = sort_axes(scales, rot)
        every = np.arange(len(members))
        self._coded = self._values(source, every)
        self._steps = [
            block.steps(part, block.frame.shape, every).copy() for part in range(len(CHANNELS))
        ]
        #: Gaussians that may need a change although they stay as they are.
        self._again = np.zeros(len(members), np.bool_)

    def _values(self, source: Scene, some: NDArray[np.integer]) -> list[NDArray]:
        """Source values of some Gaussians: one array ``(C, m)`` for each part, in its units."""
        members = self.members[some]
        planes = {group: take_columns(getattr(source, group), members) for group in GROUPS}
        axes = self._axes[:, some]
        grid = self.block.lattice.grid
        shape = np.concatenate(
            [planes["opacity"], np.take_along_axis(planes["log_scale"], axes, axis=0)]
        )
        places = planes["positions"].astype(np.float64) - np.array(grid.origin)[:, None]
        coefficients = len(self.block.units)
        ac: NDArray[np.float32] = np.zeros((3, coefficients, len(some)), np.float32)
        if coefficients:
            rest = np.ascontiguousarray(planes["f_rest"]).reshape(3, coefficients, -1)
            every, none = np.arange(len(some)), np.zeros(len(some), np.int64)
            taken, _ = take_colours(rest, every, self.block.units, none, LARGEST)
            ac = taken.reshape(rest.shape)
            if (bases := self.block.bases) is not None:
                ac = bases.components_of(ac, some, self.block.count)
        return [
            to_fixed(shape.astype(np.float64), LARGEST)[0].astype(np.float64),
            reordered(planes["rot"], axes),
            np.clip(places / (0.5 * grid.step), -PLACE_LIMIT / 2, PLACE_LIMIT / 2),
            to_fixed(to_ycocg(planes["f_dc"]), LARGEST)[0].astype(np.float64),
            ac,
        ]

    def encode(self, source: Scene, moved: NDArray[np.bool_]) -> tuple[bytes, Frame]:
        """Encode the next frame; return its bytes, and the decoded frame.

        ``moved (N,)`` are the Gaussians of the source that are not as in the frame before.
        """
        wanted = self._changes(source, np.flatnonzero(moved[self.members] | self._again))
        coded: list[Frame] = []

        def model(state: NDArray, data: NDArray) -> None:
            coded.append(self.block.walk(state, data, wanted))

        data = encode_binary(model, int(np.count_nonzero(wanted.flags)) * 8)
        return data, coded[-1]

    def _changes(self, source: Scene, some: NDArray[np.integer]) -> Changes:
        """What changes by enough to be coded, of some Gaussians."""
        block, last, count = self.block, self.block.frame, self.block.count
        changes = Changes(np.zeros((5, count), np.uint8))
        found = self._values(source, some)
        shape = last.shape.copy()
        for part, own in enumerate(found[:AC]):
            steps = block.steps(part, last.shape if part == SHAPE else shape, some)
            if part == TURN:
                steps = np.where(steps > _MOST_TURN, _NEVER, steps)
            since, left = self._differences(part, own, steps, some)
            # Finer steps than those it was coded with show errors that were allowed.
            changed = (np.abs(since) > _STILL * steps) | (steps < self._steps[part][:, some])
            if part == TURN:
                changed = changed.any(axis=0)
            sizes = np.where(changed, np.floor(np.abs(left) / steps + (1.0 - _UP[part])), 0)
            levels = np.copysign(sizes, left).astype(np.int64)
            wanted = (levels != 0).any(axis=0)
            if part == PLACE:
                self._set_far(source, changes, wanted, some)
            members = some[wanted]
            changes.flags[part, members] = 1
            near = members < count - last.far.shape[1] if part == PLACE else slice(None)
            changes.levels[part] = levels[:, wanted][:, near]
            self._coded[part][:, some] = np.where(changed, own, self._coded[part][:, some])
            self._steps[part][:, some] = np.where(changed, steps, self._steps[part][:, some])
            if part == SHAPE:
                shape[:, members] += levels[:, wanted] * steps[:, wanted]
                # Its steps are those of the shape before; the next frame applies finer ones.
                finer = block.steps(SHAPE, shape, some) < self._steps[SHAPE][:, some]
                self._again[some] = finer.any(axis=0)
        self._add_levels(changes, found[AC], shape, some)
        return changes

    def _differences(
        self, part: int, own: NDArray, steps: NDArray, some: NDArray[np.integer]
    ) -> tuple[NDArray, NDArray]:
        """Differences of values to those that were coded last, and to decoded ones."""
        coded, last = self._coded[part][:, some], self.block.frame
        if part != TURN:
            return own - coded, own - self._decoded(last, part)[:, some]
        unit = 1 << FRACTION_BITS
        left = turns_between(last.rot[:, some], own) * unit
        return turns_between(coded, own) * unit, _settled(left, steps)

    def _decoded(self, last: Frame, part: int) -> NDArray[np.int64]:
        return {SHAPE: last.shape, PLACE: last.places, DC: last.colours}[part]

    def _set_far(
        self,
        source: Scene,
        changes: Changes,
        wanted: NDArray[np.bool_],
        some: NDArray[np.integer],
    ) -> None:
        """Decide which far Gaussians move, in `wanted`, and note their centres."""
        far = self.block.frame.far
        first = self.block.count - far.shape[1]
        at = np.flatnonzero(some >= first)
        own, old = source.positions[:, self.members[some[at]]], far[:, some[at] - first]
        distance = np.abs(old - np.array(self.block.lattice.grid.origin)[:, None]).max(axis=0)
        wanted[at] = np.abs(own - old).max(axis=0) > _FAR_STEP * distance
        changes.far = np.ascontiguousarray(own[:, wanted[at]])

    def _add_levels(
        self,
        changes: Changes,
        values: NDArray[np.float32],
        shape: NDArray[np.int64],
        some: NDArray[np.integer],
    ) -> None:
        """Find the levels of SH-AC that change."""
        block, last = self.block, self.block.frame
        if not len(block.units):
            return
        shifts = block.colour_shifts(shape, some)
        steps = np.ldexp(1.0, shifts.astype(np.int32))
        old = rescaled(last.levels[:, :, some], shifts - last.shifts[some])
        coded = self._coded[AC][:, :, some]
        changed = np.abs(values - coded) > _STILL * steps
        changed |= shifts < last.shifts[some]
        levels = np.where(changed, np.floor(values / steps + 0.5), old).astype(np.int64)
        wanted = (levels != old).any(axis=(0, 1))
        members = some[wanted]
        changes.flags[AC, members] = 1
        changes.levels[AC] = levels[:, :, wanted]
        self._coded[AC][:, :, members] = np.where(changed, values, coded)[:, :, wanted]


def turns_between(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sines of half the angles about their own axes ``(3, m)`` that turn Gaussians.

    ``before (4, m)`` and ``after (4, m)`` are unit quaternions; of the half turns that leave a
    Gaussian as it is, those that make the turn smallest are applied.
    """
    a, b, c, d = before
    w, x, y, z = after
    found = np.stack(
        [
            a * w + b * x + c * y + d * z,
            a * x - b * w - c * z + d * y,
            a * y + b * z - c * w - d * x,
            a * z - b * y + c * x - d * w,
        ]
    )
    w, x, y, z = found
    ways = np.array([(w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)])
    best = np.argmax(np.abs(ways[:, 0]), axis=0)
    w, x, y, z = np.take_along_axis(ways, best[None, None], axis=0)[0]
    return np.where(w < 0.0, -1.0, 1.0) * np.stack([x, y, z])


def _settled(turns: NDArray[np.float64], steps: NDArray[np.int64]) -> NDArray[np.float64]:
    """Equivalent turns ``(3, m)`` that can be rounded axis by axis to ``steps (3, m)``.

    The turn about the axis with the largest step becomes a multiple of it. Rounding that turn alone
    would tilt the other axes by more than their steps.
    """
    one = float(1 << FRACTION_BITS)
    axis = np.argmax(steps, axis=0)[None]
    step = np.take_along_axis(steps, axis, axis=0)[0] / one
    x, y, z = (np.take_along_axis(turns, (axis + k) % 3, axis=0)[0] / one for k in (1, 2, 0))
    w = np.sqrt(np.maximum(1.0 - (x * x + y * y + z * z), 0.0))
    length = np.hypot(w, z)
    most = np.floor(length / step)
    wanted = step * np.clip(np.floor(z / step + 0.5), -most, most)
    angle = np.arcsin(wanted / np.where(length > 0, length, 1.0)) - np.arctan2(z, w)
    c, s = np.cos(angle), np.sin(angle)
    found = np.empty_like(turns)
    for k, values in zip((1, 2, 0), (x * c + y * s, y * c - x * s, wanted), strict=True):
        np.put_along_axis(found, (axis + k) % 3, one * values[None], axis=0)
    return found
