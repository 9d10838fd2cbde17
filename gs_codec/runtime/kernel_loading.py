"""Steps before a kernel is compiled: archive, disk cache, lock against other processes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.sigutils import normalize_signature

from gs_codec.runtime import compiling, kernel_archive
from gs_codec.runtime.atomic import alone
from gs_codec.runtime.kernel_cache import kept

#: Maximum seconds to wait for a process that compiles kernels of the same source file; it may be
#: suspended.
_PATIENCE = 60.0

#: Source files whose kernels this process is compiling.
_compiling: set[str] = set()


def load_first(dispatcher: Any) -> None:
    """Let numba's dispatcher of a kernel first load compiled code."""
    function = dispatcher.py_func
    dispatcher._cache = _Ready(function)
    dispatcher.compile = _alone(dispatcher.compile, function.__code__.co_filename)


class _Ready:
    """Sources of compiled code for a dispatcher: the package's archive, then the disk cache."""

    def __init__(self, function: Callable) -> None:
        self._function, self._kept = function, kept(FunctionCache, function, _Loading)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Load a kernel for the types of a signature; None if it must be compiled."""
        types, _ = normalize_signature(signature)
        found = kernel_archive.load(self._function, types, _Loading(target))
        if found is None:
            found = self._kept.load_overload(signature, target)
        if found is None:
            compiling.begin()
        return found

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kept, name)


def _alone(compile_one: Callable, source: str) -> Callable:
    """Compile while no other process compiles a kernel of this source file."""

    def compile_alone(signature: Any) -> Any:
        with global_compiler_lock, _locked(source), compiling.watched():
            return compile_one(signature)

    return compile_alone


@contextmanager
def _locked(source: str) -> Iterator[None]:
    """Hold the lock of a source file, unless this process already does, or there are no locks."""
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
    """numba's target for loading a kernel from the cache, in half the start-up time.

    Before reading the cache, numba prepares everything for the compiler, including scipy's linear
    algebra, which takes 0.4 seconds. Loaded machine code needs only numba's runtime. If the kernel
    must be compiled after all, the compiler calls the target's own `refresh`.
    """

    def __init__(self, target: Any) -> None:
        self._target = target

    def refresh(self) -> None:
        """Do the part of the target's own `refresh` that machine code needs."""
        kernel_archive.begin_runtime(self._target)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._target, name)
