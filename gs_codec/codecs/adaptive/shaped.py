"""A scene whose shapes are quantised, and whose values may still change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged, rearranged
from gs_codec.codecs.adaptive.blocks import ShapedBlock, code_dc, shape_block
from gs_codec.codecs.adaptive.lattice import to_float
from gs_codec.codecs.adaptive.rotation import LARGEST_STEP, turn_shifts
from gs_codec.coding.ycocg import from_ycocg
from gs_codec.config import SH_STREAMS
from gs_codec.egs.header import Header
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, gather, inverse_of

#: Rows of `ShapedScene.value_steps`.
VALUES = 13


@dataclass(frozen=True)
class ShapedScene:
    """A scene with everything quantised except its colours."""

    header: Header
    arranged: Arranged
    blocks: list[ShapedBlock]

    @property
    def source(self) -> Scene:
        """The scene, with its current colours."""
        return self.arranged.source

    @property
    def order(self) -> NDArray[np.uint32]:
        """Index in the source of each Gaussian, ``(N,)``, in stream order."""
        return self.arranged.order

    def decoded(self) -> Scene:
        """The decoded scene in stream order, except for its SH, which is still the source's."""
        shapes: dict[str, Any] = self.decoded_shapes()
        return replace(self.source.take(self.order), **shapes)

    def decoded_shapes(self) -> dict[str, NDArray[np.float32]]:
        """All groups of `decoded` but its SH, by name."""
        opacity = np.concatenate([block.shape.opacity for block in self.blocks])
        decoded = [block.decoded(self.arranged.lattice.grid) for block in self.blocks]
        positions, log_scale, rot = (np.concatenate(p, axis=1) for p in zip(*decoded, strict=True))
        shapes = {"positions": positions, "log_scale": log_scale, "rot": rot}
        return shapes | {"opacity": np.float32(to_float(opacity))[None]}

    def decoded_dc(self) -> NDArray[np.float32]:
        """Decoded SH-DC ``(3, N)`` in stream order."""
        coded = run_all(lambda block: code_dc(self.arranged, block).values, self.blocks)
        return from_ycocg(to_float(np.concatenate(coded, axis=1)))

    def sh_steps(self) -> NDArray[np.float32]:
        """Step sizes of SH-AC of each band, ``(3, N)`` in stream order."""
        shifts = np.concatenate([block.shifts for block in self.blocks])
        units = np.array([[self.arranged.lattice.units[stream]] for stream in SH_STREAMS])
        return to_float(units << shifts).astype(np.float32)

    def value_steps(self) -> NDArray[np.float32]:
        """Step sizes of all values but SH-AC, ``(13, N)`` in stream order.

        The rows are three for positions, three for SH-DC, one for opacity, three for log-scales
        (descending) and three for turns about these axes, in radians. Positions of far Gaussians
        have 0, because they are stored exactly.
        """
        return np.concatenate(run_all(self._value_steps, self.blocks), axis=1)

    def _value_steps(self, block: ShapedBlock) -> NDArray[np.float32]:
        lattice, shape = self.arranged.lattice, block.shape
        classes = self.arranged.classes[0, block.start : block.stop]
        steps = np.empty((VALUES, len(classes)))
        # A cell's centre, in half steps, is an odd multiple of half its side.
        sides = block.grid_positions & -block.grid_positions
        steps[:3] = sides * lattice.grid.step
        steps[:3, len(classes) - block.far.shape[1] :] = 0.0
        steps[3:6] = to_float(lattice.units["sh-dc"] << block.shifts)
        for row, (name, group) in enumerate(_BY_RULE.items(), 6):
            shifts = lattice.rules[name].shifts(classes, 1, shape.opacity, shape.scales)
            steps[row] = to_float(lattice.units[group] << shifts)
        shifts, poles = turn_shifts(lattice.rules, classes, shape.opacity, shape.scales)
        # Sines of half angles are coded.
        turns = 2 * np.minimum(to_float(lattice.units["rotation"] << shifts), LARGEST_STEP)
        roll, middle, third = turns
        steps[10:] = np.where(poles == 0, [roll, middle, third], [third, middle, roll])
        return steps.astype(np.float32)

    def with_colours(self, coloured: Scene) -> ShapedScene:
        """Replace the SH by that of `coloured`, which is in stream order."""
        source = self.changed_source(coloured, ("f_dc", "f_rest"))
        return replace(self, arranged=replace(self.arranged, source=source))

    def changed_source(self, scene: Scene, groups: Sequence[str]) -> Scene:
        """The source with groups of values of `scene`, which is in stream order."""
        places = inverse_of(self.order)
        changes: dict[str, Any] = {group: gather(getattr(scene, group), places) for group in groups}
        return replace(self.source, **changes)

    def in_stream_order(self) -> ShapedScene:
        """The same with its source in stream order, for many changes; nothing is watched."""
        order = np.arange(len(self.order), dtype=self.order.dtype)
        source = self.source.take(self.order)
        arranged = replace(self.arranged, source=source, order=order, watched=None)
        return replace(self, arranged=arranged)

    def reshaped(self, source: Scene) -> ShapedScene:
        """Quantise a changed source on the same lattices, with the classes of each Gaussian."""
        arranged = rearranged(self.arranged, source)
        blocks = run_all(lambda span: shape_block(arranged, *span), spans(self.header))
        return ShapedScene(self.header, arranged, blocks)


#: The rules of rows 6 to 9 of `value_steps`, and the group that each belongs to.
_BY_RULE = {"opacity": "opacity", **{f"scale_{k}": "scaling" for k in range(3)}}


def spans(header: Header) -> list[tuple[int, int]]:
    """First and end Gaussian of each block, in stream order."""
    return [header.block_range(block) for block in range(header.block_count)]
