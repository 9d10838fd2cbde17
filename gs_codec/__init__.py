"""Entropy coding of 3D Gaussian Splatting scenes (EntropyGS, arXiv 2508.10227).

Scenes are Open3D point clouds, one attribute tensor for each property of the Gaussians:

    cloud = gs_codec.read("scene.ply")
    data = gs_codec.encode(cloud, gs_codec.Config("m"))
    decoded = gs_codec.decode(data)

Names are loaded when first used, so that ``import gs_codec`` stays cheap. Errors are all
`GsCodecError`; nothing is printed, and no function changes what it is given.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Config": "gs_codec.config",
    "GsCodecError": "gs_codec.errors",
    "read": "gs_codec.api",
    "write": "gs_codec.api",
    "encode": "gs_codec.api",
    "decode": "gs_codec.api",
    "inspect": "gs_codec.api",
    "compare": "gs_codec.viewing",
    "render": "gs_codec.viewing",
    "prepare": "gs_codec.viewing",
    "encode_file": "gs_codec.files",
    "decode_file": "gs_codec.files",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gs_codec' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
