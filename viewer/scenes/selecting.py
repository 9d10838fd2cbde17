"""Select Gaussians by a quantity, colour, place, neighbours, or a `gs_codec.edit` function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.camera import Camera
from gs_codec.edit.clusters import connected, largest_cluster
from gs_codec.edit.floaters import find_floaters
from gs_codec.edit.selection import attribute_names, attribute_values, in_box, in_sphere
from gs_codec.edit.shares import SHARES, members
from viewer.scenes.opened import Opened, Progress, Pruned

#: Names of rules other than the shares in statistics.
_FLOATERS = "floaters"
_OUTLIERS = "outside the largest cluster"
_PRUNED = "pruned by "


#: What is selected around a Gaussian.
SEEDS = ("sphere", "colour", "flood")


@dataclass
class Selecting:
    """How tools select.

    Attributes
    ----------
    how : str
        One of `viewer.scenes.edits.HOW`.
    footprint, front : bool
        As in `viewer.scenes.region.in_region`.
    radius : int
        Of the brush, pixels.
    tolerance : int
        Largest difference of a colour channel, of 255, for `alike`.
    """

    how: str = "replace"
    footprint: bool = False
    front: bool = False
    radius: int = 20
    tolerance: int = 50


def quantity(scene: Opened, name: str) -> NDArray:
    """A quantity ``(N,)`` of each Gaussian.

    `name` is an attribute of `gs_codec.edit.select` or `gs_codec.edit.statistics` (such as
    ``longest scale``), in the same unit; or ``SH energy``, the sum of squares of all SH-AC.

    Raises
    ------
    gs_codec.GsCodecError
        If the scene has no such quantity.
    """
    gaussians, name = scene.gaussians, name.replace(" ", "_")
    if name == "SH_energy":
        return scene.sh_energy
    if name not in attribute_names(gaussians):
        raise gs_codec.GsCodecError(f"quantity '{name}': {scene.name} has none of this name")
    return attribute_values(gaussians, name)


def in_range(scene: Opened, name: str, low: float, high: float) -> NDArray[np.bool_]:
    """Mask ``(N,)`` of Gaussians with a `quantity` from `low` to `high`, inclusive; not NaN."""
    values = quantity(scene, name)
    return (values >= low) & (values <= high)


def rules(pruned: Pruned | None) -> list[str]:
    """Names of the rules for `by_rule`, for a scene with or without a pruning report."""
    reasons = () if pruned is None else pruned.reasons
    return [*SHARES, _FLOATERS, _OUTLIERS, *(f"{_PRUNED}{reason}" for reason in reasons)]


def by_rule(
    scene: Opened,
    rule: str,
    pruned: Pruned | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> NDArray[np.bool_]:
    """Mask ``(N,)`` of the Gaussians that a rule selects.

    Parameters
    ----------
    scene : Opened
    rule : str
        A name from `rules`: a share from `gs_codec.edit.statistics`, the Gaussians that
        `gs_codec.edit.remove_floaters` or `keep_largest_cluster` would remove, or a reason for
        pruning.
    pruned : Pruned or None
    cameras : sequence of gs_codec's Camera, optional
        As in `gs_codec.edit.remove_floaters`.
    progress : callable, optional
    """
    if rule.startswith(_PRUNED) and pruned is not None:
        reason = 1 + pruned.reasons.index(rule.removeprefix(_PRUNED))
        return pruned.of(scene).labels == reason
    gaussians = scene.gaussians
    if rule == _FLOATERS:
        return find_floaters(gaussians, cameras, progress) > 0
    return ~largest_cluster(gaussians) if rule == _OUTLIERS else members(gaussians, rule)


def rule_options(rule: str, cameras: object = None) -> tuple[str, ...]:
    """Options of ``gs-codec convert`` that remove what a rule selects; empty if there are none."""
    if rule == _FLOATERS and cameras is not None:
        return ("--remove-floaters", f"--cameras={cameras}") if isinstance(cameras, str) else ()
    return {_FLOATERS: ("--remove-floaters",), _OUTLIERS: ("--keep-largest-cluster",)}.get(rule, ())


def range_options(name: str, low: float, high: float) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Options that remove a range of a quantity, and those that remove all else; see `in_range`."""
    name = name.replace(" ", "_")
    if name == "SH_energy":
        return (), ()
    ends = [f"--filter={name}{sign}{end:.17g}" for sign, end in ((">=", low), ("<=", high))]
    kept = tuple(option for option, end in zip(ends, (low, high), strict=True) if np.isfinite(end))
    gone = {
        (True, False): f"--filter={name}<{low:.17g}",
        (False, True): f"--filter={name}>{high:.17g}",
    }
    option = gone.get((bool(np.isfinite(low)), bool(np.isfinite(high))))
    return (option,) if option else (), kept


def inside_box(scene: Opened, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
    """Mask ``(N,)`` of the Gaussians that `gs_codec.edit.crop_box` keeps; raises like it."""
    return in_box(scene.gaussians, low, high)


def around(
    scene: Opened,
    kind: str,
    row: int,
    radius: float,
    tolerance: float,
    drawn: NDArray[np.bool_] | None = None,
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Mask ``(N,)`` of the Gaussians around one, by `kind`, one of `SEEDS`.

    A sphere of a radius (scene units) around its centre; all SH-DC colours that differ by at most
    `tolerance` of 255 in any channel; or, of these, those reached through linked neighbours. With
    a mask `drawn` ``(N,)``, only Gaussians in it. Beside it, the options of ``gs-codec convert``
    that remove all others; empty if there are none.
    """
    if kind == "sphere":
        sphere = *scene.positions[row].tolist(), max(radius, np.finfo(float).tiny)
        found = in_sphere(scene.gaussians, sphere[:3], sphere[3])
        if drawn is not None and not drawn[found].all():
            return found & drawn, ()
        return found, (f"--crop-sphere={','.join(f'{number:.17g}' for number in sphere)}",)
    differences = np.abs(scene.colours - scene.colours[row]).max(axis=1)
    same = differences <= np.float32(tolerance / 255 + 1e-6)
    same = same if drawn is None else same & drawn
    return same if kind != "flood" else connected(scene.neighbours, same, row), ()


def grown(scene: Opened, selected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask ``(N,)``, extended by all linked neighbours of its Gaussians."""
    after = selected | selected[scene.neighbours].any(axis=1)
    after[scene.neighbours[selected]] = True
    return after


def shrunk(scene: Opened, selected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask ``(N,)`` without the Gaussians that have linked neighbours outside it."""
    return ~grown(scene, ~selected)
