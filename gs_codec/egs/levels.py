"""The sections of levels of detail: `level` and `errors`. FORMAT.md, section "Levels"."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.egs.egs_file import DESCRIPTIONS, EgsFile, Section, SectionId, read_file
from gs_codec.egs.header import FANOUT, Feature, Header
from gs_codec.errors import CorruptStream, TruncatedStream, UnsupportedVersion
from gs_codec.runtime.wording import counted

_WHERE = "section 'errors'"


def level_header(header: Header, level: int) -> Header:
    """The header of a level of a file with this header; the level may have no far Gaussians."""
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

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    """
    with within(level):
        data = file.nested(SectionId.LEVEL, level)
        found = read_file(data, lambda section, _: section in DESCRIPTIONS)
        wanted = level_header(file.header, level)
        fewer = replace(wanted, features=wanted.features & ~Feature.FAR)
        if found.header not in (wanted, fewer) or levels_of(found):
            raise CorruptStream("header: is not that of a level of this file")
        errors_of(found)
    return found


def errors_of(file: EgsFile) -> NDArray[np.float32]:
    """Errors of the blocks of a level, ``(blocks,)``."""
    blocks = file.header.block_count
    return file.parsed(SectionId.ERRORS, lambda data: _read_errors(data, blocks))


def _read_errors(data: memoryview, blocks: int) -> NDArray[np.float32]:
    if len(data) != 4 * blocks:
        raise CorruptStream(f"{_WHERE}: {counted(len(data), 'byte')}, expected {4 * blocks:,}")
    errors = np.frombuffer(data, "<f4").astype(np.float32)
    if not (np.isfinite(errors) & (errors >= 0)).all():
        raise CorruptStream(f"{_WHERE}: a value is not finite, or below 0")
    return errors


def check_errors(finer: NDArray[np.float32], coarser: NDArray[np.float32]) -> None:
    """Check that no block has a lower error than the finer blocks it replaces.

    Raises
    ------
    CorruptStream
    """
    least = np.maximum.reduceat(finer, np.arange(0, len(finer), FANOUT))
    if (coarser < least).any():
        block = int(np.argmax(coarser < least))
        raise CorruptStream(f"{_WHERE}: block {block} has less than one of the level below")


@contextmanager
def within(level: int) -> Iterator[None]:
    """Name the level in errors raised in the block, unless it is 0."""
    try:
        yield
    except (CorruptStream, TruncatedStream, UnsupportedVersion) as error:
        if not level:
            raise
        raise type(error)(f"level {level}: {error}") from error
