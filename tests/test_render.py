"""Renderer against a slow reference, closed forms, its own symmetries and real photographs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from matplotlib.image import imread
from reference_renderer import MIN_ALPHA, render_reference
from scenes import random_scene, shared_scene_path, with_threads
from splats import TEAL, crowd, real_cameras, render, splats, straight, turned

from gs_codec.cameras.camera import Camera
from gs_codec.formats.ply.file import read_ply
from gs_codec.rendering.project import _project, project
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene

TOLERANCE = 1e-6
SIZES = [(70, 45), (33, 17), (16, 16), (1, 1)]
SUMS = ("weight", "squared_weight", "transmittance", "pixels")
# Cameras and scenes


def looking_along(direction, width=16, height=16) -> Camera:
    """A camera three units in front of the origin, along `direction`."""
    forward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross(np.roll(forward, 1) + np.array([0.1, 0.2, 0.3]), forward)
    right /= np.linalg.norm(right)
    return replace(
        straight(width, height),
        rotation=np.stack([right, np.cross(forward, right), forward]),
        position=-3 * forward,
    )


# Comparisons


def assert_matches(scene: Scene, camera: Camera, background=TEAL, antialiased=False):
    """Render with both; colours within `TOLERANCE` of the brightest, depth of itself."""
    result = render(scene, camera, background, antialiased=antialiased, accumulate=True)
    expected = render_reference(scene, camera, background, antialiased)
    decided = ~expected.undecided
    assert decided.mean() >= 0.95
    brightness = max(1.0, np.abs(expected.colour).max())
    for name, limit in (
        ("colour", TOLERANCE * brightness),
        ("alpha", TOLERANCE),
        ("depth", TOLERANCE * np.maximum(expected.depth, 1e-30)[decided]),
    ):
        error = np.abs(getattr(result, name)[decided] - getattr(expected, name)[decided])
        assert (error <= limit).all(), f"{name} is off by up to {error.max():g}"
    return result, expected


def assert_same_sums(result, expected) -> None:
    """Compare accumulations of the Gaussians not touching undecided pixels."""
    sure = ~expected.affected
    sums = result.accumulations
    np.testing.assert_array_equal(sums.pixels[sure], expected.pixels[sure])
    for name in SUMS[:3]:
        np.testing.assert_allclose(
            getattr(sums, name)[sure], getattr(expected, name)[sure], rtol=1e-6, err_msg=name
        )


def assert_identical(first, second) -> None:
    """Everything rendered has the same bits."""
    for name in ("colour", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)
    for name in SUMS:
        np.testing.assert_array_equal(
            getattr(first.accumulations, name), getattr(second.accumulations, name), name
        )


# Images against the reference


@pytest.mark.one_in(4)
@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("seed", [1, 2])
def test_images_match_the_reference(seed, sh_degree, size):
    camera = turned(seed, *size)
    scene = crowd(camera, 400, sh_degree, seed + 10 * sh_degree, pixels=5)
    result, expected = assert_matches(scene, camera)
    assert expected.stopped.mean() > 0.5
    assert result.alpha.min() > 0


@pytest.mark.parametrize("seed", [2, 3])
def test_sparse_images_match_the_reference(seed):
    camera = turned(seed)
    _, expected = assert_matches(crowd(camera, 60, 1, seed, pixels=2), camera)
    assert (expected.alpha == 0).any()
    assert expected.alpha.max() > 0.9


@pytest.mark.thorough
def test_thousands_of_gaussians_in_one_block_match_the_reference():
    camera = turned(4, 16, 16)
    scene = crowd(camera, 4000, 0, seed=4, pixels=0.5)
    assert_matches(replace(scene, opacity=scene.opacity - 3), camera)


def test_outputs_have_the_types_and_shapes_of_the_image():
    scene, camera = random_scene(20), straight(33, 17)
    result = render(scene, camera, accumulate=True)
    for name, shape in (("colour", (17, 33, 3)), ("alpha", (17, 33)), ("depth", (17, 33))):
        assert (getattr(result, name).dtype, getattr(result, name).shape) == (np.float32, shape)
    for name in SUMS:
        sums = getattr(result.accumulations, name)
        assert sums.dtype == (np.int64 if name == "pixels" else np.float64)
        assert sums.shape == (20,)


def test_accumulations_are_optional():
    camera = straight()
    scene = crowd(camera, 40, 0, seed=5)
    bare, full = render(scene, camera), render(scene, camera, accumulate=True)
    assert bare.accumulations is None
    for name in ("colour", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(full, name), name)


def test_the_background_is_black_unless_given():
    camera = straight()
    scene = crowd(camera, 40, 0, seed=6, pixels=2)
    black = render(scene, camera)
    white = render(scene, camera, background=(1.0, 1.0, 1.0))
    np.testing.assert_allclose(
        white.colour - black.colour, np.repeat(1 - black.alpha[:, :, None], 3, 2), atol=1e-6
    )
    assert black.alpha.min() == 0
    assert not black.colour[black.alpha == 0].any()


# Edges


class Edge(NamedTuple):
    scene: Scene
    visible: bool = True
    camera: Camera = straight()


def around(axis: int, angle: float) -> list[float]:
    """The quaternion of a turn around a coordinate axis."""
    turn = [float(np.cos(angle / 2)), 0.0, 0.0, 0.0]
    turn[1 + axis] = float(np.sin(angle / 2))
    return turn


def columns(rows) -> np.ndarray:
    return np.array(rows, np.float64).T


def distance_edges() -> dict[str, Edge]:
    """Gaussians nearer, farther and farther outside than cameras expect."""
    after, before = np.float32(0.2), np.float32(0.2)
    for _ in range(2):
        after, before = np.nextafter(after, np.float32(1)), np.nextafter(before, np.float32(0))
    outside = [(0.62 * x * 3, 0.45 * y * 3, 3) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
    return {
        "behind": Edge(splats([(0, 0, z) for z in (-9, -1, -0.2, -1e-6, 0, 1e-6)]), False),
        "at the camera": Edge(splats([(0, 0, 0)], log_scale=3.0), False),
        "on the near plane": Edge(
            splats([(0, 0, 0)], log_scale=1.0), False, straight(position=(0, 0, -0.2))
        ),
        "short of the near plane": Edge(splats([(0, 0, before)], log_scale=-3.0), False),
        "past the near plane": Edge(splats([(0, 0, after)], log_scale=-3.0)),
        "across the near plane": Edge(
            splats([(0.1 * z, -0.05, z) for z in np.linspace(-1.03, 1.1, 12)], log_scale=-0.5)
        ),
        "outside every border": Edge(splats(outside, log_scale=-1.0)),
        "out of reach": Edge(splats(np.array(outside) * [3, 3, 1], log_scale=-2.0), False),
        "far outside, huge": Edge(splats([(100, 0, 1), (0, -100, 1), (-90, 95, 2)], log_scale=5.0)),
        "beside the camera": Edge(splats([(50, 0, 0.21), (0, -50, 0.21)], log_scale=3.0)),
        "at the end of floats": Edge(splats([(3e38, 0, 1), (0, -3e38, 0.3)]), False),
        "at infinity": Edge(splats([(0, 0, 1e30), (1e29, 1e29, 1e30)], opacity=3.0)),
    }


def shape_edges() -> dict[str, Edge]:
    """Gaussians of every size, needles and discs."""
    middle, places = [(0.2, -0.1, 3)], [(0.3 * i - 1, 0.1 * i - 0.4, 3 + 0.1 * i) for i in range(8)]
    angles = np.linspace(0, np.pi, 8, endpoint=False) + 0.05
    in_image = columns([around(2, angle) for angle in angles])
    in_depth = columns([around(1, angle) for angle in angles])
    random = np.random.default_rng(7).normal(size=(4, 8))
    needle = np.log([[2.0], [2e-4], [2e-4]])
    disc = [[-14.0], [0.0], [0.0]]
    sizes = {size: Edge(splats(middle, log_scale=size)) for size in (5, 20, -30, -1e30)}
    return {f"log-scale {size:g}": edge for size, edge in sizes.items()} | {
        "log-scale 300": Edge(splats(middle, log_scale=300), False),
        "log-scale 1e30": Edge(splats(middle, log_scale=1e30), False),
        "one axis of log-scale 1e30": Edge(splats(middle, log_scale=[[-2], [1e30], [-2]]), False),
        "opaque speck": Edge(splats([(0.025, 0, 3)], opacity=9.0, log_scale=-30)),
        "huge, off the axis": Edge(splats([(1, 1, 2), (-1.2, 0.3, 1)], log_scale=12.0)),
        "needles in the image": Edge(splats(places, log_scale=needle, rot=in_image)),
        "needles into the image": Edge(splats(places, log_scale=needle, rot=in_depth)),
        "needles anyhow": Edge(splats(places, log_scale=needle, rot=random)),
        "long needles": Edge(splats(places, log_scale=needle + 4, rot=in_image)),
        "discs edge on": Edge(splats([(0, 0, 3), (0.0, 0.2, 4)], log_scale=disc)),
        "discs": Edge(splats(places, log_scale=disc, rot=in_depth)),
        "discs anyhow": Edge(splats(places, log_scale=disc, rot=random)),
    }


def value_edges() -> dict[str, Edge]:
    """Attributes at their limits, and coincident Gaussians."""
    row = [(0.25 * i - 0.8, 0.05 * i, 3 + 0.1 * i) for i in range(7)]
    turn, long = np.array([0.3, -0.5, 0.7, 0.2]), [[-1.0], [-2.5], [-3.5]]
    quaternions = [0 * turn, -0 * turn, 1e-30 * turn, 2e-44 * turn, 4e38 * turn, 7 * turn, -turn]
    dark = [[-5.0], [-1.7725], [4.0]]
    return {
        "quaternions of any norm": Edge(
            splats(row, log_scale=long, rot=np.float32(columns(quaternions)))
        ),
        "opacities from none to all": Edge(
            splats(row, opacity=[-1e4, -100, -5, 0, 5, 100, 1e4], log_scale=-1.5)
        ),
        "opacity of none": Edge(splats(row[:1], opacity=-1e4), False),
        "opacity below a step": Edge(splats(row[:1], opacity=-5.6, log_scale=1.0), False),
        "opacity above a step": Edge(splats(row[:1], opacity=-5.5, log_scale=1.0)),
        "negative colours": Edge(splats(row, f_dc=dark, opacity=3.0)),
        "bright colours": Edge(splats(row, f_dc=1e6)),
        "one depth": Edge(splats([(x, y, 3) for x, y, _ in row], opacity=2.5, log_scale=-0.5)),
        "one depth and place": Edge(splats([(0, 0, 3)] * 30, opacity=-1.0, log_scale=-1.0)),
        "identical": Edge(splats([(0.1, 0.2, 2)] * 200, f_dc=0.3, opacity=0.5)),
        "none": Edge(splats([]), False),
        "none of degree 3": Edge(random_scene(0, 3), False),
        "one": Edge(splats([(0.1, 0.2, 2)])),
    }


def camera_edges() -> dict[str, Edge]:
    """Images and intrinsics of every kind."""
    cameras = {
        f"{width} x {height}": turned(8, width, height)
        for width, height in ((15, 16), (17, 1), (1, 33), (16, 32), (129, 3))
    }
    cameras |= {
        "principal point off the centre": turned(9, cx=12.0, cy=39.0),
        "principal point outside": turned(9, cx=-150.0, cy=90.0),
        "principal point far outside": turned(9, cx=1500.0, cy=20.0),
        "oblong pixels": turned(10, fx=40.0, fy=110.0),
        "wide angle": turned(11, fx=6.0, fy=6.0),
        "telephoto": turned(12, fx=4000.0, fy=4000.0),
    }
    return {
        name: Edge(crowd(camera, 80, 1, seed=13), camera=camera) for name, camera in cameras.items()
    }


EDGES = distance_edges() | shape_edges() | value_edges() | camera_edges()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("name", EDGES)
def test_edges_match_the_reference(name, antialiased):
    scene, visible, camera = EDGES[name]
    result, expected = assert_matches(scene, camera, antialiased=antialiased)
    if not antialiased:
        assert (expected.alpha.max() > 0) == visible
    assert_same_sums(result, expected)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", {**distance_edges(), **shape_edges(), **value_edges()})
def test_edge_cases_among_many_gaussians_match_the_reference(name):
    edge, _, camera = EDGES[name]
    others = crowd(camera, 60, 0, seed=14)
    if edge.sh_degree:
        others = edge
    planes = {group: np.hstack([getattr(others, group), getattr(edge, group)]) for group in GROUPS}
    assert_matches(Scene(**planes), camera)


@pytest.mark.parametrize(
    "scale", [[300, 300, 300], [80, -80, 0], [60, 60, -1e30], [20, -1e30, -1e30]], ids=str
)
def test_sizes_beyond_float64_keep_the_image_finite(scale):
    camera = straight()
    others = crowd(camera, 60, 0, seed=15)
    planes = {group: getattr(others, group).copy() for group in GROUPS}
    planes["log_scale"][:, 30] = scale
    result = render(Scene(**planes), camera, TEAL, accumulate=True)
    for name in ("colour", "alpha", "depth"):
        assert np.isfinite(getattr(result, name)).all()
    for name in SUMS:
        assert np.isfinite(getattr(result.accumulations, name)).all()
    assert (result.alpha <= 1).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf], ids=str)
@pytest.mark.parametrize("group", GROUPS)
def test_nonfinite_gaussians_are_not_drawn(group, value):
    camera = straight()
    scene = crowd(camera, 60, 1, seed=16)
    before = render(scene, camera, TEAL, accumulate=True)
    plane = getattr(scene, group).copy()
    bad = np.argsort(-before.accumulations.weight)[:6]
    plane[-1, bad] = value
    broken = replace(scene, **{group: plane})
    result = render(broken, camera, TEAL, accumulate=True)
    kept = np.setdiff1d(np.arange(60), bad)
    expected = render(scene.take(kept), camera, TEAL, accumulate=True)
    for name in ("colour", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(result, name), getattr(expected, name))
    for name in SUMS:
        sums = getattr(result.accumulations, name)
        np.testing.assert_array_equal(sums[kept], getattr(expected.accumulations, name))
        assert not sums[bad].any()


def test_equal_depths_are_drawn_in_the_order_of_the_scene():
    red, green = [[1.0], [-3.0], [-3.0]], [[-3.0], [1.0], [-3.0]]
    scene = splats([(0, 0, 3)] * 2, f_dc=np.hstack([red, green]), opacity=3.0, log_scale=1.0)
    first = render(scene, straight()).colour[22, 35]
    second = render(scene.take(np.array([1, 0])), straight()).colour[22, 35]
    assert first[0] > 10 * first[1]
    np.testing.assert_array_equal(first, second[[1, 0, 2]])


# Antialiasing


@pytest.mark.parametrize("pixels", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("seed", [17, 18])
def test_antialiased_images_match_the_reference(seed, pixels):
    camera = turned(seed)
    result, expected = assert_matches(crowd(camera, 200, 1, seed, pixels), camera, antialiased=True)
    assert_same_sums(result, expected)


def test_antialiasing_fades_only_small_splats():
    camera = straight(33, 17)

    def both(log_scale):
        scene = splats([(0, 0, 3)], log_scale=log_scale)
        modes = (render(scene, camera, antialiased=mode).alpha.max() for mode in (False, True))
        return tuple(modes)

    plain, thinned = both(-30.0)
    np.testing.assert_allclose(thinned, 0, atol=1e-9)  # 0.005 of the opacity is below a step
    assert plain > 0.1
    plain, thinned = both(np.log(0.05))
    variance = (60 * 0.05 / 3) ** 2
    np.testing.assert_allclose(thinned / plain, variance / (variance + 0.3), rtol=1e-5)
    plain, thinned = both(0.0)
    np.testing.assert_allclose(thinned, plain, rtol=1e-3)


@pytest.mark.parametrize("comment", ["SplatRenderMode: mip", "antialiased 1"])
def test_a_comment_of_the_file_switches_antialiasing_on(comment):
    camera = straight()
    plain = crowd(camera, 100, 0, seed=19, pixels=0.5)
    marked = replace(plain, comments=("Generated by hand", comment))
    off, on = (render(plain, camera, antialiased=mode).colour for mode in (False, True))
    assert np.abs(off - on).max() > 0.05
    np.testing.assert_array_equal(render(marked, camera).colour, on)
    np.testing.assert_array_equal(render(marked, camera, antialiased=False).colour, off)
    np.testing.assert_array_equal(render(plain, camera).colour, off)


@pytest.mark.parametrize("comment", ["SplatRenderMode: default", "antialiased 0", "mip"])
def test_other_comments_leave_antialiasing_off(comment):
    camera = straight()
    plain = crowd(camera, 100, 0, seed=20, pixels=0.5)
    np.testing.assert_array_equal(
        render(replace(plain, comments=(comment,)), camera).colour, render(plain, camera).colour
    )


# Accumulations


@pytest.mark.parametrize("size", [(33, 17), (16, 16), (70, 45)], ids=str)
@pytest.mark.parametrize("seed", [21, 22, 23])
def test_accumulations_match_the_reference(seed, size):
    camera = turned(seed, *size)
    scene = crowd(camera, 120, 0, seed)
    result, expected = assert_matches(scene, camera)
    assert expected.affected.mean() < 0.2
    assert (expected.pixels == 0).any()
    assert (expected.pixels > 20).any()
    assert_same_sums(result, expected)


@pytest.mark.parametrize("seed", [24, 25])
def test_weights_sum_to_the_alpha_of_the_image(seed):
    camera = turned(seed)
    result = render(crowd(camera, 400, 0, seed), camera, accumulate=True)
    np.testing.assert_allclose(
        result.accumulations.weight.sum(), result.alpha.sum(dtype=np.float64), rtol=1e-6
    )


# Independence from threads, order and memory


@pytest.mark.parametrize("seed", [26, 27])
def test_threads_do_not_change_a_bit(seed):
    camera = turned(seed)
    scene = crowd(camera, 400, 3, seed)
    one, *more, default = (
        with_threads(n, partial(render, scene, camera, TEAL, accumulate=True))
        for n in (1, 2, 3, None)
    )
    for other in (*more, default):
        assert_identical(one, other)
    assert one.accumulations.pixels.any()


@pytest.mark.thorough
def test_scene_and_camera_are_not_modified():
    camera = turned(28)
    scene = crowd(camera, 100, 2, seed=28)
    copies = {group: getattr(scene, group).copy() for group in GROUPS}
    expected = render(scene, camera, TEAL, accumulate=True)
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(scene, group), copies[group])
        getattr(scene, group).setflags(write=False)
    camera.rotation.setflags(write=False)
    camera.position.setflags(write=False)
    assert_identical(render(scene, camera, TEAL, accumulate=True), expected)


def test_planes_need_not_be_contiguous():
    camera = turned(29)
    scene = crowd(camera, 100, 2, seed=29)
    strided = {group: np.repeat(getattr(scene, group), 2, axis=1)[:, ::2] for group in GROUPS}
    fortran = {group: np.asfortranarray(getattr(scene, group)) for group in GROUPS}
    sliced = {group: np.tile(getattr(scene, group), 2)[:, :100] for group in GROUPS}
    expected = render(scene, camera, TEAL, accumulate=True)
    compiled = set()
    for planes in (strided, fortran, sliced):
        result = render(Scene(**planes), camera, TEAL, accumulate=True)
        assert_identical(result, expected)
        for start, stop in ((0, 100), (40, 90)):
            found = project(Scene(**planes), camera, True, start, stop)
            for ours, same in zip(found, project(scene, camera, True, start, stop), strict=True):
                np.testing.assert_array_equal(ours, same)
        compiled.add(len(_project.signatures))
    assert len(compiled) == 1  # none except for strided arrays


@pytest.mark.parametrize("seed", [30, 31])
def test_the_order_of_a_scene_does_not_matter(seed):
    camera = turned(seed)
    scene = crowd(camera, 300, 1, seed)
    order = np.random.default_rng(seed).permutation(300)
    first = render(scene, camera, TEAL, accumulate=True)
    second = render(scene.take(order), camera, TEAL, accumulate=True)
    np.testing.assert_allclose(second.colour, first.colour, rtol=0, atol=1e-6)
    np.testing.assert_allclose(second.alpha, first.alpha, rtol=0, atol=1e-6)
    np.testing.assert_allclose(second.depth, first.depth, rtol=1e-6)
    for name in SUMS:
        np.testing.assert_allclose(
            getattr(second.accumulations, name),
            getattr(first.accumulations, name)[order],
            rtol=1e-6,
            err_msg=name,
        )


# Closed forms


@pytest.mark.parametrize("sigma", [0.005, 0.05, 0.3])
def test_a_splat_on_the_axis_is_a_round_gaussian(sigma):
    camera = straight(16, 16, fx=40.0, fy=40.0)
    scene = splats([(0, 0, 2)], f_dc=0.7, opacity=1.5, log_scale=np.log(sigma))
    result = render(scene, camera, accumulate=True)
    offset = np.arange(16) + 0.5 - 8
    variance = (40 * sigma / 2) ** 2 + 0.3
    opacity = 1 / (1 + np.exp(-1.5))
    alpha = opacity * np.exp(-(offset**2 + offset[:, None] ** 2) / (2 * variance))
    alpha[alpha < MIN_ALPHA] = 0
    np.testing.assert_allclose(result.alpha, alpha, atol=1e-6)
    shade = 0.5 + 0.7 / (2 * np.sqrt(np.pi))
    np.testing.assert_allclose(result.colour, np.repeat(alpha[:, :, None] * shade, 3, 2), atol=1e-6)
    np.testing.assert_allclose(result.depth, np.where(alpha > 0, 2, 0), rtol=1e-6)
    sums = result.accumulations
    np.testing.assert_allclose(sums.weight, alpha.sum(), rtol=1e-6)
    np.testing.assert_allclose(sums.squared_weight, (alpha**2).sum(), rtol=1e-6)
    assert sums.pixels == sums.transmittance == (alpha > 0).sum()


def test_a_splat_ends_with_the_blocks_of_three_sigmas():
    # The box is 3 +- 60 pixels: it ends at block 3, where exp(-61^2 / 2 / 399) is not yet small.
    camera = straight(96, 16, fx=100.0, fy=100.0, cx=3.5)
    scene = splats([(0, 0, 1)], opacity=9.0, log_scale=np.log(np.sqrt(399 - 0.3) / 100))
    alpha = render(scene, camera).alpha[8]
    assert alpha[63] > 2 * MIN_ALPHA
    assert not alpha[64:].any()


def test_two_splats_are_blended_front_to_back():
    camera = straight(16, 16, fx=40.0, fy=40.0)
    scene = splats([(0, 0, 4), (0, 0, 2)], opacity=[[0.4, -0.6]], log_scale=3.0)
    result = render(scene, camera, TEAL)
    back, front = 1 / (1 + np.exp(-np.array([0.4, -0.6])))
    shades = 0.5 + scene.f_dc / (2 * np.sqrt(np.pi))
    weights = np.array([back * (1 - front), front])
    passed = 1 - weights.sum()
    centre = (7, 8)
    np.testing.assert_allclose(
        result.colour[centre], shades @ weights + passed * np.array(TEAL), atol=1e-5
    )
    np.testing.assert_allclose(result.alpha[centre], 1 - passed, atol=1e-5)
    np.testing.assert_allclose(result.depth[centre], weights @ [4, 2] / weights.sum(), rtol=1e-5)


# Orthonormal real harmonics with the Condon-Shortley sign, at directions where they are simple.
DEGREE_1, DEGREE_2, DEGREE_3 = (
    np.sqrt(3 / (4 * np.pi)),
    np.sqrt(15 / (4 * np.pi)),
    np.sqrt(7 / np.pi),
)
HARMONICS = [
    (1, (0, 1, 0), -DEGREE_1),
    (2, (0, 0, 1), DEGREE_1),
    (3, (1, 0, 0), -DEGREE_1),
    (4, (1, 1, 0), DEGREE_2 / 2),
    (5, (0, 1, 1), -DEGREE_2 / 2),
    (6, (0, 0, 1), np.sqrt(5 / (4 * np.pi))),
    (7, (1, 0, 1), -DEGREE_2 / 2),
    (8, (1, 0, 0), DEGREE_2 / 2),
    (9, (0, 1, 0), DEGREE_3 * np.sqrt(5 / 32)),
    (10, (1, 1, 1), DEGREE_3 * np.sqrt(15 / 4 / 27)),
    (11, (0, 1, 0), DEGREE_3 * np.sqrt(3 / 32)),
    (12, (0, 0, 1), DEGREE_3 / 2),
    (13, (1, 0, 0), DEGREE_3 * np.sqrt(3 / 32)),
    (14, (1, 0, 1), DEGREE_3 * np.sqrt(15 / 16 / 8)),
    (15, (1, 0, 0), -DEGREE_3 * np.sqrt(5 / 32)),
]


@pytest.mark.parametrize("side", [1, -1], ids=["towards", "opposite"])
@pytest.mark.parametrize(("coefficient", "direction", "value"), HARMONICS)
def test_each_harmonic_has_its_sign_and_colour(coefficient, direction, value, side):
    degree = int(np.sqrt(coefficient))
    rest = np.zeros((3, SH_COEFFICIENTS[degree]))
    amounts = np.array([0.5, -0.3, 0.1])
    rest[:, coefficient - 1] = amounts
    scene = splats([(0, 0, 0)], f_dc=0.0, f_rest=rest.reshape(-1, 1), opacity=20.0, log_scale=-1)
    result = render(scene, looking_along(side * np.array(direction)))
    np.testing.assert_allclose(
        result.colour[7, 7] / result.alpha[7, 7], 0.5 + amounts * value * side**degree, rtol=1e-5
    )


# Real scenes


@pytest.fixture(scope="module")
def bonsai() -> Scene:
    return read_ply(shared_scene_path("bonsai/point_cloud.ply"))


@pytest.mark.parametrize("view", [2, 18, 36])
def test_real_views_look_like_their_photographs(bonsai, view):
    camera = real_cameras()[view]
    photograph = imread(shared_scene_path(f"bonsai/images/{camera.name}.png"))[:, :, :3]
    image = np.clip(render(bonsai, camera).colour, 0, 1)
    psnr = -10 * np.log10(np.mean((image - photograph).astype(np.float64) ** 2))
    assert psnr > 25


@pytest.mark.thorough
def test_a_real_scene_matches_the_reference(bonsai):
    camera = real_cameras()[5].resized(50, 33)
    sample = np.random.default_rng(32).permutation(bonsai.count)[:6000]
    _, expected = assert_matches(bonsai.take(np.sort(sample)), camera)
    assert expected.alpha.mean() > 0.3


@pytest.mark.parametrize("short", [-8, -80])
@pytest.mark.parametrize("length", [8, 14, 18, 80])
def test_needles_of_any_length_match_the_reference(length, short):
    needle = splats(
        [(0, 0, 3)],
        opacity=3.0,
        log_scale=[[length], [short], [short]],
        rot=[[0.9], [0.1], [0.3], [0.5]],
    )
    _, expected = assert_matches(needle, straight())
    assert expected.alpha.max() > 0.9
