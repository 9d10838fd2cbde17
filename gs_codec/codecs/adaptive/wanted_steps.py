"""Step sizes of profiles `l`, `m` and `s` as numbers, for writers of other formats."""

from __future__ import annotations

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
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.linear import combine
from gs_codec.config import AdaptiveProfile
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.scene import Scene

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
    axes, scales, _ = sort_axes(scene.log_scale, scene.rot)
    known = features(scene.opacity[0].astype(np.float64), scales)

    # Camera-guided step sizes are whole octaves apart. Without this dither, writers that round to
    # powers of two would switch all of them at once, and file sizes would jump.
    between = np.arange(scene.count) * _GOLDEN % 1 - 0.5

    def wanted(rule: str, more: NDArray | float = 0.0) -> NDArray[np.float64]:
        octaves = steps.colour_class if rule == "colour" else steps.shape_class
        row = steps.coefficients[rule]
        whole = octaves + combine(row, known) + more
        if octaves.any() and not row[1:].any():
            whole += between
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
