"""Compare our coder of positions with Open3D's `Octree`: time to build and to traverse."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec import __version__
from gs_codec.coding.count_tree import decode_geometry, encode_geometry
from gs_codec.coding.extent import EXPANSION
from gs_codec.coding.morton import decode_morton, encode_morton
from gs_codec.coding.quantise import fit_range, quantise_positions
from gs_codec.config import Config

#: Depth of Open3D's octree: less than ours, in its favour.
OPEN3D_DEPTH = 10

#: Processor seconds of the steps of one run, by name; and its bytes or nodes.
Turn = tuple[dict[str, float], dict[str, int]]


class _Way(NamedTuple):
    """A way to divide and traverse points; `turn` runs it once."""

    coder: str
    version: str
    depth: int
    turn: Callable[[], Turn]


def measure_geometry(
    positions: NDArray[np.float32], name: str, repeats: int
) -> Iterator[dict[str, Any]]:
    """A result line for our count tree and one for Open3D's octree, from finite ``(3, N)``.

    The two alternate; the first turn, which compiles, does not count. Times are medians of
    processor seconds; both use one thread. Both get the points in memory, in their own layout.
    """
    ways = [_count_tree(positions), _open3d(positions)]
    turns = [[way.turn() for way in ways] for _ in range(repeats + 1)][1:]
    for way, taken in zip(ways, zip(*turns, strict=True), strict=True):
        steps = taken[0][0]
        yield {
            "kind": "geometry",
            "scene": name,
            "coder": way.coder,
            "version": way.version,
            "gaussians": positions.shape[1],
            "depth": way.depth,
            **taken[0][1],
            **{f"{step}_seconds": statistics.median(t[0][step] for t in taken) for step in steps},
        }


def _count_tree(positions: NDArray[np.float32]) -> _Way:
    """Sorted Morton codes, coded to bytes and decoded to cells, at the depth of `paper-m`."""
    depth = Config("paper-m").resolved_depths()["geometry"]

    def turn() -> Turn:
        start = time.thread_time()
        quantisers = [fit_range(row, depth) for row in positions]
        x, y, z = depths = tuple(quantiser.depth for quantiser in quantisers)
        codes = np.sort(encode_morton(quantise_positions(positions, quantisers), (x, y, z)))
        built = time.thread_time()
        data = encode_geometry(codes, sum(depths))
        walked = time.thread_time()
        codes = decode_geometry(memoryview(data), codes.size, sum(depths), "geometry")
        decode_morton(codes, (x, y, z))
        seconds = {"build": built - start, "walk": walked - built}
        return seconds | {"decode": time.thread_time() - walked}, {"bytes": len(data)}

    return _Way("count tree", __version__, depth, turn)


def _open3d(positions: NDArray[np.float32]) -> _Way:
    """An octree, and the minimal traversal that a coder needs: which children a node has."""
    import open3d

    points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions.T.astype(float)))

    def turn() -> Turn:
        nodes = 0

        def visit(node: Any, info: Any) -> bool:
            nonlocal nodes
            nodes += 1
            if isinstance(node, open3d.geometry.OctreeInternalNode):
                sum((child is not None) << k for k, child in enumerate(node.children))
            return False

        start = time.thread_time()
        octree = open3d.geometry.Octree(OPEN3D_DEPTH)
        octree.convert_from_point_cloud(points, EXPANSION)
        built = time.thread_time()
        octree.traverse(visit)
        seconds = {"build": built - start, "walk": time.thread_time() - built}
        return seconds, {"nodes": nodes}

    return _Way("Open3D's Octree", open3d.__version__, OPEN3D_DEPTH, turn)
