"""Trees of positions on a device, one thread per block. FORMAT.md, section "Geometry"."""

from __future__ import annotations

import numpy as np

from gs_codec.codecs.cuda.lanes import device
from gs_codec.coding.binary import FRESH
from gs_codec.coding.count_tree import TREE_CONTEXTS, walk


@device
def read_tree(
    block, data, places, starts, total_bits, codes, lefts, coders, contexts, nodes, state
):  # fmt: skip
    """Decode position codes and their numbers of missing low bits, ``(N,)``.

    The tree of a block is between its ``places (blocks, 2)``; ``coders (blocks, 5)`` receives the
    final state of its coder. ``contexts (TREE_CONTEXTS,)``, int32, ``nodes (5, STACK)`` and ``state
    (5,)``, int64, are scratch memory.
    """
    start, stop = starts[block], starts[block + 1]
    tree = data[places[block, 0] : places[block, 1]]
    for k in range(TREE_CONTEXTS):
        contexts[k] = FRESH
    code = np.int64(0)
    for k in range(4):
        code = code << 8 | (np.int64(tree[k]) if k < len(tree) else np.int64(0))
    state[0], state[1], state[2], state[3], state[4] = 0, 0xFFFFFFFF, code, 4, 0
    walk(codes[start:stop], total_bits, state, tree, contexts, lefts[start:stop], False, nodes)
    for k in range(5):
        coders[block, k] = state[k]
