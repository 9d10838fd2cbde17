"""The viewpoints of the viewer: an overview of the scene, and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewer.opened import Opened
from viewer.pose import UPS, Pose, of_camera, overview, up_of, upright


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A named pose.

    Attributes
    ----------
    name : str
        Name of the camera, or ``overview``.
    pose : Pose
    camera : Camera or None
        gs_codec's camera, whose photograph it may have.
    """

    name: str
    pose: Pose
    camera: Any = None


#: Name of the up axis that is taken from the cameras.
BY_CAMERAS = "cameras"


def find_viewpoints(
    scene: Opened, cameras: Sequence[Any], chosen: bool, up: str
) -> list[Viewpoint]:
    """The overview first, then the cameras.

    Parameters
    ----------
    scene : Opened
    cameras : sequence of gs_codec's Camera
    chosen : bool
        Whether cameras were chosen from the scene; these are rolled until they are upright.
    up : str
        One of `known_ups`.
    """
    axis = up_axis(up, cameras)
    viewpoints = [Viewpoint("overview", overview(scene.positions, scene.opacities, axis))]
    for camera in cameras:
        pose = of_camera(camera)
        viewpoints.append(Viewpoint(camera.name, upright(pose, axis) if chosen else pose, camera))
    return viewpoints


def known_ups(cameras: Sequence[Any]) -> list[str]:
    """Names of the possible up axes; the first is the default."""
    return [BY_CAMERAS, *UPS] if cameras else [*UPS]


def up_axis(up: str, cameras: Sequence[Any]) -> NDArray[np.float64]:
    """The unit vector of an up axis, by a name of `known_ups`."""
    return up_of([camera.rotation for camera in cameras]) if up == BY_CAMERAS else UPS[up]
