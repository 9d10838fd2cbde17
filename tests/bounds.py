"""Compare errors of decoded values with the bounds implied by a file's step sizes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged, arrange_scene
from gs_codec.codecs.adaptive.lattice import LARGEST, to_float
from gs_codec.codecs.adaptive.rotation import LARGEST_STEP, TURNS
from gs_codec.codecs.adaptive.shape import Shape, ShapeQuantiser, walk_shape
from gs_codec.codecs.entropygs.symbols import order_like
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.lossless.lossless import lossless_order
from gs_codec.coding.axes import nearest_quaternions, sort_axes
from gs_codec.coding.clean import finite_ends, identity_for_zero
from gs_codec.coding.far import bring_nearer
from gs_codec.coding.morton import bit_layout
from gs_codec.coding.quantise import CentredQuantiser
from gs_codec.coding.ycocg import to_ycocg
from gs_codec.config import LOSSLESS, PROFILES, Config
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene

#: Name, errors and bounds of values; all ``(n,)``.
Errors = Iterator[tuple[str, NDArray[np.float64], NDArray[np.float64]]]

#: SH-AC pass at most one step of error on to neighbours.
_DIFFUSED = 1.5


def error_over_bound(
    scene: Scene, decoded: Scene, data: bytes, config: Config
) -> tuple[float, str]:
    """Largest ratio of an error to its bound (allowing for float32 rounding), and its name.

    Errors of clamped values are measured from the clamped value, those of far Gaussians from their
    new position. The scene was encoded camera-free. With `lossless`, any differing bit is an
    infinite error.
    """
    if config.profile != LOSSLESS:
        scene, _ = identity_for_zero(finite_ends(scene)[0])
    if config.profile == LOSSLESS:
        errors = _of_bits(scene, decoded, config)
    elif config.profile in PROFILES:
        errors = _of_channels(scene, decoded, data)
    else:
        errors = _of_lattices(scene, decoded, config)
    largest, where = 0.0, ""
    for name, error, bound in errors:
        if not np.isfinite(error).all():
            return math.inf, name
        ratio = float((error / bound).max(initial=0.0))
        if ratio > largest:
            largest, where = ratio, name
    return largest, where


def _of_bits(scene: Scene, decoded: Scene, config: Config) -> Errors:
    order = np.arange(scene.count) if config.keep_order else lossless_order(scene)
    for group in GROUPS:
        before, after = getattr(scene, group)[:, order], getattr(decoded, group)
        differs = before.view(np.uint32) != after.view(np.uint32)
        yield group, np.where(differs, np.inf, 0.0), np.ones(differs.shape)


def _ulp(values: NDArray) -> NDArray[np.float64]:
    """Maximum float32 rounding error of values of this size."""
    return np.spacing(np.abs(values).astype(np.float32)).astype(np.float64)


def _of_channels(scene: Scene, decoded: Scene, data: bytes) -> Errors:
    channels = inspect_bytes(data).channels
    scene, _ = bring_nearer(scene)
    ordered = scene.take(order_like(scene, [channel.quantiser for channel in channels[:6]]))
    for channel in channels:
        values = getattr(ordered, channel.group)[channel.index].astype(np.float64)
        result = getattr(decoded, channel.group)[channel.index].astype(np.float64)
        quantiser = channel.quantiser
        if isinstance(quantiser, CentredQuantiser):
            reach = quantiser.half_range
            values = values.clip(quantiser.centre - reach, quantiser.centre + reach)
        bound = 0.5000001 * quantiser.step + _ulp(result)
        yield channel.name, np.abs(values - result), bound


def _of_lattices(scene: Scene, decoded: Scene, config: Config) -> Errors:
    arranged = arrange_scene(scene, config, None)
    ordered = arranged.source.take(arranged.order)
    _, scales, vectors = sort_axes(ordered.log_scale, ordered.rot)
    quantiser = ShapeQuantiser(arranged.lattice, ordered.opacity[0], scales, vectors)
    shape = walk_shape(arranged.lattice, arranged.classes[0], quantiser)
    yield from _of_places(ordered, decoded, arranged, shape)
    yield from _of_shapes(ordered, decoded, arranged, quantiser)
    yield from _of_colours(ordered, decoded, arranged, shape)


def _of_places(ordered: Scene, decoded: Scene, arranged: Arranged, shape: Shape) -> Errors:
    """Positions are at the centres of cells as wide as the rule says, or narrower."""
    grid = arranged.lattice.grid
    rule = arranged.lattice.rules["position"]
    dropped = rule.shifts(arranged.classes[0], 3, shape.opacity, shape.scales)
    dropped = np.minimum(dropped, grid.total_bits)
    axes = bit_layout(grid.bits)[::-1]
    for axis, name in enumerate("xyz"):
        width = np.concatenate([[0], np.cumsum(axes == axis)])[dropped]
        values = ordered.positions[axis].astype(np.float64)
        result = decoded.positions[axis].astype(np.float64)
        bound = 0.5 * grid.step * 2.0**width + 2 * _ulp(result) + _ulp(values)
        yield name, np.abs(values - result), bound


def _of_shapes(
    ordered: Scene, decoded: Scene, arranged: Arranged, quantiser: ShapeQuantiser
) -> Errors:
    units = arranged.lattice.units
    originals = {
        "opacity": (ordered.opacity[0], decoded.opacity[0], "opacity"),
        **{f"scale_{k}": (quantiser.scales[k], decoded.log_scale[k], "scaling") for k in range(3)},
    }
    for name, (values, result, group) in originals.items():
        steps = to_float(units[group] << quantiser.shifts[name])
        values = np.clip(values.astype(np.float64), -LARGEST, LARGEST)
        yield name, np.abs(values - result), 0.5 * steps + 2.0**-20 + _ulp(result)
    rot = nearest_quaternions(quantiser.vectors, decoded.rot).astype(np.float64)
    # Rotations of spherical Gaussians are not coded.
    rounding = to_float(units["scaling"] << quantiser.shifts["scale_0"])
    turned = quantiser.scales[0] - quantiser.scales[2] > 0.5 * rounding
    apart = np.sqrt(np.sum((rot - decoded.rot) ** 2, axis=0))
    yield "rotation", np.where(turned, apart, 0.0), _of_turns(quantiser)


def _of_turns(quantiser: ShapeQuantiser) -> np.ndarray:
    """Maximum error of a quaternion that was quantised in three steps.

    A turn of sine s is rounded by at most half a step d, or not coded. Its angle, half of the
    rotation's, changes by at most d / 2 divided by the smallest cosine.
    """
    unit, total = quantiser.lattice.units["rotation"], 0.0
    rolls, *tilts = (
        (quantiser.targets[name], quantiser.levels[name] * to_float(unit << shifts), shifts)
        for name, shifts in ((name, quantiser.shifts[name]) for name in TURNS)
    )
    for turns in ([rolls], tilts):
        ends = [sum(turn[end] ** 2 for turn in turns) for end in (0, 1)]
        cosine = np.sqrt(np.maximum(1.0 - np.maximum(*ends), 1e-12))
        steps = [to_float(unit << shifts) for _, _, shifts in turns]
        half = [np.where(d > LARGEST_STEP, math.sqrt(0.5), 0.5 * d) for d in steps]
        total = total + np.sqrt(sum((h + 2.0**-20) ** 2 for h in half)) / cosine
    return total + 2.0**-20


def _of_colours(ordered: Scene, decoded: Scene, arranged: Arranged, shape: Shape) -> Errors:
    rule, units = arranged.lattice.rules["colour"], arranged.lattice.units
    shifts = rule.shifts(arranged.classes[1], 1, shape.opacity, shape.scales)
    coefficients = SH_COEFFICIENTS[ordered.sh_degree]
    rest = [s.f_rest.reshape(3, coefficients, s.count) for s in (ordered, decoded)]
    groups = [("sh-dc", ordered.f_dc, decoded.f_dc, 0.5)]
    for k in range(coefficients):
        groups.append((f"sh{1 + (k > 2) + (k > 7)}", rest[0][:, k], rest[1][:, k], _DIFFUSED))
    for name, before, after, reach in groups:
        values, result = (np.clip(to_ycocg(rgb), -LARGEST, LARGEST) for rgb in (before, after))
        bound = 1.0001 * reach * to_float(units[name] << shifts)
        yield name, np.abs(values - result), bound + 2.0**-19 + np.abs(values) * 2.0**-21
