"""Profiles l, m and s: decoded values, parts of scenes, and damaged files."""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from damage import BLOCK_SIZE, COUNT, survive, with_checksums, with_section
from lattices import Shaped, assert_on_lattices
from scenes import (
    DAMAGE,
    assert_same_floats,
    edge_scenes,
    encode_by,
    made_up_guide,
    made_up_sensitivity,
    random_scene,
    steps_for,
)

from gs_codec.codecs import decode_part, decode_scene, encode_scene
from gs_codec.codecs.adaptive.contexts import passes
from gs_codec.codecs.adaptive.encode import code_shaped, shape_scene
from gs_codec.codecs.adaptive.lattice import PositionGrid, from_grid
from gs_codec.codecs.adaptive.section import RULES, UNITS, encode_marks, read_lattice
from gs_codec.codecs.adaptive.step_sizes import MAX_SLOPE, Sensitivity, StepSizes
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.coding.clean import identity_for_zero
from gs_codec.coding.frequency_table import encode_tables
from gs_codec.config import ADAPTIVE_PROFILES, PROFILES, Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.errors import CorruptStream, GsCodecError, InvalidInput, TruncatedStream
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import compare_files
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.report import StageTimes
from gs_codec.scene import GROUPS, Scene

EDGES = edge_scenes()
BLOCK = 1024


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
@pytest.mark.parametrize("name", EDGES)
def test_edge_scene_is_on_its_lattices(name, profile):
    data, report = encode_scene(EDGES[name], Config(profile))
    assert report.file_bytes == len(data)
    assert_on_lattices(Shaped.of(EDGES[name], profile), data, 1.5001)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", EDGES)
def test_guided_edge_scene_is_on_its_lattices(name):
    guide = made_up_guide(seed=30)
    data = encode_by(EDGES[name], Config("m"), guide)
    assert_on_lattices(Shaped.of(EDGES[name], "m", guide), data, 0.5001)


def test_spherical_gaussians_have_no_rotation():
    scene = random_scene(3000, 0, seed=5)
    turned = replace(scene, log_scale=np.repeat(scene.log_scale[:1], 3, axis=0))
    unturned = replace(turned, rot=np.eye(4, dtype=np.float32)[:, :1].repeat(3000, axis=1))
    data, _ = encode_scene(turned, Config("m"))
    assert data == encode_scene(unturned, Config("m"))[0]
    assert_same_floats(decode_scene(data), decode_scene(encode_scene(unturned, Config("m"))[0]))
    assert not decode_scene(data).rot[1:].any()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_blocks_and_degrees_are_on_their_lattices(profile, sh_degree, guided):
    scene = random_scene(2500, sh_degree, seed=sh_degree)
    guide = made_up_guide(seed=31) if guided else None
    data = encode_by(scene, Config(profile, block_size=BLOCK), guide)
    assert read_file(data).header.block_count == 3
    assert_on_lattices(Shaped.of(scene, profile, guide), data, 0.5001 if guided else 1.5001)


def test_profiles_are_finer_or_smaller():
    scene = random_scene(2000, 3, seed=32)
    coded = {profile: encode_scene(scene, Config(profile))[0] for profile in "lms"}
    assert len(coded["l"]) > len(coded["m"]) > len(coded["s"])


def test_steps_of_more_visible_gaussians_are_finer():
    scene = random_scene(2000, 0, seed=33)
    scene = replace(scene, opacity=np.abs(scene.opacity))
    seen = np.random.default_rng(33).random(scene.count) < 0.5

    def guide(clean: Scene, config: Config) -> StepSizes:
        even = made_up_sensitivity(clean, seed=33, spread=0.0)
        higher = [np.where(seen, 4.0**4 * values, values) for values in even]
        return steps_for(clean, config, Sensitivity(*higher))

    shaped = Shaped.of(scene, "m", guide)
    is_seen = seen[np.argsort(shaped_order(scene, shaped))]
    finest = shaped.arranged.classes[:, is_seen]
    coarsest = shaped.arranged.classes[:, ~is_seen]
    assert np.all(coarsest.mean(axis=1) - finest.mean(axis=1) > 3)
    decoded = decode_scene(encode_by(scene, Config("m"), guide))
    for group in ("positions", "opacity", "f_dc"):
        error = np.abs(getattr(decoded, group) - getattr(shaped.scene, group))
        rms = [np.sqrt(np.mean(error[:, part] ** 2)) for part in (is_seen, ~is_seen)]
        assert rms[0] < 0.25 * rms[1], group


def test_steps_are_coarser_after_a_larger_pruning_loss():
    scene, config = random_scene(1000, 1, seed=51), Config("m")
    sensitivity = made_up_sensitivity(scene, seed=51)
    sizes = []
    for loss in (0.0, 1e-4, 1e-2):
        steps = steps_for(scene, config, sensitivity, loss)
        sizes.append(encode_scene(scene, config, steps=steps)[1].file_bytes)
    assert sizes[0] > sizes[1] > sizes[2]


def shaped_order(scene: Scene, shaped: Shaped) -> np.ndarray:
    """Stream position of each Gaussian, identified by its opacity."""
    places = {value: i for i, value in enumerate(shaped.scene.opacity[0].tolist())}
    assert len(places) == scene.count
    return np.array([places[value] for value in scene.opacity[0].tolist()])


def test_a_shaped_scene_decodes_as_predicted_with_given_colours():
    scene, config = random_scene(300, 2, seed=34), Config("m")
    shaped = shape_scene(scene, config, made_up_guide(seed=34)(scene, config), StageTimes())
    told, steps = shaped.decoded(), shaped.sh_steps()
    np.testing.assert_array_equal(told.f_dc, scene.f_dc[:, shaped.order])
    np.testing.assert_array_equal(told.f_rest, scene.f_rest[:, shaped.order])
    assert steps.shape == (3, 300)
    assert steps.dtype == np.float32
    assert np.all(steps > 0)
    plain, _ = code_shaped(shaped, StageTimes())
    assert b"".join(plain) == encode_by(scene, config, made_up_guide(seed=34))
    black = replace(told, f_dc=np.zeros_like(told.f_dc), f_rest=0 * told.f_rest)
    parts, report = code_shaped(shaped.with_colours(black), StageTimes())
    decoded = decode_scene(b"".join(parts))
    assert report.count == 300
    assert not decoded.f_dc.any()
    assert not decoded.f_rest.any()
    for group in ("positions", "opacity", "log_scale", "rot"):
        np.testing.assert_array_equal(getattr(told, group), getattr(decoded, group))


def test_steps_for_a_different_number_of_gaussians_are_refused():
    scene, config = random_scene(50, 0, seed=39), Config("m")
    steps = made_up_guide(seed=39)(scene, config)
    with pytest.raises(ValueError, match="steps of 50 Gaussians, expected 49"):
        encode_scene(scene.take(np.arange(49)), config, steps=steps)


def test_a_guide_that_sees_nothing_gives_finite_scenes():
    def guide(clean: Scene, config: Config) -> StepSizes:
        even = made_up_sensitivity(clean, seed=35)
        return steps_for(clean, config, Sensitivity(*(0 * values for values in even)))

    scene = random_scene(500, 1, seed=35)
    data = encode_by(scene, Config("s"), guide)
    assert_on_lattices(Shaped.of(scene, "s", guide), data, 0.5001)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
def test_bytes_and_floats_do_not_depend_on_threads(guided):
    scene = random_scene(5000, 3, seed=36)
    guide = made_up_guide(seed=36) if guided else None
    coded = [
        encode_by(scene, Config("m", threads=t, block_size=BLOCK), guide) for t in (1, 2, 7, 7)
    ]
    assert len(set(coded)) == 1
    decoded = [decode_scene(coded[0], threads=t) for t in (1, 2, 7)]
    assert_same_floats(decoded[0], decoded[1])
    assert_same_floats(decoded[0], decoded[2])


def test_order_of_the_input_does_not_matter():
    scene = random_scene(3000, 1, seed=37)
    shuffled = scene.take(np.random.default_rng(37).permutation(scene.count))
    assert encode_scene(scene, Config("m"))[0] == encode_scene(shuffled, Config("m"))[0]


def test_no_argument_is_changed():
    scene = random_scene(1000, 3, seed=38)
    scene.rot[:, 0] = 0
    before = {group: getattr(scene, group).copy() for group in GROUPS}
    steps = made_up_guide(seed=38)(identity_for_zero(scene)[0], Config("m"))
    _, report = encode_scene(scene, Config("m"), steps=steps)
    assert report.zero_quaternions == 1
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(scene, group), before[group])


def test_extra_properties_stay_with_their_gaussians():
    scene = random_scene(1500, 0, seed=39)
    scene = replace(
        scene, extra={"label": np.arange(1500, dtype="<i4")}, comments=("a", ""), has_normals=True
    )
    data, _ = encode_scene(scene, Config("l", extra="keep", block_size=BLOCK))
    decoded = decode_scene(data)
    assert (decoded.comments, decoded.has_normals) == (scene.comments, True)
    error = np.abs(decoded.opacity[0] - scene.opacity[0, decoded.extra["label"]])
    assert error.max() < 0.1
    box = (-1.0, -1.0, -1.0, 0.5, 1.0, 1.0)
    part, _ = decode_part(data, Part(box))
    inside = Part(box).contains(decoded.positions)
    assert 0 < part.count < 1500
    np.testing.assert_array_equal(part.extra["label"], decoded.extra["label"][inside])


# Files


@pytest.mark.parametrize("second", ["scene.egs", "decoded.ply"])
def test_a_file_is_matched_with_its_original(tmp_path, monkeypatch, second):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", random_scene(1500, 3, seed=42))
    encode_file("scene.ply", "scene.egs", Config("m"))
    decode_file("scene.egs", "decoded.ply")
    for pair in (("scene.ply", second), (second, "scene.ply")):
        result = compare_files(*pair)
        assert (result.counts, result.matched_by) == ((1500, 1500), "stored order")
        errors = {(group.name, group.unit): group.rms for group in result.groups}
        assert 0 < errors["positions", "scene units"] < 0.01
        assert 0 < errors["opacity", "0-1"] < 0.005
        assert 0 < errors["f_dc", "SH"] < 0.25
        assert 0 < errors["scaling", "log"] < 0.25
    assert compare_files("scene.egs", "decoded.ply").matched_by == "index"


def test_duplicates_are_matched_with_their_originals(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", EDGES["pairs"])
    encode_file("scene.ply", "scene.egs", Config("l"))
    errors = {g.name: g.rms for g in compare_files("scene.ply", "scene.egs").groups}
    assert errors["positions"] < 0.01
    assert errors["f_dc"] < 0.25


def test_unrelated_scenes_are_not_matched(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", random_scene(1500, 0, seed=43))
    write_ply("other.ply", random_scene(1500, 0, seed=44))
    encode_file("scene.ply", "scene.egs", Config("m"))
    with pytest.raises(InvalidInput, match="Gaussians of the scenes do not match"):
        compare_files("other.ply", "scene.egs")


def test_decoded_file_can_be_encoded_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", random_scene(1500, 1, seed=45))
    encode_file("scene.ply", "once.egs", Config("m"))
    decode_file("once.egs", "once.ply")
    encode_file("once.ply", "twice.egs", Config("m"))
    decode_file("twice.egs", "twice.ply")
    once, twice = read_ply("once.ply"), read_ply("twice.ply")
    assert [len(scene.comments) for scene in (once, twice)] == [1, 2]
    assert once.comments == twice.comments[:1]
    assert twice.count == 1500


# Damage


@cache
def small(guided: bool) -> bytes:
    scene = random_scene(20, 1, seed=46)
    return encode_by(scene, Config("m"), made_up_guide(seed=46) if guided else None)


@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
def test_every_truncation_is_refused(guided):
    stream = small(guided)
    for size in range(len(stream)):
        with pytest.raises((TruncatedStream, CorruptStream)):
            decode_scene(stream[:size])
        with pytest.raises((TruncatedStream, CorruptStream)):
            inspect_bytes(stream[:size])


@pytest.mark.thorough
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
def test_every_flipped_bit_is_refused(guided):
    damaged = bytearray(small(guided))
    for bit in range(8 * len(damaged)):
        damaged[bit >> 3] ^= 1 << (bit & 7)
        with pytest.raises(GsCodecError):
            decode_scene(bytes(damaged), threads=1)
        damaged[bit >> 3] ^= 1 << (bit & 7)


@pytest.mark.thorough
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
def test_flipped_bits_with_correct_checksums_do_not_crash(guided):
    stream = small(guided)
    for bit in range(int(guided), 8 * len(stream), 9):  # one bit per byte: all take a minute
        damaged = bytearray(stream)
        damaged[bit >> 3] ^= 1 << (bit & 7)
        survive(with_checksums(damaged))


@cache
def damageable(seed: int) -> bytes:
    rng = np.random.default_rng(seed)
    scene = random_scene(int(rng.integers(1, 2500)), int(rng.integers(0, 4)), seed)
    guide = made_up_guide(seed) if seed % 2 else None
    return encode_by(scene, Config("lms"[seed % 3], block_size=BLOCK), guide)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("seed", range(60))
def test_random_changes_with_correct_checksums_do_not_crash(seed):
    rng = np.random.default_rng(seed)
    data = bytearray(damageable(seed % 12))
    for _ in range(rng.integers(1, 6)):
        end = min(len(data), 2000) if rng.random() < 0.5 else len(data)
        data[rng.integers(36, end)] = rng.integers(256)
    survive(with_checksums(data))
    try:
        decode_part(with_checksums(data), Part((-1.0, -1, -1, 0, 0, 0), 1), max_bytes=1 << 20)
    except GsCodecError:
        return


def patched(data: bytes, offset: int, layout: str, *values) -> bytes:
    """The file with fields of its lattice section replaced."""

    def change(content: bytes) -> bytes:
        changed = bytearray(content)
        struct.pack_into("<" + layout, changed, offset, *values)
        return bytes(changed)

    return with_section(data, SectionId.LATTICE, change)


UNIT, RULE = 29, 57
MARKS = RULE + len(RULES) * 21
TABLES = MARKS + 2
HOSTILE = {
    "origin NaN": (0, "f", np.nan),
    "origin infinite": (8, "f", np.inf),
    "step 0": (12, "f", 0.0),
    "step negative": (12, "f", -1.0),
    "step NaN": (12, "f", np.nan),
    "step infinite": (12, "f", np.inf),
    "22 bits": (17, "B", 22),
    "255 bits": (16, "3B", 255, 255, 255),
    "0 classes": (19, "B", 0),
    "17 classes": (19, "B", 17),
    "17 classes of colour": (20, "B", 17),
    "centre too high": (21, "i", 401 << 20),
    "centre too low": (25, "i", -(1 << 31)),
    **{f"unit of {name} 0": (UNIT + 4 * i, "I", 0) for i, name in enumerate(UNITS)},
    **{f"unit of {name} huge": (UNIT + 4 * i, "I", 2**32 - 1) for i, name in enumerate(UNITS)},
    **{f"slope {i} of 2^22": (RULE + 21 + 4 * i, "i", 1 << 22) for i in range(1, 5)},
    **{f"slope {i} of -2^22": (RULE + 21 + 4 * i, "i", -1 << 22) for i in range(1, 5)},
    **{f"limit {i} of 255": (RULE + 21 * i + 20, "B", 255) for i in range(len(RULES))},
    "limit of positions 94": (RULE + 21 * RULES.index("position") + 20, "B", 94),
    "no marks": (MARKS, "H", 0),
    "65535 bytes of marks": (MARKS, "H", 65535),
    "other marks": (TABLES + 2, "2B", 0xAA, 0x55),
    "no tables": (TABLES, "H", 0),
    "65535 tables": (TABLES, "H", 65535),
}


@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_lattice_is_refused(name, guided):
    data = patched(small(guided), *HOSTILE[name])
    for read in (decode_scene, inspect_bytes):
        with pytest.raises((CorruptStream, TruncatedStream), match=r"section 'lattice'") as error:
            read(data)
        assert "\n" not in str(error.value)


def test_offsets_used_by_the_hostile_lattice_test_are_correct():
    """Otherwise the test above would test something else."""
    content = read_file(small(False)).section(SectionId.LATTICE)
    lattice, models = read_lattice(content, 3)
    assert struct.unpack_from("<7I", content, UNIT) == tuple(lattice.units[u] for u in UNITS)
    assert content[RULE + 20] == lattice.rules["opacity"].limit
    size, number = struct.unpack_from("<2H", content, MARKS)
    assert number == len(models.weights)
    assert content[TABLES + 2 + size] == len(models.weights[0])


@pytest.mark.parametrize("seed", range(8))
def test_hostile_rules_do_not_crash_seed(seed):
    """Any numbers are valid rules; they can only make the stream corrupt."""
    rng = np.random.default_rng(seed)
    for rule in range(len(RULES)):
        numbers = rng.choice([-(2**31), 2**31 - 1, 0, -1, 1 << 16, -(1 << 20)], 5)
        numbers[1:] = np.clip(numbers[1:], -MAX_SLOPE, MAX_SLOPE)
        survive(patched(small(bool(seed % 2)), RULE + 21 * rule, "5i", *numbers))


def test_far_grid_gives_finite_positions():
    survive(patched(small(False), 0, "4f", 3e38, -3e38, 3e38, 3e38))
    grid = PositionGrid((3e38, -3e38, 3e38), 3e38, (21, 21, 21))
    assert np.isfinite(from_grid(np.array([[0, 1 << 22]] * 3), grid)).all()


def test_table_without_symbols_is_refused():
    def change(content: bytes) -> bytes:
        size, number = struct.unpack_from("<2H", content, MARKS)
        end = TABLES + 2 + size + number
        weights = [np.zeros(alphabet, np.int64) for alphabet in content[end - number : end]]
        return content[:end] + encode_tables(weights, [3] * number)

    with pytest.raises(CorruptStream, match="section 'lattice': a table without symbols"):
        decode_scene(with_section(small(False), SectionId.LATTICE, change))


@pytest.mark.parametrize("alphabet", [0, 241, 255])
def test_alphabets_out_of_range_are_refused(alphabet):
    def change(content: bytes) -> bytes:
        changed = bytearray(content)
        changed[TABLES + 2 + struct.unpack_from("<H", content, MARKS)[0]] = alphabet
        return bytes(changed)

    with pytest.raises(CorruptStream, match="section 'lattice': an alphabet out of range"):
        decode_scene(with_section(small(False), SectionId.LATTICE, change))


def test_lists_of_too_many_tables_are_refused():
    def change(content: bytes) -> bytes:
        size = struct.unpack_from("<H", content, MARKS)[0]
        lists = [item.contexts for one in passes(3) for item in one.lists]
        marks = encode_marks([np.ones(contexts - 1, np.int64) for contexts in lists])
        start = struct.pack("<2H", len(marks), sum(lists)) + marks
        return content[:MARKS] + start + content[TABLES + 2 + size :]

    with pytest.raises(CorruptStream, match="section 'lattice': more than 64 tables of 'opacity'"):
        decode_scene(with_section(small(False), SectionId.LATTICE, change))


@pytest.mark.parametrize(
    ("section_id", "change"),
    [
        (SectionId.LATTICE, lambda content: None),
        (SectionId.LATTICE, lambda content: content + b"\1"),
        (SectionId.CHANNELS, lambda content: b"channels"),
        (SectionId.CLASSES, lambda content: None),
        (SectionId.CLASSES, lambda content: b"\0\0"),
        (SectionId.OPACITY, lambda content: b"\xff\xff\xff\xff" + content[4:]),
        (SectionId.OPACITY, lambda content: content + b"\0"),
        (SectionId.ROTATION, lambda content: content[:-1]),
        (SectionId.LOW_BITS, lambda content: content + b"\0"),
        (SectionId.LOW_BITS, lambda content: content[:-1]),
        (SectionId.SH2, lambda content: b"\0\0\0\0"),
        (SectionId.SH1, lambda content: b""),
        (SectionId.STATES, lambda content: content[:-4]),
        (SectionId.STATES, lambda content: b"\0" * 128),
        (SectionId.GEOMETRY, lambda content: content + b"\0"),
    ],
)  # fmt: skip
def test_wrong_sections_are_refused(section_id, change):
    with pytest.raises((CorruptStream, TruncatedStream)):
        decode_scene(with_section(small(False), section_id, change))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("section_id", [SectionId.LATTICE, SectionId.CLASSES, SectionId.LOW_BITS])
def test_paper_profiles_have_no_lattices(profile, section_id):
    data, _ = encode_scene(random_scene(20, 0, seed=47), Config(profile))
    with pytest.raises(CorruptStream):
        decode_scene(with_section(data, section_id, lambda content: b"\0" * 24))


@pytest.mark.parametrize("profile", [*ADAPTIVE_PROFILES, *PROFILES])
@pytest.mark.parametrize("count", [1 << 14, 1 << 40, (1 << 64) - 1])
def test_a_false_count_does_not_allocate(profile, count):
    """With blocks of one Gaussian, so that the count would be consistent."""
    stream = encode_scene(random_scene(20, 1, seed=48), Config(profile))[0]
    data = bytearray(stream)
    struct.pack_into("<Q", data, COUNT, count)
    struct.pack_into("<I", data, BLOCK_SIZE, 1)
    with pytest.raises(GsCodecError):
        decode_scene(with_checksums(data))
    with pytest.raises(GsCodecError):
        decode_part(with_checksums(data), Part((0.0, 0, 0, 1, 1, 1)))


def test_decoder_refuses_scenes_above_the_size_limit():
    with pytest.raises(CorruptStream, match="the limit is 1,000"):
        decode_scene(small(False), max_bytes=1000)


@pytest.mark.parametrize(("group", "value"), DAMAGE)
def test_nonfinite_values_are_refused_or_dropped(group, value):
    scene = random_scene(50, 3, seed=49)
    getattr(scene, group)[0, [3, 17]] = value
    with pytest.raises(InvalidInput, match=f"2 in {group}"):
        encode_scene(scene, Config("m"))
    data, report = encode_scene(scene, Config("m", nonfinite="drop"))
    assert report.dropped == 2
    kept = scene.take(np.delete(np.arange(50), [3, 17]))
    assert_on_lattices(Shaped.of(kept, "m"), data, 1.5001)


def test_progress_reaches_the_total_of_every_stage():
    seen = {}

    def progress(stage, done, total):
        assert done == seen.get(stage, (0, total))[0] + 1
        seen[stage] = (done, total)

    scene = random_scene(3000, 1, seed=50)
    data, _ = encode_scene(scene, Config("m", block_size=BLOCK), progress)
    decode_scene(data, progress=progress)
    assert seen == {"quantise": (3, 3), "code": (3, 3), "decode": (3, 3)}
