"""Implicit tiling of 3D Tiles 1.1: one tile stands for a quadtree or octree of tiles.

Names of files contain the place of a tile in the tree. Subtree files say which tiles exist: a bit
for each tile, level by level, and in Morton order within a level.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from gs_codec.errors import InvalidInput
from gs_codec.formats.gltf.file import GltfFile
from gs_codec.formats.limits import refusing
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.wording import counted

#: Maximum number of tiles in the trees of a tileset.
MOST = 1 << 18

#: Maximum number of levels of a tree; Cesium ion writes about 20.
_LEVELS = 64

#: Number of axes along which a tile is divided.
_AXES = {"QUADTREE": 2, "OCTREE": 3}

#: Header of a binary subtree file: magic number, version, bytes of JSON, bytes of its buffer.
_HEADER = struct.Struct("<4sIQQ")
_MAGIC = b"subt"


class _Bits(NamedTuple):
    """A bit for each tile, or the same for all."""

    where: str
    stored: memoryview | None
    constant: bool

    def at(self, index: int) -> bool:
        if self.stored is None:
            return self.constant
        if index >= 8 * len(self.stored):
            known = counted(8 * len(self.stored), "bit")
            raise InvalidInput(f"{self.where}: {known}, no bit {index:,}")
        return bool(self.stored[index // 8] >> index % 8 & 1)


class Subtree:
    """A subtree file.

    Attributes
    ----------
    buffers : list of Path
        Other files with its bits.
    tiles, below : _Bits
        Which of its tiles exist, and which subtrees below its last level.
    contents : list of _Bits
        For each content of a tile, which of its tiles have it.
    """

    def __init__(self, folder: Path, name: str, data: memoryview) -> None:
        text, binary = _parts(data) if data[:4] == _MAGIC else (data, None)
        with refusing("subtree"):
            document = parse_json(bytes(text))
        if not isinstance(document, dict):
            raise InvalidInput("subtree: not an object")
        # Its buffers are described as in a glTF.
        self._name, self._file = name, GltfFile(folder, document, binary)
        self.buffers = self._file.files_beside()
        self.tiles = self._bits(document.get("tileAvailability"))
        self.below = self._bits(document.get("childSubtreeAvailability"))
        self.contents = [self._bits(each) for each in self._file.items("contentAvailability")]

    def _bits(self, stated: Any) -> _Bits:
        if not isinstance(stated, dict) or not {"bitstream", "constant"} & stated.keys():
            raise InvalidInput(f"subtree: availability {stated!a:.40}, expected bits or a constant")
        if "bitstream" not in stated:
            return _Bits(self._name, None, stated["constant"] == 1)
        return _Bits(self._name, self._file.bytes_of(stated["bitstream"], "availability"), False)


def _parts(data: memoryview) -> tuple[memoryview, memoryview]:
    """The JSON and the buffer of a binary subtree file."""
    if len(data) >= _HEADER.size:
        _, version, text, binary = _HEADER.unpack_from(data)
        if version == 1 and _HEADER.size + text + binary <= len(data):
            parts = data[_HEADER.size :]
            return parts[:text], parts[text : text + binary]
    raise InvalidInput("subtree: truncated, or not of version 1")


class _Node(NamedTuple):
    """A tile of a tree; `inner` and `code` are its level and Morton code in its subtree."""

    made: dict[str, Any]
    level: int
    place: tuple[int, ...]
    #: None for the first tile of a subtree.
    subtree: Subtree | None
    inner: int
    code: int


def add_children(
    tile: dict[str, Any], uris: list[Any], most: int, subtree_at: Callable[[str], Subtree]
) -> int:
    """Give an implicit tile the contents and children of its tree; return the number of tiles.

    `uris` are those of its contents, with the place of a tile left open. Raises InvalidInput if
    there are more tiles than `most`. `subtree_at` opens a file.
    """
    axes, levels, depth, name = _stated(tile.pop("implicitTiling"))
    tile.pop("content", None)
    left, count = [_Node(tile, 0, (0,) * axes, None, 0, 0)], 1
    while left:
        made, level, place, subtree, inner, code = left.pop()
        if subtree is None:
            subtree = subtree_at(_filled(name, level, place))
        bit = _before(axes, inner) + code
        named = zip(uris, subtree.contents, strict=False)
        made["contents"] = [
            {"uri": _filled(uri, level, place)} for uri, bits in named if bits.at(bit)
        ]
        last = inner + 1 == levels
        bits, first = (subtree.below, 0) if last else (subtree.tiles, _before(axes, inner + 1))
        children = []
        for each in range(code << axes, code + 1 << axes) if level + 1 < depth else ():
            if bits.at(first + each):
                half = tuple(2 * at + (each >> axis & 1) for axis, at in enumerate(place))
                child = _Node({}, level + 1, half, subtree, inner + 1, each)
                children.append(child._replace(subtree=None, inner=0, code=0) if last else child)
        made["children"] = [each.made for each in children]
        left += children
        count += len(children)
        if count > most:
            raise InvalidInput(f"tileset: more than {most:,} implicit tiles")
    return count


def _before(axes: int, level: int) -> int:
    """Number of tiles above a level of a whole tree."""
    return ((1 << axes * level) - 1) // ((1 << axes) - 1)


def _stated(tiling: Any) -> tuple[int, int, int, Any]:
    """Number of axes, levels of a subtree and of the tree, and the name of subtrees."""
    known: dict[str, Any] = tiling if isinstance(tiling, dict) else {}
    axes = _AXES.get(str(known.get("subdivisionScheme")), 0)
    levels, depth = known.get("subtreeLevels", 0), known.get("availableLevels", 0)
    subtrees, some = known.get("subtrees"), range(1, _LEVELS + 1)
    if not (axes and levels in some and depth in some and isinstance(subtrees, dict)):
        raise InvalidInput(f"tileset: implicitTiling {tiling!a:.200} is not read")
    return axes, int(levels), int(depth), subtrees.get("uri")


def _filled(uri: Any, level: int, place: tuple[int, ...]) -> Any:
    """A name of the file of a tile, from one with its place left open."""
    for name, value in zip(("level", "x", "y", "z"), (level, *place), strict=False):
        uri = uri.replace(f"{{{name}}}", str(value)) if isinstance(uri, str) else uri
    return uri
