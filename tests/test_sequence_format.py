"""Sequences against FORMAT.md: the reference decoder, random changes, damage."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import reference_sequence
from damage import (
    BLOCK_SIZE,
    COUNT,
    REFUSALS,
    TIMES_OF_FRAMES,
    changed,
    flipped,
    most_memory,
    peak_of,
    survive,
    survive_sequence,
    with_checksums,
)
from format_cases import assert_same_values
from moving_scenes import decode, encoded, opened, rewritten, sections_of, varied
from random_motion import random_motion
from scenes import random_scene, seen_from, with_far

from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.egs.header import Feature
from gs_codec.errors import CorruptStream
from gs_codec.scene import GROUPS, Scene


def assert_same(data: bytes) -> None:
    """Reference decoder and codec agree on every bit of every frame."""
    reference, ours = reference_sequence.decode_sequence(data), decode(data)
    timeline = opened(data).timeline
    for name in ("count", "rate", "names"):
        assert getattr(timeline, name) == reference[name]
    for number, (scene, frame) in enumerate(zip(ours, reference["frames"], strict=True)):
        assert_same_values(scene, frame["values"], f" of frame {number}")


def wild(count: int, frames: int) -> list[Scene]:
    """Frames in which everything changes by much, so that step sizes change too."""
    found, rng = [random_scene(count, 2, seed=3)], np.random.default_rng(3)
    for k in range(frames - 1):
        before = found[-1]
        planes = {
            "opacity": before.opacity + 1.5 * (-1) ** (k // 3),
            "log_scale": before.log_scale + 0.7 * (-1) ** (k // 4),
            "f_rest": before.f_rest * 1.3,
            "rot": rng.normal(size=before.rot.shape),
            "positions": before.positions * 1.2,
        }
        found.append(replace(before, **{name: p.astype("f4") for name, p in planes.items()}))
    return found


def in_basis(count: int, degree: int) -> Scene:
    """A scene whose SH-AC are so large that bases pay for a few Gaussians."""
    return seen_from(random_scene(count, degree, seed=degree), 2, scale=10.0)


CASES = {
    **{
        f"degree {k}": lambda k=k: encoded(varied(random_scene(250, k, seed=k), 3))
        for k in range(4)
    },
    **{
        f"only {group}": lambda group=group: encoded(
            varied(random_scene(60, 1), 3, [group], 0.5), 40, "s"
        )
        for group in GROUPS
    },
    "far": lambda: encoded(varied(with_far(random_scene(220, 1), 40), 4, share=0.6)),
    "basis": lambda: encoded(varied(in_basis(240, 3), 4, share=0.6), 120, "l"),
    "basis, far, groups": lambda: encoded(varied(with_far(in_basis(200, 2), 20), 7), 200, "s", 3),
    "equal places": lambda: encoded(
        varied(random_scene(70, 1).take(np.arange(210) % 70), 3), 100, "s"
    ),
    "other scenes": lambda: encoded(
        [*varied(random_scene(200, 1), 3), *varied(random_scene(40, 1), 2)]
        + 2 * [random_scene(0, 1)]
    ),
    "still": lambda: encoded(4 * [random_scene(50, 1)]),
    "wild": lambda: encoded(wild(150, 8), 77),
    "one frame": lambda: encoded([random_scene(20, 0)]),
}

FEATURES = {"far": Feature.FAR, "basis": Feature.LOCAL_BASIS}


@pytest.mark.parametrize("case", CASES)
def test_reference_decoder_gives_the_same_bits(case):
    data = CASES[case]()
    assert_same(data)
    features = opened(data).file.header.features
    for word, feature in FEATURES.items():
        assert (word in case) == bool(features & feature)


@cache
def base(case: str) -> bytes:
    """A sequence to change."""
    return CASES[case]()


@pytest.mark.rounds(3)
@pytest.mark.parametrize("case", ["degree 1", "basis, far, groups", "equal places", "wild"])
def test_random_motion_gives_the_same_bits(case, seed):
    """All modes, large integers, step sizes that change: what our encoder rarely writes."""
    rng = np.random.default_rng([seed, len(case)])
    data = base(case)
    moving_blocks, sections, refused = [], [], False
    for section in sections_of(data):
        if section.id == SectionId.KEY_FRAME:
            moving_blocks = reference_sequence.moving_blocks(section.data)
        if section.id == SectionId.MOTION:
            made, valid = random_motion(moving_blocks, rng)
            refused |= not valid
            section = replace(section, data=made)
        sections.append(section)
    made = rewritten(data, sections)
    if refused:
        with pytest.raises(CorruptStream, match=r"out of range|not finite"):
            decode(made)
    else:
        assert_same(made)


#: Bit flips of the small sequence, with corrected checksums.
FLIPS = 250


@cache
def small() -> bytes:
    """A few Gaussians in two blocks, some of them far; two groups, of three and two frames."""
    first = with_far(random_scene(5, 1, seed=1), 2)
    frames = varied(first, 5, share=0.7)
    return encoded(frames, 3, group=3)


def refused_by_both(data: bytes) -> None:
    with pytest.raises(REFUSALS) as refusal:
        decode(data)
    assert "\n" not in str(refusal.value)
    with pytest.raises(ValueError, match=r"\w"):
        reference_sequence.decode_sequence(data)


def test_every_truncation_is_refused():
    data = small()
    for size in range(len(data)):
        with pytest.raises(REFUSALS):
            decode(data[:size])


@pytest.mark.thorough
def test_flipped_bits_are_refused():
    data = small()
    for bit in np.random.default_rng(0).choice(8 * len(data), 5000, replace=False):
        with pytest.raises(REFUSALS):
            decode(bytes(flipped(data, int(bit))))


@pytest.mark.thorough
def test_flipped_bits_with_correct_checksums_are_refused_by_both_or_give_the_same_bits(
    pytestconfig,
):
    data = small()
    flips = FLIPS * pytestconfig.getoption("rounds")
    for bit in np.random.default_rng(1).choice(8 * len(data), flips, replace=False):
        damaged = with_checksums(flipped(data, int(bit)))
        if survive_sequence(damaged):
            assert_same(damaged)
        else:
            refused_by_both(damaged)


@pytest.mark.rounds(20)
def test_random_changes_with_correct_checksums_do_not_crash(seed):
    rng = np.random.default_rng([seed, 1])
    data = with_checksums(changed(base("basis, far, groups") if seed % 2 else small(), rng))
    survive_sequence(data)
    survive(data)


@pytest.mark.rounds(3)
@pytest.mark.parametrize("max_bytes", [1 << 16, None], ids=["64 KiB", "default"])
def test_memory_is_bounded(max_bytes, seed):
    rng = np.random.default_rng([seed, 2])
    data = bytearray(base("degree 3"))
    if seed % 2:
        struct.pack_into("<Q", data, COUNT, int(2.0 ** rng.uniform(8, 24)))
        struct.pack_into("<I", data, BLOCK_SIZE, int(2.0 ** rng.uniform(8, 16)))
        data = changed(data, rng)
    data = with_checksums(data)
    peak = peak_of(lambda: survive_sequence(data, max_bytes))
    assert peak <= most_memory(len(data), max_bytes, times=TIMES_OF_FRAMES)


def test_memory_of_frames_is_in_proportion_to_their_floats():
    scene = random_scene(20_000, 0)
    data = encoded(varied(scene, 3, share=1.0), 16384)
    peak = peak_of(lambda: survive_sequence(data, scene.float_bytes, 2))
    assert peak <= most_memory(0, scene.float_bytes, 0, TIMES_OF_FRAMES) + (4 << 20)


def test_contexts_of_small_blocks_count_towards_the_limit():
    data = encoded(2 * [random_scene(1000, 0)], 2)
    assert survive_sequence(data, None)

    def refused() -> None:
        assert not survive_sequence(data, 1 << 20)

    assert peak_of(refused) < 1 << 23


Change = Callable[[list[Section]], list[Section]]


def with_data(number: int, change: Callable[[bytes], bytes]) -> Change:
    """Change the bytes of a section."""

    def changing(sections: list[Section]) -> list[Section]:
        found = replace(sections[number], data=change(sections[number].data))
        return [*sections[:number], found, *sections[number + 1 :]]

    return changing


def timeline(**changes: object) -> Change:
    """Other fields, or other names."""

    def change(data: bytes) -> bytes:
        fields = dict(
            zip(("frames", "above", "below"), struct.unpack("<3I", data[:12]), strict=True)
        )
        fields |= {"names": data[12:]} | changes
        return struct.pack("<3I", *list(fields.values())[:3]) + fields["names"]

    return with_data(0, change)


def key(number: int, change: Callable[[bytes], bytes]) -> Change:
    return with_data({0: 1, 3: 4}[number], change)


def key_of(scene: Scene, block: int = 3, profile: str = "m") -> Callable[[bytes], bytes]:
    """A key frame of another scene; one without Gaussians cannot be first."""
    before = [] if scene.count else [random_scene(1, 1)]
    return lambda _: sections_of(encoded([*before, scene], block, profile))[-1].data


def with_header(**fields: object) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        file = read_file(data)
        return write_file(replace(file.header, **fields), sections_of(data))

    return change


def with_section(section: Section) -> Callable[[bytes], bytes]:
    return lambda data: rewritten(data, [*sections_of(data), section])


def second_group(make: Callable[[bytes], bytes], blocks: int) -> Change:
    """Another key frame 3, and nothing that changes after it."""
    still = struct.pack("<I", 1) * blocks + b"\xff" * blocks
    return lambda s: [*key(3, make)(s)[:5], replace(s[5], data=still)]


def renumbered(sections: list[Section]) -> list[Section]:
    return [sections[0], *(replace(s, block=k) for k, s in enumerate(sections[1:]))]


def other(count: int = 5, degree: int = 1) -> Scene:
    return with_far(random_scene(count, degree, seed=1), 2)


#: Sections: the timeline, key frame 0, motion 1 and 2, key frame 3, motion 4.
WRONG: dict[str, Change] = {
    "no timeline": lambda s: s[1:],
    "timeline last": lambda s: [*s[1:], s[0]],
    "frames in another order": lambda s: [*s[:2], s[3], s[2], *s[4:]],
    "groups in another order": lambda s: [s[0], *s[4:], *s[1:4]],
    "a frame is missing": lambda s: [*s[:2], *s[3:]],
    "the last frame is missing": lambda s: s[:-1],
    "the first frame is missing": lambda s: [s[0], *s[2:]],
    "no frames": lambda s: s[:1],
    "one frame too many": lambda s: [*s, replace(s[5], block=5)],
    "a frame twice": lambda s: [*s, replace(s[4], block=4)],
    "a motion first": lambda s: renumbered([s[0], s[2], s[1], *s[3:]]),
    "a motion as key frame": with_data(1, lambda _: b"\0" * 8),
    "no frames stated": timeline(frames=0),
    "more frames stated": timeline(frames=6),
    "2^24 + 1 frames": timeline(frames=(1 << 24) + 1),
    "0 a second": timeline(above=0),
    "1/0 a second": timeline(below=0),
    "a name is missing": timeline(names=b"a\nb\nc\nd"),
    "a name too many": timeline(names=b"a\nb\nc\nd\ne\nf"),
    "names that are not UTF-8": timeline(names=b"a\nb\nc\nd\n\xff"),
    "an overlong name": timeline(names=b"a\nb\nc\nd\n\xc0\xaf"),
    "half of a pair": timeline(names=b"a\nb\nc\nd\n\xed\xa0\x80"),
    "a tab": timeline(names=b"a\nb\nc\nd\n\t"),
    "a zero": timeline(names=b"a\nb\nc\nd\n\0"),
    "a control character": timeline(names="a\nb\nc\nd\n\x85".encode()),
    "a short timeline": with_data(0, lambda data: data[:11]),
    "an empty timeline": with_data(0, lambda _: b""),
    "a scene's section": lambda s: [*s, Section(SectionId.COMMENTS, 0, b"")],
    "a block's section": lambda s: [*s, Section(SectionId.OPACITY, 0, b"")],
    "an index": lambda s: [Section(SectionId.INDEX, 0, bytes(96)), *s],
    "another SH degree": second_group(key_of(other(degree=2)), 2),
    "another first scene": key(0, key_of(other(4))),
    "no Gaussians at first": key(0, key_of(random_scene(0, 1))),
    "another profile": second_group(key_of(other(), profile="s"), 2),
    "normals": second_group(with_header(has_normals=True), 2),
    "other coordinates": second_group(with_header(coordinates="RUB"), 2),
    "antialiased": second_group(with_header(antialiased=True), 2),
    "another block size at first": key(0, with_header(block_size=4)),
    "a sequence as key frame": second_group(lambda _: small(), 2),
    "extra properties": second_group(with_section(Section(SectionId.EXTRA, 0, bytes(2))), 2),
    "a feature not stated": second_group(key_of(seen_from(random_scene(5, 1), 1, scale=100.0)), 2),
    "a short motion": with_data(2, lambda data: data[:7]),
    "a motion cut": with_data(2, lambda data: data[:-1]),
    "a motion with more": with_data(2, lambda data: data + b"\0"),
    "an empty motion": with_data(2, lambda _: b""),
    "sizes in another order": with_data(2, lambda data: data[4:8] + data[:4] + data[8:]),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_sequences_are_refused(name):
    refused_by_both(rewritten(small(), WRONG[name](sections_of(small()))))


#: Sequences that our encoder does not write.
RIGHT: dict[str, Change] = {
    "no names": timeline(names=b""),
    "any names": timeline(names="\n\n\u200f \u00a0\nb\n".encode() + b"\xf4\x8f\xbf\xbf"),
    "a large rate": timeline(above=(1 << 32) - 1),
    "groups in another order": lambda s: renumbered([s[0], *s[4:], *s[1:4]]),
    "no second scene": second_group(key_of(random_scene(0, 1)), 0),
    "another second scene": second_group(key_of(other(8)), 3),
    "another block size": second_group(key_of(other(16), 9), 2),
    "comments": key(3, with_section(Section(SectionId.COMMENTS, 0, b"a comment"))),
}


@pytest.mark.parametrize("name", RIGHT)
def test_other_sequences_are_read(name):
    assert_same(rewritten(small(), RIGHT[name](sections_of(small()))))
