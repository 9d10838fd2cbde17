"""The container: fields of the header, features, padding, order of sections, comments."""

from __future__ import annotations

import re
import struct
from dataclasses import replace
from itertools import product

import pytest
from crc32c import crc32c
from damage import ENTRY, HEADER, SECTIONS, sample, with_checksums, with_section
from reference_decoder import decode as reference_decode
from scenes import random_scene

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import LOSSLESS, PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import (
    DESCRIPTIONS,
    Section,
    SectionId,
    in_file_order,
    read_file,
    write_file,
)
from gs_codec.egs.header import Feature
from gs_codec.errors import CorruptStream, TruncatedStream, UnsupportedVersion
from gs_codec.scene import Scene

VERSION, MINOR, COUNT, FEATURES, FLAGS, COORDINATES, PROFILE, DEGREE, RESERVED = (
    8, 10, 16, 24, 28, 30, 31, 32, 33,
)  # fmt: skip

SYSTEMS = [x + a + b for x in "RL" for a, b in (*product("UD", "BF"), *product("BF", "UD"))]


def patched(data: bytes, offset: int, layout: str, *values: int) -> bytes:
    """The file with header fields replaced, and checksums corrected."""
    changed = bytearray(data)
    struct.pack_into("<" + layout, changed, offset, *values)
    return with_checksums(changed)


def scene(*comments: str) -> Scene:
    return replace(random_scene(20, 1, seed=300), comments=comments)


def sections_of(data: bytes) -> list[Section]:
    return [Section(SectionId(i), b, part) for (i, b), part in read_file(data).sections.items()]


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_fields_are_at_their_specified_offsets(profile):
    given = replace(scene("SplatRenderMode: mip", "CoordinateSystem: LFD"), has_normals=True)
    data = encode_scene(given, Config(profile, block_size=1024))[0]
    fields = struct.unpack_from("<8sHHIQIHBBB3sII", data)
    number = PROFILES_BY_NUMBER.index(profile)
    size = HEADER + ENTRY * fields[-1] + 4
    coordinates = 1 + 36 * 1 + 6 * 5 + 3
    assert fields[:-1] == (
        b"\x89EGS\r\n\x1a\n", 1, 0, size, 20, 0, 0b101, coordinates, number, 1, bytes(3), 20,
    )  # fmt: skip
    assert struct.unpack_from("<I", data, size - 4)[0] == crc32c(data[: size - 4])


PROFILES_BY_NUMBER = ("paper-l", "paper-m", "paper-s", "l", "m", "s", "lossless")


def test_any_minor_version_is_read():
    data = encode_scene(scene("one"))[0]
    for minor in (1, 9, 65535):
        assert decode_scene(patched(data, MINOR, "H", minor)).comments == ("one",)
        assert inspect_bytes(patched(data, MINOR, "H", minor)) == inspect_bytes(data)


@pytest.mark.parametrize(
    ("features", "named"),
    [
        (
            32,
            "5, this reader knows 0 (G-PCC), 1 (torchac), 2 (far Gaussians), 3 (local SH basis), ",
        ),
        (1 << 31, "31, this"),
        (0b101101, "5, this"),
        ((1 << 32) - 1, "5, 6, 7, 8"),
    ],
)
def test_unknown_features_are_named(features, named):
    data = patched(encode_scene(scene())[0], FEATURES, "I", features)
    for read in (decode_scene, inspect_bytes):
        with pytest.raises(UnsupportedVersion, match=re.escape(f"needs features {named}")):
            read(data)


@pytest.mark.parametrize("profile", ["m", "paper-m", LOSSLESS])
@pytest.mark.parametrize(("feature", "label"), [(1, "G-PCC"), (2, "torchac"), (3, "G-PCC")])
def test_features_without_their_sections_are_refused(profile, feature, label):
    data = encode_scene(scene(), Config(profile))[0]
    with pytest.raises(CorruptStream, match=f"feature {label} is stated, unlike section"):
        inspect_bytes(patched(data, FEATURES, "I", feature))


@pytest.mark.parametrize("section", [SectionId.TOOL, SectionId.CODER])
def test_sections_without_their_features_are_refused(section):
    data = encode_scene(scene(), Config("paper-m"))[0]
    data = patched(with_section(data, section, lambda _: b"a program"), FEATURES, "I", 0)
    with pytest.raises(CorruptStream, match=f"is not stated, unlike section '{section.label}'"):
        decode_scene(data)


def test_names_of_features():
    assert Feature(3).labels == ("G-PCC", "torchac")
    assert Feature.TORCHAC.labels == ("torchac",)
    assert Feature.NONE.labels == ()
    assert Feature.FAR.labels == ("far Gaussians",)


@pytest.mark.parametrize(
    ("profile", "features", "version", "told"),
    [
        ("m", 0, 2, "version 2 with features: none"),
        ("m", 4, 1, "version 1 with features: far Gaussians"),
        ("m", 4, 2, "feature far Gaussians is stated, unlike section 'far'"),
        ("m", 8, 1, "version 1 with features: local SH basis"),
        ("m", 8, 2, "feature local SH basis is stated, unlike section 'basis'"),
        ("paper-m", 12, 2, "far Gaussians and local SH basis with profile paper-m"),
        ("paper-m", 3, 2, "version 2 with features: G-PCC, torchac"),
        ("paper-m", 4, 2, "far Gaussians with profile paper-m"),
        (LOSSLESS, 4, 2, "far Gaussians with profile lossless"),
    ],
)
def test_versions_and_features_go_together(profile, features, version, told):
    data = patched(encode_scene(scene(), Config(profile))[0], FEATURES, "I", features)
    data = patched(data, VERSION, "H", version)
    for read in (decode_scene, inspect_bytes):
        with pytest.raises(CorruptStream, match=told):
            read(data)
    with pytest.raises(ValueError, match=r"header|far|basis"):
        reference_decode(data)


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_coordinate_system_is_kept(system):
    data = encode_scene(scene("a", f"coordinatesystem:  {system.lower()} ", "b"))[0]
    assert read_file(data).header.coordinates == inspect_bytes(data).coordinates == system
    decoded = decode_scene(data)
    assert decoded.coordinates == system
    assert decoded.comments == ("a", "b", f"CoordinateSystem: {system}")
    assert b"oordinate" not in data
    assert encode_scene(decoded)[0] == encode_scene(replace(decoded, comments=decoded.comments))[0]


def test_other_coordinates_are_refused():
    data = encode_scene(scene())[0]
    taken = set()
    for number in range(256):
        try:
            taken.add(decode_scene(patched(data, COORDINATES, "B", number)).coordinates)
        except CorruptStream as error:
            assert f"coordinates {number} are no system" in str(error)  # noqa: PT017
    assert taken == {None, *SYSTEMS}


@pytest.mark.parametrize(
    ("comments", "kept", "antialiased"),
    [
        (("SplatRenderMode: mip",), (), True),
        (("antialiased 1", "a"), ("a", "SplatRenderMode: mip"), True),
        (("SplatRenderMode: default", "a"), ("a",), False),
        (("antialiased 0",), (), False),
        (("antialiased 1", "antialiased 0"), (), False),
        (("antialiased", "SplatRenderMode"), ("antialiased", "SplatRenderMode"), False),
    ],
)
def test_antialiasing_is_in_the_header(comments, kept, antialiased):
    data = encode_scene(scene(*comments))[0]
    assert read_file(data).header.antialiased == inspect_bytes(data).antialiased == antialiased
    decoded = decode_scene(data)
    assert decoded.antialiased == antialiased
    expected = kept if "SplatRenderMode: mip" in kept or not antialiased else (*kept, MIP)
    assert decoded.comments == expected
    assert ((SectionId.COMMENTS, 0) in read_file(data).table) == bool(set(kept) - {MIP})


MIP = "SplatRenderMode: mip"


def test_the_last_system_counts_in_comments_of_several_lines_too():
    data = encode_scene(scene("CoordinateSystem: RUB", "a\nCoordinateSystem: RFU\nb"))[0]
    assert decode_scene(data).comments == ("a", "b", "CoordinateSystem: RFU")


@pytest.mark.parametrize(
    "line",
    ["CoordinateSystem: RUB", " coordinatesystem:rdf", "SplatRenderMode: mip", "antialiased 0",
     "splatrendermode:\tdefault "],
)  # fmt: skip
def test_comments_that_duplicate_the_header_are_refused(line):
    data = with_section(
        encode_scene(scene("one"))[0], SectionId.COMMENTS, lambda _: b"one\n" + line.encode()
    )
    with pytest.raises(CorruptStream, match="section 'comments': coordinates or antialiasing"):
        decode_scene(data)


@pytest.mark.parametrize(
    ("offset", "layout", "value"),
    [(RESERVED, "B", 1), (RESERVED + 2, "B", 255), (FLAGS, "H", 8), (FLAGS, "H", 1 << 15),
     (FLAGS, "H", 2), (PROFILE, "B", 7)],
)  # fmt: skip
def test_reserved_fields_are_checked(offset, layout, value):
    data = patched(encode_scene(scene())[0], offset, layout, value)
    with pytest.raises(CorruptStream, match="header: a reserved field is not 0"):
        decode_scene(data)


def test_sizes_have_53_bits():
    data = bytearray(encode_scene(scene())[0])
    with pytest.raises(CorruptStream, match="Gaussians, expected fewer than 9,007,199,254,740,992"):
        decode_scene(patched(data, COUNT, "Q", 1 << 53))
    struct.pack_into("<Q", data, HEADER + 8, 1 << 53)
    end = HEADER + ENTRY * struct.unpack_from("<I", data, SECTIONS)[0]
    struct.pack_into("<I", data, end, crc32c(bytes(data[:end])))
    with pytest.raises(TruncatedStream):
        decode_scene(bytes(data))


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_sections_begin_at_multiples_of_4_with_zeros_between(profile):
    data = sample(profile)
    file = read_file(data)
    end = file.header_size
    for position, size, _ in file.table.values():
        assert position == end
        assert position % 4 == 0
        end += size + -size % 4
        assert not any(data[position + size : end])
    assert end == len(data)
    assert any(size % 4 for _, size, _ in file.table.values())


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_padding_that_is_not_0_is_refused(profile):
    data = sample(profile)
    for position, size, _ in read_file(data).table.values():
        for at in range(position + size, position + size + -size % 4):
            damaged = bytearray(data)
            damaged[at] = 1
            with pytest.raises(CorruptStream, match="padding that is not 0"):
                decode_scene(bytes(damaged))


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_order_of_the_encoder(profile):
    keys = list(read_file(sample(profile)).table)
    listed = [SectionId(number) for number, _ in keys]
    first = 1 if profile == LOSSLESS else 2
    assert listed[0] == SectionId.INDEX
    assert set(listed[:first]) <= set(DESCRIPTIONS)
    assert listed[first] == SectionId.COMMENTS
    assert listed[-1] == SectionId.EXTRA
    blocks = keys[first + 1 : -1]
    base = [block for section, block in blocks if section != SectionId.SH1]
    assert base == sorted(base)
    assert blocks[len(base) :] == [(SectionId.SH1, block) for block in range(max(base) + 1)]


def test_bands_come_one_after_the_other():
    data = encode_scene(random_scene(3000, 3, seed=301), Config("m", block_size=1024))[0]
    bands = (SectionId.SH1, SectionId.SH2, SectionId.SH3)
    assert list(read_file(data).table)[-9:] == [(band, b) for band in bands for b in range(3)]


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_descriptions_that_do_not_come_first_are_refused(profile):
    data = sample(profile)
    header, sections = read_file(data).header, sections_of(data)
    number = sum(section.id in DESCRIPTIONS for section in sections)
    for at in range(number):
        for to in {0, number - 1, number, len(sections) - 1} - {at}:
            moved = list(sections)
            moved.insert(to, moved.pop(at))
            with pytest.raises(CorruptStream, match="the first sections are not index"):
                decode_scene(write_file(header, moved))


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_other_sections_come_in_any_order(profile):
    data = sample(profile)
    header, sections = read_file(data).header, sections_of(data)
    first = [section for section in sections if section.id in DESCRIPTIONS]
    turned = write_file(header, [*first, *sections[: len(first) - 1 : -1]])
    assert turned != data
    assert decode_scene(turned).comments == decode_scene(data).comments
    assert write_file(header, in_file_order(sections_of(data)[::-1])) != turned
