"""Convert bit depths given for profiles ``l``, ``m`` and ``s`` to step sizes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.step_sizes import SHAPE_RULES, StepSizes
from gs_codec.codecs.entropygs.section import channel_order
from gs_codec.codecs.entropygs.symbols import fit_channel
from gs_codec.coding.far import bring_nearer
from gs_codec.coding.linear import combine
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
