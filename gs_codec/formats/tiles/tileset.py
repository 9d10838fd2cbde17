"""The tree of tiles in a `tileset.json`, and reading the finest ones.

A viewer replaces a tile by its children when its error exceeds some pixels. In the frame of a tile,
x is east, y north and z up; the glTF in it has y up, and viewers turn it. What is read has y up.
"""

from __future__ import annotations

import json
import logging
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.egs.header import FANOUT
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.format_table import GLTF, TILES, TILESET, ZIP
from gs_codec.formats.gltf.compressed import EXTENSION, SPZ_2
from gs_codec.formats.gltf.file import numbers
from gs_codec.formats.gltf.scene import placed_scenes
from gs_codec.formats.gltf.scene import stated_size as size_of_gltf
from gs_codec.formats.limits import check_count, refusing
from gs_codec.formats.registry import scene_files
from gs_codec.formats.relative_name import relative_name
from gs_codec.formats.tiles.earth import Place, frame_at, place_of
from gs_codec.formats.tiles.implicit import MOST, Subtree, add_children
from gs_codec.formats.zip_file import opened_zip
from gs_codec.runtime.arrays import folder_on_disk
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import FileBytes, located, opened
from gs_codec.scene import Scene, join_scenes

log = logging.getLogger(__name__)

Result = TypeVar("Result")

#: Largest error of a tile, in pixels, that CesiumJS shows by default. Errors of blocks are pixel
#: sizes at which merging becomes hardly visible; so this factor makes tiles refine at that size.
_PIXELS = 16

#: Number of bytes in which a `tileset.json` names its first error.
_LOOKED_AT = 1 << 16

#: From east, north, up to the axes of glTF.
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)

#: Deviation of a rotation and of metres from whole numbers by rounding alone.
_ROUNDED = 1e-7


@dataclass(frozen=True)
class Tile:
    """A tile to write.

    Attributes
    ----------
    name : str
        Its file.
    low, high : ndarray, shape (3,)
        Corners of its box, in `TILES.system`.
    error : float
        Pixel size at which it looks like its children; 0 if it has none.
    """

    name: str
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    error: float


def describe_tiles(levels: Sequence[Sequence[Tile]], at: Place | None) -> bytes:
    """The `tileset.json` of levels, the finest first; the last has one tile.

    A tile has four consecutive ones of the next finer level as children.
    """
    nodes: list[dict[str, Any]] = []
    boxes: list[NDArray[np.float64]] = []
    for tiles in levels:
        some = [slice(FANOUT * k, FANOUT * (k + 1)) for k in range(len(tiles))]
        found = [_node(one, boxes[own], nodes[own]) for one, own in zip(tiles, some, strict=True)]
        nodes, boxes = [node for node, _ in found], [box for _, box in found]
    [root], [box] = nodes, boxes
    if at is not None:
        root["transform"] = frame_at(at).T.ravel().tolist()
    used = {"extensionsUsed": [EXTENSION, SPZ_2], "extensionsRequired": [EXTENSION, SPZ_2]}
    described = {
        "asset": {"version": "1.1"},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": {"3DTILES_content_gltf": used},
        "geometricError": float(max(np.linalg.norm(box[1] - box[0]), root["geometricError"])),
        "root": root | {"refine": "REPLACE"},
    }
    return json.dumps(described, separators=(",", ":")).encode()


def _node(
    tile: Tile, boxes: Sequence[NDArray[np.float64]], children: list[dict[str, Any]]
) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """A tile in JSON, and its box, which encloses those of its children."""
    low = np.min([tile.low, *(box[0] for box in boxes)], axis=0)
    high = np.max([tile.high, *(box[1] for box in boxes)], axis=0)
    x, y, z = (0.5 * (low + high)).tolist()
    width, height, depth = (0.5 * (high - low)).tolist()
    box = [x, -z, y, width, 0, 0, 0, depth, 0, 0, 0, height]
    node: dict[str, Any] = {
        "boundingVolume": {"box": box},
        "geometricError": _PIXELS * tile.error,
        "content": {"uri": tile.name},
    }
    return node | ({"children": children} if children else {}), np.array([low, high])


def is_tileset(path: Path, data: FileBytes) -> bool:
    """Whether a JSON file looks like a tileset, or a zip has one in its first folder (`.3tz`).

    Raises InvalidInput if it is a zip that is not valid.
    """
    if data[: len(ZIP)] == ZIP:
        with located(path), opened_zip(path) as archive:
            return TILESET in archive.names
    begin = bytes(data[:_LOOKED_AT])
    return path.name.lower() == TILESET or b'"geometricError"' in begin


class _Content(NamedTuple):
    """A glTF, and the matrix ``(4, 4)`` of its tile."""

    name: str
    matrix: NDArray[np.float64]


class _Tileset:
    """A tileset and the tilesets in it, in files of one folder."""

    def __init__(self, path: Path, data: memoryview) -> None:
        self._folder, self._name = path.parent, path.name
        self._seen = {path.name}
        #: Bytes of the JSON files and of the subtrees.
        self._described = len(data)
        self._implicit = 0
        self._root = self._explicit(path.name, _root_of(data))

    def stored_bytes(self, contents: Sequence[_Content]) -> int:
        """Size of the tilesets and of contents."""
        stored = self._described
        for each in contents:
            with opened(self._folder / each.name) as file:
                stored += len(file)
        return stored

    def files_beside(self) -> list[Path]:
        """The files of `contents`, and of the tilesets in this one."""
        found = [self._folder / name for name in sorted(self._seen - {self._name})]
        texts = [path for path in found if path.suffix.lower() == ".gltf"]
        return found + [beside for path in texts for beside in scene_files(path)[1:]]

    def read(self, content: _Content, reader: Callable[[Path, memoryview, Path], Result]) -> Result:
        """What a function reads from the name and bytes of a content, and its folder."""
        path = self._folder / content.name
        with opened(path) as file:
            return reader(Path(content.name), file[:], path.parent)

    def contents(self, level: int | None = 0) -> list[_Content]:
        """Contents of the tiles of a level, 0 for the finest, or of all; every file once.

        Raises InvalidInput if there are none.
        """
        most = _heights(self._root)[id(self._root)]
        if level is not None and not 0 <= level <= most:
            raise InvalidInput(f"level {level}: the tileset has levels 0 to {most}")
        found = [*self._contents(level)]
        if not found:
            raise InvalidInput("tileset: no tile with content")
        return found

    def _contents(self, level: int | None) -> Iterator[_Content]:
        left = [("", self._root, np.eye(4), "")]
        heights, roots = _heights(self._root), []
        while left:
            base, tile, above, refine = left.pop()
            refine = str(tile.get("refine", refine)).upper()
            matrix = above @ _transform(tile)
            children, contents = _objects(tile, "children"), _contents(tile)
            if level is None or heights[id(tile)] > level or not contents:
                left += [(base, child, matrix, refine) for child in reversed(children)]
                if children and level is not None and refine != "ADD":
                    continue
            for content in contents:
                found = self._file(base, _uri_of(content))
                if found.lower().endswith(".json"):
                    roots.append(self._root_in(found))  # kept, so that every `id` stays its own
                    heights |= _heights(roots[-1])
                    left.append((found, roots[-1], matrix, refine))
                else:
                    yield _Content(found, matrix)

    def _root_in(self, name: str) -> dict[str, Any]:
        """The root tile in a file."""
        with located(name), opened(self._folder / name) as data:
            self._described += len(data)
            return self._explicit(name, _root_of(data[:]))

    def _explicit(self, base: str, root: dict[str, Any]) -> dict[str, Any]:
        """A root tile whose implicit tiles have been replaced by explicit ones."""
        tiles = [root]
        for tile in tiles:
            if "implicitTiling" in tile:
                uris = [_uri_of(content) for content in _contents(tile)]
                read, most = partial(self._subtree, base), MOST - self._implicit
                self._implicit += add_children(tile, uris, most, read)
            else:
                tiles += _objects(tile, "children")
        return root

    def _subtree(self, base: str, uri: Any) -> Subtree:
        """The file of a subtree."""
        name = str(PurePosixPath(base).parent / relative_name(uri, "subtrees", quoted=True))
        if name in self._seen:
            raise InvalidInput(f"subtree {name!a:.60} belongs to several tiles, expected one")
        path = self._folder / name
        with located(name), opened(path) as data:
            self._described += len(data)
            subtree = Subtree(path.parent, name, data[:])
        files = [path, *subtree.buffers]
        self._seen |= {file.relative_to(self._folder).as_posix() for file in files}
        return subtree

    def _file(self, base: str, uri: Any) -> str:
        """Name of a content in the folder; rejects other formats, and files used twice."""
        name = relative_name(uri, "content", quoted=True)
        if not name.lower().endswith((*GLTF.read, ".json")):
            raise InvalidInput(f"content {name!a:.60} is not read, expected .glb, .gltf or .json")
        name = str(PurePosixPath(base).parent / name)
        if name in self._seen:
            raise InvalidInput(f"content {name!a:.60} belongs to several tiles, expected one")
        self._seen.add(name)
        return name


@contextmanager
def _opened(path: Path, data: memoryview | FileBytes) -> Iterator[_Tileset]:
    """The tileset in a file; a zip is unpacked into a temporary folder for the block."""
    with located(path):
        if data[: len(ZIP)] != ZIP:
            yield _Tileset(path, data[:])
            return
        place = tempfile.TemporaryDirectory(prefix="gs_codec-", dir=folder_on_disk())
        with place as folder, opened_zip(path) as archive:
            for name in archive.names:
                unpacked = Path(folder, relative_name(name, "zip"))
                with refusing(f"zip entry {name!a:.60}"):
                    unpacked.parent.mkdir(parents=True, exist_ok=True)
                    unpacked.write_bytes(archive.read(name, archive.size(name)))
            try:
                with opened(Path(folder, TILESET)) as tileset:
                    yield _Tileset(Path(folder, TILESET), tileset[:])
            except GsCodecError as error:
                raise type(error)(str(error).replace(folder + os.sep, "")) from error


def _root_of(data: memoryview) -> dict[str, Any]:
    with refusing("tileset"):
        document = parse_json(bytes(data))
    root = document.get("root") if isinstance(document, dict) else None
    if not isinstance(root, dict):
        raise InvalidInput("tileset: no root tile")
    return root


def _heights(root: dict[str, Any]) -> dict[int, int]:
    """Number of levels below each tile of a file, by the tile's `id`."""
    tiles, heights = [root], dict[int, int]()
    for tile in tiles:
        tiles += _objects(tile, "children")
    for tile in reversed(tiles):
        heights[id(tile)] = max((heights[id(x)] + 1 for x in _objects(tile, "children")), default=0)
    return heights


def _objects(tile: dict[str, Any], name: str) -> list[dict[str, Any]]:
    found = tile.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InvalidInput(f"tileset: {name} is not a list of objects")
    return found


def _contents(tile: dict[str, Any]) -> list[dict[str, Any]]:
    one = tile.get("content")
    found = _objects(tile, "contents") if one is None else [one]
    if not all(isinstance(each, dict) for each in found):
        raise InvalidInput(f"tileset: content {one!a:.40}, expected an object")
    return found


def _uri_of(content: dict[str, Any]) -> Any:
    return content.get("uri", content.get("url"))


def _transform(tile: dict[str, Any]) -> NDArray[np.float64]:
    """The matrix ``(4, 4)`` of a tile."""
    if "transform" not in tile:
        return np.eye(4)
    return np.array(numbers(tile["transform"], 16, "tile.transform")).reshape(4, 4).T


def read_tiles(path: Path, data: FileBytes, max_bytes: int | None, level: int = 0) -> Scene:
    """Read the tiles of a level of a tileset, 0 for the finest; see `SceneFile.scene`.

    If it is on the earth, axes are those at its first tile, and the place is left out.
    """
    with _opened(path, data) as tileset:
        contents = tileset.contents(level)
        stated = _stated(tileset, contents)
        check_count(*stated, tileset.stored_bytes(contents), max_bytes)
        inverse = _from_earth(path, contents[0].matrix)
        scenes = [
            scene
            for each in contents
            for scene in _scenes(tileset, each, max_bytes, inverse @ each.matrix)
        ]
    if len({scene.antialiased for scene in scenes}) > 1:
        log.warning("%s: only some tiles are antialiased; all are read like the first", path)
    return join_scenes(scenes)


def _scenes(
    tileset: _Tileset, content: _Content, max_bytes: int | None, place: NDArray[np.float64]
) -> list[Scene]:
    """The scenes of a content in the frame of a matrix from that of its tile."""
    with np.errstate(over="ignore", invalid="ignore"):  # rejected when the scene is placed
        matrix = _Y_UP @ place @ _Y_UP.T
        whole = np.round(matrix)
        matrix = whole if np.abs(matrix - whole).max() < _ROUNDED else matrix
    return tileset.read(
        content,
        lambda name, view, folder: placed_scenes(
            name, view, max_bytes, folder, matrix, TILES.system
        ),
    )


def _stated(tileset: _Tileset, contents: Sequence[_Content]) -> tuple[int, int]:
    """Number of Gaussians and largest SH degree in the headers of contents."""
    sizes = [tileset.read(each, size_of_gltf) for each in contents]
    counts, degrees = zip(*sizes, strict=True)
    return sum(counts), max(degrees)


def _from_earth(path: Path, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix that moves a tile on the earth to the origin; the identity for others."""
    place = place_of(matrix[:3, 3])
    if place is None:
        return np.eye(4)
    log.warning("%s: left out: its place on the earth, %.7f,%.7f,%.3f", path, *place)
    return np.asarray(np.linalg.inv(frame_at(place)), np.float64)


def check_all(path: Path, data: memoryview, max_bytes: int | None) -> None:
    """Read all tiles; raises like `read_tiles`."""
    with _opened(path, data) as tileset:
        for each in tileset.contents(level=None):
            _scenes(tileset, each, max_bytes, np.eye(4))


def files_beside(path: Path, data: FileBytes) -> list[Path]:
    """The tilesets in a tileset, and all tiles; a zip has none."""
    if data[: len(ZIP)] == ZIP:
        return []
    with _opened(path, data) as tileset:
        tileset.contents(level=None)
        return tileset.files_beside()


def stated_size(path: Path, data: FileBytes) -> tuple[int, int]:
    """Number of Gaussians of the finest tiles, and their largest SH degree."""
    with _opened(path, data) as tileset:
        return _stated(tileset, tileset.contents())
