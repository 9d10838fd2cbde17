"""Shares of Gaussians that stand out: transparent, needle-like, huge, duplicate, not finite."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import sound_gaussians
from gs_codec.edit.distribution import finite_values, ranked
from gs_codec.formats.packed_values import sigmoid
from gs_codec.rendering.project import MIN_ALPHA
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.scene import GROUPS, Scene

#: Outliers: 1 in 100 values at either end.
_OUTLIERS = 100

#: A needle's longest axis is more than this many times as long as its middle axis.
_NEEDLE = 10

#: Minimum scale of a huge Gaussian, relative to the scene's extent; it covers over 30 % of the
#: scene.
_HUGE = 0.05

#: 2**64 divided by the golden ratio, odd: multiplying by it mixes the bits of columns.
_FACTOR = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True)
class Share:
    """A group of Gaussians with a common property.

    Attributes
    ----------
    name : str
        Name, as listed in `Statistics`.
    rule : str
        The common property, in words.
    count : int
        Number of these Gaussians.
    share : float
        Share of all Gaussians, 0-1.

    Examples
    --------
    >>> share = gs_codec.edit.statistics(gs_codec.read("scene.ply")).shares[0]
    >>> share.name, share.rule, share.count
    ('transparent', 'opacity below 1/255, which is not drawn', 0)
    """

    name: str
    rule: str
    count: int
    share: float


def shares_of(scene: Scene) -> tuple[Share, ...]:
    """Count Gaussians that are invisible, unusual or duplicates.

    Parameters
    ----------
    scene : Scene
        A scene with any values. NaN satisfies only the rule `not finite`.

    Returns
    -------
    tuple of Share
        ``transparent``, ``needle-like``, ``huge``, ``same centre``, ``duplicate``, ``not finite``.
        For ``huge``, the extent is the longest side of a box that excludes 1 % of the centres at
        either end of each axis. For ``same centre`` and ``duplicate`` (all attributes equal), all
        but the first Gaussian count.
    """
    with using_threads(None, scene.count):
        found = run_all(lambda rule: rule(scene), dict.fromkeys(_RULES.values()))
    counted = [
        (name, rule, int(np.count_nonzero(mask))) for each in found for name, rule, mask in each
    ]
    return tuple(
        Share(name, rule, number, number / max(scene.count, 1)) for name, rule, number in counted
    )


def members(scene: Scene, name: str) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` a share counts, by name in `SHARES`."""
    return next(mask for found, _, mask in _RULES[name](scene) if found == name)


_Found = list[tuple[str, str, NDArray[np.bool_]]]


def _transparent(scene: Scene) -> _Found:
    mask = sigmoid(scene.opacity[0].astype(np.float64)) < MIN_ALPHA
    return [("transparent", "opacity below 1/255, which is not drawn", mask)]


def _needles(scene: Scene) -> _Found:
    _, middle, longest = np.sort(scene.log_scale, axis=0).astype(np.float64)
    with np.errstate(invalid="ignore"):
        mask = longest - middle > math.log(_NEEDLE)
    return [("needle-like", f"longest scale over {_NEEDLE} times the middle one", mask)]


def _huge(scene: Scene) -> _Found:
    extent = max(_spread(row) for row in scene.positions)
    longest = scene.log_scale.astype(np.float64).max(axis=0)
    # Without extent, as with a single Gaussian, none is huge.
    mask = longest > (math.log(_HUGE * extent) if extent else math.inf)
    rule = f"longest scale over {_HUGE:.0%} of the scene's extent, {extent:.4g}"
    return [("huge", rule.replace("%", " %"), mask)]


def ends_of(number: int) -> tuple[int, int]:
    """Ranks that enclose all of `number` values except 1 % at either end."""
    rank = (number - 1) // _OUTLIERS
    return rank, number - 1 - rank


def _spread(values: NDArray[np.float32]) -> float:
    """Range of the finite values, without the outliers at either end."""
    finite = finite_values([values])
    if not finite.size:
        return 0.0
    low, high = ranked(finite, ends_of(finite.size))
    return high - low


def _repeated(scene: Scene) -> _Found:
    first, centres = _repetitions(_words(scene.positions))
    rows = np.union1d(first, centres)
    few = scene.take(rows)
    planes = np.concatenate([_words(getattr(few, group)) for group in GROUPS])
    same, all_same = np.zeros((2, scene.count), bool)
    same[centres] = all_same[rows[_repetitions(planes)[1]]] = True
    return [
        ("same centre", "centre equal to that of an earlier one", same),
        ("duplicate", "all attributes equal to those of an earlier one", all_same),
    ]


def _words(planes: NDArray[np.float32]) -> NDArray[np.uint32]:
    """The bits of floats, with -0 mapped to 0."""
    with np.errstate(invalid="ignore"):
        return (planes + np.float32(0)).view(np.uint32)


def _repetitions(words: NDArray[np.uint32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Columns of ``words (C, n)`` that repeat others: indices of those, and their own."""
    mixed = np.zeros(words.shape[1], np.uint64)
    for row in words:
        mixed = (mixed ^ row) * _FACTOR
        mixed ^= mixed >> np.uint64(32)
    order = np.argsort(mixed, kind="stable")
    mixed = mixed[order]
    after = np.flatnonzero(mixed[1:] == mixed[:-1])
    first, second = order[after], order[after + 1]
    same = np.ones(len(after), bool)
    for row in words:
        same &= row[first] == row[second]
    return first[same], second[same]


def _not_finite(scene: Scene) -> _Found:
    rule = "NaN or infinity in an attribute; not opacity 0 or 1, nor a scale of 0"
    return [("not finite", rule, ~sound_gaussians(scene))]


_RULES: Mapping[str, Callable[[Scene], _Found]] = {
    "transparent": _transparent,
    "needle-like": _needles,
    "huge": _huge,
    "same centre": _repeated,
    "duplicate": _repeated,
    "not finite": _not_finite,
}

#: Names of shares.
SHARES = tuple(_RULES)
