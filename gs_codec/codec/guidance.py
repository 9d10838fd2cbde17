"""What an encoder may be told by views of a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import LatticeProfile
from gs_codec.lattice.sensitivity import Sensitivity
from gs_codec.scene import Scene

Compact = Callable[[Scene, NDArray[np.unsignedinteger], NDArray[np.float32], LatticeProfile], Scene]


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
    compact : callable
        ``compact(scene, order, steps, profile) -> Scene``: given the scene as it decodes but for
        its SH, which are the original's, in an order ``(N,)``, the steps ``(N,)`` its SH will be
        quantised at, and the profile, a scene with fewer SH that are not 0.
    sketch : callable
        As `compact`, without asking whether views tell enough for that: quick, for sizes.
    refit : callable
        ``refit(scene) -> Scene``: given that, a scene with SH that make up for what its shape, and
        compaction, have lost.
    """

    sensitivity: Sensitivity
    loss: float
    pixels: int
    compact: Compact = lambda decoded, *_: decoded
    sketch: Compact = lambda decoded, *_: decoded
    refit: Callable[[Scene], Scene] = lambda decoded: decoded
