"""Convert a scene to Open3D's octree."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gs_codec.coding.extent import DEPTHS, EXPANSION, Cube
from gs_codec.errors import InvalidInput
from gs_codec.formats.cloud import from_cloud
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.optional import needed
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_C0

if TYPE_CHECKING:
    from open3d.pybind.geometry import Octree
    from open3d.pybind.t.geometry import PointCloud


@checked
def to_octree(cloud: PointCloud, depth: int) -> Octree:
    """Put the centres of a cloud into Open3D's octree, to count, search or draw them by cell.

    Parameters
    ----------
    cloud : open3d.t.geometry.PointCloud
        A cloud from `read` with at least one Gaussian; additional attributes are ignored.
    depth : int
        Depth of the leaves, 1-16: they are cubes of ``octree.size / 2**depth`` scene units.

    Returns
    -------
    open3d.geometry.Octree
        Its root is Open3D's cube around the centres, 1 % larger than their extent. In a leaf, an
        `OctreePointColorLeafNode`, ``indices`` are the cloud indices of the Gaussians whose centres
        are inside, and ``color`` is the mean of their SH-DC colours, RGB, 0-1.

    Raises
    ------
    InvalidInput
        If the depth is not 1-16, an attribute is missing, the cloud is empty, a centre or SH-DC is
        not finite, or all centres are so close together and so far from the origin that 64-bit
        floats cannot resolve cells.
    MissingTool
        If Open3D is not installed.

    Notes
    -----
    `encode` does not use this class: its position coder walks sorted Morton codes, which takes a
    fraction of the time. ``octree.traverse`` calls back for every node, not only for leaves.

    Examples
    --------
    >>> import open3d
    >>> octree = gs_codec.to_octree(gs_codec.read("scene.ply"), 4)
    >>> octree.max_depth, len(octree.root_node.indices)
    (4, 2000)
    >>> counts = []
    >>> def count(node, info):
    ...     if isinstance(node, open3d.geometry.OctreePointColorLeafNode):
    ...         counts.append(len(node.indices))
    >>> octree.traverse(count)
    >>> sum(counts)
    2000
    """
    open3d = needed("open3d", "to_octree")
    if not isinstance(depth, int) or depth not in DEPTHS:
        raise InvalidInput(f"depth {depth}: expected an integer from 1 to {DEPTHS[-1]}")
    scene = from_cloud(cloud, "drop", tell=False)
    if not scene.count:
        raise InvalidInput("to_octree: no Gaussians, expected at least one")
    for name, plane in (("positions", scene.positions), ("f_dc", scene.f_dc)):
        if bad := np.count_nonzero(~np.isfinite(plane).all(axis=0)):
            raise InvalidInput(f"{name}: not finite in {counted(bad, 'Gaussian')}")
    cube = Cube.around(scene.positions)
    if not cube.is_divisible(depth):
        raise InvalidInput("positions: too close together for float32 this far from the origin")
    codes, positions = cube.divide(scene.positions, depth)
    cells = np.unique(codes, return_inverse=True)[1]
    colours = np.clip(0.5 + SH_C0 * scene.f_dc.astype(np.float64), 0, 1)
    sums = np.stack([np.bincount(cells, row) for row in colours])
    vectors = open3d.utility.Vector3dVector
    points = open3d.geometry.PointCloud(vectors(positions.T))
    # Open3D gives a leaf the colour of its last point, so all points of a cell get the mean.
    points.colors = vectors((sums / np.bincount(cells))[:, cells].T)
    octree = open3d.geometry.Octree(max_depth=depth)
    octree.convert_from_point_cloud(points, EXPANSION)
    return octree
