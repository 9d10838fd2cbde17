"""Encoding by views: steps by what they see, and colours that make up for what shapes lose."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import Guidance
from gs_codec.config import LatticeProfile
from gs_codec.model.table import shannon_bits
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sensitivity import sensitivity
from gs_codec.preparation.sh_weights import squared_weights
from gs_codec.preparation.targets import Targets
from gs_codec.report import Progress
from gs_codec.scene import Scene
from gs_codec.transform.ycocg import from_ycocg, to_ycocg

#: Conjugate-gradient steps of the refit.
_REFIT = 10

#: Compaction is tried without one of so many views, and judged by these.
_EVERY = 4

#: By what the error of the worst of these may grow.
_WORST = 4.0

#: Values of a Gaussian, SH-AC aside, that take a bit more when steps are halved.
_OTHERS = 14

#: Mean squared errors below this are not told apart.
_EPS = 1e-12

#: Largest level of SH-AC that is told from others where bits are estimated.
_LARGEST = 1 << 11


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
        of_views = weights()[:, order]
        return _compact(decoded, views, of_views, steps, profile.compaction, threads)

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
    threads: int | None,
) -> Scene:
    """The scene compacted, or itself where that does not pay.

    It pays if the bits it saves are more than finer steps would take to win back what it loses,
    compacted by most of the views, in the others, and none of these is spoilt: where views are
    few, or far apart, it keeps only what they see.
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
    others = replace(views, cameras=views.cameras[::_EVERY], images=views.images[::_EVERY])
    plain, plain_bits, levels = _rounded(scene, steps)
    sparse, sparse_bits, _ = _rounded(compact(most), steps)
    lost, before = (np.maximum(others.errors(coded), _EPS) for coded in (sparse, plain))
    if lost.max() > _WORST * before.max():
        return scene
    # Halving all steps takes a bit for each value that is not 0, and a quarter of the error.
    octaves = 0.5 * math.log2(lost.mean() / before.mean())
    return compact(every) if sparse_bits + (_OTHERS + levels) * octaves < plain_bits else scene


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
