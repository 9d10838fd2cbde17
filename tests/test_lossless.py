"""Profile lossless: every bit is recovered, for any floats; damage is rejected."""

from __future__ import annotations

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from damage import COUNT, with_checksums, with_section
from reference_decoder import decode as reference_decode
from scenes import PATTERNS, REAL_SCENES, any_bits, edge_scenes, random_scene, shared_scene_path
from typer.testing import CliRunner

from gs_codec.cli.main import app
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.lossless.columns import from_ordered, read_integers, to_ordered, write_integers
from gs_codec.codecs.lossless.lossless import lossless_order
from gs_codec.config import Config
from gs_codec.egs.egs_file import SectionId
from gs_codec.errors import CorruptStream, GsCodecError, InvalidInput, TruncatedStream
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import compare_files, read_scene
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import GROUPS, Scene

LOSSLESS = Config("lossless", block_size=1024)
KEPT = replace(LOSSLESS, keep_order=True)


def unit_quaternions(count: int, seed: int) -> Scene:
    scene = random_scene(count, 0, seed)
    rot = scene.rot.astype(np.float64)
    rot[0] = np.abs(rot[0])
    return replace(scene, rot=(rot / np.linalg.norm(rot, axis=0)).astype(np.float32))


def without_colours(count: int, sh_degree: int, seed: int) -> Scene:
    """SH-AC that are all zero in some colours of some Gaussians."""
    scene = random_scene(count, sh_degree, seed)
    lacking = np.random.default_rng(seed).random((3, 1, count)) < 0.4
    f_rest = scene.f_rest.reshape(3, -1, count) * np.float32(1)
    f_rest[np.broadcast_to(lacking, f_rest.shape)] = 0
    return replace(scene, f_rest=f_rest.reshape(scene.f_rest.shape))


SCENES = edge_scenes() | {
    **{f"any bits of degree {d}-seed{20 + d}": any_bits(700, d, 20 + d) for d in range(4)},
    **{f"{n} of any bits-seed{30 + n}": any_bits(n, 3, 30 + n) for n in range(5)},
    **{f"blocks of degree {d}-seed{40 + d}": random_scene(2500, d, 40 + d) for d in range(4)},
    "blocks of any bits-seed50": any_bits(2500, 2, 50),
    "duplicates of any bits-seed51": any_bits(40, 3, 51).take(np.arange(1200) % 40),
    "unit quaternions-seed52": unit_quaternions(3000, 52),
    "colours lacking-seed53": without_colours(1500, 3, 53),
    "one colour-seed54": replace(
        random_scene(300, 1, 54),
        f_rest=random_scene(300, 1, 54).f_rest * np.repeat([1, 0, 0], 3)[:, None].astype("f4"),
    ),
}


def rows_of(scene: Scene) -> np.ndarray:
    """Bit patterns ``(N, channels)``."""
    planes = [getattr(scene, group).view(np.uint32) for group in GROUPS]
    return np.ascontiguousarray(np.concatenate(planes).T)


def assert_same_bits(first: Scene, second: Scene) -> None:
    np.testing.assert_array_equal(rows_of(first), rows_of(second))
    assert first.sh_degree == second.sh_degree


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", SCENES)
def test_bits_and_order_are_restored(name):
    data, report = encode_scene(SCENES[name], KEPT)
    assert report.file_bytes == len(data)
    assert_same_bits(decode_scene(data), SCENES[name])


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", SCENES)
def test_bits_are_restored_in_stream_order(name):
    scene = SCENES[name]
    data, _ = encode_scene(scene, LOSSLESS)
    decoded = decode_scene(data)
    assert_same_bits(decoded, scene.take(lossless_order(scene)))
    assert sorted(map(bytes, rows_of(decoded))) == sorted(map(bytes, rows_of(scene)))
    assert_same_bits(decode_scene(data), decoded)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", SCENES)
def test_order_of_the_input_does_not_matter(name):
    scene = SCENES[name]
    shuffled = scene.take(np.random.default_rng(60).permutation(scene.count))
    assert encode_scene(scene, LOSSLESS)[0] == encode_scene(shuffled, LOSSLESS)[0]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("config", [LOSSLESS, KEPT], ids=["sorted", "kept"])
@pytest.mark.parametrize("name", SCENES)
def test_reference_decoder_agrees(name, config):
    data = encode_scene(SCENES[name], config)[0]
    decoded = decode_scene(data)
    values = reference_decode(data)["values"]
    in_order = np.array([column.view(np.uint32) for column in values.values()])
    names = list(values)
    ours = {"x": decoded.positions[0], "f_dc_2": decoded.f_dc[2], "rot_0": decoded.rot[0]}
    ours |= {f"f_rest_{i}": row for i, row in enumerate(decoded.f_rest)}
    for column, row in ours.items():
        np.testing.assert_array_equal(in_order[names.index(column)], row.view(np.uint32))


@pytest.mark.thorough
@pytest.mark.parametrize("name", REAL_SCENES)
def test_real_scene_is_restored_and_smaller(name):
    path = shared_scene_path(name)
    scene = read_ply(path)
    data, _ = encode_scene(scene, Config("lossless"))
    assert_same_bits(decode_scene(data), scene.take(lossless_order(scene)))
    assert path.stat().st_size >= 1.45 * len(data)
    assert scene.float_bytes >= (1.5 if name.startswith("bonsai") else 1) * len(data)


@pytest.mark.thorough
def test_bonsai_is_smaller_in_its_order():
    scene = read_ply(shared_scene_path("bonsai/point_cloud.ply"))
    kept = encode_scene(scene, Config("lossless", keep_order=True))[0]
    assert scene.float_bytes >= 1.45 * len(kept)
    assert_same_bits(decode_scene(kept), scene)


def test_absent_colours_and_unit_quaternions_cost_little():
    full, lacking = random_scene(4000, 3, 61), without_colours(4000, 3, 61)
    sizes = [encode_scene(scene, LOSSLESS)[1].section_bytes["sh3"] for scene in (full, lacking)]
    assert sizes[1] < 0.65 * sizes[0]
    scenes = random_scene(4000, 0, 62), unit_quaternions(4000, 62)
    sizes = [encode_scene(scene, LOSSLESS)[1].section_bytes["rotation"] for scene in scenes]
    assert sizes[1] < 0.85 * sizes[0]


def test_bytes_and_floats_do_not_depend_on_threads():
    scene = any_bits(5000, 3, 63)
    streams = [encode_scene(scene, replace(LOSSLESS, threads=t))[0] for t in (1, 2, 7)]
    assert streams[0] == streams[1] == streams[2]
    for threads in (1, 2, 7):
        assert_same_bits(decode_scene(streams[0], threads), scene.take(lossless_order(scene)))


def test_no_argument_is_changed():
    scene = any_bits(500, 3, 64)
    before = rows_of(scene)
    encode_scene(scene, LOSSLESS)
    np.testing.assert_array_equal(rows_of(scene), before)


def test_extra_properties_and_comments_stay_with_their_gaussians():
    scene = replace(
        any_bits(3000, 1, 65),
        extra={"label": np.arange(3000, dtype="<i4")},
        comments=("made by a test", ""),
        has_normals=True,
    )
    for config in (LOSSLESS, KEPT):
        decoded = decode_scene(encode_scene(scene, config)[0])
        assert (decoded.comments, decoded.has_normals) == (scene.comments, True)
        assert_same_bits(decoded, scene.take(decoded.extra["label"]))


def test_nonfinite_gaussians_are_dropped_on_request():
    scene = random_scene(50, 1, 66)
    scene.rot[0, 7] = np.nan
    scene.f_rest[3, 9] = -np.inf
    data, report = encode_scene(scene, replace(KEPT, nonfinite="drop"))
    assert report.dropped == 2
    assert_same_bits(decode_scene(data), scene.take(np.delete(np.arange(50), [7, 9])))


def test_ordered_integers_ascend_with_the_floats():
    bits = np.random.default_rng(67).integers(0, 1 << 32, 100_000, np.uint32)
    bits = np.concatenate([bits, PATTERNS])
    np.testing.assert_array_equal(from_ordered(to_ordered(bits)), bits)
    floats = bits.view(np.float32)[np.argsort(to_ordered(bits))]
    assert (np.diff(floats[np.isfinite(floats)].astype(np.float64)) >= 0).all()


def test_inspect_reports_bounds_of_finite_centres():
    scene = any_bits(300, 2, 68)
    for config in (LOSSLESS, KEPT):
        info = inspect_bytes(encode_scene(scene, config)[0])
        assert (info.profile, info.keeps_order) == ("lossless", config.keep_order)
        assert info.channels == ()
        for row, low, high in zip(scene.positions, *info.bounds, strict=True):
            finite = row[np.isfinite(row)]
            assert (low, high) == (finite.min(), finite.max())
    nowhere = replace(random_scene(2, 0), positions=np.full((3, 2), np.nan, np.float32))
    assert inspect_bytes(encode_scene(nowhere, KEPT)[0]).bounds == ((0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"profile": "lossless", "depths": {"sh1": 3}}, "profile 'lossless' has none"),
        ({"profile": "paper-m", "keep_order": True}, "expected 'lossless'"),
    ],
)
def test_unsupported_options_are_refused(config, message):
    with pytest.raises(InvalidInput, match=message):
        Config(**config)


# Files


@pytest.fixture
def plain(tmp_path):
    """A PLY with random bits, an extra property, comments, and -0 among its normals."""
    scene = replace(any_bits(1500, 2, 70), comments=("one", "two"))
    extra = {name: np.zeros(1500, "<f4") for name in ("nx", "ny", "nz")}
    extra["ny"][5] = -0.0
    path = tmp_path / "scene.ply"
    write_ply(path, replace(scene, extra={**extra, "label": np.arange(1500, dtype="<u2")}))
    return path


def run(*arguments) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_command_line_restores_the_file(plain, tmp_path):
    stream, back = tmp_path / "scene.egs", tmp_path / "back.ply"
    run("encode", plain, stream, "-p", "lossless", "--keep-order", "--extra", "keep")
    run("decode", stream, back)
    assert back.read_bytes() == plain.read_bytes()
    run(
        "encode",
        back,
        tmp_path / "again.egs",
        "-p",
        "lossless",
        "--keep-order",
        "--extra",
        "keep",
    )
    assert (tmp_path / "again.egs").read_bytes() == stream.read_bytes()


def test_command_line_sorts_and_compare_finds_no_difference(tmp_path):
    plain, stream, back = (tmp_path / name for name in ("scene.ply", "scene.egs", "back.ply"))
    write_ply(plain, random_scene(1500, 3, 71))
    run("encode", plain, stream, "--profile", "lossless")
    run("decode", stream, back)
    assert json.loads(run("inspect", stream, "--json"))["profile"] == "lossless"
    assert "profile lossless" in run("inspect", stream, "--channels")
    for first, second in ((plain, back), (back, plain), (plain, stream), (stream, back)):
        assert not any(group.max for group in compare_files(first, second).groups)
    assert_same_bits(read_scene(back), read_scene(stream))


def test_the_kept_order_comment_is_still_valid(tmp_path):
    names = ("scene.ply", "lossy.egs", "lossy.ply", "kept.egs", "kept.ply")
    plain, lossy, decoded, kept, back = (tmp_path / name for name in names)
    write_ply(plain, random_scene(800, 1, 72))
    encode_file(plain, lossy)
    decode_file(lossy, decoded)
    encode_file(decoded, kept, Config("lossless", keep_order=True))
    decode_file(kept, back)
    assert back.read_bytes() == decoded.read_bytes()


def test_compare_refuses_unrelated_scenes(tmp_path):
    first, second = tmp_path / "first.ply", tmp_path / "second.ply"
    for path, seed in ((first, 73), (second, 74)):
        write_ply(path, random_scene(100, 0, seed))
    encode_file(second, tmp_path / "second.egs", Config("lossless"))
    with pytest.raises(InvalidInput, match="Gaussians of the scenes do not match"):
        compare_files(first, tmp_path / "second.egs")


# Damage


@pytest.fixture(scope="module", params=[LOSSLESS, KEPT], ids=["sorted", "kept"])
def stream(request) -> bytes:
    return encode_scene(replace(random_scene(4, 1, 80), comments=("one",)), request.param)[0]


def test_every_truncation_is_refused(stream):
    for size in range(len(stream)):
        for read in (decode_scene, inspect_bytes):
            with pytest.raises((TruncatedStream, CorruptStream)):
                read(stream[:size])


@pytest.mark.thorough
def test_every_flipped_bit_is_refused(stream):
    damaged = bytearray(stream)
    for bit in range(8 * len(stream)):
        damaged[bit >> 3] ^= 1 << (bit & 7)
        with pytest.raises(GsCodecError):
            decode_scene(bytes(damaged))
        damaged[bit >> 3] ^= 1 << (bit & 7)


def survive(data: bytes) -> None:
    """Decode and inspect; only our own errors may come out."""
    for read in (lambda data: decode_scene(data, threads=1, max_bytes=1 << 20), inspect_bytes):
        try:
            read(data)
        except GsCodecError as error:
            assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.thorough
def test_flipped_bits_with_correct_checksums_do_not_crash():
    stream = encode_scene(random_scene(4, 0, 83), KEPT)[0]
    for bit in range(8 * len(stream)):
        damaged = bytearray(stream)
        damaged[bit >> 3] ^= 1 << (bit & 7)
        survive(with_checksums(damaged))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("seed", range(100))
def test_random_changes_with_correct_checksums_do_not_crash(seed):
    rng = np.random.default_rng(seed)
    scene = any_bits(int(rng.integers(1, 2500)), int(rng.integers(0, 4)), seed)
    data = bytearray(encode_scene(scene, LOSSLESS)[0])
    for _ in range(rng.integers(1, 6)):
        end = min(len(data), 2000) if rng.random() < 0.5 else len(data)
        data[rng.integers(8, end)] = rng.integers(256)
    survive(with_checksums(data))


HOSTILE = {
    "nothing": (SectionId.OPACITY, lambda _: b"", "0 bytes left"),
    "more bytes": (SectionId.OPACITY, lambda good: good + b"\0", "after the last value"),
    "a size too large": (
        SectionId.OPACITY,
        lambda good: struct.pack("<I", 1 << 31) + good[4:],
        "bytes left",
    ),
    "lookback": (
        SectionId.OPACITY,
        lambda good: good[:6] + bytes([2 << 4 | good[6] & 15]) + good[7:],
        "not a supported pcodec stream",
    ),
    "another mode": (
        SectionId.OPACITY,
        lambda good: good[:6] + bytes([good[6] | 4]) + good[7:],
        "not a supported pcodec stream",
    ),
    "another version": (
        SectionId.OPACITY,
        lambda good: good[:4] + b"\3" + good[5:],
        "not a supported pcodec stream",
    ),
    "quaternions": (SectionId.ROTATION, lambda good: b"\2" + good[1:], "kind 2, expected"),
    "a mask": (
        SectionId.SH1,
        lambda good: columns(np.full(4, 8, np.uint32)) + good[4 + size_of(good) :],
        "mask 8, expected at most 7",
    ),
    "more values": (
        SectionId.OPACITY,
        lambda _: columns(np.random.default_rng(82).integers(0, 1 << 32, 40, np.uint32)),
        "section 'opacity' of block 0: ",
    ),
}


def size_of(section: bytes) -> int:
    return struct.unpack_from("<I", section)[0]


def columns(values: np.ndarray) -> bytes:
    packed = write_integers(values)
    return struct.pack("<I", len(packed)) + packed


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_sections_are_refused(stream, name):
    section_id, change, message = HOSTILE[name]
    with pytest.raises((CorruptStream, TruncatedStream), match=message):
        decode_scene(with_section(stream, section_id, change))


@pytest.mark.parametrize("present", [SectionId.OPACITY, SectionId.SCALING])
def test_a_missing_section_is_refused(stream, present):
    with pytest.raises(CorruptStream, match="expected 6"):
        decode_scene(with_section(stream, present, lambda _: None))


@pytest.mark.parametrize("other", [SectionId.CHANNELS, SectionId.SH2, SectionId.STATES])
def test_a_section_of_other_profiles_is_refused(stream, other):
    with pytest.raises(CorruptStream, match=r": empty$"):
        decode_scene(with_section(stream, other, lambda _: b"other"))


def test_other_profiles_have_no_order_of_the_input():
    data = bytearray(encode_scene(random_scene(20, 1, 81))[0])
    data[28] |= 2
    with pytest.raises(CorruptStream, match="a reserved field is not 0"):
        decode_scene(with_checksums(data))


@pytest.mark.parametrize("count", [5000, 65536, 1 << 20, 1 << 40, (1 << 64) - 1])
def test_a_false_count_is_refused(stream, count):
    data = bytearray(stream)
    struct.pack_into("<Q", data, COUNT, count)
    with pytest.raises(GsCodecError):
        decode_scene(with_checksums(data))


@pytest.mark.parametrize("count", [1, 2, 255, 256, 257, 8191, 8192, 8193, 30000])
@pytest.mark.parametrize("kind", ["any", "near", "ascending", "constant", "few"])
def test_integers_round_trip(kind, count):
    rng = np.random.default_rng(count)
    values = {
        "any": rng.integers(0, 1 << 32, count, np.uint32),
        "near": rng.normal(2e9, 1e5, count).astype(np.uint32),
        "ascending": np.cumsum(rng.integers(0, 9, count)).astype(np.uint32),
        "constant": np.full(count, 7, np.uint32),
        "few": rng.choice([0, 3, 0xFFFFFFFF], count).astype(np.uint32),
    }[kind]
    packed = write_integers(values)
    np.testing.assert_array_equal(read_integers(memoryview(packed), count, "here"), values)
    for size in range(0, len(packed), 1 + len(packed) // 50):
        with pytest.raises(CorruptStream, match="here"):
            read_integers(memoryview(packed[:size]), count, "here")
    with pytest.raises(CorruptStream, match="here"):
        read_integers(memoryview(packed + b"\0"), count, "here")
