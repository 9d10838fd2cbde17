"""Step sizes of profiles `l`, `m` and `s` from bit depths, and as numbers for other formats."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import LARGEST, to_fixed
from gs_codec.codecs.adaptive.rotation import TURN_RULES, likeness
from gs_codec.codecs.adaptive.step_sizes import (
    COARSEST,
    SH_RATIO,
    SHAPE_RULES,
    StepSizes,
    blind_coefficients,
    features,
)
from gs_codec.codecs.entropygs.section import channel_order
from gs_codec.codecs.entropygs.symbols import fit_channel
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.exact_math import combine
from gs_codec.coding.far import bring_nearer
from gs_codec.config import AdaptiveProfile
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.packed_values import spans
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Maximum difference between step sizes of SH-AC and SH-DC, in octaves.
_OCTAVES = 64.0


def mean_octaves(scene: Scene, depths: Mapping[str, int]) -> dict[str, float]:
    """Log2 of the geometric mean step size of each group in a paper profile with these depths.

    As in those profiles, far Gaussians are first moved nearer, and quaternions normalised. A
    constant group has no step size.
    """
    scene, _ = bring_nearer(scene)
    planes = {}
    if "rotation" in depths:
        # In float64, squares neither underflow nor overflow.
        norms = np.sqrt(np.sum(np.square(scene.rot, dtype=np.float64), axis=0))
        planes["rot"] = (scene.rot / norms).astype(np.float32)
    octaves: dict[str, list[float]] = {}
    for group, index, stream in channel_order(len(scene.f_rest) // 3):
        if stream in depths:
            row = np.ascontiguousarray(planes.get(group, getattr(scene, group))[index])
            quantiser, _ = fit_channel(row, group, depths[stream])
            if quantiser.depth:
                octaves.setdefault(stream, []).append(math.log2(quantiser.step))
    return {stream: float(np.mean(found)) for stream, found in octaves.items()}


def as_deep(
    steps: StepSizes, some: slice, known: NDArray[np.float64], octaves: Mapping[str, float]
) -> StepSizes:
    """Scale the step sizes of some groups so that their mean log2 equals the value in `octaves`.

    The mean is taken over `some` of the Gaussians, with features ``known (5, n)``; for turns, the
    mean excludes the octaves that `likeness` adds.
    """
    coefficients = {name: row.copy() for name, row in steps.coefficients.items()}

    def mean(*rules: str) -> float:
        classes = steps.colour_class if rules == ("colour",) else steps.shape_class
        by_rule = [combine(coefficients[rule], known) for rule in rules]
        return float(np.mean(classes[some], dtype=np.float64) + np.mean(by_rule))

    for group, members in {**SHAPE_RULES, "geometry": ("position",)}.items():
        if group in octaves:
            more = octaves[group] - mean(*members)
            for rule in members:
                coefficients[rule][0] += more
    before = mean("colour")
    colour = octaves.get("sh-dc", before)
    coefficients["colour"][0] += colour - before
    above = [
        octaves.get(f"sh{band}", math.log2(ratio) + before) - colour
        for band, ratio in enumerate(steps.sh_ratios, 1)
    ]
    ratios = [2.0 ** min(max(octave, -_OCTAVES), _OCTAVES) for octave in above]
    return replace(steps, coefficients=coefficients, sh_ratios=(ratios[0], ratios[1], ratios[2]))


#: Log2 of the smallest step size; and of the largest, by rule, as in an `.egs`.
_FINEST = -40.0
_COARSEST = {"position": 40, "colour": COARSEST["colour"]} | {
    rule: COARSEST[group] for group, rules in SHAPE_RULES.items() for rule in rules
}

#: The fractional parts of its multiples are spread evenly over 0 to 1.
_GOLDEN = 0.6180339887498949


def camera_free_steps(scene: Scene, profile: AdaptiveProfile) -> StepSizes:
    """The camera-free step sizes of a profile."""
    _, scales, _ = sort_axes(scene.log_scale, scene.rot)
    none = np.zeros(scene.count, np.uint8)
    return StepSizes(none, none, blind_coefficients(scales, profile.fineness), (SH_RATIO,) * 3)


def wanted_steps(scene: Scene, steps: StepSizes) -> AttributeSteps:
    """Step sizes of each attribute of a scene without NaN, infinity or quaternions of norm 0."""
    # Camera-guided step sizes are whole octaves apart. Without this dither, writers that round to
    # powers of two would switch all of them at once, and file sizes would jump.
    dithered = {
        rule
        for rule, row in steps.coefficients.items()
        if _octaves_of(rule, steps).any() and not row[1:].any()
    }
    wanted = AttributeSteps.of_size(scene.count)

    def fill(some: slice) -> None:
        wanted.set(some, _wanted(scene.between(some.start, some.stop), steps, some, dithered))

    run_all(fill, spans(scene.count))
    return wanted


def _octaves_of(rule: str, steps: StepSizes) -> NDArray[np.uint8]:
    return steps.colour_class if rule == "colour" else steps.shape_class


def _wanted(scene: Scene, steps: StepSizes, some: slice, dithered: set[str]) -> AttributeSteps:
    """Step sizes of the Gaussians `some`, which are those of `scene`."""
    axes, scales, _ = sort_axes(scene.log_scale, scene.rot)
    known = features(scene.opacity[0].astype(np.float64), scales)

    def wanted(rule: str, more: NDArray | float = 0.0) -> NDArray[np.float64]:
        whole = _octaves_of(rule, steps)[some] + combine(steps.coefficients[rule], known) + more
        if rule in dithered:
            whole += np.arange(some.start, some.stop) * _GOLDEN % 1 - 0.5
        return np.exp2(np.clip(whole, _FINEST, _COARSEST[rule]))

    alike = likeness(to_fixed(scales, LARGEST)[0])
    turns = np.stack([wanted(rule, more) for rule, more in zip(TURN_RULES, alike, strict=True)])
    by_length = np.stack([wanted(f"scale_{k}") for k in range(3)])
    log_scale = np.empty_like(by_length)
    np.put_along_axis(log_scale, axes.astype(np.int64), by_length, axis=0)
    colour = wanted("colour")
    return AttributeSteps(
        positions=wanted("position"),
        f_dc=colour,
        f_rest=colour * np.array(steps.sh_ratios)[:, None],
        opacity=wanted("opacity"),
        log_scale=log_scale,
        # Each quaternion component contributes to turns about all three axes.
        rot=np.mean(turns**-2.0, axis=0) ** -0.5,
    )
