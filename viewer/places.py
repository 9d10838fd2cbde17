"""Where one may look from: a look at all of a scene, and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewer.opened import Opened
from viewer.pose import UPS, Pose, of_camera, overview, up_of, upright


@dataclass(frozen=True, eq=False)
class Place:
    """A pose that one can go to.

    Attributes
    ----------
    name : str
        The camera's, or ``overview``.
    pose : Pose
    """

    name: str
    pose: Pose


#: What is up, by name, where cameras of a file say it.
BY_CAMERAS = "cameras"


def find_places(scene: Opened, cameras: Sequence[Any], chosen: bool, up: str) -> list[Place]:
    """The overview first, then the cameras.

    Parameters
    ----------
    scene : Opened
    cameras : sequence of gs_codec's Camera
    chosen : bool
        Whether nobody gave them, so that they may be rolled until they are upright.
    up : str
        Of `known_ups`.
    """
    axis = up_axis(up, cameras)
    places = [Place("overview", overview(scene.positions, scene.opacities, axis))]
    for camera in cameras:
        pose = of_camera(camera)
        places.append(Place(camera.name, upright(pose, axis) if chosen else pose))
    return places


def known_ups(cameras: Sequence[Any], chosen: bool) -> list[str]:
    """What may be up, by name, the first by default."""
    return [*UPS] if chosen or not cameras else [BY_CAMERAS, *UPS]


def up_axis(up: str, cameras: Sequence[Any]) -> NDArray[np.float64]:
    """The unit vector of what is up by one of the names of `known_ups`."""
    return up_of([camera.rotation for camera in cameras]) if up == BY_CAMERAS else UPS[up]
