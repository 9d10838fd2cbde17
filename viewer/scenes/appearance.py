"""The Gaussians to draw, according to the appearance and hidden Gaussians."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import SH_COEFFICIENTS, Scene
from viewer.scenes.choice import Appearance
from viewer.scenes.opened import Opened


@dataclass(frozen=True, eq=False)
class Look:
    """How a scene is drawn.

    Attributes
    ----------
    appearance : Appearance
    drawn : ndarray, shape (N,), bool, or None
        Mask of drawn Gaussians; None if none is hidden. Must not be modified.
    """

    appearance: Appearance = field(default_factory=Appearance)
    drawn: NDArray[np.bool_] | None = None

    def is_same(self, other: Look) -> bool:
        """Whether the same Gaussians are drawn; backgrounds may differ."""
        background = other.appearance.background
        mine = replace(self.appearance, background=background)
        return mine == other.appearance and self.drawn is other.drawn


def which_drawn(scene: Opened, look: Look) -> NDArray[np.bool_] | None:
    """Mask ``(N,)`` of the drawn Gaussians of a scene; None if all are drawn."""
    least = look.appearance.least_opacity
    if least <= 0:
        return look.drawn
    opaque = scene.opacities >= least
    return opaque if look.drawn is None else opaque & look.drawn


def gaussians_drawn(scene: Opened, look: Look) -> Scene:
    """The Gaussians of a scene with an appearance applied, in the scene's order.

    Gaussians that are not drawn get opacity 0: the logit is -infinity, so rasterisers skip them.
    """
    gaussians, appearance = scene.gaussians, look.appearance
    mask, degree = which_drawn(scene, look), min(appearance.sh_degree, scene.sh_degree)
    if degree < scene.sh_degree:
        whole, kept = SH_COEFFICIENTS[scene.sh_degree], SH_COEFFICIENTS[degree]
        planes = gaussians.f_rest.reshape(3, whole, gaussians.count)[:, :kept]
        gaussians = replace(gaussians, f_rest=planes.reshape(3 * kept, gaussians.count))
    if appearance.scale != 1:
        longer = np.float32(math.log(appearance.scale))
        gaussians = replace(gaussians, log_scale=gaussians.log_scale + longer)
    if mask is not None:
        opacity = np.where(mask, gaussians.opacity, np.float32(-np.inf))
        gaussians = replace(gaussians, opacity=opacity)
    return gaussians
