"""Gaussians in glTF 2.0 with the extension KHR_gaussian_splatting: `.glb` and `.gltf`.

Centres, unit quaternions xyzw, linear scales, opacities 0-1 and SH are float32 attributes of
points; the reader also accepts the integers that the extension allows. y is up. Attributes may also
be compressed (see `compressed`).
"""

from __future__ import annotations

import logging
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import GLTF
from gs_codec.formats.coordinates import state_system, turn_axes
from gs_codec.formats.extra_properties import left_out_of, listed, say_degree_4, say_left_out
from gs_codec.formats.gltf.compressed import (
    EXTENSION,
    as_current,
    check_supported,
    compressed_scene,
    compressed_size,
    document_of,
    is_compressed,
    other_attributes,
    other_extensions,
    sh_name,
)
from gs_codec.formats.gltf.file import MAGIC, GltfFile, numbers, open_gltf, pack_document, whole
from gs_codec.formats.limits import check_count
from gs_codec.formats.packed_values import (
    Clipped,
    check_finite,
    linear_scales,
    log_scales_of,
    logits_of,
    sigmoid,
    unit_quaternions,
)
from gs_codec.formats.similarity import move_scene, rotation_of
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_C0, SH_COEFFICIENTS, Scene, join_scenes, sh_bands, stated_comments

log = logging.getLogger(__name__)

_SYSTEM = GLTF.system

#: Extensions of nodes: instances are refused, and hidden nodes are not shown.
_INSTANCES = "EXT_mesh_gpu_instancing"
_VISIBILITY = "KHR_node_visibility"

#: Maximum number of primitives shown by nodes, per node and primitive of the file.
_SHOWN = 16

#: Deviation of an opacity of 0 or 1 by rounding alone.
_ROUNDED = 1e-3


def read_gltf(path: Path, view: memoryview, max_bytes: int | None) -> Scene:
    """Read the bytes of a `.glb` or `.gltf` file; see `SceneFile.scene`."""
    return join_scenes(placed_scenes(path, view, max_bytes, path.parent))


def placed_scenes(
    path: Path,
    view: memoryview,
    max_bytes: int | None,
    folder: Path,
    matrix: NDArray[np.float64] | None = None,
    system: str = _SYSTEM,
) -> list[Scene]:
    """The scene of each primitive, moved by a matrix ``(4, 4)``; raises like `read_gltf`.

    Separate buffers are in `folder`; `path` is the name in messages. `system` is the coordinate
    system then.
    """
    with located(path):
        file = open_gltf(folder, view)
        placed = _placed_primitives(file)
        count, degree = _total(file, placed)
        # Buffers may be in separate files.
        stored = sum(whole(x.get("byteLength"), "byteLength") for x in file.items("buffers"))
        check_count(count, degree, max(len(view), stored), max_bytes)
        plain = [each.primitive for each in placed if not is_compressed(each.primitive)]
        if any(sh_name(4, 0) in primitive["attributes"] for primitive in plain):
            say_degree_4(path)
        _say_others(path, file, placed)
        above = np.eye(4) if matrix is None else matrix
        return [
            state_system(_scene_of(path, file, each, degree, max_bytes, above), system)
            for each in placed
        ]


def _say_others(path: Path, file: GltfFile, placed: list[_Placed]) -> None:
    """Log what a file has besides the Gaussians of its scene."""
    primitives = [each for mesh in file.items("meshes") for each in _primitives(mesh)]
    meshes = sum("mesh" in node for node in file.items("nodes"))
    shown = sum("mesh" in node for node, _ in _shown_nodes(file))
    others = {
        "primitives without Gaussians": sum(not _is_marked(each) for each in primitives),
        "meshes outside the scene": meshes - shown,
        "primitives with morph targets": sum("targets" in each.primitive for each in placed),
        "skins": len(file.items("skins")),
        "animations": len(file.items("animations")),
    }
    found = {
        "attributes": {ascii(name) for each in placed for name in other_attributes(each.primitive)},
        "extensions": {ascii(name) for each in placed for name in other_extensions(each.primitive)},
    }
    names = [f"{kind} {listed(sorted(each))}" for kind, each in found.items() if each]
    say_left_out(path, lines=others, others=names)


def variant_of(path: Path, view: memoryview) -> str:
    """How the attributes of a file are compressed: ``spz``, or "" if they are not."""
    with located(path):
        placed = _placed_primitives(open_gltf(path.parent, view))
        return "spz" if any(is_compressed(each.primitive) for each in placed) else ""


def files_beside(path: Path, data: FileBytes) -> list[Path]:
    """The files of the buffers of a `.gltf`; a `.glb` has its own."""
    if data[: len(MAGIC)] == MAGIC:
        return []
    with located(path):
        return open_gltf(path.parent, data[:]).files_beside()


def stated_size(path: Path, view: memoryview, folder: Path | None = None) -> tuple[int, int]:
    """Number of Gaussians and SH degree stated in the document; raises like `placed_scenes`."""
    folder = path.parent if folder is None else folder
    with located(path):
        file = open_gltf(folder, view)
        return _total(file, _placed_primitives(file))


def _total(file: GltfFile, placed: list[_Placed]) -> tuple[int, int]:
    """Number of Gaussians of all primitives, and their SH degree."""
    sizes = [_size(file, each.primitive) for each in placed]
    degrees = {degree for _, degree in sizes}
    if len(degrees) > 1:
        raise InvalidInput("glTF: primitives of several SH degrees, expected one")
    return sum(count for count, _ in sizes), degrees.pop()


class _Placed(NamedTuple):
    """A primitive of Gaussians, and the matrix ``(4, 4)`` of its node and ancestors."""

    primitive: dict[str, Any]
    matrix: NDArray[np.float64]


def _placed_primitives(file: GltfFile) -> list[_Placed]:
    """Primitives of Gaussians, in the order of nodes from the roots."""
    found, splats = [], _Splats(file)
    for node, matrix in _shown_nodes(file):
        if "mesh" in node:
            shown = splats.of(node["mesh"])
            if shown and _extension(node, _INSTANCES) is not None:
                raise InvalidInput(f"glTF: {_INSTANCES!r} of Gaussians is not read")
            found += [_Placed(each, matrix) for each in shown]
            if len(found) > splats.most:
                raise InvalidInput(
                    f"glTF: nodes show more than {counted(splats.most, 'primitive')}"
                )
    if not found:
        raise InvalidInput(f"glTF: no points with {EXTENSION}, not a scene of Gaussians")
    return found


def _shown_nodes(file: GltfFile) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
    """The nodes of the scene, from its roots, each with its matrix ``(4, 4)`` in the scene."""
    shown = []
    pending = deque((root, np.eye(4)) for root in _roots(file))
    for _ in range(len(file.items("nodes"))):
        if not pending:
            break
        index, above = pending.popleft()
        node = file.item("nodes", index)
        if (_extension(node, _VISIBILITY) or {}).get("visible") is False:
            continue
        with np.errstate(over="ignore", invalid="ignore"):  # rejected when the scene is placed
            matrix = above @ _placement(node)
        pending.extend((child, matrix) for child in _children(node))
        shown.append((node, matrix))
    if pending:
        raise InvalidInput("glTF: a node has two parents")
    return shown


def _extension(node: dict[str, Any], name: str) -> dict[str, Any] | None:
    """An extension of a node; None if it has none."""
    found = node.get("extensions")
    extension = found.get(name) if isinstance(found, dict) else None
    return extension if isinstance(extension, dict) else None


def _roots(file: GltfFile) -> list[int]:
    """Nodes of the scene that is shown; of a file without scenes, all that are no child."""
    if file.items("scenes"):
        return _numbers(file.item("scenes", file.document.get("scene", 0)), "scene", "nodes")
    nodes = file.items("nodes")
    below = {child for node in nodes for child in _children(node)}
    return [i for i in range(len(nodes)) if i not in below]


class _Splats:
    """The primitives of Gaussians of each mesh, with a limit on the total that nodes may show.

    Several nodes may show one mesh. Without a limit, a small file could take minutes.
    """

    def __init__(self, file: GltfFile) -> None:
        self._file, self._known = file, dict[int, list[dict[str, Any]]]()
        primitives = sum(len(_primitives(mesh)) for mesh in file.items("meshes"))
        self.most = _SHOWN * (len(file.items("nodes")) + primitives)

    def of(self, index: Any) -> list[dict[str, Any]]:
        """The primitives of a mesh."""
        mesh = self._file.item("meshes", index)
        if index not in self._known:
            self._known[index] = [each for each in _primitives(mesh) if _is_splats(each)]
        return self._known[index]


def _primitives(mesh: dict[str, Any]) -> list[Any]:
    found = mesh.get("primitives")
    return [as_current(each) for each in found] if isinstance(found, list) else []


def _children(node: dict[str, Any]) -> list[int]:
    return _numbers(node, "node", "children")


def _numbers(item: dict[str, Any], kind: str, name: str) -> list[int]:
    """The numbers of other objects in an object of the document; empty if absent."""
    found = item.get(name, [])
    if not isinstance(found, list) or not all(isinstance(each, int) for each in found):
        raise InvalidInput(f"glTF: {kind}.{name} is not a list of numbers")
    return found


def _placement(node: dict[str, Any]) -> NDArray[np.float64]:
    """The matrix ``(4, 4)`` of a node."""
    if "matrix" in node:
        return np.array(numbers(node["matrix"], 16, "node.matrix")).reshape(4, 4).T
    turn = numbers(node.get("rotation", [0, 0, 0, 1]), 4, "node.rotation")
    scale = numbers(node.get("scale", [1, 1, 1]), 3, "node.scale")
    shift = numbers(node.get("translation", [0, 0, 0]), 3, "node.translation")
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_of(turn[3:] + turn[:3]) * scale
    matrix[:3, 3] = shift
    return matrix


def _is_marked(primitive: Any) -> bool:
    extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
    return isinstance(extensions, dict) and EXTENSION in extensions


def _is_splats(primitive: Any) -> bool:
    if not _is_marked(primitive):
        return False
    splats = primitive["extensions"][EXTENSION]
    if not isinstance(splats, dict) or not isinstance(primitive.get("attributes"), dict):
        raise InvalidInput(f"glTF: {EXTENSION} without attributes")
    check_supported(primitive)
    return True


def _size(file: GltfFile, primitive: dict[str, Any]) -> tuple[int, int]:
    """Number of Gaussians, and SH degree, of a primitive."""
    if is_compressed(primitive):
        count, degree = compressed_size(file, primitive)
    else:
        attributes = primitive["attributes"]
        count, degree = file.count(attributes.get("POSITION")), 0
        while degree < 3 and sh_name(degree + 1, 0) in attributes:
            degree += 1
    return file.count(primitive["indices"]) if "indices" in primitive else count, degree


def _scene_of(
    path: Path,
    file: GltfFile,
    placed: _Placed,
    degree: int,
    max_bytes: int | None,
    above: NDArray[np.float64],
) -> Scene:
    if is_compressed(placed.primitive):
        scene = compressed_scene(file, placed.primitive, max_bytes)
    else:
        scene = _plain_scene(path, file, placed.primitive, degree)
    if "indices" in placed.primitive:
        scene = scene.take(file.indices(placed.primitive["indices"], scene.count))
    with np.errstate(over="ignore", invalid="ignore"):
        return move_scene(scene, above @ placed.matrix)


def _plain_scene(path: Path, file: GltfFile, primitive: dict[str, Any], degree: int) -> Scene:
    attributes = primitive["attributes"]
    count = file.count(attributes.get("POSITION"))

    def planes(name: str, kind: str) -> NDArray[np.float32]:
        if name not in attributes:
            raise InvalidInput(f"glTF: no attribute {name}")
        values = file.values(attributes.get(name), kind, name)
        if len(values) != count:
            raise InvalidInput(f"glTF: {name} of {len(values)}, expected {count}")
        return np.ascontiguousarray(values.T)

    positions = planes("POSITION", "VEC3")
    scales = planes(f"{EXTENSION}:SCALE", "VEC3")
    opacity = planes(f"{EXTENSION}:OPACITY", "SCALAR")
    rest = [
        planes(sh_name(band, number), "VEC3")
        for band in range(1, degree + 1)
        for number in range(2 * band + 1)
    ]
    f_rest = np.empty((3, len(rest), count), np.float32)
    for k, colours in enumerate(rest):
        f_rest[:, k] = colours
    return Scene(
        positions,
        planes(sh_name(0, 0), "VEC3"),
        f_rest.reshape(-1, count),
        _logits(path, opacity),
        _logarithms(path, scales),
        planes(f"{EXTENSION}:ROTATION", "VEC4")[[3, 0, 1, 2]],
        comments=stated_comments(_SYSTEM, False),
    )


def _logarithms(path: Path, scales: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithms of scales.

    Drafts of the extension until early 2026, splat-transform 1.9 to 2.6 and gsbox store these.
    """
    if np.count_nonzero(scales < 0) <= scales.size // 2:
        return log_scales_of(scales)
    log.warning("%s: negative scales, read as logarithms", path)
    return scales


def _logits(path: Path, opacity: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logits of opacities. gsbox stores these; 81 to 97 % are beyond 0 to 1 in real scenes."""
    beyond = np.abs(opacity - 0.5) > 0.5 + _ROUNDED
    if np.count_nonzero(beyond) <= opacity.size // 2:
        return logits_of(opacity)
    log.warning("%s: opacities beyond 0 to 1, read as logits", path)
    return opacity


def pack_gltf(scene: Scene, as_text: bool = False) -> tuple[bytes, tuple[str, ...]]:
    """Bytes of a `.glb`, or of a `.gltf` if `as_text`; sentences on what it cannot represent.

    View-independent colours are included for programs that show points. Raises InvalidInput if
    there are no Gaussians, a value is not finite, or a scale is too large for a float32.
    """
    check_finite(scene, "glTF")
    if not scene.count:
        raise InvalidInput("no Gaussians, glTF needs at least one")
    turned = turn_axes(scene, _SYSTEM)
    clipped = Clipped()
    share = sigmoid(turned.opacity.astype(np.float64))
    colours = np.concatenate([0.5 + SH_C0 * turned.f_dc.astype(np.float64), share])
    planes = {
        "POSITION": turned.positions,
        "COLOR_0": np.rint(255 * np.clip(colours, 0, 1)).astype(np.uint8),
        f"{EXTENSION}:ROTATION": unit_quaternions(turned.rot)[[1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": linear_scales(turned.log_scale.astype(np.float64), "glTF", clipped),
        f"{EXTENSION}:OPACITY": share,
        sh_name(0, 0): turned.f_dc,
    }
    rest = turned.f_rest.reshape(3, -1, scene.count)
    for degree, band in enumerate(sh_bands(SH_COEFFICIENTS[scene.sh_degree]), 1):
        for number, k in enumerate(band):
            planes[sh_name(degree, number)] = rest[:, k]
    with np.errstate(under="ignore"):
        arrays = {
            name: np.ascontiguousarray(rows.T if rows.dtype == np.uint8 else rows.T.astype("<f4"))
            for name, rows in planes.items()
        }
    document = document_of({name: number for number, name in enumerate(arrays)}, {})
    data = pack_document(document, arrays, as_text)
    return data, (GLTF.rounding, *clipped.sentences(), *left_out_of(scene, GLTF))
