"""The package `viewer`, which stands beside gs_codec, by a name inside gs_codec.

`gs_codec.viewer` is that package itself, loaded when it is asked for. Nothing else in gs_codec
knows the viewer, which is built on it; so it is imported by its name here, out of the order of
imports that the layout prescribes.
"""

from __future__ import annotations

import sys
from importlib import import_module

sys.modules[__name__] = import_module("viewer")
