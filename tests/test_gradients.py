"""Gradients against central differences in float64, whose kernels take long to compile."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scenes import antialiased as compensated
from scenes import with_threads
from scipy.ndimage import correlate1d
from splats import TEAL, crowd, noise, render, splats, straight, turned

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.gradients import differentiate
from gs_codec.rendering.image_loss import differentiate_loss
from gs_codec.rendering.project import MIN_ALPHA
from gs_codec.rendering.tiles_float32 import MOMENT_YY, sum_gradients
from gs_codec.scene import GROUPS, SH_C0, Scene

pytestmark = pytest.mark.thorough

STEP = 1e-5


# Loss


def ssim_of(image, target) -> float:
    window = np.exp(-(np.arange(-5, 6.0) ** 2) / 4.5)
    window /= window.sum()

    def blur(values):
        for axis in (0, 1):
            values = correlate1d(values, window, axis=axis, mode="constant")
        return values

    x, t = blur(image), blur(target)
    xx, tt, xt = blur(image**2) - x * x, blur(target**2) - t * t, blur(image * target) - x * t
    top = (2 * x * t + 1e-4) * (2 * xt + 9e-4)
    return float(np.mean(top / ((x * x + t * t + 1e-4) * (xx + tt + 9e-4))))


def loss_of(image, target) -> float:
    """The loss of 3DGS."""
    target = target.astype(np.float64)
    return float(0.8 * np.abs(image - target).mean() + 0.2 * (1 - ssim_of(image, target)))


@pytest.mark.parametrize("size", [(19, 23), (1, 1), (16, 40), (33, 5)], ids=str)
@pytest.mark.parametrize("seed", [3, 4])
def test_the_loss_of_every_pixel_has_its_derivative(seed, size):
    rng = np.random.default_rng(seed)
    image, target = rng.random((2, *size, 3))
    found, squared_error = differentiate_loss(image, target)
    assert squared_error == pytest.approx(np.mean((image - target) ** 2), rel=1e-12)
    ends = (0, 0, 0), (size[0] - 1, size[1] - 1, 2)
    for place in [*ends, *rng.integers(0, image.shape, (80, 3)).tolist()]:
        place = tuple(place)
        ends = []
        for step in (STEP, -STEP):
            there = image.copy()
            there[place] += step
            ends.append(loss_of(there, target))
        expected = (ends[0] - ends[1]) / (2 * STEP)
        np.testing.assert_allclose(found[place], expected, rtol=1e-6, atol=1e-11)


def test_equal_images_have_no_loss():
    image = np.random.default_rng(5).random((20, 20, 3))
    by_colour, squared_error = differentiate_loss(image, image)
    assert squared_error == 0
    assert np.abs(by_colour).max() < 1e-12


# Gradients


def test_a_splat_is_drawn_to_ten_digits():
    camera = straight(16, 16, fx=40.0, fy=40.0)
    scene = precise(splats([(0, 0, 2)], f_dc=0.7, opacity=1.5, log_scale=-1.2))
    offset = np.arange(16) - 7.5
    variance = (20 * np.exp(scene.log_scale[0])) ** 2 + 0.3
    shade = (0.5 + SH_C0 * scene.f_dc[0]) / (1 + np.exp(-1.5))
    expected = shade * np.exp(-(offset**2 + offset[:, None] ** 2) / (2 * variance))
    frame = make_frame(scene, camera)
    image = frame.draw((0, 0, 0), np.float64, np.zeros((0, 4)))[0][:, :, 0]
    assert image.all()
    np.testing.assert_allclose(image, expected, rtol=3e-11)


def gradients(
    scene, camera: Camera, target: np.ndarray, background=(0.0, 0.0, 0.0)
) -> tuple[float, dict[str, np.ndarray]]:
    """A view's squared error, and the loss's derivatives by each group of attributes.

    In float64, for which kernels are compiled anyway.
    """
    result = differentiate(precise(scene), camera, target, background)
    slopes = result.slopes(0, len(result.chosen))
    ends = np.cumsum([len(getattr(scene, group)) for group in GROUPS])
    found = {}
    for group, rows in zip(GROUPS, np.split(slopes.T, ends[:-1]), strict=True):
        found[group] = np.zeros(getattr(scene, group).shape)
        found[group][:, result.chosen] = rows
    return result.squared_error, found


def precise(scene: Scene) -> SimpleNamespace:
    """The same Gaussians with float64 planes, so that small steps can be taken."""
    planes = {group: getattr(scene, group).astype(np.float64) for group in GROUPS}
    return SimpleNamespace(**planes, count=scene.count, antialiased=scene.antialiased)


def assert_differences(scene: Scene, camera: Camera, antialiased=False, seed=0):
    """Compare every channel of every Gaussian; return the gradients.

    A step may cross a threshold, such as a pixel's last splat; then smaller steps are used.
    """
    exact, target = precise(scene), noise(camera, seed)
    exact.antialiased = antialiased
    _, found = gradients(exact, camera, target, TEAL)

    def loss() -> float:
        colour, _, _ = make_frame(exact, camera).draw(TEAL, np.float64, np.zeros((0, 4)))
        return loss_of(colour, target)

    for group in GROUPS:
        plane, largest = getattr(exact, group), np.abs(found[group]).max(initial=0)
        for place in np.ndindex(plane.shape):
            before = plane[place]
            for step in (STEP, 1e-6, 3e-7):
                size = step * max(1.0, abs(before))
                plane[place] = before + size
                above = loss()
                plane[place] = before - size
                expected = (above - loss()) / (2 * size)
                rounding = 1e-15 / size
                limit = 1e-3 * abs(expected) + 3e-5 * largest + rounding
                if abs(found[group][place] - expected) <= limit:
                    break
            plane[place] = before
            np.testing.assert_allclose(
                found[group][place], expected, rtol=0, atol=limit, err_msg=f"{group}{place}"
            )
    return found


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("sh_degree", range(4))
def test_gradients_are_those_of_central_differences(sh_degree, antialiased):
    seed = 10 + sh_degree
    camera = turned(seed, 20, 17)
    scene = crowd(camera, 8, sh_degree, seed, pixels=5)
    found = assert_differences(scene, camera, antialiased=antialiased)
    for group in GROUPS:
        assert np.count_nonzero(np.abs(found[group]).max(axis=0, initial=0)) >= 3 or not sh_degree


ROW = [(-0.6, 0.2, 3), (0.1, -0.3, 3.5), (0.5, 0.3, 4)]
LONG = [[-1.0], [-1.6], [-2.2]]
TURNS = np.array([[0.9, 0.1, -0.4], [0.2, -0.6, 0.1], [-0.3, 0.2, 0.8], [0.4, 0.7, -0.2]])


def special_scenes() -> dict[str, Scene]:
    """Gaussians at the limits of the derivatives' case distinctions."""
    outside = [(2.5, 0.2, 2), (-2.4, -0.3, 2.1), (0.3, 1.9, 1.9), (-1.9, -2.4, 1.8)]
    turns = np.hstack([TURNS, -TURNS[:, :1]])
    return {
        "Jacobian at its edge": splats(
            outside, log_scale=[[0.3], [-0.2], [0.1]], rot=turns, opacity=0.5
        ),
        "colours below 0": splats(
            ROW, f_dc=[[-5, 1, 0.2], [0.3, -4, 0.1], [0.7, -0.5, -6]], log_scale=LONG, rot=TURNS
        ),
        "alpha at its limit": splats(ROW, opacity=7.0, log_scale=np.add(LONG, 1.5), rot=TURNS),
        "short quaternions": splats(ROW, log_scale=LONG, rot=TURNS * 0.1),
        "long quaternions": splats(ROW, log_scale=LONG, rot=TURNS * 40),
        "thin": splats(ROW, log_scale=[[-1.0], [-12.0], [-12.5]], rot=TURNS, opacity=6.0),
        "discs edge on": splats(ROW, log_scale=[[-9], [-1.2], [-1.0]], rot=around_y(), opacity=6.0),
        "behind each other": splats(
            [(0.02 * i, 0.01 * i, 2 + 0.2 * i) for i in range(9)], opacity=0.5, log_scale=-0.8
        ),
    }


def around_y() -> np.ndarray:
    angles = np.array([0.7, 0.8, 0.9])
    return np.stack([np.cos(angles), 0 * angles, np.sin(angles), 0 * angles])


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("name", special_scenes())
def test_gradients_at_limits_are_those_of_central_differences(name, antialiased):
    found = assert_differences(
        special_scenes()[name], straight(20, 17, fx=14.0, fy=13.0), antialiased, seed=16
    )
    if name == "colours below 0":
        assert not found["f_dc"][[0, 1, 2], [0, 1, 2]].any()
    assert all(np.isfinite(found[group]).all() for group in GROUPS)


def test_test_scene_has_splats_at_the_limits():
    scenes = special_scenes()
    camera = straight(20, 17, fx=14.0, fy=13.0)
    x, y, z = scenes["Jacobian at its edge"].positions
    assert ((np.abs(x / z) > 1.3 * 10 / 14) | (np.abs(y / z) > 1.3 * 8.5 / 13)).all()
    opaque = render(scenes["alpha at its limit"].take(np.array([0])), camera).alpha
    assert opaque.max() == pytest.approx(0.99)
    found = gradients(compensated(scenes["thin"]), camera, noise(camera, 17))[1]
    plain = gradients(scenes["thin"], camera, noise(camera, 17))[1]
    assert not np.allclose(found["opacity"], plain["opacity"])


def test_an_alpha_at_its_limit_does_not_change():
    camera = straight(8, 8)
    scene = splats([(0, 0, 2)], opacity=12.0, log_scale=3.0)
    _, found = gradients(scene, camera, noise(camera, 18))
    for group in ("opacity", "log_scale", "rot"):
        assert not found[group].any()
    assert found["f_dc"].all()


@pytest.mark.parametrize("size", [(70, 45), (16, 16), (17, 33), (5, 3)], ids=str)
@pytest.mark.parametrize("seed", [30, 31])
def test_rows_draw_the_same_image(seed, size):
    camera = turned(seed, *size)
    scene = crowd(camera, 600, 2, seed)
    frame = make_frame(scene, camera)
    expected, alpha, _ = frame.draw(TEAL, np.float64, np.zeros((0, 4)))
    assert alpha.max() > 0.9
    error = np.abs(frame.draw_float32(TEAL)[0] - expected)
    # Some pixels are on different sides of the alpha threshold.
    assert np.quantile(error, 0.9) < 1e-5
    assert error.max() < 2 * MIN_ALPHA


def test_splats_behind_finished_pixels_have_no_sums():
    camera = straight(16, 16)
    scene = splats([(0, 0, 2 + k) for k in range(9)], opacity=9.0, log_scale=3.0)
    frame = make_frame(scene, camera)
    colour, state = frame.draw_float32(TEAL)
    sums = np.full((frame.pairs, MOMENT_YY + 1), np.nan)
    slopes = np.ones(colour.shape)
    frame.over_tiles(sum_gradients, np.array(TEAL), slopes, *state, sums)
    assert sums[0].any()
    assert not sums[3:].any()


def test_a_zero_quaternion_has_no_gradient():
    camera = straight(16, 16)
    scene = splats([(0.3, 0.2, 2)], log_scale=LONG, rot=0.0)
    _, found = gradients(scene, camera, noise(camera, 19))
    assert not found["rot"].any()
    assert found["log_scale"].all()


@pytest.mark.parametrize("seed", [20, 21])
def test_threads_do_not_change_a_gradient(seed):
    camera = turned(seed, 70, 45)
    scene = crowd(camera, 300, 3, seed)
    one = with_threads(1, gradients, scene, camera, noise(camera, seed), TEAL)
    for threads in (2, 3, None):
        loss, found = with_threads(threads, gradients, scene, camera, noise(camera, seed), TEAL)
        assert loss == one[0]
        for group in GROUPS:
            np.testing.assert_array_equal(found[group], one[1][group], group)


@pytest.mark.parametrize("scene", [splats([]), splats([(0, 0, -3)])], ids=["none", "none seen"])
def test_invisible_gaussians_have_no_gradient(scene):
    camera = straight(16, 16)
    target = noise(camera, 22)
    error, found = gradients(scene, camera, target)
    assert error == pytest.approx(np.mean(target.astype(np.float64) ** 2))
    for group in GROUPS:
        assert found[group].shape == getattr(scene, group).shape
        assert not found[group].any()
