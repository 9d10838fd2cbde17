"""Lists of marks (0 or 1, mostly 0), coded by the binary coder. FORMAT.md, "Lattices", `marks`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import code_bit, decode_binary, encode_binary, new_contexts
from gs_codec.runtime.kernels import kernel


@kernel
def _walk(marks, state, data, contexts):
    """Code the marks of a list; the context of each is the one before."""
    before = 0
    for i in range(len(marks)):
        before = 1 if code_bit(state, data, contexts, before, marks[i] != 0) else 0
        marks[i] = before


def encode_marks(lists: Sequence[NDArray[np.int64]]) -> bytes:
    """Code lists of zeros and ones."""

    def model(state: NDArray, data: NDArray) -> None:
        contexts = new_contexts(2)
        for marks in lists:
            _walk(marks.copy(), state, data, contexts)

    return encode_binary(model, 0)


def decode_marks(data: memoryview, sizes: Sequence[int], where: str) -> list[NDArray[np.int64]]:
    """Invert `encode_marks`, for lists of these sizes.

    Raises
    ------
    CorruptStream
        If the size of the stream does not match the lists.
    """
    lists = [np.zeros(size, np.int64) for size in sizes]

    def model(state: NDArray, stream: NDArray) -> None:
        contexts = new_contexts(2)
        for marks in lists:
            _walk(marks, state, stream, contexts)

    decode_binary(model, data, where)
    return lists
