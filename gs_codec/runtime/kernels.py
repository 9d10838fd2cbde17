"""Compile functions with numba: cached on disk if possible, without the GIL."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime import rtsys

from gs_codec.runtime.atomic import alone
from gs_codec.runtime.kernel_cache import kept

#: How long to wait for a process that compiles kernels of the same source file; it may be stopped.
_PATIENCE = 60.0

#: Source files whose kernels this process is compiling.
_compiling: set[str] = set()


def kernel(function: Callable) -> Any:
    """Compile a kernel. No fastmath: results must not depend on the machine.

    To compile takes seconds, so arrays are copied into slices in loops, where an assignment would
    compile the text of an error as well; and what begins at a constant and goes to other kernels
    begins at ``np.int64(0)``, as these would be compiled for the constant, too.
    """
    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    if compiled is function:  # numba is disabled (NUMBA_DISABLE_JIT)
        return compiled
    compiled._cache = kept(FunctionCache, function, _Loading)
    compiled.compile = _alone(compiled.compile, function.__code__.co_filename)
    return compiled


def _alone(compile_one: Callable, source: str) -> Callable:
    """Compile while no other process compiles a kernel of this source file: it may be the same."""

    def compile_alone(signature: Any) -> Any:
        with global_compiler_lock, _locked(source):
            return compile_one(signature)

    return compile_alone


@contextmanager
def _locked(source: str) -> Iterator[None]:
    """Keep a source file locked, unless it is, or there are no locks."""
    if source in _compiling:
        yield
        return
    _compiling.add(source)
    try:
        with alone(source, _PATIENCE):
            yield
    finally:
        _compiling.remove(source)


def inlined(function: Callable) -> Any:
    """Compile a small function that kernels call in their inner loops."""
    return numba.njit(inline="always", error_model="numpy")(function)


class _Loading:
    """numba's target for loading a kernel from the cache, with half the start-up time.

    Before numba looks into the cache, it prepares everything that the compiler needs: 0.4 seconds,
    with the linear algebra of scipy. Loaded machine code needs only numba's runtime. If the kernel
    must be compiled after all, the compiler calls the target's own `refresh`.
    """

    def __init__(self, target: Any) -> None:
        self._target = target

    def refresh(self) -> None:
        """Do the part of the target's own `refresh` that machine code needs."""
        rtsys.initialize(self._target)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)
