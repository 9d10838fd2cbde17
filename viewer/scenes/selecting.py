"""Which Gaussians a range of a quantity, a reason, or a function of `gs_codec.edit` chooses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.camera import Camera
from gs_codec.edit.clusters import largest_cluster
from gs_codec.edit.floaters import find_floaters
from gs_codec.edit.selection import attribute_names, attribute_values, in_box
from gs_codec.edit.shares import SHARES, members
from viewer.scenes.opened import Opened, Progress, Pruned

#: Rules beside the shares of statistics.
_FLOATERS = "floaters"
_APART = "outside the largest cluster"
_PRUNED = "pruned by "


def quantity(scene: Opened, name: str) -> NDArray:
    """A quantity ``(N,)`` of each Gaussian.

    It is an attribute of `gs_codec.edit.select`, in the same unit, named as there or as
    `gs_codec.edit.statistics` names it (``longest scale``); or ``SH energy``: the sum of squares of
    all SH-AC.

    Raises
    ------
    gs_codec.GsCodecError
        If the scene has none of this name.
    """
    gaussians, name = scene.gaussians, name.replace(" ", "_")
    if name == "SH_energy":
        return scene.sh_energy
    if name not in attribute_names(gaussians):
        raise gs_codec.GsCodecError(f"quantity '{name}': {scene.name} has none of this name")
    return attribute_values(gaussians, name)


def in_range(scene: Opened, name: str, low: float, high: float) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` have a `quantity` from `low` to `high`, both included; no NaN."""
    values = quantity(scene, name)
    return (values >= low) & (values <= high)


def rules(pruned: Pruned | None) -> list[str]:
    """Names of the rules of `by_rule`, for a scene with a report or without one."""
    reasons = () if pruned is None else pruned.reasons
    return [*SHARES, _FLOATERS, _APART, *(f"{_PRUNED}{reason}" for reason in reasons)]


def by_rule(
    scene: Opened,
    rule: str,
    pruned: Pruned | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` a rule chooses.

    Parameters
    ----------
    scene : Opened
    rule : str
        A name of `rules`: a share of `gs_codec.edit.statistics`, what
        `gs_codec.edit.remove_floaters` or `keep_largest_cluster` remove, or a reason for pruning.
    pruned : Pruned or None
    cameras : sequence of gs_codec's Camera, optional
        As for `gs_codec.edit.remove_floaters`.
    progress : callable, optional
    """
    if rule.startswith(_PRUNED) and pruned is not None:
        reason = 1 + pruned.reasons.index(rule.removeprefix(_PRUNED))
        return pruned.of(scene).labels == reason
    gaussians = scene.gaussians
    if rule == _FLOATERS:
        return find_floaters(gaussians, cameras, progress) > 0
    return ~largest_cluster(gaussians) if rule == _APART else members(gaussians, rule)


def inside_box(scene: Opened, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.crop_box` keeps; raises as it does."""
    return in_box(scene.gaussians, low, high)
