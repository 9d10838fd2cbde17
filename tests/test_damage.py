"""Damaged and hostile files: always a clean refusal, never a crash or wrong data."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from crc32c import crc32c
from scenes import random_scene

from gs_codec.codec import decode_part, decode_scene, encode_scene
from gs_codec.codec.part import Part
from gs_codec.config import PROFILE_CHOICES, PROFILES, Config
from gs_codec.container.file import read_file
from gs_codec.errors import CorruptStream, GsCodecError, TruncatedStream, UnsupportedVersion
from gs_codec.inspection import inspect_bytes
from gs_codec.scene import GROUPS

HEADER = 36
ENTRY = 20


@pytest.fixture(scope="module", params=["paper-l", "paper-m", "paper-s"])
def stream(request) -> bytes:
    scene = random_scene(20, 1, seed=60)
    return encode_scene(scene, Config(request.param))[0]


def test_every_truncation_is_refused(stream):
    for size in range(len(stream)):
        with pytest.raises((TruncatedStream, CorruptStream)):
            decode_scene(stream[:size])
        with pytest.raises((TruncatedStream, CorruptStream)):
            inspect_bytes(stream[:size])


def test_every_flipped_bit_is_refused(stream):
    damaged = bytearray(stream)
    for bit in range(8 * len(stream)):
        damaged[bit >> 3] ^= 1 << (bit & 7)
        with pytest.raises((CorruptStream, TruncatedStream, UnsupportedVersion)):
            decode_scene(bytes(damaged))
        damaged[bit >> 3] ^= 1 << (bit & 7)


def test_bytes_after_the_end_are_refused(stream):
    with pytest.raises(CorruptStream, match="bytes, expected"):
        decode_scene(stream + b"\0")


def test_later_versions_are_refused(stream):
    later = bytearray(stream)
    later[8:10] = struct.pack("<H", 2)
    with pytest.raises(UnsupportedVersion, match="version 2"):
        decode_scene(bytes(later))


@pytest.mark.parametrize("data", [b"", b"ply\n", b"\x89EGS", b"\x89EGS\r\n\x1a\n", bytes(500)])
def test_other_files_are_refused(data):
    with pytest.raises((CorruptStream, TruncatedStream)):
        decode_scene(data)


def with_checksums(data: bytearray) -> bytes:
    """The stream with every checksum made right again, as a hostile writer would."""
    sections = struct.unpack_from("<I", data, 32)[0]
    size = HEADER + ENTRY * sections
    position = size + 4
    if position > len(data):
        return bytes(data)
    for entry in range(HEADER, size, ENTRY):
        length = struct.unpack_from("<Q", data, entry + 8)[0]
        if length > len(data):
            return bytes(data)
        struct.pack_into("<I", data, entry + 16, crc32c(bytes(data[position : position + length])))
        position += length
    struct.pack_into("<I", data, size, crc32c(bytes(data[:size])))
    return bytes(data)


def decode_hostile(data: bytes) -> None:
    """Decode with a bound on memory; only our own errors may come out."""
    try:
        scene = decode_scene(data, max_bytes=1 << 20)
    except GsCodecError as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    for name in ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot"):
        assert np.isfinite(getattr(scene, name)).all()


def test_every_flipped_bit_under_right_checksums_is_survived():
    stream = encode_scene(random_scene(20, 1, seed=61))[0]
    for bit in range(8 * len(stream)):
        damaged = bytearray(stream)
        damaged[bit >> 3] ^= 1 << (bit & 7)
        decode_hostile(with_checksums(damaged))


@pytest.mark.parametrize("seed", range(200))
def test_random_changes_under_right_checksums_are_survived(seed):
    rng = np.random.default_rng(seed)
    scene = random_scene(int(rng.integers(1, 3000)), int(rng.integers(0, 4)), seed)
    extra = {"label": np.arange(scene.count, dtype="<i4")}
    object.__setattr__(scene, "extra", extra)
    object.__setattr__(scene, "comments", ("a comment",))
    data = bytearray(encode_scene(scene, Config("paper-m", extra="keep", block_size=1024))[0])
    for _ in range(rng.integers(1, 6)):
        # Half of the changes hit the header and the channels, where the structure is.
        end = min(len(data), 2000) if rng.random() < 0.5 else len(data)
        data[rng.integers(HEADER, end)] = rng.integers(256)
    decode_hostile(with_checksums(data))


@pytest.mark.parametrize("count", [1 << 20, 1 << 40, (1 << 64) - 1])
def test_a_false_count_does_not_allocate(stream, count):
    data = bytearray(stream)
    struct.pack_into("<Q", data, 16, count)
    with pytest.raises(GsCodecError):
        decode_scene(with_checksums(data))


def blocks_of_one(data: bytes, count: int) -> bytes:
    """The stream with as many Gaussians, each in a block of its own."""
    hostile = bytearray(data)
    struct.pack_into("<Q", hostile, 16, count)
    struct.pack_into("<I", hostile, 28, 1)
    return with_checksums(hostile)


def peak_of(work: Callable[[], object]) -> int:
    """Most bytes allocated at once while it runs."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("part", [Part(), Part((-9.0,) * 3 + (9.0,) * 3)], ids=["all", "box"])
@pytest.mark.parametrize("profile", PROFILES)
def test_blocks_of_nothing_cost_nothing(profile, part):
    """All channels constant: no section says that there are so many blocks."""
    one = random_scene(1, 0, seed=62)
    data = blocks_of_one(encode_scene(one, Config(profile))[0], 100_000)
    jobs = []
    scenes = []
    decode = partial(decode_part, data, part, progress=lambda *state: jobs.append(state))
    peak = peak_of(lambda: scenes.append(decode()[0]))
    assert (len(data) < 250, jobs) == (True, [])
    assert peak < 3 * scenes[0].float_bytes
    assert scenes[0].count == 100_000
    for group in GROUPS:
        expected = np.repeat(getattr(one, group), 100_000, axis=1)
        np.testing.assert_array_equal(getattr(scenes[0], group), expected)


@pytest.mark.parametrize("part", [Part(), Part((-9.0,) * 3 + (9.0,) * 3)], ids=["all", "box"])
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_more_blocks_than_sections_are_refused_at_once(profile, part):
    data = blocks_of_one(encode_scene(random_scene(20, 0, seed=63), Config(profile))[0], 1 << 24)

    def refused() -> None:
        with pytest.raises(CorruptStream, match="expected"):
            decode_part(data, part)

    assert peak_of(refused) < 1 << 20


def test_unknown_sections_are_skipped_only_if_optional(stream):
    """A section 99 appended by a later writer."""
    for flags, accepted in ((1, True), (0, False), (3, False)):
        sections = struct.unpack_from("<I", stream, 32)[0]
        table_end = HEADER + ENTRY * sections
        entry = struct.pack("<HHIQI", 99, flags, 0, 5, crc32c(b"later"))
        data = bytearray(stream[:table_end] + entry + bytes(4) + stream[table_end + 4 :] + b"later")
        struct.pack_into("<I", data, 12, table_end + ENTRY + 4)
        struct.pack_into("<I", data, 32, sections + 1)
        if accepted:
            assert decode_scene(with_checksums(data)).count == 20
            assert (99, 0) not in read_file(with_checksums(data)).sections
        else:
            with pytest.raises(CorruptStream):
                decode_scene(with_checksums(data))


@pytest.mark.parametrize("section_id", [1, 2])
def test_sections_of_blocks_that_do_not_exist_are_refused(stream, section_id):
    data = bytearray(stream)
    for entry in range(HEADER, HEADER + ENTRY * struct.unpack_from("<I", data, 32)[0], ENTRY):
        if struct.unpack_from("<H", data, entry)[0] == section_id:
            struct.pack_into("<I", data, entry + 4, 1)
    with pytest.raises(CorruptStream, match="block that does not exist"):
        decode_scene(with_checksums(data))


def test_a_missing_section_is_refused(stream):
    data = bytearray(stream)
    sections = struct.unpack_from("<I", data, 32)[0]
    struct.pack_into("<HH", data, HEADER + ENTRY * (sections - 1), 99, 1)
    with pytest.raises(CorruptStream, match="sections of blocks, expected"):
        decode_scene(with_checksums(data))
