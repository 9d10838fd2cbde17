"""Decoding slab by slab equals decoding at once; `verify` detects damage."""

from __future__ import annotations

import json
import os
import tracemalloc

import numpy as np
import pytest
from scenes import edge_scenes, random_scene, rich_scene

from gs_codec.cameras.camera import Camera
from gs_codec.codecs import decode_part, encode_parts, encode_scene, slabs
from gs_codec.codecs.decode import choose_part
from gs_codec.codecs.part import Part
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.errors import CorruptStream, GsCodecError
from gs_codec.files.decode_file import decode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.ply.writer import write_ply
from gs_codec.levels.adding import add_levels

BLOCK = 1024


@pytest.fixture(autouse=True)
def small_slabs(monkeypatch):
    monkeypatch.setattr(slabs, "_SLAB", 1)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("count", "degree"), [(0, 3), (1, 1), (5000, 3), (5000, 0)])
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_slabs_are_the_whole(profile, count, degree, tmp_path):
    config = Config(profile, extra="keep", block_size=BLOCK)
    data, _ = encode_scene(rich_scene(count, degree), config)
    (tmp_path / "scene.egs").write_bytes(data)
    with slabs.opened_slabs(tmp_path / "scene.egs", Part(), threads=1) as opened:
        found = [scene.count for scene in opened.scenes()]
    assert sum(found) == count
    assert len(found) == max(1, -(-count // (2 * BLOCK)))
    report = decode_file(tmp_path / "scene.egs", tmp_path / "slabs.ply", threads=1)
    write_ply(tmp_path / "whole.ply", read_scene(tmp_path / "scene.egs"))
    assert (tmp_path / "slabs.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert (report.count, report.sh_degree, report.bytes_read) == (count, degree, len(data))


@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_slabs_of_a_part_are_the_part(profile, tmp_path):
    part = Part((-1.0, -1.0, -1.0, 0.5, 0.5, 0.5), 1)
    data, _ = encode_scene(rich_scene(5000, 3), Config(profile, extra="keep", block_size=BLOCK))
    (tmp_path / "scene.egs").write_bytes(data)
    report = decode_file(tmp_path / "scene.egs", tmp_path / "slabs.ply", threads=1, part=part)
    whole, file = decode_part(data, part)
    write_ply(tmp_path / "whole.ply", whole)
    assert (tmp_path / "slabs.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert (report.count, report.bytes_read) == (whole.count, file.bytes_read)


@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
@pytest.mark.parametrize("name", ["identical", "one place", "five of degree 0"])
def test_scenes_with_few_coded_values(profile, name):
    scene = edge_scenes()[name]
    data, _ = encode_scene(scene, Config(profile))
    whole, _ = decode_part(data, Part())
    found = list(choose_part(data, Part()).slabs(300))
    assert sum(slab.count for slab in found) == scene.count
    for group in ("positions", "f_rest", "rot"):
        joined = np.concatenate([getattr(slab, group) for slab in found], axis=1)
        assert joined.tobytes() == getattr(whole, group).tobytes()


def test_progress_continues_from_slab_to_slab():
    data, _ = encode_scene(random_scene(5000, 1, seed=61), Config("m", block_size=BLOCK))
    seen: list[tuple[str, int, int]] = []
    list(choose_part(data, Part()).slabs(2 * BLOCK, lambda *state: seen.append(state)))
    assert [stage for stage, _, _ in seen] == ["decode"] * 5
    assert [done for _, done, _ in seen] == sorted(done for _, done, _ in seen)
    assert {total for _, _, total in seen} == {5000}
    assert seen[-1][1] == 5000


@pytest.fixture(params=["m", "paper-m", "lossless"])
def encoded(request, tmp_path):
    config = Config(request.param, extra="keep", block_size=BLOCK)
    path = tmp_path / "scene.egs"
    path.write_bytes(encode_scene(rich_scene(3000, 2), config)[0])
    return path


def test_verify_describes_a_valid_file(encoded, run_codec):
    before = encoded.read_bytes()
    status, out, err = run_codec("verify", str(encoded))
    assert (status, err) == (0, "")
    assert out.startswith(f"{encoded}: sound, ")
    assert "3,000 Gaussians, 3 blocks, SH degree 2" in out
    status, out, err = run_codec("verify", str(encoded), "--json")
    report = json.loads(out)
    assert (status, report["gaussians"], report["blocks"]) == (0, 3000, 3)
    assert report["sections"] == len(read_file(before).table)
    assert report["input_bytes"] == len(before)
    assert [p.name for p in encoded.parent.iterdir()] == ["scene.egs"]


def test_verify_finds_damage_in_every_section(encoded, run_codec):
    data = encoded.read_bytes()
    for position, size, _ in read_file(data).table.values():
        if size:
            changed = bytearray(data)
            changed[position + size // 2] ^= 0x10
            encoded.write_bytes(changed)
            status, out, err = run_codec("verify", str(encoded))
            assert (status, out) == (2, "")
            assert f"{encoded}: section " in err
            assert "checksum does not match" in err


def test_verify_decodes(encoded):
    """Not detected by checksums: a block whose bytes are intact but invalid."""
    file = read_file(encoded.read_bytes())
    sections = []
    for (i, block), content in file.sections.items():
        surplus = b"\0" if (i, block) == (SectionId.OPACITY, 2) else b""
        sections.append(Section(SectionId(i), block, bytes(content) + surplus))
    encoded.write_bytes(write_file(file.header, sections))
    with pytest.raises(CorruptStream, match="block 2"):
        slabs.verify_file(encoded)


def test_verify_checks_skipped_sections(tmp_path):
    data, _ = encode_scene(random_scene(10), Config())
    file = read_file(data)
    sections = [Section(SectionId(i), b, content) for (i, b), content in file.sections.items()]
    unknown = Section(999, 5, b"unknown", optional=True)  # type: ignore[arg-type]
    whole = bytearray(write_file(file.header, [*sections, unknown]))
    (tmp_path / "scene.egs").write_bytes(whole)
    assert slabs.verify_file(tmp_path / "scene.egs").sections == len(sections) + 1
    whole[-1] ^= 1
    (tmp_path / "scene.egs").write_bytes(whole)
    with pytest.raises(CorruptStream, match="section 999 of block 5"):
        slabs.verify_file(tmp_path / "scene.egs")


@pytest.fixture(scope="module")
def in_levels(tmp_path_factory):
    """A file of 300 kB, a quarter of it in coarser levels."""
    path = tmp_path_factory.mktemp("levels") / "scene.egs"
    config = Config("l", lod=True, block_size=BLOCK)
    parts = encode_parts(random_scene(8000, 3, seed=61), config)
    path.write_bytes(b"".join(add_levels(*parts, config)[0]))
    return path


SEEN = Camera("seen", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(3), np.array([0.0, 0.0, -9.0]))


@pytest.mark.parametrize(
    "part", [Part(), Part(level=1), Part(view=SEEN)], ids=["whole", "level", "view"]
)
def test_sections_of_a_file_are_checked_but_not_kept(part, in_levels):
    with slabs.opened_slabs(in_levels, part) as opened:  # sections that are parsed once
        list(opened.scenes())
    tracemalloc.start()
    try:
        with slabs.opened_slabs(in_levels, part) as opened:
            held = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert held < 0.2 * in_levels.stat().st_size


def _write_over(path):
    """Change a byte of the last section of a block."""
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    path.write_bytes(data)


def _write_over_unseen(path):
    """The same, within the resolution of the file's modification time."""
    status = path.stat()
    _write_over(path)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (_write_over, "was changed while it was read"),
        (_write_over_unseen, "section 10 of block 5: checksum does not match"),
        (lambda path: os.truncate(path, 500), "truncated while it was read: 500 bytes, expected"),
    ],
    ids=["written", "unseen", "truncated"],
)
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_a_file_changed_between_slabs_is_one_error(profile, change, text, tmp_path):
    path = tmp_path / "scene.egs"
    path.write_bytes(
        encode_scene(random_scene(5500, 3, seed=62), Config(profile, block_size=BLOCK))[0]
    )
    with slabs.opened_slabs(path, Part(), threads=1) as opened:
        scenes = opened.scenes()
        next(scenes)
        change(path)
        with pytest.raises(GsCodecError) as error:
            list(scenes)
    assert str(error.value).startswith(f"{path}: {text}")
