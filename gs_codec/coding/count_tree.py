"""Lossless coder of sorted Morton codes: a binary tree of point counts.

Every node has the number of points that share a Morton prefix. A node of two or more points codes
the number of points in its low half. A node of one point is a leaf; its remaining bits are coded
elsewhere. A node with no bits left consists of duplicates. FORMAT.md, section "Geometry".
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import code_bit, decode_binary, encode_binary, new_contexts
from gs_codec.coding.fields import BitReader, BitWriter, ByteReader
from gs_codec.runtime.kernels import inlined, kernel

_CLASSES = 24
_SPLIT_CONTEXTS = 4 * _CLASSES
_BISECT_NODES = 32
TREE_CONTEXTS = _SPLIT_CONTEXTS + _CLASSES * _BISECT_NODES


@inlined
def _count_class(count):
    """Class 0..23 of a count: one class for each of 2..9, then one per doubling."""
    if count < 10:
        return count - 2
    size = 0
    while count > 15:
        count >>= 1
        size += 1
    return 8 + size


@inlined
def _code_split(state, data, contexts, count, onesided, low):
    """Code how many of `count` points lie in the low half; return that number."""
    size = _count_class(count)
    base = 4 * size + 2 * onesided
    if code_bit(state, data, contexts, base, low == 0):
        return 0
    if code_bit(state, data, contexts, base + 1, low == count):
        return count
    first = 1
    last = count - 1
    node = 1
    while first < last:
        middle = (first + last) >> 1
        context = _SPLIT_CONTEXTS + _BISECT_NODES * size + min(node, _BISECT_NODES - 1)
        above = code_bit(state, data, contexts, context, low > middle)
        if above:
            first = middle + 1
            node = 2 * node + 1
        else:
            last = middle
            node = 2 * node
    return first


@inlined
def _low_half(codes, start, stop, bit):
    """Number of codes in [start, stop) whose `bit` is 0; they come first."""
    first = start
    last = stop
    while first < last:
        middle = (first + last) >> 1
        if (codes[middle] >> bit) & 1:
            last = middle
        else:
            first = middle + 1
    return first - start


#: Maximum number of pending nodes, for codes of 63 bits.
STACK = 65


@inlined
def walk(codes, total_bits, state, data, contexts, lefts, encoding, nodes):
    """Code `codes` depth first, low half first; leaves omit their ``lefts`` low bits.

    ``nodes (5, STACK)``, int64, is scratch memory. Each pending node has: its start, its count, its
    remaining bits, whether it has all points of its parent, and its prefix.
    """
    nodes[0, 0], nodes[1, 0], nodes[2, 0] = 0, len(codes), total_bits
    nodes[3, 0] = nodes[4, 0] = 0
    top = 1 if len(codes) > 0 else 0
    while top > 0:
        top -= 1
        start, count, left = nodes[0, top], nodes[1, top], nodes[2, top]
        prefix = nodes[4, top]
        if count == 1 or left == 0:
            # A single point, or duplicates if no bits remain.
            for i in range(start, start + count):
                lefts[i] = left
                if not encoding:
                    codes[i] = prefix << left
            continue
        left -= 1
        low = 0
        if encoding:
            low = _low_half(codes, start, start + count, left)
        low = _code_split(state, data, contexts, count, nodes[3, top], low)
        onesided = 1 if low in (0, count) else 0
        if low < count:
            nodes[0, top], nodes[1, top] = start + low, count - low
            nodes[2, top], nodes[3, top], nodes[4, top] = left, onesided, (prefix << 1) | 1
            top += 1
        if low > 0:
            nodes[0, top], nodes[1, top] = start, low
            nodes[2, top], nodes[3, top], nodes[4, top] = left, onesided, prefix << 1
            top += 1


@kernel
def _walk(codes, total_bits, state, data, contexts, lefts, encoding):
    nodes = np.empty((5, STACK), np.int64)
    walk(codes, total_bits, state, data, contexts, lefts, encoding, nodes)


def encode_tree(codes: NDArray[np.int64], total_bits: int) -> tuple[bytes, NDArray[np.int64]]:
    """Code sorted Morton codes, each down to the bit where it becomes unique.

    Parameters
    ----------
    codes : ndarray, shape (N,), int64
        Ascending; duplicates allowed.
    total_bits : int
        Bits of a code, 0-63.

    Returns
    -------
    data : bytes
    lefts : ndarray, shape (N,), int64
        Number of low bits of each code that the tree omits.
    """
    lefts = np.zeros(codes.size, np.int64)

    def model(state: NDArray, data: NDArray) -> None:
        _walk(codes, total_bits, state, data, new_contexts(TREE_CONTEXTS), lefts, True)

    return encode_binary(model, codes.size), lefts


def decode_tree(
    data: memoryview, count: int, total_bits: int, where: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Invert `encode_tree`: codes with omitted bits set to 0, and how many bits each omits.

    Raises CorruptStream if the size of the data does not match `count` codes.
    """
    codes, lefts = np.zeros((2, count), np.int64)

    def model(state: NDArray, stream: NDArray) -> None:
        _walk(codes, total_bits, state, stream, new_contexts(TREE_CONTEXTS), lefts, False)

    decode_binary(model, data, where)
    return codes, lefts


def encode_geometry(codes: NDArray[np.int64], total_bits: int) -> bytes:
    """Code all bits of sorted Morton codes ``(N,)``, int64, of 0-63 bits."""
    coded, lefts = encode_tree(codes, total_bits)
    bits = BitWriter()
    bits.add(codes, lefts.astype(np.uint8))
    return struct.pack("<I", len(coded)) + coded + bits.finish()


def decode_geometry(data: memoryview, count: int, total_bits: int, where: str) -> NDArray[np.int64]:
    """Invert `encode_geometry` for `count` codes.

    Raises TruncatedStream or CorruptStream if the size of the section does not match `count` codes.
    """
    reader = ByteReader(data, where)
    tree = reader.take(reader.unpack("I")[0])
    codes, lefts = decode_tree(tree, count, total_bits, where)
    bits = BitReader(reader.rest(), where)
    codes |= bits.fields(lefts)
    bits.close()
    return codes
