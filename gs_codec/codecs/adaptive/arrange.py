"""Choose the lattices and the stream order of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.grid import Bounds, choose_grid
from gs_codec.codecs.adaptive.lattice import (
    FRACTION_BITS,
    LARGEST,
    MAX_SHIFT,
    Lattice,
    PositionGrid,
    grid_codes,
)
from gs_codec.codecs.adaptive.step_conversion import as_deep, mean_octaves
from gs_codec.codecs.adaptive.step_sizes import (
    COARSEST,
    SH_RATIO,
    SHAPE_RULES,
    StepSizes,
    blind_coefficients,
    features,
    finest_step,
    make_rule,
)
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.exact_math import combine
from gs_codec.coding.morton import canonical_order, in_stream_order
from gs_codec.config import Config
from gs_codec.runtime.arrays import current
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

#: Log2 of the finest fixed-point unit.
_FINEST = -18

#: Finest fixed-point unit of SH-AC: the magnitudes of 45 levels of values up to 400 then sum to
#: less than 2**30, the limit of tokens.
_FINEST_SH = 32

#: Maximum bits of a fixed-point step size.
_STEP_BITS = 31

#: Target size of the sample that units and the grid are chosen from; the actual size is less than
#: twice this.
_SAMPLE = 100_000

#: Number of Gaussians per task when positions are put on the grid.
_CHUNK = 1 << 16


@dataclass(frozen=True)
class Arranged:
    """A scene to code, its lattices, and arrays in stream order.

    ``order (N,)`` has the index of each Gaussian in the scene, ``codes (N,)`` are the `grid_codes`,
    ascending, and ``classes (2, N)`` are shape classes and colour classes. The encoder keeps
    decoded values of the Gaussians in `watched`.
    """

    source: Scene
    order: NDArray[np.uint32]
    lattice: Lattice
    codes: NDArray[np.int64]
    classes: NDArray[np.uint8]
    watched: Watched | None = None
    may_have_basis: bool = True


def arrange_scene(
    scene: Scene,
    config: Config,
    given: StepSizes | None,
    block: int | None = None,
    may_have_far: bool = True,
    watched: Watched | None = None,
) -> Arranged:
    """Choose the lattices and the stream order of a scene; camera-free if `given` is None.

    With `block`, Gaussians are sorted only within each run of `block` Gaussians. Without
    `may_have_far`, the position grid spans all Gaussians. See `Arranged` for `watched`. Raises
    ValueError if `given` has another number of Gaussians than the scene.
    """
    some = slice(None, None, sample_stride(scene.count))
    opacity = scene.opacity[0, some]
    _, sampled, _ = sort_axes(scene.log_scale[:, some], scene.rot[:, some])
    steps = given
    if steps is None:
        steps = _blind_steps(scene.count, sampled, config)
    elif len(steps.shape_class) != scene.count:
        raise ValueError(
            f"steps of {counted(len(steps.shape_class), 'Gaussian')}, expected {scene.count:,}"
        )
    if config.depths and scene.count:
        known = features(opacity, sampled)
        steps = as_deep(steps, some, known, mean_octaves(scene, config.asked_depths()))
    places = scene.positions[:, some], _bounds(scene.positions), may_have_far
    lattice = _lattice(opacity, sampled, some, steps, *places)
    codes = _codes(scene, lattice.grid)
    order = canonical_order(codes) if block is None else order_within(codes, block)
    keep = current().keep
    classes = keep(np.stack([steps.shape_class[order], steps.colour_class[order]]))
    codes, narrow = keep(codes[order]), order.astype(np.uint32)
    if watched is not None:
        watched.settle(order)
    if given is None:
        scene, narrow = in_stream_order(scene, narrow)
    has_basis = config.effort != "fast"
    return Arranged(scene, narrow, lattice, codes, classes, watched, has_basis)


def rearranged(arranged: Arranged, source: Scene) -> Arranged:
    """Arrange a changed source on the same lattices; each Gaussian keeps its classes."""
    codes = _codes(source, arranged.lattice.grid)
    order = canonical_order(codes)
    classes = np.empty_like(arranged.classes)
    classes[:, arranged.order] = arranged.classes
    if arranged.watched is not None:
        arranged.watched.settle(order)
    keep = current().keep
    return replace(
        arranged,
        source=source,
        order=order.astype(np.uint32),
        codes=keep(codes[order]),
        classes=keep(np.take(classes, order, axis=1)),
    )


def sample_stride(count: int) -> int:
    """Stride of the sample of `count` Gaussians that lattices are chosen from."""
    return max(1, count // _SAMPLE)


def blind_lattice(
    sample: Scene, bounds: Bounds, config: Config, may_have_far: bool = True
) -> Lattice:
    """The lattices that `arrange_scene` chooses without cameras, from a sample of the scene.

    Parameters
    ----------
    sample : Scene
        Every `sample_stride`-th Gaussian of the scene.
    bounds : tuple of two ndarray, shape (3,)
        Lowest and highest x, y, z of the centres of the whole scene.
    config : Config
        Its `depths` must be empty.
    may_have_far : bool
        As for `arrange_scene`.
    """
    _, scales, _ = sort_axes(sample.log_scale, sample.rot)
    steps = _blind_steps(sample.count, scales, config)
    places = sample.positions, bounds, may_have_far
    return _lattice(sample.opacity[0], scales, slice(None), steps, *places)


def _blind_steps(count: int, scales: NDArray[np.float64], config: Config) -> StepSizes:
    """Camera-free step sizes of `count` Gaussians, from the sorted log-scales of a sample."""
    none, fineness = np.zeros(count, np.uint8), config.adaptive_profile().fineness
    return StepSizes(none, none, blind_coefficients(scales, fineness), (SH_RATIO,) * 3)


def _bounds(positions: NDArray[np.float32]) -> Bounds | None:
    """Lowest and highest coordinates ``(3,)``; None if there are no Gaussians."""
    return (positions.min(axis=1), positions.max(axis=1)) if positions.size else None


def order_within(codes: NDArray[np.int64], block: int) -> NDArray[np.int64]:
    """Permutation ``(N,)`` that sorts each run of `block` Gaussians by their codes."""
    starts = range(0, len(codes), block)
    order = np.empty(len(codes), np.int64)

    def work(start: int) -> None:
        order[start : start + block] = start + canonical_order(codes[start : start + block])

    run_all(work, starts)
    return order


def _codes(scene: Scene, grid: PositionGrid) -> NDArray[np.int64]:
    """Apply `grid_codes` in parallel."""
    codes = np.empty(scene.count, np.int64)

    def work(start: int) -> None:
        span = slice(start, start + _CHUNK)
        codes[span] = grid_codes(scene.positions[:, span], grid)

    run_all(work, range(0, scene.count, _CHUNK))
    return codes


def _lattice(
    opacity: NDArray[np.float32],
    scales: NDArray[np.float64],
    some: slice,
    steps: StepSizes,
    positions: NDArray[np.float32],
    bounds: Bounds | None,
    may_have_far: bool,
) -> Lattice:
    """Choose the lattices from the sample `some`; its log-scales are sorted by length."""
    known = features(opacity, scales)

    def wanted(name: str) -> NDArray[np.float64]:
        octaves = steps.colour_class if name == "colour" else steps.shape_class
        return octaves[some] + combine(steps.coefficients[name], known)

    rules, units = {}, {}
    for group, members in {**SHAPE_RULES, "colour": ("colour",)}.items():
        coarsest = COARSEST[group]
        finest = min(finest_step(wanted(name), _FINEST, coarsest) for name in members)
        units[group] = round(2.0 ** (finest + FRACTION_BITS))
        for name in members:
            unit = math.log2(units[group]) - FRACTION_BITS
            rules[name] = make_rule(steps.coefficients[name], unit, coarsest)
    units["sh-dc"] = units.pop("colour")
    for band, ratio in enumerate(steps.sh_ratios, 1):
        largest = (1 << (_STEP_BITS - rules["colour"].limit)) - 1
        units[f"sh{band}"] = round(min(max(units["sh-dc"] * ratio, _FINEST_SH), largest))
    grid, unit = choose_grid(bounds, positions, wanted("position"), may_have_far)
    rules["position"] = make_rule(np.zeros(5), 0, 0)
    if bounds is not None:
        slopes = steps.coefficients["position"]
        rules["position"] = make_rule(slopes, unit, unit + MAX_SHIFT, thirds=True)
    centres = (_median(opacity), _median(known[2]))
    classes = (
        1 + int(steps.shape_class.max(initial=0)),
        1 + int(steps.colour_class.max(initial=0)),
    )
    return Lattice(grid, classes, centres, units, rules)


def _median(values: NDArray) -> int:
    middle = float(np.median(np.clip(values, -LARGEST, LARGEST))) if len(values) else 0.0
    return round(middle * (1 << FRACTION_BITS))
