"""Sensitivities against central differences of rendered images, and against random noise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import antialiased as compensated
from scenes import edge_scenes, with_threads
from splats import TEAL, splats, straight, turned

from gs_codec.codecs.adaptive.step_sizes import Sensitivity
from gs_codec.guidance.sensitivity import sensitivity
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.sh_weights import squared_weights
from gs_codec.rendering.frame import make_frame
from gs_codec.scene import GROUPS, SH_C0, Scene

STEPS = (1e-5, 1e-6)

#: Rows of a change: position, log-scale, turn about the Gaussian's axes, opacity, one colour.
ROWS = {
    "positions": range(3),
    "log_scale": range(3, 6),
    "rot": range(6, 9),
    "opacity": range(9, 10),
    "colour": range(10, 11),
}

#: Sensitivity to positions ignores their effect on the shape of a splat.
TOLERANCE = {"positions": 0.03, "log_scale": 1e-5, "rot": 1e-5, "opacity": 1e-5, "colour": 1e-5}


def images(planes: SimpleNamespace, cameras, antialiased: bool) -> np.ndarray:
    """Pixels of all views in full precision."""
    frames = [make_frame(planes, camera, antialiased) for camera in cameras]
    drawn = [frame.draw(TEAL, np.float64, np.zeros((0, 4)))[0] for frame in frames]
    return np.concatenate([image.ravel() for image in drawn])


def moved(scene: Scene, change: np.ndarray, channel: int = 0) -> SimpleNamespace:
    """The scene in float64, changed by rows ``(11, N)`` as in `ROWS`."""
    planes = {group: getattr(scene, group).astype(np.float64) for group in GROUPS}
    planes["positions"] += change[:3]
    planes["log_scale"] += change[3:6]
    planes["rot"] = turn(planes["rot"], change[6:9])
    planes["opacity"] += change[9:10]
    planes["f_dc"][channel] += change[10] / SH_C0
    return SimpleNamespace(**planes, count=scene.count)


def turn(rot: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Quaternions ``(4, N)`` rotated by vectors ``(3, N)`` about their own axes, in radians."""
    a, x = rot[0], rot[1:]
    half = np.sqrt((angles**2).sum(axis=0)) / 2
    b, y = np.cos(half), angles / 2 * np.sinc(half / np.pi)
    return np.vstack([a * b - (x * y).sum(axis=0), a * y + b * x + np.cross(x, y, axis=0)])


def references(cameras, background=(0.0, 0.0, 0.0)) -> ReferenceViews:
    """Views whose images are not used."""
    return ReferenceViews(tuple(cameras), (), False, background)


def summed(scene, cameras, background=(0.0, 0.0, 0.0), progress=None) -> Sensitivity:
    """Sensitivity over all views."""
    return sensitivity(scene, references(cameras, background), progress)[0]


def rows_of(found: Sensitivity) -> np.ndarray:
    """Sensitivities ``(11, N)`` to the rows of a change."""
    parts = (found.positions, *found.log_scale, *found.rot, found.opacity, found.colour)
    return np.repeat(np.stack(parts), [3, *[1] * 8], axis=0)


def differences(scene: Scene, cameras, antialiased: bool) -> np.ndarray:
    """Expected `rows_of`, before averaging, Gaussian by Gaussian.

    A step that moves a pixel across a threshold adds to it, so the smaller of two is used.
    """
    expected = np.full((11, scene.count), np.inf)
    for place in np.ndindex(expected.shape):
        for step in STEPS:
            change = np.zeros(expected.shape)
            change[place] = step
            ahead = images(moved(scene, change), cameras, antialiased)
            behind = images(moved(scene, -change), cameras, antialiased)
            slopes = (ahead - behind) / (2 * step)
            expected[place] = min(expected[place], (slopes**2).sum())
    return expected


def assert_differences(scene: Scene, cameras, antialiased: bool) -> None:
    found = rows_of(summed(compensated(scene, antialiased), cameras, TEAL))
    expected = differences(scene, cameras, antialiased)
    for name, rows in ROWS.items():
        wanted = expected[rows]
        if name == "positions":
            wanted = np.broadcast_to(wanted.mean(axis=0), wanted.shape)
        assert wanted.any(), name
        np.testing.assert_allclose(
            found[rows], wanted, rtol=TOLERANCE[name], atol=1e-6 * wanted.mean(), err_msg=name
        )


def cloud(seed: int, count: int, size: float = -2.0) -> Scene:
    """Overlapping Gaussians in front of `CAMERAS`, with colours that are never clamped."""
    rng = np.random.default_rng(seed)
    return splats(
        rng.normal(scale=0.5, size=(count, 3)),
        f_dc=rng.uniform(-1.5, 2, (3, count)),
        opacity=rng.normal(1.0, 1.5, count),
        log_scale=rng.normal(size, 0.5, (3, count)),
        rot=rng.normal(size=(4, count)),
    )


CAMERAS = [straight(48, 32, (x, 0.1, -4), 45.0, 40.0) for x in (-0.8, 0.0, 0.8)]


# Against central differences


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_gaussian(seed, antialiased):
    camera = turned(seed, 40, 36)
    rng = np.random.default_rng(seed)
    scene = splats(
        camera.rotation.T @ [0.3, -0.2, 3.0] + camera.position,
        f_dc=[[1.0], [-0.5], [0.2]],
        opacity=rng.normal(),
        log_scale=rng.normal(-2.2, 0.6, (3, 1)),
        rot=rng.normal(size=(4, 1)) * 3,
    )
    assert_differences(scene, [camera], antialiased)


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("seed", [4, 5])
def test_gaussians_before_and_behind_each_other(seed, antialiased):
    assert_differences(cloud(seed, 8), CAMERAS[:2], antialiased)


def test_gaussians_smaller_than_a_pixel():
    assert_differences(cloud(6, 6, size=-4.0), CAMERAS[1:], True)


def test_gaussians_too_thin_to_be_compensated():
    scene = splats([(0.1, 0.2, 2)], log_scale=[[-1.0], [-12.0], [-12.5]], opacity=2.0)
    scene = replace(scene, rot=np.array([[0.9], [0.1], [-0.2], [0.3]], np.float32))
    assert_differences(scene, [straight(20, 17, fx=14.0, fy=13.0)], True)


def test_a_gaussian_outside_the_image():
    outside = splats([(1.5, 0.2, 3.0)], log_scale=[[-1.2], [-1.5], [-0.7]], rot=np.ones((4, 1)))
    camera = straight(40, 36)
    found = rows_of(summed(outside, [camera], TEAL))
    expected = differences(outside, [camera], False)
    assert expected[:9].all()
    # The Jacobian of its shape is that at the edge, that of its centre is its own.
    assert found[0, 0] == pytest.approx(expected[:3].mean(), rel=0.2)
    np.testing.assert_allclose(found[3:9], expected[3:9], rtol=1e-5)


def test_an_alpha_at_its_limit_does_not_change():
    scene = splats([(0, 0, 2)], opacity=12.0, log_scale=3.0)
    found = rows_of(summed(scene, [straight(8, 8)], TEAL))
    assert not found[:10].any()
    assert found[10, 0] == pytest.approx(64 * 0.99**2)


def test_opacity_is_free_for_the_backgrounds_colour():
    places = [(0, 0, 0.2 * i) for i in range(9)]
    scene = splats(places, f_dc=1.0, opacity=4.0, log_scale=1.0)
    found = summed(scene, CAMERAS, (0.5 + SH_C0,) * 3)
    # The square of float32 rounding errors.
    assert found.opacity.max() < 1e-12
    assert found.colour[:2].all()


# Against noise


@pytest.mark.parametrize("name", ROWS)
def test_noise_on_all_gaussians_adds_the_predicted_error(name):
    scene = cloud(7, 120)
    unit = rows_of(summed(scene, CAMERAS, TEAL))
    reference = images(moved(scene, np.zeros(unit.shape)), CAMERAS, False)
    predicted = measured = 0.0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        change = np.zeros(unit.shape)
        change[ROWS[name]] = rng.normal(scale=3e-3, size=change[ROWS[name]].shape)
        image = images(moved(scene, change, seed % 3), CAMERAS, False)
        predicted += (unit * change**2).sum()
        measured += ((image - reference) ** 2).sum()
    assert measured == pytest.approx(predicted, rel=0.25)


# Invariance, and edge cases


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
def test_threads_do_not_change_it(antialiased):
    scene = compensated(cloud(8, 200), antialiased)
    cameras = CAMERAS * 4
    one = with_threads(1, summed, scene, cameras, TEAL)
    for threads in (2, 3, None):
        other = with_threads(threads, summed, scene, cameras, TEAL)
        for first, second in zip(one, other, strict=True):
            np.testing.assert_array_equal(first, second)


def test_views_add_up_and_are_counted():
    scene = cloud(9, 50)
    steps = []
    both = summed(scene, CAMERAS[:2], progress=lambda *step: steps.append(step))
    assert steps == [("sensitivity", 1, 2), ("sensitivity", 2, 2)]
    apart = [rows_of(summed(scene, [camera])) for camera in CAMERAS[:2]]
    np.testing.assert_allclose(rows_of(both), apart[0] + apart[1], rtol=1e-12)


@pytest.mark.parametrize("opaque", [0, 5], ids=["translucent", "opaque"])
def test_weights_of_views_are_those_of_drawing(opaque):
    plain = cloud(9, 50, size=-2.0 + opaque / 5)
    plain = replace(plain, opacity=plain.opacity + opaque)
    scene = replace(plain, f_rest=np.zeros((9, 50), np.float32))
    total, weights, images = sensitivity(scene, references(CAMERAS, TEAL))
    np.testing.assert_array_equal(rows_of(total), rows_of(summed(plain, CAMERAS, TEAL)))
    np.testing.assert_allclose(weights, squared_weights(scene, CAMERAS), rtol=1e-5)
    np.testing.assert_allclose(weights.sum(axis=0), total.colour, rtol=1e-5)
    assert weights.any()
    for image, camera in zip(images, CAMERAS, strict=True):
        np.testing.assert_array_equal(image, make_frame(scene, camera).draw_float32(TEAL)[0])
    assert sensitivity(plain, references(CAMERAS))[1].shape == (3, 50)


def test_antialiasing_follows_the_scene():
    scene = cloud(10, 50, size=-3.5)
    found = summed(compensated(scene), CAMERAS)
    assert not np.allclose(found.rot, summed(scene, CAMERAS).rot)


def test_invisible_gaussians_have_no_sensitivity():
    places = [(0, 0, -50), (0, 90, 0), (0, 0, 0), (0, 0, 0)]
    scene = splats(places, opacity=[[1, 1, -9, 1]], log_scale=[[-1.0], [-1.5], [-2.0]])
    found = rows_of(summed(scene, CAMERAS, TEAL))
    assert not found[:, :3].any()
    assert found[:, 3].all()


@pytest.mark.parametrize("group", [group for group in GROUPS if group != "f_rest"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf], ids=str)
def test_nonfinite_gaussians_have_no_sensitivity_and_no_effect(group, value):
    scene = cloud(11, 20)
    plane = getattr(scene, group).copy()
    plane[-1, 5] = value
    found = rows_of(summed(replace(scene, **{group: plane}), CAMERAS, TEAL))
    others = np.arange(20) != 5
    assert not found[:, 5].any()
    expected = rows_of(summed(scene.take(others), CAMERAS, TEAL))
    np.testing.assert_array_equal(found[:, others], expected)
    assert expected.any()


def test_values_beyond_float64_have_no_sensitivity():
    scene = cloud(13, 4)
    scene.log_scale[0, 2] = 230.0
    found = rows_of(summed(scene, CAMERAS, TEAL))
    assert np.isfinite(found).all()
    assert found[10].all()


@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("name", edge_scenes())
def test_edge_scenes(name, antialiased):
    scene = compensated(edge_scenes()[name], antialiased)
    found = summed(scene, CAMERAS)
    assert found.log_scale.shape == (3, scene.count)
    for plane in found:
        assert plane.shape[-1] == scene.count
        assert plane.dtype == np.float64
        assert (plane >= 0).all()
        assert np.isfinite(plane).all()


def test_without_cameras_sensitivity_is_zero():
    assert not rows_of(summed(cloud(12, 5), [])).any()
