"""Expected decoded values of profiles l, m and s: shapes on lattices, positions in cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gs_codec.codecs import decode_scene
from gs_codec.codecs.adaptive.arrange import Arranged, arrange_scene
from gs_codec.codecs.adaptive.lattice import LARGEST, to_float
from gs_codec.codecs.adaptive.rotation import LARGEST_STEP, TURNS, turned_quaternions
from gs_codec.codecs.adaptive.shape import Shape, ShapeQuantiser, walk_shape
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.clean import identity_for_zero
from gs_codec.coding.count_tree import encode_tree
from gs_codec.coding.morton import bit_layout
from gs_codec.coding.ycocg import to_ycocg
from gs_codec.config import Config
from gs_codec.egs.egs_file import read_file
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene


@dataclass(frozen=True)
class Shaped:
    """A scene in stream order, and its shapes on their lattices."""

    arranged: Arranged
    scene: Scene
    quantiser: ShapeQuantiser
    shape: Shape

    @classmethod
    def of(cls, scene: Scene, profile: str, guide=None, depths=None) -> Shaped:
        """Arrange and shape a scene like the encoder."""
        clean, _ = identity_for_zero(scene)
        config = Config(profile, depths or {})
        steps = guide(clean, config) if guide is not None and clean.count else None
        arranged = arrange_scene(clean, config, steps)
        ordered = arranged.source.take(arranged.order)
        _, scales, vectors = sort_axes(ordered.log_scale, ordered.rot)
        quantiser = ShapeQuantiser(arranged.lattice, ordered.opacity[0], scales, vectors)
        shape = walk_shape(arranged.lattice, arranged.classes[0], quantiser)
        return cls(arranged, ordered, quantiser, shape)


def assert_on_lattices(shaped: Shaped, data: bytes, ac_steps: float) -> None:
    """Shapes equal those of `shaped`; everything is within half a step of the original.

    SH-AC are within `ac_steps` steps. Values beyond `LARGEST` are clamped.
    """
    decoded, lattice, shape = decode_scene(data), shaped.arranged.lattice, shaped.shape
    assert (decoded.count, decoded.sh_degree) == (shaped.scene.count, shaped.scene.sh_degree)
    for group in GROUPS:
        plane = getattr(decoded, group)
        assert plane.dtype == np.float32
        assert plane.shape == getattr(shaped.scene, group).shape
        assert np.isfinite(plane).all()
    np.testing.assert_array_equal(decoded.opacity[0], np.float32(to_float(shape.opacity)))
    np.testing.assert_array_equal(decoded.log_scale, np.float32(to_float(shape.scales)))
    np.testing.assert_array_equal(
        decoded.rot, turned_quaternions(to_float(shape.turns), shape.poles)
    )
    quantiser, units = shaped.quantiser, lattice.units
    _, scales, _ = sort_axes(shaped.scene.log_scale, shaped.scene.rot)
    originals = {"opacity": (shaped.scene.opacity[0], to_float(shape.opacity))}
    for k in range(3):
        originals[f"scale_{k}"] = (scales[k], to_float(shape.scales[k]))
        originals[TURNS[k]] = (quantiser.targets[TURNS[k]], to_float(shape.turns[k]))
    for name, (original, values) in originals.items():
        group = {"o": "opacity", "s": "scaling", "r": "rotation", "t": "rotation"}[name[0]]
        steps = to_float(units[group] << quantiser.shifts[name].astype(np.int64))
        usual = np.abs(scales).max(axis=0, initial=0) <= LARGEST
        if group == "rotation":
            rounding = to_float(units["scaling"] << quantiser.shifts["scale_0"])
            usual &= (steps <= LARGEST_STEP) & (scales[0] - scales[2] > 0.5 * rounding)
        error = np.abs(original.astype(np.float64) - values)
        assert np.all(error[usual] <= 0.5 * steps[usual] + 2.0**-20), name
    assert_in_cells(shaped, decoded, data)
    rule = lattice.rules["colour"]
    shifts = rule.shifts(shaped.arranged.classes[1], 1, shape.opacity, shape.scales)
    for name, groups, reach in colour_groups(shaped.scene, decoded, ac_steps):
        steps = to_float(units[name] << shifts)
        original, values = (np.clip(to_ycocg(g), -LARGEST, LARGEST) for g in groups)
        rounding = 2.0**-19 + np.abs(original) * 2.0**-21
        assert np.all(np.abs(original - values) <= reach * steps + rounding), name


def colour_groups(scene: Scene, decoded: Scene, ac_steps: float):
    yield "sh-dc", (scene.f_dc, decoded.f_dc), 0.5
    coefficients = SH_COEFFICIENTS[scene.sh_degree]
    pairs = [s.f_rest.reshape(3, coefficients, scene.count) for s in (scene, decoded)]
    for k in range(coefficients):
        band = 1 + (k > 2) + (k > 7)
        yield f"sh{band}", (pairs[0][:, k], pairs[1][:, k]), ac_steps


def assert_in_cells(shaped: Shaped, decoded: Scene, data: bytes) -> None:
    """Positions are at the centres of cells as wide as the rule says, or narrower."""
    header, lattice = read_file(data).header, shaped.arranged.lattice
    shape, grid = shaped.shape, lattice.grid
    dropped = lattice.rules["position"].shifts(
        shaped.arranged.classes[0], 3, shape.opacity, shape.scales
    )
    axes = np.array(bit_layout(grid.bits)[::-1])
    for block in range(header.block_count):
        span = slice(*header.block_range(block))
        _, lefts = encode_tree(shaped.arranged.codes[span], grid.total_bits)
        bits = np.minimum(dropped[span], lefts)
        for axis in range(3):
            width = np.concatenate([[0], np.cumsum(axes == axis)])[bits]
            original = shaped.scene.positions[axis, span].astype(np.float64)
            error = np.abs(original - decoded.positions[axis, span])
            largest = max(np.abs(s.positions[axis]).max() for s in (shaped.scene, decoded))
            rounding = 2 * np.spacing(largest)
            assert np.all(error <= 0.5 * grid.step * 2.0**width + rounding)
