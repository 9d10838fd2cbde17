"""Trees of positions on a device, a thread for each block. FORMAT.md, section "Geometry"."""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.coding.binary import FRESH
from gs_codec.coding.count_tree import STACK, TREE_CONTEXTS, walk

#: State of a binary coder: low, high, code, bytes read, whether it encodes.
_STATE = 5


@cuda.jit
def read_trees(raw, places, starts, total_bits, codes, lefts, ends):
    """Fill codes of positions and how many low bits they lack, ``(N,)``.

    Data of a block are between its ``places (blocks, 2)``; ``ends (blocks, 3)`` get the low, high
    and position that the coder ends with.
    """
    block = cuda.blockIdx.x
    start, stop = starts[block], starts[block + 1]
    data = raw[places[block, 0] : places[block, 1]]
    contexts = cuda.shared.array(TREE_CONTEXTS, np.int32)
    nodes = cuda.shared.array((4, STACK), np.int64)
    prefixes = cuda.shared.array(STACK, np.int64)
    state = cuda.local.array(_STATE, np.int64)
    for k in range(TREE_CONTEXTS):
        contexts[k] = FRESH
    state[0], state[1], state[2], state[3], state[4] = 0, 0xFFFFFFFF, 0, 4, 0
    for k in range(4):
        byte = np.int64(data[k]) if k < len(data) else np.int64(0)
        state[2] = state[2] << 8 | byte
    own = codes[start:stop], lefts[start:stop]
    walk(own[0], total_bits, state, data, contexts, own[1], False, nodes, prefixes)
    ends[block, 0], ends[block, 1], ends[block, 2] = state[0], state[1], state[3]
