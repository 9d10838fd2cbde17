"""Rendering of splats in panes: drafts, appearances, hidden Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import SHARED, random_scene

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.image_quality import psnr
from gs_codec.rendering.renderer import render
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import ANTIALIASED
from viewer.pictures.centres import centres
from viewer.pictures.drawer import Drawer, measure, splats
from viewer.pictures.picture import Shown, draw_scene, picture
from viewer.scenes.appearance import Look, gaussians_drawn
from viewer.scenes.choice import Appearance
from viewer.scenes.opened import Opened, open_scene
from viewer.scenes.pose import Pose, of_camera
from viewer.window.pane import splat_cloud, splat_material

POSE = Pose(np.eye(3), np.array([0.0, 0.0, -4.0]), frame=(120, 80))
SIZE = (120, 80)


@pytest.fixture(scope="module")
def gaussians():
    scene = random_scene(5000, 3, seed=310)
    return replace(scene, log_scale=scene.log_scale + np.float32(1.5))


@pytest.fixture(scope="module")
def scene(gaussians) -> Opened:
    return Opened("a", to_cloud(gaussians))


def exact(gaussians, background=(0.0, 0.0, 0.0)) -> np.ndarray:
    return render(gaussians, as_camera(POSE.camera(*SIZE)), background, device="cpu").colour


def test_a_draft_equals_the_exact_picture_up_to_rounding(scene, gaussians):
    draft = Drawer(scene).draft(POSE, *SIZE)
    assert draft.dtype == np.float32
    assert np.ptp(draft) > 0.5
    assert psnr(draft, exact(gaussians)) > 90


def test_a_draft_of_a_real_scene_equals_the_exact_picture_up_to_rounding():
    path = SHARED / "bonsai" / "point_cloud.ply"
    if not path.exists():
        pytest.skip("needs the shared scenes")
    real = open_scene(path)
    [camera, *_] = gs_codec.render(real.cloud, path.parent / "cameras.json").cameras
    drawer, pose = Drawer(real), of_camera(camera)
    size = camera.width, camera.height
    assert psnr(drawer.draft(pose, *size), drawer.exact(pose, *size)) > 90


def test_a_draft_does_not_depend_on_the_threads(scene):
    pictures = []
    for threads in (1, 3):
        with using_threads(threads):
            pictures.append(Drawer(scene).draft(POSE, *SIZE))
    np.testing.assert_array_equal(*pictures)


def test_a_coarser_draft_is_of_fewer_larger_gaussians(scene, gaussians):
    some = gaussians.take(np.arange(0, 5000, 4))
    expected = exact(replace(some, log_scale=some.log_scale + np.float32(np.log(2))))
    assert psnr(Drawer(scene).draft(POSE, *SIZE, every=4), expected) > 90


def test_opacity_compensation_follows_the_file(gaussians, tmp_path):
    write_ply(tmp_path / "mip.ply", replace(gaussians, comments=(ANTIALIASED,)))
    drawn = splats({}, open_scene(tmp_path / "mip.ply"), POSE, *SIZE)
    np.testing.assert_array_equal(drawn, exact(replace(gaussians, comments=(ANTIALIASED,))))
    assert psnr(drawn, exact(gaussians)) < 60


@pytest.mark.parametrize("draft", [0, 1])
def test_appearances_change_what_is_drawn(scene, gaussians, draft):
    opacities = 1 / (1 + np.exp(-gaussians.opacity[0]))
    first_band = gaussians.f_rest.reshape(3, 15, -1)[:, :3].reshape(9, -1)
    expected = {
        Appearance(sh_degree=0): replace(gaussians, f_rest=gaussians.f_rest[:0]),
        Appearance(sh_degree=1): replace(gaussians, f_rest=first_band),
        Appearance(scale=0.25): replace(
            gaussians, log_scale=gaussians.log_scale - np.float32(np.log(4))
        ),
        Appearance(least_opacity=0.5): gaussians.take(opacities >= 0.5),
    }
    plain = exact(gaussians)
    for appearance, other in expected.items():
        shown = Shown(("splats",), scenes=(scene,), appearance=appearance)
        drawn = picture({}, scene, POSE, *SIZE, shown, draft)
        assert psnr(drawn, np.clip(exact(other), 0, 1)) > 90
        assert psnr(drawn, np.clip(plain, 0, 1)) < 45


def test_a_background_shows_behind_splats_and_without_them(scene, gaussians):
    teal = (0.1, 0.5, 0.6)
    appearance = Appearance(background=teal)
    drawn, _ = draw_scene(scene, POSE, *SIZE, Shown(("splats",), appearance=appearance), {})
    np.testing.assert_allclose(drawn, np.clip(exact(gaussians, teal), 0, 1), atol=1e-6)
    empty, _ = draw_scene(scene, POSE, *SIZE, Shown((), appearance=appearance), {})
    np.testing.assert_array_equal(np.unique(empty.reshape(-1, 3), axis=0)[0], np.float32(teal))


def test_degrees_above_the_scenes_change_nothing(gaussians):
    flat = Opened("flat", to_cloud(replace(gaussians, f_rest=gaussians.f_rest[:0])))
    assert gaussians_drawn(flat, Look(Appearance(sh_degree=2))) is flat.gaussians


def test_hidden_gaussians_are_not_drawn(scene, gaussians):
    mask = np.arange(5000) % 3 > 0
    shown = Shown(("splats",), scenes=(scene,), drawn={scene: mask})
    expected = exact(gaussians.take(mask))
    assert psnr(expected, exact(gaussians)) < 45
    views = {}
    for draft in (0, 1):
        drawn = picture(views, scene, POSE, *SIZE, shown, draft)
        assert psnr(drawn, np.clip(expected, 0, 1)) > 90
    # Another array is another drawing.
    drawn = picture(views, scene, POSE, *SIZE, replace(shown, drawn={scene: ~mask}))
    assert psnr(drawn, np.clip(exact(gaussians.take(~mask)), 0, 1)) > 90


def test_nothing_is_drawn_if_everything_is_hidden(scene):
    shown = Shown(("splats", "centres"), drawn={scene: np.zeros(5000, bool)})
    drawn, _ = draw_scene(scene, POSE, *SIZE, shown, {})
    assert not drawn.any()


@pytest.mark.parametrize("colouring", ["colour", "opacity", "scale", "error"])
def test_centres_of_hidden_and_of_faint_gaussians_are_left_out(scene, colouring):
    mask = np.arange(5000) % 3 > 0
    other = Opened("b", scene.cloud)
    all_of = centres(scene, colouring, [scene, other])
    look = Look(Appearance(least_opacity=0.5), mask)
    kept = mask & (scene.opacities >= 0.5)
    some = centres(scene, colouring, [scene, other], look=look)
    assert 0 < len(some.positions) == kept.sum() < mask.sum()
    np.testing.assert_array_equal(some.positions, all_of.positions[kept])
    np.testing.assert_array_equal(some.colours, all_of.colours[kept])
    assert len(centres(scene, colouring, [scene, other], 100, look=look).positions) <= 100


def test_the_shader_gets_the_gaussians_that_are_drawn(scene):
    mask = np.arange(5000) % 3 > 0
    cloud = splat_cloud(scene, Look(Appearance(scale=0.5), mask)).point
    np.testing.assert_array_equal(cloud.positions.numpy(), scene.positions[mask])
    np.testing.assert_array_equal(
        cloud["scale"].numpy(), scene.cloud.point["scale"].numpy()[mask] / 2
    )
    lengths = np.linalg.norm(cloud["rot"].numpy(), axis=1)
    np.testing.assert_allclose(lengths, 1, rtol=1e-6)
    degrees = [
        splat_material(scene, Appearance(sh_degree=degree)).gaussian_splat_sh_degree
        for degree in range(4)
    ]
    assert degrees == [0, 1, 2, 2]


def test_measurements_ignore_the_appearance(scene, gaussians):
    coded = replace(gaussians, f_dc=gaussians.f_dc + np.float32(0.05))
    scenes = scene, Opened("b", to_cloud(coded))
    before, views = measure({}, scenes, POSE), {}
    appearance = Appearance(scale=0.2, background=(1.0, 1.0, 1.0))
    shown = Shown(("splats",), scenes=scenes, appearance=appearance)
    for draft in (1, 0):
        for each in scenes:
            picture(views, each, POSE, *POSE.measured, shown, draft)
        assert measure(views, scenes, POSE) == before


def test_a_picture_that_was_just_drawn_is_not_drawn_again(scene):
    drawer = Drawer(scene)
    look, equal = Look(Appearance(scale=0.5)), Look(Appearance(scale=0.5))
    first = drawer.draft(POSE, *SIZE, look)
    assert drawer.draft(POSE, *SIZE, equal) is first
    assert drawer.draft(replace(POSE), *SIZE, look) is not first
    assert drawer.draft(POSE, *SIZE, Look()) is not first
