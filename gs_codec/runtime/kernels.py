"""Compile functions with numba: cached on disk if possible, without the GIL."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import update_wrapper
from threading import Lock
from typing import Any

from gs_codec.runtime.atomic import alone

#: How long to wait for a process that compiles kernels of the same source file; it may be stopped.
_PATIENCE = 60.0

#: Source files whose kernels this process is compiling.
_compiling: set[str] = set()

#: Held while a dispatcher is made.
_making = Lock()


class Kernel:
    """A function whose dispatcher numba makes when it is first called, or called by a kernel.

    Commands import a hundred and fifty of them and call a few; numba loads with the first.

    Parameters
    ----------
    function : callable
    make : callable
        Makes numba's dispatcher of it; all other attributes are the dispatcher's.
    """

    def __init__(self, function: Callable, make: Callable[[Callable], Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._make = make
        self._made: Any = None

    @property
    def dispatcher(self) -> Any:
        """What numba made of the function."""
        if self._made is None:
            with _making:
                if self._made is None:
                    self._made = self._make(self.py_func)
        return self._made

    def __call__(self, *arguments: Any) -> Any:
        """Run the machine code for the types of the arguments; load or compile it before."""
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.dispatcher, name)


def kernel(function: Callable) -> Any:
    """Compile a kernel. No fastmath: results must not depend on the machine.

    To compile takes seconds, so arrays are copied into slices in loops, where an assignment would
    compile the text of an error as well; and what begins at a constant and goes to other kernels
    begins at ``np.int64(0)``, as these would be compiled for the constant, too.
    """
    return Kernel(function, _cached)


def inlined(function: Callable) -> Any:
    """Compile a small function that kernels call in their inner loops."""
    return Kernel(function, _inlined)


def _inlined(function: Callable) -> Any:
    import numba

    return numba.njit(inline="always", error_model="numpy")(function)


def _cached(function: Callable) -> Any:
    import numba
    from numba.core.caching import FunctionCache

    from gs_codec.runtime.kernel_cache import kept

    compiled: Any = numba.njit(nogil=True, error_model="numpy")(function)
    if compiled is function:  # numba is disabled (NUMBA_DISABLE_JIT)
        return compiled
    compiled._cache = kept(FunctionCache, function, _Loading)
    compiled.compile = _alone(compiled.compile, function.__code__.co_filename)
    return compiled


def _alone(compile_one: Callable, source: str) -> Callable:
    """Compile while no other process compiles a kernel of this source file: it may be the same."""
    from numba.core.compiler_lock import global_compiler_lock

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
        from numba.core.runtime import rtsys

        rtsys.initialize(self._target)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)
