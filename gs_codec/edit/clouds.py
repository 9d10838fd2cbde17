"""Let functions on scenes take Open3D point clouds too."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

from gs_codec.runtime.arguments import checked
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

Arguments = ParamSpec("Arguments")
Either = TypeVar("Either", Scene, "PointCloud")


def on_clouds(
    edit: Callable[Concatenate[Scene, Arguments], Scene],
) -> Callable[Concatenate[Either, Arguments], Either]:
    """Let a function from scene to scene also map a cloud to a cloud; attributes are kept."""
    change: Callable[..., Any] = checked(edit)

    @wraps(edit)
    def edited(scene: Either, *arguments: Arguments.args, **options: Arguments.kwargs) -> Either:
        if isinstance(scene, Scene):
            return change(scene, *arguments, **options)
        from gs_codec.formats.cloud import from_cloud, to_cloud

        # Open3D's methods change clouds in place, so the result shares no memory with its source.
        return to_cloud(change(from_cloud(scene, "keep"), *arguments, **options)).clone()

    return edited
