"""Decimation: moments and errors of merges by brute force, exact counts, views against dropping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import assert_same_floats, edge_scenes, random_scene, with_threads

from gs_codec.cameras.camera import Camera
from gs_codec.edit.decimation import decimate
from gs_codec.errors import InvalidInput
from gs_codec.formats.similarity import rotation_of
from gs_codec.merging.pairs import blobs_of, lone_errors, merge_errors, merge_pairs
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.prune import expected_weight, keep_highest, leave_one_out
from gs_codec.preparation.reference_views import ReferenceViews, draw_reference_views
from gs_codec.scene import GROUPS, SH_C0, Scene

BLACK = (0.0, 0.0, 0.0)


def camera(x: float, z: float = -4.0) -> Camera:
    return Camera(f"{x} {z}", 64, 48, 60.0, 60.0, 32, 24, np.eye(3), np.array([x, 0.0, z]))


GUIDES = [camera(x) for x in (-1.2, -0.4, 0.4, 1.2)]
OTHERS = [camera(x, -3.7) for x in (-0.8, 0.0, 0.8)]


def painted_scene(count: int, seed: int, sh_degree: int = 1) -> Scene:
    """A wavy wall of small Gaussians, painted in stripes."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, count))
    scene = random_scene(count, sh_degree, seed)
    planes = {
        "positions": np.stack([x, y, 0.3 * np.sin(3 * x) + rng.normal(0, 0.01, count)]),
        "f_dc": np.stack([np.sin(5 * x), np.cos(4 * y), np.sin(3 * (x + y))]),
        "log_scale": rng.normal([[-2.6], [-2.6], [-4.0]], 0.2, (3, count)),
        "opacity": rng.normal(1.0, 1.5, (1, count)),
        "rot": np.array([[1.0], [0], [0], [0]]) + rng.normal(0, 0.1, (4, count)),
    }
    return replace(scene, **{name: plane.astype(np.float32) for name, plane in planes.items()})


def covariance(scene: Scene, i: int) -> np.ndarray:
    turn = rotation_of(scene.rot[:, i])
    return turn @ np.diag(np.exp(2 * scene.log_scale[:, i].astype(np.float64))) @ turn.T


def opacity(scene: Scene, i: int) -> float:
    return 1 / (1 + np.exp(-float(scene.opacity[0, i])))


def area(matrix: np.ndarray) -> float:
    """Root mean square of the projected area over random directions, divided by 2 pi."""
    n = np.random.default_rng(0).normal(size=(200_000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    adjugate = np.linalg.inv(matrix) * np.linalg.det(matrix)
    return float(np.sqrt(np.mean(np.einsum("ni,ij,nj->n", n, adjugate, n))))


# Moments


@pytest.mark.one_in(4)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sh_degree", range(4))
def test_a_merge_keeps_mass_mean_and_covariance(seed, sh_degree):
    scene = random_scene(2, sh_degree, seed)
    sizes = np.random.default_rng(seed).normal(-1, 0.7, (3, 2)).astype(np.float32)
    scene = replace(scene, log_scale=sizes, opacity=np.array([[-3.0, -1.0]], np.float32))
    one = merge_pairs(scene, blobs_of(scene), np.array([0]), np.array([1]))
    matrices = [covariance(scene, i) for i in range(2)]
    masses = np.array([opacity(scene, i) * area(matrices[i]) for i in range(2)])
    shares, centres = masses / masses.sum(), scene.positions.T.astype(np.float64)
    mean = shares @ centres
    # The sum of second moments about the origin, minus the mean's.
    moment = sum(
        w * (m + np.outer(c, c)) for w, m, c in zip(shares, matrices, centres, strict=True)
    )
    np.testing.assert_allclose(one.positions[:, 0], mean, atol=0.01)
    np.testing.assert_allclose(covariance(one, 0), moment - np.outer(mean, mean), atol=0.01)
    np.testing.assert_allclose(opacity(one, 0) * area(covariance(one, 0)), masses.sum(), rtol=0.01)
    for group in ("f_dc", "f_rest"):
        expected = getattr(scene, group).astype(np.float64) @ shares
        np.testing.assert_allclose(getattr(one, group)[:, 0], expected, atol=0.02)


def test_two_equal_gaussians_give_one_that_is_twice_as_opaque():
    scene = random_scene(1, 3, 5).take(np.array([0, 0]))
    for logit, expected in ((-2.0, 2 / (1 + np.exp(2.0))), (3.0, 0.99)):
        both = replace(scene, opacity=np.full((1, 2), logit, np.float32))
        one = merge_pairs(both, blobs_of(both), np.array([0]), np.array([1]))
        assert opacity(one, 0) == pytest.approx(expected, rel=1e-5)
        np.testing.assert_allclose(covariance(one, 0), covariance(both, 0), rtol=1e-4, atol=1e-9)
        for group in ("positions", "f_dc", "f_rest"):
            np.testing.assert_allclose(getattr(one, group), getattr(both, group)[:, :1], rtol=1e-6)


# Errors


def splat(scene: Scene, i: int, axis: int, grid: np.ndarray) -> np.ndarray:
    """Alpha of a Gaussian projected along an axis."""
    seen = [axis, (axis + 1) % 3]
    matrix = np.linalg.inv(covariance(scene, i)[np.ix_(seen, seen)])
    apart = grid - scene.positions[seen, i].astype(np.float64)
    return opacity(scene, i) * np.exp(-0.5 * np.einsum("...i,ij,...j->...", apart, matrix, apart))


@pytest.mark.parametrize("seed", range(5))
def test_errors_are_those_of_images(seed):
    rng = np.random.default_rng(seed)
    scene = replace(
        random_scene(2, 0, seed),
        positions=rng.normal(0, 0.4, (3, 2)).astype(np.float32),
        log_scale=rng.normal(-1, 0.3, (3, 2)).astype(np.float32),
    )
    colours, blobs = rng.normal(size=(2, 4)), blobs_of(scene)
    one = merge_pairs(scene, blobs, np.array([0]), np.array([1]))
    share = blobs.mass[1] / blobs.mass.sum()
    steps = np.linspace(-6, 6, 241)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    pixel = (steps[1] - steps[0]) ** 2 / np.pi
    merged, alone = 0.0, np.zeros(2)
    for axis in range(3):
        images = [splat(scene, i, axis, grid)[..., None] * colours[i] for i in range(2)]
        mean = colours[0] * (1 - share) + colours[1] * share
        change = images[0] + images[1] - splat(one, 0, axis, grid)[..., None] * mean
        merged += pixel * np.sum(change**2)
        alone += [pixel * np.sum(image**2) for image in images]
    errors = merge_errors(blobs, colours, np.array([[0, 1], [0, 1]]))
    np.testing.assert_allclose(lone_errors(blobs, colours), alone, rtol=1e-3)
    np.testing.assert_allclose(errors, [[np.inf, merged], [np.inf, np.inf]], rtol=1e-3)


# Counts and order


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", edge_scenes())
def test_the_number_is_exact(name):
    scene = edge_scenes()[name]
    for number in {1, 2, scene.count // 3, scene.count - 1, scene.count, scene.count + 1} - {0, -1}:
        left = decimate(scene, number)
        assert left.count == min(number, scene.count)
        assert all(np.isfinite(getattr(left, group)).all() for group in GROUPS)
        if number >= scene.count:
            assert left is scene


@pytest.mark.parametrize("sh_degree", range(4))
def test_degree_comments_and_normals_are_kept(sh_degree):
    scene = replace(random_scene(50, sh_degree, 1), comments=("made by hand",), has_normals=True)
    left = decimate(scene, 20)
    assert (left.sh_degree, left.comments, left.has_normals) == (sh_degree, scene.comments, True)


def test_a_number_below_one_is_refused():
    with pytest.raises(InvalidInput, match="gaussians 0: expected at least 1"):
        decimate(random_scene(5), 0)


def test_threads_do_not_matter_and_the_argument_is_unchanged():
    scene = painted_scene(6000, 3)
    before = scene.take(np.arange(scene.count))
    first = with_threads(1, decimate, scene, 1000)
    assert_same_floats(first, with_threads(4, decimate, scene, 1000))
    assert_same_floats(scene, before)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("group", GROUPS)
def test_nonfinite_gaussians_are_removed_first(value, group):
    scene = painted_scene(40, 4)
    plane = getattr(scene, group).copy()
    plane[0, [3, 7, 21]] = value
    broken = replace(scene, **{group: plane}, extra={"number": np.arange(40, dtype=np.int32)})
    left = decimate(broken, 37)
    assert left.extra["number"].tolist() == [i for i in range(40) if i not in (3, 7, 21)]
    left = decimate(broken, 38)
    assert left.extra["number"].tolist() == [i for i in range(40) if i not in (3, 7)]
    assert np.isfinite(getattr(decimate(broken, 30), group)).all()


def test_quaternions_of_norm_zero_are_the_identity():
    scene = painted_scene(60, 5)
    rot = scene.rot.copy()
    rot[:, ::2] = 0
    unit = rot.copy()
    unit[0, ::2] = 1
    assert_same_floats(
        decimate(replace(scene, rot=rot), 20), decimate(replace(scene, rot=unit), 20)
    )


def test_properties_are_those_of_the_heavier():
    scene = random_scene(2, 1, 6)
    for heavier in (0, 1):
        logits = np.array([[-1.0, -1.0]], np.float32)
        logits[0, heavier] = 0.0
        twins = replace(
            scene.take(np.array([0, 0])), opacity=logits, extra={"number": np.array([4.5, 6.5])}
        )
        left = decimate(twins, 1)
        assert left.extra["number"].tolist() == [4.5 + 2 * heavier]
        # They were merged: neither twin is as opaque.
        assert opacity(left, 0) == pytest.approx(opacity(twins, 0) + opacity(twins, 1), rel=1e-5)


def test_unmerged_gaussians_keep_bits_and_order():
    scene = replace(painted_scene(300, 7), extra={"number": np.arange(300, dtype=np.int32)})
    left = decimate(scene, 280)
    numbers = left.extra["number"]
    assert (np.diff(numbers) > 0).all()
    same = (left.positions == scene.positions[:, numbers]).all(axis=0)
    assert 260 <= np.count_nonzero(same) < 280
    assert_same_floats(left.take(same), scene.take(numbers[same]))


# Views


def error(scene: Scene, views: ReferenceViews) -> float:
    return views.error(replace(scene))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("percent", [20, 50])
def test_merging_without_cameras_looks_better_than_dropping(seed, percent):
    scene = painted_scene(1500, seed)
    number = scene.count * percent // 100
    views = draw_reference_views(scene, OTHERS, BLACK)
    scores = expected_weight(scene)
    dropped = scene.take(keep_highest(scores, scene.count - number))
    assert error(decimate(scene, number), views) < 0.5 * error(dropped, views)


@pytest.mark.parametrize("seed", range(2))
def test_views_guide_it(seed):
    scene = painted_scene(1500, seed)
    views = draw_reference_views(scene, OTHERS, BLACK)
    guides = draw_reference_views(scene, GUIDES, BLACK)
    left = decimate(scene, 300, Plan(cameras=GUIDES))
    assert left.count == 300
    assert error(left, views) < error(decimate(scene, 300), views)
    scores = leave_one_out(scene, guides, "test")
    dropped = scene.take(keep_highest(scores, 1200))
    assert error(left, views) < 0.5 * error(dropped, views)


def test_steps_of_a_plan_do_not_count():
    scene = painted_scene(300, 8)
    plan = Plan(cameras=GUIDES)
    steps = replace(plan, steps=Steps(prune=50, rectify=1))
    assert_same_floats(decimate(scene, 100, plan), decimate(scene, 100, steps))


def test_gaussians_with_a_distinct_colour_are_kept_longest():
    scene = painted_scene(400, 9, 0)
    f_dc = np.full_like(scene.f_dc, 0.2 / SH_C0)
    f_dc[:, 123] = (-0.5 / SH_C0, 0.5 / SH_C0, -0.5 / SH_C0)
    logits = np.full_like(scene.opacity, 2.0)
    left = decimate(replace(scene, f_dc=f_dc, opacity=logits), 100)
    np.testing.assert_array_equal((left.f_dc == f_dc[:, 123:124]).all(axis=0).sum(), 1)


def test_progress_counts_rounds():
    seen: list[tuple[str, int, int]] = []
    decimate(random_scene(100), 50, progress=lambda *step: seen.append(step))
    assert seen == [("decimate", n, 4) for n in (1, 2, 3, 4)]
