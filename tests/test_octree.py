"""A scene as Open3D's octree: every Gaussian in its cell, colours, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from scenes import edge_scenes, random_scene

import gs_codec
from gs_codec.coding.extent import Cube
from gs_codec.errors import InvalidInput
from gs_codec.formats.cloud import to_cloud
from gs_codec.scene import SH_C0, Scene


def leaves_of(octree) -> list[tuple]:
    """Indices, colour, origin and size of each leaf."""
    found = []

    def visit(node, info):
        if isinstance(node, o3d.geometry.OctreePointColorLeafNode):
            found.append((np.array(node.indices), node.color, info.origin, info.size, info.depth))

    octree.traverse(visit)
    return found


def on_borders(depth: int) -> Scene:
    """Centres on the corners of the cells of their bounding cube, up to float precision."""
    ends = np.array([[0, 0, 0], [1, 1, 1]], np.float32).T
    cube = Cube.around(ends)
    rng = np.random.default_rng(3)
    grid = rng.integers(0, int(0.99 * 2**depth), (3, 400)) * (cube.side / 2**depth)
    positions = (np.array(cube.low)[:, None] + grid).astype(np.float32)
    positions = np.concatenate([ends, np.clip(positions, 0, 1)], axis=1)
    return replace(random_scene(402, 0), positions=np.ascontiguousarray(positions))


def around_nothing() -> Scene:
    """A lowest centre that is lost by rounding the midpoint between it and the highest."""
    scene = random_scene(50, 0)
    positions = np.abs(scene.positions) / np.float32(2 * np.abs(scene.positions).max())
    positions[0, :2] = -1e-20, 1
    return replace(scene, positions=positions)


SCENES = {name: scene for name, scene in edge_scenes().items() if scene.count}
SCENES |= {
    "borders": on_borders(7),
    "around nothing": around_nothing(),
    "clusters": random_scene(3000, 1, seed=2),
}


@pytest.mark.parametrize("depth", [1, 7, 16])
@pytest.mark.parametrize("name", SCENES)
def test_every_gaussian_is_in_the_leaf_around_it(name, depth):
    scene = SCENES[name]
    octree = gs_codec.to_octree(to_cloud(scene), depth)
    leaves = leaves_of(octree)
    indices = np.concatenate([leaf[0] for leaf in leaves])
    np.testing.assert_array_equal(np.sort(indices), np.arange(scene.count))
    assert len(octree.root_node.indices) == scene.count
    places = scene.positions.T.astype(np.float64)
    for held, _, origin, size, at in leaves:
        assert at == depth
        assert size == octree.size / 2**depth
        assert np.all((origin <= places[held]) & (places[held] <= origin + size))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("depth", [1, 7, 16])
@pytest.mark.parametrize("name", SCENES)
def test_leaves_are_the_cells_of_our_codes_and_have_their_mean_colour(name, depth):
    """The cells used for mean colours, and drawn by the viewer, are Open3D's."""
    scene = SCENES[name]
    octree = gs_codec.to_octree(to_cloud(scene), depth)
    cube = Cube.around(scene.positions)
    np.testing.assert_array_equal(octree.origin, cube.low)
    assert octree.size == cube.side
    codes = cube.divide(scene.positions, depth)[0]
    colours = np.clip(0.5 + SH_C0 * scene.f_dc.T.astype(np.float64), 0, 1)
    leaves = leaves_of(octree)
    assert len(leaves) == len(np.unique(codes))
    for held, colour, *_ in leaves:
        assert len(np.unique(codes[held])) == 1
        np.testing.assert_allclose(colour, colours[held].mean(axis=0), atol=1e-12)


def test_a_code_begins_with_those_of_the_cells_around():
    scene = SCENES["borders"]
    cube = Cube.around(scene.positions)
    deep = cube.divide(scene.positions, 12)[0]
    for depth in range(1, 12):
        np.testing.assert_array_equal(
            deep >> 3 * (12 - depth), cube.divide(scene.positions, depth)[0]
        )


@pytest.mark.parametrize("depth", [0, 17, -1, 6.0, "6", None])
def test_other_depths_are_refused(depth):
    with pytest.raises(InvalidInput, match=r"^depth.*: .*expected (an integer from 1 to 16|int)$"):
        gs_codec.to_octree(to_cloud(random_scene(9)), depth)


@pytest.mark.parametrize("name", ["positions", "f_dc"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused(name, value):
    scene = random_scene(9)
    plane = getattr(scene, name).copy()
    plane[1, [3, 5]] = value
    with pytest.raises(InvalidInput, match=f"{name}: not finite in 2 Gaussians"):
        gs_codec.to_octree(to_cloud(replace(scene, **{name: plane})), 4)


def test_empty_and_indivisible_scenes_are_refused():
    with pytest.raises(InvalidInput, match="no Gaussians, expected at least one"):
        gs_codec.to_octree(to_cloud(random_scene(0)), 4)
    far = replace(random_scene(2), positions=np.full((3, 2), 1e20, np.float32))
    with pytest.raises(
        InvalidInput, match="too close together for float32 this far from the origin"
    ):
        gs_codec.to_octree(to_cloud(far), 4)
    with pytest.raises(InvalidInput, match="attribute 'positions': missing"):
        gs_codec.to_octree(o3d.t.geometry.PointCloud(), 4)
