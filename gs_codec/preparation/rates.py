"""Step sizes of a refit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.scene import GROUPS, Scene


@dataclass(frozen=True)
class Rates:
    """Step sizes of Adam at the start, and the factor on them at the end.

    In between they fall exponentially. The 3DGS trainer has 1.6e-4, 2.5e-3, 1.25e-4, 0.05, 5e-3
    and 1e-3 over 30,000 iterations; its rate for positions falls to 0.01, the others are constant.
    Here a run has a tenth of those iterations; on bonsai, higher rates that all fall were better.

    Parameters
    ----------
    positions : float
        In radii of the camera rig (see `rig_radius`).
    f_dc, f_rest : float
    opacity : float
        Logit.
    log_scale : float
    rot : float
        Quaternion as stored.
    last : float
        Factor on all rates at the end of the run; above 0.
    """

    positions: float = 6.4e-5
    f_dc: float = 1e-2
    f_rest: float = 5e-4
    opacity: float = 0.1
    log_scale: float = 2e-2
    rot: float = 4e-3
    last: float = 0.03

    def __post_init__(self) -> None:
        for name, rate in asdict(self).items():
            if not 0 <= rate < np.inf or (name == "last" and rate == 0):
                raise InvalidInput(f"rate {name}: {rate}, expected a finite number of at least 0")


def rig_radius(cameras: Sequence[Camera]) -> float:
    """Unit of position rates in 3DGS: 1.1 times the largest distance of a camera from the mean."""
    centres = np.array([camera.position for camera in cameras])
    return 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())


def step_sizes(scene: Scene, cameras: Sequence[Camera], rates: Rates) -> NDArray[np.float64]:
    """Step sizes ``(C,)`` of Adam at the start, for each channel in the order of `GROUPS`."""
    sizes = asdict(rates) | {"positions": rates.positions * rig_radius(cameras)}
    return np.concatenate([np.full(len(getattr(scene, group)), sizes[group]) for group in GROUPS])
