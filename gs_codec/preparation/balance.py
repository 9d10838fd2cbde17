"""Decide how far to prune before refinement: as long as coarser steps would lose more.

Fewer Gaussians and coarser steps both make a file smaller. A round of pruning pays off if it adds
less error than the coarser steps that would make the file as small without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gs_codec.codecs import encode_scene
from gs_codec.config import ADAPTIVE_PROFILES, Config
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.report import Progress
from gs_codec.scene import Scene

#: Mean squared error, as in `AdaptiveProfile.error`, added by the step sizes for a pruned scene.
#: Arguments: its size as a share of the input's, and the error that pruning has left in it.
StepError = Callable[[float, float], float]

#: Makes a `StepError` for the views that guide preparation.
StepsOf = Callable[[ViewSplit], StepError]

#: Share of the squared error of pruning that remains after 500 iterations of refinement, with and
#: without photographs (bench/LAB_NOTEBOOK.md).
_LEFT = {True: 0.07, False: 0.13}

#: Exponent of that share as a function of the number of iterations.
_FALL = -0.4

#: Share of the error allowed by a profile that its steps actually add, with refitted colours.
ADDED = 0.25

#: Slope of log error of the steps over log size (negated).
_SLOPE = 4.4

#: Number of views for measuring the error of a round; a rough value is enough.
_VIEWS = 16

_SIZED = Config("m", nonfinite="drop", extra="drop")


def profile_steps(config: Config) -> StepsOf:
    """The error of a profile's own steps; for profiles without step sizes, that of `m`."""
    chosen = config if config.profile in ADAPTIVE_PROFILES else Config()
    error = chosen.adaptive_profile().error
    return lambda views: lambda size, left: error


@dataclass
class Balance:
    """Compares rounds of pruning with coarser step sizes.

    Parameters
    ----------
    scene : Scene
        The scene before pruning.
    views : ReferenceViews
        Its renders.
    photographs : bool
        Whether refinement fits photographs.
    iterations : int
        Iterations of refinement.
    step_error : callable
    progress : callable, optional
    """

    scene: Scene
    views: ReferenceViews
    photographs: bool
    iterations: int
    step_error: StepError
    progress: Progress | None = None

    def __post_init__(self) -> None:
        self._whole = self._size = _size(self.scene)
        self._error, self._seen = 0.0, self.views.evenly(_VIEWS)
        left = _LEFT[self.photographs] * (self.iterations / 500) ** _FALL
        self._left = min(left, 1.0)

    def pays(self, pruned: Scene) -> bool:
        """Whether pruning from the previous scene (at first, the input) to this one pays off."""
        size = _size(pruned)
        error = self._left * self._seen.error(pruned, self.progress)
        step_error = ADDED * self.step_error(size / self._whole, error)
        cheap = error - self._error <= step_error * ((self._size / size) ** _SLOPE - 1)
        self._size, self._error = size, error
        return cheap


def _size(scene: Scene) -> int:
    """Bytes of a scene coded camera-free; pruning shrinks camera-guided files by the same ratio."""
    return len(encode_scene(scene, _SIZED)[0])
