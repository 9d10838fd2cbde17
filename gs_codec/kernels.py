"""The one way numba is used here: compiled once, cached on disk, GIL released."""

from functools import partial

import numba

#: Decorator of every kernel. No fastmath: results must not depend on the machine.
kernel = partial(numba.njit, nogil=True, cache=True, error_model="numpy")

#: Decorator of small functions that kernels call in their inner loops.
inlined = partial(numba.njit, inline="always", error_model="numpy")
