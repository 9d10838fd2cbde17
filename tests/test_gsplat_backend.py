"""Input of gsplat and refinement with it, using a stand-in; and gsplat itself."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from gardens import CAMERAS, SCENE, garden, psnr, refit, views
from scenes import antialiased as compensated
from scenes import random_scene
from splats import TEAL, crowd, noise, turned
from typer.testing import CliRunner

from gs_codec.bench import device
from gs_codec.bench.measured_scenes import MeasuredScene
from gs_codec.bench.suite.results import Results
from gs_codec.bench.suite.suite_tables import device_table
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.cli.main import app
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.formats.ply.writer import write_ply
from gs_codec.plan import Plan, Steps
from gs_codec.preparation import optimise as module
from gs_codec.preparation.pipeline import prepare_scene
from gs_codec.rendering import gradients, gsplat_backend
from gs_codec.rendering.image_loss import differentiate_loss, differentiate_loss_tensor
from gs_codec.rendering.renderer import render
from gs_codec.scene import GROUPS, Scene


def view() -> Camera:
    axes, _ = np.linalg.qr(np.random.default_rng(96).normal(size=(3, 3)))
    rotation = axes * np.linalg.det(axes)
    return Camera("v", 50, 34, 41.0, 43.0, 24.0, 18.0, rotation, -4 * rotation[2])


def faint(scene: Scene) -> Scene:
    """The scene without splats beyond 3 sigma, where gsplat's rule differs."""
    return replace(scene, opacity=np.minimum(scene.opacity, np.float32(-0.7)))


@pytest.fixture
def stand_in(monkeypatch):
    torch = pytest.importorskip("torch")
    from gsplat_stand_in import rasterization

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # more threads would wait for each other with such small images

    module = ModuleType("gsplat")
    module.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)
    monkeypatch.setattr(gsplat_backend, "sees_device", lambda: True)
    monkeypatch.setattr(gsplat_backend, "_DEVICE", "cpu")
    yield
    torch.set_num_threads(threads)


# Views


@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("asked", ["auto", "cuda"])
def test_gsplat_is_given_the_same_scene_and_camera(stand_in, sh_degree, asked):
    scene = faint(random_scene(300, sh_degree, seed=97))
    scene.rot[:, 5] = 0
    options = {"background": (0.2, 0.5, 0.9), "antialiased": True}
    expected = render(scene, view(), device="cpu", **options)
    drawn = render(scene, view(), device=asked, **options)
    np.testing.assert_allclose(drawn.colour, expected.colour, atol=1e-4)
    np.testing.assert_allclose(drawn.alpha, expected.alpha, atol=1e-4)
    np.testing.assert_allclose(drawn.depth, expected.depth, atol=1e-3)
    assert drawn.pairs > 0


def test_metadata_reaches_gsplat(stand_in):
    scene = replace(faint(random_scene(300, 0, seed=98)), comments=("antialiased 1",))
    expected = render(scene, view(), device="cpu").colour
    np.testing.assert_allclose(render(scene, view()).colour, expected, atol=1e-4)


def test_sums_come_from_the_cpu(stand_in):
    scene = random_scene(50, 0, seed=99)
    drawn = render(scene, view(), accumulate=True)
    np.testing.assert_array_equal(drawn.colour, render(scene, view(), device="cpu").colour)
    assert drawn.accumulations is not None


def test_cuda_is_refused_if_missing():
    if gsplat_backend.sees_device():
        pytest.skip("gsplat and CUDA are here")
    scene = random_scene(1)
    with pytest.raises(MissingTool, match="device 'cuda': needs gsplat"):
        render(scene, view(), device="cuda")
    # Before cameras are searched for.
    with pytest.raises(MissingTool, match="device 'cuda': needs gsplat"):
        prepare_scene(scene, Plan(Steps(refine=1), "nowhere.json", device="cuda"))


def test_gsplat_agrees_with_the_cpu_within_40_db():
    if not gsplat_backend.sees_device():
        pytest.skip("needs gsplat and a CUDA device")
    scene = random_scene(2000, 3, seed=100)
    images = [render(scene, view(), device=device).colour.clip(0, 1) for device in ("cpu", "cuda")]
    assert np.mean((images[0] - images[1]) ** 2) < 1e-4


# Gradients


@pytest.mark.parametrize("size", [(19, 23), (1, 1), (33, 5)], ids=str)
def test_the_loss_of_tensors_has_the_same_derivatives(size):
    torch = pytest.importorskip("torch")
    image, target = np.random.default_rng(101).random((2, *size, 3))
    expected, error = differentiate_loss(image, target)
    found, squared = differentiate_loss_tensor(torch.from_numpy(image), torch.from_numpy(target))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-14)
    assert float(squared) == pytest.approx(error, rel=1e-12)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("antialiased", [False, True], ids=["plain", "antialiased"])
@pytest.mark.parametrize("sh_degree", range(4))
def test_gradients_by_gsplat_are_ours(stand_in, sh_degree, antialiased):
    seed = 102 + sh_degree
    camera = turned(seed, 30, 22)
    scene = faint(crowd(camera, 30, sh_degree, seed, pixels=5))
    scene = compensated(scene) if antialiased else scene
    target = noise(camera, seed)
    expected = gradients.differentiate(scene, camera, target, TEAL)
    values, image = gsplat_backend.upload(scene), gsplat_backend.to_device(target)
    found, error = gsplat_backend.differentiate(values, camera, image, TEAL, antialiased)
    slopes = np.zeros((scene.count, sum(len(getattr(scene, group)) for group in GROUPS)))
    slopes[expected.chosen] = expected.slopes(0, len(expected.chosen))
    assert float(error) == pytest.approx(expected.squared_error, rel=1e-5)
    np.testing.assert_array_equal(np.flatnonzero(found.any(1)), expected.chosen)
    largest = np.abs(slopes).max(axis=0)
    assert (np.abs(found.numpy() - slopes) <= 2e-4 * largest).all()


# Refinement


@pytest.fixture
def refined(stand_in):
    return partial(refit, device="cuda")


def test_gsplat_refines_as_the_cpu_does(refined):
    (expected, told), (fitted, report) = refit(40), refined(40)
    targets = views(garden(1), CAMERAS)
    before, own, other = (psnr(each, CAMERAS, targets) for each in (SCENE, expected, fitted))
    assert own > before + 2
    assert other == pytest.approx(own, abs=0.2)
    assert report.keys() == told.keys()
    assert (report["iterations"], report["updated"]) == (told["iterations"], told["updated"])
    for found, point in zip(report["curve"], told["curve"], strict=True):
        assert found["psnr"] == pytest.approx(point["psnr"], abs=0.3)


def test_an_interrupted_refinement_is_resumed(refined, tmp_path, monkeypatch):
    class Stop(Exception):
        pass

    def stop(_stage: str, done: int, _total: int) -> None:
        if done == 7:
            raise Stop

    monkeypatch.setattr(module, "_CHECKPOINT_EVERY", 4)
    expected, whole = refined(10)
    path = tmp_path / "refit.npz"
    with pytest.raises(Stop):
        refined(10, checkpoint=path, progress=stop)
    fitted, report = refined(10, checkpoint=path)
    for group in GROUPS:
        np.testing.assert_allclose(getattr(fitted, group), getattr(expected, group), atol=1e-5)
    assert [p["iteration"] for p in report["curve"]] == [p["iteration"] for p in whole["curve"]]
    # Photographs, and state that depends on them, do not depend on the device.
    assert refit(10, checkpoint=path)[1]["iterations"] == 10
    with pytest.raises(InvalidInput, match="checkpoint of another"):
        refined(11, checkpoint=path)


def test_fitting_scenes_are_unchanged(stand_in):
    """Its own views, rendered by gsplat."""
    plan = Plan(Steps(refine=4, prune=0), CAMERAS, device="cuda")
    scene = garden(1)
    refined, report = prepare_scene(scene, plan)
    assert report.steps[-1].details["iterations"] == 0
    np.testing.assert_array_equal(refined.f_dc, scene.f_dc)


def test_the_command_refines_on_a_device(stand_in, tmp_path):
    scene, cameras, out = tmp_path / "a.ply", tmp_path / "c.json", tmp_path / "b.egs"
    write_ply(scene, replace(garden(3), extra={}))
    write_cameras(cameras, CAMERAS)
    known = ["encode", str(scene), str(out), "--cameras", str(cameras), "--device", "cuda"]
    refused = CliRunner().invoke(app, known)
    assert "--device needs --refine" in str(refused.exception or refused.output)
    done = CliRunner().invoke(app, [*known, "--refine", "4", "--prune", "20", "--json"])
    assert done.exit_code == 0, done.output
    steps = json.loads(done.stdout)["prepared"]["steps"]
    assert steps[-2]["details"]["iterations"] == 4


def test_extreme_gaussians_stay_finite(refined):
    scene = replace(SCENE, f_dc=SCENE.f_dc.copy(), rot=SCENE.rot.copy())
    scene.f_dc[:, 6], scene.f_dc[:, 7], scene.rot[:, 8] = 3e38, -3e38, 0
    fitted, _ = refined(6, scene)
    for group in GROUPS:
        assert np.isfinite(getattr(fitted, group)).all(), group
    np.testing.assert_array_equal(fitted.rot[:, 8], 0)


# The bench


def test_a_device_is_measured(stand_in, monkeypatch):
    monkeypatch.setattr(device, "WIDTH", 24)
    monkeypatch.setattr(device, "ITERATIONS", 6)
    monkeypatch.setattr(device, "BLOCK_SIZES", (1024,))
    scene = garden(3)
    measured = MeasuredScene(Path("a.ply"), "a", scene, [], CAMERAS, None)
    decoding, more, refining, last = device.measure_device(measured, (100,), 1, "cpu")
    for line, size in ((decoding, 60), (more, 100)):
        assert (line["kind"], line["scene"], line["gaussians"]) == ("device", "a", size)
        assert line["same"]
        assert min(line["seconds"], line["cpu_seconds"]) > 0
    for line, size in ((refining, 60), (last, 100)):
        assert (line["work"], line["gaussians"], line["iterations"]) == ("refining", size, 6)
        assert line["iterations_per_second"] > 0
    table = device_table(Results([decoding, more, refining, last]))
    assert all(len(row) == len(table.columns) for row in table.rows)
    assert [row[5] for row in table.rows] == ["yes", "yes", "", ""]
