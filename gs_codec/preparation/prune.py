"""Rules for pruning: by position, by importance, or by the error of images without a Gaussian.

Every rule returns the indices of the Gaussians that stay, in the scene's order. Among equal scores,
the first in the scene is removed first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene

#: Exponent of a Gaussian's volume in LightGaussian's score, and the quantile it is divided by.
_VOLUME_POWER, _VOLUME_QUANTILE = 0.1, 0.9


def portion(count: int, percent: float) -> int:
    """Number of Gaussians in `percent` percent of `count`, rounded down.

    Raises
    ------
    InvalidInput
        If the percentage is not from 0 to 100, or nothing would be left.
    """
    if not 0 <= percent <= 100:
        raise InvalidInput(f"{percent:g} %: expected a percentage, 0 to 100")
    # The millionth makes up for binary rounding of percentages: 7 % of 100 is 7.
    number = int(np.floor(count * percent / 100 + 1e-6))
    if number >= count > 0:
        raise InvalidInput(f"pruning {percent:g} % of {count} Gaussians would leave none")
    return number


def keep_highest(scores: NDArray, number: int) -> NDArray[np.int64]:
    """Indices of all but the `number` lowest of ``scores (N,)``."""
    return np.sort(np.argsort(scores, kind="stable")[number:])


def keep_near(scene: Scene, percent: float) -> NDArray[np.int64]:
    """Remove the `percent` farthest from the centre along x, then of the rest along y, then z.

    The paper's geometry pruning (Section 4.2): N (1 - theta2)^3 stay. The centre is the median.
    """
    centre = np.median(scene.positions, axis=1) if scene.count else np.zeros(3)
    kept = np.arange(scene.count)
    for axis in range(3):
        distance = np.abs(scene.positions[axis, kept].astype(np.float64) - centre[axis])
        kept = kept[keep_highest(-distance, portion(len(kept), percent))]
    return kept


def importance(
    scene: Scene, cameras: Sequence[Camera], advance: Callable[[], None] | None = None
) -> NDArray[np.float64]:
    """LightGaussian's score (Fan et al. 2023, Section 3.2; the paper's Section 4.2), ``(N,)``.

    Opacity times the transmittance in front of the Gaussian, summed over its pixels and the views,
    times (volume / 90th percentile of volumes)^0.1. Larger volumes count as the 90th percentile.
    """
    seen = np.zeros(scene.count)
    for camera in cameras:
        sums = render(scene, camera, accumulate=True).accumulations
        assert sums is not None
        seen += sums.transmittance
        if advance is not None:
            advance()
    log_volume = scene.log_scale.sum(axis=0, dtype=np.float64)
    largest = np.quantile(log_volume, _VOLUME_QUANTILE) if scene.count else 0.0
    volume = np.exp(_VOLUME_POWER * np.minimum(log_volume - largest, 0.0))
    return seen / (1.0 + np.exp(-scene.opacity[0].astype(np.float64))) * volume
