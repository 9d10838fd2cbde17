"""Clip SH-AC to their Laplace range, as encoding with a `paper` profile does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isqrt

import numpy as np

from gs_codec.coding.quantise import CentredQuantiser, fit_centred
from gs_codec.scene import Scene


def rectify(scene: Scene, depths: Mapping[str, int]) -> tuple[Scene, int]:
    """Clip each SH-AC channel to the range it has at its band's depth; see `fit_centred`.

    Parameters
    ----------
    scene : Scene
    depths : mapping of str to int
        Bits of ``sh1``, ``sh2`` and ``sh3``.

    Returns
    -------
    Scene
    int
        Values that were moved.
    """
    clipped = scene.f_rest.copy()
    for index, row in enumerate(clipped):
        band = isqrt(index % (len(clipped) // 3) + 1)
        quantiser, _ = fit_centred(row, depths[f"sh{band}"])
        if isinstance(quantiser, CentredQuantiser):
            centre, reach = quantiser.centre, quantiser.half_range
            np.clip(row, centre - reach, centre + reach, out=row)
    return replace(scene, f_rest=clipped), int(np.count_nonzero(clipped != scene.f_rest))
