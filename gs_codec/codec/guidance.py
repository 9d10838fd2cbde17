"""What an encoder may be told by views of a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import LatticeProfile
from gs_codec.lattice.sensitivity import Sensitivity
from gs_codec.scene import Scene


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
    recolour : callable
        ``recolour(scene, steps, profile) -> Scene``: given the scene as it decodes but for its SH,
        which are the original's, the steps ``(N,)`` its SH will be quantised at, and the profile,
        a scene with SH that make up for what its shape has
        lost.
    """

    sensitivity: Sensitivity
    loss: float
    pixels: int
    recolour: Callable[[Scene, NDArray[np.float32], LatticeProfile], Scene]
