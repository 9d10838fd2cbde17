"""Scenes of XGRIDS: `.lcc` with its binary files, and `.lcc2`, an octree of other scenes."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import foreign
import numpy as np
import pytest
from scenes import assert_same_floats, random_scene

from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import state_system, turn_axes
from gs_codec.formats.packed_values import sigmoid
from gs_codec.formats.registry import open_scene, overview_of, scene_files
from gs_codec.formats.sog.writer import pack_sog
from gs_codec.formats.spz.scene import pack_spz
from gs_codec.scene import SH_C0, join_scenes


def written(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / next(iter(files))


def expected_planes(rows: np.ndarray, sh: np.ndarray | None, low: float, high: float) -> dict:
    """Values of rows by the formulas of splat-transform's reader, Gaussian by Gaussian."""
    found: dict[str, list] = {n: [] for n in ("positions", "colour", "alpha", "scale", "rot", "sh")}
    for i, row in enumerate(rows):
        found["positions"].append(row["p"])
        found["colour"].append(row["c"][:3] / 255)
        found["alpha"].append(np.clip(int(row["c"][3]), 0.25, 254.75) / 255)
        found["scale"].append(1e-3 + (0.5 - 1e-3) * (row["s"] / 65535))
        packed = int(row["r"])
        three = [
            (packed >> shift & 1023) / 1023 * np.sqrt(2) - np.sqrt(0.5) for shift in (0, 10, 20)
        ]
        left = np.sqrt(max(0.0, 1 - np.dot(three, three)))
        x, y, z, w = np.insert(three, packed >> 30, left)
        found["rot"].append((w, x, y, z))
        for j in range(15 if sh is not None else 0):
            packed = int(sh[i, j])
            parts = (packed & 2047) / 2047, (packed >> 11 & 1023) / 1023, (packed >> 21) / 2047
            found["sh"].append([low + (high - low) * part for part in parts])
    return {name: np.array(value) for name, value in found.items()}


@pytest.mark.parametrize("kind", ["Quality", "Portable", None])
def test_the_finest_level_is_read_by_its_formula(kind, tmp_path, caplog):
    files, rows, sh = foreign.lcc_files(kind)
    path = written(tmp_path, files)
    scene = read_scene(path, coordinates=None)
    has_sh = kind != "Portable"
    count = sum(len(each) for each in rows)
    assert (scene.count, scene.sh_degree, scene.coordinates) == (count, 3 * has_sh, "RFU")
    parts = [
        expected_planes(part, values if has_sh else None, *bounds)
        for part, values, bounds in zip(rows, sh, ((-1, 1), (-0.5, 0.5)), strict=True)
    ]
    found = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    np.testing.assert_array_equal(scene.positions.T, found["positions"])
    np.testing.assert_allclose(0.5 + SH_C0 * scene.f_dc.T, found["colour"], atol=1e-6)
    np.testing.assert_allclose(sigmoid(scene.opacity[0].astype(float)), found["alpha"], atol=1e-6)
    np.testing.assert_allclose(np.exp(scene.log_scale.T), found["scale"], rtol=1e-6)
    np.testing.assert_allclose(scene.rot.T, found["rot"], atol=1e-6)
    if has_sh:
        rest = scene.f_rest.reshape(3, 15, count).transpose(2, 1, 0).reshape(-1, 3)
        np.testing.assert_allclose(rest, found["sh"], atol=1e-6)
    with open_scene(path) as file:
        assert file.stored_bytes == sum(map(len, files.values()))
    assert {each.name for each in scene_files(path)} >= files.keys()
    assert not caplog.messages


BAD = {
    "count": ("a.lcc", {"splats": [9]}, "index.bin: 7 Gaussians at the finest level, expected 9"),
    "levels": ("a.lcc", {"totalLevel": 0}, "a.lcc: levels 0, expected 1 to 64"),
    "no bounds": ("a.lcc", {"attributes": []}, "a.lcc: description: \"'scale'\""),
    "bounds": (
        "a.lcc",
        {"attributes": [{"name": "scale", "min": [0, 0], "max": [1, 1, 1]}]},
        "a.lcc: description: .*inhomogeneous",
    ),
    "index": ("index.bin", -1, r"index.bin: 71 bytes, expected a multiple of 36"),
    "data": ("data.bin", -200, r"data.bin: 4 Gaussians at byte 96, of"),
    "sh": ("shcoef.bin", -400, r"shcoef.bin: 4 Gaussians at byte 192, of"),
    "environment": (
        "environment.bin",
        -1,
        r"environment.bin: 191 bytes, expected a multiple of 96",
    ),
    "below 0": (
        "index.bin",
        struct.pack("<2hiqi", 0, 0, -3, 0, 0) + bytes(16),
        "index.bin: 4,294,967,293 Gaus",
    ),
    "missing": ("data.bin", None, "data.bin: No such file or directory"),
}


@pytest.mark.parametrize("case", BAD)
def test_damaged_files_are_refused_in_one_line(case, tmp_path):
    name, change, message = BAD[case]
    files, *_ = foreign.lcc_files("Portable" if case in ("bounds", "no bounds") else "Quality")
    if isinstance(change, dict):
        files[name] = json.dumps(json.loads(files[name]) | change).encode()
    elif isinstance(change, int):
        files[name] = files[name][:change]
    elif change is None:
        del files[name]
    else:
        files[name] = change
    path = written(tmp_path, files)
    with pytest.raises(InvalidInput, match=message) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("earlier", [False, True])
def test_lcc2_is_read_from_its_finest_nodes(earlier, tmp_path):
    scenes = [random_scene(40 + n, 1, seed=n) for n in range(4)]
    packed = [pack_sog(scene)[0] for scene in scenes]
    if not earlier:
        packed[0] = pack_spz(scenes[0])[0]
    suffixes = ["sog"] * 4 if earlier else ["spz", "sog", "sog", "sog"]
    files = {f"{n}.{s}": data for n, (s, data) in enumerate(zip(suffixes, packed, strict=True))}
    path = written(tmp_path, foreign.lcc2_files([*files], earlier) | files)
    used = [0, 1, 3]  # two finest nodes, and the environment
    parts = [read_scene(tmp_path / [*files][n], coordinates=None) for n in used]
    expected = join_scenes([state_system(part, "RFU") for part in parts])
    assert_same_floats(read_scene(path), turn_axes(expected))
    assert overview_of(path).count == 40 + 41 + 43
    assert overview_of(path).file_bytes == sum(
        (tmp_path / name).stat().st_size for name in (path.name, *(list(files)[n] for n in used))
    )
    # Some programs write surplus commas.
    path.write_bytes(path.read_bytes().replace(b"}", b",}").replace(b"]", b",\n]"))
    assert overview_of(path).count == 40 + 41 + 43


#: Two levels of a node of the first file.
ONE = {"child": [{"child": {"0": {"data": {"3dgs": {"name": 0}}}}}]}

BAD_2 = {
    "levels": ({"totalLevels": "2"}, "levels '2', expected 1 to 64"),
    "too deep": ({"totalLevels": 9}, "no files of the finest level"),
    "index": ({"root": {"splatFiles": [], **ONE}}, "a file beyond the 0 of"),
    "outside": (
        {"root": {"splatFiles": ["../a.sog"], **ONE}},
        "file '../a.sog', expected one in its folder",
    ),
    "kind": (
        {"root": {"splatFiles": ["a.lcc2"], **ONE}},
        r"a.lcc2: lcc, expected .sog or .spz",
    ),
}


@pytest.mark.parametrize("case", BAD_2)
def test_bad_lcc2_is_refused_in_one_line(case, tmp_path):
    change, message = BAD_2[case]
    about = json.loads(foreign.lcc2_files(["0.sog", "1.sog", "2.sog", "3.sog"])["a.lcc2"])
    path = written(tmp_path, {"a.lcc2": json.dumps(about | change).encode()})
    with pytest.raises(InvalidInput, match=message) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)
    assert scene_files(path) in ([path], [path, path])  # it may name itself
