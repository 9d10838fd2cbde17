"""Other codecs beside ours: what comes back, what is absent, and the bench's lines of both."""

from __future__ import annotations

import json
import sys
from types import ModuleType

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec.bench import beside
from gs_codec.bench.peers import AbsentPeer, columns_peer, spz_peer
from gs_codec.cli.main import app
from gs_codec.io.ply import read_ply, vertex_rows, write_ply
from gs_codec.metrics.views import compare_views
from gs_codec.rendering.cameras import find_cameras


@pytest.mark.parametrize("count", [0, 1, 700])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_columns_come_back_bit_for_bit(tmp_path, count, degree):
    write_ply(tmp_path / "scene.ply", random_scene(count, degree, seed=80))
    peer = columns_peer("error")
    back = peer.scene(peer.decode(peer.encode(tmp_path / "scene.ply")))
    expected = vertex_rows(read_ply(tmp_path / "scene.ply"))
    assert vertex_rows(back).tobytes() == expected.tobytes()


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_spz_gives_the_same_scene_back(tmp_path, capfd, degree):
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


def test_spz_that_is_absent_says_how_to_get_it(monkeypatch):
    peer = spz_peer("error", "no_module_of_this_name")
    assert isinstance(peer, AbsentPeer)
    assert peer.absent.startswith("spz: not installed (pip install ")
    monkeypatch.setitem(sys.modules, "another_spz", ModuleType("another_spz"))
    peer = spz_peer("error", "another_spz")
    assert isinstance(peer, AbsentPeer)
    assert "module 'another_spz' is not Niantic's" in peer.absent


@pytest.fixture(scope="module")
def beside_lines(tmp_path_factory) -> tuple[list[dict], str]:
    path = tmp_path_factory.mktemp("peers") / "scene.ply"
    write_ply(path, random_scene(600, 1, seed=82))

    def peers(extra, threads):
        return [AbsentPeer("other", "other: not installed (get it)"), columns_peer(extra, threads)]

    options = ["-p", "m", "-p", "paper-m", "--peers", "--repeats", "2"]
    options += ["--cameras", "auto", "--width", "36"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(beside, "find_peers", peers)
        result = CliRunner().invoke(app, ["bench", str(path), *options])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()], result.stderr


def test_every_codec_has_a_line(beside_lines):
    lines, table = beside_lines
    assert [line["kind"] for line in lines] == ["machine"] + ["beside"] * 5
    names = [line["codec"] for line in lines[1:]]
    assert names == ["m", "paper-m", "m, by views", "pcodec, columns", "other"]
    for line in lines[1:-1]:
        assert line["ratio"] == pytest.approx(line["ply_bytes"] / line["file_bytes"])
        assert line["bits_per_gaussian"] == pytest.approx(8 * line["file_bytes"] / 600)
        assert line["encode_seconds"]["min"] > 0
        assert line["views"] == 24
        assert f"scene, {line['codec']}" in table


def test_what_is_bit_exact_looks_the_same(beside_lines):
    lines, table = beside_lines
    assert lines[4]["codec"] == "pcodec, columns"
    assert lines[4]["mean"]["psnr"] is None
    assert "equal" in table
    assert lines[2]["mean"]["psnr"] < 90


def test_what_is_absent_has_one_line(beside_lines):
    lines, table = beside_lines
    assert lines[-1]["absent"] == "other: not installed (get it)"
    assert table.count("other: not installed (get it)") == 1
