"""Memory for reading a scene in any format stays below its limit."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from batch_work import in_this_process
from command_line import Folder, assert_one_error_line
from damage import TIMES_FILE, TIMES_LIMIT
from PIL import Image
from scenes import random_scene

import gs_codec
from gs_codec.batch import needed_memory, remote, run
from gs_codec.batch.remote import storage_of
from gs_codec.batch.scene_tasks import Options, find_tasks
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import read_scene, stated_bytes
from gs_codec.files.writing import write_scene
from gs_codec.runtime.optional import is_available
from gs_codec.scene import SH_COEFFICIENTS, float_bytes
from viewer.scenes.view_request import Request

#: Memory that does not depend on limit and file: tables, and the image of a palette.
FIXED = 64 << 20

#: Bytes of the floats of bombs.
FLOATS = 192 << 20


def spz_bomb(version: int, degree: int, floats: int) -> bytes:
    """An `.spz` of identical Gaussians."""
    count = floats // float_bytes(1, degree)
    sizes = [9, 1, 3, 3, 3 if version < 3 else 4, 3 * SH_COEFFICIENTS[degree]]
    return foreign.spz_file([bytes(size * count) for size in sizes], count, version, degree)


def webp(height: int, width: int) -> bytes:
    pixels = np.zeros((height, width, 4), np.uint8)
    pixels[..., 3] = 252
    out = io.BytesIO()
    Image.fromarray(pixels, "RGBA").save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def sog_bomb(version: int, degree: int, floats: int) -> bytes:
    """The same as SOG, with a palette of maximum size."""
    count = floats // float_bytes(1, degree)
    meta, images = foreign.sog_parts(4, version, degree, seed=1, palette=1 << 16)
    if version == 2:
        meta["count"] = count
    else:
        meta["means"]["shape"][0] = count
    out, pixels = io.BytesIO(), webp(-(-count // 2048), 2048)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.json", json.dumps(meta))
        for name in images:
            palette = name == "shN_centroids.webp"
            data = webp(1 << 10, 64 * SH_COEFFICIENTS[degree]) if palette else pixels
            archive.writestr(name, data)
    return out.getvalue()


def rad_bomb(degree: int, floats: int) -> bytes:
    """A `.rad` of identical Gaussians in one chunk."""
    count = floats // float_bytes(1, degree)
    one = foreign.rad_values(1, degree, seed=1)
    values = {name: np.broadcast_to(rows, (len(rows), count)) for name, rows in one.items()}
    return foreign.rad_file([foreign.rad_chunk(values, dict.fromkeys(values, "f32"))])[""]


BOMBS = {
    "a.rad": lambda floats: rad_bomb(3, floats),
    "v3.spz": lambda floats: spz_bomb(3, 0, floats),
    "v4.spz": lambda floats: spz_bomb(4, 3, floats),
    "v2.sog": lambda floats: sog_bomb(2, 0, floats),
    "v1.sog": lambda floats: sog_bomb(1, 3, floats),
}

READ = """
import re, sys
from pathlib import Path
from gs_codec.files.scenes import read_scene

def peak_bytes():  # of this process alone: what it was forked from may have had more
    return 1024 * int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])

small, large, limit = sys.argv[1:]
read_scene(small)  # loads libraries
before = peak_bytes()
scene = read_scene(large, max_bytes=int(limit))
print(scene.float_bytes, peak_bytes() - before)
"""


@pytest.mark.thorough
@pytest.mark.parametrize("name", BOMBS)
def test_memory_of_foreign_formats_is_bounded(name, tmp_path):
    """Peak of a separate process, because Python does not count the memory of libraries."""
    small, large = tmp_path / f"small-{name}", tmp_path / name
    small.write_bytes(BOMBS[name](1000))
    large.write_bytes(BOMBS[name](FLOATS))
    arguments = [sys.executable, "-c", READ, str(small), str(large), str(FLOATS)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    floats, peak = map(int, done.stdout.split())
    assert 0.99 * FLOATS < floats <= FLOATS
    assert peak <= TIMES_LIMIT * FLOATS + TIMES_FILE * large.stat().st_size + FIXED


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys) -> Folder:
    """A scene, and batches that run in this process."""
    (tmp_path / "in").mkdir()
    write_scene(tmp_path / "in/a.ply", random_scene(40, 0), Config())
    monkeypatch.setattr(run, "Pool", in_this_process)
    # The memory of this process serves as remote storage.
    monkeypatch.setattr(remote, "_OWN", "")
    monkeypatch.setattr(remote, "_OBJECTS", ("memory",))
    monkeypatch.chdir(tmp_path)
    return Folder(tmp_path, monkeypatch, capsys)


def one_of_each(target: Path) -> list[Path]:
    """A scene in each format, with more than 1000 bytes of floats."""
    scene = random_scene(40, 0)
    usd = ("a.usdc",) if is_available("pxr") else ()
    for name in ("a.ply", "a.egs", "a.splat", "a.pt", "a.ckpt", *usd):
        write_scene(target / name, scene, Config())
    (target / "packed.ply").write_bytes(foreign.ply_file(list(foreign.packed_rows(40, 0).items())))
    rows = foreign.ksplat_rows(40, 1, 0, seed=1)
    (target / "a.ksplat").write_bytes(
        foreign.ksplat_file(1, [(0, rows, 256, [40], np.zeros((1, 3)))])
    )
    for name, bomb in BOMBS.items():
        (target / name).write_bytes(bomb(4000))
    header, body = (target / "a.ply").read_bytes().split(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(40, -1)
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist()) + "\n"
    header = header.replace(b"binary_little_endian", b"ascii") + b"end_header\n"
    (target / "text.ply").write_bytes(header + text.encode())
    return sorted(target.iterdir())


@pytest.mark.slow
def test_every_format_respects_a_given_limit(tmp_path):
    for path in one_of_each(tmp_path):
        floats = read_scene(path).float_bytes
        assert floats > 1000
        assert read_scene(path, max_bytes=floats).float_bytes == floats
        with pytest.raises(gs_codec.GsCodecError, match=f"{floats:,} bytes.* {floats - 1:,}"):
            read_scene(path, max_bytes=floats - 1)


def test_extra_properties_count_where_they_are_kept(tmp_path):
    scene = replace(random_scene(40, 0), extra={"label": np.zeros(40, "<i4")})
    write_scene(tmp_path / "a.ply", scene, Config())
    floats = float_bytes(40, 0)
    assert read_scene(tmp_path / "a.ply", "drop", max_bytes=floats).count == 40
    with pytest.raises(InvalidInput, match=f"{floats + 160:,} bytes; at most {floats + 159:,} "):
        read_scene(tmp_path / "a.ply", "keep", max_bytes=floats + 159)


COMMANDS = (
    "encode in/a.ply out.egs",
    "convert in/a.ply out.ply",
    "prepare in/a.ply out.ply --prune-geometry 5",
    "compare in/a.ply in/a.ply",
    "compare in/a.ply in/a.ply --cameras auto",
    "render in/a.ply --cameras auto --out out",
    "analyze in/a.ply --out out",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_that_read_scenes_take_a_limit(command, folder: Folder):
    err = folder.refuse(*command.split(), "--max-bytes", "999")
    assert "at most 999 are read" in err
    assert_one_error_line(err)


def test_functions_that_read_scenes_take_a_limit(tmp_path):
    path = tmp_path / "a.ply"
    write_scene(path, random_scene(40, 0), Config())
    plan = gs_codec.Plan(gs_codec.Steps(rectify=7.5))
    for read, *others in ((gs_codec.read,), (gs_codec.render,), (gs_codec.prepare, plan)):
        with pytest.raises(InvalidInput, match="at most 999 are read"):
            read(path, *others, max_bytes=999)
    with pytest.raises(InvalidInput, match="has no effect on a cloud"):
        gs_codec.render(gs_codec.read(path), max_bytes=999)


def test_the_viewer_takes_a_limit(tmp_path):
    write_scene(tmp_path / "a.ply", random_scene(40, 0), Config())
    with pytest.raises(InvalidInput, match="at most 999 are read"):
        Request(tmp_path / "a.ply", max_bytes=999).scenes()


def test_headers_state_at_least_what_is_read(tmp_path):
    for path in one_of_each(tmp_path):
        assert stated_bytes(path) >= read_scene(path).float_bytes


def test_a_batch_is_planned_from_headers(tmp_path):
    floats = 1 << 25
    (tmp_path / "a.spz").write_bytes(spz_bomb(4, 0, floats))
    (tmp_path / "b.sog").write_bytes(sog_bomb(2, 0, floats))
    (tmp_path / "c.spz").write_bytes(b"no scene")
    storages = storage_of(str(tmp_path)), storage_of("out")
    tasks = find_tasks("in", *storages, Options(Config()), "")
    assert needed_memory.needed_bytes(floats) - tasks[0].need < 1000
    assert needed_memory.needed_bytes(floats) - tasks[1].need < 1000
    assert tasks[2].need < needed_memory.needed_bytes(1000)
    limited = find_tasks("in", *storages, Options(Config(), max_bytes=1000), "")
    assert max(task.need for task in limited) == needed_memory.needed_bytes(1000)


def test_a_batch_refuses_scenes_above_its_limit(folder: Folder):
    assert folder.run("batch", "in/a.ply", "out", "--max-bytes", "999").status == 1
    report = json.loads(Path("out/report.jsonl").read_text())
    assert "at most 999 are read" in report["error"]["text"]


def test_a_batch_limits_decompression_of_remote_files(folder: Folder):
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    bomb = spz_bomb(4, 0, 2 * needed_memory.most_floats(0, "a.spz"))
    storage_of("memory://")._fs.pipe_file("/bombs/a.spz", bomb)
    assert folder.run("batch", "memory://bombs/a.spz", "out").status == 1
    report = json.loads(Path("out/report.jsonl").read_text())
    assert "are read from a file of" in report["error"]["text"]
