"""How tensors reach kernels, and kernels a device: the CPU's memory in numba's simulator."""

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
    """Run kernels and torch on a device, in one stream; gives where tensors are."""
    place = torch.device("cpu" if SIMULATED else device)
    with warnings.catch_warnings():
        # A file of few blocks keeps few processors busy, which numba warns of.
        warnings.filterwarnings("ignore", ".*Grid size")
        if SIMULATED:
            yield place
            return
        # numba's stream is the default one.
        stream = torch.cuda.default_stream(place)
        with torch.cuda.stream(stream), cuda.gpus[stream.device.index]:
            yield place


def argument(value: Any) -> Any:
    """What a kernel takes: of a tensor, the same memory."""
    if not isinstance(value, torch.Tensor):
        return value
    return value.numpy() if SIMULATED else cuda.as_cuda_array(value, sync=False)


def unsigned(tensor: torch.Tensor) -> Any:
    """What a kernel takes of a tensor of 32-bit integers that are not negative."""
    return argument(tensor.view(-1)).view(np.uint32).reshape(tensor.shape)


def staging(count: int, kind: torch.dtype) -> torch.Tensor:
    """Memory of the CPU that is copied to a device while both go on."""
    return torch.empty(count, dtype=kind, pin_memory=not SIMULATED)


def upload(array: NDArray, place: torch.device) -> torch.Tensor:
    """A copy there of an array."""
    return torch.from_numpy(np.ascontiguousarray(array)).to(place, non_blocking=True)


def for_each(kernel: Any, count: int, *arguments: Any) -> None:
    """Run a kernel that has a thread for each Gaussian."""
    # In the simulator one thread goes through all.
    grid = 1 if SIMULATED else -(-count // THREADS)
    kernel[grid, THREADS](*map(argument, arguments))
