"""Where cameras stand in each style of capture, and how the scene's axes and units lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gs_codec.rendering.camera import Camera
from samples.captures.indoors import corridor, flat, table_room, window_bench
from samples.captures.objects import papered_wall, turntable
from samples.captures.outdoors import garden, pasture, village
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
    roll : float
        How much cameras roll, about radians.
    floaters : float
        Share of the Gaussians that float before the cameras.
    far : float
        Distance from the origin of one Gaussian that training lost; 0 without it.
    """

    place: Callable[[], Place]
    stand: Callable[[np.random.Generator], tuple[Array, Array]]
    size: tuple[int, int]
    field: float
    unit: float
    up: Point | None
    roll: float = 0.03
    floaters: float = 0.025
    far: float = 0.0


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
    for i, rotation in enumerate(_rotations(centres, targets, rig.roll, rng)):
        split: Literal["train", "test"] = "test" if i % _TEST_EVERY == 4 else "train"
        view = (w, h, focal, focal, w / 2, h / 2, rotation, centres[i], split)
        camera = Camera(f"{i:05d}.png", *view)
        cameras.append(camera if width is None else camera.resized(width, round(h * width / w)))
    return cameras


def _rotations(centres: Array, targets: Array, roll: float, rng: np.random.Generator) -> Array:
    """World to camera ``(V, 3, 3)``, upright but for the roll."""
    forward = targets - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    steep = np.abs(forward[:, 2:]) > 0.97
    up = np.where(steep, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    right = np.cross(forward, up + roll * rng.standard_normal(up.shape))
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


def _wall(rng: np.random.Generator) -> tuple[Array, Array]:
    """A phone that goes to, higher fro, and lower to again, before a head on a wall."""
    counts = (22, 13, 15)
    sweeps = [(-72, 60), (48, -40), (-55, 62)]
    z = rng.standard_normal((3, sum(counts)))
    ends = zip(sweeps, counts, strict=True)
    angle = np.radians(np.concatenate([np.linspace(*sweep, n) for sweep, n in ends])) + 0.04 * z[0]
    r = 1.05 + 0.08 * z[1]
    height = np.repeat([0.12, 0.75, -0.6], counts) + 0.06 * z[2]
    centres = np.stack([r * np.sin(angle), -0.1 - r * np.cos(angle), height], axis=1)
    return centres, [0, -0.15, 0.0] + 0.09 * rng.standard_normal(centres.shape)


def _corridor(rng: np.random.Generator) -> tuple[Array, Array]:
    """A walk of 14 m that looks ahead."""
    count = 64
    x = np.linspace(1.0, 15.0, count)
    centres = np.stack([x, 0.25 * np.sin(0.9 * x), np.full(count, 1.5)], axis=1)
    centres += 0.04 * rng.standard_normal(centres.shape)
    return centres, centres + [4, 0, -0.25] + [0, 0.9, 0.4] * rng.standard_normal(centres.shape)


def _strip(rng: np.random.Generator) -> tuple[Array, Array]:
    """A drone that looks down on the way out and ahead on the way back: 18 photographs."""
    out = np.linspace(-64, 64, 9)
    centres = np.concatenate(
        [
            np.stack([x, np.full(9, y), np.full(9, z)], axis=1)
            for x, y, z in ((out, -14.0, 66.0), (-out, 16.0, 56.0))
        ]
    )
    centres += 3.0 * rng.standard_normal(centres.shape)
    ahead = np.repeat([[4.0, 0, 0], [-38.0, -12, 0]], 9, axis=0)
    return centres, centres * [1, 1, 0] + ahead + 5.0 * rng.standard_normal(centres.shape)


def _turntable(rng: np.random.Generator) -> tuple[Array, Array]:
    """Two rings of even angles, as a turntable makes them."""
    angle = np.tile(2 * np.pi * np.arange(24) / 24, 2) + np.repeat([0.0, np.pi / 24], 24)
    r, height = np.repeat([1.05, 0.9], 24), np.repeat([0.3, 0.7], 24)
    centres = np.stack([r * np.cos(angle), r * np.sin(angle), height], axis=1)
    return centres, np.array([0, 0, 0.2]) + 0.004 * rng.standard_normal(centres.shape)


def _sky(rng: np.random.Generator) -> tuple[Array, Array]:
    """Half a ring around the sculpture, level enough to see far mountains and the sky."""
    z = rng.standard_normal((3, 48))
    angle = np.radians(np.linspace(-120, 100, 48)) + 0.03 * z[0]
    r = 3.2 + 0.3 * z[1]
    centres = np.stack([r * np.sin(angle), -r * np.cos(angle), 1.4 + 0.15 * z[2]], axis=1)
    return centres, [0, 0, 1.25] + 0.2 * rng.standard_normal(centres.shape)


#: Styles of capture by their names; a style's place in this order is part of its seeds.
RIGS = {
    "orbit": Rig(table_room, _orbit, (240, 160), 62.0, 30.0, (0.0, -1.0, 0.0)),
    "arc": Rig(garden, _arc, (180, 240), 55.0, 1.4, None),
    "room": Rig(flat, _room, (240, 160), 78.0, 5.0, (0.0, 1.0, 0.0)),
    "forward": Rig(window_bench, _forward, (232, 174), 58.0, 0.7, (0.0, -1.0, 0.0)),
    "aerial": Rig(village, _aerial, (240, 180), 60.0, 0.1, (0.0, 0.0, 1.0)),
    "wall": Rig(papered_wall, _wall, (150, 266), 43.0, 4.0, (0.0, -1.0, 0.0), roll=0.12),
    "corridor": Rig(corridor, _corridor, (240, 160), 75.0, 0.9, (0.1, -1.0, 0.3)),
    "strip": Rig(village, _strip, (240, 180), 63.0, 0.06, (-0.1, -0.25, -1.0), roll=1.0),
    "turntable": Rig(turntable, _turntable, (200, 200), 40.0, 6.0, (0.0, 0.0, 1.0), roll=0.0),
    "sky": Rig(pasture, _sky, (240, 160), 65.0, 1.2, (0.0, -1.0, 0.0)),
}
RIGS["floaters"] = replace(RIGS["orbit"], floaters=0.1)
RIGS["far"] = replace(RIGS["arc"], far=1e6)
