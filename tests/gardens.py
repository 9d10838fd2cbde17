"""A small scene among cameras, its renders, and a version to fit to them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from splats import render, splats, straight

from gs_codec.cameras.camera import Camera
from gs_codec.preparation.optimise import optimise
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.scene import GROUPS, Scene


def orbit(count: int = 5, width: int = 40, height: int = 32) -> list[Camera]:
    """Cameras around the origin that look at it."""
    cameras = []
    for i in range(count):
        angle = 0.5 * i
        turn = np.array(
            [
                [np.cos(angle), 0, -np.sin(angle)],
                [0, 1, 0],
                [np.sin(angle), 0, np.cos(angle)],
            ]
        )
        camera = straight(width, height, fx=40.0, fy=40.0)
        cameras.append(replace(camera, name=f"view {i}", rotation=turn, position=-4 * turn[2]))
    return cameras


def garden(seed: int, sh_degree: int = 1, count: int = 60) -> Scene:
    rng = np.random.default_rng(seed)
    scene = splats(
        rng.normal(scale=0.7, size=(count, 3)),
        f_dc=rng.normal(size=(3, count)),
        f_rest=rng.normal(scale=0.2, size=(9 if sh_degree else 0, count)),
        opacity=rng.normal(1.0, 1.0, size=count),
        log_scale=rng.normal(-1.6, 0.4, size=(3, count)),
        rot=rng.normal(size=(4, count)),
    )
    return replace(scene, comments=("a garden",), extra={"label": np.arange(count, dtype=np.int32)})


def changed(scene: Scene, seed: int, scale: float = 0.05) -> Scene:
    rng = np.random.default_rng(seed)
    planes = {
        group: (
            getattr(scene, group) + rng.normal(scale=scale, size=getattr(scene, group).shape)
        ).astype(np.float32)
        for group in GROUPS
    }
    return replace(scene, **planes)


def views(scene: Scene, cameras: list[Camera]) -> list[np.ndarray]:
    return [render(scene, camera).colour for camera in cameras]


def psnr(scene: Scene, cameras, targets) -> float:
    errors = [np.mean((a - b) ** 2) for a, b in zip(views(scene, cameras), targets, strict=True)]
    return float(-10 * np.log10(np.mean(errors)))


#: Default cameras of renders.
CAMERAS = orbit()

#: Default scene to fit.
SCENE = changed(garden(1), 2)


@cache
def renders() -> list[np.ndarray]:
    """Target images for fitting `SCENE`; not rendered while tests are only collected."""
    return views(garden(1), CAMERAS)


def refit(
    iterations: int = 12, scene=SCENE, targets=None, cameras=CAMERAS, background=(0, 0, 0),
    **options,
):  # fmt: skip
    references = ReferenceViews(tuple(cameras), targets or renders(), True, background)
    return optimise(scene, references, iterations, **options)
