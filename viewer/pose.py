"""Where one looks from, whatever the size of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Focal length of a camera that nobody gave, picture heights: 60 degrees.
_FOCAL = 0.866


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera without its picture.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        World to camera, whose axes are right, down, forward.
    position : ndarray, shape (3,)
    focal : tuple of two float
        Focal lengths, in picture heights.
    aspect : float
        Width by height of what is to be seen; a narrower picture shows more above and below.
    """

    rotation: NDArray[np.float64]
    position: NDArray[np.float64]
    focal: tuple[float, float] = (_FOCAL, _FOCAL)
    aspect: float = 0.0

    def focal_lengths(self, width: int, height: int) -> tuple[float, float]:
        """In pixels, for a picture of this size."""
        size = min(height, width / self.aspect) if self.aspect else height
        return self.focal[0] * size, self.focal[1] * size

    def camera(self, width: int, height: int) -> dict[str, Any]:
        """An entry of ``cameras.json`` for a picture of this size."""
        fx, fy = self.focal_lengths(width, height)
        return {
            "img_name": "view",
            "width": width,
            "height": height,
            "fx": fx,
            "fy": fy,
            "rotation": self.rotation.T.tolist(),
            "position": self.position.tolist(),
        }

    def intrinsics(self, width: int, height: int, left: float = 0.0) -> NDArray[np.float64]:
        """Matrix for a pane that begins `left` pixels into a picture of this size."""
        fx, fy = self.focal_lengths(width, height)
        return np.array([[fx, 0, width / 2 - left], [0, fy, height / 2], [0, 0, 1.0]])

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
        fx, fy = self.focal_lengths(width, height)
        x, y, depth = self.rotation @ (np.asarray(points, np.float64) - self.position).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u = fx * x / depth + width / 2
            v = fy * y / depth + height / 2
        return np.stack([u, v], axis=1), depth


def of_camera(camera: Any) -> Pose:
    """The pose of one of gs_codec's cameras."""
    focal = camera.fx / camera.height, camera.fy / camera.height
    return Pose(camera.rotation, camera.position, focal, camera.width / camera.height)


def overview(positions: NDArray, opacities: NDArray) -> Pose:
    """A look at most of a scene from above its front; down is y, as trainers have it."""
    seen = positions[opacities > 0.3] if np.any(opacities > 0.3) else positions
    if not len(seen):
        return Pose(np.eye(3), np.array([0.0, 0.0, -1.0]))
    centre = np.median(seen, axis=0).astype(np.float64)
    reach = float(np.quantile(np.linalg.norm(seen - centre, axis=1), 0.8)) or 1.0
    return look_at(centre + 2.0 * reach * np.array([0.35, -0.45, -0.82]), centre)


def look_at(position: NDArray, target: NDArray) -> Pose:
    """From a position to a target, upright; down is y."""
    forward = np.subtract(target, position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right = right / (np.linalg.norm(right) or 1.0)
    return Pose(np.stack([right, np.cross(forward, right), forward]), np.asarray(position))


def up_of(rotations: Sequence[NDArray]) -> NDArray[np.float64]:
    """What is up for cameras of these rotations: the mean of what is up in their pictures."""
    up = -np.mean([rotation[1] for rotation in rotations], axis=0)
    return up / (np.linalg.norm(up) or 1.0)
