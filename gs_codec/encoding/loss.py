"""The loss of a coded scene, measured in windows that were not used to choose its step sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.guidance.calibrate import mean_error
from gs_codec.guidance.windows import (
    MOST_SHOWN,
    SIDES,
    Part,
    choose_windows,
    draw_parts,
    error_factors,
    find_shown,
    parts_of,
    sample_of,
    windows_of,
)
from gs_codec.report import NOMINAL_ERROR, RenderedLoss, psnr_loss
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.plan import Plan

#: Reported quantile of the crops' losses. A few crops are rendered from inside a Gaussian, where no
#: camera has been.
_WORST = 0.95

#: Minimum number of windows: fewer than choose step sizes, as a rough loss is better than none.
_ENOUGH = 8

#: Lower bound of mean squared errors: 120 dB.
_LEAST = 1e-12


class _Seen(NamedTuple):
    """Windows, each with its Gaussians ``(n,)``, image ``(H, W, 3)`` and mean transmittance.

    See `error_factors` for the factors.
    """

    windows: list[Camera]
    shown: list[NDArray[np.int64]]
    images: list[NDArray[np.float32]]
    left: list[float]
    factors: list[float]

    def errors(self, coded: Scene, shown: Sequence[NDArray[np.int64]]) -> NDArray[np.float64]:
        """Mean squared error of each window; `shown` are its Gaussians in the coded scene."""
        drawn = _draw(coded, self.windows, shown)
        pairs = zip(self.images, drawn, strict=True)
        errors = np.array([np.mean((a - b) ** 2, dtype=np.float64) for a, (b, _) in pairs])
        return errors * self.factors


def _draw(
    scene: Scene, windows: Sequence[Camera], shown: Sequence[NDArray[np.int64]]
) -> list[tuple[NDArray[np.float32], float]]:
    parts: list[Part] = parts_of(windows, [len(own) for own in shown])
    with np.errstate(all="ignore"):
        return draw_parts(scene.take(np.concatenate([np.empty(0, np.int64), *shown])), parts)


def _look(
    scene: Scene,
    windows: Sequence[Camera],
    shown: Sequence[NDArray[np.int64]],
    with_holes: bool = False,
) -> _Seen | None:
    """The usable windows, or `with_holes` all in which not too much is shown; None if too few."""
    found = zip(windows, shown, strict=True)
    usable = [(window, own) for window, own in found if len(own) <= MOST_SHOWN]
    if len(usable) < _ENOUGH:
        return None
    drawn = _draw(scene, *zip(*usable, strict=True))
    left = [through for _, through in drawn]
    factors = np.ones(len(left)) if with_holes else error_factors(left, _ENOUGH)
    if factors is None:
        return None
    rows = [
        (window, own, image, through, factor)
        for (window, own), (image, through), factor in zip(usable, drawn, factors, strict=True)
        if factor
    ]
    return _Seen(*map(list, zip(*rows, strict=True)))


def _look_from(scene: Scene, cameras: Sequence[Camera]) -> _Seen | None:
    """Windows of given cameras; smaller ones if views of few pixels show too many Gaussians."""
    for side in SIDES:
        windows = windows_of(cameras, side)
        # Empty windows count as having no loss. From likely positions, they are holes.
        seen = _look(scene, windows, find_shown(scene, windows), with_holes=True)
        if seen is not None:
            return seen
    return None


@dataclass(frozen=True)
class Check:
    """Windows on a scene, from likely camera positions and from given cameras if there are any.

    Given cameras measure the loss. Windows from likely positions then show whether those cameras
    fit the scene. `telling` is as in `Windows`. `before` is the mean squared error that pruning
    caused before encoding.
    """

    scene: Scene
    likely: _Seen | None
    given: _Seen | None = None
    telling: bool = True
    before: float = 0.0

    @classmethod
    def of(cls, scene: Scene, likely: Sequence[Camera]) -> Check:
        """Render a finite scene in these windows."""
        return cls.by_shown(replace(scene, extra={}), likely, find_shown(scene, likely))

    @classmethod
    def by_shown(
        cls, scene: Scene, likely: Sequence[Camera], shown: Sequence[NDArray[np.int64]]
    ) -> Check:
        """Like `of`; `shown` are the Gaussians in each window. The scene may lack others."""
        return cls(scene, _look(scene, likely, shown))

    @classmethod
    def by_plan(cls, scene: Scene, plan: Plan | None) -> Check:
        """Like `of`, with windows chosen from the scene, and windows of a plan's given cameras."""
        sample = sample_of(scene)
        windows = choose_windows(sample, scene.count)
        if plan is None or plan.estimates:
            return cls.of(scene, windows.checking)
        from gs_codec.preparation.view_selection import checking_cameras

        check, cameras = cls.of(scene, windows.checking), checking_cameras(scene, plan)
        return replace(check, given=_look_from(check.scene, cameras), telling=windows.telling)

    def of_pruned(self, scene: Scene) -> Check:
        """The same for the encoding of a pruned scene."""
        loss = self.measure(scene)
        return self if loss is None else replace(self, before=error_of(loss.loss))

    @property
    def covered(self) -> float:
        """10th percentile of the opacity of given cameras' windows, 0-1; 1 without cameras."""
        return 1.0 if self.given is None else 1.0 - float(np.quantile(self.given.left, 0.9))

    @property
    def _seen(self) -> list[_Seen]:
        return [seen for seen in (self.likely, self.given) if seen is not None]

    @property
    def windows(self) -> list[Camera]:
        """All windows; none if too little is visible."""
        return [window for seen in self._seen for window in seen.windows]

    def watch(self) -> Watched | None:
        """The Gaussians in the windows, whose decoded values an encoder should keep.

        None if there are none, or the encoder has fewer than the scene.
        """
        shown = [own for seen in self._seen for own in seen.shown]
        return Watched.shown(self.scene, shown) if shown and not self.before else None

    def measure_watched(self, watched: Watched) -> RenderedLoss | None:
        """The loss, from the decoded values that an encoder kept of those from `watch`."""
        found = [watched.find(own) for seen in self._seen for own in seen.shown]
        return self.measure_shown(watched.decoded(), found)

    def measure_shown(
        self, coded: Scene, shown: Sequence[NDArray[np.int64]]
    ) -> RenderedLoss | None:
        """The loss of coded Gaussians; `shown` are the indices that each of `windows` shows."""
        left = iter(shown)
        return self._loss(
            [seen.errors(coded, [next(left) for _ in seen.windows]) for seen in self._seen]
        )

    def measure(self, coded: Scene) -> RenderedLoss | None:
        """The loss of a coded scene in any order; None if too little is visible."""
        plain = replace(coded, extra={})
        return self.measure_shown(plain, find_shown(plain, self.windows))

    def _loss(self, errors: list[NDArray[np.float64]]) -> RenderedLoss | None:
        if not errors:
            return None
        away = None
        if self.likely is not None:
            of_likely = mean_error(errors[0], self.scene)
            if self.given is not None:
                away = psnr_loss(of_likely)
        error = of_likely if self.given is None else float(errors[-1].mean())
        error, worst = max(error, _LEAST), float(np.quantile(errors[-1], _WORST))
        return RenderedLoss(
            psnr=-10 * float(np.log10(error)),
            loss=psnr_loss(error),
            worst=max(psnr_loss(worst), psnr_loss(error)),
            windows=len(errors[-1]),
            views="likely" if self.given is None else "given",
            away=away,
        )


def error_of(loss: float) -> float:
    """Mean squared error of views from their loss in dB; inverse of `psnr_loss`."""
    return NOMINAL_ERROR * (10 ** (loss / 10) - 1)
