"""The JavaScript decoder gives the same floats of the frames of a sequence as Python's."""

from __future__ import annotations

import struct
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from damage import changed, with_checksums
from javascript import HERE, NODE, digest, run
from moving_scenes import coded, moving
from scenes import seen_from, with_far

from gs_codec.codecs.moving import decode_frames
from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.egs.frame_sections import timeline_of
from gs_codec.egs.header import Feature
from gs_codec.errors import GsCodecError
from gs_codec.scene import Scene

pytestmark = pytest.mark.skipif(NODE is None, reason="needs Node")


def distant(frames: list[Scene], number: int) -> list[Scene]:
    """Frames with Gaussians far away, of which every second one moves."""
    found = []
    for k, scene in enumerate(frames):
        whole = with_far(scene, number)
        positions = whole.positions.copy()
        far = np.flatnonzero(np.abs(positions).max(axis=0) > 100)[::2]
        positions[:, far] *= 1 - k / 64
        found.append(replace(whole, positions=positions))
    return found


def viewed(frames: list[Scene]) -> list[Scene]:
    """Frames whose SH-AC is in a local basis."""
    return [
        replace(seen_from(frames[0], 1, scale=100.0), positions=scene.positions) for scene in frames
    ]


CASES = {
    "degree 0": lambda: moving(sh_degree=0, frames=4),
    "degree 3": lambda: moving(frames=6),
    "groups": lambda: [*moving(frames=5), *moving(210, frames=3, seed=1)],
    "far": lambda: distant(moving(sh_degree=1), 30),
    "basis": lambda: [
        replace(scene, f_rest=scene.f_rest * (1 + k % 2))
        for k, scene in enumerate(viewed(moving(frames=4)))
    ],
    "one frame": lambda: moving(20, 1),
}


@cache
def sequence(case: str, profile: str = "m") -> bytes:
    with TemporaryDirectory() as folder:
        coded(Path(folder, "a.egs"), CASES[case](), profile, 4)
        return Path(folder, "a.egs").read_bytes()


def frames_of(data: bytes, limit: int | None = None) -> list[str]:
    """Digests of the frames that Python decodes."""
    file = read_file(data, lambda section, _: section == SectionId.TIMELINE)
    return [digest(scene) for scene in decode_frames(file, timeline_of(file), max_bytes=limit)]


@pytest.mark.parametrize("case", CASES)
def test_frames_are_those_of_python(case):
    data = sequence(case)
    features = read_file(data).header.features
    assert (Feature.FAR in features) == (case == "far")
    assert case != "basis" or Feature.LOCAL_BASIS in features
    expected = frames_of(data)
    assert len(set(expected)) == len(expected)
    here, workers = run(
        {"bytes": data, "frames": True}, {"bytes": data, "frames": True, "workers": 2}
    )
    assert here["hashes"] == workers["hashes"] == expected
    assert workers["alive"] == 0
    assert (here["fps"], here["count"]) == (25, len(expected))
    assert here["names"] == [f"frame_{k}" for k in range(len(expected))]


def test_a_golden_file():
    data = (HERE / "golden" / "v2-sequence.egs").read_bytes()
    assert run({"bytes": data, "frames": True})[0]["hashes"] == frames_of(data)


@pytest.mark.parametrize("profile", ["l", "s"])
def test_other_profiles(profile):
    data = sequence("degree 3", profile)
    assert run({"bytes": data, "frames": True})[0]["hashes"] == frames_of(data)


def test_any_frame_is_read_with_its_group():
    data = sequence("groups")
    expected, order = frames_of(data), [6, 1, 2, 0, 4, 7]
    [found] = run({"bytes": data, "frames": order, "as": "url"})
    assert found["keys"] == [0, 4, 5]
    assert found["hashes"] == [expected[k] for k in order]
    assert found["listening"] == 0
    sizes = read_file(data).sizes
    [of_one] = run({"bytes": data, "frames": [6], "as": "url"})
    group = sum(size for (_, number), size in sizes.items() if number >= 5)
    first = sizes[SectionId.TIMELINE, 0]
    assert of_one["fetched"] == group + first + len(data) - sum(sizes.values())
    assert [found["error"] for found in run({"bytes": data, "frames": [8]})] == ["RangeError"]


def test_a_group_with_a_damaged_frame_is_freed(tmp_path):
    """Otherwise each attempt to show the frame would keep its group in memory."""
    data = bytearray(sequence("groups"))
    position, _, _ = read_file(bytes(data)).table[SectionId.MOTION, 2]
    data[position + 20] ^= 4
    (tmp_path / "a.egs").write_bytes(data)
    folder = HERE.parent / "viewer" / "web" / "src"
    script = f"""
        import * as fs from 'node:fs';
        import {{ Here }} from '{(folder / "here.js").as_uri()}';
        import {{ openSequence }} from '{(folder / "index.js").as_uri()}';
        let freed = 0;
        Here.prototype.release = () => freed++;
        const sequence = await openSequence(fs.readFileSync('{tmp_path / "a.egs"}'));
        for (let k = 0; k < 3; k++) await sequence.frame(2).catch(() => {{}});
        console.log(freed);
    """
    command = [str(NODE), "--input-type=module", "-e", script]
    assert subprocess.run(command, capture_output=True, check=True).stdout == b"3\n"


def test_sequences_and_scenes_are_told_apart():
    data = sequence("one frame")
    key = bytes(read_file(data).nested(SectionId.KEY_FRAME, 0))
    scene, opened, other = run(
        {"bytes": data}, {"bytes": data, "open": {}}, {"bytes": key, "frames": True}
    )
    for found in (scene, opened, other):
        assert found["error"] == "UnsupportedError"
    assert "openSequence" in scene["message"]
    assert "use decode" in other["message"]


def with_timeline(data: bytes, content: bytes) -> bytes:
    file = read_file(data)
    sections = [
        Section(SectionId(i), b, content if i == SectionId.TIMELINE else bytes(d))
        for (i, b), d in file.sections.items()
    ]
    return write_file(file.header, sections)


def rearranged(data: bytes, order: list[int]) -> bytes:
    """The sequence with its frames in another order, or fewer."""
    file = read_file(data)
    [timeline, *frames] = [
        Section(SectionId(i), b, bytes(d)) for (i, b), d in file.sections.items()
    ]
    return write_file(file.header, [timeline, *(frames[k] for k in order)])


def test_wrong_sequences_are_refused():
    data = sequence("groups")
    start = struct.pack("<3I", 8, 25, 1)
    wrong = [
        with_timeline(data, content)
        for content in (
            struct.pack("<3I", 7, 25, 1),
            struct.pack("<3I", 0, 25, 1),
            struct.pack("<3I", 8, 0, 1),
            start[:-1],
            start + b"a\nb",
            start + b"\n".join(8 * [b"\xff"]),
            start + b"\n".join(8 * [b"\x07"]),
        )
    ]
    wrong += [rearranged(data, order) for order in ([1, 0, *range(2, 8)], list(range(7)), [])]
    for each, found in zip(wrong, run(*({"bytes": w, "frames": True} for w in wrong)), strict=True):
        assert found.get("error") == "CorruptError", found
        with pytest.raises(GsCodecError):
            frames_of(each)
    plain = with_timeline(data, start)
    assert run({"bytes": plain, "frames": True})[0]["names"] == []


@pytest.mark.one_in(2)
def test_every_truncation_is_refused():
    data = sequence("one frame")
    jobs = [{"bytes": data[:size], "frames": True} for size in range(0, len(data), 3)]
    for found in run(*jobs):
        assert found.get("error") == "CorruptError", found


@pytest.mark.one_in(2)
@pytest.mark.parametrize("right", [False, True], ids=["wrong checksums", "right checksums"])
@pytest.mark.parametrize("case", ["degree 3", "far", "basis"])
def test_damage_is_refused_or_decodes_like_in_python(case, right):
    rng = np.random.default_rng(5)
    data, refused = sequence(case), 0
    files = [bytes(changed(data, rng)) for _ in range(120)]
    files = [bytes(with_checksums(each)) if right else each for each in files]
    jobs = [{"bytes": each, "frames": True, "maxBytes": 1 << 20} for each in files]
    for each, found in zip(files, run(*jobs), strict=True):
        try:
            expected = frames_of(each, 1 << 20)
        except GsCodecError:
            refused += 1
            kinds = ["CorruptError", "UnsupportedError", "TooLargeError"]
            assert found.get("error") in kinds, found
        else:
            assert found.get("hashes") == expected, found
    assert refused > 60
