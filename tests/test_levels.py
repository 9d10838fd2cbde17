"""Levels of detail: tree, merging, errors, selection, and damaged levels."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import reference_decoder
from damage import REFUSALS, flipped, with_checksums, with_section
from level_files import (
    AWAY,
    BLOCK,
    FAR,
    NEAR,
    NO_LEVELS,
    camera,
    encoded,
    errors_changed,
    in_level,
    sample,
)
from scenes import (
    SmallBlocks,
    antialiased,
    assert_same_floats,
    edge_scenes,
    random_scene,
    with_threads,
)

from gs_codec.cameras.camera_files import write_cameras
from gs_codec.codecs import decode_part, decode_scene, encode_parts
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import verify_file
from gs_codec.config import ADAPTIVE_PROFILES, PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.egs.index import errors_of, levels_of, open_level
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.preparing import prepare_file
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.levels.building import build_levels
from gs_codec.levels.quarter import Clusters, merge_group
from gs_codec.merging.pairs import blobs_of
from gs_codec.metrics.views import compare_views
from gs_codec.plan import Plan, Steps
from gs_codec.scene import GROUPS, Scene

#: Numbers of Gaussians: none, less than a block, full blocks and groups, and one more.
COUNTS = (0, 1, 7, 8, 9, 32, 33, 128, 129, 136, 513)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("count", COUNTS)
def test_levels_have_a_quarter_rounded_up_until_one_block_is_left(count):
    data = encoded(random_scene(count, 0, seed=331))
    file = read_file(data)
    block, expected = file.header.block_size, []
    while count > block:
        count = -(-count // 4)
        expected.append(count)
    assert levels_of(file) == list(range(1, len(expected) + 1))
    for level, number in enumerate(expected, 1):
        assert decode_part(data, Part(level=level))[0].count == number
        assert open_level(file, level).header.block_count == -(-number // block)
    assert file.data[10:12] == (b"\1\0" if expected else b"\0\0")


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_reference_decoder_agrees(profile):
    data = sample(300, 2, profile)
    found = reference_decoder.decode(data)["levels"]
    assert len(found) == 3
    for level, values in enumerate(found, 1):
        scene = decode_part(data, Part(level=level))[0]
        for name, row in (("x", scene.positions[0]), ("f_rest_5", scene.f_rest[5])):
            np.testing.assert_array_equal(values["values"][name].view("u4"), row.view("u4"))


def test_older_readers_skip_levels(monkeypatch):
    data = sample()
    expected = reference_decoder.decode_file(data)["values"]
    monkeypatch.setattr(reference_decoder, "KNOWN", range(1, 20))
    monkeypatch.setattr(reference_decoder, "LEVEL", None)
    found = reference_decoder.decode_file(data)["values"]
    assert all(np.array_equal(found[name], row, equal_nan=True) for name, row in expected.items())


def test_levels_do_not_change_the_coded_scene():
    scene = random_scene(300, 1, seed=330)
    data, file = sample(), read_file(sample())
    kept = [
        Section(SectionId(number), block, content)
        for (number, block), content in file.sections.items()
        if number != SectionId.LEVEL
    ]
    stripped = write_file(file.header, kept)
    assert stripped == encoded(scene, lod=False)
    assert_same_floats(decode_scene(data), decode_scene(stripped))


def test_extra_properties_are_those_of_the_scene():
    labels = np.arange(300, dtype="<i4")
    data = encoded(replace(random_scene(300, 1, seed=339), extra={"label": labels}))
    assert sorted(decode_scene(data).extra["label"]) == list(labels)
    assert not decode_part(data, Part(level=1))[0].extra


def test_levels_precede_the_blocks_coarsest_first():
    file = read_file(sample())
    assert list(file.table)[:5] == [(16, 0), (13, 0), (20, 3), (20, 2), (20, 1)]
    assert all(entry.position % 4 == 0 for entry in file.table.values())


@pytest.mark.thorough
def test_threads_do_not_change_the_bytes():
    scene = random_scene(6000, 1, seed=332)
    files = {with_threads(n, encoded, scene, "m", 500) for n in (1, 2, 3)}
    assert len(files) == 1


@pytest.mark.thorough
@pytest.mark.parametrize("name", edge_scenes())
def test_extreme_scenes_have_levels(name):
    scene = edge_scenes()[name]
    data = encoded(scene)
    for level in levels_of(read_file(data)):
        merged = decode_part(data, Part(level=level))[0]
        assert all(np.isfinite(getattr(merged, group)).all() for group in GROUPS)
    assert inspect_bytes(data).levels[:1] == () or inspect_bytes(data).levels[0].level == 1


def test_clusters_keep_mass_mean_and_covariance():
    scene = random_scene(200, 1, seed=333)
    scene = replace(scene, opacity=np.full((1, 200), -2.0, np.float32))
    into = merge_group(scene, 50)
    merged = Clusters(scene, into, 50).merged()
    before, after = blobs_of(scene), blobs_of(merged)
    assert np.bincount(into[into >= 0]).min() >= 1
    kept = after.opacity < 0.98
    for cluster in np.flatnonzero(kept):
        members = np.flatnonzero(into == cluster)
        mass = before.mass[members]
        share = mass / mass.sum()
        mean = share @ before.means[members]
        apart = before.means[members] - mean
        xx = share @ (before.covariances[members, 0] + apart[:, 0] ** 2)
        np.testing.assert_allclose(after.means[cluster], mean, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(after.covariances[cluster, 0], xx, rtol=1e-3)
        np.testing.assert_allclose(after.mass[cluster], mass.sum(), rtol=1e-3)
        rest = share @ scene.f_rest[3, members].astype(np.float64)
        np.testing.assert_allclose(merged.f_rest[3, cluster], rest, rtol=1e-3, atol=1e-5)


def test_levels_look_like_the_scene_from_afar():
    rng = np.random.default_rng(334)
    scene = random_scene(4000, 1, seed=334)
    spread = np.float32(rng.normal(-3.0, 0.3, (3, 4000)))
    scene = antialiased(replace(scene, log_scale=spread))
    for level in build_levels(scene, 1000):
        coarse = replace(level.scene, comments=scene.comments)
        # At this distance, the largest error is one pixel.
        far = camera(tuple(100.0 * float(level.errors.max()) * np.array([0.6, 0.3, -0.7])))
        quality = compare_views(scene, coarse, [far], device="cpu").views[0].between
        assert quality.psnr > 35


@pytest.mark.thorough
def test_errors_do_not_fall_from_level_to_level():
    found = reference_decoder.decode(encoded(random_scene(600, 0, seed=335)))["levels"]
    assert len(found) == 4
    assert all(error > 0 for level in found for error in level["errors"])
    for finer, coarser in zip(found, found[1:], strict=False):
        for block, error in enumerate(coarser["errors"]):
            assert error >= max(finer["errors"][4 * block : 4 * block + 4])


@pytest.mark.one_in(4)
@pytest.mark.parametrize("seed", range(12))
def test_selection_follows_the_format(seed):
    rng = np.random.default_rng(seed)
    data = sample(500)
    view = camera(tuple(rng.normal(size=3) * 10.0 ** rng.uniform(-1, 2)), 10.0 ** rng.uniform(1, 3))
    tolerance = float(rng.choice([0.0, 0.5, 1.0, 4.0, 30.0]))
    budget = int(rng.integers(8, 600)) if seed % 2 else None
    part = Part(view=view, tolerance=tolerance, budget=budget)
    expected = reference_decoder.select(data, view, tolerance, budget)
    scenes, header = [], read_file(data).header
    for level in range(len(levels_of(read_file(data))), -1, -1):
        whole = decode_part(data, Part(level=level))[0]
        for k, block in expected:
            if k == level:
                start = block * header.block_size
                scenes.append(whole.between(start, min(start + header.block_size, whole.count)))
    found = decode_part(data, part)[0]
    assert found.count == sum(scene.count for scene in scenes)
    assert budget is None or found.count <= budget
    for group in GROUPS:
        planes = [getattr(scene, group) for scene in scenes]
        if planes:
            np.testing.assert_array_equal(getattr(found, group), np.concatenate(planes, axis=1))


def test_tolerance_0_gives_the_blocks_of_the_scene_in_view():
    data = sample()
    seen = decode_part(data, Part(view=FAR, tolerance=0))[0]
    plain = encoded(random_scene(300, 1, seed=330), lod=False)
    assert_same_floats(seen, decode_part(plain, Part(view=FAR))[0])
    assert 0 < seen.count <= 300


def test_from_far_away_the_coarsest_level_is_enough():
    data = sample()
    seen, _ = decode_part(data, Part(view=AWAY))
    assert_same_floats(seen, decode_part(data, Part(level=3))[0])


def test_a_budget_is_spent_on_near_blocks():
    data = sample()
    counts = [decode_part(data, Part(view=NEAR, budget=n))[0].count for n in (8, 40, 120, 300)]
    assert counts == sorted(counts)
    assert all(count <= n for count, n in zip(counts, (8, 40, 120, 300), strict=True))
    assert counts[-1] > counts[0]


def test_without_levels_a_budget_takes_the_nearest_blocks():
    plain = encoded(random_scene(300, 1, seed=330), lod=False)
    every, some = (decode_part(plain, Part(view=FAR, budget=n))[0] for n in (300, 40))
    assert 0 < some.count <= 40 < every.count

    def nearest(scene: Scene) -> float:
        return float(np.linalg.norm(scene.positions.T - FAR.position, axis=1).min())

    assert nearest(some) <= nearest(every) + 0.5
    with pytest.raises(InvalidInput, match="budget 3"):
        decode_part(plain, Part(view=FAR, budget=3))


def test_a_tolerance_without_levels_is_refused():
    plain = encoded(random_scene(300, 1, seed=330), lod=False)
    said = "tolerance 4: has no effect without levels of detail"
    with pytest.raises(InvalidInput, match=said):
        decode_part(plain, Part(view=FAR, tolerance=4.0))


def test_a_view_without_blocks_is_empty():
    behind = replace(FAR, rotation=FAR.rotation * np.array([[-1], [1], [-1]]))
    assert decode_part(sample(), Part(view=behind))[0].count == 0


@pytest.mark.thorough
def test_sh_degree_combines_with_views_and_levels():
    data = sample(300, 2)
    assert decode_part(data, Part(sh_degree=1, level=2))[0].sh_degree == 1
    assert decode_part(data, Part(sh_degree=0, view=FAR, tolerance=30))[0].sh_degree == 0


def test_a_box_of_a_level():
    part = Part((-1.0, -1.0, -1.0, 1.0, 1.0, 1.0), level=1)
    found, whole = decode_part(sample(), part)[0], decode_part(sample(), Part(level=1))[0]
    assert_same_floats(found, whole.take(part.contains(whole.positions)))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"level": -1}, "level -1"),
        ({"budget": 5}, "budget 5: has no effect without a view"),
        ({"tolerance": 1.0}, "tolerance 1.0: has no effect"),
        ({"view": FAR, "budget": 0}, "budget 0"),
        ({"view": FAR, "tolerance": -1.0}, "tolerance -1.0"),
        ({"view": FAR, "tolerance": float("nan")}, "tolerance nan"),
        ({"view": FAR, "level": 1}, "level: cannot be combined with a view"),
        ({"view": FAR, "box": (0.0, 0, 0, 1, 1, 1)}, "box: cannot be combined with a view"),
    ],
)
def test_invalid_parts_are_refused(fields, message):
    with pytest.raises(InvalidInput, match=message):
        Part(**fields)


def test_missing_level_is_refused():
    with pytest.raises(InvalidInput, match="level 4: the file has levels 0 to 3"):
        decode_part(sample(), Part(level=4))


@pytest.mark.parametrize("profile", [p for p in PROFILE_CHOICES if p not in ADAPTIVE_PROFILES])
def test_other_profiles_have_no_levels(profile):
    with pytest.raises(InvalidInput, match="lod"):
        Config(profile, lod=True)


def test_other_formats_targets_and_memory_limits_go_without_levels(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(100, 0))
    with pytest.raises(InvalidInput, match="lod"):
        Config(format="spz", lod=True)
    for extra in ({"rate": {"ratio": 5}}, {"max_memory": 10**9}):
        with pytest.raises(InvalidInput, match="lod"):
            encode_file(tmp_path / "scene.ply", tmp_path / "a.egs", Config(lod=True), **extra)
    with pytest.raises(InvalidInput, match="lod"):
        convert_file(tmp_path / "scene.ply", tmp_path / "a.egs", Config(lod=True), max_memory=10**9)
    assert not (tmp_path / "a.egs").exists()


def test_guided_prepared_and_converted_files_have_levels(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(1500, 0))
    write_cameras(tmp_path / "cameras.json", [FAR, replace(NEAR, name="b")])
    plan = Plan(cameras=str(tmp_path / "cameras.json"))
    pruning, config = replace(plan, steps=Steps(prune=10)), Config(lod=True, block_size=1024)
    source, target = tmp_path / "scene.ply", tmp_path / "a.egs"
    for write, expected in (
        (lambda: encode_file(source, target, config, plan), 375),
        (lambda: encode_file(source, target, config, pruning, overwrite=True), 338),
        (lambda: prepare_file(source, target, pruning, config, overwrite=True), 338),
        (lambda: convert_file(source, target, config, overwrite=True), 375),
    ):
        write()
        assert decode_part(target.read_bytes(), Part(level=1))[0].count == expected


# Damage


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0])
def test_errors_out_of_range_are_refused(value):
    damaged = in_level(sample(), errors_changed(value))
    for part in (Part(level=1), Part(view=FAR)):
        with pytest.raises(CorruptStream, match="level 1: section 'errors'"):
            decode_part(damaged, part)
    with pytest.raises(ValueError, match="errors"):
        reference_decoder.decode(damaged)
    assert decode_scene(damaged).count == 300


def test_errors_below_those_of_the_level_before_are_refused(tmp_path):
    damaged = in_level(sample(), errors_changed(0.0), 2)
    with pytest.raises(CorruptStream, match="level 2: section 'errors': block 0"):
        decode_part(damaged, Part(view=FAR))
    (tmp_path / "a.egs").write_bytes(damaged)
    with pytest.raises(CorruptStream, match="level 2: section 'errors'"):
        verify_file(tmp_path / "a.egs")
    with pytest.raises(ValueError, match="errors"):
        reference_decoder.decode(damaged)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("change", NO_LEVELS)
def test_levels_of_another_file_are_refused(change, tmp_path):
    damaged = in_level(sample(), change)
    (tmp_path / "a.egs").write_bytes(damaged)
    with pytest.raises(REFUSALS, match="level 1: "):
        verify_file(tmp_path / "a.egs")
    with pytest.raises(REFUSALS, match="level 1: "):
        decode_part(damaged, Part(level=1))
    with pytest.raises((ValueError, IndexError, struct.error)):
        reference_decoder.decode(damaged)
    assert decode_scene(damaged).count == 300


def test_missing_and_surplus_levels_are_refused():
    for level in (1, 3):
        with pytest.raises(CorruptStream, match="2 levels, expected 3"):
            decode_scene(with_section(sample(), SectionId.LEVEL, lambda _: None, level))
    for level in (0, 4):
        with pytest.raises(CorruptStream, match="does not exist"):
            decode_scene(with_section(sample(), SectionId.LEVEL, lambda _: b"", level))


def test_misplaced_sections_of_levels_are_refused():
    errors = with_section(sample(), SectionId.ERRORS, lambda _: bytes(4))
    with pytest.raises(CorruptStream, match="section 'errors'"):
        decode_scene(errors)
    scene, config = random_scene(30, 1), SmallBlocks("paper-m", block_size=BLOCK)
    paper = b"".join(encode_parts(scene, config)[0])
    with pytest.raises(CorruptStream, match="section 'level'"):
        decode_scene(with_section(paper, SectionId.LEVEL, lambda _: b"", 1))


@pytest.mark.thorough
def test_damage_in_a_level_is_found_when_it_is_read(tmp_path):
    data, rng = sample(), np.random.default_rng(336)
    position, size, _ = read_file(data).table[SectionId.LEVEL, 1]
    for at in rng.choice(size, 25, replace=False):
        damaged = flipped(data, 8 * (position + int(at)) + int(rng.integers(8)))
        assert_same_floats(decode_scene(bytes(damaged)), decode_scene(data))
        (tmp_path / "a.egs").write_bytes(damaged)
        with pytest.raises(REFUSALS):
            verify_file(tmp_path / "a.egs")


def test_levels_are_read_without_checking_their_whole_section():
    """Like a reader that fetches some of its blocks."""
    data = sample()
    position, size, _ = read_file(data).table[SectionId.LEVEL, 1]
    last = position + size - 1
    damaged = bytes(flipped(data, 8 * last))
    far = Part((-9.0,) * 3 + (9.0,) * 3, level=3)
    assert_same_floats(decode_part(damaged, far)[0], decode_part(data, far)[0])


def test_truncated_files_are_refused():
    data = sample()
    position, size, _ = read_file(data).table[SectionId.LEVEL, 2]
    for end in (position, position + 30, position + size // 2, position + size):
        with pytest.raises(REFUSALS):
            decode_part(data[:end], Part(level=2))


# Files and commands


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("levels")
    write_ply(path / "scene.ply", random_scene(9000, 1, seed=337))
    encode_file(path / "scene.ply", path / "a.egs", Config(lod=True, block_size=1024))
    write_cameras(path / "cameras.json", [FAR, replace(NEAR, name="b")])
    return path


def test_a_view_reads_only_its_bytes(folder):
    out = folder / "out.ply"
    seen = decode_file(folder / "a.egs", out, Part(view=AWAY))
    assert seen.bytes_read < 0.2 * seen.file_bytes
    assert read_ply(out).count == seen.count < 1000
    whole = decode_file(folder / "a.egs", out, Part(view=FAR, tolerance=0), overwrite=True)
    assert seen.bytes_read < whole.bytes_read < whole.file_bytes
    level = decode_file(folder / "a.egs", out, Part(level=1), overwrite=True)
    assert level.count == 2250
    assert level.bytes_read < 0.5 * level.file_bytes


@pytest.mark.thorough
def test_reports_have_levels(folder):
    info, report = inspect_bytes((folder / "a.egs").read_bytes()), verify_file(folder / "a.egs")
    assert [(one.level, one.count, one.blocks) for one in info.levels] == [
        (1, 2250, 3),
        (2, 563, 1),
    ]
    assert report.levels == 2
    [size] = [stream.bytes for stream in info.streams if stream.name == "level"]
    assert sum(one.bytes for one in info.levels) == size
    assert info.levels[0].largest_error <= info.levels[1].least_error
    encoded_report = encode_file(
        folder / "scene.ply", folder / "b.egs", Config(lod=True, block_size=1024)
    )
    assert encoded_report.section_bytes["level"] == size
    assert encoded_report.file_bytes == (folder / "b.egs").stat().st_size
    assert errors_of(open_level(read_file((folder / "a.egs").read_bytes()), 2)).shape == (1,)


def test_commands(folder, tmp_path, run_codec):
    source, cameras = folder / "a.egs", folder / "cameras.json"

    asked = ("--lod", "--block-size", "1024", "--json")
    status, text, _ = run_codec("encode", folder / "scene.ply", tmp_path / "a.egs", *asked)
    assert status == 0
    assert json.loads(text)["section_bytes"]["level"] > 0
    assert (tmp_path / "a.egs").read_bytes() == source.read_bytes()
    assert len(json.loads(run_codec("inspect", source, "--json")[1])["levels"]) == 2
    assert "largest error" in run_codec("inspect", source)[1]
    assert "2 coarser levels" in run_codec("verify", source)[1]

    def decoded(*options: str) -> int:
        status, text, err = run_codec(
            "decode", source, tmp_path / "out.ply", "--json", "--overwrite", *options
        )
        assert status == 0, err
        assert json.loads(text)["gaussians"] == read_ply(tmp_path / "out.ply").count
        return json.loads(text)["gaussians"]

    assert decoded("--level", "2") == 563
    seen = decoded("--view", f"{cameras}:b")
    assert decoded("--view", f"{cameras}:#1") == seen
    assert decoded("--view", f"{cameras}:b", "--tolerance", "0") >= seen
    assert decoded("--view", f"{cameras}:b", "--budget", "2000") <= 2000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--level", "3"], "level 3: the file has levels 0 to 2"),
        (["--budget", "5"], "budget 5: has no effect without a view"),
        (["--view", "CAMERAS"], "of 2 cameras, expected"),
        (["--view", "CAMERAS:c"], "matches none of 2 cameras, expected the name or number of one"),
        (
            ["--view", "CAMERAS:#2"],
            "#2: matches none of 2 cameras, expected the name or number of one",
        ),
        (["--view", "SAME:b"], "matches 2 of 2 cameras, expected the name or number of one"),
        (["--view", "none.json:c"], "none.json: no such file"),
        (["--view", "CAMERAS:b", "--level", "1"], "level: cannot be combined with a view"),
    ],
)
def test_commands_refuse(folder, tmp_path, options, message, run_codec):
    given, same = folder / "cameras.json", tmp_path / "same.json"
    same.write_text(given.read_text().replace(f'"{FAR.name}"', '"b"'))
    typed = [text.replace("CAMERAS", str(given)).replace("SAME", str(same)) for text in options]
    target = tmp_path / "out.ply"
    status, _, err = run_codec("decode", folder / "a.egs", target, *typed)
    assert status == 2
    assert message in err
    assert not target.exists()


def test_damaged_levels_are_one_line_and_status_2(folder, tmp_path, run_codec):
    data = (folder / "a.egs").read_bytes()
    damaged = in_level(data, errors_changed(float("nan")))
    (tmp_path / "a.egs").write_bytes(damaged)
    for verb in ("verify", "inspect"):
        status, _, err = run_codec(verb, tmp_path / "a.egs")
        assert status == 2
        assert err.count("\n") == 1
        assert "level 1: section 'errors'" in err
    assert with_checksums(data) == data
