"""Decoding on a device gives the same values and errors as on the CPU.

The device is numba's simulator, in a separate process where nothing is compiled.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damage import BASIS, FAR, sample, with_section
from golden.make import GUIDES
from scenes import edge_scenes, encode_by, moved_apart, random_scene, seen_from

import gs_codec
from gs_codec.codecs import decode_scene
from gs_codec.codecs.cuda.lanes import pack_tables
from gs_codec.coding.context_rans import PRECISION, RUN_BITS, SPAN_BITS, PassTables
from gs_codec.coding.frequency_table import normalise
from gs_codec.config import Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.errors import GsCodecError, InvalidInput, MissingTool
from gs_codec.runtime.optional import is_available
from gs_codec.scene import Scene

pytestmark = [
    pytest.mark.skipif(not is_available("torch"), reason="torch is not installed"),
    pytest.mark.slow,
]

HERE = Path(__file__).parent
GOLDEN = [f"v1-{name}" for name in ("l", "s", "guided", "carried-m", "empty-m", "paper-m")]
EDGES = edge_scenes()
STRONG = random_scene(150, 3, seed=60)
DAMAGED = [f"damaged {name} {seed}" for name in SectionId if name > 1 for seed in range(2)]


def damaged(name: str) -> bytes:
    """A file of three blocks with bytes of a section changed, removed or added."""
    _, section, seed = name.split()
    data = sample("m", 8, 2)
    rng = np.random.default_rng([97, int(section), int(seed)])
    block = 0 if (int(section), 1) not in read_file(data).table else 1

    def change(content: bytes) -> bytes:
        kind = rng.integers(4)
        if kind == 0 or not content:
            return content + b"\1\2"
        if kind == 1:
            return content[:-1]
        changed = bytearray(content)
        for _ in range(kind):
            changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
        return bytes(changed)

    return with_section(data, SectionId(int(section)), change, block)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Files, and their results from a device."""
    folder = tmp_path_factory.mktemp("device")
    for name in GOLDEN:
        (folder / f"{name}.egs").write_bytes((HERE / "golden" / f"{name}.egs").read_bytes())
    for name, scene in EDGES.items():
        few = scene.take(np.arange(min(scene.count, 24)))
        data = encode_by(few, Config("m"), GUIDES["v1-guided"] if name == "pairs" else None)
        (folder / f"{name}.egs").write_bytes(data)
    (folder / "blocks.egs").write_bytes(sample("s", 70, 3, 33))
    (folder / "far.egs").write_bytes(sample(FAR, 20, 1, 8))
    (folder / "basis.egs").write_bytes(sample(BASIS, 30, 2, 20))
    bases = moved_apart(*(seen_from(random_scene(40, 3, k), 1, k, 100.0) for k in range(2)))
    (folder / "bases.egs").write_bytes(encode_by(bases, Config("m")))
    # Sums of SH-AC up to the highest contexts, and many tables.
    strong = replace(STRONG, f_rest=8 * STRONG.f_rest)
    (folder / "strong.egs").write_bytes(encode_by(strong, Config("m")))
    for name in DAMAGED:
        (folder / f"{name}.egs").write_bytes(damaged(name))
    simulated = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1"}
    paths = os.pathsep.join([str(HERE), str(HERE.parent)])
    done = subprocess.run(
        [sys.executable, str(HERE / "device_work.py"), str(folder)],
        env={**os.environ, **simulated, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def tensors_of(scene: Scene) -> dict[str, np.ndarray]:
    coefficients = len(scene.f_rest) // 3
    colours = scene.f_dc[:, None], scene.f_rest.reshape(3, coefficients, scene.count)
    return {
        "means": scene.positions.T,
        "quats": scene.rot.T,
        "log_scales": scene.log_scale.T,
        "logits": scene.opacity[0],
        "sh": np.concatenate(colours, axis=1).transpose(2, 1, 0),
    }


def check_same(found, scene: Scene) -> None:
    for name, rows in tensors_of(scene).items():
        values = np.asarray(found[name])
        assert values.shape == rows.shape, name
        np.testing.assert_array_equal(
            values.view(np.uint32), np.ascontiguousarray(rows).view(np.uint32), err_msg=name
        )


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*GOLDEN, *EDGES, "blocks", "far", "strong"])
def test_a_device_decodes_to_the_same_bits(folder, name):
    with np.load(folder / f"{name}.npz") as found:
        check_same(found, decode_scene((folder / f"{name}.egs").read_bytes()))


@pytest.mark.thorough
@pytest.mark.parametrize("name", DAMAGED)
def test_a_device_refuses_the_same_as_the_cpu(folder, name):
    refused = None
    try:
        scene = decode_scene((folder / f"{name}.egs").read_bytes())
    except GsCodecError as error:
        refused = type(error).__name__
    if refused is None:
        with np.load(folder / f"{name}.npz") as found:
            check_same(found, scene)
    else:
        assert (folder / f"{name}.txt").read_text() == refused


@pytest.mark.parametrize("profile", ["m", "paper-s", "lossless"])
def test_tensors_of_the_cpu_are_the_scene(tmp_path, profile):
    data = encode_by(random_scene(40, 2, seed=98), Config(profile))
    (tmp_path / "a.egs").write_bytes(data)
    for source in (data, tmp_path / "a.egs"):
        splats = gs_codec.decode_tensors(source, "cpu")
        check_same(vars(splats), decode_scene(data))
        np.testing.assert_array_equal(splats.scales, splats.log_scales.exp())
        np.testing.assert_array_equal(splats.opacities, splats.logits.sigmoid())
    assert gs_codec.encode_tensors(splats, Config("lossless")) == encode_by(
        decode_scene(data), Config("lossless")
    )
    halves = replace(splats, sh=splats.sh.bfloat16())
    floats = replace(splats, sh=splats.sh.bfloat16().float())
    assert gs_codec.encode_tensors(halves) == gs_codec.encode_tensors(floats)


def test_missing_devices_are_refused(monkeypatch):
    data = sample("m")
    with pytest.raises(InvalidInput, match="device 'tpu': expected cpu, cuda"):
        gs_codec.decode_tensors(data, "tpu")
    monkeypatch.setattr("torch.cuda.device_count", lambda: 0)
    with pytest.raises(MissingTool, match="device 'cuda:1': torch sees 0 CUDA devices"):
        gs_codec.decode_tensors(data, "cuda:1")
    monkeypatch.setattr("torch.cuda.device_count", lambda: 1)
    monkeypatch.setitem(sys.modules, "numba_cuda", None)
    with pytest.raises(MissingTool, match=r"device 'cuda': needs numba-cuda .* 'gs-codec\[cuda\]'"):
        gs_codec.decode_tensors(data)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingTool, match="device 'cpu': needs torch; pip install torch"):
        gs_codec.decode_tensors(data, "cpu")


def test_unsupported_configurations_for_tensors_are_refused():
    splats = gs_codec.decode_tensors(sample("m"), "cpu")
    for config, name in ((Config(lod=True), "lod"), (Config(format="spz"), "format 'spz'")):
        with pytest.raises(
            InvalidInput, match=f"{name}: cannot be encoded from tensors, expected .egs"
        ):
            gs_codec.encode_tensors(splats, config)
    with pytest.raises(InvalidInput, match="tensor 'quats': shape"):
        gs_codec.encode_tensors(replace(splats, quats=splats.quats[:, :3]))


def test_packed_tables_have_the_token_of_every_slot():
    rng = np.random.default_rng(99)
    tables = [
        normalise(weights * (rng.random(len(weights)) < 0.7) + (np.arange(len(weights)) == 0), 12)
        for weights in (rng.integers(0, 1 << 16, size) for size in (1, 2, 50, 240))
    ]
    runs, spans = (each.astype(np.int64) for each in pack_tables(PassTables.pack(tables)))
    slots = np.arange(1 << PRECISION)
    low = slots & ((1 << RUN_BITS) - 1)
    for row, table in enumerate(tables):
        run = runs[(row << (PRECISION - RUN_BITS)) + (slots >> RUN_BITS)]
        marks = ((run >> 8) & ((2 << low) - 1)).tolist()
        ranks = (run & 255) + [mark.bit_count() for mark in marks]
        found = spans[(row << SPAN_BITS) + ranks]
        np.testing.assert_array_equal(found & 255, table.slots)
        np.testing.assert_array_equal((found >> 8) & 4095, table.starts[table.slots])
        np.testing.assert_array_equal((found >> 20) + 1, table.frequencies[table.slots])
