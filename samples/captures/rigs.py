"""Camera positions in each style of capture, and the axes and units of the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gs_codec.cameras.camera import Camera
from samples.captures.indoors import corridor, flat, table_room, window_bench
from samples.captures.objects import papered_wall, turntable
from samples.captures.outdoors import garden, pasture, village
from samples.captures.place import Place
from samples.shapes import Point
from samples.textures import Array

#: Every n-th camera is a test camera, as in the trainers' evaluation.
_TEST_EVERY = 8


@dataclass(frozen=True)
class Rig:
    """A place and the cameras in it.

    Parameters
    ----------
    place : callable
    stand : callable
        Makes, from a generator, centres ``(V, 3)`` and the target points ``(V, 3)``; metres.
    size : (int, int)
        Width and height of the images, pixels.
    field : float
        Horizontal field of view, degrees.
    unit : float
        Length of a metre in the scene.
    up : Point or None
        Approximate up direction in the scene; None for a random one.
    roll : float
        Approximate roll of the cameras, radians.
    floaters : float
        Share of the Gaussians that are floaters in front of the cameras.
    far : float
        Distance from the origin of one stray Gaussian; 0 for none.
    exposure : float
        Logarithm of the brightness ratio of the last photograph to the first.
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
    exposure: float = 0.0


@dataclass(frozen=True)
class Frame:
    """Transform from metres, z up, to a scene: ``unit * turn @ p + shift``."""

    unit: float
    turn: Array
    shift: Array

    def points(self, points: Array) -> Array:
        """Convert points ``(N, 3)`` to the scene."""
        return self.unit * points @ self.turn.T + self.shift

    def camera(self, camera: Camera) -> Camera:
        """Convert a camera to the scene."""
        position = self.points(camera.position[None])[0]
        return replace(camera, position=position, rotation=camera.rotation @ self.turn.T)


def cameras_of(rig: Rig, rng: np.random.Generator, width: int | None = None) -> list[Camera]:
    """The cameras in the place, in metres; images are `width` pixels wide, by default the rig's."""
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
    """World-to-camera rotations ``(V, 3, 3)``, upright except for the roll."""
    forward = targets - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    steep = np.abs(forward[:, 2:]) > 0.97
    up = np.where(steep, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
    right = np.cross(forward, up + roll * rng.standard_normal(up.shape))
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def frame_of(rig: Rig, rng: np.random.Generator) -> Frame:
    """Axes of the scene: up within a few degrees of the rig's, random heading and origin."""
    up = rng.standard_normal(3)
    if rig.up is not None:
        up = np.array(rig.up) + 0.08 * up
    up /= np.linalg.norm(up)
    east = np.cross(rng.standard_normal(3), up)
    east /= np.linalg.norm(east)
    turn = np.stack([east, np.cross(up, east), up], axis=1)
    return Frame(rig.unit, turn, 3 * rig.unit * rng.standard_normal(3))


def _orbit(rng: np.random.Generator) -> tuple[Array, Array]:
    """Three rings around the table; the highest is the smallest."""
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
    """A hand-held camera that moves in front of the sculpture in one direction, then lower back."""
    there, back = np.linspace(-58, 52, 30), np.linspace(55, -50, 26)
    z = rng.standard_normal((3, 56))
    angle = np.radians(np.concatenate([there, back])) + 0.02 * z[0]
    r = 2.5 + 0.35 * np.sin(np.linspace(0, 7, 56)) + 0.08 * z[1]
    height = np.repeat([1.55, 1.0], [30, 26]) + 0.07 * z[2]
    centres = np.stack([r * np.sin(angle), -r * np.cos(angle), height], axis=1)
    return centres, [0, 0, 1.0] + 0.13 * rng.standard_normal((56, 3))


def _room(rng: np.random.Generator) -> tuple[Array, Array]:
    """A walk through both rooms that stops every few steps to look around."""
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
    """A small planar grid of cameras that look in the same direction."""
    x, z = np.meshgrid(np.linspace(-0.55, 0.55, 7), np.linspace(-0.28, 0.28, 5))
    centres = np.stack([x.ravel(), np.full(x.size, -2.2), 0.75 + z.ravel()], axis=1)
    centres += 0.03 * rng.standard_normal(centres.shape)
    ahead = centres * [0.7, 0, 0.7] + [0, 4, 0]
    return centres, ahead + 0.08 * rng.standard_normal(ahead.shape)


def _aerial(rng: np.random.Generator) -> tuple[Array, Array]:
    """Lines of a drone looking down, and a second flight looking obliquely."""
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
    """A phone moved along a head on a wall, and lower back; the last six views from above."""
    counts = (28, 16, 6)
    z = rng.standard_normal((3, sum(counts)))
    sweeps = zip([(-72, 60), (62, -55), (-12, 8)], counts, strict=True)
    angle = (
        np.radians(np.concatenate([np.linspace(*sweep, n) for sweep, n in sweeps])) + 0.04 * z[0]
    )
    r = np.repeat([1.05, 0.95, 0.5], counts) + 0.06 * z[1]
    height = np.repeat([0.1, -0.6, 1.05], counts) + 0.06 * z[2]
    centres = np.stack([r * np.sin(angle), -0.1 - r * np.cos(angle), height], axis=1)
    return centres, [0, -0.15, 0.0] + 0.09 * rng.standard_normal(centres.shape)


def _corridor(rng: np.random.Generator) -> tuple[Array, Array]:
    """A walk of 14 m, looking ahead; at the end, six views back."""
    ahead = np.repeat([4.0, -4.0], [58, 6])
    x = np.concatenate([np.linspace(1.0, 15.0, 58), np.linspace(15.0, 13.0, 6)])
    centres = np.stack([x, 0.25 * np.sin(0.9 * x), np.full(x.size, 1.5)], axis=1)
    centres += 0.04 * rng.standard_normal(centres.shape)
    aside = [0, 0.9, 0.4] * rng.standard_normal(centres.shape)
    return centres, centres + aside + np.stack([ahead, 0 * x, 0 * x - 0.25], axis=1)


def _strip(rng: np.random.Generator) -> tuple[Array, Array]:
    """A drone that climbs looking ahead, then flies there and back looking down: 18 photographs."""
    out = np.linspace(-50, 50, 6)
    x = np.concatenate([np.linspace(-150, -80, 6), out, -out])
    z = np.concatenate([np.linspace(34, 60, 6), np.repeat([72.0, 64.0], 6)])
    y = np.repeat([-30.0, -14.0, 16.0], 6)
    centres = np.stack([x, y, z], axis=1) + 3.0 * rng.standard_normal((18, 3))
    ahead = np.repeat([[70.0, 15, 0], [4, 0, 0], [-12, -5, 0]], 6, axis=0)
    return centres, centres * [1, 1, 0] + ahead + 5.0 * rng.standard_normal(centres.shape)


def _turntable(rng: np.random.Generator) -> tuple[Array, Array]:
    """Two rings with even angles, as on a turntable."""
    angle = np.tile(2 * np.pi * np.arange(24) / 24, 2) + np.repeat([0.0, np.pi / 24], 24)
    r, height = np.repeat([1.05, 0.9], 24), np.repeat([0.3, 0.7], 24)
    centres = np.stack([r * np.cos(angle), r * np.sin(angle), height], axis=1)
    return centres, np.array([0, 0, 0.2]) + 0.004 * rng.standard_normal(centres.shape)


def _sky(rng: np.random.Generator) -> tuple[Array, Array]:
    """Most of a level ring around the sculpture; the last six look down on it from above."""
    z = rng.standard_normal((3, 48))
    sides = [np.linspace(-120, 100, 42), np.linspace(150, 175, 6)]
    angle = np.radians(np.concatenate(sides)) + 0.03 * z[0]
    r = np.repeat([3.2, 1.6], [42, 6]) + 0.2 * z[1]
    height = np.repeat([1.4, 4.2], [42, 6]) + 0.15 * z[2]
    centres = np.stack([r * np.sin(angle), -r * np.cos(angle), height], axis=1)
    return centres, [0, 0, 1.25] + 0.2 * rng.standard_normal(centres.shape)


#: Styles of capture by name; the index of a style is part of its seeds.
RIGS = {
    "orbit": Rig(table_room, _orbit, (240, 160), 62.0, 30.0, (0.0, -1.0, 0.0)),
    "arc": Rig(garden, _arc, (180, 240), 55.0, 1.4, None),
    "room": Rig(flat, _room, (240, 160), 78.0, 5.0, (0.0, 1.0, 0.0)),
    "forward": Rig(window_bench, _forward, (232, 174), 58.0, 0.7, (0.0, -1.0, 0.0)),
    "aerial": Rig(village, _aerial, (240, 180), 60.0, 0.1, (0.0, 0.0, 1.0)),
    "wall": Rig(
        papered_wall, _wall, (150, 266), 43.0, 4.0, (0.0, -1.0, 0.0), roll=0.12, exposure=-0.5
    ),
    "corridor": Rig(corridor, _corridor, (240, 160), 75.0, 0.9, (0.1, -1.0, 0.3), exposure=-0.5),
    "strip": Rig(
        village, _strip, (240, 180), 63.0, 0.06, (-0.1, -0.25, -1.0), roll=1.0, exposure=0.4
    ),
    "turntable": Rig(turntable, _turntable, (200, 200), 40.0, 6.0, (0.0, 0.0, 1.0), roll=0.0),
    "sky": Rig(pasture, _sky, (240, 160), 65.0, 1.2, (0.0, -1.0, 0.0), exposure=-0.5),
}
RIGS["floaters"] = replace(RIGS["orbit"], floaters=0.1)
RIGS["far"] = replace(RIGS["arc"], far=1e6)
