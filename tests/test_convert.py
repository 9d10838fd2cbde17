"""``gs-codec convert``: what is kept, lost and reported; and coordinate systems."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from appearance import assert_seen_alike
from scenes import assert_same_bits, random_scene, thorough
from typer.testing import CliRunner

from gs_codec.cli.main import app
from gs_codec.config import Config
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import inspect_file, read_scene
from gs_codec.files.writing import write_scene
from gs_codec.formats import limits
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows, write_ply
from gs_codec.formats.registry import open_scene, scene_files
from gs_codec.scene import ORDER, Scene, coordinates_comment


def run(*arguments: object) -> tuple[str, str]:
    """Standard output and error of a successful command."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout, result.stderr


@pytest.fixture
def spz(tmp_path) -> Path:
    path = tmp_path / "scene.spz"
    streams = foreign.spz_streams(40, 3, 2, seed=1)
    streams[1] = bytes([0, 255]) + streams[1][2:]
    path.write_bytes(foreign.spz_file(streams, 40, 3, 2, flags=1))
    return path


@pytest.fixture
def ply(tmp_path) -> Path:
    path = tmp_path / "scene.ply"
    extra = {"label": np.arange(60, dtype="<i4"), "Weight_2": np.linspace(0, 1, 60)}
    write_ply(path, replace(random_scene(60, 2, seed=3), extra=extra, comments=("one", "two")))
    return path


@pytest.mark.parametrize("suffix", [".ply", ".egs"])
def test_declarations_of_spz_stay_with_the_scene(suffix, spz, tmp_path, caplog):
    caplog.set_level("INFO")
    target = tmp_path / f"out{suffix}"
    exact = ["-p", "lossless", "--keep-order"] if suffix == ".egs" else []
    out, err = run("convert", spz, target, "--coordinates", "keep", *exact)
    assert out.startswith(f"{target}: 40 Gaussians, SH degree 2, ")
    assert "coordinates unchanged (RUB)" in err
    scene, back = (read_scene(path, coordinates=None) for path in (spz, target))
    assert_same_bits(scene, back)
    assert (back.coordinates, back.antialiased) == ("RUB", True)
    assert (
        caplog.messages[0] == f"{spz}: opacity 0 or 1 has no logit, moved by 0.00098 in 2 Gaussians"
    )


def test_inspect_shows_what_was_declared(spz, tmp_path):
    encode_file(spz, tmp_path / "a.egs", Config("paper-m"))
    write_ply(tmp_path / "b.ply", random_scene(20, 0))
    encode_file(tmp_path / "b.ply", tmp_path / "b.egs")
    assert "coordinates RDF, antialiased\n" in run("inspect", tmp_path / "a.egs")[0]
    assert "coordinates not stated\n" in run("inspect", tmp_path / "b.egs")[0]
    shown = json.loads(run("inspect", tmp_path / "a.egs", "--json")[0])
    assert (shown["coordinates"], shown["antialiased"]) == ("RDF", True)
    assert inspect_file(tmp_path / "b.egs").coordinates is None


def test_extra_properties_survive_both_ways(ply, tmp_path):
    run("convert", ply, tmp_path / "a.egs", "-p", "lossless", "--keep-order")
    run("convert", tmp_path / "a.egs", tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == ply.read_bytes()
    run("convert", ply, tmp_path / "c.ply", "--extra", "drop")
    assert read_ply(tmp_path / "c.ply").extra == {}
    result = CliRunner().invoke(
        app, ["convert", str(ply), str(tmp_path / "d.ply"), "--extra=error"]
    )
    assert result.exit_code != 0
    assert not (tmp_path / "d.ply").exists()


def test_names_of_extra_properties_survive_a_lossy_file(ply, tmp_path):
    run("convert", ply, tmp_path / "a.egs", "-p", "s")
    run("convert", tmp_path / "a.egs", tmp_path / "b.ply")
    back = read_ply(tmp_path / "b.ply", "keep")
    assert list(back.extra) == ["label", "Weight_2"]
    assert sorted(back.extra["label"]) == list(range(60))


def test_converting_to_ply_is_decoding(ply, tmp_path):
    encode_file(ply, tmp_path / "a.egs", Config(extra="keep"))
    decode_file(tmp_path / "a.egs", tmp_path / "b.ply")
    convert_file(tmp_path / "a.egs", tmp_path / "c.ply")
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "c.ply").read_bytes()


@pytest.mark.parametrize("count", [0, 1, thorough(70_000)])
def test_a_table_has_every_float_exactly(count, tmp_path):
    scene = random_scene(count, int(count < 2))
    kept = {"label,x": np.arange(count, dtype="<i4") - 1, "w": np.linspace(0, 1, count)}
    scene = replace(scene, extra=kept, has_normals=True, comments=("one", f"{ORDER}floats"))
    scene.opacity[:, :2] = [np.nan, -np.inf] if count > 1 else 0.25
    lost, _ = write_scene(tmp_path / "a.csv", scene, Config())
    assert lost == ("left out: comments (1)",)
    with open(tmp_path / "a.csv", newline="") as file:
        names, *rows = csv.reader(file)
    expected = vertex_rows(replace(scene, has_normals=False))
    assert names == list(expected.dtype.names or ())
    assert len(rows) == count
    for name, column in zip(names, zip(*rows, strict=True), strict=False):
        values = np.array(column, expected.dtype[name])
        np.testing.assert_array_equal(values, expected[name], name)


@pytest.mark.parametrize("name", ["a.egs", "a.spz", "a.sog", "a.splat"])
def test_what_an_encoder_made_is_read_whatever_its_size(name, tmp_path, monkeypatch):
    scene = random_scene(3000)
    scene = replace(scene, f_rest=np.zeros_like(scene.f_rest))
    monkeypatch.setattr(limits, "DECODED_BYTES", 1)
    monkeypatch.setattr(limits, "EXPANSION", 1)
    write_scene(tmp_path / name, scene, Config())
    with pytest.raises(GsCodecError, match=r"max-bytes|the limit is"):
        read_scene(tmp_path / name)


def test_losses_of_splat_are_reported(ply, tmp_path, caplog):
    out, err = run("convert", ply, tmp_path / "a.splat", "--json")
    report = json.loads(out)
    assert report["gaussians"] == 60
    assert report["output_bytes"] == 60 * 32 == (tmp_path / "a.splat").stat().st_size
    line = "left out: SH of degrees 1 to 2; comments (2); properties label, Weight_2"
    assert line in report["lost"]
    assert f"{tmp_path / 'a.splat'}: {line}" in caplog.messages
    assert "coordinates unchanged (RDF)" in err


def test_nonfinite_values_are_refused_or_dropped(tmp_path):
    scene = random_scene(30, 0)
    opacity = scene.opacity.copy()
    opacity[0, 4:7] = np.nan
    write_ply(tmp_path / "a.ply", replace(scene, opacity=opacity))
    result = CliRunner().invoke(
        app, ["convert", *map(str, (tmp_path / "a.ply", tmp_path / "b.ply"))]
    )
    assert isinstance(result.exception, InvalidInput)
    assert "3 in opacity" in str(result.exception)
    _, err = run("convert", tmp_path / "a.ply", tmp_path / "b.ply", "--nonfinite", "drop")
    assert "dropped 3 Gaussians" in err
    assert read_ply(tmp_path / "b.ply").count == 27
    run(
        "convert",
        tmp_path / "a.ply",
        tmp_path / "c.egs",
        "-p",
        "lossless",
        "--keep-order",
    )
    np.testing.assert_array_equal(read_scene(tmp_path / "c.egs").opacity, opacity)


@pytest.mark.parametrize("name", ["out", "out.obj", "out.ksplat", "ply", "out.pth"])
def test_formats_that_are_not_written_are_refused(name, ply, tmp_path):
    with pytest.raises(InvalidInput, match=r"expected \.egs, .*\.ply, .* or \.collision\.glb"):
        convert_file(ply, tmp_path / name)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("command", ["convert", "encode", "prepare --gaussians 9", "batch", "read"])
def test_usd_needs_an_extra(command, ply, tmp_path, monkeypatch, run_codec):
    monkeypatch.setitem(sys.modules, "pxr", None)
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    first, *options = command.split()
    typed = [first, str(ply), str(tmp_path / "b.usdz"), *options]
    if first == "batch":
        typed = ["batch", str(ply), str(tmp_path / "out"), "--format", "usdz"]
    elif first == "read":
        typed = ["verify", str(tmp_path / "a.usda")]
    status, _, err = run_codec(*typed)
    assert status == 2
    assert "USD: needs usd-core; pip install 'gs-codec[usd]'" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.usda", "scene.ply"]


def test_converting_a_file_to_itself_is_refused(ply):
    before = ply.read_bytes()
    with pytest.raises(InvalidInput, match="input and output are the same file"):
        convert_file(ply, ply)
    assert ply.read_bytes() == before


@pytest.mark.parametrize("suffix", [".ply", ".egs", ".splat"])
def test_damaged_source_leaves_no_output(suffix, spz, tmp_path):
    spz.write_bytes(spz.read_bytes()[:-30])
    with pytest.raises(GsCodecError):
        convert_file(spz, tmp_path / f"out{suffix}")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.spz"]


def test_every_command_reads_other_formats(spz, tmp_path):
    run("encode", spz, tmp_path / "a.egs", "-p", "paper-m", "--nonfinite", "drop")
    run("compare", spz, tmp_path / "a.egs", "--json")
    run("render", spz, "--cameras", "auto", "--width", "16", "--out", tmp_path / "views")
    run(
        "prepare",
        spz,
        tmp_path / "b.splat",
        *["--prune-geometry", "10", "--width", "16", "--views", "2"],
    )
    assert read_scene(tmp_path / "b.splat").count < 40


def test_size_of_a_scene_includes_all_files(tmp_path):
    parts = foreign.sog_parts(300, 2, 0, seed=1)
    path = foreign.sog_folder(tmp_path, *parts)
    total = sum(file.stat().st_size for file in tmp_path.iterdir())
    out, _ = run("encode", path, tmp_path / "a.egs", "--json")
    with open_scene(path) as file:
        assert json.loads(out)["input_bytes"] == file.stored_bytes == total
    (tmp_path / "b.sog").write_bytes(foreign.sog_file(*parts))
    with open_scene(tmp_path / "b.sog") as file:
        assert file.stored_bytes == (tmp_path / "b.sog").stat().st_size
    assert {*scene_files(path)} == {*tmp_path.iterdir()} - {tmp_path / "b.sog"} - {
        tmp_path / "a.egs"
    }
    assert scene_files(tmp_path / "b.sog") == [tmp_path / "b.sog"]
    path.write_bytes(b"{")
    assert scene_files(path) == [path]


# Coordinate systems


def stated(scene: Scene, system: str) -> Scene:
    return replace(scene, comments=("first", coordinates_comment(system)))


@pytest.mark.parametrize("system", ["RUB", "LDB", "LUF", "LUB", "RUF", "RDB", "LDF"])
def test_turned_scenes_look_the_same_from_turned_directions(system):
    scene = stated(random_scene(30, 3, seed=4), "RDF")
    turned = turn_axes(scene, system)
    assert turned.coordinates == system
    assert turned.comments == ("first", coordinates_comment(system))
    signs = np.array([1 if a == b else -1 for a, b in zip("RDF", system, strict=True)])
    np.testing.assert_array_equal(turned.positions, scene.positions * signs[:, None])
    assert_seen_alike(scene, turned, np.diag(signs))
    assert_same_bits(scene, turn_axes(turned, "RDF"))


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize(
    ("system", "turn"),
    [
        ("RFU", [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ("RBD", [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ("LBU", [[-1, 0, 0], [0, 0, -1], [0, -1, 0]]),
    ],
)
def test_scenes_whose_z_is_up_look_the_same_too(system, turn, degree):
    scene = stated(random_scene(30, degree, seed=4), "RDF")
    turned = turn_axes(scene, system)
    np.testing.assert_array_equal(turned.positions, np.array(turn) @ scene.positions)
    assert_seen_alike(scene, turned, np.array(turn))
    back = turn_axes(turned, "RDF")
    np.testing.assert_allclose(back.f_rest, scene.f_rest, atol=1e-6)
    assert_same_bits(replace(scene, f_rest=back.f_rest), back)


def test_conversion_keeps_the_bits_of_nan():
    scene = random_scene(3, 1)
    bits = np.array([0x7FA00001, 0xFFC00002, 0x7F800000], np.uint32)
    scene.positions[:] = bits.view(np.float32)
    assert_same_bits(stated(scene, "RDF"), turn_axes(turn_axes(stated(scene, "RDF"), "RUB")))


def test_ply_and_splat_come_out_right_down_forward(spz, tmp_path):
    flip = np.array([[1], [-1], [-1]], np.float32)
    stored = read_scene(spz, coordinates=None)
    for name, *exact in (
        ["a.ply"],
        ["a.splat"],
        ["a.egs", "-p", "lossless", "--keep-order"],
    ):
        _, err = run("convert", spz, tmp_path / name, *exact)
        assert "coordinates converted from RUB to RDF" in err
        positions = read_scene(tmp_path / name, coordinates=None).positions
        np.testing.assert_array_equal(positions, stored.positions * flip)
    encode_file(spz, tmp_path / "b.egs", Config("lossless", keep_order=True))
    decode_file(tmp_path / "b.egs", tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


def test_encoding_keeps_the_bits_of_a_ply_that_states_another_system(tmp_path):
    write_ply(tmp_path / "a.ply", stated(random_scene(40, 2, seed=6), "RUB"))
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs", Config("lossless", keep_order=True))
    decode_file(tmp_path / "a.egs", tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()
    assert read_scene(tmp_path / "a.egs").coordinates == "RDF"


def test_a_system_is_one_of_right_or_left_up_or_down_back_or_forward(spz, ply, tmp_path):
    target = tmp_path / "out.ply"
    for system in ("up", "", "RDFX", "DRF", "RUU", "up:RDF", "RDF:", "RDF:RUB:RDF"):
        with pytest.raises(InvalidInput, match=r"scene.spz: .*expected for example RDF"):
            convert_file(spz, target, coordinates=system)
    assert not target.exists()
    _, err = run("convert", ply, target, "--coordinates", "rub")
    assert "coordinates converted from RDF to RUB" in err
    assert read_ply(target, "keep").coordinates == "RUB"
    _, err = run("convert", spz, target, "--coordinates", "luf:rdf", "--overwrite")
    assert "coordinates converted from LUF to RDF" in err
    flip = np.array([[-1], [-1], [1]], np.float32)
    stored = read_scene(spz, coordinates=None)
    np.testing.assert_array_equal(read_ply(target).positions, stored.positions * flip)
    _, err = run("convert", spz, target, "--coordinates", "RDF:RDF", "--overwrite")
    assert "coordinates unchanged (RDF)" in err
    np.testing.assert_array_equal(read_ply(target).positions, stored.positions)
    # If coordinates change, the comment on the sort order is dropped.
    encode_file(spz, tmp_path / "a.egs")
    convert_file(tmp_path / "a.egs", target, coordinates="LUF", overwrite=True)
    assert read_ply(target).comments == ("SplatRenderMode: mip", "CoordinateSystem: LUF")


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ((), None),
        (("CoordinateSystem: RUB",), "RUB"),
        (("coordinatesystem:luf", "another"), "LUF"),
        (("CoordinateSystem: RUB", "CoordinateSystem: RFU"), "RFU"),
        (("CoordinateSystem: RRR", "CoordinateSystem: UP", "CoordinateSystem: RUBX"), None),
    ],
)
def test_the_last_comment_on_the_coordinate_system_counts(comments, expected):
    assert replace(random_scene(1, 0), comments=comments).coordinates == expected


def test_chosen_gaussians_are_kept_in_their_order(ply, tmp_path):
    scene = read_ply(ply, "keep")
    chosen = np.arange(scene.count) % 3 == 0
    done = convert_file(ply, tmp_path / "a.ply", chosen=chosen)
    assert done.count == np.count_nonzero(chosen)
    assert_same_bits(read_ply(tmp_path / "a.ply", "keep"), scene.take(chosen))


@pytest.mark.parametrize(
    ("sources", "chosen", "said"),
    [
        (1, np.zeros(7, bool), r"chosen: bool \(7,\), expected bool \[\(\d+,\)\]"),
        (1, np.arange(60), "chosen: int64"),
        (2, np.ones(60, bool), r"expected bool \[\(60,\), \(60,\)\]"),
        (1, np.zeros(60, bool), "chosen: no Gaussian"),
    ],
)
def test_invalid_selections_are_refused(ply, tmp_path, sources, chosen, said):
    with pytest.raises(InvalidInput, match=said):
        convert_file([ply] * sources, tmp_path / "a.ply", chosen=chosen)
    assert not (tmp_path / "a.ply").exists()
