"""What `inspect` reports as taking no bits: absent, constant or zero parts, and unused models."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes import edge_scenes, encode_by, made_up_guide, random_scene
from typer.testing import CliRunner

from gs_codec.cli.main import app
from gs_codec.codecs import encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import DESCRIPTIONS, read_file

BASE = random_scene(2000, 3, seed=200)
LATTICES = ("l", "m", "s")
CLASSES = "classes: one for all"
PAPERS = ("paper-l", "paper-m", "paper-s")


def skipped(scene, profile, guide=None, **options):
    """The lines on a scene, without that on classes, which every camera-free file has."""
    lines = inspect_bytes(encode_by(scene, Config(profile, **options), guide)).skipped
    if profile in LATTICES and guide is None and scene.count:
        assert CLASSES in lines
    return [line for line in lines if line != CLASSES]


def with_rows(group, rows, value=0.0):
    plane = getattr(BASE, group).copy()
    plane[rows] = value
    return replace(BASE, **{group: plane})


def band_rows(*bands):
    """Rows of f_rest for whole bands."""
    spans = {1: range(3), 2: range(3, 8), 3: range(8, 15)}
    return [15 * colour + k for colour in range(3) for band in bands for k in spans[band]]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
@pytest.mark.parametrize(
    ("degree", "line"),
    [
        (0, "SH bands 1, 2, 3: absent (degree 0)"),
        (1, "SH bands 2, 3: absent (degree 1)"),
        (2, "SH band 3: absent (degree 2)"),
    ],
)
def test_absent_bands_and_normals_are_reported(profile, degree, line):
    scene = random_scene(300, degree, seed=201)
    normals = "normals: all zero, not stored"
    assert skipped(scene, profile)[:1] == [line]
    assert normals not in skipped(scene, profile)
    assert skipped(replace(scene, has_normals=True), profile)[:2] == [line, normals]


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_nothing_is_reported_if_everything_is_coded(profile):
    assert skipped(BASE, profile) == []
    assert skipped(random_scene(0, 3), profile) == []


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", PAPERS)
@pytest.mark.parametrize(
    ("group", "rows", "line"),
    [
        ("positions", [1], "y: constant"),
        ("positions", [0, 1, 2], "geometry: constant"),
        ("f_dc", [0, 2], "f_dc_0, f_dc_2: constant"),
        ("opacity", [0], "opacity: constant"),
        ("log_scale", [0, 1, 2], "scaling: constant"),
        ("rot", [3], "rot_3: constant"),
        ("f_rest", [0, 20], "f_rest_0, f_rest_20: constant"),
        ("f_rest", range(8, 15), "7 of 21 in sh3: constant"),
        ("f_rest", band_rows(2), "sh2: constant"),
    ],
)
def test_constant_channels_are_reported(profile, group, rows, line):
    lines = skipped(with_rows(group, list(rows), 0.25), profile)
    assert [text for text in lines if "constant" in text] == [line]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", [*LATTICES, *PAPERS])
@pytest.mark.parametrize(
    ("bands", "named"),
    [((3,), "SH band 3"), ((1, 3), "SH bands 1, 3"), ((1, 2, 3), "SH bands 1, 2, 3")],
)
def test_zero_bands_are_reported(profile, bands, named):
    end = " after rounding" if profile in LATTICES else ""
    lines = skipped(with_rows("f_rest", band_rows(*bands)), profile)
    assert [text for text in lines if "SH" in text] == [f"{named}: all zero{end}"]


@pytest.mark.parametrize("profile", LATTICES)
def test_all_zero_symbols_of_lattices_are_reported(profile):
    equal = np.full_like(BASE.log_scale, -5.0)
    turned = np.zeros_like(BASE.rot)
    turned[0] = 2.0
    scene = replace(BASE, log_scale=equal, rot=turned)
    opacity, flat = np.full_like(BASE.opacity, 3.0), with_rows("positions", [2], 1.5).positions
    scene = replace(scene, positions=flat, opacity=opacity)
    assert skipped(scene, profile)[:6] == [
        "z: constant",
        "opacity: constant",
        "scale_0: constant",
        "scale_1: the same as scale_0",
        "scale_2: the same as scale_1",
        "rotation: all zero after rounding",
    ]


def test_a_single_class_is_reported():
    varied = made_up_guide(seed=202)
    assert not any(line.endswith("one for all") for line in skipped(BASE, "m", varied))
    even = skipped(BASE, "m", made_up_guide(seed=203, spread=0.0))
    assert "colour classes: one for all" in even


def test_one_table_for_all_contexts_is_reported():
    scene, end = random_scene(60, 0, seed=204), ": one table for all contexts"
    info = inspect_bytes(encode_by(scene, Config("m"), made_up_guide(seed=204)))
    told = next(line for line in info.skipped if line.endswith(end)).removesuffix(end).split(", ")
    for item in info.passes[1:]:
        assert (item.name in told or item.stream in told) == (item.tables == 1), item.name
    # Without cameras, steps of opacity depend on nothing, so there is no context to choose.
    info = inspect_bytes(encode_scene(BASE, Config("m"))[0])
    assert [p.tables for p in info.passes if p.name == "opacity"] == [1]
    assert info.skipped == (CLASSES,)


@pytest.mark.parametrize("profile", ["paper-m", "m"])
def test_command_line_prints_what_is_skipped(profile, tmp_path):
    path = tmp_path / "scene.egs"
    path.write_bytes(encode_scene(random_scene(50, 1, seed=206), Config(profile))[0])
    printed = CliRunner().invoke(app, ["inspect", str(path)]).stdout
    listed = json.loads(CliRunner().invoke(app, ["inspect", str(path), "--json"]).stdout)["skipped"]
    assert listed[0] == "SH bands 2, 3: absent (degree 1)"
    assert printed.endswith("".join(["skipped:\n", *(f"  {line}\n" for line in listed)]))
    path.write_bytes(encode_scene(random_scene(0, 3), Config(profile))[0])
    assert "skipped" not in CliRunner().invoke(app, ["inspect", str(path)]).stdout


def test_tables_in_place_of_models_are_reported():
    two = edge_scenes()["two opacities"]
    line = "opacity: a table in place of a mixture model"
    assert line in skipped(two, "paper-m", models="best")
    assert line not in skipped(two, "paper-m")
    bits = np.random.default_rng(205).choice([-1.0, 1.0], BASE.f_rest.shape).astype(np.float32)
    line = "sh1, sh2, sh3: a table in place of a Laplace model"
    asked = {"depths": {"sh-ac": 5}, "models": "best"}
    assert skipped(replace(BASE, f_rest=bits), "paper-m", **asked) == [line]


@pytest.mark.parametrize("profile", ["paper-m", "m", "lossless"])
def test_inspect_reads_no_blocks(profile):
    data = bytearray(encode_scene(BASE, Config(profile, block_size=1024))[0])
    before = inspect_bytes(bytes(data))
    file = read_file(bytes(data))
    position = file.header_size
    for (section, _), size in file.sizes.items():
        if section not in DESCRIPTIONS:
            data[position : position + size] = bytes(size)
        position += size
    assert inspect_bytes(bytes(data)) == before
