"""The command line: results on stdout, one line per error, no files left behind."""

from __future__ import annotations

import errno
import os
import re
import struct
import subprocess
import sys
import threading
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import ROOT, Folder, assert_one_error_line, python, strict_json
from crc32c import crc32c
from scenes import random_scene, thorough

from gs_codec import __version__
from gs_codec.cli import output
from gs_codec.cli.main import describe_error
from gs_codec.cli.output import progress_lines
from gs_codec.config import ADAPTIVE_PROFILES, PROFILES, Config
from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.egs.sections import write_extra
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.files.writing import write_scene
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import GROUPS

COMMANDS = ("encode", "decode", "verify", "inspect", "compare", "bench")


# What works


def test_encode_and_decode_write_the_librarys_bytes(folder, trio):
    status, out, err = folder.run("encode", "scene.ply", "out.egs", "-p", "paper-m")
    assert (status, err) == (0, "")
    assert (folder.path / "out.egs").read_bytes() == trio.egs.read_bytes()
    assert out.startswith("out.egs: 1,500 Gaussians, 355.48 kB -> ")
    out = folder.run("inspect", "out.egs").out
    assert {"geometry", "sh-dc", "opacity", "scaling", "rotation", "sh1", "sh2", "sh3"} <= {
        line.split()[0] for line in out.splitlines()
    }
    status, out, err = folder.run("decode", "out.egs", "out.ply")
    assert (status, err) == (0, "")
    assert (folder.path / "out.ply").read_bytes() == trio.decoded.read_bytes()
    assert out.startswith("out.ply: 1,500 Gaussians, SH degree 3, 355.")


def test_encode_reports_as_json(folder):
    status, out, err = folder.run("encode", "scene.ply", "out.egs", "--json", "-p", "paper-m")
    report = strict_json(out)
    assert (status, err) == (0, "")
    size = (folder.path / "out.egs").stat().st_size
    assert sum(report["section_bytes"].values()) == report["output_bytes"] == size
    assert report["input_bytes"] == (folder.path / "scene.ply").stat().st_size
    expected = {"gaussians": 1500, "raw_bytes": 1500 * 59 * 4, "profile": "paper-m", "dropped": 0}
    assert report | expected == report
    assert len(report["costs"]) == 1 + 3 + 4 + 45


def test_decode_reports_as_json(folder):
    status, out, err = folder.run("decode", "scene.egs", "out.ply", "--json", "--threads", "2")
    size = (folder.path / "out.ply").stat().st_size
    assert (status, err) == (0, "")
    expected = {"gaussians": 1500, "sh_degree": 3, "output": "out.ply", "output_bytes": size}
    assert strict_json(out) | expected == strict_json(out)


@pytest.mark.parametrize("profile", PROFILES)
def test_profile_determines_the_depths(folder, profile):
    assert folder.run("encode", "scene.ply", "out.egs", "-p", profile).status == 0
    info = strict_json(folder.run("inspect", "out.egs", "--json").out)
    assert info["profile"] == profile
    assert {c["stream"]: c["depth"] for c in info["channels"]} == PROFILES[profile]


def test_depth_may_be_given_several_times(folder):
    depths = [
        "-p",
        "paper-m",
        "--depth",
        "sh-ac=5",
        "--depth",
        "sh3=2",
        "--depth",
        "geometry=12",
    ]
    assert folder.run("encode", "scene.ply", "out.egs", *depths).status == 0
    info = strict_json(folder.run("inspect", "out.egs", "--json").out)
    used = {channel["stream"]: channel["depth"] for channel in info["channels"]}
    expected = dict(PROFILES["paper-m"]) | {"sh1": 5, "sh2": 5, "sh3": 2, "geometry": 12}
    assert used == expected


def test_inspect_describes_the_file(folder, trio):
    scene = read_ply(trio.ply)
    status, out, err = folder.run("inspect", "scene.egs", "--json")
    info = strict_json(out)
    assert (status, err) == (0, "")
    size = trio.egs.stat().st_size
    assert (info["gaussians"], info["sh_degree"], info["blocks"]) == (1500, 3, 1)
    assert info["input_bytes"] == size == sum(stream["bytes"] for stream in info["streams"])
    assert info["ratio"] == pytest.approx(1500 * 59 * 4 / size)
    np.testing.assert_allclose(
        info["bounds"], [scene.positions.min(axis=1), scene.positions.max(axis=1)]
    )
    plain = folder.run("inspect", "scene.egs").out
    listed = folder.run("inspect", "scene.egs", "--channels").out
    assert plain.startswith("scene.egs: version 1, profile paper-m, 1,500 Gaussians, SH degree 3")
    assert listed.startswith(plain)
    rows = {line.split()[0] for line in listed[len(plain) :].splitlines()}
    assert {"x", "f_dc_2", "opacity", "scale_1", "rot_3", "f_rest_44"} <= rows


def test_encode_prints_a_line_and_the_loss_of_views(folder):
    for options in ([], ["-p", "paper-m"], ["-p", "lossless"]):
        out = folder.run("encode", "scene.ply", "out.egs", "--overwrite", *options).out
        first, *others = out.splitlines()
        assert first.startswith("out.egs: 1,500 Gaussians, ")
        assert len(others) == ("lossless" not in options)
        assert all(line.startswith("rendered views: ") for line in others)


def test_ratio_of_a_compressed_source_is_relative_to_the_floats(folder):
    write_scene("a.splat", read_ply("scene.ply"), Config())
    out = folder.run("encode", "a.splat", "out.egs").out
    size = Path("out.egs").stat().st_size
    assert f" 48.00 kB -> {size / 1e3:.2f} kB ({1500 * 56 / size:.2f}x relative to the" in out


def test_a_file_that_is_not_smaller_than_its_rounded_source_is_reported(folder, caplog):
    folder.run("encode", "scene.ply", "a.spz", "--coarseness", "12")
    warning = "out.egs: not smaller than its source, whose values are already rounded"
    for profile, is_reported in (("l", True), ("s", False), ("lossless", False)):
        caplog.clear()
        folder.run("encode", "a.spz", "out.egs", "-p", profile, "--overwrite")
        assert (warning in caplog.messages) == is_reported, profile


@pytest.mark.parametrize("suffix", ["ply", "splat", "egs"])
def test_inspect_describes_every_scene(folder, suffix):
    scene = replace(
        read_ply("scene.ply"), comments=("CoordinateSystem: RUB", "SplatRenderMode: mip")
    )
    write_scene(f"a.{suffix}", scene, Config("m" if suffix == "splat" else "lossless"))
    status, out, err = folder.run("inspect", f"a.{suffix}")
    assert (status, err) == (0, "")
    kept = suffix != "splat"
    degree = 3 if kept else 0
    assert f"1,500 Gaussians, SH degree {degree}" in out.splitlines()[0]
    assert out.startswith(f"a.{suffix}: {'version 1' if suffix == 'egs' else suffix}, ")
    where = [line for line in out.splitlines() if line.startswith("bounds ")]
    assert len(where) == 1
    info = strict_json(folder.run("inspect", f"a.{suffix}", "--json").out)
    bounds = [scene.positions.min(axis=1), scene.positions.max(axis=1)]
    np.testing.assert_allclose(info["bounds"], bounds)
    assert (info["gaussians"], info["sh_degree"], info["antialiased"]) == (1500, degree, kept)
    assert info["raw_bytes"] == 4 * 1500 * (14 + 45 * kept)


def test_inspect_lists_extra_properties_of_a_ply(folder):
    scene = read_ply("scene.ply")
    scene.positions[:, 3] = np.inf
    write_ply("labels.ply", replace(scene, extra={"label": np.arange(1500, dtype="<u2")}))
    out = folder.run("inspect", "labels.ply").out
    assert out.splitlines()[-1] == "other properties: label"
    assert "inf" not in out
    write_ply("none.ply", random_scene(0))
    assert "no bounds" in folder.run("inspect", "none.ply").out


def test_compare_prints_the_errors(folder):
    status, out, err = folder.run("compare", "scene.ply", "decoded.ply", "--json")
    result = strict_json(out)
    assert (status, err) == (0, "")
    assert (result["input"], result["gaussians"]) == (["scene.ply", "decoded.ply"], [1500, 1500])
    assert result["matched_by"] == "stored order"
    errors = {(group["name"], group["unit"]): group["max"] for group in result["groups"]}
    assert 0 < errors["positions", "scene units"] < 1e-4
    lines = folder.run("compare", "scene.ply", "decoded.ply").out.splitlines()
    assert lines[0] == "1,500 Gaussians, matched by stored order"
    assert len(lines) == 3 + len(result["groups"])
    assert lines[-1].endswith("--cameras auto compares rendered views")
    assert f"{errors['opacity', 'logit']:.6g}" in lines[5].split()


def test_identical_files_have_no_error(folder):
    result = strict_json(folder.run("compare", "scene.egs", "decoded.ply", "--json").out)
    assert result["matched_by"] == "index"
    assert {group["max"] for group in result["groups"]} == {0}


@pytest.mark.parametrize("count", [0, 1])
def test_smallest_scenes_pass_through_all_commands(folder, count):
    write_ply("small.ply", random_scene(count, 3))
    for arguments in (
        ["encode", "small.ply", "small.egs"],
        ["inspect", "small.egs", "--channels"],
        ["decode", "small.egs", "back.ply"],
        ["compare", "small.ply", "back.ply"],
    ):
        status, out, err = folder.run(*arguments)
        assert (status, err) == (0, "")
        assert out
    info = strict_json(folder.run("inspect", "small.egs", "--json").out)
    compared = strict_json(folder.run("compare", "small.ply", "back.ply", "--json").out)
    assert (info["gaussians"], compared["gaussians"]) == (count, [count, count])


def test_extra_properties_are_refused_kept_or_dropped(folder, caplog):
    label = np.arange(1500, dtype="<u2")
    write_ply("labels.ply", replace(read_ply("scene.ply"), extra={"label": label}))
    refused = folder.refuse("encode", "labels.ply", "out.egs", "--extra", "error")
    assert "--extra keep or --extra drop" in refused
    for choice, names in (("keep", ["label"]), ("drop", []), ("auto", [])):
        assert folder.run("encode", "labels.ply", f"{choice}.egs", "--extra", choice).status == 0
        assert ("left out: properties label" in caplog.text) == (not names)
        caplog.clear()
        assert folder.run("decode", f"{choice}.egs", f"{choice}.ply").status == 0
        assert list(read_ply(f"{choice}.ply", "keep").extra) == names


def test_nonfinite_gaussians_are_refused_or_dropped(folder):
    scene = read_ply("scene.ply")
    scene.opacity[0, [4, 5]] = np.nan
    scene.rot[2, 5] = np.inf
    scene.f_rest[44, 9] = -np.inf
    write_ply("holes.ply", scene)
    message = folder.refuse("encode", "holes.ply", "out.egs")
    assert "holes.ply: " in message
    assert "1 in f_rest, 2 in opacity, 1 in rot" in message
    status, out, err = folder.run("encode", "holes.ply", "out.egs", "--nonfinite", "drop")
    assert (status, err) == (0, "dropped 3 Gaussians with NaN or infinity\n")
    assert "1,497 Gaussians" in out
    out = folder.run("encode", "holes.ply", "o.egs", "--nonfinite", "drop", "--json").out
    assert strict_json(out)["dropped"] == 3


def test_zero_quaternions_are_reported(folder):
    scene = read_ply("scene.ply")
    scene.rot[:, [1, 2]] = 0
    write_ply("zero.ply", scene)
    status, _, err = folder.run("encode", "zero.ply", "out.egs")
    assert (status, err) == (0, "replaced 2 zero quaternions by the identity\n")
    out = folder.run("encode", "zero.ply", "again.egs", "--json").out
    assert strict_json(out)["zero_quaternions"] == 2


def test_an_existing_file_is_refused_with_the_callers_option(folder):
    (folder.path / "b.egs").touch()
    with pytest.raises(InvalidInput, match=r"b\.egs: already exists; .* overwrite=True$"):
        encode_file("scene.ply", "b.egs")
    assert folder.refuse("encode", "scene.ply", "b.egs").endswith(" --overwrite\n")
    refused = folder.refuse("convert", "scene.ply", "c.egs", "--filter", "x>1e9")
    assert refused.startswith("gs-codec: error: scene.ply: --filter x>1e9: no Gaussian is left")


def test_an_existing_file_is_replaced(folder, trio):
    for name in ("out.egs", "out.ply"):
        (folder.path / name).write_bytes(b"old" * 1_000_000)
    arguments = ("scene.ply", "out.egs", "-p", "paper-m", "--overwrite")
    assert folder.run("encode", *arguments).status == 0
    assert folder.run("decode", "out.egs", "out.ply", "--overwrite").status == 0
    assert (folder.path / "out.egs").read_bytes() == trio.egs.read_bytes()
    assert (folder.path / "out.ply").read_bytes() == trio.decoded.read_bytes()


@pytest.mark.parametrize("command", [(), *((name,) for name in COMMANDS)], ids=" ".join)
@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help(folder, command, flag):
    status, out, err = folder.run(*command, flag)
    assert (status, err) == (0, "")
    assert all(name in out for name in COMMANDS) if not command else "--" in out


def test_no_command_shows_the_help(folder):
    _, out, err = folder.run()
    assert all(name in out for name in COMMANDS)
    assert err == ""


def test_version(folder):
    assert folder.run("--version") == (0, f"gs-codec {__version__}\n", "")


def test_name_that_is_not_unicode_can_be_printed(folder, trio):
    name = os.fsdecode(b"out\xff.egs")
    assert folder.run("encode", "scene.ply", name, "--json").status == 0
    assert folder.run("encode", "scene.ply", name, "-p", "paper-m", "--overwrite").status == 0
    assert (folder.path / name).read_bytes() == trio.egs.read_bytes()


# Lattices, and parts of scenes


@pytest.fixture
def lattice(folder) -> Folder:
    """The folder with `l.egs`, `m.egs` and `s.egs` added."""
    for profile in ADAPTIVE_PROFILES:
        encode_file("scene.ply", f"{profile}.egs", Config(profile, block_size=1024))
    return folder


@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_encode_to_lattices_writes_the_librarys_bytes(folder, profile):
    status, out, err = folder.run("encode", "scene.ply", "out.egs", "-p", profile)
    assert (status, err) == (0, "")
    encode_file("scene.ply", "library.egs", Config(profile))
    assert Path("out.egs").read_bytes() == Path("library.egs").read_bytes()
    assert out.startswith("out.egs: 1,500 Gaussians, 355.48 kB -> ")
    listed = folder.run("inspect", "out.egs").out.split("skipped:")[0]
    header, *rows = [line.split() for line in listed.splitlines()[3:]]
    assert header == ["stream", "bytes", "bits/Gaussian", "depth", "models"]
    sizes = {row[0]: int(row[1].replace(",", "")) for row in rows}
    assert sum(sizes.values()) == Path("out.egs").stat().st_size
    assert set(sizes) >= {"lattice", "index", "classes", "low-bits", "geometry", "sh3"}


def test_encode_to_lattices_reports_as_json(folder):
    status, out, err = folder.run("encode", "scene.ply", "out.egs", "-p", "m", "--json")
    report = strict_json(out)
    assert (status, err, report["profile"], report["gaussians"]) == (0, "", "m", 1500)
    assert sum(report["section_bytes"].values()) == report["output_bytes"]
    assert len(report["costs"]) == 10 + 3 + 9
    for cost in report["costs"]:
        assert cost["coded_bits"] >= cost["shannon_bits"] * (1 - 1e-12), cost["name"]


def test_values_beyond_the_lattices_are_reported(folder):
    scene = read_ply("scene.ply")
    scene.opacity[0, :3] = 1e6
    write_ply("far.ply", scene)
    status, _, err = folder.run("encode", "far.ply", "out.egs", "-p", "m")
    assert (status, err) == (0, "values clipped to 400: 3\n")


@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_inspect_describes_lattices(lattice, profile):
    scene, name = read_ply("scene.ply"), f"{profile}.egs"
    status, out, err = lattice.run("inspect", name, "--json")
    info = strict_json(out)
    assert (status, err) == (0, "")
    assert (info["profile"], info["gaussians"], info["blocks"]) == (profile, 1500, 2)
    assert info["channels"] == []
    assert sum(stream["bytes"] for stream in info["streams"]) == info["input_bytes"]
    assert [p["name"] for p in info["passes"][:3]] == ["shape class", "colour class", "opacity"]
    assert len(info["passes"]) == 10 + 3 + 9
    for item in info["passes"]:
        assert 0 < item["finest_step"] <= item["coarsest_step"]
        assert item["tables"] >= 1
    assert len(info["grid"]["bits"]) == 3
    np.testing.assert_allclose(
        info["bounds"], [scene.positions.min(axis=1), scene.positions.max(axis=1)], atol=0.1
    )
    plain = lattice.run("inspect", name).out
    assert plain.startswith(f"{name}: version 1, profile {profile}, 1,500 Gaussians, SH degree 3")
    listed = lattice.run("inspect", name, "--channels").out
    assert listed.startswith(plain)
    header, *rows = [line.split() for line in listed[len(plain) :].splitlines()]
    assert header == ["symbols", "stream", "tables", "finest", "step", "coarsest", "step"]
    assert {row[0] for row in rows} >= {"opacity", "scale_2", "tilt_1", "f_dc", "SH", "sh1"}
    tables = {line.split()[0]: line.split()[-2] for line in plain.splitlines() if " table" in line}
    assert tables == {s["name"]: str(s["tables"]) for s in info["streams"] if s["tables"]}
    for stream, number in tables.items():
        listed_tables = [int(p["tables"]) for p in info["passes"] if p["stream"] == stream]
        # Passes of SH share tables.
        assert max(listed_tables) <= int(number) <= sum(listed_tables)
        assert stream.startswith("sh") or int(number) == sum(listed_tables)


@pytest.mark.parametrize("name", ["m.egs", "scene.egs"])
def test_decode_of_a_lower_degree(lattice, name):
    status, out, err = lattice.run("decode", name, "out.ply", "--sh-degree", "1")
    assert (status, err) == (0, "")
    first, second = out.splitlines()
    assert first.startswith("out.ply: 1,500 Gaussians, SH degree 1, ")
    assert re.fullmatch(rf"read [0-9.]+ kB of {name} \([0-9]+%\)", second)
    scene = read_ply("out.ply")
    assert scene.sh_degree == 1
    report = strict_json(lattice.run("decode", name, "o.ply", "--sh-degree", "0", "--json").out)
    assert report["sh_degree"] == 0
    assert report["bytes_read"] < report["input_bytes"] == Path(name).stat().st_size
    assert lattice.run("compare", "scene.ply", "out.ply").status == 0


@pytest.mark.parametrize("name", ["m.egs", "scene.egs"])
def test_decode_of_a_box(lattice, name):
    assert lattice.run("decode", name, "whole.ply").status == 0
    status, out, err = lattice.run("decode", name, "out.ply", "--bbox", "-9,-9,-9,0,9,9.5")
    assert (status, err) == (0, "")
    whole, part = read_ply("whole.ply"), read_ply("out.ply")
    inside = whole.positions[0] <= 0
    assert out.startswith(f"out.ply: {inside.sum():,} Gaussians, SH degree 3, ")
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(part, group), getattr(whole, group)[:, inside])
    assert part.comments == ()
    line = lattice.refuse("decode", name, "none.ply", "--bbox", "8,8,8,9,9,9")
    assert f"{name}: no Gaussians in the box, bounds -" in line


@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
@pytest.mark.parametrize("count", [0, 1])
def test_smallest_scenes_pass_through_all_commands_with_lattices(folder, profile, count):
    write_ply("small.ply", random_scene(count, 3))
    for arguments in (
        ["encode", "small.ply", "small.egs", "-p", profile],
        ["inspect", "small.egs", "--channels"],
        ["decode", "small.egs", "back.ply"],
        ["decode", "small.egs", "part.ply", "--bbox=-9,-9,-9,9,9,9", "--sh-degree", "2"],
        ["compare", "small.ply", "back.ply"],
    ):
        status, out, err = folder.run(*arguments)
        assert (status, err) == (0, "")
        assert out
    info = strict_json(folder.run("inspect", "small.egs", "--json").out)
    compared = strict_json(folder.run("compare", "small.ply", "back.ply", "--json").out)
    assert (info["gaussians"], compared["gaussians"]) == (count, [count, count])


@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_lattices_are_compared_with_their_original(lattice, profile):
    for pair in (["scene.ply", f"{profile}.egs"], [f"{profile}.egs", "scene.ply"]):
        result = strict_json(lattice.run("compare", *pair, "--json").out)
        assert result["matched_by"] == "stored order"
        errors = {(group["name"], group["unit"]): group["rms"] for group in result["groups"]}
        assert 0 < errors["positions", "scene units"] < 0.02
    found = strict_json(lattice.run("compare", "l.egs", "s.egs", "--json").out)
    assert found["matched_by"] in ("index", "nearest centre")


# What is refused


def resealed(data: bytes, position: int, patch: bytes) -> bytes:
    """The stream with other header bytes, and a matching header checksum."""
    size = struct.unpack_from("<I", data, 12)[0]
    head = data[:position] + patch + data[position + len(patch) : size - 4]
    return head + struct.pack("<I", crc32c(head)) + data[size:]


def flipped(data: bytes, position: int) -> bytes:
    position %= len(data)
    return data[:position] + bytes([data[position] ^ 16]) + data[position + 1 :]


def without(name: str) -> Callable[[bytes], bytes]:
    return lambda good: good.replace(f"property float {name}\n".encode(), b"", 1)


BAD_PLY = {
    "empty": (lambda good: b"", "empty file"),
    "text": (lambda good: b"these are\nno Gaussians\n", "expected 'ply'"),
    "truncated": (lambda good: good[:-100], "the file ends in row 1499"),
    "truncated header": (lambda good: good[:300], "end-of-file"),
    "missing property": (without("opacity"), "missing property 'opacity'"),
    "wrong f_rest": (without("f_rest_7"), "44 f_rest"),
}
BAD_EGS = {
    "empty": (lambda good: b"", "empty file"),
    "text": (lambda good: b"these are\nno Gaussians\n", "not an .egs file"),
    "signature alone": (lambda good: good[:8], "header"),
    "version 3": (lambda good: resealed(good, 8, b"\3\0"), "version 3 .*knows 1 and 2"),
    "version 0": (lambda good: resealed(good, 8, b"\0\0"), "version 0"),
    "reserved flag": (lambda good: resealed(good, 28, b"\x08"), "reserved"),
    "bit of the count": (lambda good: flipped(good, 16), "header"),
    "bit of the section table": (lambda good: flipped(good, 40), "header"),
    "bit of the channels": (lambda good: flipped(good, 400), "section 1 .*checksum"),
    "one byte short": (lambda good: good[:-1], "bytes, expected"),
    "half": (lambda good: good[: len(good) // 2], "bytes, expected"),
    "one byte more": (lambda good: good + b"\0", "bytes, expected"),
}


@pytest.mark.parametrize("name", BAD_PLY)
def test_bad_ply_is_refused(folder, name):
    make, message = BAD_PLY[name]
    Path("bad.ply").write_bytes(make(Path("scene.ply").read_bytes()))
    for arguments in (["encode", "bad.ply", "out.egs"], ["compare", "scene.ply", "bad.ply"]):
        if name == "empty" and arguments[0] == "compare":
            message = "empty file"
        line = folder.refuse(*arguments)
        assert "bad.ply: " in line
        assert re.search(message, line)


@pytest.mark.parametrize("name", BAD_EGS)
def test_bad_egs_is_refused(folder, name):
    make, message = BAD_EGS[name]
    Path("bad.egs").write_bytes(make(Path("scene.egs").read_bytes()))
    for arguments in (
        ["decode", "bad.egs", "out.ply"],
        ["inspect", "bad.egs"],
        ["compare", "scene.ply", "bad.egs"],
    ):
        line = folder.refuse(*arguments)
        assert "bad.egs: " in line
        assert re.search(message, line)


def test_bit_of_the_last_section_is_refused(folder):
    Path("bad.egs").write_bytes(flipped(Path("scene.egs").read_bytes(), -1))
    assert "section 10 of block 0: checksum" in folder.refuse("decode", "bad.egs", "out.ply")
    assert folder.run("inspect", "bad.egs").status == 0


@pytest.mark.parametrize(
    "names", [["x"], ["two words"], [""], ["rot_3"], ["label", "label"]], ids=str
)
def test_egs_with_properties_invalid_in_ply_is_refused(folder, names):
    """The checksums of such a file are right; only its content is wrong."""
    good = read_file(Path("scene.egs").read_bytes())
    one = write_extra({"?": np.zeros(1500, np.uint8)}, np.arange(1500))[4:]
    columns = [bytes([len(name)]) + name.encode() + one for name in names]
    extra = struct.pack("<H", len(names)) + b"".join(columns)
    sections = [Section(SectionId(i), block, data) for (i, block), data in good.sections.items()]
    sections.append(Section(SectionId.EXTRA, 0, extra))
    Path("bad.egs").write_bytes(write_file(good.header, sections))
    assert "bad.egs: " in folder.refuse("decode", "bad.egs", "out.ply")


THREADS = "threads {}: expected an integer from 1 to 256"
REFUSED = {
    "encode missing": ("encode missing.ply out.egs", "missing.ply: No such file"),
    "encode directory": ("encode some.dir out.egs", "some.dir: no frames, expected files of"),
    "decode missing": ("decode missing.egs out.ply", "missing.egs: No such file"),
    "decode directory": ("decode some.dir out.ply", "some.dir: a directory, expected a file"),
    "decode .ply": ("decode scene.ply out.ply", "scene.ply: ply, not an .egs file"),
    "inspect missing": ("inspect missing.egs", "missing.egs: No such file"),
    "inspect directory": ("inspect some.dir", "some.dir: no frames, expected files of"),
    "inspect text": ("inspect text.md", "text.md: begins with b'# Ti', expected .ply, .egs"),
    "inspect zip": ("inspect zip.pt", "zip.pt: pickle: 'pickle exhausted before seeing STOP'"),
    "inspect other zip": ("inspect zip.sog", "zip.sog: a zip without meta.json, expected a SOG"),
    "channels of a .ply": ("inspect scene.ply --channels", "--channels has no effect on scene.ply"),
    "decode .splat": (
        "decode a.splat out.ply",
        "a.splat: splat, not an .egs file; `convert`",
    ),
    "verify .ply": ("verify scene.ply --threads 2", "--threads has no effect on scene.ply, exp"),
    "verify a cut .ply": ("verify cut.ply", "cut.ply: .*the file ends in row"),
    "encode .pt": ("encode scene.ply a.pt", "suffix '.pt', expected .*; `convert` writes that"),
    "coding of a .pt": ("convert scene.ply a.pt -p s", "--profile has no effect on a.pt, expected"),
    "compare missing": ("compare scene.ply missing.ply", "missing.ply: No such file"),
    "compare directory": ("compare some.dir scene.ply", "some.dir: no frames, expected files of"),
    "compare counts": (
        "compare scene.ply other.ply",
        "1,500 Gaussians against 7: .* rendered views",
    ),
    "profile": ("encode scene.ply out.egs -p best", "profile 'best': expected one of l, m, s, "),
    "depth group": (
        "encode scene.ply out.egs -p paper-m --depth colour=3",
        "'colour': expected one of",
    ),
    "depth 0": (
        "encode scene.ply out.egs -p paper-m --depth opacity=0",
        "integer from 1 to 12",
    ),
    "depth 13": (
        "encode scene.ply out.egs -p paper-m --depth sh-ac=13",
        "integer from 1 to 12",
    ),
    "depth 22": (
        "encode scene.ply out.egs -p paper-m --depth geometry=22",
        "integer from 1 to 21",
    ),
    "depth word": ("encode scene.ply out.egs --depth sh-ac=x", "expected an integer"),
    "depth empty": ("encode scene.ply out.egs --depth sh-ac=", "expected an integer"),
    "depth negative": ("encode scene.ply out.egs --depth sh-ac=-1", "expected an integer"),
    "depth no number": (
        "encode scene.ply out.egs --depth sh-ac",
        "--depth sh-ac: expected GROUP=BITS",
    ),
    "depth superscript": ("encode scene.ply out.egs --depth sh-ac=²", "expected an integer"),
    "depth of 5000 digits": (
        f"encode scene.ply out.egs --depth sh-ac={'9' * 5000}",
        "expected",
    ),
    "nonfinite": ("encode scene.ply out.egs --nonfinite keep", "nonfinite 'keep'"),
    "extra": ("encode scene.ply out.egs --extra maybe", "extra 'maybe'"),
    "depth of a lattice": ("encode scene.ply out.egs -p m --depth sh1=13", "depth of sh1 13"),
    "depth of lossless": ("encode scene.ply o.egs -p lossless --depth sh1=3", "has none"),
    "box of five": ("decode scene.egs out.ply --bbox 0,0,0,1,1", "--bbox 0,0,0,1,1: expected six"),
    "box of seven": ("decode scene.egs out.ply --bbox 0,0,0,1,1,1,1", "expected six numbers"),
    "box of words": ("decode scene.egs out.ply --bbox a,b,c,d,e,f", "expected six numbers"),
    "box empty": ("decode scene.egs out.ply --bbox=", "expected six numbers"),
    "box upside down": ("decode scene.egs out.ply --bbox 0,0,1,1,1,0", "box 0, 0, 1, 1, 1, 0: "),
    "box of NaN": ("decode scene.egs out.ply --bbox 0,0,0,1,1,nan", "expected lowest x, y, z"),
    "box without end": ("decode scene.egs out.ply --bbox 0,0,0,1,1,inf", "expected lowest x, y"),
    "degree 4": ("decode scene.egs out.ply --sh-degree 4", "SH degree 4: expected 0-3"),
    "degree -1": ("decode scene.egs out.ply --sh-degree -1", "SH degree -1: expected 0-3"),
    "degree word": ("decode scene.egs out.ply --sh-degree all", "--sh-degree.*valid int"),
    "threads of encode": ("encode scene.ply out.egs --threads 0", THREADS.format(0)),
    "threads of decode": ("decode scene.egs out.ply --threads 0", THREADS.format(0)),
    "many threads of encode": ("encode scene.ply out.egs --threads 257", THREADS.format(257)),
    "many threads of decode": ("decode scene.egs out.ply --threads 257", THREADS.format(257)),
    "threads of bench": ("bench run scene.ply --threads 0", THREADS.format(0)),
    "too large": ("decode scene.egs out.ply --max-bytes 9", "354,000 bytes, the limit is 9"),
    "encode to no folder": ("encode scene.ply no/out.egs", "no directory 'no'"),
    "decode to no folder": ("decode scene.egs no/out.ply", "no directory 'no'"),
    "encode to directory": ("encode scene.ply some.dir", "some.dir: a directory"),
    "decode to directory": ("decode scene.egs some.dir", "some.dir: a directory"),
    "encode to device": ("encode scene.ply /dev/null", "not a regular file"),
    "encode to source": ("encode scene.ply scene.ply", "input and output are the same file"),
    "encode to link": ("encode scene.ply link.ply", "input and output are the same file"),
    "decode to source": ("decode scene.egs ./scene.egs", "input and output are the same file"),
    "encode to long name": (f"encode scene.ply {'x' * 300}.egs", "name too long"),
    "no such option": ("encode scene.ply out.egs --best", "--best"),
    "no such command": ("squeeze scene.ply", "squeeze"),
    "missing argument": ("encode scene.ply", "OUT"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_usage_errors_are_refused(folder, name):
    command, message = REFUSED[name]
    Path("some.dir").mkdir()
    Path("link.ply").symlink_to("scene.ply")
    write_ply("other.ply", random_scene(7))
    Path("text.md").write_text("# Title")
    Path("cut.ply").write_bytes(Path("scene.ply").read_bytes()[:-1])
    Path("a.splat").write_bytes(bytes(32))
    for path, entry in (("zip.pt", "step/data.pkl"), ("zip.sog", "readme")):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(entry, b"")
    assert re.search(message, folder.refuse(*command.split(" ")))


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_is_refused(folder):
    Path("locked").mkdir(mode=0o500)
    line = folder.refuse("encode", "scene.ply", "locked/out.egs")
    assert "no permission to write in 'locked'" in line


@pytest.mark.parametrize("existing", [False, True])
@pytest.mark.parametrize(
    "command", ["encode scene.ply o.egs --overwrite", "decode scene.egs o.ply --overwrite"]
)
def test_full_disk_keeps_the_old_file(folder, command, existing):
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    target = command.split()[2]
    if existing:
        Path(target).write_bytes(b"precious")
    folder.monkeypatch.setattr(os, "fsync", full)
    assert (
        folder.refuse(*command.split()) == f"gs-codec: error: {target}: No space left on device\n"
    )


def test_scenes_without_a_match_are_refused(folder):
    write_ply("other.ply", random_scene(1500, 3, seed=99))
    told = folder.refuse("compare", "scene.ply", "other.ply")
    assert (
        "Gaussians of the scenes do not match, so there are no errors by attribute: compare" in told
    )
    status, out, _ = folder.run("compare", "scene.egs", "other.ply", "--json")
    assert (status, "do not match" in strict_json(out)["error"]["text"]) == (2, True)


# Visible only in a separate process

HOOK = """
import importlib, os, signal, sys
from gs_codec.cli.main import main
module = importlib.import_module(sys.argv.pop(1))
name = sys.argv.pop(1)
original = getattr(module, name)
def interrupt(*arguments):
    os.kill(os.getpid(), signal.SIGINT)
    return original(*arguments)
setattr(module, name, interrupt)
main()
"""


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    ("command", "place"),
    [
        ("encode scene.ply out.egs -p paper-m", "gs_codec.codecs.entropygs.encode encode_colour"),
        ("encode scene.ply out.egs", "os fsync"),
        ("decode scene.egs out.ply", "gs_codec.codecs.entropygs.decode decode_colour"),
        ("decode scene.egs out.ply", "os fsync"),
    ],
)
def test_interrupt_leaves_nothing(folder, command, place):
    before = folder.contents()
    status, out, err = python("-c", HOOK, *place.split(), *command.split(), cwd=folder.path)
    assert folder.contents() == before
    assert (status, out, err) == (130, "", "gs-codec: interrupted\n")


SMALL_DISK = """
import atexit, resource
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, -1))
atexit.register(resource.setrlimit, resource.RLIMIT_FSIZE, (-1, -1))  # for measured coverage
from gs_codec.cli.main import main
main()
"""


@pytest.mark.one_in(2)
@pytest.mark.skipif(sys.platform == "win32", reason="no limits of file size")
@pytest.mark.parametrize("command", ["encode scene.ply out.egs", "decode scene.egs out.ply"])
def test_file_too_large_for_the_disk_leaves_nothing(folder, command):
    before = folder.contents()
    status, out, err = python("-c", SMALL_DISK, *command.split(), cwd=folder.path)
    assert folder.contents() == before
    assert (status, out) == (2, "")
    assert_one_error_line(err)
    assert "File too large" in err


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ("decode missing.egs out.ply", "missing.egs: No such file or directory"),
        ("convert scene.ply o.none", "o.none: suffix '.none', expected "),
    ],
)
def test_module_is_the_command(folder, arguments, error):
    status, out, err = python("-m", "gs_codec", *arguments.split(), cwd=folder.path)
    assert (status, out) == (2, "")
    assert_one_error_line(err)
    assert err.startswith(f"gs-codec: error: {error}")


@pytest.mark.skipif(sys.platform == "win32", reason="a folder in use cannot be removed")
def test_removed_working_directory_is_named(folder, tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    folder.monkeypatch.chdir(gone)
    gone.rmdir()
    status, _, err = folder.run("batch", "in", "out")
    assert (status, err) == (2, "gs-codec: error: the working directory was removed\n")
    folder.monkeypatch.chdir(tmp_path)
    # As raised by semaphores where there is no /dev/shm.
    error = FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
    assert describe_error(error) == "No such file or directory"


@pytest.mark.thorough
def test_warnings_are_lines_on_stderr(folder):
    with open("scene.ply", "ab") as file:
        file.write(b"more")
    status, out, err = python(
        "-m", "gs_codec", "encode", "scene.ply", "o.egs", "--json", cwd=folder.path
    )
    assert (status, strict_json(out)["gaussians"]) == (0, 1500)
    assert err == "gs-codec: warning: scene.ply: left out: 4 bytes after the last vertex\n"


def test_progress_on_a_terminal_ends_in_a_clean_line(folder):
    pty = pytest.importorskip("pty")
    control, terminal = pty.openpty()
    command = [sys.executable, "-m", "gs_codec", "encode", "scene.ply", "out.egs"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "80"}
    done = subprocess.run(
        command, env=environment, stdout=subprocess.PIPE, stderr=terminal, check=False
    )
    os.close(terminal)
    shown = os.read(control, 1 << 16).decode()
    os.close(control)
    assert done.returncode == 0
    assert done.stdout.startswith(b"out.egs: 1,500 Gaussians")
    assert "code" in shown
    assert "\x1b[?25h" in shown, "the cursor must be visible again"


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "command",
    [
        "encode scene.ply out.egs",
        "encode scene.ply out.egs -p paper-m",
        "encode scene.ply out.egs --cameras auto --views 3 --width 48 --prune 10",
        "encode scene.ply out.egs --cameras auto --views 3 --width 48 --max-psnr-drop 1",
        "decode scene.egs out.ply",
        "verify scene.egs",
        "convert scene.ply out.splat",
        "convert scene.egs out.egs",
    ],
)
def test_one_thread_starts_no_other(folder, command):
    started: list[str] = []
    folder.monkeypatch.setattr(threading.Thread, "start", lambda self: started.append(self.name))
    assert folder.run(*command.split(), "--threads", "1").status == 0
    assert started == []


COUNTED = """
import os, sys
from gs_codec.cli.main import main
try:
    main()
finally:
    print(len(os.listdir("/proc/self/task")), file=sys.stderr)
"""


@pytest.mark.thorough
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="the system lists no threads")
def test_numpy_starts_no_threads_either(folder):
    folder.monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    command = ["encode", "scene.ply", "out.egs", "--threads", "1"]
    status, _, err = python("-c", COUNTED, *command, cwd=folder.path)
    assert (status, err) == (0, "1\n")


def test_progress_in_a_pipe_is_a_line_every_ten_seconds(capsys, monkeypatch):
    monkeypatch.setattr(output, "SECONDS_A_LINE", 10)
    seconds = iter([100, 104, 109.9, 110, 119.9, 131.5, 141])
    update = progress_lines(lambda: next(seconds))
    for done in range(1, 4):
        update("refit", done, 3000)
    assert capsys.readouterr().err == "refit: 3 of 3,000 after 10 s, 150 min left\n"
    update("refit", 2999, 3000)
    update("refit", 3000, 3000)
    update("code", 1, 2)
    out, err = capsys.readouterr()
    assert (out, err) == ("", "refit: 3,000 of 3,000 after 32 s\n")


@pytest.mark.parametrize("json", [[], ["--json"]], ids=["table", "json"])
@pytest.mark.parametrize("command", ["encode scene.ply out.egs", "decode scene.egs out.ply"])
def test_commands_report_progress_in_a_pipe(folder, command, json):
    folder.monkeypatch.setattr(output, "SECONDS_A_LINE", 0)
    status, out, err = folder.run(*command.split(), *json)
    assert status == 0
    assert re.search(r"^(de)?code: 1 of \d+ after \d+ s$", err, re.MULTILINE)
    if json:
        assert strict_json(out)["gaussians"] == 1500


@pytest.mark.thorough
def test_a_batch_reports_progress_of_its_scenes_in_a_pipe(folder):
    folder.monkeypatch.setattr(output, "SECONDS_A_LINE", 0)
    status, _, err = folder.run("batch", "scene.ply", "out")
    assert status == 0
    assert re.search(r"^scene.ply: code: 1 of \d+ after \d+ s$", err, re.MULTILINE)


LOADED = """
import sys
import zipfile
{run}
print(*sorted(sys.modules), file=sys.stderr)
"""
RUN_ALL = """
import sys
from gs_codec.cli.main import main
for line in {commands}:
    sys.argv = ["gs-codec", *line.split()]
    try:
        main()
    except SystemExit as stop:
        assert not stop.code
"""


@pytest.mark.parametrize(
    ("run", "loaded", "absent"),
    [
        ("import gs_codec", {"gs_codec"}, {"numpy", "numba", "open3d", "torch", "typer", "rich"}),
        (
            RUN_ALL.format(commands=["--help", "encode --help", "bench --help"]),
            {"typer"},
            {"numpy", "numba", "open3d", "torch", "plyfile", "matplotlib"},
        ),
        (
            RUN_ALL.format(
                commands=[
                    "encode scene.ply out.egs --overwrite",
                    "decode out.egs out.ply --overwrite",
                    "inspect out.egs",
                    "compare scene.ply out.egs",
                ]
            ),
            {"numpy", "numba", "plyfile"},
            {"open3d", "torch", "torchac", "matplotlib"}
            | {"scipy.linalg", "rich", "gs_codec.cli.batch", "gs_codec.cli.bench"},
        ),
        thorough(
            RUN_ALL.format(
                commands=["compare scene.ply scene.egs --cameras auto --width 40 --device cpu"]
            ),
            {"gs_codec.metrics.views"},
            {"torch", "lpips", "torchvision", "skimage"},
        ),
    ],
    ids=["import", "help", "files", "views"],
)
def test_heavy_packages_load_on_use(folder, run, loaded, absent):
    assert python("-c", run, cwd=folder.path).status == 0  # compiles kernels
    status, _, err = python("-c", LOADED.format(run=run), cwd=folder.path)
    modules = set(err.split())
    assert status == 0
    assert loaded <= modules
    assert absent & modules == set()


def test_decoded_file_can_be_encoded_again(folder, trio):
    scene = read_ply("scene.ply")
    assert folder.run("encode", "decoded.ply", "again.egs", "-p", "paper-m").status == 0
    assert folder.run("decode", "again.egs", "again.ply").status == 0
    again, decoded = read_ply("again.ply"), read_ply("decoded.ply")
    assert again.comments == decoded.comments * 2
    for group in set(GROUPS) - {"f_rest"}:
        np.testing.assert_array_equal(getattr(again, group), getattr(decoded, group))
    assert again.count == scene.count
    encode_file("decoded.ply", "by_library.egs", Config("paper-m"))
    assert Path("again.egs").read_bytes() == Path("by_library.egs").read_bytes()


@pytest.mark.parametrize(
    "typed",
    [
        "inspect https://host/a.egs",
        "encode https://host/a.ply?b=1 a.egs",
        "encode scene.ply s3://host/a.egs",
        "render scene.ply --cameras https://host/cameras.json --out views",
    ],
)
def test_files_at_urls_give_a_hint(folder, typed):
    assert folder.refuse(*typed.split()).endswith("; only `batch` reads and writes URLs\n")
    url = "https://host/page"
    assert "only" not in folder.refuse("share", "none.egs", "--out", "page", "--url", url)
