"""Viewer of 3D Gaussian Splatting scenes: compare two versions, and show what was pruned.

`draw` opens a window; `attach` adds actions to a window of Open3D. Names are loaded when first
used, because loading Open3D takes a second. `gs_codec.viewer` is another name of this package.
"""

from __future__ import annotations

from importlib import import_module

_HOMES = {"draw": "viewer.plugin", "attach": "viewer.plugin"}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'viewer' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
