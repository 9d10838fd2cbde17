"""Checkpoints of trainers, and their tensors: PyTorch's own readers and writers agree with ours."""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import struct
import sys
import tempfile
import tracemalloc
import zipfile
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refusals import assert_one_line, assert_refused
from scenes import assert_same_floats, random_scene

import gs_codec
from gs_codec.api.trainer_tensors import scene_of_trainer
from gs_codec.config import Config
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.scenes import read_scene, stated_bytes
from gs_codec.files.writing import write_scene
from gs_codec.formats.cloud import from_cloud
from gs_codec.formats.pickled import UNKNOWN, StoredTensor, parse_pickle, write_pickle
from gs_codec.formats.tensors import scene_of_tensors, tensors_of
from gs_codec.runtime.optional import is_available
from gs_codec.scene import GROUPS, SH_C0, Scene

#: Digests of a scene as .pt and as .ckpt, the same on every machine.
DIGESTS = ["534b0f52cb6333d9", "102bbd423f1d8983"]

needs_torch = pytest.mark.skipif(not is_available("torch"), reason="torch is not installed")


def assert_same(first: Scene, second: Scene) -> None:
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(first, group), getattr(second, group), group)


def trained(count: int = 30):
    """Parameters of gsplat's trainer; its SH are two views of one tensor."""
    import torch

    generator = torch.Generator().manual_seed(1)

    def some(*shape: int):
        return torch.randn(*shape, generator=generator)

    colours = some(count, 16, 3)
    of_scene = {"means": some(count, 3), "scales": some(count, 3), "quats": some(count, 4)}
    of_scene |= {"opacities": some(count), "sh0": colours[:, :1, :], "shN": colours[:, 1:, :]}
    return torch.nn.ParameterDict({n: torch.nn.Parameter(t) for n, t in of_scene.items()})


def assert_trained(scene: Scene, splats) -> None:
    expected = {name: tensor.detach().float().numpy() for name, tensor in splats.items()}
    for name, array in tensors_of(scene).items():
        np.testing.assert_array_equal(array, expected[name].reshape(array.shape), name)


def scene_of(tensors) -> Scene:
    return from_cloud(gs_codec.from_tensors(tensors))


# What we write


@pytest.mark.parametrize("count", [0, 1, 300])
@pytest.mark.parametrize("degree", range(4))
def test_written_checkpoints_round_trip(degree, count, tmp_path):
    scene = random_scene(count, degree)
    assert write_scene(tmp_path / "a.pt", scene, Config()).lost == ()
    assert_same(read_scene(tmp_path / "a.pt"), scene)
    assert stated_bytes(tmp_path / "a.pt") == scene.float_bytes
    write_scene(tmp_path / "a.ckpt", scene, Config())
    back = read_scene(tmp_path / "a.ckpt")
    assert back.sh_degree == 3
    rest = back.f_rest.reshape(3, 15, count)
    number = len(scene.f_rest) // 3
    np.testing.assert_array_equal(rest[:, :number], scene.f_rest.reshape(3, number, count))
    assert not rest[:, number:].any()
    assert_same(replace(back, f_rest=scene.f_rest), scene)


def test_the_same_scene_gives_the_same_bytes(tmp_path):
    scene = random_scene(5, 1, seed=3)
    exact = {g: np.round(8 * np.clip(getattr(scene, g), -4, 4)) / 8 for g in GROUPS}
    scene = Scene(**{group: plane.astype(np.float32) for group, plane in exact.items()})
    digests = []
    for name in ("a.pt", "a.ckpt"):
        write_scene(tmp_path / name, scene, Config())
        digests.append(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()[:16])
    assert digests == DIGESTS


def test_values_are_aligned_for_memory_maps(tmp_path):
    write_scene(tmp_path / "a.pt", random_scene(7, 3), Config())
    data = (tmp_path / "a.pt").read_bytes()
    with zipfile.ZipFile(tmp_path / "a.pt") as archive:
        for entry in archive.infolist():
            at = entry.header_offset
            name, extra = (int.from_bytes(data[at + i : at + i + 2], "little") for i in (26, 28))
            assert (at + 30 + name + extra) % 64 == 0


def test_losses_of_a_checkpoint_are_reported(tmp_path, caplog):
    scene = random_scene(5, 0)
    extra = {"label": np.arange(5, dtype="<i4")}
    scene = replace(scene, extra=extra, comments=("one", "SplatRenderMode: mip"))
    write_scene(tmp_path / "a.ply", scene, Config())
    report = convert_file(tmp_path / "a.ply", tmp_path / "a.ckpt")
    assert report.lost == ("left out: antialias flag; comments (1); properties label",)
    assert (report.count, report.sh_degree) == (5, 3)
    assert report.lost[0] in caplog.text


def captured(scene: Scene, axes: int = 3) -> tuple[dict, tuple]:
    """Storages by name, and what INRIA's trainer saves of a scene; with two axes, that of 2DGS."""
    arrays = tensors_of(scene)
    arrays["scales"] = np.ascontiguousarray(arrays["scales"][:, :axes])
    arrays["opacities"] = arrays["opacities"][:, None]
    names = ("means", "sh0", "shN", "scales", "quats", "opacities")
    storages = {f"data/{i}": arrays[name].tobytes() for i, name in enumerate(names)}
    tensors = [
        StoredTensor(
            *("torch FloatStorage", str(i), arrays[name].size, 0, arrays[name].shape),
            tuple(stride // 4 for stride in np.ascontiguousarray(arrays[name]).strides),
        )
        for i, name in enumerate(names)
    ]
    return storages, ((3, *tensors, {"state": {}}, 5), 30000)


def test_checkpoints_of_inrias_trainer_are_read(tmp_path):
    scene = random_scene(20, 3)
    storages, root = captured(scene)
    path = tmp_path / "chkpnt30000.pth"
    path.write_bytes(zipped(**{"data.pkl": write_pickle(root), **storages}))
    assert_same(read_scene(path), scene)
    assert stated_bytes(path) == scene.float_bytes
    path.write_bytes(zipped(**{"data.pkl": write_pickle(((3, *root[0][1:6]), 1)), **storages}))
    assert_refused(path, "without 'means', expected one of gsplat, splatfacto or INRIA's trainer")


def test_2d_gaussians_with_two_scales_are_flat(tmp_path, caplog):
    """As the trainer of 2DGS saves them, which is built on INRIA's."""
    scene = random_scene(20, 1)
    storages, root = captured(scene, axes=2)
    path = tmp_path / "chkpnt30000.pth"
    path.write_bytes(zipped(**{"data.pkl": write_pickle(root), **storages}))
    flat = read_scene(path)
    np.testing.assert_array_equal(flat.log_scale[:2], scene.log_scale[:2])
    np.testing.assert_array_equal(flat.log_scale[2], scene.log_scale[:2].min(axis=0) - 10)
    assert flat.comments == ("SplatRenderMode: 2dgs",)
    assert caplog.messages == [f"{path}: a 2DGS scene; its Gaussians are flat"]


@needs_torch
def test_what_pytorch_saves_of_inrias_trainer_is_read(tmp_path):
    """Parameters, and an optimiser with a learning rate of NumPy."""
    import torch

    splats = trained()
    names = ("means", "sh0", "shN", "scales", "quats", "opacities")
    values = [torch.nn.Parameter(splats[name].detach().clone()) for name in names]
    values[-1] = torch.nn.Parameter(values[-1].detach()[:, None])
    optimizer = torch.optim.Adam([{"params": values, "name": "xyz", "lr": np.float64(1e-3)}])
    sum(value.sum() for value in values).backward()
    optimizer.step()
    others = (torch.zeros(30), torch.zeros(30, 1), torch.zeros(30, 1), optimizer.state_dict(), 1.5)
    torch.save(((3, *values, *others), 7000), tmp_path / "chkpnt7000.pth")
    expected = {name: value.detach() for name, value in zip(names, values, strict=True)}
    assert_trained(read_scene(tmp_path / "chkpnt7000.pth"), expected)


@pytest.mark.one_in(4)
@needs_torch
@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize("degree", range(4))
def test_pytorch_reads_our_checkpoints(degree, mapped, tmp_path):
    import torch

    scene = random_scene(40, degree)
    write_scene(tmp_path / "a.pt", scene, Config())
    loaded = torch.load(tmp_path / "a.pt", weights_only=True, mmap=mapped)
    assert loaded["step"] == 0
    assert {name: tuple(t.shape) for name, t in loaded["splats"].items()} == {
        "means": (40, 3), "quats": (40, 4), "scales": (40, 3), "opacities": (40,),
        "sh0": (40, 1, 3), "shN": (40, len(scene.f_rest) // 3, 3),
    }  # fmt: skip
    assert_trained(scene, loaded["splats"])


@needs_torch
def test_splatfacto_loads_our_checkpoints(tmp_path):
    import torch

    scene = random_scene(40, 3)
    write_scene(tmp_path / "step-000000000.ckpt", scene, Config())
    loaded = torch.load(tmp_path / "step-000000000.ckpt", weights_only=True)
    assert list(loaded) == ["step", "pipeline", "optimizers", "schedulers", "scalers"]
    # nerfstudio loads tensors of any number of Gaussians into its model.
    shapes = {"means": (3,), "scales": (3,), "quats": (4,), "opacities": (1,)}
    shapes |= {"features_dc": (3,), "features_rest": (15, 3)}
    model = torch.nn.Module()
    model.gauss_params = torch.nn.ParameterDict({
        name: torch.nn.Parameter(torch.zeros(40, *shape)) for name, shape in shapes.items()
    })  # fmt: skip
    state = {k.removeprefix("_model."): v for k, v in loaded["pipeline"].items()}
    model.load_state_dict(state, strict=True)
    assert_trained(
        scene,
        {
            {"features_dc": "sh0", "features_rest": "shN"}.get(name, name): tensor
            for name, tensor in model.gauss_params.items()
        },
    )


# What trainers write


@needs_torch
def test_a_checkpoint_of_gsplat_is_read(tmp_path, caplog):
    import torch

    splats = trained()
    path = tmp_path / "ckpt_6999_rank0.pt"
    state = {"step": 6999, "scene_id": "garden", "splats": splats.state_dict()}
    state["pose_adjust"] = torch.nn.Embedding(3, 9).state_dict()
    torch.save(state, path)
    assert_trained(read_scene(path), splats)
    assert not caplog.messages
    torch.save(state, tmp_path / "ckpt_6999_rank1.pt")
    read_scene(path)
    assert "ckpt_6999_rank1.pt, contain the rest of the scene" in caplog.text
    torch.save(dict(splats.items()), tmp_path / "plain.zip")
    assert_trained(read_scene(tmp_path / "plain.zip"), splats)


@pytest.mark.thorough
@needs_torch
@pytest.mark.parametrize("prefix", ["_model.gauss_params.", "_model.", "_model.module.gauss."])
def test_a_checkpoint_of_splatfacto_is_read(prefix, tmp_path):
    import torch

    splats = trained()
    sum(each.sum() for each in splats.values()).backward()
    optimizer = torch.optim.Adam(splats.values())
    optimizer.step()
    renamed = {"sh0": "features_dc", "shN": "features_rest"}
    model = OrderedDict((prefix + renamed.get(n, n), t.detach()) for n, t in splats.items())
    model[prefix + "features_dc"] = model[prefix + "features_dc"][:, 0]
    model[prefix + "opacities"] = model[prefix + "opacities"][:, None]
    model["_model.lpips.net.weight"] = torch.ones(3, 3, dtype=torch.int64)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.9).state_dict()
    state = {"step": 29999, "pipeline": model, "optimizers": {"means": optimizer.state_dict()}}
    torch.save(state | {"schedulers": {"means": schedule}, "scalers": {}}, tmp_path / "a.ckpt")
    assert_trained(read_scene(tmp_path / "a.ckpt"), splats)
    # Without SH-AC, splatfacto stores colours before the sigmoid.
    model[prefix + "features_rest"] = torch.zeros(30, 0, 3)
    torch.save(state, tmp_path / "b.ckpt")
    colours = 0.5 + SH_C0 * read_scene(tmp_path / "b.ckpt").f_dc.T
    expected = torch.sigmoid(model[prefix + "features_dc"])
    np.testing.assert_allclose(colours, expected, atol=1e-6)


def test_the_configuration_of_a_run_stands_for_its_newest_checkpoint(tmp_path):
    """A run of nerfstudio: its checkpoints are numbered, and their names are padded to 9 digits."""
    config = tmp_path / "config.yml"
    config.write_text("!!python/object:nerfstudio.engine.trainer.TrainerConfig\nmethod: a\n")
    assert_refused(config, "without checkpoint, expected nerfstudio_models")
    models = tmp_path / "nerfstudio_models"
    models.mkdir()
    for step in (999, 1000, 1000000000):
        write_scene(models / f"step-{step:09}.ckpt", random_scene(9, 3, seed=step), Config())
    (models / "step-last.ckpt").touch()
    assert_same(read_scene(config), random_scene(9, 3, seed=1000000000))
    assert stated_bytes(config) == random_scene(9, 3).float_bytes
    newest = models / "step-1000000000.ckpt"
    newest.write_bytes(newest.read_bytes()[:100])
    with pytest.raises(InvalidInput) as caught:
        read_scene(config)
    assert_one_line(caught.value, newest)


def checkpoint_of_run(folder: Path) -> Path:
    """A checkpoint in a new folder."""
    folder.mkdir()
    path = folder / "ckpt_99_rank0.pt"
    write_scene(path, random_scene(9, 3), Config())
    return path


@pytest.mark.parametrize(
    ("folder", "name", "text"),
    [
        ("nerfstudio_models", "config.yml", "    rasterize_mode: antialiased\n    sh_degree: 3\n"),
        ("ckpts", "cfg.yml", "absgrad: false\nantialiased: true\n"),
        ("ckpts", "cfg.json", '{"absgrad": false, "antialiased": true, "app_opt": false}'),
    ],
)
def test_the_configuration_of_a_run_states_antialiasing(folder, name, text, tmp_path):
    path = checkpoint_of_run(tmp_path / folder)
    assert not read_scene(path).antialiased
    (tmp_path / name).write_text(text)
    assert read_scene(path).antialiased
    text = text.replace("antialiased: true", "antialiased: false").replace('": true', '": false')
    (tmp_path / name).write_text(text.replace("mode: antialiased", "mode: classic"))
    assert not read_scene(path).antialiased


def test_2d_gaussians_of_gsplat_are_flat(tmp_path, caplog):
    """Only the configuration of the run says that their third scale is not trained."""
    path = checkpoint_of_run(tmp_path / "ckpts")
    whole = read_scene(path)
    (tmp_path / "cfg.json").write_text('{"antialiased": true, "model_type": "2dgs"}')
    scene = read_scene(path)
    np.testing.assert_array_equal(scene.log_scale[:2], whole.log_scale[:2])
    np.testing.assert_array_equal(scene.log_scale[2], whole.log_scale[:2].min(axis=0) - 10)
    assert scene.comments == ("SplatRenderMode: 2dgs",)
    assert caplog.messages == [f"{path}: a 2DGS scene; its Gaussians are flat"]


# What trainers call


@needs_torch
def test_a_strategy_for_gsplat_compresses_its_splats(tmp_path):
    """What `Runner.run_compression` of simple_trainer.py does."""
    splats, compression = trained(), gs_codec.Compression("lossless")
    compression.compress(str(tmp_path), splats)
    back = compression.decompress(str(tmp_path))
    order = np.lexsort(splats["means"].detach().numpy().T)
    there = np.lexsort(back["means"].numpy().T)
    for name in splats:
        expected = splats[name].detach().numpy()[order]
        np.testing.assert_array_equal(back[name].numpy()[there], expected, name)
    gs_codec.Compression("s").compress(tmp_path, splats)
    assert compression.decompress(tmp_path)["shN"].shape == (30, 15, 3)
    with pytest.raises(InvalidInput, match="format 'spz': expected 'egs'"):
        gs_codec.Compression(Config(format="spz"))
    with pytest.raises(InvalidInput, match="tensor 'features': not known"):
        compression.compress(tmp_path, dict(splats) | {"features": splats["means"]})


@needs_torch
@pytest.mark.parametrize("kind", ["float16", "bfloat16", "float64"])
def test_other_floats_are_converted(kind, tmp_path):
    import torch

    splats = {n: t.detach().to(getattr(torch, kind)) for n, t in trained().items()}
    torch.save({"splats": splats}, tmp_path / "a.pt")
    assert_trained(read_scene(tmp_path / "a.pt"), splats)
    assert_trained(scene_of(splats), splats)


# Nothing is executed, and nothing is trusted


class Evil:
    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder / "made"),)


def test_calls_in_a_pickle_are_not_executed(tmp_path):
    data = pickle.dumps({"a": Evil(tmp_path), "b": [1, "x", (2.5, None)]}, 2)
    assert parse_pickle(data) == {"a": UNKNOWN, "b": [1, "x", (2.5, None)]}
    assert parse_pickle(pickle.dumps({"a": Evil(tmp_path), "s": {3}}, 4)) == {
        "a": UNKNOWN,
        "s": [3],
    }
    assert list(tmp_path.iterdir()) == []
    pickle.loads(data)
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_keys_that_are_slow_to_compare_are_ignored():
    assert parse_pickle(b"\x80\x02}" + LEAVES + b"K\x01s.") == {}


def test_large_integers_are_not_kept():
    """As keys they would be hashed repeatedly, and Python may refuse to print them."""
    large = b"\x8b" + struct.pack("<i", 1 << 20) + b"\1" * (1 << 20) + b"q\0"
    assert parse_pickle(b"\x80\x02" + large + b".") is UNKNOWN
    items = b"".join(b"h\0N" for _ in range(100_000))
    assert parse_pickle(b"\x80\x02" + large + b"}(" + items + b"u.") == {}
    assert parse_pickle(pickle.dumps({2**63: 2**64 - 1}, 2)) == {2**63: 2**64 - 1}


LEAVES = b"K\x01" + b"".join(b"q%ch%c\x86" % (i, i) for i in range(60))  # 2^60 references
FOR_EVER = {
    "a size": b"ctorch._utils\n_rebuild_tensor_v2\n("
    b"(X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\0aNK\x06tQK\0" + LEAVES + b")tR.",
    "a length": b"(X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\0aN" + LEAVES + b"tQ.",
}


@pytest.mark.parametrize("name", FOR_EVER)
def test_values_that_are_slow_to_print_are_refused(name):
    with pytest.raises(InvalidInput, match="pickle: tuple, expected a whole number"):
        parse_pickle(b"\x80\x02" + FOR_EVER[name])
    assert parse_pickle(b"\x80\x02" + LEAVES + b"K\x01\x93)R.") is UNKNOWN


def test_repeated_dictionary_is_searched_once(tmp_path):
    inner = b"}(" + b"".join(b"J%sN" % struct.pack("<i", i) for i in range(100_000)) + b"uq\0"
    outer = b"".join(b"J%sh\0" % struct.pack("<i", i) for i in range(100_000))
    pickled = b"\x80\x02}(K\0" + inner + outer + b"u."
    (tmp_path / "a.zip").write_bytes(zipped(**{"data.pkl": pickled}))
    with pytest.raises(InvalidInput, match="without 'means'"):
        read_scene(tmp_path / "a.zip")


def test_pickles_round_trip():
    tensor = StoredTensor("torch FloatStorage", "0", 12, 0, (4, 3), (3, 1))
    value = {"step": 0, "nothing": {}, "splats": {"means": tensor}}
    assert parse_pickle(write_pickle(value)) == value


def test_degree_4_of_tensors_is_dropped(caplog):
    tensors = tensors_of(random_scene(5, 3, seed=1))
    whole = np.pad(tensors["shN"], ((0, 0), (0, 9), (0, 0)), constant_values=1.0)
    assert_same_floats(scene_of_tensors(tensors | {"shN": whole}), scene_of_tensors(tensors))
    scene_of_tensors(tensors | {"shN": whole}, "a.pt")
    told = "left out: SH of degree 4"
    assert caplog.messages == [f"tensor 'shN': {told}", f"a.pt: {told}"]


def test_a_zip_of_two_checkpoints_is_refused(tmp_path):
    data = io.BytesIO(zipped())
    with zipfile.ZipFile(data, "a") as archive:
        archive.writestr("second/data.pkl", archive.read("x/data.pkl"))
    (tmp_path / "two.pt").write_bytes(data.getvalue())
    expected = r"a zip of 2 scenes \('second/data.pkl', 'x/data.pkl'\), expected one"
    with pytest.raises(InvalidInput, match=expected):
        read_scene(tmp_path / "two.pt")


def zipped(**changes: bytes | None) -> bytes:
    """A checkpoint of 2 Gaussians, with some entries changed or removed."""
    out = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder:
        write_scene(Path(folder, "a.pt"), random_scene(2, 0), Config())
        with zipfile.ZipFile(Path(folder, "a.pt")) as archive:
            names = archive.namelist()
            entries = {n.removeprefix("archive/"): archive.read(n) for n in names}
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in (entries | changes).items():
            if data is not None:
                archive.writestr(f"x/{name}", data)
    return out.getvalue()


def with_tensors(**changes) -> bytes:
    tensors = {
        name: StoredTensor("torch FloatStorage", str(i), 2 * width, 0, shape, strides)
        for i, (name, width, shape, strides) in enumerate([
            ("means", 3, (2, 3), (3, 1)), ("quats", 4, (2, 4), (4, 1)),
            ("scales", 3, (2, 3), (3, 1)), ("opacities", 1, (2,), (1,)),
            ("sh0", 3, (2, 1, 3), (3, 3, 1)),
        ])
    }  # fmt: skip
    tensors = {name: t for name, t in (tensors | changes).items() if t is not None}
    return zipped(**{"data.pkl": write_pickle({"splats": tensors})})


def stored(key: str = "0", length: int = 6, offset: int = 0, shape=(2, 3), strides=(3, 1)):
    return StoredTensor("torch FloatStorage", key, length, offset, shape, strides)


BAD = {
    "no pickle": (zipped(**{"data.pkl": None}), "a zip without meta.json"),
    "a number": (zipped(**{"data.pkl": pickle.dumps(3, 2)}), "without 'means'"),
    "no tensors": (zipped(**{"data.pkl": write_pickle({"means": 1})}), "without 'means'"),
    "a pickle of text": (zipped(**{"data.pkl": b"hello"}), "pickle: "),
    "an opcode": (zipped(**{"data.pkl": b"\x80\x02}(S'a'\nu."}), "opcode STRING, not expected"),
    "big-endian": (zipped(byteorder=b"big"), "byte order b'big', expected b'little'"),
    "no numbers": (zipped(**{"data/0": None}), "zip entry 'x/data/0': missing"),
    "few numbers": (zipped(**{"data/0": bytes(20)}), "storage '0': 20 bytes of 6"),
    "beyond the end": (
        with_tensors(means=stored(offset=1)),
        "storage '0': numbers 1 to 7 of",
    ),
    "far beyond": (with_tensors(means=stored(strides=(1 << 38, 1))), "storage '0': "),
    "integers": (
        with_tensors(means=replace(stored(), kind="torch LongStorage")),
        "tensor of 'torch LongStorage', expected floats",
    ),
    "no quats": (with_tensors(quats=None), "tensor 'quats': missing, expected means, quats"),
    "other shape": (
        with_tensors(quats=stored("1", 8, 0, (4, 2), (2, 1))),
        r"tensor 'quats': shape \(4, 2\), expected \(2, 4\)",
    ),
    "5 of SH": (
        with_tensors(shN=stored(shape=(2, 5, 3), strides=(0, 0, 0))),
        "tensor 'shN': 5 coefficients, expected one of 0, 3, 8, 15",
    ),
    "very many": (
        with_tensors(
            means=stored(shape=(1 << 39, 3), strides=(0, 0)),
            quats=stored(shape=(1 << 39, 4), strides=(0, 0)),
            scales=stored(shape=(1 << 39, 3), strides=(0, 0)),
            opacities=stored(shape=(1 << 39,), strides=(0,)),
            sh0=stored(shape=(1 << 39, 3), strides=(0, 0)),
        ),
        "549,755,813,888 Gaussians of 30,786,325,577,728 bytes; at most",
    ),
}


def with_large_storage(method: int) -> bytes:
    """A checkpoint of 2 Gaussians whose centres are in the middle of a storage of 96 MB."""
    length, out = 24 << 20, io.BytesIO()
    means = stored(length=length, offset=length // 2)
    numbers = np.zeros(length, "<f4")
    numbers[length // 2 : length // 2 + 6] = range(6)
    with zipfile.ZipFile(io.BytesIO(with_tensors(means=means))) as small:
        entries = {name: small.read(name) for name in small.namelist()}
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in (entries | {"x/data/0": numbers.tobytes()}).items():
            archive.writestr(name, data)
    return out.getvalue()


def test_only_the_used_part_of_a_large_storage_takes_memory(tmp_path):
    path = tmp_path / "a.pt"
    path.write_bytes(with_large_storage(zipfile.ZIP_STORED))
    tracemalloc.start()
    try:
        scene = read_scene(path)
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
    finally:
        tracemalloc.stop()
    np.testing.assert_array_equal(scene.positions.T.ravel(), range(6))
    path.write_bytes(with_large_storage(zipfile.ZIP_DEFLATED))
    assert_refused(path, "zip entry 'x/data/0': 100,663,296 bytes compressed, 24 of them used")


@pytest.mark.parametrize("name", BAD)
def test_bad_checkpoints_are_refused_in_one_line(name, tmp_path):
    data, message = BAD[name]
    path = tmp_path / "a.zip"
    path.write_bytes(data)
    assert_refused(path, message)


def test_checkpoints_are_valid_before_they_are_damaged(tmp_path):
    for data in (zipped(), with_tensors()):
        (tmp_path / "a.zip").write_bytes(data)
        assert read_scene(tmp_path / "a.zip").count == 2


def test_truncated_checkpoints_are_refused(tmp_path):
    write_scene(tmp_path / "a.pt", random_scene(1, 0), Config())
    data = (tmp_path / "a.pt").read_bytes()
    for end in range(1, len(data), 7):
        (tmp_path / "b.pt").write_bytes(data[:end])
        with pytest.raises(GsCodecError, match=r"b\.pt: "):
            read_scene(tmp_path / "b.pt")


def test_a_changed_byte_of_a_value_is_detected(tmp_path):
    scene = random_scene(3, 0)
    write_scene(tmp_path / "a.pt", scene, Config())
    data = bytearray((tmp_path / "a.pt").read_bytes())
    data[data.index(scene.positions.T.tobytes())] ^= 1
    (tmp_path / "a.pt").write_bytes(data)
    with pytest.raises(InvalidInput, match=r"zip entry 'archive/data/0': .*Bad CRC"):
        read_scene(tmp_path / "a.pt")


# Tensors


@pytest.mark.parametrize("count", [0, 1, 50])
@pytest.mark.parametrize("degree", range(4))
def test_tensors_round_trip(degree, count, tmp_path):
    write_scene(tmp_path / "a.ply", random_scene(count, degree), Config())
    cloud = gs_codec.read(tmp_path / "a.ply")
    tensors = gs_codec.to_tensors(cloud)
    assert all(t.dtype == np.float32 and t.flags.c_contiguous for t in tensors.values())
    assert_same(scene_of(tensors), from_cloud(cloud))
    before = from_cloud(gs_codec.from_tensors(tensors))
    cloud = gs_codec.from_tensors(tensors)
    for tensor in tensors.values():
        tensor += 1
    assert_same(from_cloud(cloud), before)


@needs_torch
def test_a_trainers_parameters_are_accepted_unchanged():
    import torch

    splats = trained()
    cloud = gs_codec.from_tensors(splats)
    assert_trained(from_cloud(cloud), splats)
    back = gs_codec.to_tensors(cloud, "torch")
    assert list(back) == ["means", "quats", "scales", "opacities", "sh0", "shN"]
    assert all(torch.equal(back[name], splats[name].detach()) for name in back)


ARRAYS = tensors_of(random_scene(4, 1))
BAD_TENSORS = {
    "none": ({}, "tensor 'means': missing, expected means, quats, scales, opacities, sh0, shN"),
    "appearance": (ARRAYS | {"features": ARRAYS["means"]}, "tensor 'features': not known"),
    "two names": (ARRAYS | {"features_dc": ARRAYS["sh0"]}, "some have two names"),
    "integers": (ARRAYS | {"means": np.ones((4, 3), int)}, "tensor 'means': int64, expected fl"),
    "rows": (ARRAYS | {"sh0": np.ones((5, 3))}, r"'sh0': shape \(5, 3\), expected \(4, 1, 3\)"),
    "a number": (ARRAYS | {"means": np.float32(1)}, r"'means': shape \(\), expected \(0, 3\)"),
}


@pytest.mark.parametrize("name", BAD_TENSORS)
def test_bad_tensors_are_refused(name):
    tensors, message = BAD_TENSORS[name]
    with pytest.raises(InvalidInput, match=message):
        gs_codec.from_tensors(tensors)


def test_libraries_of_tensors_are_numpy_and_torch(monkeypatch):
    cloud = gs_codec.from_tensors(ARRAYS)
    with pytest.raises(InvalidInput, match="library 'jax': expected one of numpy, torch"):
        gs_codec.to_tensors(cloud, "jax")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(gs_codec.MissingTool, match="to_tensors: needs torch; pip install torch"):
        gs_codec.to_tensors(cloud, "torch")


@needs_torch
def test_tensors_without_plain_values_are_refused():
    import torch

    splats = {name: tensor.detach() for name, tensor in trained().items()}
    means = splats["means"]
    turned = torch.complex(means, -means).conj().imag  # `means`, as a view with a negative bit
    scene = scene_of_trainer(splats | {"means": turned})
    np.testing.assert_array_equal(scene.positions, means.numpy().T)
    for other in (means.to_sparse(), means.to("meta")):
        with pytest.raises(InvalidInput, match="tensor: "):
            scene_of_trainer(splats | {"means": other})
    with pytest.raises(InvalidInput, match="tensor 'means': complex64, expected floats"):
        scene_of_trainer(splats | {"means": torch.complex(means, means).conj()})
