"""The same bytes and floats on every run and machine, with any number of threads."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from golden.make import GUIDES, golden_scenes
from scenes import encode_by, made_up_guide, random_scene

from gs_codec.codecs import decode_scene
from gs_codec.config import ADAPTIVE_PROFILES, PROFILE_CHOICES, Config
from gs_codec.levels.building import Run
from gs_codec.scene import GROUPS, Scene

ROOT = Path(__file__).parents[1]

#: Packages whose floats determine the bytes of a file.
DECIDING = ("codecs", "coding", "egs")


def digests(threads: int | None) -> dict[str, str]:
    """Digests of the bytes and floats of each profile."""
    scene, found = random_scene(3000, 2, seed=90), {}
    for profile in PROFILE_CHOICES:
        config = Config(profile, threads=threads, block_size=1024)
        guides = [None, made_up_guide(seed=90)] if profile in ADAPTIVE_PROFILES else [None]
        for guide in guides:
            data = encode_by(scene, config, guide)
            name = f"{profile}, {'guided' if guide else 'blind'}"
            found[name] = hashlib.sha256(data + floats(decode_scene(data, threads))).hexdigest()
    return found


def floats(scene: Scene) -> bytes:
    return b"".join(getattr(scene, group).tobytes() for group in GROUPS)


def digest_of_levels() -> str:
    """Digest of the floats of merged Gaussians, of random shapes and spheres."""
    scene = random_scene(160, 1, seed=91)
    scene.log_scale[:, ::3] = scene.log_scale[0, ::3]
    merged = Run(scene).merged(0.1)
    return hashlib.sha256(floats(merged) + floats(Run(merged).merged(0.0))).hexdigest()


def run_alone(call: str, environment: dict[str, str]) -> str:
    """Result of a function of this module in a separate process."""
    environment = os.environ | environment | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    script = f"import json, test_determinism as t; print(json.dumps(t.{call}))"
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.thorough
def test_threads_and_runs_do_not_matter():
    expected = digests(1)
    for threads in (1, 2, 3, None):
        assert digests(threads) == expected


@pytest.mark.thorough
@pytest.mark.parametrize("blas_threads", ["1", "2"])
def test_processes_do_not_matter(blas_threads):
    """Each with another hash seed, and other thread counts of libraries."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    environment = dict.fromkeys(names, blas_threads) | {"PYTHONHASHSEED": blas_threads}
    assert run_alone("digests(2)", environment) == digests(1)


@pytest.mark.thorough
def test_processors_do_not_matter_to_levels():
    """Nor do compilers: kernels run as Python, numpy and BLAS as on the oldest processor."""
    features = np.show_config(mode="dicts")["SIMD Extensions"]["found"]  # type: ignore[index]
    environment = {
        "NPY_DISABLE_CPU_FEATURES": " ".join(features),
        "OPENBLAS_CORETYPE": "Prescott",
        "NUMBA_DISABLE_JIT": "1",
    }
    assert run_alone("digest_of_levels()", environment) == digest_of_levels()


@cache
def golden_encoded(name: str, threads: int) -> bytes:
    """What the encoder writes today of the scene of a golden file."""
    scene, config = golden_scenes()[name]
    return encode_by(scene, replace(config, threads=threads), GUIDES.get(name))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("name", golden_scenes())
def test_golden_files_are_written_and_read_by_any_threads(name, threads):
    assert golden_encoded(name, threads) == golden_encoded(name, 1 + threads % 2)
    golden = (ROOT / "tests" / "golden" / name).with_suffix(".egs")
    decoded = decode_scene(golden.read_bytes(), threads)
    with np.load(golden.with_suffix(".npz")) as expected:
        for group in GROUPS:
            assert getattr(decoded, group).tobytes() == expected[group].tobytes()


def sources() -> list[Path]:
    return [path for name in DECIDING for path in (ROOT / "gs_codec" / name).rglob("*.py")]


@pytest.mark.parametrize("path", sources(), ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_no_sum_is_left_to_blas(path):
    """Rounding of BLAS and LAPACK depends on the processor and the number of threads."""
    forbidden = {"dot", "vdot", "inner", "matmul", "tensordot", "einsum", "linalg"}
    for node in ast.walk(ast.parse(path.read_text())):
        assert not isinstance(node, ast.MatMult), f"{path}: @"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            assert not (node.value.id == "np" and node.attr in forbidden), f"{path}: {node.attr}"


def test_kernels_round_as_they_are_written():
    """Rounding of fast maths and parallel sums would depend on the machine."""
    for path in (ROOT / "gs_codec").rglob("*.py"):
        text = path.read_text()
        assert not any(word in text for word in ("fastmath=", "parallel=", "prange"))
