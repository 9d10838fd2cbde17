"""An alias of the top-level package `viewer`, inside gs_codec.

`gs_codec.viewer` is that package itself, loaded on first use. The viewer is built on gs_codec, so
this import runs against the import order of the layout; nothing else in gs_codec uses the viewer.
"""

from __future__ import annotations

import sys
from importlib import import_module

sys.modules[__name__] = import_module("viewer")
