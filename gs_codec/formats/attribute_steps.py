"""Step sizes that a writer may round attributes to, in addition to the format's own rounding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.arrays import empty
from gs_codec.scene import Scene, gather


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


#: Attributes with step sizes for each band or axis.
_OF_ROWS = ("f_rest", "log_scale")


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
    def of_size(cls, count: int) -> AttributeSteps:
        """Step sizes of a number of Gaussians, to be set."""
        return cls(**{f.name: empty(_shape(f.name, count), np.float64) for f in fields(cls)})

    @classmethod
    def least(cls, scene: Scene) -> AttributeSteps:
        """Step sizes finer than those of any format."""
        zero = np.zeros(())
        count = scene.count
        return cls(**{f.name: np.broadcast_to(zero, _shape(f.name, count)) for f in fields(cls)})

    @classmethod
    def joined(cls, parts: Sequence[AttributeSteps]) -> AttributeSteps:
        """Step sizes of the Gaussians of all parts."""
        names = [f.name for f in fields(cls)]
        return cls(**{n: np.concatenate([getattr(p, n) for p in parts], axis=-1) for n in names})

    def times(self, factor: float) -> AttributeSteps:
        """Step sizes multiplied by a factor."""
        return replace(self, **{f.name: factor * getattr(self, f.name) for f in fields(self)})

    def set(self, some: slice, values: AttributeSteps) -> None:
        """Set the step sizes of a span of Gaussians."""
        for f in fields(self):
            getattr(self, f.name)[..., some] = getattr(values, f.name)

    def take(self, index: NDArray[np.integer]) -> AttributeSteps:
        """Step sizes of the Gaussians selected by `index`, in that order."""
        rows = {f.name: np.atleast_2d(getattr(self, f.name)) for f in fields(self)}
        taken = {name: gather(planes, index) for name, planes in rows.items()}
        return replace(self, **{n: t if n in _OF_ROWS else t[0] for n, t in taken.items()})

    def between(self, some: slice) -> AttributeSteps:
        """Step sizes of a span of Gaussians, without copying."""
        return replace(self, **{f.name: getattr(self, f.name)[..., some] for f in fields(self)})


def _shape(name: str, count: int) -> tuple[int, ...]:
    return (3, count) if name in _OF_ROWS else (count,)
