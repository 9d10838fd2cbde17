"""Match the Gaussians of two versions of a scene, and measure their differences."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.codecs.matching import NEAREST, GridOrder, order_of, put_side_by_side
from gs_codec.coding.axes import nearest_quaternions, sort_axes
from gs_codec.coding.clean import identity_for_zero
from gs_codec.metrics.attributes import compare_scenes
from gs_codec.scene import SH_C0, Scene
from viewer.scenes.opened import Opened

#: Property that stores row numbers while scenes are matched.
_ROW = "row"


@dataclass(frozen=True)
class Difference:
    """Differences between a Gaussian and its match.

    Attributes
    ----------
    row : int
        Row of the match in its scene.
    matched_by : str
        ``stored order``, ``index`` or ``Morton order``, as in `Comparison`; or `NEAREST`.
    position : float
        Distance between the centres, scene units.
    scales : tuple of three float
        Ratios of the axes, this over the other, minus 1; sorted from the longest unless matched by
        index.
    rotation : float
        Angle, degrees.
    opacity : float
        Difference, 0-1.
    colour : float
        Root mean square over R, G and B of SH-DC, in levels of 255.
    sh : float or None
        Root mean square over the SH-AC; None if neither scene has any.
    """

    row: int
    matched_by: str
    position: float
    scales: tuple[float, float, float]
    rotation: float
    opacity: float
    colour: float
    sh: float | None


class Match:
    """Matches between the Gaussians of two scenes.

    Uses the matching of `gs_codec.compare`; if that fails, for example after pruning, the nearest
    centre.

    Parameters
    ----------
    first, second : Opened
    """

    def __init__(self, first: Opened, second: Opened) -> None:
        self._scenes = first.gaussians, second.gaussians
        self._sorts = any(isinstance(order_of(each), GridOrder) for each in self._scenes)
        self.matched_by = NEAREST
        self._rows: tuple[NDArray, NDArray] | None = None
        if first.count != second.count:
            return
        a, b = (_numbered(each) for each in self._scenes)
        try:
            a, b, self.matched_by = put_side_by_side(a, b, in_order=True)
        except gs_codec.GsCodecError:  # no match in order
            return
        self._rows = a.extra[_ROW], b.extra[_ROW]

    def difference(self, which: int, row: int) -> Difference | None:
        """Differences of a Gaussian of scene `which` (0 or 1) from its match, if any."""
        own, other = self._scenes[which], self._scenes[1 - which]
        if self._rows is None:
            found = _nearest(own.positions[:, row], other.positions)
        else:
            place = np.flatnonzero(self._rows[which] == row)[0]
            found = int(self._rows[1 - which][place])
        if found is None:
            return None
        pair = own.take(np.array([row])), other.take(np.array([found]))
        if self._sorts or self._rows is None:
            pair = _with_axes_alike(*pair)
        return _difference(*pair, found, self.matched_by)


def _numbered(scene: Scene) -> Scene:
    return replace(scene, extra={_ROW: np.arange(scene.count, dtype=np.int32)})


def _nearest(position: NDArray, positions: NDArray) -> int | None:
    """Index of the nearest of finite positions ``(3, N)``; None if there are none."""
    with np.errstate(over="ignore", invalid="ignore"):
        distances = np.sum((positions - position[:, None]) ** 2, axis=0)
    return int(np.nanargmin(distances)) if np.isfinite(distances).any() else None


def _with_axes_alike(first: Scene, second: Scene) -> tuple[Scene, Scene]:
    """Both scenes with axes sorted from the longest, and with similar quaternions if possible."""
    pair = []
    rot = np.array([[1], [0], [0], [0]], np.float32)
    for scene in (second, first):
        scene, _ = identity_for_zero(scene)
        _, scales, vectors = sort_axes(scene.log_scale, scene.rot)
        rot = nearest_quaternions(vectors, rot)
        pair.append(replace(scene, log_scale=scales.astype(np.float32), rot=rot))
    return pair[1], pair[0]


def _difference(first: Scene, second: Scene, row: int, matched_by: str) -> Difference:
    compared = compare_scenes(first, second)
    errors = {(group.name, group.unit): group for group in compared.groups}
    rest = errors.get(("f_rest", "SH"))
    with np.errstate(over="ignore", invalid="ignore"):
        scales = np.expm1(first.log_scale[:, 0].astype(np.float64) - second.log_scale[:, 0])
        logits = np.array([first.opacity[0, 0], second.opacity[0, 0]], np.float64)
        opacities = 1 / (1 + np.exp(-logits))
    return Difference(
        row,
        matched_by,
        float(np.linalg.norm(first.positions.astype(np.float64) - second.positions)),
        tuple(scales.tolist()),
        errors["rotation", "degrees"].max,
        float(opacities[0] - opacities[1]),
        255 * SH_C0 * errors["f_dc", "SH"].rms,
        None if rest is None else rest.rms,
    )
