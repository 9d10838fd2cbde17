"""A mesh of what is solid in a scene, for collisions: a `.collision.glb`.

Opacities are gathered in a grid of voxels; the mesh is where they reach one half.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.axes import rotation_matrix
from gs_codec.errors import InvalidInput
from gs_codec.format_table import COLLISION_MESH
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.gltf.file import pack_mesh
from gs_codec.formats.packed_values import check_finite, sigmoid, unit_quaternions
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.optional import needed
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import Scene, inverse_of

if TYPE_CHECKING:
    from open3d.pybind.geometry import TriangleMesh

#: Voxels along the longest side of the box with the middle 98 % of the centres.
_VOXELS = 192

#: Voxels of a block of Open3D's grid along each axis.
_BLOCK = 16

#: Minimum standard deviation, in voxels: thinner Gaussians would lie between voxels.
_THINNEST = 0.5

#: Alpha below which a Gaussian ends, as in renderers.
_LEAST_ALPHA = 1 / 255

#: Smallest part of the mesh that is kept, relative to all triangles.
_SMALLEST_PART = 0.002

#: Share of the triangles that remain; flat surfaces need few.
_KEPT = 0.2


def write_collision_mesh(path: str | Path, scene: Scene) -> tuple[str, ...]:
    """Write the mesh; raises InvalidInput if nothing is solid, MissingTool without Open3D.

    Returns
    -------
    tuple of str
        A sentence on what it is.
    """
    open3d = needed("open3d", COLLISION_MESH.name)
    check_finite(scene, COLLISION_MESH.name)
    turned = turn_axes(scene, COLLISION_MESH.system)
    origin, voxel, shape = _grid_of(turned)
    occupancy = _occupancy(turned, origin, voxel, shape)
    mesh = _simplified(open3d, _surface(open3d, occupancy))
    vertices = np.asarray(mesh.vertices) * voxel + origin
    triangles = np.asarray(mesh.triangles)
    if not len(triangles):
        raise InvalidInput(f"{path}: nothing in the scene is solid, so there is no mesh")
    with atomic_writer(path) as file:
        file.write(pack_mesh(vertices.astype("<f4"), triangles.astype("<u4")))
    return (f"only a mesh of {len(triangles):,} triangles, from voxels {voxel:.3g} wide",)


def _grid_of(scene: Scene) -> tuple[NDArray[np.float64], float, tuple[int, int, int]]:
    """Centre of the first voxel, width of a voxel, and number of voxels in z, y, x."""
    if not scene.count:
        raise InvalidInput("no Gaussians, so there is no mesh")
    low, high = np.percentile(scene.positions.astype(np.float64), [1, 99], axis=1)
    side = float((high - low).max())
    voxel = (side or 1.0) / _VOXELS
    # Empty voxels around the others close the mesh.
    numbers = [
        -(-int((h - n) / voxel + 7) // _BLOCK) * _BLOCK for n, h in zip(low, high, strict=True)
    ]
    return low - 3 * voxel, voxel, (numbers[2], numbers[1], numbers[0])


def _occupancy(
    scene: Scene, origin: NDArray[np.float64], voxel: float, shape: tuple[int, int, int]
) -> NDArray[np.float32]:
    """Alpha of all Gaussians together at each voxel, 0-1, ``shape``."""
    alphas = sigmoid(scene.opacity[0].astype(np.float64))
    seen = alphas > _LEAST_ALPHA
    shown, alphas = scene.take(seen), alphas[seen]
    centres = (shown.positions.T.astype(np.float64) - origin) / voxel
    deviations = np.maximum(np.exp(shown.log_scale.T.astype(np.float64)) / voxel, _THINNEST)
    axes = np.moveaxis(rotation_matrix(unit_quaternions(shown.rot)), 2, 0)
    covariances = np.einsum("nij,nj,nkj->nik", axes, deviations**2, axes)
    inverses = np.einsum("nij,nj,nkj->nik", axes, deviations**-2.0, axes)
    reach = 2 * np.log(alphas / _LEAST_ALPHA)
    halves = np.sqrt(reach[:, None] * np.diagonal(covariances, axis1=1, axis2=2))
    passed = np.zeros(shape, np.float32)
    bounds = np.linspace(0, shape[0], 4 * available_threads() + 1).astype(np.int64)
    run_all(
        lambda span: _add(centres, inverses, halves, reach, alphas, *span, passed),
        zip(bounds[:-1], bounds[1:], strict=True),
    )
    np.expm1(passed, out=passed)
    occupancy = np.negative(passed, out=passed)
    for end in (0, -1):
        occupancy[end] = occupancy[:, end] = occupancy[:, :, end] = 0
    return occupancy


@kernel
def _add(centres, inverses, halves, reach, alphas, first, end, passed):
    """Add the logarithms of 1 - alpha to layers `first` to `end` of a grid."""
    rows, columns = passed.shape[1:]
    for i in range(len(centres)):
        u, v, w = centres[i]
        inverse = inverses[i]
        for z in range(
            max(first, np.int64(math.ceil(max(w - halves[i, 2], -1.0)))),
            min(end, np.int64(math.floor(min(w + halves[i, 2], 1e6))) + 1),
        ):
            dz = z - w
            for y in range(
                max(np.int64(0), np.int64(math.ceil(max(v - halves[i, 1], -1.0)))),
                min(rows, np.int64(math.floor(min(v + halves[i, 1], 1e6))) + 1),
            ):
                dy = y - v
                slope = inverse[0, 1] * dy + inverse[0, 2] * dz
                rest = inverse[1, 1] * dy * dy + 2 * inverse[1, 2] * dy * dz
                rest += inverse[2, 2] * dz * dz
                square = slope * slope - inverse[0, 0] * (rest - reach[i])
                if square <= 0.0:
                    continue
                half = math.sqrt(square) / inverse[0, 0]
                middle = u - slope / inverse[0, 0]
                for x in range(
                    max(np.int64(0), np.int64(math.ceil(max(middle - half, -1.0)))),
                    min(columns, np.int64(math.floor(min(middle + half, 1e6))) + 1),
                ):
                    dx = x - u
                    q = inverse[0, 0] * dx * dx + 2 * slope * dx + rest
                    alpha = min(0.99, alphas[i] * math.exp(-0.5 * q))
                    passed[z, y, x] += math.log(1.0 - alpha)


def _surface(open3d: Any, occupancy: NDArray[np.float32]) -> TriangleMesh:
    """Surface where the occupancy is one half, in voxels."""
    kinds = (open3d.core.float32, open3d.core.float32)
    blocks = _solid_blocks(occupancy)
    if not len(blocks):
        return open3d.geometry.TriangleMesh()
    grid = open3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), kinds, ((1), (1)), 1.0, _BLOCK, len(blocks)
    )
    grid.hashmap().activate(open3d.core.Tensor(blocks))
    places, indices = grid.voxel_coordinates_and_flattened_indices()
    x, y, z = places.numpy().astype(np.int64).T
    values = 0.5 - occupancy[z, y, x]
    for name, column in (("tsdf", values), ("weight", np.ones_like(values))):
        grid.attribute(name).reshape((-1, 1))[indices] = open3d.core.Tensor(column[:, None])
    found = grid.extract_triangle_mesh(0.5)
    vertices = found.vertex.positions.numpy().astype(np.float64)
    triangles = found.triangle.indices.numpy().astype(np.int64)
    # Threads of Open3D find vertices and triangles in any order.
    order = np.lexsort(vertices.T)
    triangles = inverse_of(order)[triangles]
    first = triangles.argmin(axis=1)[:, None]
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    triangles = triangles[np.lexsort(triangles.T[::-1])]
    return open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices[order]), open3d.utility.Vector3iVector(triangles)
    )


def _solid_blocks(occupancy: NDArray[np.float32]) -> NDArray[np.int32]:
    """Blocks with a solid voxel, and their neighbours: x, y, z, ``(n, 3)``."""
    counts = [n for number in occupancy.shape for n in (number // _BLOCK, _BLOCK)]
    solid = np.pad(occupancy.reshape(counts).max(axis=(1, 3, 5)) > 0.5, 1)
    for axis in range(3):
        solid = solid | np.roll(solid, 1, axis) | np.roll(solid, -1, axis)
    return np.ascontiguousarray(np.argwhere(solid[1:-1, 1:-1, 1:-1])[:, ::-1], np.int32)


def _simplified(open3d: Any, mesh: TriangleMesh) -> TriangleMesh:
    """The mesh without small parts, and with fewer triangles."""
    parts, sizes, _ = mesh.cluster_connected_triangles()
    small = np.asarray(sizes)[np.asarray(parts)] < _SMALLEST_PART * len(mesh.triangles)
    mesh.remove_triangles_by_mask(small)
    mesh.remove_unreferenced_vertices()
    return mesh.simplify_quadric_decimation(int(_KEPT * len(mesh.triangles)))
