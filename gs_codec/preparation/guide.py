"""Encoding by views: steps by what they see, and colours that make up for what shapes lose."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import Guidance
from gs_codec.config import LatticeProfile
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sensitivity import sensitivity
from gs_codec.preparation.sh_weights import squared_weights
from gs_codec.preparation.targets import Targets, draw_targets
from gs_codec.report import Progress
from gs_codec.scene import Scene

#: Conjugate-gradient steps of the refit.
_REFIT = 10

#: Compaction is tried without one of so many views, and done if in these it loses at most so
#: much of its strength, and a share of what is lost already: what the others do not tell costs
#: 1.1 times the strength where they surround a scene, and 7 to 50 times where they are too few.
_EVERY, _UNSEEN = 4, 2.0


def guide(
    scene: Scene,
    views: Targets,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Guidance:
    """What views say of a scene to be encoded.

    Colours are refitted to the views' images once shapes are rounded and, where views tell enough
    of them, compacted before.
    """
    cameras, background = views.cameras, views.background
    loss = views.error(scene)
    found = sensitivity(scene, cameras, background, threads=threads, progress=progress)

    @cache
    def weights() -> NDArray[np.float32]:
        return squared_weights(scene, cameras, None, threads, progress)

    def compact(
        decoded: Scene,
        order: NDArray[np.unsignedinteger],
        steps: NDArray[np.float32],
        profile: LatticeProfile,
    ) -> Scene:
        if not scene.sh_degree:
            return decoded
        allowed = _UNSEEN * profile.compaction + profile.of_loss * loss
        of_views = weights()[:, order]
        return _compact(decoded, views, of_views, steps, profile.compaction, allowed, threads)

    def refit(decoded: Scene) -> Scene:
        return refit_colour(
            decoded,
            cameras,
            views.images,
            _REFIT,
            background=background,
            threads=threads,
            progress=progress,
        )[0]

    pixels = sum(camera.width * camera.height for camera in cameras)
    return Guidance(found, loss, pixels, compact, refit)


def _compact(
    scene: Scene,
    views: Targets,
    weights: NDArray[np.float32],
    steps: NDArray[np.float32],
    strength: float,
    allowed: float,
    threads: int | None,
) -> Scene:
    """The scene compacted; itself where that keeps only what these very views see.

    Compacted by most of the views it may lose a mean squared error `allowed` in the others.
    """
    every = np.arange(len(views.cameras))
    most = every[every % _EVERY > 0]

    def compact(seen: NDArray[np.intp]) -> Scene:
        cameras = [views.cameras[i] for i in seen]
        least = 0.5 * steps
        return compact_sh(
            scene, cameras, strength, smallest=least, weights=weights[seen], threads=threads
        )[0]

    if not len(most):
        return scene
    others = draw_targets(scene, views.cameras[::_EVERY], views.background)
    return compact(every) if others.error(compact(most)) <= allowed else scene
