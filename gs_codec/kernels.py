"""The one way numba is used here: compiled once, cached on disk, GIL released."""

from collections.abc import Callable
from typing import Any

import numba


def kernel(function: Callable) -> Any:
    """Compile a kernel. No fastmath: results must not depend on the machine."""
    return numba.njit(nogil=True, cache=True, error_model="numpy")(function)


def inlined(function: Callable) -> Any:
    """Compile a small function that kernels call in their inner loops."""
    return numba.njit(inline="always", error_model="numpy")(function)
