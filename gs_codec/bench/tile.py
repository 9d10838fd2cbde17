"""Scenes of any size from one real scene: copies side by side, every float jittered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gs_codec.scene import GROUPS, Scene

_JITTER = 1e-3


def tile_scene(scene: Scene, count: int, seed: int = 0) -> Scene:
    """`count` Gaussians: copies of `scene` on a square grid.

    Each float moves by a normal deviate of 1/1000 of its channel's standard deviation, so that
    copies are alike in distribution but in no value. Exact zeros of f_rest stay.
    """
    copies = -(-count // scene.count)
    side = int(np.ceil(np.sqrt(copies)))
    extent = np.ptp(scene.positions, axis=1)
    rng = np.random.default_rng(seed)
    planes: dict[str, Any] = {}
    for group in GROUPS:
        source = getattr(scene, group)
        tiled = np.tile(source, (1, copies))[:, :count]
        spread = source.std(axis=1, dtype=np.float64) * _JITTER
        for row, sigma in zip(tiled, spread, strict=True):
            jitter = rng.standard_normal(count, dtype=np.float32) * np.float32(sigma)
            row += np.where(row == 0, np.float32(0), jitter)
        planes[group] = tiled
    copy = np.arange(count) // scene.count
    planes["positions"][0] += extent[0] * (copy % side)
    planes["positions"][1] += extent[1] * (copy // side)
    return replace(scene, extra={}, **planes)
