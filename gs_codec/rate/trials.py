"""Trial encodings of a scene during the search for a rate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import encode_scene, shape_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import EGS, AdaptiveProfile, Config, RateTarget
from gs_codec.guidance.guide import Guidance, Shaped, guide
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.report import EncodeReport, Progress, RateReport, StageTimes
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Seen:
    """Views, and the mean squared errors of the held-out ones ``(views,)`` before encoding."""

    views: ViewSplit
    before: NDArray[np.float64]
    progress: Progress | None

    def loss(self, coded: Scene) -> float:
        """PSNR loss of a decoded scene in the held-out views, dB."""
        measured = self.views.held_out
        return measured.drop(measured.errors(coded, self.progress), self.before)


@dataclass
class RateSearch:
    """A rate target, and the time and encodings spent on it so far.

    Without `references`, the encoder is camera-free. `limit` (bytes) is None if the target is a
    loss; a loss needs `seen`.
    """

    config: Config
    target: RateTarget
    limit: int | None
    references: ReferenceViews | None
    seen: Seen | None
    progress: Progress | None
    times: StageTimes = field(default_factory=StageTimes)
    encodings: int = 0


@dataclass
class Trials:
    """Trial encodings of a scene, with the most recently refitted colours.

    Attributes
    ----------
    scene : Scene
        As given.
    asked : RateSearch
    guidance : Guidance or None
    coloured : Scene
        The scene with the most recently refitted colours.
    octaves : float
        Log2 of the coarseness of `last`.
    last : tuple
        File and report of the last encoding.
    loss : float or None
        PSNR loss of `last`, dB; None if it was not measured.
    compacting : bool
        Whether `refit` compacts SH first.
    predicted_bytes, predicted_drop : number or None
        As in `RateReport`.
    at_end : bool
        Whether the target is out of reach for any step sizes.
    """

    scene: Scene
    asked: RateSearch
    guidance: Guidance | None = field(init=False, default=None)
    coloured: Scene = field(init=False)
    octaves: float = 0.0
    last: tuple[bytes, EncodeReport] = field(init=False)
    loss: float | None = None
    compacting: bool = True
    predicted_bytes: int | None = None
    predicted_drop: float | None = None
    at_end: bool = False

    def __post_init__(self) -> None:
        self.coloured = self.scene
        if self.asked.references is not None:
            with self.asked.times.stage("views"):
                self.guidance = guide(self.scene, self.asked.references, self.asked.progress)

    def config_at(self, octaves: float) -> Config:
        """The configuration at a coarseness, log2."""
        return replace(self.asked.config, coarseness=2.0**octaves)

    def size(self, octaves: float) -> int:
        """Encode with the current colours; return the file's size, bytes."""
        config = self.config_at(octaves)
        with self.asked.times.stage("search"):
            steps = None
            if self.guidance is not None:
                steps = self.guidance.steps(config.adaptive_profile())
            self.last = encode_scene(self.coloured, config, self.asked.progress, steps)
        self.octaves = octaves
        self.asked.encodings += 1
        return len(self.last[0])

    def compact(self, octaves: float) -> None:
        """Compact SH for steps of this coarseness, without deciding whether it pays off."""
        self._recolour(octaves, lambda guidance, *to: guidance.compact(*to, decide=False))

    def settle(self, octaves: float) -> None:
        """Like `compact`, but first decide, once, whether compaction pays off."""
        self._recolour(octaves, lambda guidance, *to: guidance.compact(*to))

    def refit(self, octaves: float) -> None:
        """Compact and refit SH for steps of this coarseness."""
        self._recolour(octaves, lambda guidance, *to: guidance.recolour(*to, self.compacting))

    def _recolour(
        self, octaves: float, choose: Callable[[Guidance, Shaped, AdaptiveProfile], Scene]
    ) -> None:
        assert self.guidance is not None
        config = self.config_at(octaves)
        profile = config.adaptive_profile()
        with self.asked.times.stage("recolour"):
            steps = self.guidance.steps(profile)
            shaped = shape_scene(self.scene, config, steps, StageTimes(), self.asked.progress)
            shaped = shaped.with_colours(choose(self.guidance, shaped, profile))
        self.coloured = shaped.source
        self.asked.encodings += 1

    def rate_report(self, pruned: int) -> RateReport:
        """Report how the last encoding met the target, with `pruned` Gaussians removed."""
        data = self.last[0]
        return RateReport(
            self.asked.target,
            2.0**self.octaves,
            self._steps(),
            len(data),
            self.predicted_bytes,
            self.loss,
            self.predicted_drop,
            self.asked.encodings,
            pruned,
            self.at_end,
        )

    def _steps(self) -> dict[str, tuple[float, float]]:
        """Finest and coarsest step size of each pass of an `.egs`."""
        if self.asked.config.format != EGS:
            return {}
        passes = inspect_bytes(self.last[0]).passes
        return {each.name: (each.finest_step, each.coarsest_step) for each in passes}

    def decoded(self) -> Scene:
        """The scene of the last encoding."""
        return decode_as(self.asked.config, self.last[0], self.asked.progress)
