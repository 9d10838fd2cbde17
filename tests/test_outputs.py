"""Outputs: supported suffixes, existing files, pipes."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import ROOT, assert_one_error_line, strict_json

import gs_codec
from gs_codec.cli import streams
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.preparing import prepare_file
from gs_codec.plan import Plan, Steps
from gs_codec.runtime import atomic
from gs_codec.runtime.arrays import folder_on_disk

WRONG_SUFFIX = {
    "encode scene.ply b.ply": ".usdc or .usdz; `convert` writes that",
    "encode scene.ply b.ksplat": "b.ksplat: suffix '.ksplat', expected .egs",
    "encode scene.ply b": "b: suffix '', expected .egs",
    "decode scene.egs b.splat": "b.splat: suffix '.splat', expected .ply; `convert` writes that",
    "decode scene.egs b.egs": "b.egs: suffix '.egs', expected .ply; `convert` writes that",
    "decode scene.egs b.compressed.ply": "suffix '.compressed.ply', expected .ply",
    "convert scene.ply b.OBJ": "suffix '.obj', expected .egs, .spz, .sog, meta.json, .comp",
    "prepare scene.ply b.obj --prune 9": "suffix '.obj', expected .egs, .spz",
    "prepare scene.ply - --prune 9": "-: suffix '', expected .egs, .spz",
    # Their other files have the same names whatever theirs is.
    "encode scene.ply b-meta.json": "b-meta.json: expected the name meta.json, which viewers",
    "convert scene.ply b-tileset.json": "b-tileset.json: expected the name tileset.json, which",
    "encode scene.ply - --format ply": "--format ply: `convert` writes that",
}


@pytest.mark.parametrize("command", WRONG_SUFFIX)
def test_unsupported_output_suffix_is_refused(folder, command):
    assert WRONG_SUFFIX[command] in folder.refuse(*command.split())


# What exists

VIEWS = "--cameras cameras.json --width 16"
WRITING = {
    "encode scene.ply out.egs": "out.egs",
    "decode scene.egs out.ply": "out.ply",
    "convert scene.ply out.splat": "out.splat",
    "prepare scene.ply out.ply --rectify 7 --width 16": "out.ply",
    "prepare scene.ply o.ply --rectify 7 --report out --width 16": "out/report.json",
    f"render scene.ply {VIEWS} --out out": "out/a.png",
    f"render scene.ply {VIEWS} --out out.json": "out.json",
    f"compare scene.ply scene.egs {VIEWS} --images out": "out/a_a.png",
    "analyze scene.ply --out out": "out/report.html",
    "bench suite scene.ply --out out": "out/suite.jsonl",
    "batch scene.ply out": "out/scene.egs",
    "batch decoded.ply . --report out.jsonl": "out.jsonl",
}


@pytest.mark.parametrize("command", WRITING)
def test_existing_outputs_are_refused_before_the_work(folder, command):
    existing = Path(WRITING[command])
    existing.parent.mkdir(exist_ok=True)
    # Looks like the beginning of a `batch` report.
    existing.write_text('{"source": 0}\n')
    line = folder.refuse(*command.split())
    assert existing.parts[0] in line
    assert "--overwrite" in line


@pytest.mark.parametrize(
    "command", [c for c in WRITING if c.split()[0] in ("encode", "decode", "convert", "render")]
)
def test_existing_outputs_are_replaced_with_overwrite(folder, command):
    existing = Path(WRITING[command])
    existing.parent.mkdir(exist_ok=True)
    existing.write_text("old")
    (existing.parent / "beside").write_text("other")
    assert folder.run(*command.split(), "--overwrite").status == 0
    assert existing.read_bytes() != b"old"
    assert (existing.parent / "beside").read_text() == "other"


@pytest.mark.parametrize("name", ["tileset.json", "lod-meta.json", "meta.json"])
def test_the_other_files_of_a_scene_are_refused_too(folder, name):
    command = ("convert", "scene.ply", f"there/{name}")
    Path("there").mkdir()
    assert folder.run(*command).status == 0
    Path(command[-1]).unlink()
    line = folder.refuse(*command)
    assert "already exists; choose another folder or pass --overwrite" in line
    assert folder.run(*command, "--overwrite").status == 0


def test_empty_folder_is_accepted(folder):
    Path("out").mkdir()
    assert folder.run("render", "scene.ply", *VIEWS.split(), "--out", "out").status == 0


@pytest.mark.parametrize("command", ["share no.ply", "render no.ply", "compare no.ply no.ply"])
def test_a_file_in_place_of_a_folder_is_refused_before_the_work(folder, command):
    Path("out").touch()
    option = "--images" if command.startswith("compare") else "--out"
    line = folder.refuse(*command.split(), "--cameras", "auto", option, "out", "--overwrite")
    assert line == "gs-codec: error: out: exists, expected a folder\n"


def test_cameras_are_not_written_over_what_they_are_from(folder):
    for name in ("cameras.json", "link.json"):
        Path("link.json").unlink(missing_ok=True)
        Path("link.json").symlink_to("cameras.json")
        typed = ["--cameras", "cameras.json", "--out", name, "--overwrite"]
        line = folder.refuse("render", "scene.ply", *typed)
        assert f"{name}: input and output are the same file" in line


def test_dangling_link_counts_as_existing(folder):
    Path("link.egs").symlink_to("nowhere.egs")
    assert "link.egs: already exists" in folder.refuse("encode", "scene.ply", "link.egs")


def test_functions_overwrite_on_request(folder):
    cloud = gs_codec.read("scene.ply")
    writers = {
        "a.egs": lambda path, **keep: encode_file("scene.ply", path, **keep),
        "a.ply": lambda path, **keep: decode_file("scene.egs", path, **keep),
        "a.splat": lambda path, **keep: convert_file("scene.ply", path, **keep),
        "b.ply": lambda path, **keep: prepare_file(
            "scene.ply", path, Plan(Steps(rectify=7.5), "cameras.json", width=16), **keep
        ),
        "c.ply": lambda path, **keep: gs_codec.write(path, cloud, **keep),
    }
    for name, write in writers.items():
        Path(name).write_text("old")
        with pytest.raises(InvalidInput, match=f"^{name}: already exists"):
            write(name)
        assert Path(name).read_text() == "old"
        write(name, overwrite=True)
        assert Path(name).read_bytes() != b"old"


# Pipes


def piped(*arguments: str, given: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "gs_codec", *arguments]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, input=given, capture_output=True, check=False)


def test_dash_is_stdin_and_stdout(folder, trio):
    coded = piped("encode", "-", "-", "-p", "paper-m", given=trio.ply.read_bytes())
    assert (coded.returncode, coded.stdout) == (0, trio.egs.read_bytes())
    # Progress lines may come first on a slow machine.
    assert b"\n-: 1,500 Gaussians, 355.48 kB -> " in b"\n" + coded.stderr
    back = piped("decode", "-", "-", given=coded.stdout)
    assert (back.returncode, back.stdout) == (0, trio.decoded.read_bytes())
    assert not Path("-").exists()


@pytest.mark.parametrize(
    "command",
    [
        "convert - out.splat",
        "prepare - out.ply --rectify 7 --cameras cameras.json --width 16",
        "verify -",
        "encode - out.egs",
    ],
)
def test_commands_that_read_a_scene_from_stdin(folder, trio, command):
    data = (trio.egs if command.startswith("verify") else trio.ply).read_bytes()
    folder.monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    assert folder.run(*command.split()).status == 0


SPLAT = np.random.default_rng(5).uniform(0.25, 0.75, (40, 8)).astype("<f4").tobytes()


@pytest.mark.parametrize(
    "command",
    [
        "convert - out.ply",
        "prepare - out.ply --rectify 7 --cameras auto --width 16",
        "verify -",
        "inspect -",
        "encode - out.egs",
    ],
)
def test_the_format_of_stdin_can_be_given(folder, command):
    def given(data: bytes) -> None:
        stdin = io.TextIOWrapper(io.BytesIO(data))
        folder.monkeypatch.setattr(sys, "stdin", stdin)

    given(SPLAT)
    assert folder.refuse(*command.split()).endswith(
        "needs --input-format for splat, ksplat and gltf\n"
    )
    given(SPLAT)
    assert folder.run(*command.split(), "--input-format", "splat").status == 0
    given(b"ply\n" + SPLAT)
    line = folder.refuse(*command.split(), "--input-format", "splat")
    assert line.endswith("error: -: content is ply, expected splat\n")
    typed = command.replace("-", "scene.ply", 1).split()
    line = folder.refuse(*typed, "--input-format", "splat")
    assert line.endswith("--input-format: has no effect on scene.ply, expected - or a pipe\n")


def test_named_pipe_is_read_as_a_file(folder, trio):
    os.mkfifo("pipe")
    with subprocess.Popen(["cp", str(trio.ply), "pipe"]):
        assert folder.run("encode", "pipe", "out.egs", "-p", "paper-m").status == 0
    assert Path("out.egs").read_bytes() == trio.egs.read_bytes()


def test_a_full_temporary_folder_is_named(folder):
    def full(*_) -> None:
        raise OSError(28, "No space left on device")

    folder.monkeypatch.setattr(streams.shutil, "copyfileobj", full)
    folder.monkeypatch.setenv("TMPDIR", str(folder.path))
    line = folder.refuse("encode", "-", "out.egs")
    assert line.endswith(f": -: copying it to {folder.path}: No space left on device\n")
    # Where --max-memory keeps large arrays: /tmp may be in memory.
    folder.monkeypatch.delenv("TMPDIR")
    disk = folder_on_disk()
    assert f" copying it to {disk}: No space" in folder.refuse("encode", "-", "out.egs")
    folder.monkeypatch.setattr(atomic.os, "fsync", full)
    line = folder.refuse("encode", "scene.ply", "-")
    assert line.endswith(f": -: temporary file in {disk}: No space left on device\n")


def test_a_full_disk_leaves_no_new_folder(folder):
    def full(*_) -> None:
        raise OSError(28, "No space left on device")

    folder.monkeypatch.setattr(atomic.os, "fsync", full)
    Path("empty").mkdir()
    for name in ("new", "empty"):
        line = folder.refuse("convert", "scene.ply", f"{name}/tileset.json")
        assert line.endswith(": No space left on device\n")
    assert not Path("new").exists()
    assert list(Path("empty").iterdir()) == []


def test_commands_that_read_no_pipe_say_so(folder, trio):
    os.mkfifo("pipe")
    with subprocess.Popen(["cp", str(trio.ply), "pipe"], stderr=subprocess.DEVNULL):
        status, _, err = folder.run("compare", "pipe", "scene.ply")
    line = "gs-codec: error: pipe: a pipe or device, expected a file\n"
    assert (status, err) == (2, line)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("given", [b"", b"no scene"])
def test_errors_name_a_piped_source(folder, given):
    done = piped("encode", "-", "-", given=given)
    assert (done.returncode, done.stdout) == (2, b"")
    assert_one_error_line(done.stderr.decode())
    assert done.stderr.startswith(b"gs-codec: error: -: ")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_full_stdout_is_named(folder):
    command = [sys.executable, "-m", "gs_codec", "convert", "scene.ply", "-", "--quiet"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command, env=environment, stdout=full, stderr=subprocess.PIPE, check=False, text=True
        )
    line = "gs-codec: error: standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, line)


@pytest.mark.parametrize(
    ("typed", "place"), [("encode scene.ply - --none", "err"), ("encode - o.egs --none", "out")]
)
def test_document_of_a_usage_error_is_not_on_stdout_that_takes_a_scene(folder, typed, place):
    result = folder.run(*typed.split(), "--json")
    assert result.status == 2
    assert strict_json(getattr(result, place).splitlines()[-1])["error"]["kind"] == "Usage"
    assert place == "out" or result.out == ""


@pytest.mark.thorough
def test_warnings_name_stdout(folder, trio):
    done = piped("encode", "-", "-", "--format", "splat", given=trio.ply.read_bytes())
    assert done.returncode == 0
    warnings = [line for line in done.stderr.decode().splitlines() if "warning" in line]
    assert warnings[0].startswith("gs-codec: warning: -: opacity, colour and rotation rounded")
    assert all(line.startswith("gs-codec: warning: -: ") for line in warnings)


def test_scene_is_not_written_to_a_terminal(folder):
    folder.monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert "-: stdout is a terminal" in folder.refuse("encode", "scene.ply", "-")


@pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell closes the streams")
@pytest.mark.parametrize(
    ("typed", "status", "error"),
    [
        ("--version >&-", 0, ""),
        ("inspect nope.ply >&- 2>&- <&-", 2, ""),
        ("encode nope.ply - >&-", 2, "-: stdout is closed, expected a pipe or a file"),
    ],
)
def test_closed_streams_act_like_the_null_device(typed, status, error, tmp_path):
    command = ["sh", "-c", f"'{sys.executable}' -m gs_codec {typed}"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr == (error and f"gs-codec: error: {error}\n")
