"""Other codecs: their results, and bench lines of present and missing ones."""

from __future__ import annotations

import json
import os
import select
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec.bench import measure
from gs_codec.bench.peers import (
    PROGRAM_VARIABLE,
    AbsentPeer,
    columns_peer,
    find_peers,
    find_splat_transform,
    own_peers,
    splat_transform_peers,
    spz_peer,
    zstd_peer,
)
from gs_codec.cli.main import app
from gs_codec.errors import InvalidInput, ToolFailed
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows, write_ply
from gs_codec.metrics.views import compare_views
from gs_codec.views.find import find_cameras

STAND_IN = Path(__file__).with_name("splat_stand_in.py")
SPLAT_NAMES = [f"splat-transform, {label}" for label in ("compressed.ply", "spz", "SOG")]

EXACT = {
    "pcodec, columns": lambda: columns_peer("error"),
    "zstd, PLY": lambda: zstd_peer("error", threads=1),
}


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("count", [0, 1, 700])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_lossless_codecs_are_bit_exact(tmp_path, name, count, degree):
    write_ply(tmp_path / "scene.ply", random_scene(count, degree, seed=80))
    peer = EXACT[name]()
    assert peer.name == name
    back = peer.scene(peer.decode(peer.encode(tmp_path / "scene.ply")))
    expected = vertex_rows(read_ply(tmp_path / "scene.ply"))
    assert vertex_rows(back).tobytes() == expected.tobytes()


def test_all_peers_are_searched(monkeypatch):
    monkeypatch.setenv(PROGRAM_VARIABLE, "/nowhere")
    names = [peer.name.split(" ")[0].rstrip(",") for peer in find_peers("error")]
    assert names == ["spz", "splat-transform", "pcodec", "zstd"]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_restores_the_scene(tmp_path, capfd, degree):
    peer = spz_peer("error")
    if isinstance(peer, AbsentPeer):
        pytest.skip(peer.absent)
    scene = random_scene(2000, degree, seed=81)
    write_ply(tmp_path / "scene.ply", scene)
    data = peer.encode(tmp_path / "scene.ply")
    assert data[:8] == b"NGSP\x04\0\0\0"
    back = peer.scene(peer.decode(data))
    assert capfd.readouterr().out == ""
    # Positions and scales have fixed steps: 2^-12 scene units, 1/16.
    np.testing.assert_allclose(back.positions, scene.positions, atol=2**-13 + 1e-6)
    np.testing.assert_allclose(back.log_scale, np.clip(scene.log_scale, -10, 6), atol=1 / 32 + 1e-5)
    cameras = find_cameras("auto", scene, width=60, auto=3)
    assert compare_views(scene, back, cameras, device="cpu").mean.between.psnr > 30


def test_missing_spz_is_reported_with_a_remedy(monkeypatch):
    peer = spz_peer("error", "no_module_of_this_name")
    assert isinstance(peer, AbsentPeer)
    assert peer.absent.startswith("spz: not installed ('make peers', or pip install ")
    monkeypatch.setitem(sys.modules, "another_spz", ModuleType("another_spz"))
    peer = spz_peer("error", "another_spz")
    assert isinstance(peer, AbsentPeer)
    assert "module 'another_spz' is not Niantic's" in peer.absent


@pytest.fixture
def ply(tmp_path) -> Path:
    write_ply(tmp_path / "scene.ply", random_scene(200, 1, seed=83))
    return tmp_path / "scene.ply"


def stand_in(folder: Path) -> str:
    """The stand-in for splat-transform, as an executable."""
    path = folder / "splat-transform"
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" -I -S "{STAND_IN}" "$@"\n')
    path.chmod(0o755)
    return str(path)


@pytest.fixture
def splat_peers(tmp_path, monkeypatch):
    monkeypatch.setenv(PROGRAM_VARIABLE, stand_in(tmp_path))
    peers = splat_transform_peers(threads=2)
    assert [peer.name for peer in peers] == SPLAT_NAMES
    assert {peer.version for peer in peers} == {"v0.1 (stand-in)"}
    return peers


def test_splat_transform_is_called_from_file_to_file(splat_peers, ply):
    for peer in splat_peers:
        assert peer.own_process
        data = peer.encode(ply)
        assert data == ply.read_bytes()
        back = peer.scene(peer.decode(data))
        assert vertex_rows(back).tobytes() == vertex_rows(read_ply(ply)).tobytes()
    assert [peer.once for peer in splat_peers] == [False, False, True]


def test_splat_transform_is_found(tmp_path, monkeypatch):
    """By the environment variable, on PATH, and where `make peers` installs it."""
    for folder in ("variable", "path", "prefix/peers/node_modules/.bin", "empty"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.delenv(PROGRAM_VARIABLE, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    [absent] = splat_transform_peers()
    assert absent.absent.startswith("splat-transform: not found; 'make peers', or npm install")
    for folder in ("prefix/peers/node_modules/.bin", "path", "variable"):
        expected = stand_in(tmp_path / folder)
        if folder == "path":
            monkeypatch.setenv("PATH", str(tmp_path / "path"))
        if folder == "variable":
            monkeypatch.setenv(PROGRAM_VARIABLE, expected)
        assert find_splat_transform()[0] == expected
        assert len(splat_transform_peers()) == 3


@pytest.mark.parametrize(
    ("failure", "message"),
    [
        (
            "other",
            "splat-transform: not splat-transform, --version prints 'another 1.0'; 'make peers'",
        ),
        ("nowhere", "/nowhere: no such program; 'make peers'"),
        ("broken", "broken: not splat-transform, --version prints "),
    ],
)
def test_a_different_program_counts_as_absent(failure, message, tmp_path, monkeypatch):
    path = {"nowhere": "/nowhere", "broken": str(tmp_path / "broken")}.get(failure)
    (tmp_path / "broken").write_bytes(b"\x7fELF and nothing more")
    (tmp_path / "broken").chmod(0o755)
    monkeypatch.setenv(PROGRAM_VARIABLE, path or stand_in(tmp_path))
    monkeypatch.setenv("SPLAT_STAND_IN", failure)
    [absent] = splat_transform_peers()
    assert isinstance(absent, AbsentPeer)
    assert message in absent.absent
    assert "\n" not in absent.absent


@pytest.mark.parametrize(
    ("failure", "message"),
    [
        ("fail:", "ended with status 1: Error: no good"),
        ("nothing", "wrote nothing"),
        ("garbage", "wrote a PLY that cannot be read: "),
    ],
)
def test_failures_of_splat_transform_are_one_error(splat_peers, ply, failure, message, monkeypatch):
    monkeypatch.setenv("SPLAT_STAND_IN", failure)
    peer = splat_peers[0]
    with pytest.raises(ToolFailed, match=message):
        peer.scene(peer.decode(peer.encode(ply)))


def test_hanging_programs_are_killed_with_their_children(ply, tmp_path, monkeypatch):
    monkeypatch.setenv(PROGRAM_VARIABLE, stand_in(tmp_path))
    monkeypatch.setattr("gs_codec.bench.peers.SECONDS", 1.0)
    peer = splat_transform_peers()[2]
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    monkeypatch.setenv("SPLAT_STAND_IN", f"hang:{fifo}")
    with pytest.raises(ToolFailed, match="did not end in 1 s"):
        peer.encode(ply)
    # It ends when no process holds it open.
    assert select.select([reader], [], [], 300)[0]
    assert os.read(reader, 1) == b""
    os.close(reader)


@pytest.mark.parametrize(
    "commands",
    ["gzip -1c {in} >{out}; gzip -dc {in} >{out}", "cp {in} {out}.bin.1; cp {in}.bin.1 {out}"],
)
def test_own_codecs_are_two_shell_commands(tmp_path, commands):
    folder = tmp_path / "a folder's"
    folder.mkdir()
    scene = random_scene(300, 1, seed=85)
    write_ply(folder / "scene.ply", scene)
    [peer] = own_peers([f"mine: {commands}"])
    assert (peer.name, peer.version, peer.own_process) == ("mine", commands.split(";")[0], True)
    data = peer.encode(folder / "scene.ply")
    assert (data == (folder / "scene.ply").read_bytes()) == commands.startswith("cp")
    assert vertex_rows(peer.scene(peer.decode(data))).tobytes() == vertex_rows(scene).tobytes()


@pytest.mark.parametrize(
    ("commands", "message"),
    [
        ("no-such-tool {in} {out}; cp {in} {out}", "ended with status 127: .*no-such-tool"),
        ("cp {in} {out}.bin; cp {in} {out}", "ended with status 1: .*coded"),
        ("cp {in} {out}; echo {in} >{out}", "wrote a PLY that cannot be read"),
        ("true {in} {out}; cp {in} {out}", "wrote nothing"),
    ],
)
def test_failures_of_own_codecs_are_one_error(ply, commands, message):
    [peer] = own_peers([f"mine: {commands}"])
    with pytest.raises(ToolFailed, match=message):
        peer.scene(peer.decode(peer.encode(ply)))


def test_own_codecs_leave_nothing_in_the_background(ply, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    encode = f"exec 3>{tmp_path / 'pipe'} && {{ sleep 600 & }} && cp {{in}} {{out}}"
    [peer] = own_peers([f"mine: {encode}; cp {{in}} {{out}}"])
    peer.encode(ply)
    assert select.select([reader], [], [], 60)[0]
    assert os.read(reader, 1) == b""
    os.close(reader)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["mine"], "codec 'mine': expected NAME: ENCODE; DECODE, with {in} and {out} in each"),
        (["mine: cp {in} {out}"], "expected NAME: ENCODE; DECODE"),
        (["mine: cp {in} x; cp {in} {out}"], "expected NAME: ENCODE; DECODE"),
        (["mine: cd a; cp {in} {out}; cp {in} {out}"], "expected NAME: ENCODE; DECODE"),
        ([": cp {in} {out}; cp {in} {out}"], "expected NAME: ENCODE; DECODE"),
        (["m, x: cp {in} {out}; cp {in} {out}"], "the name 'm, x' is taken"),
        (2 * ["a: cp {in} {out}; cp {in} {out}"], "the name 'a' is taken"),
    ],
)
def test_own_codecs_need_a_name_and_two_commands(texts, message):
    with pytest.raises(InvalidInput, match=message):
        own_peers(texts)


@pytest.mark.parametrize("index", range(3))
def test_splat_transform_itself_restores_the_scene(tmp_path, index):
    peers = splat_transform_peers()
    if len(peers) < 3:
        pytest.skip(peers[0].absent)
    scene = random_scene(500, 3, seed=84)
    write_ply(tmp_path / "scene.ply", scene)
    data = peers[index].encode(tmp_path / "scene.ply")
    assert data.startswith([b"ply\n", b"NGSP\x04\0\0\0", b"PK\3\4"][index])
    back = peers[index].scene(peers[index].decode(data))
    assert (back.count, back.sh_degree) == (500, 3)
    cameras = find_cameras("auto", scene, width=60, auto=3)
    assert compare_views(scene, back, cameras, device="cpu").mean.between.psnr > 30


@pytest.fixture(scope="module")
def beside_lines(tmp_path_factory) -> tuple[list[dict], str]:
    path = tmp_path_factory.mktemp("peers") / "scene.ply"
    write_ply(path, random_scene(600, 1, seed=82))

    def peers(extra, threads):
        absent = AbsentPeer("other", "other: not installed (get it)")
        return [absent, columns_peer(extra, threads), *splat_transform_peers(threads)]

    options = ["-p", "m", "-p", "paper-m", "--repeats", "2"]
    options += ["--cameras", "auto", "--width", "36"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "find_peers", peers)
        patch.setenv(PROGRAM_VARIABLE, stand_in(path.parent))
        patch.setenv("SPLAT_STAND_IN", "fail:.sog")
        result = CliRunner().invoke(app, ["bench", "peers", str(path), *options])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()], result.stderr


@pytest.mark.thorough
def test_every_codec_has_a_line(beside_lines):
    lines, table = beside_lines
    assert [line["kind"] for line in lines] == ["machine"] + ["beside"] * 8
    names = [line["codec"] for line in lines[1:]]
    assert names == ["m", "paper-m", "m, camera-guided", "pcodec, columns", *SPLAT_NAMES, "other"]
    for line in lines[1:-2]:
        assert line["own_process"] == (line["codec"] in SPLAT_NAMES)
        assert line["ratio"] == pytest.approx(line["input_bytes"] / line["output_bytes"])
        assert line["bits_per_gaussian"] == pytest.approx(8 * line["output_bytes"] / 600)
        assert line["encode_seconds"]["min"] > 0
        assert line["views"] == 24
        assert f"\n{line['codec']}{' *' if line['own_process'] else ''}" in table.replace(":", "")


@pytest.mark.thorough
def test_bit_exact_codecs_have_equal_views(beside_lines):
    lines, table = beside_lines
    assert lines[4]["codec"] == "pcodec, columns"
    assert lines[4]["mean"]["psnr"] is None
    assert "equal" in table
    assert lines[2]["mean"]["psnr"] < 90


def test_absent_codecs_have_one_line(beside_lines):
    lines, table = beside_lines
    assert lines[-1]["absent"] == "other: not installed (get it)"
    assert table.count("other: not installed (get it)") == 1


def test_failing_codecs_have_one_line(beside_lines):
    lines, table = beside_lines
    why = "splat-transform, SOG of scene: ended with status 1: Error: no good"
    assert lines[-2] == {
        "kind": "beside",
        "scene": "scene",
        "codec": "splat-transform, SOG",
        "absent": why,
    }
    assert table.count(why) == 1
