"""Where cameras stand in each style of capture, and how the scene's axes and units lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gs_codec.rendering.camera import Camera
from samples.captures.indoors import flat, table_room, window_bench
from samples.captures.outdoors import garden, village
from samples.captures.place import Place
from samples.shapes import Point
from samples.textures import Array

#: Every so many-th camera is for tests, as in the trainers' evaluation.
_TEST_EVERY = 8


@dataclass(frozen=True)
class Rig:
    """A place and the cameras in it.

    Parameters
    ----------
    place : callable
    stand : callable
        Makes, from a generator, centres ``(V, 3)`` and the points ``(V, 3)`` looked at; metres.
    size : (int, int)
        Width and height of the images, pixels.
    field : float
        Field of view across the width, degrees.
    unit : float
        Length of a metre in the scene.
    up : Point or None
        Where about up points in the scene; None for anywhere.
    """

    place: Callable[[], Place]
    stand: Callable[[np.random.Generator], tuple[Array, Array]]
    size: tuple[int, int]
    field: float
    unit: float
    up: Point | None


@dataclass(frozen=True)
class Frame:
    """From metres, z up, to a scene: ``unit * turn @ p + shift``."""

    unit: float
    turn: Array
    shift: Array

    def points(self, points: Array) -> Array:
        """Points ``(N, 3)`` in the scene."""
        return self.unit * points @ self.turn.T + self.shift

    def camera(self, camera: Camera) -> Camera:
        """A camera in the scene."""
        position = self.points(camera.position[None])[0]
        return replace(camera, position=position, rotation=camera.rotation @ self.turn.T)


def cameras_of(rig: Rig, rng: np.random.Generator, width: int | None = None) -> list[Camera]:
    """The cameras in the place, in metres; images `width` pixels wide, by default the rig's."""
    centres, targets = rig.stand(rng)
    w, h = rig.size
    focal = 0.5 * w / np.tan(np.radians(rig.field) / 2)
    cameras = []
    for i, rotation in enumerate(_rotations(centres, targets, rng)):
        split: Literal["train", "test"] = "test" if i % _TEST_EVERY == 4 else "train"
        view = (w, h, focal, focal, w / 2, h / 2, rotation, centres[i], split)
        camera = Camera(f"{i:05d}.png", *view)
        cameras.append(camera if width is None else camera.resized(width, round(h * width / w)))
    return cameras


def _rotations(centres: Array, targets: Array, rng: np.random.Generator) -> Array:
    """World to camera ``(V, 3, 3)``, upright but for a slight roll."""
    forward = targets - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    steep = np.abs(forward[:, 2:]) > 0.97
    up = np.where(steep, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    right = np.cross(forward, up + 0.03 * rng.standard_normal(up.shape))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def frame_of(rig: Rig, rng: np.random.Generator) -> Frame:
    """The scene's axes: up as the rig says to a few degrees, the heading and the origin any."""
    up = rng.standard_normal(3)
    if rig.up is not None:
        up = np.array(rig.up) + 0.08 * up
    up /= np.linalg.norm(up)
    east = np.cross(rng.standard_normal(3), up)
    east /= np.linalg.norm(east)
    turn = np.stack([east, np.cross(up, east), up], axis=1)
    return Frame(rig.unit, turn, 3 * rig.unit * rng.standard_normal(3))


def _orbit(rng: np.random.Generator) -> tuple[Array, Array]:
    """Three rings around the table, the highest the smallest."""
    centres = []
    for count, height, radius in ((26, 0.45, 2.6), (24, 1.05, 2.5), (14, 1.6, 1.9)):
        z = rng.standard_normal((3, count))
        angle = 2 * np.pi * (np.arange(count) + 0.15 * z[0]) / count
        r = radius * (1 + 0.05 * z[1])
        ring = [r * np.cos(angle), r * np.sin(angle), height + 0.06 * z[2]]
        centres.append(np.stack(ring, axis=1))
    at = np.concatenate(centres)
    return at, [0, 0, 0.12] + 0.1 * rng.standard_normal(at.shape)


def _arc(rng: np.random.Generator) -> tuple[Array, Array]:
    """A hand-held camera that goes to and, lower, fro before the sculpture."""
    there, back = np.linspace(-58, 52, 30), np.linspace(55, -50, 26)
    z = rng.standard_normal((3, 56))
    angle = np.radians(np.concatenate([there, back])) + 0.02 * z[0]
    r = 2.5 + 0.35 * np.sin(np.linspace(0, 7, 56)) + 0.08 * z[1]
    height = np.repeat([1.55, 1.0], [30, 26]) + 0.07 * z[2]
    centres = np.stack([r * np.sin(angle), -r * np.cos(angle), height], axis=1)
    return centres, [0, 0, 1.0] + 0.13 * rng.standard_normal((56, 3))


def _room(rng: np.random.Generator) -> tuple[Array, Array]:
    """A walk through both rooms; every few steps it stops to look around."""
    x = [0.7, 1.5, 3.6, 4.2, 5.0, 5.9, 7.2, 8.6, 8.9, 7.3]
    y = [1.0, 2.8, 2.9, 1.9, 2.0, 1.3, 2.1, 1.1, 2.1, 2.3]
    stops = np.repeat(np.linspace(0, len(x) - 1, 30), 4)
    count = len(stops)
    walk = [np.interp(stops, np.arange(len(x)), path) for path in (x, y)]
    centres = np.stack([*walk, np.full(count, 1.5)], axis=1)
    centres += 0.08 * rng.standard_normal(centres.shape)
    yaw = 2.4 * np.arange(count) + 0.25 * rng.standard_normal(count)
    pitch = np.radians(-9 + 9 * rng.standard_normal(count))
    ahead = np.array([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
    return centres, centres + ahead.T


def _forward(rng: np.random.Generator) -> tuple[Array, Array]:
    """A small plane of cameras that all look one way."""
    x, z = np.meshgrid(np.linspace(-0.55, 0.55, 7), np.linspace(-0.28, 0.28, 5))
    centres = np.stack([x.ravel(), np.full(x.size, -2.2), 0.75 + z.ravel()], axis=1)
    centres += 0.03 * rng.standard_normal(centres.shape)
    ahead = centres * [0.7, 0, 0.7] + [0, 4, 0]
    return centres, ahead + 0.08 * rng.standard_normal(ahead.shape)


def _aerial(rng: np.random.Generator) -> tuple[Array, Array]:
    """Lines of a drone that looks down, and a second flight that looks aslant."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-75, 75, 7)] * 2))
    down = np.stack([x, y, np.full(x.size, 72.0)], axis=1)
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-80, 80, 5)] * 2))
    aslant = np.stack([x, y, np.full(x.size, 64.0)], axis=1)
    heading = np.pi / 2 * (np.arange(x.size) % 4) + 0.1 * rng.standard_normal(x.size)
    out = 55 * np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=1)
    centres = np.concatenate([down, aslant])
    targets = centres * [1, 1, 0] + np.concatenate([0 * down, out])
    spread = rng.standard_normal((2, *centres.shape))
    return centres + 1.2 * spread[0], targets + 1.5 * spread[1]


#: Styles of capture by their names.
RIGS = {
    "orbit": Rig(table_room, _orbit, (240, 160), 62.0, 30.0, (0.0, -1.0, 0.0)),
    "arc": Rig(garden, _arc, (180, 240), 55.0, 1.4, None),
    "room": Rig(flat, _room, (240, 160), 78.0, 5.0, (0.0, 1.0, 0.0)),
    "forward": Rig(window_bench, _forward, (232, 174), 58.0, 0.7, (0.0, -1.0, 0.0)),
    "aerial": Rig(village, _aerial, (240, 180), 60.0, 0.1, (0.0, 0.0, 1.0)),
}
