"""Views to measure in that are not those a scene is encoded by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gs_codec.preparation.pipeline import Plan
from gs_codec.preparation.steps import Steps
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import find_cameras
from gs_codec.scene import Scene

#: Of ``auto`` views, so many are measured in, and so many others are encoded by.
_MEASURED, _ENCODED_BY = 24, 64


def held_out_views(
    source: str | Sequence[Camera], scene: Scene, width: int | None
) -> tuple[list[Camera], Plan]:
    """Cameras to measure in, and a plan without steps that goes by the others.

    Of a file, or of cameras given, those marked ``test`` are measured in, as anywhere; ``auto``
    chooses enough for both, as the few it chooses alone are among the many.
    """
    both = _MEASURED + _ENCODED_BY
    cameras = find_cameras(source, scene, "all", width, both)
    if source == "auto":
        marked = [i * _MEASURED // both for i in range(len(cameras) + 1)]
        cameras = [
            replace(camera, split="test" if marked[i] < marked[i + 1] else "train")
            for i, camera in enumerate(cameras)
        ]
    return find_cameras(cameras, scene, "held-out"), Plan(Steps(), cameras, views=_ENCODED_BY)
