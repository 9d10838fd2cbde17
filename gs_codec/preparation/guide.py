"""Encoding by views: steps by what they see, and colours that make up for what shapes lose."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import OF_LOSS, Guidance
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sensitivity import sensitivity
from gs_codec.preparation.targets import Targets, draw_targets
from gs_codec.rendering.camera import Camera
from gs_codec.report import Progress
from gs_codec.scene import Scene

#: Conjugate-gradient steps of the refit.
_REFIT = 10

#: Compaction is tried without one of so many views, and done if it loses no more in these than
#: its strength and a share of what is lost already.
_EVERY = 4


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

    def recolour(decoded: Scene, steps: NDArray[np.float32], compaction: float) -> Scene:
        def compact(seen: Sequence[Camera]) -> Scene:
            return compact_sh(
                decoded,
                seen,
                compaction,
                smallest=0.5 * steps,
                threads=threads,
                progress=progress,
            )[0]

        start = decoded
        allowed = compaction + OF_LOSS * loss
        if scene.sh_degree and _loss_unseen(decoded, views, compact) <= allowed:
            start = compact(cameras)
        refitted, _ = refit_colour(
            start,
            cameras,
            views.images,
            _REFIT,
            background=background,
            threads=threads,
            progress=progress,
        )
        return refitted

    pixels = sum(camera.width * camera.height for camera in cameras)
    return Guidance(found, loss, pixels, recolour)


def _loss_unseen(
    scene: Scene, views: Targets, compact: Callable[[Sequence[Camera]], Scene]
) -> float:
    """Mean squared error that compaction by most of the views adds to the others.

    Where views are few, or far apart, it keeps only what they see.
    """
    others = views.cameras[::_EVERY]
    most = [camera for i, camera in enumerate(views.cameras) if i % _EVERY]
    if not most:
        return math.inf
    return draw_targets(scene, others, views.background).error(compact(most))
