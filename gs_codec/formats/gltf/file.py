"""Files of glTF 2.0: the document, its buffers, and the values of accessors."""

from __future__ import annotations

import base64
import json
import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import GLTF
from gs_codec.formats.limits import refusing
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.wording import counted

MAGIC = GLTF.signatures[0]

_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
_DATA_URI = "data:application/octet-stream;base64,"

#: WebGL constants for component types, and for the target of a buffer view.
FLOAT = 5126
UNSIGNED_BYTE = 5121
_ARRAY_BUFFER = 34962

#: Component types, and the divisor of their normalised integers.
_COMPONENTS = {
    5120: ("<i1", 127.0),
    5121: ("<u1", 255.0),
    5122: ("<i2", 32767.0),
    5123: ("<u2", 65535.0),
    5126: ("<f4", 1.0),
}
_INDICES = {kind: _COMPONENTS[kind] for kind in (5121, 5123)} | {5125: ("<u4", 1.0)}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

#: Compressions of a buffer view.
_COMPRESSED = ("EXT_meshopt_compression", "KHR_meshopt_compression")


@dataclass(frozen=True)
class GltfFile:
    """An opened file.

    Attributes
    ----------
    folder : Path
        Its folder, which separate buffers are in, too.
    document : dict
        Its JSON.
    binary : memoryview or None
        The embedded buffer of a `.glb`.
    """

    folder: Path
    document: dict[str, Any]
    binary: memoryview | None
    _lists: dict[str, list[dict[str, Any]]] = field(default_factory=dict, init=False)
    _loaded: dict[int, memoryview] = field(default_factory=dict, init=False)

    def items(self, name: str) -> list[dict[str, Any]]:
        """A list of objects of the document; empty if it is absent."""
        if name not in self._lists:
            found = self.document.get(name, [])
            if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
                raise InvalidInput(f"glTF: {name} is not a list of objects")
            self._lists[name] = found
        return self._lists[name]

    def item(self, name: str, index: Any) -> dict[str, Any]:
        """An object from a list of the document."""
        found = self.items(name)
        if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(found):
            raise InvalidInput(f"glTF: {name} {index!a:.20}, expected one of {len(found)}")
        return found[index]

    def count(self, accessor: Any) -> int:
        """Number of elements of an accessor."""
        return whole(self.item("accessors", accessor).get("count"), "accessor.count")

    def values(self, accessor: Any, kind: str, where: str) -> NDArray[np.float32]:
        """Values ``(count, components)`` of an accessor of type `kind`, normalised if it states so.

        Raises InvalidInput if it is of another type, sparse, or outside its buffer.
        """
        rows, divisor = self._rows(accessor, kind, where, _COMPONENTS)
        with np.errstate(invalid="ignore"):
            plain = rows.astype(np.float32)
        normalised = self.item("accessors", accessor).get("normalized") is True
        return plain / np.float32(divisor) if normalised else plain

    def indices(self, accessor: Any, most: int) -> NDArray[np.int64]:
        """Indices ``(n,)`` of an accessor; raises like `values`, or if one is not below `most`."""
        rows, _ = self._rows(accessor, "SCALAR", "indices", _INDICES)
        index = rows[:, 0].astype(np.int64)
        if index.size and index.max() >= most:
            raise InvalidInput(f"glTF: index {index.max():,} of {counted(most, 'Gaussian')}")
        return index

    def _rows(
        self, accessor: Any, kind: str, where: str, components: dict[int, tuple[str, float]]
    ) -> tuple[NDArray, float]:
        """Numbers ``(count, components)`` as stored, and the divisor of normalised ones."""
        known = self.item("accessors", accessor)
        component = known.get("componentType")
        packed = components.get(component) if isinstance(component, int) else None
        if known.get("type") != kind or packed is None or "sparse" in known:
            found = f"{known.get('type')!a:.20} of {component!a:.20}"
            raise InvalidInput(f"glTF: {where} is {found}, expected {kind} of numbers, not sparse")
        code, divisor = packed
        width, size = _WIDTHS[kind], np.dtype(code).itemsize
        view = self.item("bufferViews", known.get("bufferView"))
        data, first, length = self._span(view)
        offset = whole(known.get("byteOffset", 0), "accessor.byteOffset")
        stride = whole(view.get("byteStride", width * size), "bufferView.byteStride")
        count = self.count(accessor)
        used = offset + stride * (count - 1) + width * size if count else 0
        if used > length or first + length > len(data) or stride < width * size:
            raise InvalidInput(f"glTF: {where}: {counted(count, 'element')} beyond the buffer")
        rows = np.ndarray((count, width), code, data, first + offset, (stride, size))
        return rows, divisor

    def bytes_of(self, index: Any, where: str) -> memoryview:
        """The bytes of a buffer view; `InvalidInput` if it is outside its buffer."""
        data, first, length = self._span(self.item("bufferViews", index))
        if first + length > len(data):
            raise InvalidInput(f"glTF: {where}: {counted(length, 'byte')} beyond the buffer")
        return data[first : first + length]

    def _span(self, view: dict[str, Any]) -> tuple[memoryview, int, int]:
        """Buffer of a buffer view, and its offset and length there, which are not checked."""
        extensions = view.get("extensions")
        for name in _COMPRESSED:
            if isinstance(extensions, dict) and name in extensions:
                raise InvalidInput(f"glTF: {name!r} is not read")
        data = self._buffer(view.get("buffer"))
        first = whole(view.get("byteOffset", 0), "bufferView.byteOffset")
        return data, first, whole(view.get("byteLength"), "bufferView.byteLength")

    def _buffer(self, index: Any) -> memoryview:
        buffer = self.item("buffers", index)
        length, uri = whole(buffer.get("byteLength"), "buffer.byteLength"), buffer.get("uri")
        data = self._contents(index, uri, length)
        if data is None or len(data) < length:
            raise InvalidInput(f"glTF: buffer {index}: fewer bytes than {length}")
        return data[:length]

    def _contents(self, index: int, uri: Any, length: int) -> memoryview | None:
        if uri is None:
            return self.binary if index == 0 else None
        if index not in self._loaded:
            self._loaded[index] = memoryview(self._load(uri, length))
        return self._loaded[index]

    def _load(self, uri: Any, length: int) -> bytes:
        """Bytes of a data URI, or of a file in the same folder."""
        if not isinstance(uri, str):
            raise InvalidInput("glTF: buffer.uri is not text")
        if uri.startswith("data:"):
            with refusing("glTF: buffer.uri"):
                return base64.b64decode(uri.partition(";base64,")[2], validate=True)
        path = self._file(uri)
        with refusing(f"file '{path.name[:60]}'"):
            if not path.is_file() or path.stat().st_size < length:
                raise InvalidInput(f"file '{path.name[:60]}': no file of {counted(length, 'byte')}")
            with open(path, "rb") as file:
                return file.read(length)

    def _file(self, uri: str) -> Path:
        name = unquote(uri)
        if not name.isprintable() or set(name) & set("/\\:") or not name.strip("."):
            raise InvalidInput(f"glTF: buffer.uri {uri!a:.60}, expected a file in the same folder")
        return self.folder / name

    def files_beside(self) -> list[Path]:
        """The files of buffers that are not in the document."""
        uris = [buffer.get("uri") for buffer in self.items("buffers")]
        return [
            self._file(uri) for uri in uris if isinstance(uri, str) and not uri.startswith("data:")
        ]


def open_gltf(folder: Path, data: memoryview) -> GltfFile:
    """Open the bytes of a `.glb` or `.gltf` file in a folder.

    Raises InvalidInput if it is neither, or not of version 2.
    """
    text, binary = _chunks(data) if data[:4] == MAGIC else (data, None)
    with refusing("glTF"):
        document = parse_json(bytes(text))
    asset = document.get("asset") if isinstance(document, dict) else None
    version = asset.get("version") if isinstance(asset, dict) else None
    if not isinstance(version, str) or not version.startswith("2."):
        raise InvalidInput(f"glTF version {version!a:.20}, expected 2")
    return GltfFile(folder, document, binary)


def _chunks(data: memoryview) -> tuple[memoryview, memoryview | None]:
    """The JSON and the buffer of a `.glb`."""
    least = _HEADER.size + _CHUNK.size
    if len(data) < least:
        raise InvalidInput(f"glTF: {counted(len(data), 'byte')}, expected a header and a chunk")
    _, version, length = _HEADER.unpack_from(data)
    if version != 2 or not least <= length <= len(data):
        stated = f"version {version}, {counted(length, 'byte')} of {len(data):,}"
        raise InvalidInput(f"glTF: {stated}, expected version 2 and {least} or more")
    parts, offset = [], _HEADER.size
    for kind in (b"JSON", b"BIN\0"):
        if offset + _CHUNK.size > length:
            break
        size, found = _CHUNK.unpack_from(data, offset)
        offset += _CHUNK.size
        if found != kind or offset + size > length:
            raise InvalidInput(
                f"glTF: chunk {found!a} of {counted(size, 'byte')}, expected {kind!a}"
            )
        parts.append(data[offset : offset + size])
        offset += size
    return parts[0], parts[1] if len(parts) > 1 else None


def whole(value: Any, where: str) -> int:
    """A non-negative integer of a document; `InvalidInput` otherwise."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 40:
        raise InvalidInput(f"glTF: {where} is {value!a:.40}, expected a whole number")
    return value


def numbers(value: Any, length: int, where: str) -> list[float]:
    """A list of `length` finite numbers of a document; `InvalidInput` otherwise."""
    if not isinstance(value, list) or len(value) != length:
        raise InvalidInput(f"glTF: {where} is not a list of {counted(length, 'number')}")
    for each in value:
        known = isinstance(each, int | float) and not isinstance(each, bool)
        if not known or not math.isfinite(each):
            raise InvalidInput(f"glTF: {where} has {each!a:.40}, expected a number")
    return [float(each) for each in value]


def pack_document(document: dict[str, Any], arrays: dict[str, NDArray], as_text: bool) -> bytes:
    """Serialise one mesh of points with these attributes ``(N, components)``.

    Float32 arrays are stored unchanged, uint8 arrays as normalised integers. `document` provides
    all members except buffers, views and accessors; `as_text` embeds the buffer in the JSON
    (`.gltf`).
    """
    views, accessors, offset = [], [], 0
    for name, array in arrays.items():
        views.append({
            "buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": _ARRAY_BUFFER,
        })  # fmt: skip
        kind = {width: kind for kind, width in _WIDTHS.items()}[array.shape[1]]
        accessor: dict[str, Any] = {
            "bufferView": len(views) - 1, "componentType": FLOAT, "count": len(array),
            "type": kind,
        }  # fmt: skip
        if array.dtype == np.uint8:
            accessor |= {"componentType": UNSIGNED_BYTE, "normalized": True}
        if name == "POSITION":
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        accessors.append(accessor)
        offset += array.nbytes
    data = b"".join(array.tobytes() for array in arrays.values())
    return pack_binary(document | {"bufferViews": views, "accessors": accessors}, data, as_text)


def pack_mesh(vertices: NDArray[np.float32], triangles: NDArray[np.uint32]) -> bytes:
    """Bytes of a `.glb` with one mesh: ``vertices (N, 3)`` and ``triangles (M, 3)``."""
    counts = {"count": len(vertices), "componentType": FLOAT, "type": "VEC3"}
    ends = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0", "generator": "gs_codec"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0} | counts | ends,
            {"bufferView": 1, "count": triangles.size, "componentType": 5125, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": vertices.nbytes, "target": _ARRAY_BUFFER},
            {
                "buffer": 0, "byteOffset": vertices.nbytes, "byteLength": triangles.nbytes,
                "target": 34963,
            },
        ],
    }  # fmt: skip
    return pack_binary(document, vertices.tobytes() + triangles.tobytes(), False)


def pack_binary(document: dict[str, Any], data: bytes, as_text: bool) -> bytes:
    """Serialise a document without buffers, and its only buffer; see `pack_document`."""
    buffer: dict[str, Any] = {"byteLength": len(data)}
    if as_text:
        buffer["uri"] = _DATA_URI + base64.b64encode(data).decode()
    text = json.dumps(document | {"buffers": [buffer]}, separators=(",", ":")).encode()
    if as_text:
        return text
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    length = _HEADER.size + 2 * _CHUNK.size + len(text) + len(data)
    head = _HEADER.pack(MAGIC, 2, length) + _CHUNK.pack(len(text), b"JSON")
    return b"".join([head, text, _CHUNK.pack(len(data), b"BIN\0"), data])
