"""Distorted lenses: replacement by pinhole cameras, and undistorted photographs.

The formulas of the models are repeated here from COLMAP's documentation.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from camera_files import Image, Intrinsics, both_forms, write_model
from scenes import random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import read_image, write_png
from gs_codec.cameras.lens import Lens
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.metrics.views import compare_views
from gs_codec.preparation.reference_views import photographed, read_photographs
from gs_codec.views.find import find_cameras
from gs_codec.views.photographs import read_photograph

SIDES = (800, 600)

#: Parameters of each model, and COLMAP 4.2.1's result for a photograph of 800x600 pixels: width,
#: height, cx and cy (`pycolmap.undistort_camera`; focal lengths do not change).
MODELS = {
    "SIMPLE_RADIAL": ((500.0, 400.0, 290.0, -0.08), (847, 616, 423.5, 297.73333333333335)),
    "RADIAL": ((500.0, 400.0, 300.0, 0.1, 0.02), (728, 546, 364.0, 273.0)),
    "OPENCV": (
        (500.0, 520.0, 380.0, 310.0, -0.12, 0.03, 0.002, -0.001),
        (853, 620, 405.175, 320.3333333333333),
    ),
    "FULL_OPENCV": (
        (500.0, 520.0, 380.0, 310.0, -0.12, 0.03, 0.002, -0.001, 0.01, 0.02, 0.003, 0.001),
        (864, 624, 410.4, 322.4),
    ),
    "SIMPLE_RADIAL_FISHEYE": ((400.0, 410.0, 300.0, 0.05), (1108, 714, 567.85, 357.0)),
    "RADIAL_FISHEYE": ((400.0, 400.0, 290.0, 0.05, -0.01), (1148, 708, 574.0, 342.2)),
    "OPENCV_FISHEYE": (
        (400.0, 390.0, 400.0, 300.0, 0.05, -0.01, 0.003, -0.001),
        (1145, 725, 572.5, 362.5),
    ),
}
each_model = pytest.mark.parametrize("model", MODELS)
needs_opencv = pytest.mark.usefixtures("opencv")


@pytest.fixture
def opencv() -> None:
    pytest.importorskip("cv2", reason="the extra 'undistort' is not installed")


# The formulas


def brown(u: float, v: float, k: Sequence[float], p1: float = 0, p2: float = 0, *q: float):
    """k1, k2, k3 of the numerator; tangential terms; k4, k5, k6 of the denominator."""
    r2 = u**2 + v**2
    radial = 1 + sum(c * r2 ** (i + 1) for i, c in enumerate(k))
    radial /= 1 + sum(c * r2 ** (i + 1) for i, c in enumerate(q))
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u**2)
    return x, v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v**2)


def fisheye(u: float, v: float, k: Sequence[float]):
    r = math.hypot(u, v)
    theta = math.atan(r)
    seen = theta * (1 + sum(c * theta ** (2 * i + 2) for i, c in enumerate(k)))
    return (u * seen / r, v * seen / r) if r else (u, v)


FORMULAS: dict[str, Callable[..., tuple[float, float]]] = {
    "SIMPLE_RADIAL": lambda u, v, k: brown(u, v, [k]),
    "RADIAL": lambda u, v, *k: brown(u, v, k),
    "OPENCV": lambda u, v, k1, k2, p1, p2: brown(u, v, (k1, k2), p1, p2),
    "FULL_OPENCV": lambda u, v, k1, k2, p1, p2, k3, *q: brown(u, v, (k1, k2, k3), p1, p2, *q),
    "SIMPLE_RADIAL_FISHEYE": lambda u, v, k: fisheye(u, v, [k]),
    "RADIAL_FISHEYE": lambda u, v, *k: fisheye(u, v, k),
    "OPENCV_FISHEYE": lambda u, v, *k: fisheye(u, v, k),
}


def photographed_at(model: str, point: Sequence[float]) -> tuple[float, float]:
    """The pixel of the distorted photograph that shows a point in camera axes."""
    parameters = MODELS[model][0]
    one = model in ("SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
    fx, fy, cx, cy, *rest = parameters[:1] * one + parameters
    x, y = FORMULAS[model](point[0] / point[2], point[1] / point[2], *rest)
    return fx * x + cx, fy * y + cy


def seen_by(camera: Camera, point: Sequence[float]) -> tuple[float, float]:
    x, y, z = point
    return camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy


def camera_of(model: str, folder: Path, name: str = "a.png") -> Camera:
    """A camera at the origin that looks along z, read from a COLMAP model."""
    intrinsics = Intrinsics(1, model, *SIDES, MODELS[model][0])
    image = Image(name, quaternion=(1, 0, 0, 0), translation=(0, 0, 0))
    (camera,) = read_cameras(write_model(folder / "model", ".txt", [image], [intrinsics]))
    return camera


def points(camera: Camera) -> list[tuple[float, float, float]]:
    """Points in space, spread over the camera's image, well separated."""
    rng = np.random.default_rng(7)
    cells = np.array([(x, y) for x in range(5) for y in range(4)])
    inside = (cells + rng.uniform(0.3, 0.7, cells.shape)) / (5, 4) * (camera.width, camera.height)
    planar = (inside - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    depths = rng.uniform(1, 9, len(cells))
    return [(x * z, y * z, z) for (x, y), z in zip(planar, depths, strict=True)]


# Cameras


@each_model
@both_forms
def test_camera_is_that_of_colmaps_undistorter(suffix, model, tmp_path):
    parameters, (width, height, cx, cy) = MODELS[model]
    intrinsics = Intrinsics(1, model, *SIDES, parameters)
    (camera,) = read_cameras(write_model(tmp_path, suffix, cameras=[intrinsics]))
    assert (camera.width, camera.height) == (width, height)
    np.testing.assert_allclose((camera.cx, camera.cy), (cx, cy), rtol=1e-12)
    assert camera.fx == parameters[0]
    assert camera.fy == (parameters[1] if "OPENCV" in model else parameters[0])


@each_model
def test_undistorted_pixels_are_where_the_formula_says(model, tmp_path):
    camera = camera_of(model, tmp_path)
    for point in points(camera):
        u, v = photographed_at(model, point)
        found = camera.lens.undistort(np.array([[u], [v]])).ravel()
        np.testing.assert_allclose(found, (point[0] / point[2], point[1] / point[2]), atol=1e-9)


@each_model
def test_every_pixel_of_the_camera_is_in_the_photograph(model, tmp_path):
    camera = camera_of(model, tmp_path)
    width, height = camera.width - 0.5, camera.height - 0.5
    edge = [(x, y) for x in np.linspace(0.5, width, 60) for y in (0.5, height)]
    edge += [(x, y) for y in np.linspace(0.5, height, 60) for x in (0.5, width)]
    inside = [
        photographed_at(model, ((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1))
        for x, y in edge
    ]
    low, high = np.min(inside, axis=0), np.max(inside, axis=0)
    # COLMAP rounds sides down to whole pixels, and is sometimes half a pixel off.
    assert (low > -0.5).all()
    assert (high < np.array(SIDES) + 0.5).all()
    # Little of the photograph is lost: each edge is touched somewhere, or the size doubles.
    assert (low < 2).any()
    assert (high > np.array(SIDES) - 2).any()


@both_forms
def test_models_without_distortion_keep_their_size(suffix, tmp_path):
    names = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
    cameras = [
        Intrinsics(i + 1, m, *SIDES, [c if abs(c) > 1 else 0.0 for c in MODELS[m][0]])
        for i, m in enumerate(names)
    ]
    images = [Image(f"{i}.jpg", camera_id=i + 1) for i in range(len(names))]
    for camera in read_cameras(write_model(tmp_path, suffix, images, cameras)):
        assert (camera.width, camera.height, camera.lens) == (*SIDES, None)


def test_fisheye_lens_without_coefficients_is_not_a_pinhole(tmp_path):
    intrinsics = Intrinsics(1, "OPENCV_FISHEYE", *SIDES, (400.0, 400.0, 400.0, 300.0, 0, 0, 0, 0))
    (camera,) = read_cameras(write_model(tmp_path, ".bin", cameras=[intrinsics]))
    # The middle of the left edge is 1 rad from the axis.
    assert camera.width == int(800 * math.tan(399.5 / 400) / (399.5 / 400) * 399.5 / 400)
    np.testing.assert_allclose(camera.lens.undistort([[800], [300]]), [[math.tan(1)], [0]])


def test_very_wide_lens_doubles_the_sides():
    lens = Lens(800, 800, 200.0, 200.0, 400.0, 400.0, True, (0.0,) * 4)
    fields = lens.pinhole()
    assert (fields["width"], fields["height"]) == (1600, 1600)
    assert lens.undistort([[800.0], [400.0]])[0] == np.inf  # 2 rad from the axis


def test_resizing_keeps_the_lens(tmp_path):
    camera = camera_of("OPENCV", tmp_path)
    (small,) = find_cameras([camera], random_scene(1), width=100)
    assert small.lens == camera.lens


@both_forms
def test_edges_that_cannot_be_inverted_are_left_out(suffix, tmp_path):
    """An action camera: with k1 alone, no point of the world is at the left and right edges."""
    f, k1 = 1330.9, -0.2947
    turn = 1 / math.sqrt(-3 * k1)
    assert f * turn * (1 + k1 * turn**2) < 959.5
    intrinsics = Intrinsics(1, "SIMPLE_RADIAL", 1920, 1080, (f, 960.0, 540.0, k1))
    (camera,) = read_cameras(write_model(tmp_path, suffix, cameras=[intrinsics]))
    x, y = (camera.width - 1) / 2 / f, (camera.height - 1) / 2 / f
    assert x < turn
    assert 0.88 * 960 < f * brown(x, 0, [k1])[0] < 0.91 * 960
    assert 535 < f * brown(0, y, [k1])[1] < 540


BAD_LENSES = {
    "k1 = 1e300": ((500.0, 400.0, 300.0, 1e300), "lens: its distortion"),
    "k1 = -1e300": ((500.0, 400.0, 300.0, -1e300), "lens: its distortion"),
    "k1 = 1e4": ((500.0, 400.0, 300.0, 1e4), r"lens: its distortion leaves 4\.6 % of a side"),
    "k1 = -3": ((500.0, 400.0, 300.0, -3.0), "lens: its distortion cannot be inverted"),
    "focal of zero": ((0.0, 400.0, 300.0, 0.1), "lens: fx 0"),
    "point outside": ((500.0, -1.0, 300.0, 0.1), "lens: principal point -1, expected within"),
    "point on the edge": ((500.0, 400.0, 600.0, 0.1), "lens: principal point 600"),
}


@pytest.mark.parametrize("name", BAD_LENSES)
@both_forms
def test_irreversible_distortion_is_refused(suffix, name, tmp_path):
    parameters, message = BAD_LENSES[name]
    intrinsics = Intrinsics(4, "SIMPLE_RADIAL", *SIDES, parameters)
    with pytest.raises(InvalidInput, match=f"camera 4: {message}") as caught:
        read_cameras(write_model(tmp_path, suffix, cameras=[intrinsics]))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("sides", [(0, 600), (800, 1 << 20)])
def test_size_of_a_lens_is_checked(sides, tmp_path):
    intrinsics = Intrinsics(4, "SIMPLE_RADIAL", *sides, (500.0, 400.0, 300.0, 0.1))
    with pytest.raises(InvalidInput, match=r"camera 4: lens: (width|height)"):
        read_cameras(write_model(tmp_path, ".bin", cameras=[intrinsics]))


@pytest.mark.thorough
def test_random_lenses_give_cameras_or_are_refused_seed8():
    rng = np.random.default_rng(8)
    given = refused = 0
    for _ in range(150):
        fisheye = bool(rng.integers(2))
        coefficients = rng.standard_cauchy(4 if fisheye else 8) * 10.0 ** rng.integers(-4, 2)
        sides = [int(side) for side in rng.integers(1, 300, 2)]
        view = (*rng.uniform(1, 300, 2), *rng.uniform(0, 1, 2) * sides)
        try:
            fields = Lens(*sides, *view, fisheye, tuple(coefficients.tolist())).pinhole()
        except InvalidInput as error:
            refused += str(error).isprintable()
        else:
            Camera("a", **fields, rotation=np.eye(3), position=np.zeros(3))
            assert fields["width"] <= 2 * sides[0]
            given += 1
    assert given > 20
    assert refused > 20
    assert given + refused == 150


@pytest.mark.parametrize("coefficients", [(), (0.1,) * 4, (math.nan,) * 8, (math.inf,) * 8])
def test_coefficients_of_a_lens_are_checked(coefficients):
    with pytest.raises(InvalidInput, match=r"lens: coefficients .*expected 8 finite numbers"):
        Lens(40, 30, 40.0, 40.0, 20.0, 15.0, False, coefficients)


def test_distort_is_the_inverse_of_undistort():
    points = np.random.default_rng(9).uniform(-0.7, 0.7, (2, 40))
    for fisheye, coefficients, r8 in (
        (False, (-0.12, 0.03, 0.002, -0.001, 0.01, 0.02, 0.003, 0.001), 0.0),
        (False, (-0.12, 0.03, 0.002, -0.001, 0.01, 0.0, 0.0, 0.0), 0.004),
        (True, (0.05, -0.01, 0.003, -0.001), 0.0),
    ):
        lens = Lens(800, 600, 500.0, 520.0, 380.0, 310.0, fisheye, coefficients, r8)
        np.testing.assert_allclose(lens.undistort(lens.distort(points)), points, atol=1e-9)
        np.testing.assert_allclose(lens.distort(np.zeros((2, 1))), [[380], [310]])
    for fisheye, r8 in ((False, math.nan), (True, 0.1)):
        with pytest.raises(InvalidInput, match="lens: r8"):
            Lens(40, 30, 40.0, 40.0, 20.0, 15.0, fisheye, (0.0,) * (4 if fisheye else 8), r8)


# Photographs


def draw_dots(places: Sequence[tuple[float, float]], width: int, height: int) -> np.ndarray:
    """An image, grey 0-1, with a soft dot of radius 1.5 pixels at each place."""
    image = np.zeros((height, width))
    y, x = np.mgrid[:height, :width] + 0.5  # centres of pixels
    for u, v in places:
        image += np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 1.5**2))
    return image


def dot_near(image: np.ndarray, u: float, v: float) -> tuple[float, float]:
    """The centroid of the dot near a position."""
    left, top = int(u) - 9, int(v) - 9
    part = image[top : top + 19, left : left + 19]
    y, x = np.mgrid[:19, :19] + 0.5
    part = np.asarray(part, np.float64)
    return left + (x * part).sum() / part.sum(), top + (y * part).sum() / part.sum()


@pytest.mark.one_in(3)
@needs_opencv
@each_model
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_photograph_points_move_to_the_cameras_pixels(model, scale, tmp_path):
    camera = camera_of(model, tmp_path)
    places = points(camera)
    seen = [np.multiply(scale, photographed_at(model, point)) for point in places]
    image = draw_dots(seen, *(round(scale * side) for side in SIDES))
    write_png(tmp_path / "a.png", np.repeat(image[..., None], 3, axis=2))
    fitted, straight = read_photograph(camera, tmp_path / "a.png")
    assert straight.shape == (fitted.height, fitted.width, 3)
    assert fitted.width == pytest.approx(scale * camera.width, abs=1)
    expected = [seen_by(fitted, point) for point in places]
    errors = np.array([dot_near(straight[..., 0], *place) for place in expected]) - expected
    # A shift of half a pixel would affect all dots; at the edges, dots are stretched to one side.
    assert np.abs(np.median(errors, axis=0)).max() < 0.05
    assert np.abs(errors).max() < 0.25


@needs_opencv
def test_photographs_of_a_lens_that_opencv_does_not_have(tmp_path):
    coefficients = (-0.12, 0.03, 0.002, -0.001, 0.01, 0.0, 0.0, 0.0)
    plain = Lens(*SIDES, 500.0, 520.0, 380.0, 310.0, False, coefficients)
    image = np.random.default_rng(10).random((300, 400, 3))
    write_png(tmp_path / "a.png", image)
    read = {}
    for r8 in (0.0, 1e-12, 0.05):
        lens = replace(plain, r8=r8)
        camera = Camera("a", **lens.pinhole(), rotation=np.eye(3), position=np.zeros(3))
        read[r8] = read_photograph(camera, tmp_path / "a.png")
    np.testing.assert_allclose(read[1e-12][1], read[0.0][1], atol=0.02)
    # Position in the photograph of pixel (x, y) of the undistorted image.
    camera, straight = read[0.05]
    x, y = 40, 25
    u, v = (x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy
    u, v = brown(u, v, (-0.12, 0.03, 0.01, 0.05), 0.002, -0.001)
    column, row = (500 * u + 380) / 2 - 0.5, (520 * v + 310) / 2 - 0.5
    left, top = int(column), int(row)
    a, b = column - left, row - top
    four = read_image(tmp_path / "a.png")[top : top + 2, left : left + 2]
    expected = np.array([1 - b, b]) @ np.tensordot(four, [1 - a, a], (1, 0))
    np.testing.assert_allclose(straight[y, x], expected, atol=0.03)


@needs_opencv
def test_photograph_has_no_empty_border(tmp_path):
    for model in MODELS:
        camera = camera_of(model, tmp_path)
        write_png(tmp_path / "a.png", np.ones((600, 800, 3)))
        _, straight = read_photograph(camera, tmp_path / "a.png")
        assert straight.min() == 1
        assert straight.dtype == np.float32


def test_undistorted_photographs_are_unchanged(tmp_path):
    camera = camera_of("OPENCV", tmp_path)
    for by in (1, 2, 4):
        size = round(camera.width / by), round(camera.height / by)
        image = np.random.default_rng(by).random((size[1], size[0], 3))
        write_png(tmp_path / "a.png", image)
        fitted, kept = read_photograph(camera, tmp_path / "a.png")
        assert (fitted.width, fitted.height) == size
        np.testing.assert_allclose(kept, image, atol=0.51 / 255)
        assert fitted.fx == pytest.approx(camera.fx * size[0] / camera.width)


@pytest.mark.parametrize("up", [0, 1])
def test_smaller_photographs_may_be_rounded_down_or_up(up, tmp_path):
    image = Image(quaternion=(1, 0, 0, 0), translation=(0, 0, 0))
    intrinsics = Intrinsics(1, "PINHOLE", 1071, 1898, (900.0, 900.0, 535.5, 949.0))
    (camera,) = read_cameras(write_model(tmp_path, ".txt", [image], [intrinsics]))
    write_png(tmp_path / "a.png", np.zeros((237, 133 + up, 3)))
    fitted, _ = read_photograph(camera, tmp_path / "a.png")
    assert (fitted.width, fitted.height) == (133 + up, 237)
    write_png(tmp_path / "a.png", np.zeros((237, 132, 3)))
    with pytest.raises(InvalidInput, match="132x237 pixels, expected the shape of 1071x1898"):
        read_photograph(camera, tmp_path / "a.png")


def test_photograph_of_another_shape_is_refused(tmp_path):
    camera = camera_of("OPENCV", tmp_path)
    write_png(tmp_path / "a.png", np.zeros((600, 600, 3)))
    with pytest.raises(InvalidInput, match=r"a\.png: 600x600 .*shape of 800x600, or 853x620 und"):
        read_photograph(camera, tmp_path / "a.png")


def test_without_opencv_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    camera = camera_of("OPENCV", tmp_path)
    write_png(tmp_path / "a.png", np.zeros((600, 800, 3)))
    with pytest.raises(MissingTool, match=r"a\.png: .*pip install 'gs-codec\[undistort\]'"):
        read_photograph(camera, tmp_path / "a.png")
    # If nothing needs to be undistorted, OpenCV is not needed.
    straight, image = read_photograph(
        replace(camera, lens=None).resized(800, 600), tmp_path / "a.png"
    )
    assert (straight.width, image.shape) == (800, (600, 800, 3))


@needs_opencv
def test_comparison_and_preparation_undistort(tmp_path):
    camera = camera_of("OPENCV", tmp_path)
    write_png(tmp_path / "a.png", np.random.default_rng(9).random((60, 80, 3)))
    scene = random_scene(20)
    [view] = compare_views(scene, scene, [camera], truth=tmp_path, images=tmp_path / "out").views
    assert view.first is not None
    found = photographed([camera], tmp_path)
    references = read_photographs(found, (0, 0, 0))
    expected, image = read_photograph(camera, tmp_path / "a.png")
    np.testing.assert_array_equal(references.images[0], image)
    assert references.cameras[0].width == expected.width == 85
