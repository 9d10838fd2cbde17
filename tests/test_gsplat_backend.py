"""What gsplat is given, by a stand-in that draws it with our rasteriser; and gsplat itself."""

from __future__ import annotations

import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.errors import MissingTool
from gs_codec.rendering import gsplat_backend
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene


def view() -> Camera:
    axes, _ = np.linalg.qr(np.random.default_rng(96).normal(size=(3, 3)))
    rotation = axes * np.linalg.det(axes)
    return Camera("v", 50, 34, 41.0, 43.0, 24.0, 18.0, rotation, -4 * rotation[2])


def rasterization(**given):
    """gsplat's function (release 1.5), for one camera."""
    import torch

    numpy = {k: v.numpy() for k, v in given.items() if isinstance(v, torch.Tensor)}
    pose, lens = numpy["viewmats"][0].astype(np.float64), numpy["Ks"][0]
    sh = numpy["colors"].transpose(2, 1, 0)
    assert sh.shape[1] == (given["sh_degree"] + 1) ** 2
    assert (given["near_plane"], given["eps2d"]) == (0.2, 0.3)
    assert given["render_mode"] == "RGB+ED"
    count = len(numpy["means"])
    scene = Scene(
        positions=numpy["means"].T.copy(),
        f_dc=sh[:, 0].copy(),
        f_rest=sh[:, 1:].reshape(-1, count).copy(),
        opacity=torch.logit(given["opacities"]).numpy()[None],
        log_scale=np.log(numpy["scales"]).T.copy(),
        rot=numpy["quats"].T.copy(),
    )
    camera = Camera(
        "v",
        given["width"],
        given["height"],
        *(float(lens[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))),
        pose[:3, :3],
        -pose[:3, :3].T @ pose[:3, 3],
    )
    [background] = numpy["backgrounds"]
    assert background.shape == (3,)
    antialiased = given["rasterize_mode"] == "antialiased"
    drawn = render(scene, camera, background, antialiased, device="cpu")
    image = np.concatenate([drawn.colour, drawn.depth[..., None]], axis=2)
    meta = {"flatten_ids": torch.zeros(drawn.pairs)}
    return torch.from_numpy(image)[None], torch.from_numpy(drawn.alpha)[None, ..., None], meta


@pytest.fixture
def stand_in(monkeypatch):
    pytest.importorskip("torch")
    module = ModuleType("gsplat")
    module.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", module)
    monkeypatch.setattr(gsplat_backend, "is_available", lambda: True)
    monkeypatch.setattr(gsplat_backend, "_DEVICE", "cpu")


@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("device", ["auto", "cuda"])
def test_gsplat_is_given_the_same_scene_and_camera(stand_in, sh_degree, device):
    scene = random_scene(300, sh_degree, seed=97)
    scene.rot[:, 5] = 0
    options = {"background": (0.2, 0.5, 0.9), "antialiased": True}
    expected = render(scene, view(), device="cpu", **options)
    drawn = render(scene, view(), device=device, **options)
    np.testing.assert_allclose(drawn.colour, expected.colour, atol=1e-4)
    np.testing.assert_allclose(drawn.alpha, expected.alpha, atol=1e-4)
    np.testing.assert_allclose(drawn.depth, expected.depth, atol=1e-3)
    assert drawn.pairs == pytest.approx(expected.pairs, rel=0.01)


def test_metadata_reaches_gsplat(stand_in):
    scene = replace(random_scene(300, 0, seed=98), comments=("antialiased 1",))
    expected = render(scene, view(), device="cpu").colour
    np.testing.assert_allclose(render(scene, view()).colour, expected, atol=1e-4)


def test_sums_come_from_the_cpu(stand_in):
    scene = random_scene(50, 0, seed=99)
    drawn = render(scene, view(), accumulate=True)
    np.testing.assert_array_equal(drawn.colour, render(scene, view(), device="cpu").colour)
    assert drawn.accumulations is not None


def test_cuda_is_refused_where_it_is_not():
    if gsplat_backend.is_available():
        pytest.skip("gsplat and CUDA are here")
    with pytest.raises(MissingTool, match="device 'cuda': needs gsplat"):
        render(random_scene(1), view(), device="cuda")


def test_gsplat_agrees_with_the_cpu_within_40_db():
    if not gsplat_backend.is_available():
        pytest.skip("needs gsplat and a CUDA device")
    scene = random_scene(2000, 3, seed=100)
    images = [render(scene, view(), device=device).colour.clip(0, 1) for device in ("cpu", "cuda")]
    assert np.mean((images[0] - images[1]) ** 2) < 1e-4
