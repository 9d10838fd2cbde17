"""Guidance for camera-guided encoding: sensitivities, and SH compaction and refitting to views."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.shaped import ShapedScene
from gs_codec.codecs.adaptive.step_sizes import (
    Sensitivity,
    StepSizes,
    expected_sensitivity,
    fit_step_sizes,
)
from gs_codec.codecs.interchange import RoundedScene
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.frequency_table import shannon_bits
from gs_codec.coding.ycocg import from_ycocg, to_ycocg
from gs_codec.config import AdaptiveProfile
from gs_codec.guidance.cross_validation import blend, blind_share
from gs_codec.guidance.joint_rounding import round_jointly
from gs_codec.guidance.round_sh import round_rgb, round_sh
from gs_codec.guidance.sensitivity import sensitivity
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.image_operator import ImageOperator, Places
from gs_codec.preparation.likely_views import likely_views
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sh_weights import coefficients_of
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.arrays import release_freed
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, channel_count, inverse_of

#: Conjugate-gradient iterations of the colour refit.
_REFIT = 6

#: The same for a pruned scene, which gains more from refitting.
_REFIT_PRUNED = 10

#: Cross-validation over views to decide whether compaction pays off: a fold is every fourth view,
#: and every other fold is held out once.
_FOLD = 4

#: Maximum factor by which compaction may multiply the largest error of held-out views.
_WORST = 16.0

#: Share of the allowed cost below which one fold is enough to decide.
_CLEAR = 0.5

#: It is first tried on every n-th Gaussian. If errors do not grow, this decides.
_TRIED = 4

#: Values of a Gaussian without SH-AC; each takes one more bit when step sizes are halved.
_OTHERS = 14

#: Lower bound of mean squared errors.
_EPS = 1e-12

#: Levels of SH-AC are clipped to this when bits are estimated.
_LARGEST = 1 << 11


#: A scene with all but its colours quantised, for `.egs` or another format.
Shaped = ShapedScene | RoundedScene


@dataclass
class Guidance:
    """Guidance for the encoder, from cameras.

    Attributes
    ----------
    steps_adding : callable
        A function from the total squared error that all parameters may add to step sizes.
    loss : float
        Mean squared error of an image value before encoding; pruning may have caused it.
    pixels : int
        Number of pixels of all views.
    views : ReferenceViews
    weights : ndarray, shape (views, N), float32
        Sums of (alpha T)^2 of the encoded scene.
    order : ndarray, shape (N,)
        The order of Gaussians in `weights`, as indices of the scene.
    progress : callable, optional
    compacts : bool or None
        Whether compaction of SH pays off; None until decided.
    operator : ImageOperator or None
        Images as a function of SH, for the most recent shapes.
    """

    steps_adding: Callable[[float], StepSizes]
    loss: float
    pixels: int
    views: ReferenceViews
    weights: NDArray[np.float32]
    order: NDArray[np.integer]
    progress: Progress | None = None
    compacts: bool | None = None
    operator: ImageOperator | None = None

    def steps(self, profile: AdaptiveProfile) -> StepSizes:
        """Step sizes that add the error allowed by a profile, before colours are refitted."""
        return self.steps_adding(self._error(profile))

    def _error(self, profile: AdaptiveProfile) -> float:
        """Total squared error that all parameters may add."""
        error = profile.error / profile.left + profile.of_loss * self.loss
        return error * 3 * self.pixels

    def _parameter_error(self, profile: AdaptiveProfile, scene: Scene) -> float:
        """Squared error that each parameter may add."""
        return self._error(profile) / (scene.count * channel_count(len(scene.f_rest) // 3))

    def recolour(self, shaped: Shaped, profile: AdaptiveProfile, compacting: bool = True) -> Scene:
        """`compact`, then refit SH to compensate for quantisation and compaction, then round.

        SH-AC end on their levels, if they are coded as levels.
        """
        other = shaped if isinstance(shaped, RoundedScene) else None
        compacting = compacting and (other is None or other.is_sparse)
        decoded = self.compact(shaped, profile) if compacting else shaped.decoded()
        iterations, progress = _REFIT_PRUNED if self.loss > 0 else _REFIT, self.progress
        refitted, _ = refit_colour(
            decoded,
            self.views,
            iterations,
            operator=self._operator_of(decoded),
            progress=progress,
        )
        self._forget_operator()
        error = self._parameter_error(profile, refitted)
        weights, cameras = self._weights_in(shaped.order), self.views.cameras
        if other is None:
            return round_sh(refitted, cameras, weights, shaped.sh_steps(), error, progress)
        grid = other.sh_grid()
        if grid is None or not refitted.sh_degree:
            return refitted
        return round_rgb(refitted, cameras, weights, grid, progress)

    def round(self, shaped: Shaped, profile: AdaptiveProfile) -> Shaped:
        """Round a recoloured scene jointly, if the profile does; see `round_jointly`."""
        looks = round(profile.looks * len(self.views.cameras))
        if isinstance(shaped, RoundedScene) or not looks or not shaped.source.count:
            return shaped
        error = self._parameter_error(profile, shaped.source)
        return round_jointly(shaped, self.views, error, looks, self.progress)

    def compact(self, shaped: Shaped, profile: AdaptiveProfile, decide: bool = True) -> Scene:
        """The decoded scene in stream order, with its SH compacted if this pays off.

        The first call decides whether it pays off. Without `decide`, compaction is assumed to pay
        off unless already decided; this is a quick way to estimate sizes.
        """
        decoded, steps = shaped.decoded(), shaped.sh_steps().min(axis=0)
        if not decoded.sh_degree:
            return decoded
        weights = self._weights_in(shaped.order)
        likely = likely_views(decoded, weights) if self.views.origin == "estimated" else None

        def compacted(seen: Sequence[int], every: int = 1) -> Scene:
            """Every n-th Gaussian, compacted with some of the views."""
            part = np.arange(0, decoded.count, every)
            some = decoded if every == 1 else decoded.take(part)
            return compact_sh(
                some,
                self.views.cameras,
                profile.compaction / profile.left * some.count / decoded.count,
                smallest=0.5 * steps[part],
                weights=weights[:, ::every],
                seen=seen,
                likely=likely and likely._replace(weights=likely.weights[:, ::every]),
                progress=self.progress,
            )[0]

        if decide and self.compacts is None:
            self.compacts = self._pays(decoded, steps, compacted)
        return decoded if self.compacts is False else compacted(range(len(weights)))

    def _weights_in(self, order: NDArray[np.integer]) -> NDArray[np.float32]:
        """Weights in a stream order, which they have from then on."""
        if not np.array_equal(self.order, order):
            before = inverse_of(self.order)[order]
            self.weights, self.order = np.take(self.weights.T, before, axis=0).T, order
        return self.weights

    def _pays(
        self,
        decoded: Scene,
        steps: NDArray[np.float32],
        compacted: Callable[[Sequence[int], int], Scene],
    ) -> bool:
        """Whether compaction pays off, measured in held-out views.

        Each fold compacts with most of the views and measures in the others. Compaction pays off
        if, in every fold, it saves more bits than finer steps would need to compensate for the
        error, and the largest error grows by at most `_WORST`. One fold is enough if the cost is
        much lower, and every n-th Gaussian of it if there is no cost at all. If views are few or
        far apart, compaction does not pay off: it would keep only the colours visible in these
        views.
        """
        count = len(self.weights)
        if count < 2:
            return False
        operator = self._operator_of(decoded)
        plain, plain_bits, levels = _rounded(decoded, steps)

        def tried(first: int, every: int) -> tuple[float, float, float]:
            """Cost and saving in bits, and the growth of the largest error, of `_WORST`."""
            others, part = range(first, count, _FOLD), slice(None, None, every)
            most = sorted(set(range(count)) - set(others))
            sparse, sparse_bits, _ = _rounded(compacted(most, every), steps[part])
            coded = replace(plain, f_dc=plain.f_dc.copy(), f_rest=plain.f_rest.copy())
            coded.f_dc[:, part], coded.f_rest[:, part] = sparse.f_dc, sparse.f_rest
            found, before = (self._errors(scene, operator, others) for scene in (coded, plain))
            lost = np.maximum(before + every * (found - before), _EPS)
            # Halving all steps takes one bit for each non-zero value and divides the error by 4.
            octaves = 0.5 * math.log2(lost.mean() / before.mean())
            growth = float(lost.max() / before.max()) / _WORST
            return (_OTHERS + levels) * octaves, plain_bits - sparse_bits, growth

        cost, _, growth = tried(0, _TRIED)
        if cost <= 0 and growth < _CLEAR:
            return True
        for first in range(0, min(_FOLD, count), 2):
            cost, saved, growth = tried(first, 1)
            if cost >= saved or growth > 1:
                return False
            if cost < _CLEAR * saved and growth < _CLEAR:
                break
        return True

    def _errors(
        self, scene: Scene, operator: ImageOperator, seen: Sequence[int]
    ) -> NDArray[np.float64]:
        """Mean squared errors in some of the views."""
        advance = step_counter(self.progress, "measure", len(seen))
        coefficients = coefficients_of(scene)
        used = coefficients != 0
        used[:, :, 0] = True
        errors = operator.errors(coefficients[used], Places.of(used), seen, advance)
        values = [3 * operator.pixels(view) for view in seen]
        return np.maximum(errors / values, _EPS)

    def _operator_of(self, scene: Scene) -> ImageOperator:
        if self.operator is None or not _same_shapes(self.operator.scene, scene):
            self._forget_operator()
            self.operator = ImageOperator(scene, self.views)
        return self.operator

    def _forget_operator(self) -> None:
        """Free the operator, which may take more than 1 GiB."""
        self.operator = None
        release_freed()


def _same_shapes(first: Scene, second: Scene) -> bool:
    return all(
        np.array_equal(getattr(first, name), getattr(second, name))
        for name in ("positions", "opacity", "log_scale", "rot")
    )


def guide(scene: Scene, views: ReferenceViews, progress: Progress | None = None) -> Guidance:
    """Measure the guidance for an encoder from the views of a scene.

    Views without images get renders of the scene itself.
    """
    release_freed()  # preparation had many images
    found, weights, images = sensitivity(scene, views, progress)
    loss = 0.0
    if views.images:
        loss = views.error(scene, progress)
    else:
        views = replace(views, images=images)
    advance = step_counter(progress, "steps", 2)
    share = blind_share(scene, weights, views.cameras, views.origin == "estimated")
    advance()
    adding = steps_adding(scene, found, share)
    advance()
    pixels = sum(camera.width * camera.height for camera in views.cameras)
    return Guidance(adding, loss, pixels, views, weights, np.arange(scene.count), progress)


def steps_adding(
    scene: Scene, found: Sensitivity, blind: float = 0.0
) -> Callable[[float], StepSizes]:
    """A function from the total squared error that all parameters may add to step sizes.

    `blind` is the share of the camera-free rules in the sensitivities.
    """
    axes, scales, _ = sort_axes(scene.log_scale, scene.rot)
    by_axis = {
        name: np.take_along_axis(getattr(found, name), axes.astype(np.int64), 0)
        for name in ("log_scale", "rot")
    }
    found = found._replace(**by_axis)
    if blind:
        found = blend(found, expected_sensitivity(scene.opacity[0], scales), blind)
    by_error = fit_step_sizes(found, scene.opacity[0], scales)
    parameters = scene.count * channel_count(len(scene.f_rest) // 3)
    return lambda error: by_error(error / parameters)


def _rounded(scene: Scene, steps: NDArray[np.float32]) -> tuple[Scene, float, float]:
    """Round SH-AC to their steps; also return estimated bits and non-zero levels per Gaussian."""
    f_rest = np.empty_like(scene.f_rest)
    planes, rounded = (x.reshape(3, -1, scene.count) for x in (scene.f_rest, f_rest))

    def run(k: int) -> tuple[float, int]:
        found = np.rint(to_ycocg(planes[:, k]) / steps)
        rounded[:, k] = from_ycocg(found * steps)
        rows = np.clip(found, -_LARGEST, _LARGEST).astype(np.int64)
        bits = sum(shannon_bits(np.bincount(row + _LARGEST)) for row in rows)
        return bits, int(np.count_nonzero(found))

    bits, levels = map(sum, zip(*run_all(run, range(planes.shape[1])), strict=True))
    return replace(scene, f_rest=f_rest), bits / scene.count, levels / scene.count
