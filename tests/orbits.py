"""Cameras around a scene, and their renders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scenes import random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.preparation.reference_views import draw_reference_views
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene
from samples.generate import orbit_cameras


def cameras(count: int, width: int = 90, height: int = 60) -> list[Camera]:
    """Cameras around the scenes of samples/generate.py; every third is held out."""
    return [
        Camera(
            f"{i}", width, height, c["fx"], c["fy"], width / 2, height / 2,
            np.array(c["rotation"]).T, np.array(c["position"]), "test" if i % 3 == 1 else "train",
        )
        for i, c in enumerate(orbit_cameras(count, width, height))
    ]  # fmt: skip


def quality(original: Scene, decoded: Scene, views: list[Camera]) -> float:
    """PSNR in dB of a scene in views, relative to its original."""
    return draw_reference_views(original, views, (0, 0, 0)).quality(decoded).psnr


def orbit(views: int, seed: int = 0, distance: float = 5.0, side: int = 40) -> list[Camera]:
    """Cameras all around, looking at the origin."""
    rng = np.random.default_rng(seed)
    return [facing(rng.normal(size=3), f"view {i}", distance, side) for i in range(views)]


def facing(direction, name="facing", distance=5.0, side=40) -> Camera:
    """A camera in a direction from the origin, looking at it."""
    forward = -np.asarray(direction, np.float64) / np.linalg.norm(direction)
    right = np.cross(np.roll(forward, 1) + np.array([0.1, 0.2, 0.3]), forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    size = (side, side, 1.2 * side, 1.2 * side, side / 2, side / 2)
    return Camera(name, *size, rotation, -distance * forward)


def visible_scene(count: int, seed: int, sh_degree: int = 3, bright: float = 0.0) -> Scene:
    """Large Gaussians of medium opacity; `bright` of 3 channels are well above black."""
    scene = random_scene(count, sh_degree, seed)
    rng = np.random.default_rng(seed)
    return replace(
        scene,
        f_dc=(0.4 * scene.f_dc + bright).astype(np.float32),
        opacity=rng.uniform(-2, 2, (1, count)).astype(np.float32),
        log_scale=rng.uniform(-3, -1.5, (3, count)).astype(np.float32),
    )


def images(scene: Scene, cameras: list[Camera]) -> np.ndarray:
    """Renders of a scene, one per camera."""
    return np.array([render(scene, camera, device="cpu").colour for camera in cameras])
