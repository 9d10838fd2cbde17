"""Damaged and hostile files: always a clean error, never a crash or wrong data."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from crc32c import crc32c
from damage import (
    BLOCK_SIZE,
    COUNT,
    ENTRY,
    HEADER,
    REFUSALS,
    SAMPLES,
    SECTIONS,
    changed,
    flipped,
    most_memory,
    peak_of,
    sample,
    survive,
    with_checksums,
)
from scenes import random_scene

from gs_codec.codecs import decode_part, decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.config import PROFILE_CHOICES, PROFILES, Config
from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.egs.sections import write_extra
from gs_codec.errors import CorruptStream, GsCodecError, TruncatedStream, UnsupportedVersion

#: Bit flips per file and round, with corrected checksums; ten rounds cover all bits.
FLIPS = 1500


@pytest.fixture(scope="module", params=PROFILES)
def stream(request) -> bytes:
    scene = random_scene(20, 1, seed=60)
    return encode_scene(scene, Config(request.param))[0]


@pytest.mark.parametrize("profile", SAMPLES)
def test_every_truncation_is_refused(profile):
    stream = sample(profile)
    for size in range(len(stream)):
        with pytest.raises((TruncatedStream, CorruptStream)):
            decode_scene(stream[:size], threads=1)
        with pytest.raises((TruncatedStream, CorruptStream)):
            inspect_bytes(stream[:size])


@pytest.mark.thorough
@pytest.mark.parametrize("profile", SAMPLES)
def test_every_flipped_bit_is_refused(profile):
    stream = sample(profile)
    for bit in range(8 * len(stream)):
        with pytest.raises(REFUSALS):
            decode_scene(bytes(flipped(stream, bit)), threads=1)


@pytest.mark.thorough
@pytest.mark.parametrize("profile", SAMPLES)
def test_flipped_bits_with_correct_checksums_do_not_crash(profile, pytestconfig):
    stream = sample(profile)
    number = min(FLIPS * pytestconfig.getoption("rounds"), 8 * len(stream))
    bits = np.linspace(0, 8 * len(stream) - 1, number).astype(int)
    taken = sum(survive(with_checksums(flipped(stream, int(bit)))) for bit in bits)
    # Many bits are values, and any value gives a valid scene.
    assert 0 < taken < number


@pytest.mark.rounds(15)
@pytest.mark.parametrize("profile", SAMPLES)
def test_random_changes_are_refused(profile, seed):
    stream = sample(profile, 1500, 3, 1024)
    damaged = bytes(changed(stream, np.random.default_rng([seed, 0])))
    if damaged != stream:
        with pytest.raises(REFUSALS):
            decode_scene(damaged)


@pytest.mark.one_in(3)
@pytest.mark.rounds(40)
@pytest.mark.parametrize("profile", SAMPLES)
def test_random_changes_with_correct_checksums_do_not_crash(profile, seed):
    rng = np.random.default_rng([seed, 1])
    stream = sample(profile, int(rng.choice([1, 40, 1500])), int(rng.integers(0, 4)), 1024)
    survive(with_checksums(changed(stream, rng)))


@pytest.mark.rounds(4)
@pytest.mark.parametrize("max_bytes", [1 << 16, 1 << 20, None], ids=["64 KiB", "1 MiB", "default"])
@pytest.mark.parametrize("profile", SAMPLES)
def test_memory_is_bounded(profile, max_bytes, seed):
    rng = np.random.default_rng([seed, 2])
    data = bytearray(sample(profile, 1500, int(rng.integers(0, 4)), 1024))
    if seed % 2:
        # Fields that determine sizes: the number of Gaussians, and of those in a block.
        struct.pack_into("<Q", data, COUNT, int(2.0 ** rng.uniform(8, 24)))
        struct.pack_into("<I", data, BLOCK_SIZE, int(2.0 ** rng.uniform(8, 16)))
    data = with_checksums(changed(data, rng))
    threads = 1 + seed % 2
    peak = peak_of(lambda: survive(data, max_bytes, threads))
    assert peak <= most_memory(len(data), max_bytes, threads)


def with_extra(stream: bytes, extra: bytes) -> bytes:
    """The stream with another `extra` section."""
    file = read_file(stream)
    sections = [
        Section(SectionId(number), block, extra if number == SectionId.EXTRA else data)
        for (number, block), data in file.sections.items()
    ]
    return write_file(file.header, sections)


@pytest.mark.parametrize("profile", SAMPLES)
def test_extra_properties_count_towards_the_limit(profile):
    """Each property is small when deflated, because it is all zeros."""
    count = 1500
    names = {f"zero{i}": np.zeros(count, "<f8") for i in range(100)}
    extra = write_extra(names, np.arange(count))
    data = with_extra(sample(profile, count, 0, 1024), extra)
    floats = 4 * 14 * count
    most = floats + 100 * 8 * count
    assert len(decode_scene(data, max_bytes=most).extra) == 100

    def refused() -> None:
        for limit in (floats, most - 1):
            with pytest.raises(CorruptStream, match="section 'extra': 1,200,000 bytes"):
                decode_scene(data, max_bytes=limit)

    assert peak_of(refused) < 1 << 20


@pytest.mark.thorough
def test_a_table_of_many_sections_is_bounded():
    """Unknown, empty, optional sections."""
    data = sample("m")
    sections, number = struct.unpack_from("<I", data, SECTIONS)[0], 50_000
    end = HEADER + ENTRY * sections
    entries = b"".join(struct.pack("<HHIQI", 999, 1, i, 0, 0) for i in range(number))
    data = bytearray(data[:end] + entries + data[end:])
    struct.pack_into("<I", data, 12, end + len(entries) + 4)
    struct.pack_into("<I", data, SECTIONS, sections + number)
    data = with_checksums(data)
    assert peak_of(lambda: decode_scene(data, 1, 1 << 16)) <= most_memory(len(data), 1 << 16)


def test_bytes_after_the_end_are_refused(stream):
    with pytest.raises(CorruptStream, match="bytes, expected"):
        decode_scene(stream + b"\0")


def test_later_versions_are_refused(stream):
    later = bytearray(stream)
    later[8:10] = struct.pack("<H", 3)
    with pytest.raises(UnsupportedVersion, match="version 3"):
        decode_scene(bytes(later))


@pytest.mark.parametrize("data", [b"", b"ply\n", b"\x89EGS", b"\x89EGS\r\n\x1a\n", bytes(500)])
def test_other_files_are_refused(data):
    with pytest.raises((CorruptStream, TruncatedStream)):
        decode_scene(data)


@pytest.mark.parametrize("count", [1 << 20, 1 << 40, (1 << 64) - 1])
def test_a_false_count_does_not_allocate(stream, count):
    data = bytearray(stream)
    struct.pack_into("<Q", data, COUNT, count)
    with pytest.raises(GsCodecError):
        decode_scene(with_checksums(data))


def blocks_of_one(data: bytes, count: int) -> bytes:
    """The stream with `count` Gaussians, each in its own block."""
    hostile = bytearray(data)
    struct.pack_into("<Q", hostile, COUNT, count)
    struct.pack_into("<I", hostile, BLOCK_SIZE, 1)
    return with_checksums(hostile)


@pytest.mark.parametrize("part", [Part(), Part((-9.0,) * 3 + (9.0,) * 3)], ids=["all", "box"])
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
@pytest.mark.parametrize("count", [1, 20])
def test_more_blocks_than_in_the_index_are_refused_at_once(profile, part, count):
    """With a single Gaussian, all channels of paper profiles are constant, so blocks are empty."""
    scene = random_scene(count, 0, seed=63)
    data = blocks_of_one(encode_scene(scene, Config(profile))[0], 1 << 24)

    def refused() -> None:
        with pytest.raises(CorruptStream, match="expected"):
            decode_part(data, part)

    assert peak_of(refused) < 1 << 20


def test_unknown_sections_are_skipped_only_if_optional(stream):
    """Section 99, appended by a later writer."""
    for flags, accepted in ((1, True), (0, False), (3, False)):
        sections = struct.unpack_from("<I", stream, SECTIONS)[0]
        table_end = HEADER + ENTRY * sections
        entry = struct.pack("<HHIQI", 99, flags, 0, 5, crc32c(b"later"))
        end = b"later" + bytes(3)
        data = bytearray(stream[:table_end] + entry + bytes(4) + stream[table_end + 4 :] + end)
        struct.pack_into("<I", data, 12, table_end + ENTRY + 4)
        struct.pack_into("<I", data, SECTIONS, sections + 1)
        if accepted:
            assert decode_scene(with_checksums(data)).count == 20
            assert (99, 0) not in read_file(with_checksums(data)).sections
        else:
            with pytest.raises(CorruptStream):
                decode_scene(with_checksums(data))


@pytest.mark.parametrize("section_id", [1, 2])
def test_sections_of_blocks_that_do_not_exist_are_refused(stream, section_id):
    data = bytearray(stream)
    for entry in range(HEADER, HEADER + ENTRY * struct.unpack_from("<I", data, SECTIONS)[0], ENTRY):
        if struct.unpack_from("<H", data, entry)[0] == section_id:
            struct.pack_into("<I", data, entry + 4, 1)
    with pytest.raises(CorruptStream, match="block that does not exist"):
        decode_scene(with_checksums(data))


def test_a_missing_section_is_refused(stream):
    data = bytearray(stream)
    sections = struct.unpack_from("<I", data, SECTIONS)[0]
    struct.pack_into("<HH", data, HEADER + ENTRY * (sections - 1), 99, 1)
    with pytest.raises(CorruptStream, match="sections of blocks, expected"):
        decode_scene(with_checksums(data))
