"""The section table and the sections of an `.egs` file. FORMAT.md, section "File"."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple, TypeVar

from crc32c import crc32c

from gs_codec.coding.fields import ByteReader
from gs_codec.egs.header import FIELDS, TOO_LARGE, Feature, Header, pack_header, unpack_header
from gs_codec.errors import CorruptStream, TruncatedStream, UnsupportedVersion
from gs_codec.format_table import EGS
from gs_codec.runtime.arrays import current
from gs_codec.runtime.guess import LOOKED_AT, looks_like
from gs_codec.runtime.mapped import FileBytes
from gs_codec.runtime.wording import counted

Parsed = TypeVar("Parsed")

MAGIC = EGS.signatures[0]

#: Highest version that can be read; `Header.version` is the version of a file.
VERSION = 2

#: Minor version of files without levels.
MINOR = 0

#: Minor version of files of version 1 with levels.
MINOR_LEVELS = 1

_START = "<8sHHI"
_ENTRY = "<HHIQI"
_OPTIONAL_FLAG = 1

#: Maximum number of frames of a sequence.
MOST_FRAMES = 1 << 24

#: Bytes of the checksum that ends the header.
_CHECKSUM = 4

#: Sections start at multiples of this offset.
_ALIGNMENT = 4


class SectionId(IntEnum):
    """Identifiers of sections."""

    CHANNELS = 1
    GEOMETRY = 2
    SH_DC = 3
    STATES = 4
    OPACITY = 5
    SCALING = 6
    ROTATION = 7
    SH1 = 8
    SH2 = 9
    SH3 = 10
    COMMENTS = 11
    EXTRA = 12
    LATTICE = 13
    CLASSES = 14
    LOW_BITS = 15
    INDEX = 16
    GPCC = 17
    TOOL = 18
    CODER = 19
    LEVEL = 20
    ERRORS = 21
    FAR = 22
    BASIS = 23
    TIMELINE = 24
    KEY_FRAME = 25
    MOTION = 26

    @property
    def label(self) -> str:
        """Name in messages and reports; for a section of a stream, the stream's name."""
        return self.name.lower().replace("_", "-")

    @classmethod
    def of_stream(cls, stream: str) -> SectionId:
        """The section of a stream."""
        return cls[stream.upper().replace("-", "_")]


def section_label(section_id: int) -> str:
    """Name of a section in messages and reports, including unknown sections."""
    known = section_id in set(SectionId)
    return SectionId(section_id).label if known else f"section {section_id}"


#: Sections that describe where blocks are and how they are coded; a file begins with them, in this
#: order.
DESCRIPTIONS = (
    SectionId.INDEX,
    SectionId.ERRORS,
    SectionId.CHANNELS,
    SectionId.LATTICE,
    SectionId.TOOL,
    SectionId.CODER,
    SectionId.TIMELINE,
)

#: Sections of frames of a sequence: their block number is the frame's.
FRAME_SECTIONS = (SectionId.KEY_FRAME, SectionId.MOTION)

#: Sections of the whole scene; all others belong to a block.
SCENE_SECTIONS = frozenset(
    {
        *DESCRIPTIONS,
        *FRAME_SECTIONS,
        SectionId.COMMENTS,
        SectionId.EXTRA,
        SectionId.LEVEL,
    },
)

#: Sections that files with a feature have, and no others.
_FEATURE_SECTIONS = {
    Feature.GPCC: SectionId.TOOL,
    Feature.TORCHAC: SectionId.CODER,
    Feature.FAR: SectionId.FAR,
    Feature.LOCAL_BASIS: SectionId.BASIS,
    Feature.SEQUENCE: SectionId.TIMELINE,
}

#: Sections of a block that follow all other sections of blocks, in this order.
_LATER = (SectionId.SH1, SectionId.SH2, SectionId.SH3)

#: Data that a file can be read from.
Readable = memoryview | FileBytes

#: ``wanted(id, block)`` returns whether to read a section.
Wanted = Callable[[int, int], bool]


def described(section: int, _block: int) -> bool:
    """What to read of a file at first: its descriptions."""
    return section in DESCRIPTIONS


@dataclass(frozen=True)
class Section:
    """Bytes of a section; `block` is 0 for sections of the whole scene, or the level's number."""

    id: SectionId
    block: int
    data: bytes | memoryview
    optional: bool = False

    @classmethod
    def kept(cls, section_id: SectionId, block: int, data: bytes) -> Section:
        """A section with its bytes moved to the storage in use (memory or disk)."""
        return cls(section_id, block, current().keep_bytes(data))


class Entry(NamedTuple):
    """Position, size and checksum of a section."""

    position: int
    size: int
    checksum: int


class Sections(Mapping[tuple[int, int], memoryview]):
    """The checked sections of a file.

    They are not kept in memory: each access reads the section from the open file and checks it
    again, in case the file has changed.
    """

    def __init__(
        self,
        data: Readable,
        table: dict[tuple[int, int], Entry],
        checked: Iterable[tuple[int, int]] = (),
    ) -> None:
        self._data, self._table = data, table
        self._checked = {key: table[key] for key in checked}

    def __getitem__(self, key: tuple[int, int]) -> memoryview:
        position, size, _ = self._checked[key]
        if isinstance(self._data, FileBytes):
            return self.only(key)
        return self._data[position : position + size]

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self._checked)

    def __len__(self) -> int:
        return len(self._checked)

    @property
    def size(self) -> int:
        """Bytes of the sections including padding."""
        return sum(_padded(entry.size) for entry in self._checked.values())

    def check(self, wanted: Wanted | None) -> Sections:
        """These sections plus the wanted ones, checked."""
        known = set(SectionId)
        new = [key for key in self._table if key not in self and (wanted is None or wanted(*key))]
        for key in new:
            self.only(key)
        new = [key for key in new if key[0] in known]
        return Sections(self._data, self._table, [*self, *new])

    def only(self, key: tuple[int, int]) -> memoryview:
        """A section of the table, checked."""
        position, size, checksum = self._table[key]
        data = self._data[position : position + _padded(size)]
        content, wrong = data[:size], None
        if crc32c(content) != checksum:
            wrong = "checksum does not match"
        elif any(data[size:]):
            wrong = "padding that is not 0"
        if wrong:
            if isinstance(self._data, FileBytes):
                self._data.check_unchanged()
            raise CorruptStream("section {} of block {}: {}".format(*key, wrong))
        return content


@dataclass(frozen=True)
class EgsFile:
    """A file with its checked header, and the sections that have been checked."""

    header: Header
    data: Readable
    header_size: int
    table: dict[tuple[int, int], Entry]
    sections: Sections
    version: int
    _parsed: dict[SectionId, Any] = field(default_factory=dict, repr=False)

    def parsed(self, section_id: SectionId, parse: Callable[[memoryview], Parsed]) -> Parsed:
        """Parse a section of the whole scene, once."""
        if section_id not in self._parsed:
            self._parsed[section_id] = parse(self.section(section_id))
        return self._parsed[section_id]

    @property
    def sizes(self) -> dict[tuple[int, int], int]:
        """Bytes of each section including padding, whether read or not."""
        return {key: _padded(entry.size) for key, entry in self.table.items()}

    @property
    def bytes_read(self) -> int:
        """Size of the header and of all sections read, including padding."""
        return self.header_size + self.sections.size

    def section(self, section_id: SectionId, block: int = 0) -> memoryview:
        """Bytes of a section; raises if it is missing."""
        try:
            return self.sections[section_id, block]
        except KeyError:
            raise CorruptStream(f"section '{section_id.label}' of block {block}: missing") from None

    def only(self, section_id: SectionId, block: int) -> memoryview:
        """Bytes of a section that is in the table, checked; only this section is read."""
        return self.sections.only((section_id, block))

    def read(self, wanted: Wanted | None = None) -> EgsFile:
        """Check further sections; see `read_file`."""
        return replace(self, sections=self.sections.check(wanted))

    def nested(self, section_id: SectionId, block: int) -> Readable:
        """A section that is itself a file, whose sections have their own checksums."""
        position, size, _ = self.table[section_id, block]
        if isinstance(self.data, FileBytes):
            return self.data.window(position, size)
        return self.data[position : position + size]


def section_sizes(sized: Sequence[tuple[int, int]]) -> dict[str, int]:
    """Bytes of a file by section, padding included, from the id and size of each section.

    ``header`` includes the section table.
    """
    sizes = Counter({"header": head_size(len(sized))})
    for section_id, size in sized:
        sizes[SectionId(section_id).label] += _padded(size)
    return dict(sizes)


def in_file_order(sections: Iterable[Section]) -> list[Section]:
    """Sort sections into file order, so that the start of a file is useful without the rest.

    The order is: descriptions and comments; levels, the coarsest first; blocks without SH-AC;
    SH-AC, band by band; extra properties. Otherwise sections keep their order.
    """
    return sorted(sections, key=lambda section: place_in_file(section.id, section.block))


def place_in_file(section_id: SectionId, block: int) -> tuple[int, int]:
    """Sort key of `in_file_order`."""
    scene = (*DESCRIPTIONS, SectionId.COMMENTS, SectionId.LEVEL)
    if section_id in scene:
        return scene.index(section_id) - len(scene), -block
    if section_id in _LATER:
        return 1 + _LATER.index(section_id), block
    return (1 + len(_LATER) if section_id == SectionId.EXTRA else 0), block


def _padded(size: int) -> int:
    """Size of a section including padding up to the start of the next one."""
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def head_size(sections: int) -> int:
    """Size of `file_head` with this many sections."""
    fixed = struct.calcsize(_START) + struct.calcsize("<" + FIELDS) + 4
    return fixed + sections * struct.calcsize(_ENTRY) + _CHECKSUM


def write_file(header: Header, sections: Iterable[Section]) -> bytes:
    """Assemble a file; sections are stored in the order given."""
    return b"".join(file_parts(header, list(sections)))


def file_parts(header: Header, sections: Sequence[Section]) -> list[bytes | memoryview]:
    """The consecutive pieces of a file: its header, then its sections in the order given."""
    parts: list[bytes | memoryview] = [file_head(header, [Listed.of(each) for each in sections])]
    for section in sections:
        parts += padded_parts(section)
    return parts


class Listed(NamedTuple):
    """An entry of the section table."""

    id: int
    block: int
    size: int
    checksum: int
    flags: int = 0

    @classmethod
    def of(cls, section: Section) -> Listed:
        """The entry of a section."""
        flags = _OPTIONAL_FLAG if section.optional else 0
        return cls(section.id, section.block, len(section.data), crc32c(section.data), flags)


def file_head(header: Header, table: Sequence[Listed]) -> bytes:
    """The start of a file, up to its first section; the table is in the order of the sections."""
    has_levels = any(entry.id == SectionId.LEVEL for entry in table)
    minor = MINOR_LEVELS if has_levels and header.version == 1 else MINOR
    head = bytearray(struct.pack(_START, MAGIC, header.version, minor, head_size(len(table))))
    head += pack_header(header) + struct.pack("<I", len(table))
    for entry in table:
        head += struct.pack(_ENTRY, entry.id, entry.flags, *entry[1:4])
    return bytes(head + struct.pack("<I", crc32c(head)))


def padded_parts(section: Section) -> list[bytes | memoryview]:
    """A section's bytes, and the padding up to the start of the next section."""
    size = len(section.data)
    return [section.data, bytes(_padded(size) - size)]


def read_file(data: bytes | Readable, wanted: Wanted | None = None) -> EgsFile:
    """Parse a file and check it.

    Raises TruncatedStream, CorruptStream or UnsupportedVersion.

    Parameters
    ----------
    data : bytes
    wanted : callable, optional
        ``wanted(id, block)`` returns whether to read and check a section; by default all are. Other
        sections are not read.
    """
    view = data if isinstance(data, FileBytes) else memoryview(data)
    if len(view) >= len(MAGIC) and view[: len(MAGIC)] != MAGIC:
        found = looks_like(bytes(view[:LOOKED_AT]))
        raise CorruptStream(found or "not an .egs file (it does not begin with the EGS signature)")
    start = view[: head_size(0) - _CHECKSUM]
    reader = ByteReader(start, "header")
    _, version, _, header_size = reader.unpack(_START[1:])
    fields = reader.unpack(FIELDS)
    entries = reader.unpack("I")[0]
    if version > VERSION or version == 0:
        raise UnsupportedVersion(f"version {version} of the format, this reader knows 1 and 2")
    if header_size != (expected := head_size(entries)):
        raise CorruptStream(f"header: size {header_size}, expected {expected}")
    needed, left = expected - reader.position, len(view) - reader.position
    if left < needed:
        raise TruncatedStream(
            f"header: {counted(left, 'byte')} of section table, expected {needed:,}"
        )
    rest = view[reader.position : expected]
    listed, checksum = rest[:-_CHECKSUM], rest[-_CHECKSUM:]
    if int.from_bytes(checksum, "little") != crc32c(listed, crc32c(start)):
        raise CorruptStream("header: checksum does not match")
    header = unpack_header(*fields)
    if version != header.version:
        named = ", ".join(header.features.labels) or "none"
        raise CorruptStream(f"header: version {version} with features: {named}")
    located = _locate(expected, len(view), header, list(struct.iter_unpack(_ENTRY, listed)))
    _check_features(header.features, located)
    return EgsFile(header, view, expected, located, Sections(view, located), version).read(wanted)


def _check_features(features: Feature, table: dict[tuple[int, int], Entry]) -> None:
    """Check that the file has the sections of exactly these features."""
    found = {section for section, _ in table}
    for feature, section in _FEATURE_SECTIONS.items():
        if Feature.SEQUENCE in features and feature != Feature.SEQUENCE:
            # Its key frames have these sections.
            continue
        if (feature in features) != (section in found):
            label = " and ".join(feature.labels)
            stated = "stated" if feature in features else "not stated"
            raise CorruptStream(
                f"header: feature {label} is {stated}, unlike section '{section.label}'"
            )


def _locate(
    position: int, end: int, header: Header, table: list[tuple]
) -> dict[tuple[int, int], Entry]:
    """Check the section table of a file of `end` bytes, whose header ends at `position`."""
    expected = position + sum(_padded(entry[3]) for entry in table)
    if end != expected:
        kind = TruncatedStream if end < expected else CorruptStream
        raise kind(f"file: {counted(end, 'byte')}, expected {expected:,}")
    entries: dict[tuple[int, int], Entry] = {}
    known = set(SectionId)
    for section_id, flags, block, size, checksum in table:
        where = f"section {section_id} of block {block}"
        if flags & ~_OPTIONAL_FLAG:
            raise CorruptStream(f"{where}: a reserved flag is not 0")
        if section_id not in known and not flags & _OPTIONAL_FLAG:
            raise CorruptStream(f"{where}: unknown, and not optional")
        if section_id == SectionId.LEVEL:
            # Numbered from 1.
            blocks = len(header.level_counts) + 1 if block else 0
        elif section_id in FRAME_SECTIONS:
            blocks = MOST_FRAMES
        else:
            blocks = 1 if section_id in SCENE_SECTIONS else header.block_count
        if (section_id, block) in entries or (section_id in known and block >= blocks):
            raise CorruptStream(f"{where}: repeated, or of a block that does not exist")
        if size >= TOO_LARGE:
            raise CorruptStream(
                f"{where}: {counted(size, 'byte')}, expected fewer than {TOO_LARGE:,}"
            )
        entries[section_id, block] = Entry(position, size, checksum)
        position += _padded(size)
    _check_order([section_id for section_id, _ in entries])
    found = [block for section_id, block in entries if section_id == SectionId.LEVEL]
    if found and len(found) != len(header.level_counts):
        raise CorruptStream(
            f"header: {counted(len(found), 'level')}, expected {len(header.level_counts):,}"
        )
    return entries


def _check_order(listed: list[int]) -> None:
    """Check that descriptions come first, in their order."""
    expected = [section for section in DESCRIPTIONS if section in listed]
    if listed[: len(expected)] != expected:
        names = ", ".join(section.label for section in expected)
        raise CorruptStream(f"header: the first sections are not {names}, in this order")
