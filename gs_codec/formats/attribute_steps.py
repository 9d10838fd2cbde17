"""Step sizes that a writer may round attributes to, in addition to the format's own rounding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import Scene


class ShGrid(NamedTuple):
    """Levels of a format for SH-AC: ``(level + offset) * step``.

    Attributes
    ----------
    steps : ndarray, shape (3, N), float32
        Step sizes of each band.
    offset : float
    """

    steps: NDArray[np.float32]
    offset: float


@dataclass(frozen=True)
class AttributeSteps:
    """Wanted step sizes of each Gaussian.

    Attributes
    ----------
    positions : ndarray, shape (N,)
        Scene units.
    f_dc : ndarray, shape (N,)
    f_rest : ndarray, shape (3, N)
        Of each band.
    opacity : ndarray, shape (N,)
        Logit.
    log_scale : ndarray, shape (3, N)
        Of each axis.
    rot : ndarray, shape (N,)
        Of the components of a unit quaternion.
    """

    positions: NDArray[np.floating]
    f_dc: NDArray[np.floating]
    f_rest: NDArray[np.floating]
    opacity: NDArray[np.floating]
    log_scale: NDArray[np.floating]
    rot: NDArray[np.floating]

    @classmethod
    def least(cls, scene: Scene) -> AttributeSteps:
        """Step sizes finer than those of any format."""
        rows = {"f_rest": (3, scene.count), "log_scale": (3, scene.count)}
        return cls(**{f.name: np.zeros(rows.get(f.name, scene.count)) for f in fields(cls)})

    @classmethod
    def joined(cls, parts: Sequence[AttributeSteps]) -> AttributeSteps:
        """Step sizes of the Gaussians of all parts."""
        names = [f.name for f in fields(cls)]
        return cls(**{n: np.concatenate([getattr(p, n) for p in parts], axis=-1) for n in names})

    def times(self, factor: float) -> AttributeSteps:
        """Step sizes multiplied by a factor."""
        return replace(self, **{f.name: factor * getattr(self, f.name) for f in fields(self)})

    def take(self, index: NDArray[np.integer] | slice) -> AttributeSteps:
        """Step sizes of the Gaussians selected by `index`, in that order."""
        return replace(self, **{f.name: getattr(self, f.name)[..., index] for f in fields(self)})
