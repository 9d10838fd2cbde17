"""A small scene trained on photographs of a synthetic place, and its cameras."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import write_png
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.scene import GROUPS, Scene, join_scenes
from samples.attributes import FAINTEST
from samples.captures.initial import (
    Points,
    candidates_of_each,
    floaters,
    initial_scene,
    seen_candidates,
    surface_points,
)
from samples.captures.photograph import Photographer
from samples.captures.rigs import RIGS, cameras_of, frame_of
from samples.captures.training import train

#: Minimum number of initial Gaussians.
MIN_COUNT = 100

#: Maximum number of initial Gaussians.
MAX_COUNT = 100_000

#: Default number of training iterations.
ITERATIONS = 600


@dataclass(frozen=True)
class Capture:
    """A trained scene, its cameras, and their photographs ``(H, W, 3)``."""

    scene: Scene
    cameras: tuple[Camera, ...]
    images: tuple[NDArray[np.float32], ...]


def capture(
    style: str,
    count: int = 12_000,
    seed: int = 0,
    iterations: int = ITERATIONS,
    width: int | None = None,
) -> Capture:
    """Photograph a place and train a scene on it.

    Parameters
    ----------
    style : str
        One of `RIGS`.
    count : int
        Initial number of Gaussians, `MIN_COUNT` to `MAX_COUNT`. A few become so faint in training
        that they are removed.
    seed : int
        0 or more. The same arguments give the same result.
    iterations : int
    width : int, optional
        Width of the images, pixels; by default 180 to 240.

    Raises
    ------
    InvalidInput
        If there is no such style, or the count or the seed is out of range.
    """
    if style not in RIGS:
        raise InvalidInput(f"style '{style}': expected one of {', '.join(RIGS)}")
    if not MIN_COUNT <= count <= MAX_COUNT:
        raise InvalidInput(f"count: {count}, expected {MIN_COUNT}-{MAX_COUNT} in a capture")
    if seed < 0:
        raise InvalidInput(f"seed: {seed}, expected 0 or more")
    rig = RIGS[style]
    rng = np.random.default_rng([seed, list(RIGS).index(style)])
    cameras = cameras_of(rig, rng, width)
    photographer = Photographer(rig.place())
    shots = [photographer.photograph(camera, rng) for camera in cameras]
    gains = np.exp(np.linspace(0, rig.exposure, len(shots), dtype=np.float32))
    images = [np.fmin(gain * image, 1) for gain, (image, _) in zip(gains, shots, strict=True)]
    use = [i for i, camera in enumerate(cameras) if camera.split == "train"]
    each = candidates_of_each(count, len(use))
    found = [seen_candidates(cameras[i], images[i], shots[i][1], each, rng) for i in use]
    few = round(rig.floaters * count)
    points = _points([cameras[i] for i in use], [images[i] for i in use], found, count, few, rng)
    frame = frame_of(rig, rng)
    placed = [frame.camera(camera) for camera in cameras]
    scene = initial_scene(points, frame, rng)
    scene = train(scene, [placed[i] for i in use], [images[i] for i in use], iterations)
    scene = _with_lost(_without_faintest(scene), rig.far)
    return Capture(scene, tuple(placed), tuple(images))


def _points(
    cameras: list[Camera],
    images: list[NDArray[np.float32]],
    found: list[NDArray],
    count: int,
    few: int,
    rng: np.random.Generator,
) -> Points:
    """Points on surfaces, and `few` floaters, `count` in total."""
    centres = np.array([camera.position for camera in cameras])
    radius = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    candidates = np.concatenate(found)
    parts = (
        surface_points(candidates, count - few, radius * cameras[0].fx, rng),
        floaters(cameras, images, few, float(np.median(candidates[:, 9])), rng),
    )
    return Points(*(np.concatenate(field) for field in zip(*parts, strict=True)))


def _without_faintest(scene: Scene) -> Scene:
    kept = scene.opacity[0] > FAINTEST
    planes = {group: getattr(scene, group)[:, kept] for group in GROUPS}
    return Scene(**planes, has_normals=True)


def _with_lost(scene: Scene, distance: float) -> Scene:
    """A scene with its first Gaussian duplicated far away along x; unchanged if `distance` is 0."""
    if not distance:
        return scene
    lost = scene.take(np.zeros(1, np.int64))
    place = np.array([[distance], [0], [0]], np.float32)
    return join_scenes([scene, replace(lost, positions=place)])


def write_capture(folder: Path, made: Capture) -> None:
    """Write ``point_cloud.ply``, ``cameras.json`` in the INRIA trainer's layout, and ``images``."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    write_ply(folder / "point_cloud.ply", made.scene)
    for camera, image in zip(made.cameras, made.images, strict=True):
        write_png(folder / "images" / camera.name, image)
    entries = [_entry(number, camera) for number, camera in enumerate(made.cameras)]
    with atomic_writer(folder / "cameras.json") as file:
        file.write(json.dumps(entries, indent=1).encode() + b"\n")


def _entry(number: int, camera: Camera) -> dict[str, Any]:
    return {
        "id": number,
        "img_name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "position": camera.position.tolist(),
        "rotation": camera.rotation.T.tolist(),
        "fy": camera.fy,
        "fx": camera.fx,
        "split": camera.split,
    }
