"""A short training of Gaussians on photographs, like the 3DGS trainer's without densification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.preparation.adam import new_state, rig_radius
from gs_codec.preparation.optimise import take_steps, view_of, with_values
from gs_codec.rendering.gradients import differentiate
from gs_codec.scene import GROUPS, Scene

#: Initial step sizes of Adam; positions in radii of the camera rig. Those of `optimise` are for
#: trained scenes: from initial points, after 200 iterations on `orbit`, test views were 4 dB worse
#: with them, and the Gaussians nearly spherical.
_RATES = {
    "positions": 1e-3,
    "f_dc": 2.5e-2,
    "f_rest": 2.5e-3,
    "opacity": 0.2,
    "log_scale": 0.12,
    "rot": 0.05,
}

#: Factor on all step sizes at the end; they decay exponentially.
_LAST = 0.03

#: Share of the iterations with images of half size.
_COARSE = 0.5

Image = NDArray[np.float32]


def train(
    scene: Scene, cameras: Sequence[Camera], images: Sequence[Image], iterations: int
) -> Scene:
    """Fit all attributes of a scene's Gaussians to images, one view per iteration."""
    state = new_state(np.concatenate([getattr(scene, group) for group in GROUPS]))
    fitted = with_values(scene, state.values.T)
    rates = _RATES | {"positions": _RATES["positions"] * rig_radius(cameras)}
    sizes = np.concatenate([np.full(len(getattr(scene, group)), rates[group]) for group in GROUPS])
    fine = list(zip(cameras, images, strict=True))
    coarse = [_halved(*view) for view in fine]
    for i in range(iterations):
        view = view_of(i, len(fine))
        camera, image = (coarse if i < _COARSE * iterations else fine)[view]
        result = differentiate(fitted, camera, image, (0.0, 0.0, 0.0))
        take_steps(state, [result], i + 1, [sizes * _LAST ** (i / iterations)])
    return fitted


def _halved(camera: Camera, image: Image) -> tuple[Camera, Image]:
    """The view at half size; a last odd row or column is dropped."""
    h, w = camera.height // 2, camera.width // 2
    smaller = replace(camera, width=2 * w, height=2 * h).resized(w, h)
    mean = image[: 2 * h, : 2 * w].reshape(h, 2, w, 2, 3).mean(axis=(1, 3))
    return smaller, np.ascontiguousarray(mean)
