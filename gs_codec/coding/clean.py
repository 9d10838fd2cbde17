"""Replace or reject values that cannot be coded.

An opacity of +-infinity (1 or 0 after the sigmoid) and a log-scale of -infinity (flat) are valid;
readers replace them by finite numbers. Other infinities and NaN are damage.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gs_codec.config import LOSSLESS, Config
from gs_codec.errors import InvalidInput
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import GROUPS, Scene

log = logging.getLogger(__name__)

#: Logit that replaces +infinity (opacity 1); its negative replaces -infinity. The opacity changes
#: by 2^-25.
_OPAQUE = 17.328679

#: Log of the thickness given to flat Gaussians, relative to the shorter other axis: a ratio of
#: 5e-5, less than a pixel. Because the ratio is constant, it costs no bits in profiles `l`, `m` and
#: `s`.
_THICKNESS = np.float32(-10)

#: Minimum log-scale of that other axis.
_LEAST_AXIS = np.float32(-20)


class Ends(NamedTuple):
    """Number of Gaussians whose opacity was replaced, and number whose scale was."""

    opacity: int
    scale: int


def finite_ends(scene: Scene) -> tuple[Scene, Ends]:
    """Replace valid infinities by finite numbers that render the same."""
    ends, flat = np.isinf(scene.opacity), np.isneginf(scene.log_scale)
    counts = Ends(int(np.count_nonzero(ends)), int(np.count_nonzero(flat.any(axis=0))))
    if not any(counts):
        return scene, counts
    opacity, log_scale = (empty(p.shape, np.float32) for p in (scene.opacity, scene.log_scale))
    opacity[:] = np.where(ends, np.copysign(np.float32(_OPAQUE), scene.opacity), scene.opacity)
    log_scale[:] = np.where(flat, flat_scales(scene.log_scale), scene.log_scale)
    return replace(scene, opacity=opacity, log_scale=log_scale), counts


def flat_scales(log_scale: NDArray[np.float32]) -> NDArray[np.float32]:
    """Log-scales ``(N,)`` that replace -infinity, from ``(k, N)`` log-scales of all axes.

    The ratio is taken to the shortest axis that is not -infinity.
    """
    shorter = np.where(np.isneginf(log_scale), np.float32(np.inf), log_scale).min(axis=0)
    shorter = np.where(np.isposinf(shorter), _LEAST_AXIS, np.maximum(shorter, _LEAST_AXIS))
    with np.errstate(invalid="ignore"):  # comparing a signalling NaN warns
        return shorter + _THICKNESS


def with_finite_ends(scene: Scene, where: str | Path = "") -> Scene:
    """Apply `finite_ends`, and log what was replaced, with `where`."""
    scene, counts = finite_ends(scene)
    log_ends(counts, where)
    return scene


def log_ends(counts: Ends, where: str | Path = "") -> None:
    """Log what `finite_ends` replaced, if anything, in one line."""
    what = {"opacity 0 or 1": counts.opacity, "a scale of 0": counts.scale}
    if any(counts):
        found = " and ".join(f"{name} in {counted(n, 'Gaussian')}" for name, n in what.items() if n)
        where = f"{where}: " if where else ""
        log.warning("%s%s, read as finite values that look the same", where, found)


def clean_scene(scene: Scene, config: Config, whole: bool = True) -> tuple[Scene, dict[str, Any]]:
    """Clean a scene; return it and the `EncodeReport` fields that count the changes.

    Profile ``lossless`` keeps every float, unless ``config.nonfinite`` is ``drop``. A part of a
    scene (not `whole`) may end up empty. Raises InvalidInput if values are not finite and
    ``config.nonfinite`` is ``error``, except with ``lossless``; or if no Gaussian of a whole scene
    remains.
    """
    exact = config.profile == LOSSLESS
    if exact and config.nonfinite == "error":
        return scene, {}
    if not exact:
        scene, _ = finite_ends(scene)
    scene, dropped = drop_nonfinite(scene, config, whole)
    if exact:
        return scene, {"dropped": dropped}
    scene, zero_quaternions = identity_for_zero(scene)
    return scene, {"dropped": dropped, "zero_quaternions": zero_quaternions}


def drop_nonfinite(scene: Scene, config: Config, whole: bool = True) -> tuple[Scene, int]:
    """Drop Gaussians with NaN or damaged infinities; return the scene and how many were dropped.

    Raises InvalidInput if there are any and ``config.nonfinite`` is ``error``, or if the scene is
    `whole` and no Gaussian remains.
    """
    planes = [(group, row) for group in GROUPS for row in getattr(scene, group)]
    finite = run_all(lambda item: np.count_nonzero(_sound(*item)), planes)
    bad: Counter[str] = Counter()
    for (group, row), count in zip(planes, finite, strict=True):
        bad[group] += row.size - count
    if not bad.total():
        return scene, 0
    if config.nonfinite == "error":
        listed = ", ".join(f"{n} in {group}" for group, n in bad.items() if n)
        raise InvalidInput(f'values that are not finite: {listed}; nonfinite="drop" removes them')
    keep = sound_gaussians(scene)
    if whole and not keep.any():
        raise nothing_left(scene.count)
    return scene.take(keep), int(np.count_nonzero(~keep))


def nothing_left(count: int) -> InvalidInput:
    """The error for a scene of which all `count` Gaussians are damaged."""
    return InvalidInput(f"no Gaussian is left of {count:,}: all contain NaN or infinity")


def _sound(group: str, row: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which values of a channel are undamaged."""
    if group == "opacity":
        return ~np.isnan(row)
    return row < np.inf if group == "log_scale" else np.isfinite(row)


def sound_gaussians(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` have neither NaN nor damaged infinities."""
    sound = np.ones(scene.count, bool)
    for group in GROUPS:
        for row in getattr(scene, group):
            sound &= _sound(group, row)
    return sound


def finite_gaussians(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` have neither NaN nor infinity."""
    finite = np.ones(scene.count, bool)
    for group in GROUPS:
        for row in getattr(scene, group):
            finite &= np.isfinite(row)
    return finite


#: Minimum opacity of solid Gaussians, and its logit. Others say little about where surfaces are.
SOLID = 0.3
_SOLID_LOGIT = -0.85

#: If fewer Gaussians are solid, the most opaque ones are. In 16 real and generated captures, 25 to
#: 59 % are solid.
_LEAST_SOLID = 0.1


def solid_gaussians(
    opacity: NDArray[np.floating], usable: ArrayLike, least: float = _SOLID_LOGIT
) -> NDArray[np.integer]:
    """Indices of the solid Gaussians among usable ones; opacity ``(N,)`` are logits by default.

    Their opacity is above `least`. If fewer than a tenth are, as in smoke, the most opaque tenth.
    """
    found = np.flatnonzero(usable & ~np.isnan(opacity))
    values = opacity[found]
    solid, needed = values > least, math.ceil(_LEAST_SOLID * len(found))
    if np.count_nonzero(solid) < needed:
        solid = values >= np.partition(values, -needed)[-needed]
    return found[solid]


def identity_for_zero(scene: Scene) -> tuple[Scene, int]:
    """Replace quaternions of norm 0 by the identity; return the scene and their number."""
    zero = ~scene.rot.any(axis=0)
    count = int(np.count_nonzero(zero))
    if count:
        rot = empty(scene.rot.shape, np.float32)
        rot[:] = scene.rot
        rot[0, zero] = 1.0
        scene = replace(scene, rot=rot)
    return scene, count
