"""Edit scenes: select, move, merge, clean, decimate, describe.

Functions take Open3D point clouds from `gs_codec.read`, and return new ones:

    cloud = gs_codec.edit.rotate(gs_codec.read("scene.ply"), (90, 0, 0))
    cloud = gs_codec.edit.select(cloud, "opacity>0.05")

An `Action` is an edit by ``gs-codec convert`` or `gs_codec.convert_file`.
"""

from __future__ import annotations

from gs_codec.runtime.lazy import lazy_names

#: Modules and their public names.
_PUBLIC = {
    "gs_codec.edit.selection": (
        "crop_box",
        "crop_sphere",
        "select",
        "remove_nonfinite",
        "limit_sh_degree",
        "sort_morton",
    ),
    "gs_codec.edit.motion": ("translate", "rotate", "scale", "transform"),
    "gs_codec.edit.floaters": ("remove_floaters",),
    "gs_codec.edit.clusters": ("keep_largest_cluster",),
    "gs_codec.edit.decimation": ("decimate",),
    "gs_codec.edit.join": ("merge",),
    "gs_codec.edit.description": ("statistics", "Statistics", "AttributeStatistics"),
    "gs_codec.edit.shares": ("Share",),
    "gs_codec.edit.actions": ("Action",),
}

__all__, __getattr__ = lazy_names(__name__, _PUBLIC)


def __dir__() -> list[str]:
    return sorted(__all__)
