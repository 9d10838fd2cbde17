"""The `index` section: bounding boxes of each block. FORMAT.md, section "Index"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.extent import EXTENT, centre_box
from gs_codec.egs.egs_file import EgsFile, Section, SectionId
from gs_codec.errors import CorruptStream
from gs_codec.runtime.wording import counted

Box = tuple[tuple[float, ...], tuple[float, ...]]

_WHERE = "section 'index'"


def index_section(extents: Sequence[NDArray[np.float32]]) -> list[Section]:
    """The section with the extents ``(12,)`` of blocks (`block_extent`); none without blocks."""
    if not extents:
        return []
    return [Section(SectionId.INDEX, 0, np.stack(extents).astype("<f4").tobytes())]


def index_of(file: EgsFile) -> NDArray[np.float32]:
    """Extents of the blocks of a file, ``(blocks, 12)``; see `read_index`."""
    blocks = file.header.block_count
    if not blocks:
        return np.zeros((0, EXTENT), np.float32)
    return file.parsed(SectionId.INDEX, lambda data: read_index(data, blocks))


def bounds_of(file: EgsFile) -> Box | None:
    """Lowest and highest corner of the finite centres of a file; None without Gaussians."""
    extents = index_of(file)
    if not len(extents):
        return None
    low, high = extents[:, :3].min(axis=0), extents[:, 3:6].max(axis=0)
    return tuple(low.tolist()), tuple(high.tolist())


def check_centres(file: EgsFile, block: int, positions: NDArray[np.float32]) -> None:
    """Check that the index matches the decoded centres ``(3, n)`` of a block.

    Raises
    ------
    CorruptStream
    """
    if centre_box(positions).tobytes() != index_of(file)[block, :6].tobytes():
        raise CorruptStream(f"{_WHERE}: does not match block {block}")


def check_boxes(file: EgsFile, boxes: NDArray[np.float32]) -> None:
    """Check that the index matches the boxes ``(blocks, 6)`` of decoded, finite centres.

    Raises
    ------
    CorruptStream
    """
    # Adding 0 turns -0 into 0.
    found, told = boxes + np.float32(0), np.ascontiguousarray(index_of(file)[:, :6])
    differ = np.any(found.view(np.uint32) != told.view(np.uint32), axis=1)
    if differ.any():
        raise CorruptStream(f"{_WHERE}: does not match block {np.argmax(differ)}")


def read_index(data: memoryview, blocks: int) -> NDArray[np.float32]:
    """Parse the extents of `blocks` blocks, ``(blocks, 12)``; inverse of `index_section`.

    Raises
    ------
    CorruptStream
        If their number is wrong, or a box is invalid or does not contain its centres.
    """
    if len(data) != 4 * EXTENT * blocks:
        raise CorruptStream(
            f"{_WHERE}: {counted(len(data), 'byte')}, expected {4 * EXTENT * blocks:,}"
        )
    extents = np.frombuffer(data, "<f4").reshape(blocks, EXTENT).astype(np.float32)
    low, high, least, most = extents.reshape(blocks, 4, 3).transpose(1, 0, 2)
    sound = np.isfinite(extents).all(axis=1)
    sound &= np.all((least <= low) & (low <= high) & (high <= most), axis=1)
    if not sound.all():
        raise CorruptStream(f"{_WHERE}: no boxes of block {np.argmin(sound)}")
    return extents
