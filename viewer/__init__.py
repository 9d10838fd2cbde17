"""Viewer of 3D Gaussian Splatting scenes: compare two versions, and show what was pruned.

`draw` opens a window; `attach` adds actions to a window of Open3D; `embed` shows scenes in a
notebook, and after ``%load_ext viewer`` clouds show themselves there. Names are loaded when first
used, because loading Open3D takes a second. `gs_codec.viewer` is another name of this package.
"""

from __future__ import annotations

from importlib import import_module

_HOMES = {
    "draw": "viewer.plugin",
    "attach": "viewer.plugin",
    "embed": "viewer.notebook",
    "load_ipython_extension": "viewer.notebook",
}

__all__ = [name for name in _HOMES if name != "load_ipython_extension"]  # IPython calls it


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'viewer' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
