"""Guidance for camera-guided encoding: sensitivities, and SH compacted and refitted to views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.encode import ShapedScene
from gs_codec.codecs.adaptive.step_sizes import Sensitivity, StepSizes, fit_step_sizes
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.frequency_table import shannon_bits
from gs_codec.coding.ycocg import from_ycocg, to_ycocg
from gs_codec.config import AdaptiveProfile
from gs_codec.guidance.sensitivity import sensitivity
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.image_operator import ImageOperator
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sh_weights import coefficients_of
from gs_codec.report import Progress, step_counter
from gs_codec.scene import Scene, channel_count

#: Conjugate-gradient iterations of the refit.
_REFIT = 10

#: Folds of the cross-validation over views that decides whether compaction pays.
_FOLDS = 4

#: Most by which compaction may multiply the largest error of the left-out views.
_WORST = 16.0

#: Values of a Gaussian without SH-AC; each takes one more bit when steps are halved.
_OTHERS = 14

#: Smaller mean squared errors count as this.
_EPS = 1e-12

#: Levels of SH-AC are clipped to this when bits are estimated.
_LARGEST = 1 << 11


@dataclass(frozen=True)
class Guidance:
    """What cameras tell the encoder about a scene.

    Attributes
    ----------
    sensitivity : Sensitivity
    loss : float
        Mean squared error of an image value before encoding; pruning may have caused it.
    pixels : int
        Of all views together.
    colours : Colours
    """

    sensitivity: Sensitivity
    loss: float
    pixels: int
    colours: Colours

    def steps(self, scene: Scene, profile: AdaptiveProfile) -> StepSizes:
        """Step sizes of the scene; its colours may have changed."""
        return guided_steps(scene, profile, self.sensitivity, self.loss, self.pixels)

    def recolour(self, shaped: ShapedScene, profile: AdaptiveProfile) -> ShapedScene:
        """Compact and refit the SH of a scene whose shapes are rounded."""
        decoded, steps = shaped.decoded(), shaped.sh_steps()
        decoded = self.colours.compact(decoded, shaped.order, steps, profile)
        return shaped.with_colours(self.colours.refit(decoded))


def guided_steps(
    scene: Scene, profile: AdaptiveProfile, sensitivity: Sensitivity, loss: float, pixels: int
) -> StepSizes:
    """Step sizes that add the error which a profile allows; see `Guidance`."""
    axes, scales, _ = sort_axes(scene.log_scale, scene.rot)
    sorted_axes = np.take_along_axis(sensitivity.log_scale, axes.astype(np.int64), 0)
    # The error that all parameters may add, divided by their number.
    parameters = scene.count * channel_count(len(scene.f_rest) // 3)
    error = (profile.error + profile.of_loss * loss) * 3 * pixels / parameters
    return fit_step_sizes(
        sensitivity._replace(log_scale=sorted_axes), scene.opacity[0], scales, error
    )


def guide(
    scene: Scene,
    views: ReferenceViews,
    progress: Progress | None = None,
) -> Guidance:
    """Measure what the encoder needs to know from the views of a scene."""
    cameras = views.cameras
    loss = views.error(scene, progress)
    found, weights = sensitivity(
        scene, cameras, views.background, progress, keep=scene.sh_degree > 0
    )
    pixels = sum(camera.width * camera.height for camera in cameras)
    return Guidance(found, loss, pixels, Colours(views, weights, progress))


@dataclass
class Colours:
    """Compaction and refit of the SH of a scene whose shapes are rounded.

    The `decoded` scene has decoded shapes and the original's SH. Its Gaussian i is number
    ``order[i]`` of the scene whose views were measured. `steps` ``(N,)`` are the step sizes of its
    SH. SH are compacted if this pays, which the first call of `compact` decides.

    Attributes
    ----------
    views : ReferenceViews
    weights : ndarray, shape (views, N), float32
        Sums of (alpha T)^2 of the scene that is encoded, in its own order.
    compacts : bool or None
        Whether compaction pays; None until it is decided.
    operator : ImageOperator or None
        Images as a function of SH, for the shapes that were used last.
    """

    views: ReferenceViews
    weights: NDArray[np.float32]
    progress: Progress | None
    compacts: bool | None = None
    operator: ImageOperator | None = None

    def compact(
        self,
        decoded: Scene,
        order: NDArray[np.unsignedinteger],
        steps: NDArray[np.float32],
        profile: AdaptiveProfile,
    ) -> Scene:
        """A scene with fewer non-zero SH, if this pays."""
        if decoded.sh_degree and self.compacts is None:
            trial = self._compaction(order, steps, profile)
            self.compacts = trial.pays(decoded, self._operator_of(decoded))
        return self.sketch(decoded, order, steps, profile)

    def sketch(
        self,
        decoded: Scene,
        order: NDArray[np.unsignedinteger],
        steps: NDArray[np.float32],
        profile: AdaptiveProfile,
    ) -> Scene:
        """As `compact`, without deciding whether it pays: quick, to estimate sizes."""
        if not decoded.sh_degree or self.compacts is False:
            return decoded
        return self._compaction(order, steps, profile).whole(decoded)

    def refit(self, decoded: Scene) -> Scene:
        """A scene with SH refitted to compensate for rounded shapes and compaction."""
        return refit_colour(
            decoded,
            self.views.cameras,
            self.views.images,
            _REFIT,
            operator=self._operator_of(decoded),
            progress=self.progress,
        )[0]

    def _compaction(
        self,
        order: NDArray[np.unsignedinteger],
        steps: NDArray[np.float32],
        profile: AdaptiveProfile,
    ) -> _Compaction:
        weights = self.weights[:, order]
        return _Compaction(self.views, weights, steps, profile, self.progress)

    def _operator_of(self, scene: Scene) -> ImageOperator:
        if self.operator is None or not _same_shapes(self.operator.scene, scene):
            self.operator = None  # Both would not fit into memory.
            views = self.views
            self.operator = ImageOperator(scene, views.cameras, views.background)
        return self.operator


def _same_shapes(first: Scene, second: Scene) -> bool:
    return all(
        np.array_equal(getattr(first, name), getattr(second, name))
        for name in ("positions", "opacity", "log_scale", "rot")
    )


@dataclass(frozen=True)
class _Compaction:
    """Compaction of a scene for given step sizes of its SH."""

    views: ReferenceViews
    weights: NDArray[np.float32]
    steps: NDArray[np.float32]
    profile: AdaptiveProfile
    progress: Progress | None

    def whole(self, scene: Scene) -> Scene:
        """Compact the scene with all views."""
        return self.by(scene, range(len(self.weights)))

    def by(self, scene: Scene, seen: Sequence[int]) -> Scene:
        """Compact the scene with some of the views."""
        return compact_sh(
            scene,
            [self.views.cameras[i] for i in seen],
            self.profile.compaction,
            smallest=0.5 * self.steps,
            weights=self.weights[list(seen)],
            progress=self.progress,
        )[0]

    def pays(self, scene: Scene, operator: ImageOperator) -> bool:
        """Whether compaction pays, measured in views that it did not use.

        Each fold compacts with most of the views and measures in the others. Compaction pays if,
        in every fold, it saves more bits than finer steps would take to win back the error, and
        the largest error stays within `_WORST`. Where views are few or far apart it does not pay:
        it keeps only the colours that these views see.
        """
        count = len(self.weights)
        if count < 2:
            return False
        plain, plain_bits, levels = _rounded(scene, self.steps)
        for first in range(min(_FOLDS, count)):
            others = range(first, count, _FOLDS)
            most = sorted(set(range(count)) - set(others))
            sparse, sparse_bits, _ = _rounded(self.by(scene, most), self.steps)
            lost, before = (self._errors(coded, operator, others) for coded in (sparse, plain))
            # Halving all steps takes one bit for each non-zero value and divides the error by 4.
            octaves = 0.5 * math.log2(lost.mean() / before.mean())
            if sparse_bits + (_OTHERS + levels) * octaves >= plain_bits:
                return False
            if lost.max() > _WORST * before.max():
                return False
        return True

    def _errors(
        self, scene: Scene, operator: ImageOperator, seen: Sequence[int]
    ) -> NDArray[np.float64]:
        """Mean squared errors in some of the views."""
        values = [self.views.images[view].size for view in seen]
        advance = step_counter(self.progress, "measure", len(seen))
        errors = operator.errors(coefficients_of(scene), self.views.images, seen, advance)
        return np.maximum(errors / values, _EPS)


def _rounded(scene: Scene, steps: NDArray[np.float32]) -> tuple[Scene, float, float]:
    """Round SH-AC to their steps; return also estimated bits and non-zero levels a Gaussian."""
    f_rest = np.empty_like(scene.f_rest)
    rounded = f_rest.reshape(3, -1, scene.count)
    bits = levels = 0.0
    for k, plane in enumerate(scene.f_rest.reshape(3, -1, scene.count).swapaxes(0, 1)):
        found = np.rint(to_ycocg(plane) / steps)
        rounded[:, k] = from_ycocg(found * steps)
        levels += np.count_nonzero(found)
        for row in np.clip(found, -_LARGEST, _LARGEST).astype(np.int64):
            bits += shannon_bits(np.bincount(row + _LARGEST))
    return replace(scene, f_rest=f_rest), bits / scene.count, levels / scene.count
