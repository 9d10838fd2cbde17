"""Encoding by views: steps by what they see, and colours that make up for what shapes lose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import Guidance
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sensitivity import sensitivity
from gs_codec.preparation.targets import Targets
from gs_codec.report import Progress
from gs_codec.scene import Scene

#: Conjugate-gradient steps of the refit.
_REFIT = 10


def guide(
    scene: Scene,
    views: Targets,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Guidance:
    """What views say of a scene to be encoded.

    Colours are compacted and refitted to the views' images once shapes are rounded.
    """
    cameras, background = views.cameras, views.background
    found = sensitivity(scene, cameras, background, threads=threads, progress=progress)

    def recolour(decoded: Scene, steps: NDArray[np.float32], compaction: float) -> Scene:
        compact, _ = compact_sh(
            decoded,
            cameras,
            compaction,
            smallest=0.5 * steps,
            threads=threads,
            progress=progress,
        )
        refitted, _ = refit_colour(
            compact,
            cameras,
            views.images,
            _REFIT,
            background=background,
            threads=threads,
            progress=progress,
        )
        return refitted

    pixels = sum(camera.width * camera.height for camera in cameras)
    return Guidance(found, views.error(scene), pixels, recolour)
