"""Floats as integers in the same order, and the order of Gaussians that follows from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.transform.morton import encode_morton

_SIGN = np.uint32(1 << 31)


def to_ordered(bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Integers that ascend with the floats of these bit patterns, one for each pattern."""
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


def from_ordered(ordered: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The inverse of `to_ordered`."""
    return np.where(ordered & _SIGN, ordered ^ _SIGN, ~ordered)


def float_order(
    positions: NDArray[np.float32], others: list[NDArray[np.float32]]
) -> NDArray[np.int64]:
    """Permutation that sorts by the Morton code of all 32 bits of each coordinate.

    Any float can be sorted, NaN too. Gaussians at the same position are sorted by their other
    attributes; only Gaussians that agree in every bit keep the order of the input.

    Parameters
    ----------
    positions : ndarray, shape (3, N), float32
    others : list of ndarray, each of shape (C, N), float32
    """
    ordered = to_ordered(positions.view(np.uint32))
    high = encode_morton(ordered >> np.uint32(11), (21, 21, 21))
    low = encode_morton(ordered & np.uint32(0x7FF), (11, 11, 11))
    order = np.lexsort((low, high))
    before, after = order[:-1], order[1:]
    same = (high[before] == high[after]) & (low[before] == low[after])
    tied = np.zeros(order.size, bool)
    tied[1:] |= same
    tied[:-1] |= same
    ties = np.sort(order[tied])
    rows = [row for plane in others for row in plane[:, ties].view(np.uint32)]
    order[tied] = ties[np.lexsort((*rows, low[ties], high[ties]))]
    return order
