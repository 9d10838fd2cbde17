"""What each Gaussian of a file takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.costs import symbol_bits
from gs_codec.config import ADAPTIVE_PROFILES
from gs_codec.egs.file import SCENE_SECTIONS, EgsFile
from gs_codec.runtime.threads import using_threads


def gaussian_bits(file: EgsFile) -> NDArray[np.float64]:
    """Bits of each Gaussian ``(N,)`` of a file that decodes, in stream order; in sum, the file's.

    With profiles `l`, `m` and `s`, the information of its own symbols; positions, and all of the
    other profiles, are the mean of the block. What the file has once is shared by all.

    Raises
    ------
    CorruptStream, TruncatedStream
    """
    header = file.header
    bits = np.zeros(header.count)
    if header.profile in ADAPTIVE_PROFILES:
        with using_threads(None, header.count):
            bits = symbol_bits(file)
    sizes = np.zeros(header.block_count)
    for (section, block), size in file.sizes.items():
        if section not in SCENE_SECTIONS and block < len(sizes):
            sizes[block] += 8 * size
    for block, block_bits in enumerate(sizes):
        own = bits[slice(*header.block_range(block))]
        own += (block_bits - own.sum()) / len(own)
    return bits + (8 * len(file.data) - sizes.sum()) / max(header.count, 1)
