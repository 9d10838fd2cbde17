"""SH-AC moved to their Laplace range, as coding does too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gs_codec.quantise import CentredQuantiser, fit_centred
from gs_codec.scene import Scene


def rectify(scene: Scene, depth: int) -> tuple[Scene, int]:
    """Clip each SH-AC channel to the range it has at `depth` bits; see `fit_centred`.

    Returns
    -------
    Scene
    int
        Values that were moved.
    """
    clipped = scene.f_rest.copy()
    for row in clipped:
        quantiser, _ = fit_centred(row, depth)
        if isinstance(quantiser, CentredQuantiser):
            centre, reach = quantiser.centre, quantiser.half_range
            np.clip(row, centre - reach, centre + reach, out=row)
    return replace(scene, f_rest=clipped), int(np.count_nonzero(clipped != scene.f_rest))
