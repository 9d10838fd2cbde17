"""Floaters and clusters against brute force: floaters are removed, backgrounds kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import edge_scenes, random_scene, shared_scene_path, with_threads

from gs_codec.cameras.camera import Camera, facing
from gs_codec.edit.clusters import keep_largest_cluster, largest_cluster
from gs_codec.edit.floaters import FLOATERS, find_floaters, remove_floaters
from gs_codec.edit.spacing import far_from_others, find_spacing, usual_distance
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene, join_scenes

ISOLATED, HARDLY_SEEN, OUTSIDE = 1, 2, 3


def made(points, sigma, opacity=0.9, flat=1.0) -> Scene:
    """Grey Gaussians at ``points (n, 3)``, flattened along z by a factor."""
    points = np.asarray(points, np.float32).T
    count = points.shape[1]
    log_scale = np.full((3, count), np.log(sigma), np.float32)
    log_scale[2] += np.float32(np.log(flat))
    return Scene(
        positions=points,
        f_dc=np.zeros((3, count), np.float32),
        f_rest=np.zeros((0, count), np.float32),
        opacity=np.full((1, count), np.log(opacity / (1 - opacity)), np.float32),
        log_scale=log_scale,
        rot=np.tile(np.float32([[1], [0], [0], [0]]), count),
    )


def disc(size, radius, depth=0.0) -> np.ndarray:
    """Points of a `size` x `size` grid inside a circle in the plane z = depth."""
    x, y = np.meshgrid(*[np.linspace(-radius, radius, size)] * 2)
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, depth)], axis=1)
    return points[x.ravel() ** 2 + y.ravel() ** 2 <= 1.02 * radius**2]


def wall_and_thing() -> Scene:
    """A fine disc, and far behind it a wall of a few large flat Gaussians."""
    return join_scenes([made(disc(40, 1.0), 0.03, flat=0.1), made(disc(8, 20.0, 15.0), 3.0)])


def ring(count, distance=4.0, width=96) -> list[Camera]:
    """Cameras in front of the origin, looking at it from a cone of directions."""
    angles = 2 * np.pi * np.arange(count) / count
    places = [distance * np.array([0.5 * np.cos(a), 0.5 * np.sin(a), -1.0]) for a in angles]
    size = width, width * 3 // 4
    return [
        Camera(f"{i}", *size, width, width, size[0] / 2, size[1] / 2, facing(-p, [0, -1, 0]), p)
        for i, p in enumerate(places)
    ]


def sizes_by_hand(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Largest standard deviation and geometric mean, rounded to powers of two."""
    octaves = scene.log_scale.astype(np.float64) / np.log(2)
    largest, mean = octaves.max(axis=0), scene.log_scale.mean(axis=0, dtype=np.float64) / np.log(2)
    return 2.0 ** np.rint(largest), 2.0 ** np.rint(mean)


def all_ratios(scene: Scene) -> np.ndarray:
    """Distances in units of sizes between all pairs ``(N, N)``; rows are the first Gaussians."""
    points = scene.positions.T.astype(np.float64)
    length, width = sizes_by_hand(scene)
    apart = np.sqrt(((points[:, None] - points[None]) ** 2).sum(axis=2))
    ratios = apart / (length[:, None] + width[None])
    np.fill_diagonal(ratios, np.inf)
    return ratios


def sparse_and_dense(seed: int) -> Scene:
    """Clumps and single Gaussians, with sizes over four orders of magnitude."""
    scene = random_scene(700, 0, seed)
    rng = np.random.default_rng(seed)
    sizes = rng.normal(-4.0, 1.5, (1, 700)) + rng.normal(0, 0.7, (3, 700))
    loose = rng.uniform(-8, 8, (3, 700)).astype(np.float32)
    positions = np.where(np.arange(700) % 16 == 0, loose, scene.positions)
    return replace(scene, positions=positions, log_scale=sizes.astype(np.float32))


# Distances


@pytest.mark.parametrize("seed", range(4))
def test_distances_in_sizes_are_those_of_all_pairs(seed):
    scene = sparse_and_dense(seed)
    expected = np.sort(all_ratios(scene), axis=1)[:, 7]
    spacing = find_spacing(scene)
    some = np.random.default_rng(seed).permutation(700)[:300]
    np.testing.assert_allclose(far_from_others(spacing, some), expected[some], rtol=1e-12)
    assert usual_distance(spacing) == pytest.approx(np.quantile(expected, 0.9), rel=1e-12)
    by_centre = spacing.in_sizes().max(axis=1)
    assert (by_centre > expected * (1 + 1e-9)).any(), "nothing large is near from afar"


def test_few_gaussians_use_their_farthest_neighbour():
    scene = sparse_and_dense(5).take(np.arange(4))
    expected = np.sort(all_ratios(scene), axis=1)[:, 2]
    np.testing.assert_allclose(far_from_others(find_spacing(scene), np.arange(4)), expected)


# Isolated


@pytest.mark.parametrize("seed", range(4))
def test_isolated_by_brute_force(seed):
    scene = sparse_and_dense(seed)
    far = np.sort(all_ratios(scene), axis=1)[:, 7]
    expected = far > 1.75 * np.quantile(far, 0.9)
    assert 0 < expected.sum() < 100
    np.testing.assert_array_equal(find_floaters(scene) == ISOLATED, expected)


@pytest.mark.parametrize("clump", [1, 3, 5, 8])
def test_injected_clumps_are_removed_and_a_sparse_wall_is_kept(clump):
    scene = wall_and_thing()
    rng = np.random.default_rng(clump)
    centres = np.repeat(disc(4, 1.5, -3.0), clump, axis=0)
    floaters = made(centres + rng.normal(0, 0.03, centres.shape), 0.05)
    labels = find_floaters(join_scenes([scene, floaters]))
    assert not labels[: scene.count].any()
    assert (labels[scene.count :] == ISOLATED).all()


def test_nine_together_are_not_isolated():
    scene = wall_and_thing()
    together = made(np.random.default_rng(0).normal(0, 0.02, (9, 3)) - [0, 0, 5], 0.05)
    assert not find_floaters(join_scenes([scene, together])).any()


def test_large_isolated_gaussians_are_kept_where_small_ones_are_removed():
    scene = wall_and_thing()
    places = [[0, 0, -4.0]]
    assert find_floaters(join_scenes([scene, made(places, 0.02)]))[-1] == ISOLATED
    assert find_floaters(join_scenes([scene, made(places, 2.0)]))[-1] == 0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_units_make_no_difference(scale):
    scene = sparse_and_dense(9)
    shift = np.float32(np.log(2.0) * np.rint(np.log2(scale)))
    factor = np.float32(2.0 ** np.rint(np.log2(scale)))
    scaled = replace(scene, positions=scene.positions * factor, log_scale=scene.log_scale + shift)
    np.testing.assert_array_equal(find_floaters(scaled), find_floaters(scene))


# With cameras


def test_hidden_gaussians_are_hardly_seen():
    front, behind = made(disc(40, 1.0), 0.06, 0.99), made(disc(12, 0.3, 0.8), 0.05)
    scene = join_scenes([front, front, behind])
    cameras = ring(12)
    labels = find_floaters(scene, cameras)
    assert np.isin(labels[-behind.count :], [ISOLATED, HARDLY_SEEN]).all()
    assert np.mean(labels[-behind.count :] == HARDLY_SEEN) > 0.9
    weight = sum(render(scene, c, accumulate=True).accumulations.weight for c in cameras)
    assert (weight[labels == HARDLY_SEEN] < 1e-3 * weight.mean()).all()
    assert not labels[weight > 1e-3 * weight.mean()].any()


@pytest.mark.parametrize("count", [1, 3, 9])
def test_few_cameras_label_nothing_hardly_seen(count):
    front, behind = made(disc(40, 1.0), 0.06, 0.99), made(disc(12, 0.3, 0.8), 0.05)
    labels = find_floaters(join_scenes([front, front, behind]), ring(count))
    assert not (labels == HARDLY_SEEN).any()


def test_far_gaussians_are_removed_and_unseen_near_ones_kept():
    thing = made(disc(40, 1.0), 0.06)
    behind = made(disc(10, 0.2) + np.array([0, 0, -3.3]), 0.06)
    outside = made(disc(10, 0.2) + np.array([0, 0, -60.0]), 0.06)
    cameras = ring(12, 2.5)
    labels = find_floaters(join_scenes([thing, behind, outside]), cameras)
    assert not labels[: -outside.count].any()
    assert (labels[-outside.count :] == OUTSIDE).all()


@pytest.mark.parametrize("before", [True, False], ids=["before cameras", "behind what they see"])
def test_the_isolation_threshold_is_lower_in_front_of_cameras(before):
    """A ring of eight around one is farther from it than usual, but only slightly."""
    angles = 2 * np.pi * np.arange(8) / 8
    ring_of = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    thing = made(disc(60, 1.0), 0.03)
    usual = usual_distance(find_spacing(thing))
    depth = -2.0 if before else 1.5
    places = np.concatenate([[[0, 0, 0]], 1.5 * usual * 2 * 0.03125 * ring_of])
    scene = join_scenes([thing, made(places + np.array([0, 0, depth]), 0.03, 0.2)])
    assert find_floaters(scene)[thing.count] == 0
    assert (find_floaters(scene, ring(4))[thing.count] == ISOLATED) == before


def test_visible_gaussians_are_never_outside():
    thing, far = made(disc(40, 1.0), 0.06), made(disc(6, 20.0) + np.array([0, 0, 60.0]), 6.0)
    labels = find_floaters(join_scenes([thing, far]), ring(12))
    assert not labels.any()


@pytest.mark.parametrize("places", [disc(30, 1.0), np.zeros((20, 3))], ids=["plane", "point"])
def test_cameras_and_points_without_a_hull(places):
    away = made(np.full((9, 3), [3.5, 0, 4.0]), 0.05)
    camera = Camera("a", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(3), np.array([0, 0, 0.0]))
    scene = join_scenes([made(places * [1, 0, 0] + np.array([0, 0, 4]), 0.3), away])
    assert not (find_floaters(scene, [camera] * 2) == OUTSIDE).any()


def test_with_blind_cameras_only_isolated_gaussians_are_removed():
    scene = join_scenes([wall_and_thing(), made([[0, 0, -4.0]], 0.02)])
    away = Camera("a", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(3), np.array([0, 0, 500.0]))
    np.testing.assert_array_equal(find_floaters(scene, [away] * 12), find_floaters(scene))


def test_no_cameras_in_a_sequence_is_an_error():
    with pytest.raises(InvalidInput, match="cameras: none"):
        find_floaters(wall_and_thing(), [])


def test_progress_counts_views():
    steps = []
    find_floaters(wall_and_thing(), ring(3), lambda *step: steps.append(step))
    assert steps == [("views", 1, 3), ("views", 2, 3), ("views", 3, 3)]


# Edges


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", edge_scenes())
def test_edges(name):
    scene = edge_scenes()[name]
    for cameras in (None, ring(2)):
        labels = find_floaters(scene, cameras)
        assert labels.shape == (scene.count,)
        assert labels.dtype == np.uint8
        assert (labels < len(FLOATERS)).all()
        assert remove_floaters(scene, cameras).count == (labels == 0).sum()
    assert bool(largest_cluster(scene).any()) == bool(scene.count)


@pytest.mark.thorough
@pytest.mark.parametrize("group", ["positions", "f_dc", "f_rest", "opacity", "log_scale", "rot"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_nonfinite_values(group, value):
    scene = join_scenes([sparse_and_dense(1), made([[0, 0, 90.0]], 0.01)])
    scene = replace(scene, f_rest=np.zeros((9, scene.count), np.float32))
    plane = getattr(scene, group).copy()
    plane[-1, ::7] = value
    broken = replace(scene, **{group: plane})
    sound = np.ones(scene.count, bool)
    sound[::7] = False
    for cameras in (None, ring(12)):
        labels = find_floaters(broken, cameras)
        assert not labels[~sound].any()
        np.testing.assert_array_equal(labels[sound], find_floaters(scene.take(sound), cameras))
    cluster = largest_cluster(broken)
    assert not cluster[~sound].any()
    np.testing.assert_array_equal(cluster[sound], largest_cluster(scene.take(sound)))


def test_no_finite_gaussians():
    scene = replace(sparse_and_dense(1), opacity=np.full((1, 700), np.nan, np.float32))
    assert not find_floaters(scene, ring(2)).any()
    assert remove_floaters(scene) is scene
    assert keep_largest_cluster(scene).count == 0


def test_without_floaters_the_scene_is_returned():
    scene = wall_and_thing()
    assert remove_floaters(scene) is scene
    thing = made(disc(40, 1.0), 0.03)
    assert keep_largest_cluster(thing) is thing


@pytest.mark.thorough
def test_threads_make_no_difference():
    scene = join_scenes([sparse_and_dense(2), sparse_and_dense(3)])
    for function in (find_floaters, largest_cluster):
        one = with_threads(1, function, scene)
        np.testing.assert_array_equal(one, with_threads(5, function, scene))
    seen = with_threads(1, find_floaters, scene, ring(12))
    np.testing.assert_array_equal(seen, with_threads(5, find_floaters, scene, ring(12)))


# Clusters


def cluster_by_hand(scene: Scene) -> np.ndarray:
    """The cluster with the most Gaussians, from links between all pairs."""
    ratios = all_ratios(scene)
    linked = ratios <= np.quantile(np.sort(ratios, axis=1)[:, 7], 0.9)
    linked |= linked.T
    left, best = np.ones(scene.count, bool), np.zeros(scene.count, bool)
    while left.any():
        found = np.zeros(scene.count, bool)
        edge = found.copy()
        edge[np.argmax(left)] = True
        while edge.any():
            found |= edge
            edge = linked[edge].any(axis=0) & ~found
        left &= ~found
        best = found if found.sum() > best.sum() else best
    return best


@pytest.mark.one_in(3)
@pytest.mark.parametrize("seed", range(6))
def test_the_largest_cluster_by_brute_force(seed):
    scene = sparse_and_dense(seed)
    expected = cluster_by_hand(scene)
    assert 300 < expected.sum() < 700
    np.testing.assert_array_equal(largest_cluster(scene), expected)


def test_dense_knots_are_connected():
    """The nearest neighbours of each are in its own knot, so nearest-neighbour links split it."""
    knots = np.repeat(disc(10, 1.0), 12, axis=0)
    jitter = np.random.default_rng(0).normal(0, 0.01, knots.shape)
    jitter[::12] *= 9
    apart = made(disc(12, 0.5) + np.array([0, 0, 30.0]), 0.1)
    scene = join_scenes([made(knots + jitter, 0.1), apart])
    expected = cluster_by_hand(scene)
    np.testing.assert_array_equal(largest_cluster(scene), expected)
    assert keep_largest_cluster(scene).count == expected.sum()


def test_the_cluster_with_more_gaussians_is_kept():
    few, many = made(disc(10, 5.0, 80.0), 1.2), made(disc(30, 1.0), 0.08)
    kept = keep_largest_cluster(join_scenes([few, many]))
    np.testing.assert_array_equal(kept.positions, many.positions)


# Real scenes


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["mouse/point_cloud.ply", "showroom_sh0.ply"])
def test_real_scenes_keep_nearly_all(name):
    scene = read_ply(shared_scene_path(name))
    assert 0 < np.count_nonzero(find_floaters(scene)) < 0.02 * scene.count
    assert largest_cluster(scene).mean() > 0.97
