"""What moves in sequences: surfaces, and how the Gaussians on them change with time."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gs_codec.formats.similarity import rotation_of
from gs_codec.scene import SH_C0, Scene
from samples.attributes import multiply
from samples.shapes import Point, blob
from samples.surfaces import StillLife, Surface, joined, still_life
from samples.textures import Array, checker, mottled, stripes

#: Share of the Gaussians that are on moving or appearing surfaces.
SHARE = 0.2

#: Opacity logit that appearing Gaussians start below their own: fully transparent.
_CLEAR = 14.0

#: Standard deviation of a trainer's noise in each group: two steps of Adam at the learning rates of
#: the INRIA trainer, for centres at the middle of its schedule in a scene of radius 3.
_NOISE = {
    "positions": 1e-4,
    "f_dc": 5e-3,
    "f_rest": 2.5e-4,
    "opacity": 0.1,
    "log_scale": 0.01,
    "rot": 2e-3,
}

Parts = NDArray[np.intp]


@dataclass(frozen=True)
class Motion:
    """A scene at rest, and the function that gives the scene at a time in seconds.

    `change` takes the scene at rest, the surface of each of its Gaussians (-1 for floaters), and
    the time.
    """

    rest: StillLife
    change: Callable[[Scene, Parts, float], Scene]


@dataclass(frozen=True)
class Pose:
    """A rotation by the unit quaternion `turn` (wxyz), followed by the translation `shift`."""

    turn: Array
    shift: Array

    def after(self, first: Pose) -> Pose:
        """The pose that is `first`, then this one."""
        shift = rotation_of(self.turn) @ first.shift + self.shift
        return Pose(multiply(self.turn, first.turn), shift)


def turned(angle: float, axis: Point, about: Point = (0, 0, 0), shift: Point = (0, 0, 0)) -> Pose:
    """Rotate by `angle` radians about the unit `axis` through `about`, then translate."""
    turn = np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis))])
    return Pose(turn, np.array(about) - rotation_of(turn) @ about + shift)


def posed(scene: Scene, part: Parts, poses: dict[int, Pose]) -> Scene:
    """Move the Gaussians of each surface that has a pose: centres and quaternions, not SH."""
    positions, rot = scene.positions.copy(), scene.rot.copy()
    for number, pose in poses.items():
        own = np.flatnonzero(part == number)
        positions[:, own] = rotation_of(pose.turn) @ positions[:, own] + pose.shift[:, None]
        rot[:, own] = multiply(pose.turn, rot[:, own])
    return replace(scene, positions=positions, rot=rot)


def with_noise(scene: Scene, strength: float, rng: np.random.Generator) -> Scene:
    """Add what a trainer's last steps leave in every attribute; SH-AC that are 0 stay 0."""
    changes = {}
    for group, deviation in _NOISE.items():
        plane = getattr(scene, group)
        noise = np.float32(strength * deviation) * rng.standard_normal(plane.shape, np.float32)
        changes[group] = plane + (noise * (plane != 0) if group == "f_rest" else noise)
    return replace(scene, **changes)


def _with_share(static: Sequence[Surface], moving: Sequence[Surface]) -> StillLife:
    """Join surfaces, with `SHARE` of the Gaussians on those that move, which come last."""
    weights = [joined(surfaces).cumulative[-1] for surfaces in (static, moving)]
    factor = SHARE / (1 - SHARE) * weights[0] / weights[1]
    return joined([*static, *(replace(each, density=factor * each.density) for each in moving)])


def _moving(names: Collection[str]) -> StillLife:
    """The still life, with `SHARE` of the Gaussians on these of its surfaces."""
    surfaces = still_life().surfaces
    return _with_share(
        [each for each in surfaces if each.name not in names],
        [each for each in surfaces if each.name in names],
    )


def _object() -> Motion:
    """The knot circles above the table, and turns twice as fast."""
    rest = _moving({"knot"})

    def change(scene: Scene, part: Parts, time: float) -> Scene:
        angle = 2 * math.pi * time / 6
        way = (0.5 * math.cos(angle), 0.5 * math.sin(angle) - 0.2, 0.45 + 0.1 * math.sin(3 * angle))
        pose = turned(2 * angle, (0.36, 0.48, 0.8), about=(0, 0.3, 0.4), shift=way)
        return posed(scene, part, {len(rest.surfaces) - 1: pose})

    return Motion(rest, change)


@dataclass(frozen=True)
class _Limb:
    """An ellipsoid that moves with its parent, and swings about x at its joint.

    `swing` has the mean and the amplitude of the angle, and its phase: radians.
    """

    parent: str
    joint: Point
    centre: Point
    radii: Point
    swing: Point

    def angle(self, stride: float) -> float:
        mean, amplitude, phase = self.swing
        return mean + amplitude * math.sin(stride + phase)


def _limbs() -> dict[str, _Limb]:
    """Limbs of a person of 1.7 m at the origin, who looks towards +y; parents before children."""
    limbs = {
        "torso": _Limb("", (0, 0, -0.1), (0, 0, 0.16), (0.19, 0.12, 0.33), (-0.06, 0, 0)),
        "head": _Limb("torso", (0, 0, 0.44), (0, 0, 0.57), (0.1, 0.12, 0.14), (0.06, 0, 0)),
    }
    for x, lead in ((-1, 0.0), (1, math.pi)):
        own = {
            "arm": ("torso", (0.25 * x, 0, 0.4), 0.24, (0.06, 0.06, 0.18), (0, -0.4, lead)),
            "forearm": ("arm", (0.25 * x, 0, 0.08), -0.07, (0.05, 0.05, 0.18), (0.5, -0.2, lead)),
            "thigh": ("torso", (0.1 * x, 0, -0.12), -0.33, (0.08, 0.09, 0.25), (0, 0.5, lead)),
            "shin": (
                "thigh",
                (0.1 * x, 0, -0.55),
                -0.77,
                (0.06, 0.07, 0.23),
                (-0.45, -0.45, lead + 1.6),
            ),
        }
        for name, (parent, joint, height, radii, swing) in own.items():
            parent = parent if parent in limbs else f"{parent} {x}"
            limbs[f"{name} {x}"] = _Limb(parent, joint, (*joint[:2], height), radii, swing)
    return limbs


def _walker() -> Motion:
    """A person walks around the table, two steps a second."""
    limbs = _limbs()
    cloth = stripes(lambda p: p[2], 0.09, (0.20, 0.30, 0.55), (0.75, 0.72, 0.62))
    textures = {"torso": cloth, "head": mottled((0.78, 0.58, 0.46), 9.0, 0.1)}
    trousers = checker(0.06, (0.24, 0.22, 0.22), (0.36, 0.33, 0.30))
    moving = [
        Surface(name, blob(limb.centre, limb.radii, 0.06, i), textures.get(name, trousers))
        for i, (name, limb) in enumerate(limbs.items())
    ]
    rest = _with_share(still_life().surfaces, moving)
    number = {surface.name: i for i, surface in enumerate(rest.surfaces)}

    def change(scene: Scene, part: Parts, time: float) -> Scene:
        stride, way = 2 * math.pi * time, 2 * math.pi * time / 11
        bob = 0.02 * math.cos(2 * stride)
        poses = {"": turned(way, (0, 0, 1)).after(turned(0, (1, 0, 0), shift=(2.1, 0, bob)))}
        for name, limb in limbs.items():
            swing = turned(limb.angle(stride), (1, 0, 0), about=limb.joint)
            poses[name] = poses[limb.parent].after(swing)
        return posed(scene, part, {number[name]: poses[name] for name in limbs})

    return Motion(rest, change)


def _light() -> Motion:
    """A warm lamp circles above the table: SH-DC and SH-AC near it grow."""

    def change(scene: Scene, part: Parts, time: float) -> Scene:
        angle = 2 * math.pi * time / 5
        lamp = np.array([0.9 * math.cos(angle), 0.6 * math.sin(angle), 0.5])
        apart = ((scene.positions - lamp[:, None]) ** 2).sum(axis=0)
        near = np.fmax(1 - apart / 1.1**2, 0) ** 2
        gain = 1 + np.multiply.outer([0.8, 0.65, 0.4], near)
        f_dc = (gain * (0.5 + SH_C0 * scene.f_dc) - 0.5) / SH_C0
        f_rest = np.repeat(gain, len(scene.f_rest) // 3, axis=0) * scene.f_rest
        return replace(scene, f_dc=f_dc.astype(np.float32), f_rest=f_rest.astype(np.float32))

    return Motion(still_life(), change)


def _appearing() -> Motion:
    """The sphere, the torus and the knot appear within 1.5 seconds, from the left to the right."""
    names = {"sphere", "torus", "knot"}
    rest = _moving(names)

    def change(scene: Scene, part: Parts, time: float) -> Scene:
        shown = np.clip(2.2 * time - 1.2 - scene.positions[0], 0, 1)
        clear = np.float32(_CLEAR) * (1 - shown) * (part >= len(rest.surfaces) - len(names))
        return replace(scene, opacity=scene.opacity - clear)

    return Motion(rest, change)


_MAKERS = {"object": _object, "walker": _walker, "light": _light, "appearing": _appearing}

#: Names of the motions.
MOTIONS = tuple(_MAKERS)


@lru_cache
def motion(name: str) -> Motion:
    """The motion of this name, one of `MOTIONS`."""
    return _MAKERS[name]()
