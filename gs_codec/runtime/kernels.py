"""Compile functions with numba: cached on disk if possible, without the GIL."""

from collections.abc import Callable
from functools import update_wrapper
from threading import Lock
from typing import Any

#: Held while a dispatcher is made.
_making = Lock()


class Kernel:
    """A function whose numba dispatcher is made on the first call, or when a kernel calls it.

    Commands import 150 of them and call a few; numba is loaded with the first.

    Parameters
    ----------
    function : callable
    make : callable
        Makes numba's dispatcher; all other attributes are forwarded to it.
    """

    def __init__(self, function: Callable, make: Callable[[Callable], Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._make = make
        self._made: Any = None

    @property
    def dispatcher(self) -> Any:
        """The function's numba dispatcher."""
        if self._made is None:
            with _making:
                if self._made is None:
                    self._made = self._make(self.py_func)
        return self._made

    def __call__(self, *arguments: Any) -> Any:
        """Run the machine code for the types of the arguments, loading or compiling it first."""
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.dispatcher, name)


def kernel(function: Callable) -> Any:
    """Compile a kernel. No fastmath: results must not depend on the machine.

    Compiling takes seconds, so copy arrays into slices in loops: slice assignment also compiles an
    error message. Initialise values that are passed to other kernels with ``np.int64(0)``: a
    literal constant would compile those once more.
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

    from gs_codec.runtime.kernel_loading import load_first

    compiled = numba.njit(nogil=True, error_model="numpy")(function)
    if compiled is not function:  # or if numba is disabled (NUMBA_DISABLE_JIT)
        load_first(compiled)
    return compiled
