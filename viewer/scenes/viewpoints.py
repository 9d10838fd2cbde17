"""The viewpoints of the viewer: an overview of the scene, and cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.up import BY_CAMERAS, UPS, up_of
from gs_codec.cameras.widest import widest_view
from gs_codec.views.estimate import COUNT, estimate_views
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose, of_camera, overview, upright


@dataclass(frozen=True, eq=False)
class Views:
    """Cameras to look from, and their up direction.

    Attributes
    ----------
    cameras : sequence of gs_codec's Camera
    up : ndarray, shape (3,), or None
        Unit vector; None if there are no cameras.
    chosen : bool
        Whether cameras were chosen from the scene. The first is then an overview, and all are
        rolled upright.
    up_certain : bool
        Whether `up` is certain.
    """

    cameras: Sequence[gs_codec.Camera] = field(default_factory=list)
    up: NDArray[np.float64] | None = None
    chosen: bool = False
    up_certain: bool = True

    @property
    def first(self) -> int:
        """Index of the first camera in `find_viewpoints`."""
        return 0 if self.chosen else 1

    @property
    def ups(self) -> list[str]:
        """Names of the possible up axes; the first is the default."""
        return [*UPS] if self.up is None else [BY_CAMERAS, *UPS]

    def up_axis(self, up: str) -> NDArray[np.float64]:
        """The unit vector of an up axis, by its name."""
        return UPS[up] if up != BY_CAMERAS or self.up is None else self.up


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A named pose.

    Attributes
    ----------
    name : str
        Name of the camera, or ``overview``.
    pose : Pose
    camera : Camera or None
        The camera, which may have a photograph.
    """

    name: str
    pose: Pose
    camera: gs_codec.Camera | None = None


def given_views(cameras: Sequence[gs_codec.Camera]) -> Views:
    """Views of given cameras; at least one."""
    return Views(cameras, up_of([camera.rotation for camera in cameras]))


def choose_views(scene: Opened, up: str | None = None, count: int = COUNT) -> Views:
    """Cameras chosen from the scene, as by ``auto``; none if no view shows anything.

    Parameters
    ----------
    scene : Opened
    up : str, optional
        Up axis, one of `UPS`; by default estimated from the scene.
    count : int
    """
    try:
        found = estimate_views(scene.gaussians, count, None if up is None else UPS[up])
    except gs_codec.InvalidInput:
        return Views()
    return Views(found.cameras, found.up, True, found.up_certain or up is not None)


def find_viewpoints(scene: Opened, views: Views, up: str) -> list[Viewpoint]:
    """The overview first, then the cameras.

    With given cameras, the overview is the pose of the camera that shows most, made upright.

    Parameters
    ----------
    scene : Opened
    views : Views
    up : str
        One of `views.ups`.
    """
    axis = views.up_axis(up)
    if not views.chosen:
        if views.cameras:
            widest = widest_view(scene.gaussians, views.cameras)
            pose = upright(of_camera(views.cameras[widest]), axis)
        else:
            pose = overview(scene.positions, scene.opacities, axis)
        others = [Viewpoint(view.name, of_camera(view), view) for view in views.cameras]
        return [Viewpoint("overview", pose), *others]
    names = ["overview", *(view.name for view in views.cameras[1:])]
    return [
        Viewpoint(name, upright(of_camera(view), axis), view)
        for name, view in zip(names, views.cameras, strict=True)
    ]


def nearest_camera(
    cameras: Sequence[gs_codec.Camera], position: NDArray, forward: NDArray
) -> gs_codec.Camera:
    """The camera with the most similar view to one from a position in a direction.

    Parameters
    ----------
    cameras : sequence of gs_codec's Camera
        At least one.
    position, forward : ndarray, shape (3,)
        `forward` is a unit vector.
    """
    away = np.linalg.norm([camera.position - position for camera in cameras], axis=1)
    turned = [1 - camera.rotation[2] @ forward for camera in cameras]
    return cameras[int(np.argmin(away / (np.median(away) or 1.0) + turned))]
