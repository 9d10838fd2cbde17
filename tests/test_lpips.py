"""LPIPS with weights from a file; a stand-in replaces the package if possible."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras.image_files import write_png
from gs_codec.cli.main import app
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.image_quality import LPIPS_SIZE, LPIPS_VARIABLE, compare_images, load_lpips

#: Backbones by the package's names: display name, name in torchvision, and a layer's name in the
#: package.
BACKBONES = {
    "vgg": ("VGG16", "vgg16", "slice5.26"),
    "squeeze": ("SqueezeNet 1.1", "squeezenet1_1", "slice7.12.squeeze"),
    "alex": ("AlexNet", "alexnet", "slice5.10"),
}


@pytest.fixture
def stand_in(monkeypatch):
    """A package `lpips` with one-layer networks; returns a function that stores weights for it."""
    torch = pytest.importorskip("torch")

    class Network(torch.nn.Module):
        def __init__(self, net, pnet_rand, verbose):
            assert (pnet_rand, verbose) == (True, False)
            super().__init__()
            self.net = self.layer = torch.nn.Conv2d(3, 1, 1)
            for name in reversed(BACKBONES[net][2].split(".")):
                self.net = torch.nn.ModuleDict({name: self.net})

        def forward(self, a, b, normalize):
            assert normalize
            return (self.layer(a) - self.layer(b)).abs().mean()

    package = ModuleType("lpips")
    package.LPIPS = Network
    monkeypatch.setitem(sys.modules, "lpips", package)

    def store(path, net="alex", shape=(1, 3, 1, 1)):
        name = f"features.{BACKBONES[net][2].partition('.')[2]}"
        state = {f"{name}.weight": torch.ones(shape), f"{name}.bias": torch.ones(1)}
        torch.save(state | {"classifier.1.weight": torch.ones(2)}, path)
        return path

    return store


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Two scenes, two cameras, and their photographs."""
    scene = random_scene(300, 1, seed=90)
    for name, shift in (("a.ply", 0), ("b.ply", 0.1)):
        write_ply(tmp_path / name, replace(scene, f_dc=scene.f_dc + np.float32(shift)))
    entry = {"width": 40, "height": 32, "fx": 40.0, "fy": 40.0, "rotation": np.eye(3).tolist()}
    entries = [
        entry | {"id": i, "img_name": f"v{i}", "position": [0.2 * i, 0.0, -5.0]} for i in range(2)
    ]
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    for i in range(2):
        write_png(tmp_path / f"v{i}.png", np.full((32, 40, 3), 0.5))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(LPIPS_VARIABLE, raising=False)
    load_lpips.cache_clear()  # of files with the same name in another folder
    return tmp_path


def compare(*options):
    return CliRunner().invoke(
        app, ["compare", "a.ply", "b.ply", "--cameras", "cameras.json", *map(str, options)]
    )


@pytest.mark.filterwarnings("ignore:.*deprecated since 0.13")
@pytest.mark.parametrize("net", BACKBONES)
def test_values_are_those_of_the_package_with_the_same_weights(tmp_path, monkeypatch, net):
    torch = pytest.importorskip("torch")
    lpips = pytest.importorskip("lpips")
    torchvision = pytest.importorskip("torchvision")
    name, model, _ = BACKBONES[net]
    torch.manual_seed(7)
    state = getattr(torchvision.models, model)(weights=None).state_dict()
    features = {key: value for key, value in state.items() if key.startswith("features.")}
    torch.save(features, tmp_path / "weights.pth")
    monkeypatch.setattr("torchvision.models._api.load_state_dict_from_url", lambda *_, **__: state)
    network = lpips.LPIPS(net=net, verbose=False)  # loads the weights as if downloaded
    a, b = np.random.default_rng(8).random((2, 40, LPIPS_SIZE, 3))
    tensors = [torch.tensor(x.transpose(2, 0, 1)[None], dtype=torch.float32) for x in (a, b)]
    expected = network(*tensors, normalize=True).item()
    assert load_lpips(tmp_path / "weights.pth").backbone == name
    assert compare_images(a, b, tmp_path / "weights.pth").lpips == pytest.approx(expected, rel=1e-5)
    assert compare_images(a, a, tmp_path / "weights.pth").lpips == 0


@pytest.mark.parametrize("net", BACKBONES)
def test_backbone_is_recognised_by_its_weights(stand_in, tmp_path, net):
    path = stand_in(tmp_path / "weights.pth", net)
    assert load_lpips(path).backbone == BACKBONES[net][0]
    image = np.zeros((LPIPS_SIZE, 40, 3))
    assert compare_images(image, image + 0.25, path).lpips == pytest.approx(0.75)
    assert compare_images(image, image + 0.25).lpips is None
    with pytest.raises(InvalidInput, match=r"40x30 pixels, expected at least 31 .* for LPIPS"):
        compare_images(image[1:], image[1:], path)


@pytest.mark.parametrize("net", BACKBONES)
def test_weights_of_another_shape_are_refused(stand_in, tmp_path, net):
    with pytest.raises(InvalidInput, match=r"weights.pth: not a state dict of torchvision, exp"):
        load_lpips(stand_in(tmp_path / "weights.pth", net, shape=(1, 3, 3, 3)))


@pytest.mark.parametrize("kind", ["text", "zip", "tensor", "list", "VGG19", "module"])
def test_unrelated_file_is_refused(stand_in, tmp_path, kind):
    import torch

    path = tmp_path / f"{kind}.pth"
    if kind in ("text", "zip"):
        path.write_bytes({"text": b"hello world", "zip": b"PK\3\4"}[kind])
    else:
        values = {
            "tensor": torch.ones(2),
            "list": ["features.26.weight"],
            "VGG19": {"features.28.weight": torch.ones(2)},
            "module": torch.nn.Linear(2, 2),  # code, which is not executed
        }
        torch.save(values[kind], path)
    with pytest.raises(InvalidInput, match=rf"{kind}.pth: not a state dict .*AlexNet$"):
        load_lpips(path)


@pytest.mark.parametrize(
    ("code", "why"),
    [
        ("import no_such_module", "No module named 'no_such_module'"),
        ("raise RuntimeError('operator torchvision::nms\\ndoes not exist')", "nms does not exist"),
    ],
)
def test_broken_package_is_named(folder, monkeypatch, code, why):
    (folder / "lpips.py").write_text(code)
    (folder / "weights.pth").write_bytes(b"weights")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "lpips", raising=False)
    result = compare("--lpips", "weights.pth", "--images", "out")
    assert isinstance(result.exception, MissingTool)
    assert str(result.exception).endswith(f"{why}); pip install 'gs-codec[lpips]'")
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("name", "why"),
    [("none.pth", "No such file or directory"), (".", "a directory, expected a file")],
)
def test_unreadable_file_is_refused(folder, name, why):
    result = compare("--lpips", name)
    assert isinstance(result.exception, InvalidInput)
    assert str(result.exception) == f"{name}: {why}"


def test_compare_names_the_backbone(stand_in, folder, monkeypatch):
    stand_in("weights.pth", "squeeze")
    lines = compare("--lpips", "weights.pth", "--gt-images", ".").stdout.splitlines()
    assert "LPIPS (SqueezeNet 1.1)" in lines[1]
    assert lines[1].endswith("delta-LPIPS")
    report = json.loads(compare("--lpips", "weights.pth", "--gt-images", ".", "--json").stdout)
    del report["seconds"]
    assert report["backbone"] == "SqueezeNet 1.1"
    mean = {name: report["mean"][name]["lpips"] for name in ("between", "a", "b", "delta")}
    assert mean["between"] > 0
    assert mean["delta"] == pytest.approx(mean["b"] - mean["a"])
    monkeypatch.setenv(LPIPS_VARIABLE, "weights.pth")
    again = json.loads(compare("--gt-images", ".", "--json").stdout)
    assert {name: again[name] for name in report} == report
    assert gs_codec.compare("a.ply", "b.ply", "cameras.json").backbone == "SqueezeNet 1.1"
    monkeypatch.setenv(LPIPS_VARIABLE, "")
    report = json.loads(compare("--json").stdout)
    assert (report["backbone"], report["mean"]["between"]["lpips"]) == (None, None)
