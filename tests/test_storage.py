"""Scenes larger than memory: the same bytes, in hidden files, below a limit."""

from __future__ import annotations

import errno
import gc
import os
import tracemalloc
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import edge_scenes, random_scene, rich_scene

from gs_codec.codecs import encode_parts, encode_scene, memory_limit, slabs
from gs_codec.codecs.memory_limit import least_memory
from gs_codec.codecs.part import Part
from gs_codec.config import PROFILE_CHOICES, Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime import arrays as storage
from gs_codec.runtime.arrays import Disk, Memory, bounded, current, empty, using
from gs_codec.runtime.threads import run_all, using_threads
from samples.generate import generate

BLOCK = 1024


@pytest.fixture
def everything_on_disk(monkeypatch):
    monkeypatch.setattr(storage, "_LARGE", 0)
    monkeypatch.setattr(storage, "_SEGMENT", 5000)


@pytest.mark.one_in(3)
@pytest.mark.usefixtures("everything_on_disk")
@pytest.mark.parametrize(
    ("count", "degree"), [(0, 3), (1, 2), (5, 0), (3000, 0), (3000, 1), (3000, 2), (3000, 3)]
)
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_bytes_are_the_same_on_disk(profile, count, degree):
    config = Config(profile, extra="keep", block_size=BLOCK)
    scene = rich_scene(count, degree)
    whole, expected = encode_scene(scene, config)
    with using(Disk()):
        parts, report = encode_parts(scene, config)
    assert b"".join(parts) == whole
    assert replace(report, seconds={}) == replace(expected, seconds={})


@pytest.mark.one_in(3)
@pytest.mark.usefixtures("everything_on_disk")
@pytest.mark.parametrize("name", edge_scenes())
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_bytes_of_edge_scenes_are_the_same_on_disk(profile, name):
    scene = edge_scenes()[name]
    with using(Disk()):
        data, _ = encode_scene(scene, Config(profile))
    assert data == encode_scene(scene, Config(profile))[0]


@pytest.mark.usefixtures("everything_on_disk")
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_dropped_and_replaced_values_are_the_same_on_disk(profile):
    scene = random_scene(2000, 1, seed=62)
    scene.opacity[0, 5:50] = np.nan
    scene.rot[:, 100:110] = 0
    config = Config(profile, nonfinite="drop")
    with using(Disk()):
        data, report = encode_scene(scene, config)
    assert data == encode_scene(scene, config)[0]
    assert (report.dropped, report.count) == (45, 1955)
    assert report.zero_quaternions == (0 if profile == "lossless" else 10)


@pytest.mark.usefixtures("everything_on_disk")
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_files_are_the_same_with_constant_page_release(profile, tmp_path, monkeypatch):
    monkeypatch.setattr(memory_limit, "_check", lambda least, what: None)
    monkeypatch.setattr(memory_limit, "_FIXED", -(10**9))
    ply, whole, within = tmp_path / "scene.ply", tmp_path / "whole.egs", tmp_path / "within.egs"
    write_ply(ply, replace(generate(6000, 2, 1), extra=rich_scene(6000, 2).extra))
    config = Config(profile, extra="keep", block_size=BLOCK)
    expected = encode_file(ply, whole, config)
    found = encode_file(ply, within, config, max_memory=1)
    assert (found.rendered is None) == (profile == "lossless")
    assert replace(found, seconds={}) == replace(expected, seconds={})
    assert within.read_bytes() == whole.read_bytes()
    decode_file(whole, tmp_path / "whole.ply")
    decode_file(whole, tmp_path / "within.ply", max_memory=1)
    assert (tmp_path / "within.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert slabs.verify_file(within, max_memory=1).count == 6000


@pytest.mark.usefixtures("everything_on_disk")
@pytest.mark.parametrize("name", ["a.spz", "a.sog", "a.ssog"])
def test_other_formats_are_the_same_with_constant_page_release(name, tmp_path, monkeypatch):
    monkeypatch.setattr(memory_limit, "_check", lambda least, what: None)
    write_ply(tmp_path / "scene.ply", generate(6000, 1, 1))
    written = []
    for limit in (None, 1):
        folder = tmp_path / f"{limit}"
        folder.mkdir()
        found = convert_file(tmp_path / "scene.ply", folder / name, max_memory=limit)
        written.append(((folder / name).read_bytes(), found.rendered))
    assert written[0] == written[1]
    assert written[0][1] is not None


@pytest.mark.thorough
@pytest.mark.parametrize(
    "config",
    [Config("m"), Config("paper-m"), Config("lossless"), Config(format="sog")],
    ids=lambda config: f"{config.profile} {config.format}",
)
def test_encoding_on_disk_takes_little_memory_for_each_gaussian(config, tmp_path, monkeypatch):
    """Memory of Python and numpy, without mapped files."""
    monkeypatch.setattr(storage, "_LARGE", 1 << 14)
    count = 40_000
    write_ply(tmp_path / "scene.ply", random_scene(count, 3, seed=63))
    size = 2 * BLOCK if config.format == "egs" else config.block_size
    config = replace(config, block_size=size, threads=1)
    encode_parts(random_scene(100, 3), config)

    def encode() -> int:
        tracemalloc.start()
        try:
            encode_parts(read_ply(tmp_path / "scene.ply"), config)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    whole = encode()
    with using(Disk()):
        within = encode()
    assert whole > count * 4 * 59
    assert within < 0.6 * whole


@pytest.mark.thorough
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_decoding_keeps_only_some_slabs(profile, tmp_path, monkeypatch):
    monkeypatch.setattr(slabs, "_SLAB", 1)
    count = 40_000
    data, _ = encode_scene(random_scene(count, 3, seed=64), Config(profile, block_size=BLOCK))
    (tmp_path / "scene.egs").write_bytes(data)
    slabs.verify_file(tmp_path / "scene.egs", threads=1)
    tracemalloc.start()
    try:
        decode_file(tmp_path / "scene.egs", tmp_path / "scene.ply", threads=1)
        assert tracemalloc.get_traced_memory()[1] < 0.6 * count * 4 * 59
    finally:
        tracemalloc.stop()


def test_files_have_no_name_and_end_with_their_arrays(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    disk = Disk()
    array = disk.empty((3, 1 << 19), np.float32)
    kept = disk.keep(np.arange(10))
    assert list(tmp_path.iterdir()) == []
    maps = [known() for known in disk._maps]
    watched = [weakref.ref(mapped) for mapped in maps if mapped is not None]
    assert len(watched) == 2
    del maps
    array[:] = 7
    del array
    gc.collect()
    assert [ref() is None for ref in watched] == [True, False]
    del disk
    assert kept.tolist() == list(range(10))
    del kept
    gc.collect()
    assert watched[1]() is None


def test_released_pages_keep_their_content(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    disk = Disk()
    array = disk.empty((2, 1 << 18), np.float64)
    array[:] = np.arange(1 << 19).reshape(2, -1)
    kept = [disk.keep(np.full((7, n), n, np.uint16)) for n in range(50)]
    note = disk.keep_bytes(b"note")
    disk.release()
    assert np.array_equal(array.ravel(), np.arange(1 << 19))
    assert all((column == n).all() and column.shape == (7, n) for n, column in enumerate(kept))
    assert bytes(note) == b"note"
    assert disk.keep_bytes(b"") == b""
    assert all(column.ctypes.data % 64 == 0 for column in kept if column.size)


def test_full_disk_is_one_line(tmp_path, monkeypatch, run_codec):
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_ply(tmp_path / "scene.ply", random_scene(3000, 3))
    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr(storage, "_LARGE", 0)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    target = tmp_path / "scene.egs"
    arguments = ["encode", str(tmp_path / "scene.ply"), str(target), "--max-memory", "2GB"]
    status, out, err = run_codec(*arguments)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert f"{tmp_path}: No space left on device" in err
    assert "TMPDIR" in err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.ply"]


def test_threads_use_the_callers_storage():
    disk = Disk()
    with using(disk):
        assert all(found is disk for found in run_all(lambda _: current(), range(4), 2))
    assert type(current()) is Memory


def test_bounded_ends_with_its_block():
    with bounded(None):
        assert type(current()) is Memory
    with bounded(10**12):
        assert current().limit == 10**12
        assert empty((4,), np.uint8).shape == (4,)
    assert type(current()) is Memory
    with pytest.raises(KeyError), bounded(10**12):
        raise KeyError
    assert type(current()) is Memory


@pytest.fixture
def files(tmp_path) -> tuple[Path, Path]:
    source, target = tmp_path / "scene.ply", tmp_path / "scene.egs"
    write_ply(source, generate(500, 3, 1))
    encode_file(source, target)
    return source, target


@pytest.mark.parametrize("command", ["encode", "encode -p paper-m", "decode", "verify"])
def test_too_little_memory_is_refused_with_the_minimum(command, files, run_codec):
    source, coded = files
    command, *options = command.split()
    words = {
        "encode": (source, source.parent / "out.egs", "--overwrite"),
        "decode": (coded, source.parent / "out.ply", "--overwrite"),
        "verify": (coded,),
    }
    arguments = [command, *map(str, words[command]), *options, "--threads", "2"]
    status, out, err = run_codec(*arguments, "--max-memory", "100MB")
    assert (status, out) == (2, "")
    assert "max-memory: 100,000,000 bytes, " in err
    least = err.partition(" at least ")[2].partition(" ")[0].replace(",", "")
    status, _, err = run_codec(*arguments, "--max-memory", least)
    assert (status, err) == (0, "")
    status, _, err = run_codec(*arguments, "--max-memory", f"{int(least) - 1}B")
    assert status == 2
    assert not err.startswith("Traceback")


def test_too_little_memory_for_a_sog_is_refused(files):
    target = files[1].with_name("out.sog")
    with pytest.raises(InvalidInput, match="max-memory: 300,000,000 bytes, expected at least"):
        encode_file(files[0], target, max_memory=300_000_000)
    assert not target.exists()


def test_parts_of_streamed_sog_need_less_memory_than_one_sog(tmp_path, monkeypatch):
    needed = []
    monkeypatch.setattr(memory_limit, "_check", lambda least, what: needed.append(least))
    write_ply(tmp_path / "scene.ply", random_scene(40_000, 0, seed=65))
    for name in ("a.ssog", "a.sog"):
        size = 1024 if name == "a.ssog" else Config.block_size
        convert_file(tmp_path / "scene.ply", tmp_path / name, Config(block_size=size))
    streamed, whole = needed
    assert whole - streamed == 200 * (40_000 - 16 * 1024)


def test_an_invalid_size_is_refused(files, run_codec):
    for size in ("4 apples", "", "-1GB", "GB"):
        status, out, err = run_codec("verify", str(files[1]), f"--max-memory={size}")
        assert (status, out) == (2, "")
        assert f"--max-memory {size}: expected a size" in err


def test_views_and_targets_need_the_whole_scene(files):
    with pytest.raises(InvalidInput, match="max-memory: cannot be combined with"):
        encode_file(*files, rate=RateTarget(ratio=5), max_memory=10**10, overwrite=True)


def test_formats_read_as_a_whole_are_refused_within_a_limit(files):
    text = files[0].with_name("text.ply")
    header, _, body = files[0].read_bytes().partition(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(500, -1)
    lines = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    text.write_text(header.decode().replace("binary_little_endian", "ascii"))
    with text.open("a") as file:
        file.write(f"end_header\n{lines}\n")
    for source in (text, files[1].with_name("text.spz")):
        encode_file(files[0], source) if source.suffix == ".spz" else None
        with pytest.raises(InvalidInput, match=f"{source}: max-memory: only .egs and binary PLY"):
            encode_file(source, files[1].with_name("again.egs"), max_memory=10**10)


def test_extra_properties_inflate_to_their_stated_size(everything_on_disk, tmp_path):
    scene = rich_scene(700, 0)
    with using(Disk()):
        data, _ = encode_scene(scene, Config("lossless", extra="keep", keep_order=True))
    (tmp_path / "scene.egs").write_bytes(data)
    with slabs.opened_slabs(tmp_path / "scene.egs", Part()) as opened:
        (found,) = opened.scenes()
    for name, column in scene.extra.items():
        assert found.extra[name].tobytes() == column.tobytes()


def test_least_memory_grows_with_the_scene():
    for profile in PROFILE_CHOICES:
        with using_threads(2):
            few, many = (least_memory(n, Config(profile)) for n in (0, 20_000_000))
        assert 300_000_000 < few < many < 4_000_000_000
