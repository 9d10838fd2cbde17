"""Batches: selection of scenes, outputs, resuming, and untrusted reports."""

from __future__ import annotations

import json
import ntpath
import os
import platform
import re
import sys
from collections import Counter
from dataclasses import fields, replace
from inspect import signature
from pathlib import Path
from typing import Any

import foreign
import pytest
from batch_work import in_this_process
from camera_files import inria_entry, write_json
from command_line import Folder, assert_one_error_line
from scenes import random_scene

from gs_codec import __version__
from gs_codec.batch import local, needed_memory, remote, run, scene_tasks
from gs_codec.batch.ledger import Record, parse_record
from gs_codec.batch.local import Location
from gs_codec.batch.remote import is_url, storage_of
from gs_codec.batch.run import Batch, Summary, Watcher, run_batch
from gs_codec.batch.scene_tasks import Options, Task
from gs_codec.cli import batch, encode
from gs_codec.config import Config, RateTarget
from gs_codec.edit.actions import Action
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.writing import write_scene
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.plan import Plan, Steps
from gs_codec.runtime import memory as free_memory
from gs_codec.runtime.atomic import atomic_writer, leftovers
from gs_codec.runtime.optional import is_available
from gs_codec.views.estimate import HEIGHT, WIDTH
from gs_codec.workers.pool import Pool

NAMES = ("a.ply", "sub/b.ply", "sub/deeper/c.ply")


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys) -> Folder:
    """Three scenes in folders, and batches that run in this process."""
    for seed, name in enumerate(NAMES):
        path = tmp_path / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_ply(path, random_scene(200, seed, seed=seed))
    monkeypatch.setattr(run, "Pool", in_this_process)
    # The memory of this process serves as remote storage.
    monkeypatch.setattr(remote, "_OWN", "")
    monkeypatch.setattr(remote, "_OBJECTS", ("memory",))
    monkeypatch.chdir(tmp_path)
    return Folder(tmp_path, monkeypatch, capsys)


def records(path: str | Path = "out/report.jsonl") -> list[dict[str, Any]]:
    return [json.loads(line) for line in Path(path).read_text().splitlines()]


def encoded(path: str | Path, config: Config | None = None) -> bytes:
    """The result of `encode` for a scene."""
    encode_file(path, "one.egs", config)
    content = Path("one.egs").read_bytes()
    Path("one.egs").unlink()
    return content


# What is written


def summary_of(out: str) -> Summary:
    told = json.loads(out)
    return Summary(**{field.name: told[field.name] for field in fields(Summary)})


def test_tree_is_mirrored_and_reported(folder):
    status, out, err = folder.run("batch", "in", "out", "--jobs", "2")
    assert status == 0
    assert out.startswith("3 scenes encoded; ")
    lines = err.splitlines()
    assert len(lines) == 5
    assert sum("not measured" in line for line in lines) == 1
    for name, record in zip(NAMES, records(), strict=True):
        source, output = Path("in", name), Path("out", name).with_suffix(".egs")
        assert output.read_bytes() == encoded(source)
        expected = {
            "input": str(source.absolute()),
            "output": str(output.absolute()),
            "input_bytes": source.stat().st_size,
            "input_modified": source.stat().st_mtime_ns,
            "input_sha256": local.file_sha256(source),
            "output_bytes": output.stat().st_size,
            "output_sha256": local.file_sha256(output),
            "gaussians": 200,
            "ratio": source.stat().st_size / output.stat().st_size,
            "error": None,
        }
        assert record | expected == record
        assert {"gs_codec", "numpy", "numba"} <= record["versions"].keys()
        assert {"fetch", "read", "code", "write"} <= record["stages"].keys()
    assert sum(path.is_file() for path in Path("out").rglob("*")) == 4


@pytest.mark.parametrize(
    ("source", "outputs"),
    [
        ("in", ["a", "sub/b", "sub/deeper/c"]),
        ("in/", ["a", "sub/b", "sub/deeper/c"]),
        ("in/**/*.ply", ["a", "sub/b", "sub/deeper/c"]),
        ("in/*.ply", ["a"]),
        ("in/*/*.ply", ["sub/b"]),
        ("in/sub/**/*.ply", ["b", "deeper/c"]),
        ("in/sub/b.ply", ["b"]),
        ("*/a.ply", ["in/a"]),
        ("file://{here}/in/sub", ["b", "deeper/c"]),
    ],
)
def test_output_tree_starts_at_the_first_wildcard(folder, source, outputs):
    source = source.format(here=folder.path)
    assert folder.run("batch", source, "out").status == 0
    found = [str(path.relative_to("out").with_suffix("")) for path in Path("out").rglob("*.egs")]
    assert sorted(found) == outputs


def test_outputs_of_an_earlier_run_are_no_scenes(folder, caplog):
    for count in (3, 0):
        out = folder.run("batch", ".", "out", "--format", "ply", "--json", "--resume").out
        summary = summary_of(out)
        assert (summary.done, summary.skipped) == (count, 3 - count)
    assert "skipped 3 scenes that this batch writes" in caplog.messages
    assert not Path("out/out").exists()


@pytest.mark.parametrize("suffixes", [(".ply",), (".ply", ".spz.ply"), (".ply", ".splat")])
def test_outputs_next_to_their_scenes_are_no_scenes(folder, suffixes):
    for suffix in suffixes[1:]:
        folder.run("convert", "in/a.ply", f"in/a{suffix}")
    for resumed in (False, True):
        args = ["--resume"] if resumed else []
        assert folder.run("batch", "in/a*", "in", "--format", "spz", *args, "--json").status == 0
        outputs = sorted(path.name for path in Path("in").glob("*.spz"))
        stems = ["a.ply", "a.splat"] if ".splat" in suffixes else ["a", "a.spz"][: len(suffixes)]
        assert outputs == [f"{stem}.spz" for stem in stems]


def test_options_equal_those_of_encode(folder):
    options = ("-p", "paper-s", "--depth", "rotation=9", "--extra", "drop", "--threads", "2")
    assert folder.run("batch", "in/*.ply", "out", *options, "--json").status == 0
    config = Config("paper-s", {"rotation": 9}, extra="drop")
    assert Path("out/a.egs").read_bytes() == encoded("in/a.ply", config)


def test_batch_has_the_options_of_encode():
    of_encode, of_batch = (signature(x.command).parameters.keys() for x in (encode, batch))
    # These are for a single scene or sequence, or for stdin.
    assert of_encode - {"checkpoint", "input_format", "fps", "group", "target_bitrate"} <= of_batch
    # `--dask` is not an expert option of batch.
    options = "checkpoint FILE|dask ADDRESS|input-format NAME|fps X|group N|target-bitrate RATE"
    own = re.compile(rf"\n--({options}) .*?(?=\n--|\n\n)", re.DOTALL)
    without = own.sub("", encode.command.epilog)
    assert "--crop-box X,Y,Z,X,Y,Z " in without
    assert without == batch.command.epilog


def test_ratios_are_relative_to_floats_for_compressed_sources(folder):
    Path("packed").mkdir()
    write_scene("packed/a.splat", read_ply("in/a.ply"), Config())
    assert folder.run("batch", "packed", "out", "--target-ratio", "3").status == 0
    (record,) = records()
    raw = encode_file("packed/a.splat", "one.egs").raw_bytes
    assert raw / record["output_bytes"] >= 3
    # A ratio relative to the file itself would be much lower.
    assert record["input_bytes"] / record["output_bytes"] < 3
    assert record["ratio"] == raw / record["output_bytes"]
    out = folder.run("batch", "packed", "again", "--target-ratio", "3").out
    assert f"({record['ratio']:.2f}x relative to the floats)" in out


def test_folder_has_scenes_of_every_format(folder):
    for suffix in ("splat", "spz", "sog", "egs", "json"):
        Path(f"in/sub/{suffix}.{suffix}").write_bytes(b"{")
    write_scene("in/sub/splat.splat", read_ply("in/a.ply"), Config())
    assert folder.run("batch", "in/sub", "out").status == 1
    names = {Path(record["input"]).name: record["error"] for record in records()}
    assert names.keys() == {"b.ply", "c.ply", "splat.splat", "spz.spz", "sog.sog"}
    assert names["splat.splat"] is None
    assert Path("out/splat.egs").read_bytes() == encoded("in/sub/splat.splat")
    assert folder.run("batch", "in/sub/*.json", "out", "--overwrite").status == 1
    assert records()[0]["error"]["text"].endswith("SOG of several files, expected a bundle (.sog)")


@pytest.mark.parametrize(
    ("name", "text"),
    [("tileset.json", "3D Tiles of several files"), ("LOD-meta.json", "a bundle (.ssog)")],
)
def test_scenes_of_several_files_are_refused_by_their_format(folder, name, text):
    Path(f"in/{name}").write_bytes(b"{")
    assert text in folder.run("batch", f"in/{name}", "out").err


def test_parts_of_other_scenes_in_a_folder_are_no_scenes(folder, caplog):
    scene = read_ply("in/a.ply")
    for name in ("tileset.json", "lod-meta.json", "meta.json"):
        Path("in", name[:1]).mkdir()
        convert_file("in/a.ply", f"in/{name[:1]}/{name}")
    write_scene("in/t/tiles/own.glb", scene, Config())
    parts = ["lcc/0.sog", "lcc/1.sog", "lcc/coarse.sog", "lcc/environment.spz"]
    files = foreign.lcc2_files(parts)
    write_scene("in/own.spz", scene, Config())
    for name, data in files.items():
        Path("in", name).write_bytes(data)
    Path("in/lcc").mkdir()
    for name in parts:
        write_scene(f"in/{name}", scene, Config())
    Path("in/meta.json").write_text("{}")
    Path("in/broken").mkdir()
    Path("in/broken/tileset.json").write_text("{}")
    write_scene("in/broken/0.glb", scene, Config())
    caplog.clear()
    found = [name for name, _ in storage_of("in").find()]
    assert found == ["a.lcc2", "a.ply", "own.spz", *NAMES[1:], "t/tiles/own.glb"]
    (warning,) = (record.getMessage() for record in caplog.records)
    assert "skipped 4 scenes of several files, such as " in warning
    assert warning.endswith("convert each to one file")


def test_summary_as_json(folder):
    Path("in/broken.ply").write_text("no scene")
    status, out, _ = folder.run("batch", "in", "out", "--json", "--report", "lines")
    found = summary_of(out)
    assert (status, found.done, found.failed, found.report) == (1, 3, 1, "lines")
    assert found.output_bytes == sum(path.stat().st_size for path in Path("out").rglob("*.egs"))


def test_an_error_stops_the_batch_on_request(folder):
    Path("in/sub/b.ply").write_text("no scene")
    status, out, _ = folder.run("batch", "in", "out", "--on-error", "stop")
    assert status == 1
    assert "1 scene encoded, 1 failed, 1 not started" in out
    assert [record["error"] is None for record in records()] == [True, False]
    error = records()[1]["error"]
    assert error["kind"] == "InvalidInput"
    assert error["text"].startswith(f"{Path('in/sub/b.ply').absolute()}: not a readable PLY")


def test_changes_and_warnings_are_reported(folder):
    scene = random_scene(200, 0)
    scene.rot[:, 3] = 0
    write_ply("in/a.ply", scene)
    with open("in/a.ply", "ab") as file:
        file.write(b"more")
    status, _, err = folder.run("batch", "in/a.ply", "out")
    assert status == 0
    assert records()[0]["changed"] == {"zero_quaternions": 1}
    assert "left out: 4 bytes after the last vertex" in records()[0]["warnings"][0]
    assert "warning: " in err


def test_preparation_is_reported(folder):
    write_ply("in/a.ply", random_scene(200, 0))
    prune = ["--prune", "50", "--cameras", "auto", "--views", "2", "--width", "32"]
    assert folder.run("batch", "in/a.ply", "out", *prune)[0] == 0
    assert records()[0]["prepared"]["gaussians"] == 100
    _, _, err = folder.run("batch", "in/a.ply", "out", *prune, "--resume")
    assert "not records" not in err
    folder.run("batch", "in/a.ply", "out", "--overwrite")
    assert records()[0]["prepared"] is None


# Links


def test_links_to_parent_folders_are_not_followed(folder, caplog):
    Path("in/sub/up").symlink_to("..")
    Path("in/sub/above").symlink_to("../..")
    for source in ("in", "in/**/*.ply", "in/sub/**/*.ply", "in/**/**/*.ply"):
        caplog.clear()
        target = f"out of {source.replace('/', ' ')}"
        assert folder.run("batch", source, target).status == 0
        assert len(records(f"{target}/report.jsonl")) == (2 if "sub" in source else 3)
        lines = [f"{Path('in/sub', name).absolute()}: links to " for name in ("up", "above")]
        assert all(caplog.text.count(line) == 1 for line in lines)


@pytest.mark.parametrize("source", ["in", "in/**/*.ply"])
def test_folders_of_many_links_are_read_once(folder, caplog, source):
    for name in ("one", "two", "three"):
        Path("in", name).symlink_to(".")
        Path("in/sub/deeper", name).symlink_to("../../sub")
    assert folder.run("batch", source, "out").status == 0
    assert len(records()) == 3
    assert caplog.text.count("links to") == 6


@pytest.mark.parametrize("source", ["in", "in/**/*.ply", "in/*/*.ply"])
def test_linked_scene_is_encoded_once(folder, caplog, source):
    write_ply("far.ply", random_scene(200, 0, seed=7))
    Path("far").mkdir()
    Path("far.ply").rename("far/d.ply")
    Path("in/0").symlink_to("sub")
    Path("in/far").symlink_to("../far")
    Path("in/sub/0.ply").symlink_to("b.ply")
    assert folder.run("batch", source, "out").status == 0
    names = sorted(Path(record["input"]).relative_to(folder.path / "in") for record in records())
    deep = [] if source == "in/*/*.ply" else ["a.ply", "sub/deeper/c.ply"]
    assert [str(name) for name in names] == sorted([*deep, "sub/b.ply", "far/d.ply"])
    assert "in/sub/0.ply: the same file as " in caplog.text


def test_unreadable_folder_is_reported(folder, caplog):
    real = os.scandir

    def closed(path: str) -> Any:
        if str(path).endswith("deeper"):
            raise PermissionError(13, "Permission denied", path)
        return real(path)

    folder.monkeypatch.setattr(os, "scandir", closed)
    assert folder.run("batch", "in", "out").status == 0
    assert f"{Path('in/sub/deeper').absolute()}: Permission denied, skipped" in caplog.text


# Rejected before any work


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("missing", "out"), "missing: no such file or folder"),
        (("in/**/*.splat", "out"), "no scenes found"),
        (("in", "out", "--jobs", "0"), "jobs 0: expected 1 to 1024"),
        (("in", "out", "--on-error", "panic"), "on_error 'panic': expected 'continue' or 'stop'"),
        (("in", "out", "--profile", "xl"), "profile 'xl': expected one of"),
        (
            ("in", "out", "--dask", "tcp://h:1", "--jobs", "2"),
            "has no effect with a Dask scheduler",
        ),
        (("in", "out", "--target-size", "much"), "--target-size much: expected a size"),
        (("in", "out", "--report", "in"), "in: a directory, expected a file name"),
        (("in", "out", "--report", "no/report"), "no/report: no directory 'no'"),
        (("in", "in/a.ply"), "in/a.ply: File exists, expected a folder"),
        (("in", "in/a.ply/out"), "in/a.ply/out: Not a directory, expected a folder"),
        (("in", "http://localhost/out"), "http://localhost/out: http is read-only"),
        (("in", "nonsense://out"), "nonsense://out: Protocol not known: nonsense"),
        (("in", "simplecache::memory://out"), "a chain of protocols is read-only"),
        (("in", "out", "--report", "s3://a:b@c"), "report s3://a@c: expected a local file"),
    ],
)
def test_usage_errors_are_one_line(folder, arguments, text):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    before = {name for name in folder.contents() if name != "out"}
    status, out, err = folder.run("batch", *arguments)
    assert (status, out) == (2, "")
    assert_one_error_line(err)
    assert text in err
    assert folder.contents().keys() - {"out"} == before


def test_patterns_of_windows_have_a_fixed_part(monkeypatch):
    monkeypatch.setattr(local.os, "sep", "\\")
    monkeypatch.setattr(local.os.path, "abspath", ntpath.abspath)
    place = storage_of("C:\\city\\tiles\\**\\*.ply")
    assert place.path == "C:/city/tiles/**/*.ply"
    assert local.fixed_part(place.path) == "C:/city/tiles"
    target = storage_of("D:\\coded").location("a\\b.egs")
    assert local.by_folder([target]) == {"D:/coded/a": {"b.egs"}}


def test_two_sources_of_one_output_are_refused(folder):
    # Scenes that differ only in their suffix keep it, which may be the name of another.
    for name in ("in/a.PLY", "in/a.ply.ply"):
        Path(name).write_bytes(Path("in/a.ply").read_bytes())
    err = folder.refuse("batch", "in", "out")
    assert "in/a.ply.ply would both be written to " in err
    assert f" would both be written to {Path('out/a.ply.egs').absolute()}" in err


@pytest.mark.parametrize(
    ("key", "text"),
    [("../../out.ply", "'..'"), ("a\\..\\..\\out.ply", "'..'"), ("c:/out.ply", "'c:'")],
)
def test_keys_of_an_object_store_stay_in_the_folder(folder, key, text):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    store = storage_of("memory://")._fs
    folder.monkeypatch.setattr(store, "find", lambda *_, **__: {f"/way/{key}": {}})
    folder.monkeypatch.setattr(scene_tasks.os.path, "splitdrive", ntpath.splitdrive)
    store.pipe_file("/way/a.ply", b"x")
    err = folder.refuse("batch", "memory://way", ".")
    assert f"memory://way/{key}: {text} in its name" in err


def test_scene_is_not_written_over_itself(folder):
    Path("in/a.egs").write_bytes(b"")
    assert "a.egs: input and output are the same file" in folder.refuse("batch", "in/a.egs", "in")


def test_unrelated_file_is_not_used_as_a_report(folder):
    Path("thesis.txt").write_text("Chapter 1\n")
    err = folder.refuse("batch", "in", ".", "--report", "thesis.txt")
    assert "thesis.txt: exists and is not a report of gs-codec batch" in err
    assert "not a report" in folder.refuse("batch", "in", ".", "--report", "thesis.txt", "--resume")


def test_two_batches_do_not_share_a_report(folder):
    fcntl = pytest.importorskip("fcntl")
    assert folder.run("batch", "in", "out").status == 0
    with open("out/report.jsonl", "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert "another batch" in folder.refuse("batch", "in", "out", "--overwrite")


def test_report_that_cannot_be_written_ends_the_batch(folder):
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    Path("out").mkdir()
    folder.monkeypatch.setattr(os, "fsync", full)
    status, out, err = folder.run("batch", "in", "out")
    assert (status, out) == (2, "")
    line = f"gs-codec: error: {Path('out/report.jsonl').absolute()}: No space left on device"
    assert err.splitlines()[-1] == line


# Scenes encoded again


def resumed(folder: Folder, *options: str) -> Summary:
    status, out, err = folder.run("batch", "in", "out", "--json", "--resume", *options)
    assert status == 0, err
    return summary_of(out)


def test_complete_scenes_are_skipped(folder):
    assert resumed(folder).done == 3
    before = folder.contents()
    again = resumed(folder, "--threads", "2")
    assert (again.done, again.skipped) == (0, 3)
    assert folder.contents() == before


@pytest.mark.parametrize(
    "change",
    [
        lambda: Path("in/a.ply").write_bytes(Path("in/sub/b.ply").read_bytes()),
        lambda: Path("out/a.egs").unlink(),
        lambda: Path("out/a.egs").write_bytes(b"x"),
        lambda: Path("out/a.egs").write_bytes(bytes(Path("out/a.egs").stat().st_size)),
    ],
    ids=["input", "no output", "short output", "other output"],
)
def test_changed_scenes_are_encoded_again(folder, change):
    resumed(folder)
    change()
    again = resumed(folder)
    assert (again.done, again.skipped) == (1, 2)
    assert Path("out/a.egs").read_bytes() == encoded("in/a.ply")
    assert resumed(folder).skipped == 3


def test_touched_input_with_equal_content_is_skipped(folder):
    resumed(folder)
    os.utime("in/a.ply", (1, 1))
    assert resumed(folder).skipped == 3


def test_changed_input_of_equal_size_is_encoded_again(folder):
    resumed(folder)
    write_ply("in/a.ply", random_scene(200, 0, seed=9))
    os.utime("in/a.ply", (1, 1))
    assert resumed(folder).done == 1


def test_a_scene_of_several_files_is_compared_as_a_whole(folder):
    values = [foreign.rad_values(9, 0, seed=seed) for seed in range(3)]
    chunks = [foreign.rad_chunk(each, {}) for each in values]
    for name, data in foreign.rad_file(chunks[:2], prefix="d-").items():
        Path("in", name or "d.rad").write_bytes(data)
    assert (resumed(folder).done, resumed(folder).skipped) == (4, 4)
    record = next(each for each in records() if each["input"].endswith("d.rad"))
    assert record["input_bytes"] == sum(path.stat().st_size for path in Path("in").glob("d*.rad*"))
    if is_available("fsspec"):
        folder.run("batch", f"local://{Path('in').resolve()}/d.rad", "other")
        [record] = records("other/report.jsonl")
        text = "in/d.rad: a scene of 3 files, expected one file in remote storage"
        assert record["error"]["text"].endswith(text)
    changed = foreign.rad_file([chunks[0], chunks[2]], prefix="d-")["d-1.radc"]
    Path("in/d-1.radc").write_bytes(changed)
    assert resumed(folder).done == 1
    assert Path("out/d.egs").read_bytes() == encoded("in/d.rad")


def test_different_options_encode_everything_again(folder):
    resumed(folder)
    assert resumed(folder, "--profile", "s").done == 3
    assert resumed(folder, "--profile", "s").skipped == 3


def test_a_different_version_encodes_everything_again(folder):
    resumed(folder)
    text = Path("out/report.jsonl").read_text()
    Path("out/report.jsonl").write_text(
        text.replace(f'"gs_codec": "{__version__}', '"gs_codec": "9')
    )
    assert resumed(folder).done == 3


def test_failures_are_retried(folder):
    good = Path("in/a.ply").read_bytes()
    Path("in/a.ply").write_bytes(good[:-1])
    assert folder.run("batch", "in", "out").status == 1
    Path("in/a.ply").write_bytes(good)
    again = resumed(folder)
    assert (again.done, again.skipped) == (1, 2)


def test_without_resume_a_new_report_is_started(folder):
    resumed(folder)
    status, out, _ = folder.run("batch", "in", "out", "--overwrite")
    assert (status, len(records())) == (0, 3)
    assert out.startswith("3 scenes encoded; ")


def test_existing_outputs_are_refused_without_overwrite(folder):
    assert folder.run("batch", "in/a.ply", "out").status == 0
    assert "out/a.egs: already exists; pass --resume or" in folder.refuse(
        "batch", "in/a.ply", "out"
    )
    os.unlink("out/a.egs")
    assert "report.jsonl: already exists; pass --resume or" in folder.refuse("batch", "in", "out")
    assert "cannot be combined" in folder.refuse("batch", "in", "out", "--resume", "--overwrite")


def test_incomplete_files_are_removed(folder):
    Path("out/sub").mkdir(parents=True)
    ours = [Path("out/.a.egs.0123abcd"), Path("out/sub/.b.egs.ffffffff")]
    others = [Path("out/.a.egs.0123"), Path("out/.c.egs.0123abcd"), Path("out/.a.egs.0123ABCD")]
    for path in (*ours, *others):
        path.touch()
    others += [Path("out/.a.egs.0000000a"), Path("out/.a.egs.0000000b")]
    others[-2].mkdir()
    others[-1].symlink_to(others[0].absolute())
    resumed(folder)
    assert not any(path.exists() for path in ours)
    assert all(path.exists() for path in others)


@pytest.mark.parametrize("target", ["out", "local://{here}/out"])
@pytest.mark.parametrize("nameless", [True, False])
def test_batches_keep_each_others_unfinished_outputs(folder, target, nameless):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    target = target.format(here=folder.path)
    arguments = ("batch", "in/a.ply", target)
    rename, statuses = os.rename, []

    def rename_late(begun: str, moved: str) -> None:
        """Simulate another batch that arrives when an output is complete but not yet named."""
        if not statuses:
            statuses.append(None)
            other = run_batch(Batch("in/a.ply", target, Options(Config()), report="other.jsonl"))
            statuses.append(other.failed)
        rename(begun, moved)

    if not nameless:
        folder.monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    assert folder.run(*arguments, "--report", "zero.jsonl").status == 0
    Path("zero.jsonl").unlink()
    for name in ("rename", "replace"):
        folder.monkeypatch.setattr(os, name, rename_late)
    status, _, err = folder.run(*arguments, "--report", "one.jsonl", "--resume")
    assert (status, statuses) == (0, [None, 0]), err
    assert [path.name for path in Path("out").iterdir()] == ["a.egs"]


def test_temporary_names_are_recognised(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    name = "x" * 120 + ".egs"
    with atomic_writer(tmp_path / name) as file:
        file.write(b"x")
        assert leftovers(os.listdir(tmp_path), [name]) == os.listdir(tmp_path)
    assert leftovers(os.listdir(tmp_path), [name]) == []


def test_source_changed_during_encoding_is_an_error(folder):
    original = local.LocalStorage.fetch

    def fetch(self, file: Location, into: Path) -> Path:
        os.utime(file.path, (1, 1))
        return original(self, file, into)

    folder.monkeypatch.setattr(local.LocalStorage, "fetch", fetch)
    assert folder.run("batch", "in/a.ply", "out").status == 1
    assert records()[0]["error"]["text"].endswith("a.ply: changed while it was read")
    assert not Path("out/a.egs").exists()


def test_named_pipe_does_not_block(folder):
    os.mkfifo("in/pipe.ply")
    assert folder.run("batch", "in", "out").status == 1
    assert [r["error"]["text"] for r in records() if r["error"]] == [
        f"{Path('in/pipe.ply').absolute()}: not a regular file"
    ]


def test_circular_link_is_an_error_of_one_scene(folder):
    Path("in/circle.ply").symlink_to("circle.ply")
    assert folder.run("batch", "in", "out").status == 1
    errors = [r["error"]["text"] for r in records() if r["error"]]
    assert errors == [f"{Path('in/circle.ply').absolute()}: Too many levels of symbolic links"]
    assert len(records()) == 4


def test_unexpected_exceptions_are_errors_of_one_scene(folder):
    def surprise(*arguments: Any, **options: Any) -> None:
        raise ZeroDivisionError

    folder.monkeypatch.setattr("gs_codec.files.encode_file.encode_requested", surprise)
    assert folder.run("batch", "in/a.ply", "out").status == 1
    text = f"{Path('in/a.ply').absolute()}: ZeroDivisionError"
    assert records()[0]["error"] == {"kind": "ZeroDivisionError", "text": text}


# Untrusted reports

GOOD = json.dumps({"input": "s", "output": "o", "input_bytes": 3, "error": None})

GARBAGE = [
    b"",
    b"null",
    b"[]",
    b'"text"',
    b"{}",
    b"{" * 100_000,
    b"[" * 100_000,
    b'{"input": "s"}',
    b'{"input": "s", "output": 7}',
    b'{"input": "s", "output": "o", "input_bytes": "3"}',
    b'{"input": "s", "output": "o", "input_bytes": true}',
    b'{"input": "s", "output": "o", "input_bytes": 1e400}',
    b'{"input": "s", "output": "o", "ratio": NaN}',
    b'{"input": "s", "output": "o", "ratio": Infinity}',
    b'{"input": "s", "output": "o", "ratio": ' + b"9" * 400 + b"}",
    b'{"input": "s", "output": "o", "input_bytes": ' + b"9" * 10_000 + b"}",
    b'{"input": "s", "output": "o", "versions": {"gs_codec": 1}}',
    b'{"input": "s", "output": "o", "error": ["kind"]}',
    b'{"input": "s", "output": "o", "seconds": {"read": {"read": 1}}}',
    b'{"source": "\xff", "output": "o"}',
    GOOD.encode()[:-1],
]


@pytest.mark.parametrize("line", GARBAGE, ids=range(len(GARBAGE)))
def test_invalid_line_is_not_a_record(line):
    assert parse_record(line) is None


def test_valid_line_is_a_record():
    assert parse_record(GOOD.encode()) == Record("s", "o", input_bytes=3)
    later = GOOD[:-1] + ', "what later versions have": [1]}'
    assert parse_record(later.encode()) == Record("s", "o", input_bytes=3)


def test_garbage_in_a_report_is_ignored(folder, caplog):
    resumed(folder)
    report = Path("out/report.jsonl")
    first, *rest = report.read_bytes().splitlines()
    garbage = [line for line in GARBAGE if line]
    report.write_bytes(b"\n".join([first, *garbage, *rest, b'{"source": "torn']))
    assert resumed(folder).skipped == 3
    assert f"skipped {len(garbage)} lines without a record" in caplog.text
    assert b"torn" not in report.read_bytes()


@pytest.mark.parametrize("torn", [b'{"sche', b'{"sour'])
def test_report_with_only_a_truncated_line_is_accepted(folder, torn):
    Path("out").mkdir()
    Path("out/report.jsonl").write_bytes(torn)
    assert resumed(folder).done == 3
    assert len(records()) == 3


# Options


def test_digest_covers_everything_the_bytes_depend_on(tmp_path):
    cameras = tmp_path / "cameras.json"
    cameras.write_text("[]")
    plan = Plan(Steps(), cameras=str(cameras))
    options = [
        Options(Config()),
        Options(Config("s")),
        Options(Config(depths={"rotation": 9})),
        Options(Config(), Plan(Steps(prune=30))),
        Options(Config(), plan),
        Options(Config(), rate=RateTarget(ratio=12)),
    ]
    digests = [one.digest() for one in options]
    assert len(set(digests)) == len(options)
    assert Options(Config(threads=3)).digest() == digests[0]
    cameras.write_text("[ ]")
    assert Options(Config(), plan).digest() not in digests
    (tmp_path / "model").mkdir()
    model = Options(Config(), replace(plan, cameras=tmp_path / "model"))
    before = model.digest()
    (tmp_path / "model/images.bin").touch()
    assert model.digest() != before


def test_digest_covers_all_rows_of_a_project(tmp_path):
    def digest(removed):
        file = tmp_path / "a.gsproj"
        file.write_text(json.dumps(project | {"removed": removed}))
        return Options(Config(), actions=(Action("edits", str(file)),)).digest()

    scenes = [{"path": "a.ply", "name": "a", "gaussians": 5000}]
    project = {"project": 1, "scenes": scenes, "moves": [], "hidden": ""}
    assert digest("2500") != digest("2501")


# Memory


def task(name: str, need: int) -> Task:
    file = Location(name)
    return Task(name, file, file, (name, name), local.Stamp(0, 0), need)


def test_tasks_start_when_they_fit_into_memory():
    pool = Pool(3, 100, "")
    pool._waiting.extend([large := task("large", 150), small := task("small", 40)])
    pool._waiting.append(middle := task("middle", 70))
    pool._again.append(lost := task("lost", 1))

    class Busy:
        def __init__(self, running: Task) -> None:
            self.task = running

    assert pool._next() is large  # alone, because it never fits
    pool._busy.append(Busy(large))
    assert pool._next() is None
    pool._busy[:] = [Busy(task("other", 50))]
    assert pool._next() is small
    pool._busy.append(Busy(small))
    assert pool._next() is None
    pool._busy.clear()
    assert pool._next() is middle
    pool._busy.append(Busy(middle))
    assert pool._next() is None  # retries run alone
    pool._busy.clear()
    assert pool._next() is lost
    assert pool._next() is None


@pytest.mark.parametrize(
    ("jobs", "threads", "count", "expected"),
    [
        (None, None, 99, (8, 1)),
        (None, None, 3, (3, 2)),
        (2, None, 99, (2, 4)),
        (None, 3, 99, (2, 3)),
        (None, 9, 99, (1, 9)),
        (5, 4, 99, (5, 4)),  # as requested
    ],
)
def test_scenes_share_the_processors(monkeypatch, jobs, threads, count, expected):
    monkeypatch.setattr(run, "available_threads", lambda: 8)
    monkeypatch.setattr(scene_tasks, "available_threads", lambda: 8)
    options = Options(Config(threads=threads))
    batch = Batch("in", "out", options, jobs)
    jobs = run._open_workers(batch, count, "", Watcher())._jobs
    assert (jobs, options.with_share(jobs).config.threads) == expected


@pytest.mark.parametrize(
    ("on_host", "of_worker", "expected"), [(4, 1, 2), (8, 4, 1), (0, 2, 4), (1, 1, 8)]
)
def test_scenes_of_a_cluster_share_the_processors_of_a_host(
    monkeypatch, on_host, of_worker, expected
):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    from gs_codec.workers import dask

    class Worker:
        memory_manager = type("", (), {"memory_limit": None})
        state = type("", (), {"nthreads": of_worker})
        local_directory = "."

    monkeypatch.setattr(dask.distributed, "get_worker", Worker)
    monkeypatch.setattr(scene_tasks, "available_threads", lambda: 8)
    hosts = Counter({platform.node(): on_host, "another": 99})
    place = dask._do(lambda task, place: place, task("a", 1), hosts, "topic")
    assert Options(Config()).with_share(place.jobs).config.threads == expected


def test_estimated_memory_grows_with_scene_and_views():
    small, large = (needed_memory.needed_bytes(size) for size in (0, 10**9))
    assert 0 < small < 10**9
    assert large - small >= 2.7e9
    assert needed_memory.needed_bytes(10**9, 1) > large


def test_floats_are_estimated_from_the_file_size():
    expected = needed_memory.expected_floats
    assert expected(10**9, "a.ply") == 10**9
    assert expected(10**9, "a.compressed.ply") == 5 * 10**9
    assert expected(10**9, "a.spz") > expected(10**9, "a.compressed.ply")
    assert expected(-1, "a.ply") == 0
    assert needed_memory.most_floats(10**9, "a.spz") > expected(10**9, "a.spz")
    assert needed_memory.most_floats(-1, "a.spz") > 0


def test_paths_in_options_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = Config("paper-m", geometry="auto", tmc3="bin/tmc3")
    found = Options(config, Plan(Steps(), "cameras.json", "images")).absolute()
    assert found.config.tmc3 == str(tmp_path / "bin/tmc3")
    assert found.plan.cameras == str(tmp_path / "cameras.json")
    assert found.plan.gt_images == str(tmp_path / "images")
    config = replace(config, tmc3="tmc3")
    assert Options(config, Plan(Steps())).absolute() == Options(config, Plan(Steps()))


def test_views_are_counted(tmp_path):
    file = str(write_json(tmp_path / "cameras.json", inria_entry(width=90, height=60)))
    assert Options(Config()).pixels() == 0
    assert Options(Config(), rate=RateTarget(ratio=9)).pixels() == 0
    assert Options(Config(), rate=RateTarget(psnr_drop=1)).pixels() == 64 * WIDTH * HEIGHT
    assert Options(Config(), Plan(Steps(), views=3)).pixels() == 3 * WIDTH * HEIGHT
    assert Options(Config(), Plan(Steps(), views=3, width=300)).pixels() == 6 * 300 * 200
    assert Options(Config(), Plan(Steps(), file, views=2)).pixels() == 2 * 90 * 60
    with pytest.raises(InvalidInput, match="missing"):
        Options(Config(), Plan(Steps(), "missing.json")).pixels()


def test_free_memory_respects_control_groups(tmp_path):
    group = tmp_path / "user/me"
    group.mkdir(parents=True)
    (group / "memory.max").write_text("max\n")
    for folder, most in ((tmp_path, 900), (tmp_path / "user", 1000)):
        (folder / "memory.max").write_text(f"{most}\n")
        (folder / "memory.current").write_text("300\n")
        (folder / "memory.stat").write_text("anon 7\ninactive_file 50\n")
    free = free_memory._along(tmp_path, "/user/me", "memory.max", "memory.current")
    assert sorted(free) == [650, 750]
    assert free_memory.available_bytes() is None or free_memory.available_bytes() > 0


# Storage


def test_urls_are_distinguished_from_paths():
    assert is_url("s3://bucket/a")
    assert not is_url("file:///a")
    assert not is_url("C:/a")
    assert not is_url("a/b")


@pytest.mark.parametrize(
    ("url", "text", "line"),
    [
        ("s3://b/a", "Install s3fs to access S3", ""),
        ("sftp://h/a", 'requires "paramiko"', "; pip install 'gs-codec[cluster]'"),
    ],
    ids=["s3", "sftp"],
)
def test_missing_backend_is_named_with_its_install_command(monkeypatch, url, text, line):
    fsspec = pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")

    def missing(*arguments: Any, **options: Any) -> None:
        raise ImportError(text)

    monkeypatch.setattr(fsspec.core, "url_to_fs", missing)
    with pytest.raises(MissingTool) as caught:
        storage_of(url)
    assert str(caught.value) == f"{url}: {text}{line}"


def test_in_process_storage_is_refused():
    with pytest.raises(InvalidInput, match="memory://a: storage of this process, expected"):
        storage_of("memory://a")


def test_missing_dask_is_named_with_its_install_command(folder):
    folder.monkeypatch.delitem(sys.modules, "gs_codec.workers.dask", raising=False)
    for name in ("dask", "distributed"):
        folder.monkeypatch.setitem(sys.modules, name, None)
    status, out, err = folder.run("batch", "in", "out", "--dask", "local")
    assert (status, out) == (2, "")
    assert err == "gs-codec: error: dask: needs distributed; pip install 'gs-codec[cluster]'\n"


def test_object_store_without_folders_works(folder):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    store = storage_of("memory://")._fs
    for name in NAMES:
        store.pipe_file(f"/scenes/{name}", Path("in", name).read_bytes())
    store.pipe_file("/scenes/bad.ply", b"no scene")
    batch = Batch("memory://scenes/**/*.ply", "memory://coded", Options(Config()), resume=True)
    summary = run_batch(batch)
    assert (summary.done, summary.failed, summary.report) == (3, 1, "report.jsonl")
    for name in NAMES:
        coded = store.cat_file(f"/coded/{name.replace('.ply', '.egs')}")
        assert coded == encoded(Path("in", name))
    assert records("report.jsonl")[1]["error"]["text"].startswith("memory://scenes/bad.ply: not a ")
    assert run_batch(batch).skipped == 3
    store.pipe_file("/coded/a.egs", b"other")
    assert run_batch(batch).done == 1
    for name in ("tileset.json", "tiles/0/0.glb", "tiles/1/tileset.json", "tiles/a.spz"):
        store.pipe_file(f"/parted/{name}", b"")
    assert [name for name, _ in storage_of("memory://parted").find()] == ["tiles/a.spz"]


def test_keys_with_characters_that_windows_reserves_are_stored_with_underscores(folder):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    place = storage_of("memory://reserved")
    place._fs.pipe_file("/reserved/photo:a.ply", b"x")
    [(name, found)] = place.find()
    assert name == place.fetch(found, folder.path).name == "photo:a.ply"
    folder.monkeypatch.setattr(local.os, "sep", "\\")
    written = storage_of("out").location(name), storage_of("file:///out").location(name)
    paths = [place.fetch(found, folder.path), *(Path(each.path) for each in written)]
    assert {path.name for path in paths} == {"photo_a.ply"}


def test_errors_of_a_storage_have_no_secrets(monkeypatch):
    pytest.importorskip("aiohttp", reason="no client for the web")
    place = storage_of("https://host/a.ply?signature=secret")

    def fails(error: Exception) -> str:
        def raise_it(*arguments: Any) -> None:
            raise error

        monkeypatch.setattr(place._fs, "info", raise_it)
        with pytest.raises(InvalidInput) as caught:
            place.find()
        return str(caught.value)

    missing = FileNotFoundError("https://host/a.ply?signature=secret")
    assert fails(missing) == "https://host/a.ply: No such file or directory"
    strange = RuntimeError("no 'https://host/a.ply?signature=secret'\nat all")
    assert fails(strange) == "https://host/a.ply: no 'https://host/a.ply' at all"
    assert fails(TimeoutError()) == "https://host/a.ply: TimeoutError"


def test_warnings_name_the_scene_instead_of_its_copy(folder):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    store = storage_of("memory://")._fs
    store.pipe_file("/scenes/a.ply", Path("in/a.ply").read_bytes() + b"more")
    assert folder.run("batch", "memory://scenes/a.ply", "out").status == 0
    warning, _ = records()[0]["warnings"]  # and views are not measured
    assert warning.startswith("memory://scenes/a.ply: left out: 4 bytes after the last vertex")


def test_download_needs_free_space(folder):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    storage_of("memory://")._fs.pipe_file("/scenes/large.ply", b"large")
    folder.monkeypatch.setattr("shutil.disk_usage", lambda path: type("", (), {"free": 4}))
    assert folder.run("batch", "memory://scenes/large.ply", "out").status == 1
    assert "memory://scenes/large.ply: 5 bytes, " in records()[0]["error"]["text"]
    assert ", 4 free in " in records()[0]["error"]["text"]


def test_watcher_receives_every_scene_and_stage(folder):
    heard = []

    class Ears(Watcher):
        def started(self, task: Task) -> None:
            heard.append(("started", task.name))

        def stage(self, task: Task, stage: str, done: int, total: int) -> None:
            heard.append(("stage", stage))

        def ended(self, task: Task, record: Record) -> None:
            heard.append(("ended", task.name))

    run_batch(Batch("in/a.ply", "out", Options(Config("paper-m"))), Ears())
    assert heard[0] == ("started", "a.ply")
    assert heard[-1] == ("ended", "a.ply")
    assert {kind for kind, _ in heard} == {"started", "stage", "ended"}


def test_invalid_batches_in_python():
    with pytest.raises(InvalidInput, match="jobs 2000"):
        Batch("a", "b", Options(Config()), jobs=2000)
