"""The one way numba is used here: compiled once, cached on disk where it can be, GIL released."""

import pickle
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
from numba.core.runtime import rtsys

#: What a disk without room, a folder without permission or an entry cut short give.
_CACHE_ERRORS = (OSError, EOFError, pickle.UnpicklingError)


def kernel(function: Callable) -> Any:
    """Compile a kernel. No fastmath: results must not depend on the machine."""
    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    if compiled is function:  # where numba is told to leave everything to Python
        return compiled
    with suppress(RuntimeError):  # no folder to cache in: it is compiled in each process
        compiled.enable_caching()
        _go_by_cache(compiled._cache)
    return compiled


def _go_by_cache(cache: Any) -> None:
    """Start fast from the cache, and do without where it fails: kernels can be compiled again."""
    load, save = cache.load_overload, cache.save_overload

    def try_to_load(signature: Any, target: Any) -> Any:
        with suppress(*_CACHE_ERRORS):
            return load(signature, _Loading(target))
        return None

    def try_to_save(*arguments: Any) -> None:
        with suppress(*_CACHE_ERRORS):
            save(*arguments)

    cache.load_overload, cache.save_overload = try_to_load, try_to_save


def inlined(function: Callable) -> Any:
    """Compile a small function that kernels call in their inner loops."""
    return numba.njit(inline="always", error_model="numpy")(function)


class _Loading:
    """numba's target for a kernel that is loaded: half of what a start takes is left out.

    numba gets everything ready that a compiler needs, 0.4 seconds with the linear algebra of
    scipy, before it looks into the cache. Machine code needs numba's runtime alone; where the
    kernel has to be compiled after all, the compiler calls the target's own `refresh`.
    """

    def __init__(self, target: Any) -> None:
        self._target = target

    def refresh(self) -> None:
        """What the target's own does for machine code."""
        rtsys.initialize(self._target)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)
