"""Encoding by views: steps by what they see, and colours that make up for what shapes lose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.lattice_encode import ShapedScene
from gs_codec.config import LatticeProfile
from gs_codec.lattice.fit import Steps, fit_steps
from gs_codec.lattice.sensitivity import Sensitivity
from gs_codec.model.table import shannon_bits
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.image_operator import ImageOperator
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sensitivity import sensitivity
from gs_codec.preparation.sh_weights import coefficients_of
from gs_codec.preparation.targets import Targets
from gs_codec.report import Progress, step_counter
from gs_codec.scene import Scene, channel_count
from gs_codec.transform.axes import sort_axes
from gs_codec.transform.ycocg import from_ycocg, to_ycocg

#: Conjugate-gradient steps of the refit.
_REFIT = 10

#: Compaction is tried without one of so many views, and judged by these, until all were left out.
_FOLDS = 4

#: By what the error of the worst of those left out may grow.
_WORST = 16.0

#: Values of a Gaussian, SH-AC aside, that take a bit more when steps are halved.
_OTHERS = 14

#: Mean squared errors below this are not told apart.
_EPS = 1e-12

#: Largest level of SH-AC that is told from others where bits are estimated.
_LARGEST = 1 << 11


@dataclass(frozen=True)
class Guidance:
    """What views say of a scene to be encoded.

    Attributes
    ----------
    sensitivity : Sensitivity
    loss : float
        Mean squared error of an image value that the scene has already, pruned as it may be.
    pixels : int
        Of all views together.
    colours : Colours
    """

    sensitivity: Sensitivity
    loss: float
    pixels: int
    colours: Colours

    def steps(self, scene: Scene, profile: LatticeProfile) -> Steps:
        """Step sizes of the scene, or of it with other colours."""
        return guided_steps(scene, profile, self.sensitivity, self.loss, self.pixels)

    def recolour(self, shaped: ShapedScene, profile: LatticeProfile) -> ShapedScene:
        """Compact and refit the SH of a scene whose shapes are rounded."""
        decoded, steps = shaped.decoded(), shaped.sh_steps()
        decoded = self.colours.compact(decoded, shaped.order, steps, profile)
        return shaped.with_colours(self.colours.refit(decoded))


def guided_steps(
    scene: Scene, profile: LatticeProfile, sensitivity: Sensitivity, loss: float, pixels: int
) -> Steps:
    """Step sizes at which a scene loses what a profile allows; see `Guidance`."""
    axes, scales, _ = sort_axes(scene.log_scale, scene.rot)
    sorted_axes = np.take_along_axis(sensitivity.log_scale, axes.astype(np.int64), 0)
    # What all may add together, over the parameters that there are.
    parameters = scene.count * channel_count(len(scene.f_rest) // 3)
    error = (profile.error + profile.of_loss * loss) * 3 * pixels / parameters
    return fit_steps(sensitivity._replace(log_scale=sorted_axes), scene.opacity[0], scales, error)


def guide(
    scene: Scene,
    views: Targets,
    progress: Progress | None = None,
) -> Guidance:
    """What views say of a scene to be encoded."""
    cameras = views.cameras
    loss = views.error(scene, progress)
    found, weights = sensitivity(
        scene, cameras, views.background, progress, keep=scene.sh_degree > 0
    )
    pixels = sum(camera.width * camera.height for camera in cameras)
    return Guidance(found, loss, pixels, Colours(views, weights, progress))


@dataclass
class Colours:
    """Choice of colours for a scene whose shapes are rounded.

    Scenes are given as they decode, in an order ``(N,)`` of the one that was looked at, but for
    their SH, which are the original's; `steps` ``(N,)`` are what these will be quantised at. SH
    are compacted where views tell enough of them, which is found out at the steps that are asked
    for first, sketches aside.

    Attributes
    ----------
    views : Targets
    weights : ndarray, shape (views, N), float32
        Sums of (alpha T)^2 of the scene that is encoded, in its own order.
    compacts : bool or None
        Whether compaction pays, once that is known.
    operator : ImageOperator or None
        What views see of the shapes they were asked about last.
    """

    views: Targets
    weights: NDArray[np.float32]
    progress: Progress | None
    compacts: bool | None = None
    operator: ImageOperator | None = None

    def compact(
        self,
        decoded: Scene,
        order: NDArray[np.unsignedinteger],
        steps: NDArray[np.float32],
        profile: LatticeProfile,
    ) -> Scene:
        """A scene with fewer SH that are not 0."""
        if decoded.sh_degree and self.compacts is None:
            trial = self._compaction(order, steps, profile)
            self.compacts = trial.pays(decoded, self._operator_of(decoded))
        return self.sketch(decoded, order, steps, profile)

    def sketch(
        self,
        decoded: Scene,
        order: NDArray[np.unsignedinteger],
        steps: NDArray[np.float32],
        profile: LatticeProfile,
    ) -> Scene:
        """As `compact`, without asking whether views tell enough: quick, for sizes."""
        if not decoded.sh_degree or self.compacts is False:
            return decoded
        return self._compaction(order, steps, profile).whole(decoded)

    def refit(self, decoded: Scene) -> Scene:
        """A scene with SH that make up for what its shape, and compaction, have lost."""
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
        profile: LatticeProfile,
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
    """Compaction of a scene at the steps its SH will have."""

    views: Targets
    weights: NDArray[np.float32]
    steps: NDArray[np.float32]
    profile: LatticeProfile
    progress: Progress | None

    def whole(self, scene: Scene) -> Scene:
        """The scene compacted by all views."""
        return self.by(scene, range(len(self.weights)))

    def by(self, scene: Scene, seen: Sequence[int]) -> Scene:
        """The scene compacted by some of the views."""
        return compact_sh(
            scene,
            [self.views.cameras[i] for i in seen],
            self.profile.compaction,
            smallest=0.5 * self.steps,
            weights=self.weights[list(seen)],
            progress=self.progress,
        )[0]

    def pays(self, scene: Scene, operator: ImageOperator) -> bool:
        """Whether views tell enough of the colours.

        They do if the bits saved are more than finer steps would take to win back what is lost,
        compacted by most of the views, in the others, and none of these is spoilt, whichever are
        left out: where views are few, or far apart, it keeps only what they see.
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
            # Halving all steps takes a bit for each value not 0, and a quarter of the error.
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
    """A scene as its SH-AC are coded; for each Gaussian the bits, about, and levels not 0."""
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
