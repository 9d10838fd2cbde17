"""Header and section table of an `.egs` file. FORMAT.md, sections "File" and "Sections"."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple, TypeVar

from crc32c import crc32c

from gs_codec.coding.fields import ByteReader
from gs_codec.config import LOSSLESS, Config
from gs_codec.errors import CorruptStream, TruncatedStream, UnsupportedVersion
from gs_codec.runtime.arrays import current
from gs_codec.scene import SH_COEFFICIENTS, Scene, float_bytes

Parsed = TypeVar("Parsed")

MAGIC = b"\x89EGS\r\n\x1a\n"
VERSION = 1
MAX_BLOCK_SIZE = 1 << 16
_FIXED = "<8sHHIQBBHII"
_ENTRY = "<HHIQI"
_NORMALS_FLAG = 1
_ORDER_FLAG = 2
_OPTIONAL_FLAG = 1


class SectionId(IntEnum):
    """What a section holds."""

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
    BOUNDS = 16
    BOX = 17
    GPCC = 18
    TOOL = 19
    CODER = 20

    @property
    def label(self) -> str:
        """Name in messages and reports; for a section of a stream, the stream's name."""
        return self.name.lower().replace("_", "-")

    @classmethod
    def of_stream(cls, stream: str) -> SectionId:
        """The section of a stream."""
        return cls[stream.upper().replace("-", "_")]


#: Sections that say how the others are coded.
DESCRIPTIONS = frozenset(
    {
        SectionId.CHANNELS,
        SectionId.LATTICE,
        SectionId.BOUNDS,
        SectionId.BOX,
        SectionId.TOOL,
        SectionId.CODER,
    }
)

#: Sections of the whole scene; the others are of a block.
SCENE_SECTIONS = DESCRIPTIONS | {SectionId.COMMENTS, SectionId.EXTRA}

#: ``wanted(id, block)`` tells whether to read a section.
Wanted = Callable[[int, int], bool]


@dataclass(frozen=True)
class Header:
    """What the header states about a scene."""

    count: int
    sh_degree: int
    profile: str
    block_size: int
    has_normals: bool = False
    keeps_order: bool = False

    @classmethod
    def of(cls, scene: Scene, config: Config) -> Header:
        """The header of a scene in the fewest blocks that `config` allows, filled evenly."""
        blocks = max(-(-scene.count // config.block_size), 1)
        size = max(-(-scene.count // blocks), 1)
        normals, keeps_order = scene.has_normals, config.keep_order
        return cls(scene.count, scene.sh_degree, config.profile, size, normals, keeps_order)

    @property
    def block_count(self) -> int:
        """Number of independently decodable blocks."""
        return -(-self.count // self.block_size)

    @property
    def float_bytes(self) -> int:
        """Size of the decoded float32 attributes."""
        return float_bytes(self.count, self.sh_degree)

    def block_range(self, block: int) -> tuple[int, int]:
        """First Gaussian of a block and the one after its last."""
        start = block * self.block_size
        return start, min(start + self.block_size, self.count)


@dataclass(frozen=True)
class Section:
    """Bytes of one section; `block` is 0 for those of the whole scene."""

    id: SectionId
    block: int
    data: bytes | memoryview
    optional: bool = False

    @classmethod
    def kept(cls, section_id: SectionId, block: int, data: bytes) -> Section:
        """A section with its bytes in the storage in use, memory or disk."""
        return cls(section_id, block, current().keep_bytes(data))


class Entry(NamedTuple):
    """Position, size and checksum of a section."""

    position: int
    size: int
    checksum: int


@dataclass(frozen=True)
class EgsFile:
    """A file with its checked header and those of its sections that were read and checked."""

    header: Header
    data: memoryview
    header_size: int
    table: dict[tuple[int, int], Entry]
    sections: dict[tuple[int, int], memoryview]
    version: int
    _parsed: dict[SectionId, Any] = field(default_factory=dict, repr=False)

    def parsed(self, section_id: SectionId, parse: Callable[[memoryview], Parsed]) -> Parsed:
        """A parsed section of the whole scene; it is parsed only once."""
        if section_id not in self._parsed:
            self._parsed[section_id] = parse(self.section(section_id))
        return self._parsed[section_id]

    @property
    def sizes(self) -> dict[tuple[int, int], int]:
        """Bytes of each section, read or not."""
        return {key: entry.size for key, entry in self.table.items()}

    @property
    def bytes_read(self) -> int:
        """Size of the header and of the sections that were read."""
        return self.header_size + sum(len(content) for content in self.sections.values())

    def section(self, section_id: SectionId, block: int = 0) -> memoryview:
        """Bytes of a section; it is an error if it is missing."""
        try:
            return self.sections[section_id, block]
        except KeyError:
            raise CorruptStream(f"section '{section_id.label}' of block {block}: missing") from None

    def read(self, wanted: Wanted | None = None) -> EgsFile:
        """The file with further sections read; see `read_file`."""
        sections = dict(self.sections)
        known = set(SectionId)
        for (section_id, block), (position, size, checksum) in self.table.items():
            key = section_id, block
            if key in sections or not (wanted is None or wanted(*key)):
                continue
            content = self.data[position : position + size]
            if crc32c(content) != checksum:
                where = f"section {section_id} of block {block}"
                raise CorruptStream(f"{where}: checksum does not match")
            if section_id in known:
                sections[key] = content
        return replace(self, sections=sections)


#: Profile numbers in the header.
PROFILE_NAMES = ("paper-l", "paper-m", "paper-s", "l", "m", "s", LOSSLESS)


def section_sizes(sections: Sequence[Section]) -> dict[str, int]:
    """Bytes of a file by section; ``header`` includes the section table."""
    sizes = Counter({"header": _header_size(len(sections))})
    for section in sections:
        sizes[section.id.label] += len(section.data)
    return dict(sizes)


def _header_size(sections: int) -> int:
    return struct.calcsize(_FIXED) + sections * struct.calcsize(_ENTRY) + 4


def write_file(header: Header, sections: Iterable[Section]) -> bytes:
    """Assemble a file; sections are stored in the order given."""
    return b"".join(file_parts(header, list(sections)))


def file_parts(header: Header, sections: Sequence[Section]) -> list[bytes | memoryview]:
    """The consecutive pieces of a file: its header, then its sections in the order given."""
    header_size = _header_size(len(sections))
    head = bytearray()
    head += struct.pack(
        _FIXED,
        MAGIC,
        VERSION,
        _NORMALS_FLAG * header.has_normals | _ORDER_FLAG * header.keeps_order,
        header_size,
        header.count,
        header.sh_degree,
        PROFILE_NAMES.index(header.profile),
        0,
        header.block_size,
        len(sections),
    )
    for section in sections:
        flags = _OPTIONAL_FLAG if section.optional else 0
        size, checksum = len(section.data), crc32c(section.data)
        head += struct.pack(_ENTRY, section.id, flags, section.block, size, checksum)
    head += struct.pack("<I", crc32c(head))
    return [bytes(head), *(section.data for section in sections)]


def read_file(data: bytes | memoryview, wanted: Wanted | None = None) -> EgsFile:
    """Parse a file and check it.

    Parameters
    ----------
    data : bytes
    wanted : callable, optional
        ``wanted(id, block)`` tells whether to read and check a section; by default all are. The
        others are not touched.

    Raises
    ------
    TruncatedStream, CorruptStream, UnsupportedVersion
    """
    view = memoryview(data)
    if len(view) >= len(MAGIC) and view[: len(MAGIC)] != MAGIC:
        raise CorruptStream("not an .egs file (it does not begin with the EGS signature)")
    reader = ByteReader(view, "header")
    _, version, flags, header_size, count, degree, profile, reserved, block_size, entries = (
        reader.unpack(_FIXED[1:])
    )
    if version > VERSION or version == 0:
        raise UnsupportedVersion(f"version {version} of the format, this reader knows 1")
    expected = reader.position + entries * struct.calcsize(_ENTRY) + 4
    if header_size != expected:
        raise CorruptStream(f"header: size {header_size}, expected {expected}")
    needed, left = expected - reader.position, len(view) - reader.position
    if left < needed:
        raise TruncatedStream(f"header: {left} bytes of section table, expected {needed}")
    table = [reader.unpack(_ENTRY[1:]) for _ in range(entries)]
    checksum = crc32c(view[: reader.position])
    if reader.unpack("I")[0] != checksum:
        raise CorruptStream("header: checksum does not match")
    exact = profile == PROFILE_NAMES.index(LOSSLESS)
    known = _NORMALS_FLAG | _ORDER_FLAG * exact
    if flags & ~known or reserved or profile >= len(PROFILE_NAMES):
        raise CorruptStream("header: a reserved field is not 0")
    if degree >= len(SH_COEFFICIENTS) or not 1 <= block_size <= MAX_BLOCK_SIZE:
        raise CorruptStream(f"header: SH degree {degree}, block size {block_size} out of range")
    normals, ordered = bool(flags & _NORMALS_FLAG), bool(flags & _ORDER_FLAG)
    header = Header(count, degree, PROFILE_NAMES[profile], block_size, normals, ordered)
    entries = _locate(reader.position, len(view), header, table)
    return EgsFile(header, view, reader.position, entries, {}, version).read(wanted)


def _locate(
    position: int, end: int, header: Header, table: list[tuple]
) -> dict[tuple[int, int], Entry]:
    """The checked section table of a file of `end` bytes, whose header ends at `position`."""
    expected = position + sum(entry[3] for entry in table)
    if end != expected:
        kind = TruncatedStream if end < expected else CorruptStream
        raise kind(f"file: {end} bytes, expected {expected}")
    entries: dict[tuple[int, int], Entry] = {}
    known = set(SectionId)
    for section_id, flags, block, size, checksum in table:
        where = f"section {section_id} of block {block}"
        if flags & ~_OPTIONAL_FLAG:
            raise CorruptStream(f"{where}: a reserved flag is not 0")
        if section_id not in known and not flags & _OPTIONAL_FLAG:
            raise CorruptStream(f"{where}: unknown, and not optional")
        blocks = 1 if section_id in SCENE_SECTIONS else header.block_count
        if (section_id, block) in entries or (section_id in known and block >= blocks):
            raise CorruptStream(f"{where}: repeated, or of a block that does not exist")
        entries[section_id, block] = Entry(position, size, checksum)
        position += size
    return entries
