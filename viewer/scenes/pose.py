"""Camera poses that do not depend on picture size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import NEAR, Camera, facing
from gs_codec.cameras.up import UPS
from gs_codec.coding.clean import SOLID, solid_gaussians
from viewer.scenes.opened import thinned

#: Focal length of the default camera, in frame heights: a vertical field of view of 60 degrees.
_FOCAL = 0.866

#: Frame of the default camera, pixels.
_FRAME = (600, 400)

#: Wider frames are measured at this width, pixels, because the trainer shrinks photographs to it.
_MEASURED_WIDTH = 1600

#: Half width of the region straight ahead, relative to depth.
_AHEAD = 0.25

#: Maximum number of centres used to find the depth ahead.
_SAMPLES = 20_000


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera for pictures of any size; a picture shows the frame and its surroundings.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        World to camera; the camera's axes are right, down, forward.
    position : ndarray, shape (3,)
    focal : tuple of two float
        Focal lengths, in frame heights.
    frame : tuple of two int
        Width and height of the camera's own picture, pixels.
    shift : tuple of two float
        Offset of the principal point from the middle of the frame, in frame heights.
    near : float
        Minimum depth of a Gaussian to be drawn, scene units.
    """

    rotation: NDArray[np.float64]
    position: NDArray[np.float64]
    focal: tuple[float, float] = (_FOCAL, _FOCAL)
    frame: tuple[int, int] = _FRAME
    shift: tuple[float, float] = (0.0, 0.0)
    near: float = NEAR

    @property
    def measured(self) -> tuple[int, int]:
        """Size for measuring quality, pixels: that of the frame, at most 1,600 wide."""
        width, height = self.frame
        scale = min(1.0, _MEASURED_WIDTH / width)
        return round(scale * width), max(round(scale * height), 1)

    def framed(self, width: int, height: int) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the frame in a picture of this size, pixels."""
        high = min(height, width * self.frame[1] / self.frame[0])
        wide = high * self.frame[0] / self.frame[1]
        left, top = (width - wide) / 2, (height - high) / 2
        return left, top, left + wide, top + high

    def lens(self, width: int, height: int) -> tuple[float, float, float, float]:
        """Focal lengths and principal point for a picture of this size, pixels."""
        _, top, _, bottom = self.framed(width, height)
        size = bottom - top
        centre = width / 2 + self.shift[0] * size, height / 2 + self.shift[1] * size
        return self.focal[0] * size, self.focal[1] * size, *centre

    def camera(self, width: int, height: int) -> dict[str, object]:
        """An entry of ``cameras.json`` for a picture of this size."""
        lens = dict(zip(("fx", "fy", "cx", "cy"), self.lens(width, height), strict=True))
        return {
            "img_name": "view",
            "width": width,
            "height": height,
            **lens,
            "rotation": self.rotation.T.tolist(),
            "position": self.position.tolist(),
            "near": self.near,
        }

    def intrinsics(self, width: int, height: int, left: float = 0.0) -> NDArray[np.float64]:
        """Matrix for a pane that begins `left` pixels into a picture of this size."""
        fx, fy, cx, cy = self.lens(width, height)
        return np.array([[fx, 0, cx - left], [0, fy, cy], [0, 0, 1.0]])

    @property
    def extrinsics(self) -> NDArray[np.float64]:
        """World to camera ``(4, 4)``."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = -self.rotation @ self.position
        return matrix

    def project(
        self, points: NDArray, width: int, height: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels ``(n, 2)`` and depths ``(n,)`` of points ``(n, 3)``."""
        fx, fy, cx, cy = self.lens(width, height)
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y, depth = self.rotation @ (np.asarray(points, np.float64) - self.position).T
            u = fx * x / depth + cx
            v = fy * y / depth + cy
        return np.stack([u, v], axis=1), depth


def of_camera(camera: Camera) -> Pose:
    """The pose of one of gs_codec's cameras."""
    size, high = (camera.width, camera.height), camera.height
    focal = camera.fx / high, camera.fy / high
    shift = (camera.cx - camera.width / 2) / high, (camera.cy - high / 2) / high
    return Pose(camera.rotation, camera.position, focal, size, shift, camera.near)


def overview(positions: NDArray, opacities: NDArray, up: NDArray = UPS["-y"]) -> Pose:
    """A pose that shows most of a scene from above its front; `up` is a unit vector ``(3,)``."""
    seen = positions[solid_gaussians(opacities, np.isfinite(positions).all(axis=1), SOLID)]
    if not len(seen):
        return Pose(np.eye(3), np.array([0.0, 0.0, -1.0]))
    centre = np.median(seen, axis=0).astype(np.float64)
    reach = float(np.quantile(np.linalg.norm(seen - centre, axis=1), 0.8)) or 1.0
    # The front is -z if -y is up (as for trainers' cameras), z if y is up, -y if z is up.
    front = np.cross(np.eye(3)[int(abs(up[0]) > 1 - 1e-6)], up)
    front /= np.linalg.norm(front)
    away = 0.35 * np.cross(up, front) + 0.45 * up + 0.82 * front
    return look_at(centre + 2.5 * reach * away, centre, up)


def look_at(position: NDArray, target: NDArray, up: NDArray = UPS["-y"]) -> Pose:
    """An upright pose at a position that looks at a target; `up` is a unit vector ``(3,)``."""
    return Pose(facing(np.subtract(target, position), up), np.asarray(position))


def upright(pose: Pose, up: NDArray) -> Pose:
    """The same pose, rolled until `up` points up in the picture."""
    return replace(pose, rotation=facing(pose.rotation[2], up))


def moved(pose: Pose, matrix: NDArray) -> Pose:
    """The pose from which a scene looks the same after a move by a matrix ``(4, 4)``."""
    scale = scale_of(matrix)
    return replace(
        pose,
        rotation=pose.rotation @ matrix[:3, :3].T / scale,
        position=placed(pose.position, matrix),
        near=scale * pose.near,
    )


def scale_of(matrix: NDArray) -> float:
    """The factor by which a matrix ``(4, 4)`` scales all axes."""
    return float(np.cbrt(np.linalg.det(matrix[:3, :3])))


def placed(points: NDArray, matrix: NDArray) -> NDArray[np.float64]:
    """Points ``(..., 3)`` after a move by a matrix ``(4, 4)``."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def distance_ahead(pose: Pose, positions: NDArray) -> float:
    """Median depth of centres straight ahead; if there are none, distance to the median."""
    some = positions[thinned(len(positions), _SAMPLES)].astype(np.float64)
    some = some[np.isfinite(some).all(axis=1)]
    x, y, depth = pose.rotation @ (some - pose.position).T
    seen = np.hypot(x, y) < _AHEAD * depth
    if seen.any():
        return float(np.median(depth[seen]))
    if not len(some):
        return 1.0
    return float(np.linalg.norm(np.median(some, axis=0) - pose.position)) or 1.0
