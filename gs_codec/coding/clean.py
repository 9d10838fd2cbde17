"""Clean a scene before coding: no NaN or infinity, no quaternions of norm 0."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import LOSSLESS, Config
from gs_codec.errors import InvalidInput
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene


def clean_scene(scene: Scene, config: Config) -> tuple[Scene, dict[str, Any]]:
    """Clean a scene; returns it and the fields of `EncodeReport` that count the changes.

    Profile ``lossless`` keeps every float, unless it is to drop those that are not finite.

    Raises
    ------
    InvalidInput
        If values are not finite and ``config.nonfinite`` is ``error``, except with ``lossless``.
    """
    exact = config.profile == LOSSLESS
    if exact and config.nonfinite == "error":
        return scene, {}
    scene, dropped = drop_nonfinite(scene, config)
    if exact:
        return scene, {"dropped": dropped}
    scene, zero_quaternions = identity_for_zero(scene)
    return scene, {"dropped": dropped, "zero_quaternions": zero_quaternions}


def drop_nonfinite(scene: Scene, config: Config) -> tuple[Scene, int]:
    """Drop Gaussians that hold NaN or infinity; returns the scene and their number.

    Raises
    ------
    InvalidInput
        If there are any and ``config.nonfinite`` is ``error``.
    """
    planes = [(group, row) for group in GROUPS for row in getattr(scene, group)]
    finite = run_all(lambda item: np.count_nonzero(np.isfinite(item[1])), planes)
    bad: Counter[str] = Counter()
    for (group, row), count in zip(planes, finite, strict=True):
        bad[group] += row.size - count
    if not bad.total():
        return scene, 0
    if config.nonfinite == "error":
        listed = ", ".join(f"{n} in {group}" for group, n in bad.items() if n)
        raise InvalidInput(f"values that are not finite: {listed}; --nonfinite drop removes them")
    keep = finite_gaussians(scene)
    return scene.take(keep), int(np.count_nonzero(~keep))


def finite_gaussians(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` hold neither NaN nor infinity."""
    finite = np.ones(scene.count, bool)
    for group in GROUPS:
        for row in getattr(scene, group):
            finite &= np.isfinite(row)
    return finite


def identity_for_zero(scene: Scene) -> tuple[Scene, int]:
    """Replace quaternions of norm 0 by the identity; returns the scene and their number."""
    zero = ~scene.rot.any(axis=0)
    count = int(np.count_nonzero(zero))
    if count:
        rot = empty(scene.rot.shape, np.float32)
        rot[:] = scene.rot
        rot[0, zero] = 1.0
        scene = replace(scene, rot=rot)
    return scene, count
