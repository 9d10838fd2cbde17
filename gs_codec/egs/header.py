"""The scene's fields in the header of an `.egs` file. FORMAT.md, section "File"."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from enum import IntFlag

from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS, Config
from gs_codec.errors import CorruptStream, UnsupportedVersion
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS, Scene, float_bytes

MAX_BLOCK_SIZE = 1 << 16

#: Fan-out: one block, or Gaussian, replaces this many of the next finer level.
FANOUT = 4

#: Layout of the fields, from the number of Gaussians to the size of a block.
FIELDS = "QIHBBB3sI"

_NORMALS_FLAG = 1
_ORDER_FLAG = 2
_ANTIALIASED_FLAG = 4

#: 64-bit integers must be below this, so that a float64 represents them exactly.
TOO_LARGE = 1 << 53

#: Profile numbers in the header.
PROFILE_NAMES = ("paper-l", "paper-m", "paper-s", "l", "m", "s", LOSSLESS)

#: Directions of an axis, in the order of their numbers: right, left, up, down, back, forward.
_DIRECTIONS = "RLUDBF"


class Feature(IntFlag):
    """Features that a reader must support besides the profile itself."""

    NONE = 0
    GPCC = 1
    TORCHAC = 2
    FAR = 4
    LOCAL_BASIS = 8
    SEQUENCE = 16

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the features."""
        return tuple(label for feature, label in _FEATURE_LABELS.items() if feature in self)


_FEATURE_LABELS = {
    Feature.GPCC: "G-PCC",
    Feature.TORCHAC: "torchac",
    Feature.FAR: "far Gaussians",
    Feature.LOCAL_BASIS: "local SH basis",
    Feature.SEQUENCE: "sequence",
}

#: Files with this or a later feature are version 2.
_FIRST_OF_VERSION_2 = Feature.FAR


@dataclass(frozen=True)
class Header:
    """What the header states about a scene.

    ``coordinates`` and ``antialiased`` are as in `Scene`.
    """

    count: int
    sh_degree: int
    profile: str
    block_size: int
    has_normals: bool = False
    keeps_order: bool = False
    antialiased: bool = False
    coordinates: str | None = None
    features: Feature = Feature.NONE

    @classmethod
    def of(cls, scene: Scene, config: Config, count: int | None = None) -> Header:
        """The header of a scene, with the fewest blocks that `config` allows, filled evenly.

        `count` overrides the number of Gaussians of `scene`, which may then be empty.
        """
        count = scene.count if count is None else count
        blocks = max(-(-count // config.block_size), 1)
        size = max(-(-count // blocks), 1)
        return cls(
            count,
            scene.sh_degree,
            config.profile,
            size,
            scene.has_normals,
            config.keep_order,
            scene.antialiased,
            scene.coordinates,
        )

    @property
    def version(self) -> int:
        """Format version of a file with these features."""
        return 2 if self.features >= _FIRST_OF_VERSION_2 else 1

    def having(self, feature: Feature, has: bool) -> Header:
        """The header with a feature, or without it."""
        return replace(self, features=self.features & ~feature | feature * has)

    @property
    def block_count(self) -> int:
        """Number of independently decodable blocks."""
        return -(-self.count // self.block_size)

    @property
    def level_counts(self) -> list[int]:
        """Number of Gaussians of levels 1, 2, ..., if the file has levels."""
        counts = []
        count = self.count
        while count > self.block_size:
            count = -(-count // FANOUT)
            counts.append(count)
        return counts

    @property
    def float_bytes(self) -> int:
        """Size of the decoded float32 attributes."""
        return float_bytes(self.count, self.sh_degree)

    def block_range(self, block: int) -> tuple[int, int]:
        """First Gaussian of a block and the one after its last."""
        start = block * self.block_size
        return start, min(start + self.block_size, self.count)


def pack_header(header: Header) -> bytes:
    """Serialise the fields."""
    flags = _NORMALS_FLAG * header.has_normals | _ORDER_FLAG * header.keeps_order
    return struct.pack(
        "<" + FIELDS,
        header.count,
        header.features,
        flags | _ANTIALIASED_FLAG * header.antialiased,
        _coordinates_number(header.coordinates),
        PROFILE_NAMES.index(header.profile),
        header.sh_degree,
        bytes(3),
        header.block_size,
    )


def _coordinates_number(system: str | None) -> int:
    """Number of a coordinate system in the header; 0 if unknown."""
    if system is None:
        return 0
    x, y, z = map(_DIRECTIONS.index, system)
    return 1 + 36 * x + 6 * y + z


#: Coordinate systems by their number in the header: those with x to the right or left.
_SYSTEMS = {
    _coordinates_number(x + first + second): x + first + second
    for x in "RL"
    for first, second in ("UB", "UF", "DB", "DF", "BU", "FU", "BD", "FD")
}


def unpack_header(
    count: int,
    features: int,
    flags: int,
    coordinates: int,
    profile: int,
    degree: int,
    reserved: bytes,
    block_size: int,
) -> Header:
    """The inverse of `pack_header`. Raises CorruptStream or UnsupportedVersion."""
    if unknown := features & ~sum(Feature):
        raise UnsupportedVersion(
            f"header: needs features {_named_bits(unknown)}, this reader knows "
            f"{_named_bits(sum(Feature))}"
        )
    exact = profile == PROFILE_NAMES.index(LOSSLESS)
    known = _NORMALS_FLAG | _ORDER_FLAG * exact | _ANTIALIASED_FLAG
    if flags & ~known or any(reserved) or profile >= len(PROFILE_NAMES):
        raise CorruptStream("header: a reserved field is not 0")
    if degree >= len(SH_COEFFICIENTS) or not 1 <= block_size <= MAX_BLOCK_SIZE:
        raise CorruptStream(f"header: SH degree {degree}, block size {block_size} out of range")
    needless = Feature.NONE if degree else Feature.LOCAL_BASIS
    if PROFILE_NAMES[profile] not in ADAPTIVE_PROFILES:
        needless = Feature.FAR | Feature.LOCAL_BASIS | Feature.SEQUENCE
    if wrong := Feature(features) & needless:
        what = f"profile {PROFILE_NAMES[profile]} of SH degree {degree}"
        raise CorruptStream(f"header: {' and '.join(wrong.labels)} with {what}")
    if coordinates and coordinates not in _SYSTEMS:
        raise CorruptStream(f"header: coordinates {coordinates} are no system")
    if count >= TOO_LARGE:
        raise CorruptStream(
            f"header: {counted(count, 'Gaussian')}, expected fewer than {TOO_LARGE:,}"
        )
    return Header(
        count,
        degree,
        PROFILE_NAMES[profile],
        block_size,
        bool(flags & _NORMALS_FLAG),
        bool(flags & _ORDER_FLAG),
        bool(flags & _ANTIALIASED_FLAG),
        _SYSTEMS.get(coordinates),
        Feature(features),
    )


def _named_bits(features: int) -> str:
    """Numbers of feature bits, with their names if known."""
    names = {feature.bit_length() - 1: label for feature, label in _FEATURE_LABELS.items()}
    bits = [bit for bit in range(32) if features >> bit & 1]
    return ", ".join(f"{bit} ({names[bit]})" if bit in names else str(bit) for bit in bits)
