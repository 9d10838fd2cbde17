"""Attributes of a glTF stored as an `.spz`: KHR_gaussian_splatting_compression_spz_2.

Accessors state only types and counts. The numbers in the `.spz` are those of the attributes, so
they are in the coordinates of glTF, whatever its specification says: CesiumJS and Cesium Native
do not convert them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.config import Effort
from gs_codec.errors import InvalidInput
from gs_codec.format_table import GLTF
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.gltf.file import FLOAT, UNSIGNED_BYTE, GltfFile, pack_binary
from gs_codec.formats.packed_values import Clipped
from gs_codec.formats.similarity import move_scene
from gs_codec.formats.spz.file import read_streams, stated_size
from gs_codec.formats.spz.scene import centre_range, pack_spz, scene_of_streams
from gs_codec.runtime.mapped import located
from gs_codec.scene import SH_COEFFICIENTS, Scene, sh_bands

EXTENSION = "KHR_gaussian_splatting"
COLOUR_SPACE = "srgb_rec709_display"

#: Its names in drafts of 2025; JSplat wrote the first.
_DRAFTED = ("BT.709-sRGB", "BT.709")

SPZ_2 = f"{EXTENSION}_compression_spz_2"

#: The extension of drafts of 2025, which was not within the other.
_ALONE = "KHR_spz_gaussian_splats_compression"

#: Names of the extension: the current one, then those of earlier drafts.
_NAMES = (SPZ_2, f"{EXTENSION}_compression_spz", _ALONE)

#: Beginnings of the names of its attributes in drafts; they have no values.
_OF_SPZ = ("_SCALE", "_ROTATION", "_SH_DEGREE_")

#: A compression of attributes of meshes.
_DRACO = "KHR_draco_mesh_compression"

#: Proposed compressions, by parts of the names of their extensions.
_PROPOSED = {"lgsc": "L-GSC", "egsc": "EGSC", "mpeg": "MPEG's codec"}

#: Version of SPZ files: that of version 2.0 of Niantic's library.
_VERSION = 3

#: Stands for the `.spz` in messages.
_INSIDE = Path(SPZ_2)


def sh_name(degree: int, coefficient: int) -> str:
    """Name of the attribute of an SH coefficient."""
    return f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{coefficient}"


def as_current(primitive: Any) -> Any:
    """A primitive of a draft of 2025 as it would be stated now; others unchanged."""
    extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
    if not isinstance(extensions, dict) or _ALONE not in extensions:
        return primitive
    return primitive | {"extensions": {EXTENSION: {"extensions": {_ALONE: extensions[_ALONE]}}}}


def _inner(primitive: dict[str, Any]) -> Any:
    """Extensions of the extension of a primitive of Gaussians."""
    return primitive["extensions"][EXTENSION].get("extensions") or {}


def is_compressed(primitive: dict[str, Any]) -> bool:
    """Whether the attributes of a checked primitive are an `.spz`."""
    return bool(_inner(primitive))


def other_attributes(primitive: dict[str, Any]) -> set[str]:
    """Names of the attributes of a checked primitive that are no Gaussians' or their colours'."""
    known = (f"{EXTENSION}:", *(_OF_SPZ if is_compressed(primitive) else ()))
    names = {name for name in primitive["attributes"] if not name.startswith(known)}
    return names - {"POSITION", "COLOR_0"}


def other_extensions(primitive: dict[str, Any]) -> set[str]:
    """Names of the extensions of a checked primitive that are neither Gaussians nor an `.spz`."""
    return {*primitive["extensions"], *_inner(primitive)} - {EXTENSION, *_NAMES}


def check_supported(primitive: dict[str, Any]) -> None:
    """Reject a primitive of Gaussians with another compression, kernel or colour space."""
    splats, inner = primitive["extensions"][EXTENSION], _inner(primitive)
    if _DRACO in primitive["extensions"]:
        raise InvalidInput(f"glTF: {_DRACO!r} is not read")
    names = sorted(inner) if isinstance(inner, dict) else [inner]
    # Others may add to an `.spz`, like EXT_splat_opacity of 3DGS-PLY-3DTiles-Converter.
    spz = isinstance(inner, dict) and any(name in _NAMES for name in names)
    for name in names:
        known = (by for part, by in _PROPOSED.items() if part in str(name).lower())
        by = "".join(f" ({each})" for each in known)
        if by or not spz:
            raise InvalidInput(f"glTF: {name!a:.80}{by} is not read, expected {SPZ_2} or none")
    default = ("ellipse", COLOUR_SPACE) if inner else (None, None)
    kernel = splats.get("kernel", default[0])
    space = splats.get("colorSpace", default[1])
    if kernel != "ellipse" or space not in (COLOUR_SPACE, *_DRAFTED):
        raise InvalidInput(
            f"glTF: kernel {kernel!a:.40} in {space!a:.40}, expected ellipse in {COLOUR_SPACE}"
        )


def _spz_of(file: GltfFile, primitive: dict[str, Any]) -> memoryview:
    inner = _inner(primitive)
    stated = next(inner[name] for name in _NAMES if name in inner)
    view = stated.get("bufferView") if isinstance(stated, dict) else None
    return file.bytes_of(view, SPZ_2)


def compressed_size(file: GltfFile, primitive: dict[str, Any]) -> tuple[int, int]:
    """Number of Gaussians, and SH degree, of a compressed primitive."""
    return stated_size(_INSIDE, _spz_of(file, primitive))


def compressed_scene(file: GltfFile, primitive: dict[str, Any], max_bytes: int | None) -> Scene:
    """The Gaussians of a compressed primitive, in its own coordinates."""
    with located(_INSIDE):
        header, streams, _ = read_streams(_INSIDE, _spz_of(file, primitive), max_bytes)
        return scene_of_streams(_INSIDE, header, streams, GLTF.system)


def document_of(attributes: dict[str, int], compression: dict[str, Any]) -> dict[str, Any]:
    """A document of one primitive of Gaussians, without accessors and buffers.

    `compression` has the extensions of its extension.
    """
    splats: dict[str, Any] = {"kernel": "ellipse", "colorSpace": COLOUR_SPACE}
    used = [EXTENSION, *compression]
    if compression:
        splats["extensions"] = compression
    primitive = {"attributes": attributes, "mode": 0, "extensions": {EXTENSION: splats}}
    return {
        "asset": {"version": "2.0", "generator": "gs_codec"},
        "extensionsUsed": used,
        **({"extensionsRequired": used} if compression else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
    }


def pack_gltf_spz(
    scene: Scene,
    steps: AttributeSteps | None = None,
    effort: Effort = "normal",
    as_text: bool = False,
    clipped: Clipped | None = None,
    place: tuple[str, Sequence[float]] | None = None,
) -> tuple[bytes, tuple[str, ...]]:
    """Bytes of a `.glb`, or of a `.gltf` if `as_text`; see `pack_spz`.

    Centres may be relative to a place in another coordinate system, whose numbers are those of the
    glTF. Raises InvalidInput if there are no Gaussians, or a value is not finite.
    """
    if not scene.count:
        raise InvalidInput("no Gaussians, glTF needs at least one")
    system, middle = place or (GLTF.system, (0.0, 0.0, 0.0))
    matrix = np.eye(4)
    matrix[:3, 3] = middle
    if place is not None:
        scene = move_scene(turn_axes(scene, system), np.linalg.inv(matrix))
    data, lost = pack_spz(scene, _VERSION, steps, effort, system, clipped)
    document = document_of({}, {SPZ_2: {"bufferView": 0}})
    document["nodes"][0]["matrix"] = matrix.T.ravel().tolist()
    return _with_spz(document, data, scene.count, scene.sh_degree, as_text), lost


def _with_spz(
    document: dict[str, Any], data: bytes, count: int, sh_degree: int, as_text: bool
) -> bytes:
    """Add attributes to a document without any. CesiumJS needs exactly these."""
    low, high = centre_range(_INSIDE, data)
    floats = {"componentType": FLOAT, "count": count}
    attributes: dict[str, dict[str, Any]] = {
        "POSITION": floats | {"type": "VEC3", "min": low.tolist(), "max": high.tolist()},
        "COLOR_0": {
            "componentType": UNSIGNED_BYTE, "normalized": True, "count": count, "type": "VEC4",
        },
        f"{EXTENSION}:SCALE": floats | {"type": "VEC3"},
        f"{EXTENSION}:ROTATION": floats | {"type": "VEC4"},
    }  # fmt: skip
    for degree, band in enumerate(sh_bands(SH_COEFFICIENTS[sh_degree]), 1):
        attributes |= {sh_name(degree, n): floats | {"type": "VEC3"} for n in range(len(band))}
    [primitive] = document["meshes"][0]["primitives"]
    primitive["attributes"] = {name: number for number, name in enumerate(attributes)}
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": len(data)}]
    document |= {"bufferViews": views, "accessors": [*attributes.values()]}
    return pack_binary(document, data, as_text)
