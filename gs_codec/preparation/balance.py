"""How far to prune before refinement: as long as coarser steps would cost more.

Fewer Gaussians and coarser steps both make a file smaller. Least is lost where the last thousandth
of the size costs the same error either way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from gs_codec.codecs import encode_scene
from gs_codec.config import ADAPTIVE_PROFILES, Config
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.report import Progress
from gs_codec.scene import Scene

#: Mean squared error, as `AdaptiveProfile.error`, of the steps that would code a pruned scene: by
#: its size, as a share of the input's, and by the error that pruning has left in it.
StepError = Callable[[float, float], float]

#: The same by the views that guide preparation.
StepsOf = Callable[[ViewSplit], StepError]

#: Share of the squared error of pruning that 500 iterations of refinement leave, with photographs
#: and without (bench/RESULTS.md).
_LEFT = {True: 0.07, False: 0.13}

#: This share falls with this power of the number of iterations.
_FALL = -0.4

#: Share of the error that a profile may add which its steps do add, colours refitted.
ADDED = 0.25

#: Logarithm of the error that steps add by the logarithm of the size, negative.
_SLOPE = 4.4

#: Views that the error of a round is measured in; it only has to be about right.
_VIEWS = 16

_SIZED = Config("m", nonfinite="drop", extra="drop")


def profile_steps(config: Config) -> StepsOf:
    """The error of a profile's own steps; of `m` for profiles without step sizes."""
    chosen = config if config.profile in ADAPTIVE_PROFILES else Config()
    error = chosen.adaptive_profile().error
    return lambda views: lambda size, left: error


@dataclass
class Balance:
    """Weighs rounds of pruning, one after the other, against steps of another size.

    Parameters
    ----------
    scene : Scene
        Before pruning.
    views : ReferenceViews
        Its renders.
    photographs : bool
        Whether refinement fits photographs.
    iterations : int
        Of refinement.
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
        """Whether to go on from the scene of the call before, or the input, to this one."""
        size = _size(pruned)
        error = self._left * self._seen.error(pruned, self.progress)
        step_error = ADDED * self.step_error(size / self._whole, error)
        cheap = error - self._error <= _SLOPE * step_error * math.log(self._size / size)
        self._size, self._error = size, error
        return cheap


def _size(scene: Scene) -> int:
    """Bytes of a scene that is coded without cameras; with them it shrinks by pruning alike."""
    return len(encode_scene(scene, _SIZED)[0])
