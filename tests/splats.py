"""Hand-placed Gaussians and cameras for tests of rendering."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
from scenes import shared_scene_path

from gs_codec.cameras.camera import Camera
from gs_codec.rendering import renderer
from gs_codec.scene import SH_COEFFICIENTS, Scene

#: A background, RGB.
TEAL = (0.1, 0.7, 0.6)

#: Not on a GPU, which follows the same rule, but not within these tolerances.
render = partial(renderer.render, device="cpu")


def straight(width=70, height=45, position=(0, 0, 0), fx=60.0, fy=60.0, cx=None, cy=None) -> Camera:
    """A camera that looks along +z."""
    return Camera(
        "straight",
        width,
        height,
        fx,
        fy,
        width / 2 if cx is None else cx,
        height / 2 if cy is None else cy,
        np.eye(3),
        np.array(position, np.float64),
    )


def turned(seed: int, width=70, height=45, **intrinsics) -> Camera:
    """A camera at a random position with a random rotation."""
    rng = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation = axes * np.linalg.det(axes)
    return replace(
        straight(width, height, **intrinsics), rotation=rotation, position=rng.normal(size=3)
    )


def splats(positions, **planes) -> Scene:
    """Gaussians at `positions`, (N, 3); the other planes are broadcast to N columns."""
    positions = np.array(positions, np.float32).reshape(-1, 3).T
    count = positions.shape[1]
    shades = np.linspace(-1, 1, 3 * count).reshape(3, count)
    planes = {
        "f_dc": shades,
        "f_rest": np.zeros((0, 1)),
        "opacity": 1.0,
        "log_scale": -2.0,
        "rot": [[1], [0], [0], [0]],
    } | planes
    rows = {"f_dc": 3, "f_rest": len(planes["f_rest"]), "opacity": 1, "log_scale": 3, "rot": 4}
    full = {
        name: np.broadcast_to(np.asarray(planes[name], np.float32), (rows[name], count)).copy()
        for name in rows
    }
    return Scene(positions=np.ascontiguousarray(positions), **full)


def crowd(camera: Camera, count: int, sh_degree: int, seed: int, pixels: float = 4.0) -> Scene:
    """Gaussians of about `pixels` in and around the view of `camera`, some of them behind it."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(-0.3, 5, count)
    u = rng.uniform(-0.3, 1.3, count) * camera.width
    v = rng.uniform(-0.3, 1.3, count) * camera.height
    seen = depth * [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(count)]
    size = np.log(pixels * np.maximum(depth, 0.2) / camera.fx)
    return splats(
        (camera.rotation.T @ seen).T + camera.position,
        f_dc=rng.normal(size=(3, count)),
        f_rest=rng.normal(scale=0.4, size=(3 * SH_COEFFICIENTS[sh_degree], count)),
        opacity=rng.choice([-3.0, 0.0, 2.0, 8.0], count) + rng.normal(size=count),
        log_scale=size + rng.normal(scale=0.8, size=(3, count)),
        rot=rng.normal(size=(4, count)),
    )


def real_cameras() -> list[Camera]:
    """The test views of the bonsai scene."""
    views = json.loads(shared_scene_path("bonsai/cameras.json").read_text())
    return [
        Camera(
            view["img_name"],
            view["width"],
            view["height"],
            view["fx"],
            view["fy"],
            view["width"] / 2,
            view["height"] / 2,
            np.array(view["rotation"]).T,
            np.array(view["position"]),
        )
        for view in views
        if view["split"] == "test"
    ]


def noise(camera: Camera, seed: int) -> np.ndarray:
    """A random image of a camera's size."""
    rng = np.random.default_rng(seed)
    return rng.random((camera.height, camera.width, 3)).astype(np.float32)
