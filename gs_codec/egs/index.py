"""The sections `index`, `level` and `errors`: boxes of blocks, and levels of detail. FORMAT.md."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.extent import EXTENT, centre_box
from gs_codec.egs.egs_file import EgsFile, Section, SectionId, described, read_file
from gs_codec.egs.header import FANOUT, Header
from gs_codec.errors import CorruptStream, TruncatedStream, UnsupportedVersion
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

    Raises CorruptStream.
    """
    if centre_box(positions).tobytes() != index_of(file)[block, :6].tobytes():
        raise CorruptStream(f"{_WHERE}: does not match block {block}")


def check_boxes(file: EgsFile, boxes: NDArray[np.float32]) -> None:
    """Check that the index matches the boxes ``(blocks, 6)`` of decoded, finite centres.

    Raises CorruptStream.
    """
    # Adding 0 turns -0 into 0.
    found, stated = boxes + np.float32(0), np.ascontiguousarray(index_of(file)[:, :6])
    differ = np.any(found.view(np.uint32) != stated.view(np.uint32), axis=1)
    if differ.any():
        raise CorruptStream(f"{_WHERE}: does not match block {np.argmax(differ)}")


def read_index(data: memoryview, blocks: int) -> NDArray[np.float32]:
    """Parse the extents of `blocks` blocks, ``(blocks, 12)``; inverse of `index_section`.

    Raises CorruptStream if their number is wrong, or a box is invalid or does not contain its
    centres.
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


_IN_ERRORS = "section 'errors'"


def level_header(header: Header, level: int) -> Header:
    """The header of a level of a file with this header; the level may lack some of its features."""
    count = header.level_counts[level - 1]
    return replace(header, count=count, has_normals=False)


def errors_section(errors: NDArray[np.float32]) -> Section:
    """The section with the errors of a level's blocks, ``(blocks,)``, in scene units."""
    return Section(SectionId.ERRORS, 0, errors.astype("<f4").tobytes())


def levels_of(file: EgsFile) -> list[int]:
    """Numbers of the levels of a file, without level 0, ascending."""
    return sorted(block for section, block in file.table if section == SectionId.LEVEL)


def open_level(file: EgsFile, level: int) -> EgsFile:
    """Open a level as a file of its own; its descriptions are read and checked.

    Raises CorruptStream, TruncatedStream or UnsupportedVersion.
    """
    with within(level):
        data = file.nested(SectionId.LEVEL, level)
        found = read_file(data, described)
        wanted = level_header(file.header, level)
        same = replace(found.header, features=wanted.features) == wanted
        if not same or found.header.features & ~wanted.features or levels_of(found):
            raise CorruptStream("header: does not match a level of this file")
        errors_of(found)
    return found


def errors_of(file: EgsFile) -> NDArray[np.float32]:
    """Errors of the blocks of a level, ``(blocks,)``."""
    blocks = file.header.block_count
    return file.parsed(SectionId.ERRORS, lambda data: _read_errors(data, blocks))


def _read_errors(data: memoryview, blocks: int) -> NDArray[np.float32]:
    if len(data) != 4 * blocks:
        raise CorruptStream(f"{_IN_ERRORS}: {counted(len(data), 'byte')}, expected {4 * blocks:,}")
    errors = np.frombuffer(data, "<f4").astype(np.float32)
    if not (np.isfinite(errors) & (errors >= 0)).all():
        raise CorruptStream(f"{_IN_ERRORS}: a value is not finite, or below 0")
    return errors


def check_errors(finer: NDArray[np.float32], coarser: NDArray[np.float32]) -> None:
    """Check that no block has a lower error than the finer blocks it replaces.

    Raises CorruptStream.
    """
    least = np.maximum.reduceat(finer, np.arange(0, len(finer), FANOUT))
    if (coarser < least).any():
        block = int(np.argmax(coarser < least))
        raise CorruptStream(
            f"{_IN_ERRORS}: block {block} has a smaller error than a block that it replaces"
        )


@contextmanager
def within(level: int) -> Iterator[None]:
    """Name the level in errors raised in the block, unless it is 0."""
    try:
        yield
    except (CorruptStream, TruncatedStream, UnsupportedVersion) as error:
        if not level:
            raise
        raise type(error)(f"level {level}: {error}") from error
