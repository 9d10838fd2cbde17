"""Frames of a sequence: the sections `timeline`, `key-frame` and `motion`.

FORMAT.md, section "Sequences".
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gs_codec.coding.fields import ByteReader
from gs_codec.egs.egs_file import (
    FRAME_SECTIONS,
    MAGIC,
    MOST_FRAMES,
    EgsFile,
    Readable,
    Section,
    SectionId,
    Wanted,
    described,
    read_file,
)
from gs_codec.egs.header import Feature, Header
from gs_codec.errors import (
    CorruptStream,
    InvalidInput,
    TruncatedStream,
    UnsupportedVersion,
)
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

_WHERE = "section 'timeline'"

#: Where the header states features.
_FEATURES = slice(24, 28)

#: Features that key frames may have; the file's header has those of all of them.
_OF_KEYS = Feature.FAR | Feature.LOCAL_BASIS

#: Characters that names do not have; line feeds are between them.
_CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f]")

#: Maximum bytes of the names of frames.
_NAME_BYTES = 1 << 26


@dataclass(frozen=True)
class Timeline:
    """What a sequence states about its frames.

    Attributes
    ----------
    count : int
        Number of frames.
    rate : tuple of two int
        Frames a second, as numerator and denominator.
    names : tuple of str
        Name of each frame, without suffix; empty if they have none.
    keys : tuple of int
        Numbers of the key frames, ascending; the first is 0.
    """

    count: int
    rate: tuple[int, int]
    names: tuple[str, ...]
    keys: tuple[int, ...]

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self.rate[0] / self.rate[1]

    def key_of(self, frame: int) -> int:
        """The key frame that a frame is decoded from."""
        return self.keys[int(np.searchsorted(self.keys, frame, "right")) - 1]

    def name_of(self, frame: int) -> str:
        """The name of a frame; its number if it has none."""
        return self.names[frame] if self.names else f"{frame:0{max(4, len(str(self.count)))}}"


def is_sequence(path: str | Path) -> bool | None:
    """Whether an `.egs` is a sequence; None for a pipe, and for anything that is no `.egs`."""
    try:
        if not Path(path).is_file():
            return None
        with open(path, "rb") as file:
            start = file.read(_FEATURES.stop)
    except OSError:  # reported by the reader
        return None
    if not start.startswith(MAGIC):
        return None
    return bool(int.from_bytes(start[_FEATURES], "little") & Feature.SEQUENCE)


def read_described(data: Readable | bytes, wanted: Wanted | None = described) -> EgsFile:
    """Read a file, by default only its descriptions; of a sequence, those of its first frame.

    Raises TruncatedStream, CorruptStream or UnsupportedVersion.
    """
    file = read_file(data, described)
    if Feature.SEQUENCE in file.header.features:
        log.warning("only the first of %s is read", counted(timeline_of(file).count, "frame"))
        file = open_key_frame(file, 0)
    return file.read(wanted)


def timeline_section(rate: tuple[int, int], names: Sequence[str], count: int) -> Section:
    """The section `timeline` of `count` frames."""
    known = (name if name.isprintable() else f"{number:04d}" for number, name in enumerate(names))
    text = "\n".join(known).encode()
    if len(text) > _NAME_BYTES:
        raise InvalidInput(
            f"names of frames: {counted(len(text), 'byte')}, at most {_NAME_BYTES:,}"
        )
    return Section(SectionId.TIMELINE, 0, struct.pack("<3I", count, *rate) + text)


def timeline_of(file: EgsFile) -> Timeline:
    """The timeline of a file that is a sequence.

    Raises CorruptStream, also if the file has not exactly one section for each frame.
    """
    if not file.header.count:
        raise CorruptStream("header: a sequence without Gaussians")
    count, rate, names = file.parsed(SectionId.TIMELINE, _read_timeline)
    own = {*FRAME_SECTIONS, SectionId.TIMELINE}
    listed = []
    for section, number in file.table:
        if section in own - {SectionId.TIMELINE}:
            listed.append(number)
        elif section not in own and section in set(SectionId):
            label = SectionId(section).label
            raise CorruptStream(f"section '{label}' of block {number}: in a sequence")
    if listed != list(range(count)):
        shown = f"frames {', '.join(map(str, listed[:9]))}"
        raise CorruptStream(f"header: {shown}, expected 0 to {count - 1}, ascending")
    keys = tuple(number for section, number in file.table if section == SectionId.KEY_FRAME)
    if keys[:1] != (0,):
        raise CorruptStream("header: the first frame is not a key frame")
    return Timeline(count, rate, names, keys)


def _read_timeline(data: memoryview) -> tuple[int, tuple[int, int], tuple[str, ...]]:
    reader = ByteReader(data, _WHERE)
    count, above, below = reader.unpack("3I")
    if not (1 <= count <= MOST_FRAMES and above and below):
        raise CorruptStream(f"{_WHERE}: {counted(count, 'frame')}, {above}/{below} a second")
    rest = reader.rest()
    if not len(rest):
        return count, (above, below), ()
    try:
        text = bytes(rest).decode()
    except UnicodeDecodeError:
        raise CorruptStream(f"{_WHERE}: names that are not UTF-8") from None
    names = tuple(text.split("\n"))
    if len(names) != count or len(rest) > _NAME_BYTES or _CONTROL.search(text):
        shown = f"{counted(len(names), 'name')} for {counted(count, 'frame')}"
        raise CorruptStream(f"{_WHERE}: {shown}, or control characters")
    return count, (above, below), names


def open_key_frame(file: EgsFile, frame: int) -> EgsFile:
    """Open a key frame as a file of its own; its descriptions are read and checked.

    Raises CorruptStream, TruncatedStream or UnsupportedVersion.
    """
    with within_frame(frame):
        data = file.nested(SectionId.KEY_FRAME, frame)
        found = read_file(data, described)
        if sequence_header([found.header]).features & ~file.header.features:
            raise CorruptStream("header: a feature that the sequence does not state")
        if not {SectionId.LEVEL, SectionId.EXTRA}.isdisjoint(section for section, _ in found.table):
            raise CorruptStream("header: levels or extra properties in a sequence")
        same = replace(found.header, features=file.header.features) == file.header
        alike = same if frame == 0 else _alike(found.header, file.header)
        if not alike or Feature.SEQUENCE in found.header.features:
            raise CorruptStream("header: does not match the sequence")
    return found


def _alike(key: Header, whole: Header) -> bool:
    """Whether a header differs only in what may differ between frames."""
    block_size, features = whole.block_size, whole.features
    same = replace(key, count=whole.count, block_size=block_size, features=features)
    return same == whole


def sequence_header(keys: Sequence[Header]) -> Header:
    """The header of a sequence, from those of its key frames.

    Raises InvalidInput if they differ in what all frames must share.
    """
    features = Feature.SEQUENCE
    for key in keys:
        features |= key.features & _OF_KEYS
    whole = replace(keys[0], features=features)
    for key in keys:
        if not _alike(key, whole):
            raise InvalidInput("frames differ in SH degree, coordinates, antialiasing or normals")
    return whole


@contextmanager
def within_frame(frame: int) -> Iterator[None]:
    """Name the frame in errors raised in the block."""
    try:
        yield
    except (CorruptStream, TruncatedStream, UnsupportedVersion) as error:
        raise type(error)(f"frame {frame}: {error}") from error
