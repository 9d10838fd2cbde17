"""The one way numba is used here: compiled once, cached on disk where it can be, GIL released."""

import pickle
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba

#: What a disk without room, a folder without permission or an entry cut short give.
_CACHE_ERRORS = (OSError, EOFError, pickle.UnpicklingError)


def kernel(function: Callable) -> Any:
    """Compile a kernel. No fastmath: results must not depend on the machine."""
    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    if compiled is function:  # where numba is told to leave everything to Python
        return compiled
    with suppress(RuntimeError):  # no folder to cache in: it is compiled in each process
        compiled.enable_caching()
        _ignore_cache_errors(compiled._cache)
    return compiled


def _ignore_cache_errors(cache: Any) -> None:
    """Do without the cache where it fails: what it keeps can be compiled again."""
    load, save = cache.load_overload, cache.save_overload

    def try_to_load(*arguments: Any) -> Any:
        with suppress(*_CACHE_ERRORS):
            return load(*arguments)
        return None

    def try_to_save(*arguments: Any) -> None:
        with suppress(*_CACHE_ERRORS):
            save(*arguments)

    cache.load_overload, cache.save_overload = try_to_load, try_to_save


def inlined(function: Callable) -> Any:
    """Compile a small function that kernels call in their inner loops."""
    return numba.njit(inline="always", error_model="numpy")(function)
