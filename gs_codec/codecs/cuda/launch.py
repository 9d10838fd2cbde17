"""Pass tensors to kernels, and kernels to a device (in numba's simulator, the CPU's memory)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numba import cuda
from numpy.typing import NDArray

from gs_codec.codecs.cuda.floats import THREADS
from gs_codec.codecs.cuda.lanes import SIMULATED


@contextmanager
def working_on(device: str) -> Iterator[torch.device]:
    """Run kernels and torch on a device, in one stream; yield the device of tensors."""
    place = torch.device("cpu" if SIMULATED else device)
    with warnings.catch_warnings():
        # numba warns that a file of few blocks underuses the device.
        warnings.filterwarnings("ignore", ".*Grid size")
        if SIMULATED:
            yield place
            return
        # numba uses the default stream.
        stream = torch.cuda.default_stream(place)
        with torch.cuda.stream(stream), cuda.gpus[stream.device.index]:
            yield place


def argument(value: Any) -> Any:
    """Convert a value for a kernel; tensors share their memory."""
    if not isinstance(value, torch.Tensor):
        return value
    return value.numpy() if SIMULATED else cuda.as_cuda_array(value, sync=False)


def unsigned(tensor: torch.Tensor) -> Any:
    """Convert a tensor of non-negative 32-bit integers for a kernel."""
    return argument(tensor.view(-1)).view(np.uint32).reshape(tensor.shape)


def staging(count: int, kind: torch.dtype) -> torch.Tensor:
    """Pinned CPU memory, copied to a device asynchronously."""
    return torch.empty(count, dtype=kind, pin_memory=not SIMULATED)


def upload(array: NDArray, place: torch.device) -> torch.Tensor:
    """Copy an array to a device."""
    return torch.from_numpy(np.ascontiguousarray(array)).to(place, non_blocking=True)


def for_each(kernel: Any, count: int, *arguments: Any) -> None:
    """Run a kernel with one thread per Gaussian."""
    # In the simulator one thread processes all Gaussians.
    grid = 1 if SIMULATED else -(-count // THREADS)
    kernel[grid, THREADS](*map(argument, arguments))
