"""A short training of Gaussians on photographs, as the 3DGS trainer's without densification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.preparation.adam import AdamState, adam_step, new_state, rig_radius
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.gradients import Differentiated, differentiate
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene

#: Step sizes of Adam at the start; positions in radii of the camera rig. Those of `optimise` are
#: for scenes that are trained already: from initial points, after 200 iterations on `orbit`, test
#: views were 4 dB worse with them, and the Gaussians nearly round.
_RATES = {
    "positions": 1e-3,
    "f_dc": 2.5e-2,
    "f_rest": 2.5e-3,
    "opacity": 0.2,
    "log_scale": 0.12,
    "rot": 0.05,
}

#: Factor on all step sizes at the end; they fall exponentially.
_LAST = 0.03

#: Share of the iterations on images of half the size.
_COARSE = 0.5

#: Gaussians that one task updates.
_CHUNK = 1000

Image = NDArray[np.float32]


def train(
    scene: Scene, cameras: Sequence[Camera], images: Sequence[Image], iterations: int
) -> Scene:
    """Fit all attributes of a scene's Gaussians to images, one view an iteration."""
    state = new_state(np.concatenate([getattr(scene, group) for group in GROUPS]))
    ends = np.cumsum([len(getattr(scene, group)) for group in GROUPS])
    # Views of the state's values, so the scene follows its changes.
    planes: dict[str, Any] = dict(zip(GROUPS, np.split(state.values, ends[:-1]), strict=True))
    fitted = replace(scene, **planes)
    rates = _RATES | {"positions": _RATES["positions"] * rig_radius(cameras)}
    sizes = np.concatenate([np.full(len(plane), rates[group]) for group, plane in planes.items()])
    fine = list(zip(cameras, images, strict=True))
    coarse = [_halved(*view) for view in fine]
    for i in range(iterations):
        epoch, index = divmod(i, len(fine))
        view = np.random.default_rng([0, epoch]).permutation(len(fine))[index]
        camera, image = (coarse if i < _COARSE * iterations else fine)[view]
        result = differentiate(fitted, camera, image, (0.0, 0.0, 0.0))
        _update(state, result, i + 1, sizes * _LAST ** (i / iterations))
    return fitted


def _update(
    state: AdamState, result: Differentiated, step: int, sizes: NDArray[np.float64]
) -> None:
    count = state.values.shape[1]

    def update(start: int) -> None:
        stop = min(start + _CHUNK, count)
        first, end = np.searchsorted(result.chosen, (start, stop))
        slopes = result.slopes(first, end)
        adam_step(*state, step, sizes, slopes, result.chosen[first:end], start, stop)

    run_all(update, range(0, count, _CHUNK))


def _halved(camera: Camera, image: Image) -> tuple[Camera, Image]:
    """The view with four pixels in one; a last odd row or column is left out."""
    h, w = camera.height // 2, camera.width // 2
    smaller = replace(camera, width=2 * w, height=2 * h).resized(w, h)
    mean = image[: 2 * h, : 2 * w].reshape(h, 2, w, 2, 3).mean(axis=(1, 3))
    return smaller, np.ascontiguousarray(mean)
