"""Which Gaussians a range of a quantity, a reason, or a function of `gs_codec.edit` chooses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.edit.clusters import largest_cluster
from gs_codec.edit.floaters import find_floaters
from gs_codec.edit.selection import attribute_names, attribute_values, in_box
from gs_codec.formats.cloud import from_cloud
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene
from viewer.scenes.opened import Opened, Progress, Pruned


def quantity_names(scene: Opened) -> list[str]:
    """Names of the quantities that `quantity` has of a scene."""
    return [*attribute_names(gaussians_of(scene)), *_DERIVED]


def quantity(scene: Opened, name: str) -> NDArray:
    """A quantity ``(N,)`` of each Gaussian.

    It is an attribute of `gs_codec.edit.select`, in the same unit, or ``sh_energy``: the sum of
    squares of all SH-AC.

    Raises
    ------
    gs_codec.GsCodecError
        If the scene has none of this name.
    """
    gaussians = gaussians_of(scene)
    if name in _DERIVED:
        return _DERIVED[name](gaussians)
    if name not in attribute_names(gaussians):
        raise gs_codec.GsCodecError(f"quantity '{name}': {scene.name} has none of this name")
    return attribute_values(gaussians, name)


_DERIVED: Mapping[str, Callable[[Scene], NDArray]] = {
    "sh_energy": lambda scene: np.square(scene.f_rest, dtype=np.float64).sum(axis=0)
}


def in_range(scene: Opened, name: str, low: float, high: float) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` have a `quantity` from `low` to `high`, both included; no NaN."""
    values = quantity(scene, name)
    return (values >= low) & (values <= high)


def by_reason(scene: Opened, pruned: Pruned, reason: str) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` preparation removed for a reason of `Pruned`."""
    return pruned.of(scene).labels == 1 + pruned.reasons.index(reason)


def inside_box(scene: Opened, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.crop_box` keeps; raises as it does."""
    return in_box(gaussians_of(scene), low, high)


def not_floating(
    scene: Opened, cameras: Sequence[Camera] | None, progress: Progress | None
) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.remove_floaters` keeps."""
    return find_floaters(gaussians_of(scene), cameras, progress) == 0


def in_largest_cluster(scene: Opened) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.keep_largest_cluster` keeps."""
    return largest_cluster(gaussians_of(scene))


def gaussians_of(scene: Opened) -> Scene:
    """The Gaussians as gs_codec's functions take them; they share memory."""
    return from_cloud(scene.cloud, "drop")
