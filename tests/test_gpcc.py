"""G-PCC for geometry and SH-DC: the same scene as with the octree, or one clear error.

A stand-in simulates faults of `tmc3`; the program itself is tested if it is found.
"""

from __future__ import annotations

import errno
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from damage import with_section
from scenes import assert_same_floats, edge_scenes, random_scene, shared_scene_path
from tmc3_stand_in import VERSION
from typer.testing import CliRunner

from gs_codec.cli.main import app
from gs_codec.codecs import decode_part, decode_scene, encode_scene
from gs_codec.codecs.entropygs.gpcc import Tmc3, decode_points, encode_points
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS, PROFILES, Config
from gs_codec.egs.egs_file import SCENE_SECTIONS, Section, SectionId, read_file, write_file
from gs_codec.egs.header import Feature
from gs_codec.errors import CorruptStream, InvalidInput, MissingTool, ToolFailed, TruncatedStream
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.programs import Limits

EDGES = edge_scenes()
STAND_IN = Path(__file__).with_name("tmc3_stand_in.py")


def find_real() -> Tmc3 | None:
    """The program itself, found through the environment of the test run."""
    try:
        return Tmc3.find()
    except MissingTool:
        return None


REAL = find_real()
needs_real = pytest.mark.skipif(REAL is None, reason="tmc3 is not on this machine")


@pytest.fixture(autouse=True)
def nothing_left(tmp_path, monkeypatch):
    """Hide the program unless a test enables it; check that no temporary file is left."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("GS_CODEC_TMC3", raising=False)
    yield
    assert list(folder.iterdir()) == []


@pytest.fixture
def stand_in(tmp_path, monkeypatch) -> str:
    """The stand-in, found through the environment."""
    path = tmp_path / "stand in"
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -I -S "{STAND_IN}" "$@"\n')
    path.chmod(0o755)
    monkeypatch.setenv("GS_CODEC_TMC3", str(path))
    return str(path)


def config(profile="paper-m", **options) -> Config:
    return Config(profile, block_size=1024, **{"geometry": "gpcc", **options})


def duplicated(count: int, seed: int):
    """Each Gaussian several times, so that block boundaries fall between equal ones."""
    scene = random_scene(count // 8, 1, seed)
    return scene.take(np.random.default_rng(seed).integers(0, count // 8, count))


def assert_interchangeable(scene, options, **more):
    """The decoded scene equals that of the octree's stream, bit for bit."""
    expected = decode_scene(encode_scene(scene, Config(block_size=1024, **options))[0])
    data, report = encode_scene(scene, config(**options, **more))
    assert report.file_bytes == len(data)
    assert {"geometry", "sh-dc"}.isdisjoint(report.section_bytes)
    assert_same_floats(decode_scene(data), expected)
    return data


@pytest.mark.thorough
@pytest.mark.parametrize("name", EDGES)
def test_edge_scenes_decode_like_the_octree(name, stand_in):
    assert_interchangeable(EDGES[name], {"profile": "paper-m"})


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", PROFILES)
def test_blocks_decode_like_the_octree(profile, stand_in):
    data = assert_interchangeable(duplicated(2500, seed=90), {"profile": profile})
    assert inspect_bytes(data).blocks == 3
    assert encode_scene(duplicated(2500, seed=90), config(profile))[0] == data


@pytest.mark.parametrize("depths", [{"geometry": 18, "sh-dc": 1}, {"geometry": 1, "sh-dc": 8}])
def test_depths_decode_like_the_octree(depths, stand_in):
    scene = random_scene(1500, 0, seed=91)
    assert_interchangeable(scene, {"profile": "paper-l", "depths": depths})


def test_parts_decode_like_the_octree(stand_in):
    scene = random_scene(3000, 2, seed=92)
    low, high = np.quantile(scene.positions, [0.1, 0.4], axis=1)
    part = Part((*low, *high), sh_degree=1)
    parts = [
        decode_part(encode_scene(scene, config(geometry=coder))[0], part)[0]
        for coder in ("octree", "gpcc")
    ]
    assert 0 < parts[0].count < scene.count
    assert_same_floats(*parts)


def test_readers_without_the_feature_refuse_it(stand_in):
    file = read_file(encode_scene(random_scene(50, 0, seed=93), config())[0])
    entries = file.header_size - 4 - 20 * len(file.table)
    table = bytes(file.data[entries : file.header_size - 4])
    flags = {
        int.from_bytes(table[i : i + 2], "little"): table[i + 2] for i in range(0, len(table), 20)
    }
    assert flags[SectionId.GPCC] == flags[SectionId.TOOL] == 0, "not optional"
    assert file.header.features == Feature.GPCC


def test_inspect_names_the_program(stand_in, tmp_path):
    scene = random_scene(300, 1, seed=94)
    path = tmp_path / "scene.egs"
    path.write_bytes(encode_scene(scene, config())[0])
    info = inspect_bytes(path.read_bytes())
    assert (info.geometry, info.tool) == ("gpcc", VERSION)
    text = CliRunner().invoke(app, ["inspect", str(path)]).stdout
    assert "profile paper-m with G-PCC, 300 Gaussians" in text
    assert info.features == ("G-PCC",)
    assert f"geometry and SH-DC: G-PCC, by '{VERSION}'" in text
    assert "8/16" in text
    coders = [inspect_bytes(encode_scene(scene, Config(p))[0]) for p in ("paper-m", "m", LOSSLESS)]
    assert [(i.geometry, i.tool) for i in coders] == [
        ("octree", None), ("octree", None), ("columns", None),
    ]  # fmt: skip


def test_auto_uses_the_program_if_found(stand_in, monkeypatch):
    scene = random_scene(200, 1, seed=95)
    for profile in (*PROFILES, *ADAPTIVE_PROFILES, LOSSLESS):
        asked = "gpcc" if profile in PROFILES else "octree"
        expected = encode_scene(scene, config(profile, geometry=asked))[0]
        assert encode_scene(scene, config(profile, geometry="auto"))[0] == expected
    deep = {"geometry": 19}
    expected = encode_scene(scene, config(geometry="octree", depths=deep))[0]
    assert encode_scene(scene, config(geometry="auto", depths=deep))[0] == expected
    monkeypatch.delenv("GS_CODEC_TMC3")
    expected = encode_scene(scene, config(geometry="octree"))[0]
    assert encode_scene(scene, config(geometry="auto"))[0] == expected
    with pytest.raises(MissingTool, match="/nowhere: no such program"):
        encode_scene(scene, config(geometry="auto", tmc3="/nowhere"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"geometry": "kd-tree"}, "geometry 'kd-tree': expected one of octree, gpcc, auto"),
        ({"geometry": "gpcc", "profile": "m"}, "profile 'm' has no uniformly quantised positions"),
        ({"geometry": "gpcc", "profile": LOSSLESS}, "profile 'lossless' has no uniformly"),
        ({"geometry": "gpcc", "depths": {"geometry": 19}}, "depth of geometry 19, at most 18"),
        ({"geometry": "gpcc", "depths": {"sh-dc": 9}}, "depth of sh-dc 9, at most 8"),
        ({"tmc3": "tmc3"}, "tmc3: only geometry gpcc and auto use it"),
        ({"verify": False}, "verify: only geometry gpcc and auto use it"),
    ],
)
def test_invalid_options_are_refused(options, message):
    with pytest.raises(InvalidInput, match=message):
        Config(**{"profile": "paper-m", **options})


# The command line


def test_the_command_line_finds_the_program(stand_in, tmp_path, monkeypatch):
    monkeypatch.delenv("GS_CODEC_TMC3")
    source, target, back = (str(tmp_path / n) for n in ("a.ply", "a.egs", "b.ply"))
    write_ply(source, random_scene(400, 1, seed=96))
    encode = [
        "encode",
        source,
        target,
        "-p",
        "paper-s",
        "--geometry",
        "gpcc",
        "--json",
        "--overwrite",
    ]
    for options in ([], ["--no-verify"]):
        result = CliRunner().invoke(app, [*encode, "--tmc3", stand_in, *options])
        assert result.exit_code == 0, result.output
    assert CliRunner().invoke(app, ["decode", target, back, "--tmc3", stand_in]).exit_code == 0
    assert read_ply(back).count == 400
    # Commands without the option use the environment.
    assert isinstance(CliRunner().invoke(app, ["compare", source, target]).exception, MissingTool)
    monkeypatch.setenv("GS_CODEC_TMC3", stand_in)
    result = CliRunner().invoke(app, ["compare", source, target])
    assert result.exit_code == 0, result.output
    monkeypatch.delenv("GS_CODEC_TMC3")
    (tmp_path / "temporary" / "tmc3").symlink_to(stand_in)
    result = CliRunner().invoke(app, ["compare", source, target])
    (tmp_path / "temporary" / "tmc3").unlink()
    assert result.exit_code == 0, result.output


def test_a_missing_program_is_named_in_one_line(stand_in, tmp_path, monkeypatch):
    source, target, back = (str(tmp_path / n) for n in ("a.ply", "a.egs", "b.ply"))
    write_ply(source, random_scene(10, 0, seed=97))
    encode = ["encode", source, target, "-p", "paper-m", "--geometry", "gpcc"]
    assert CliRunner().invoke(app, encode).exit_code == 0
    monkeypatch.delenv("GS_CODEC_TMC3")
    again = [*encode[:2], str(tmp_path / "c.egs"), *encode[3:]]
    for command in (again, ["decode", target, back]):
        error = CliRunner().invoke(app, command).exception
        assert isinstance(error, MissingTool)
        text = str(error)
        assert "tmc3: not found; tmc3 is MPEG's reference software for G-PCC" in text
        assert "https://github.com/MPEGGroup/mpeg-pcc-tmc13" in text
        assert "'octree' needs no program" in text
        assert "\n" not in text
        assert not Path(command[2]).exists()


@pytest.mark.parametrize(
    ("failure", "message"),
    [("help:silent", "not tmc3, --help prints ''"), ("help:other", "prints 'usage: other'")],
)
def test_a_different_program_is_refused(failure, message, stand_in, monkeypatch):
    monkeypatch.setenv("TMC3_STAND_IN", failure)
    with pytest.raises(MissingTool, match=message):
        Tmc3.find()


@pytest.mark.usefixtures("stand_in")
def test_a_system_without_limits_is_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "resource", None)  # as on Windows
    with pytest.raises(MissingTool, match="other programs cannot be limited on this system"):
        Tmc3.find()


def test_an_unrunnable_program_is_refused(tmp_path):
    broken = tmp_path / "broken"
    broken.write_bytes(b"\x7fELF and nothing more")
    broken.chmod(0o755)
    for path in (broken, tmp_path, tmp_path / "nothing"):
        with pytest.raises(MissingTool, match=str(path)):
            Tmc3.find(path)


# What may go wrong

FAILURES = {
    "encode:exit": r"ended with status 3: Error: no \?\[31mgood$",
    "encode:segfault": "was stopped by SIGSEGV",
    "encode:huge": "File too large",
    "encode:garbage": "ended with status 1: AssertionError",
    "encode:empty": "ended with status 1",
    "encode:nothing": "wrote nothing",
    "decode:exit": "ended with status 3",
    "decode:segfault": "was stopped by SIGSEGV",
    "decode:huge": "File too large",
    "decode:garbage": "not a readable PLY",
    "decode:empty": "not a readable PLY",
    "decode:nothing": "wrote nothing",
    "decode:count": "wrote 19 points, expected 20",
    "decode:values": "decoded other points than were encoded",
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("failure", FAILURES)
def test_a_failure_is_one_clear_error(failure, stand_in, monkeypatch):
    """While encoding, and while decoding a valid stream."""
    scene = random_scene(20, 0, seed=98)
    good = encode_scene(scene, config())[0]
    monkeypatch.setenv("TMC3_STAND_IN", failure)
    calls = [lambda: encode_scene(scene, config())]
    if failure.startswith("decode"):
        calls.append(lambda: decode_scene(good))
        # Without verification, the fault is not noticed.
        assert encode_scene(scene, config(verify=False))[0] == good
    for call in calls:
        with pytest.raises(ToolFailed, match=FAILURES[failure]) as caught:
            call()
        assert str(caught.value).startswith("gpcc of block 0: tmc3 (" + VERSION)
        assert "\n" not in str(caught.value)


def test_a_failure_leaves_no_file(stand_in, tmp_path, monkeypatch):
    source, target = tmp_path / "a.ply", tmp_path / "a.egs"
    write_ply(source, random_scene(20, 0, seed=98))
    monkeypatch.setenv("TMC3_STAND_IN", "encode:segfault")
    options = ["-p", "paper-m", "--geometry", "gpcc"]
    result = CliRunner().invoke(app, ["encode", str(source), str(target), *options])
    assert isinstance(result.exception, ToolFailed)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply", "stand in", "temporary"]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("failure", "limits", "message"),
    [
        ("hang", Limits(seconds=1.0), "did not end in 1 s"),
        ("spin", Limits(processor_seconds=1), "was stopped by SIGXCPU"),
        ("memory", Limits(memory_bytes=1 << 29), "ended with status 1: MemoryError"),
    ],
)
def test_excessive_runs_are_stopped(failure, limits, message, stand_in, monkeypatch):
    points = np.zeros((3, 5), np.uint32), np.zeros((3, 5), np.uint16)
    tool = Tmc3(stand_in, VERSION, limits)
    monkeypatch.setenv("TMC3_STAND_IN", f"encode:{failure}")
    with pytest.raises(ToolFailed, match=message):
        encode_points(tool, *points)


def test_a_full_disk_is_one_clear_error(stand_in, monkeypatch):
    tool = Tmc3.find()

    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ToolFailed, match=r"in\.bin: No space left on device"):
        decode_points(tool, b"", 1, (1, 1, 1), (1, 1, 1))


# Its output is not trusted

HEADER = """ply
format binary_little_endian 1.0
comment anything
element vertex 1
property float x
property float y
property float z
property uchar green
property uchar blue
property uchar red
element face 0
property list uint8 int32 vertex_index
end_header
"""
POINT = np.array([1, 2, 3], "<f4").tobytes() + b"\4\5\6"


@dataclass(frozen=True)
class Writer(Tmc3):
    """A program that writes given bytes."""

    content: bytes = b""

    def run(self, arguments, inputs, output, most):
        return self.content


def decode_ply(content: bytes):
    writer = Writer("tmc3", VERSION, content=content)
    return decode_points(writer, b"", 1, (2, 2, 2), (3, 3, 3))


def test_a_valid_ply_is_read():
    cells, colours = decode_ply(HEADER.encode() + POINT)
    assert (cells.tolist(), colours.tolist()) == ([[1], [2], [3]], [[6], [4], [5]])
    assert (cells.dtype, colours.dtype) == (np.uint32, np.uint16)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ply\n", "plx\n", "not a readable PLY"),
        ("end_header", "end_headers", "not a readable PLY"),
        ("binary_little_endian", "ascii", "a PLY that is not binary"),
        ("binary_little_endian", "binary_big_endian", "a PLY that is not binary"),
        ("vertex 1", "vertex 2", "wrote 2 points, expected 1"),
        ("vertex 1", "vertex -1", "element 'vertex -1', expected a name and a count"),
        ("vertex 1", "vertex 1e0", "element 'vertex 1e0', expected a name and a count"),
        ("vertex 1\n", "vertex 1\nelement vertex 1\n", "two elements of the same name 'vertex'"),
        ("element vertex 1", "element point 0\nelement vertex 1", "other elements than 'vertex'"),
        ("face 0", "face 1", "other elements than 'vertex'"),
        ("property float z\n", "", "without property 'z'"),
        ("property float z\n", "property float y\n", "two properties of the same name 'y'"),
        ("float z", "half z", "property 'half z', expected a type and a name"),
        ("property float z", "property list uchar int z", "without property 'z'"),
        ("float x", "float x\nproperty list uchar int w", "expected 1 without lists"),
        ("float z", "double z", "15 bytes of data, expected 19"),
        ("element vertex 1\n", "", "'property float x' is not expected there"),
        ("comment anything", "\x1b", r"'\\x1b' is not expected there"),
    ],
)
def test_an_unexpected_ply_is_refused(old, new, message):
    with pytest.raises(ToolFailed, match=message):
        decode_ply(HEADER.replace(old, new, 1).encode() + POINT)


@pytest.mark.parametrize("data", [b"", POINT[:-1], POINT + b"\0", 2 * POINT])
def test_an_unexpected_size_is_refused(data):
    with pytest.raises(ToolFailed, match="bytes of data, expected 15"):
        decode_ply(HEADER.encode() + data)


@pytest.mark.parametrize("value", [-1, 4, 0.5, np.nan, np.inf, 3e38])
def test_values_that_are_not_symbols_are_refused(value):
    point = np.array([1, value, 3], "<f4").tobytes() + b"\4\5\6"
    with pytest.raises(ToolFailed, match="value of y that is not an integer of 2 bits"):
        decode_ply(HEADER.encode() + point)
    with pytest.raises(ToolFailed, match="value of red that is not an integer of 3 bits"):
        decode_ply(HEADER.encode() + POINT[:-1] + b"\x08")


# Streams that lie


@pytest.mark.parametrize(
    ("section", "content", "kind", "message"),
    [
        (SectionId.TOOL, b"", CorruptStream, "section 'tool': 0 bytes"),
        (SectionId.TOOL, b"tmc3\x1b[31m", CorruptStream, "printable ASCII"),
        (SectionId.TOOL, b"t" * 201, CorruptStream, "section 'tool': 201 bytes"),
        (SectionId.TOOL, None, CorruptStream, "section 'gpcc' of block 0: empty"),
        (SectionId.GPCC, None, CorruptStream, "sections of blocks"),
        (SectionId.GPCC, b"123", TruncatedStream, "gpcc of block 0: 3 bytes"),
        (SectionId.GPCC, b"1234", ToolFailed, "ended with status 1"),
    ],
)
def test_invalid_sections_are_refused(section, content, kind, message, stand_in):
    data = encode_scene(random_scene(20, 0, seed=99), config())[0]
    data = with_section(data, section, lambda _: content)
    with pytest.raises(kind, match=message):
        decode_scene(data)
    if section == SectionId.TOOL and content is not None:
        with pytest.raises(kind, match=message):
            inspect_bytes(data)


@pytest.mark.parametrize("profile", ["m", LOSSLESS, "paper-m"])
def test_a_tool_without_its_points_is_refused(profile, stand_in):
    data = encode_scene(random_scene(0), Config(profile))[0]
    with pytest.raises(CorruptStream, match="section 'tool' of block 0: empty"):
        decode_scene(with_section(data, SectionId.TOOL, lambda _: b"tmc3"))


def test_too_deep_points_are_refused(stand_in):
    scene = random_scene(50, 0, seed=100)
    data = encode_scene(scene, config(geometry="octree", depths={"geometry": 19}))[0]
    for section, content in (
        (SectionId.GEOMETRY, None),
        (SectionId.SH_DC, None),
        (SectionId.TOOL, b"tmc3"),
        (SectionId.GPCC, bytes(8)),
    ):
        data = with_section(data, section, lambda _, content=content: content)
    with pytest.raises(CorruptStream, match="geometry of 19 bits, expected at most 18"):
        decode_scene(data)


def test_many_small_blocks_are_refused(stand_in):
    file = read_file(encode_scene(random_scene(1200, 0, seed=103), config())[0])
    header = replace(file.header, block_size=500)
    sections = [Section(SectionId(key[0]), key[1], part) for key, part in file.sections.items()]
    sections += [replace(s, block=2) for s in sections if s.id not in SCENE_SECTIONS and s.block]
    sections[0] = replace(sections[0], data=bytes(sections[0].data) + bytes(sections[0].data)[:48])
    with pytest.raises(CorruptStream, match="blocks of 500 Gaussians, expected at least 512"):
        decode_scene(write_file(header, sections))


def test_another_version_is_named(stand_in, monkeypatch):
    data = encode_scene(random_scene(20, 0, seed=101), config())[0]
    data = with_section(data, SectionId.TOOL, lambda _: b"tmc3 version 99")
    assert decode_scene(data).count == 20
    monkeypatch.setenv("TMC3_STAND_IN", "decode:segfault")
    with pytest.raises(ToolFailed, match=rf"tmc3 \({VERSION}; written by tmc3 version 99\) was"):
        decode_scene(data)


# The program itself


@pytest.fixture
def real(monkeypatch):
    """The program itself, found through the environment."""
    assert REAL is not None
    monkeypatch.setenv("GS_CODEC_TMC3", REAL.path)


@needs_real
@pytest.mark.parametrize("name", EDGES)
def test_edge_scenes_by_the_program(name, real):
    assert_interchangeable(EDGES[name], {"profile": "paper-m"})


@needs_real
@pytest.mark.parametrize("depths", [{}, {"geometry": 18, "sh-dc": 8}, {"geometry": 1, "sh-dc": 1}])
def test_blocks_and_depths_by_the_program(depths, real):
    assert_interchangeable(duplicated(2500, seed=90), {"profile": "paper-s", "depths": depths})


@needs_real
@pytest.mark.parametrize("name", ["tiny_sh3.ply", "flowers_sh2.ply", "bonsai/point_cloud.ply"])
def test_real_scenes_by_the_program(name, real):
    scene = read_ply(shared_scene_path(name))
    expected = decode_scene(encode_scene(scene, Config("paper-m"))[0])
    data = encode_scene(scene, Config("paper-m", geometry="gpcc", verify=False))[0]
    assert_same_floats(decode_scene(data), expected)


@needs_real
@pytest.mark.parametrize("seed", range(8))
def test_damage_is_always_detected(seed, real):
    """The program may crash, hang or return other points: one error, or the same points."""
    tool = Tmc3(REAL.path, REAL.version, Limits(processor_seconds=2))
    rng = np.random.default_rng(seed)
    cells = rng.integers(0, 1 << 12, (3, 500)).astype(np.uint32)
    colours = rng.integers(0, 256, (3, 500)).astype(np.uint16)
    data = bytearray(encode_points(tool, cells, colours))
    data[rng.integers(0, len(data))] ^= 1 << rng.integers(0, 8)
    try:
        found = decode_points(tool, bytes(data), 500, (12, 12, 12), (8, 8, 8))
    except ToolFailed as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert found[0].shape == found[1].shape == (3, 500)
