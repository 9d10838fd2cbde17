"""Parts of a scene: Gaussians in a box, SH up to a degree, and how much of a file is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from damage import HEADER, with_checksums
from scenes import any_bits, assert_same_floats, random_scene

from gs_codec.codecs import decode_part, decode_scene, encode_scene
from gs_codec.codecs.part import Part
from gs_codec.config import PROFILE_CHOICES, PROFILES, Config
from gs_codec.egs.egs_file import SCENE_SECTIONS, SectionId, read_file
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.scene import GROUPS, SH_COEFFICIENTS

BLOCK = 1024


@cache
def large(profile: str) -> bytes:
    return encode_scene(random_scene(6000, 3, seed=40), Config(profile, block_size=BLOCK))[0]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_lower_degree_is_the_whole_without_its_bands(profile, degree):
    data = large(profile)
    whole, everything = decode_part(data, Part())
    part, file = decode_part(data, Part(sh_degree=degree))
    bands = whole.f_rest.reshape(3, 15, -1)[:, : SH_COEFFICIENTS[degree]]
    lower = replace(whole, f_rest=np.ascontiguousarray(bands.reshape(-1, whole.count)))
    assert_same_floats(part, lower)
    assert part.sh_degree == degree
    assert everything.bytes_read == len(data)
    unread = {SectionId.of_stream(f"sh{band}") for band in range(degree + 1, 4)}
    skipped = sum(size for (i, _), size in read_file(data).sizes.items() if i in unread)
    assert file.bytes_read == len(data) - skipped
    assert skipped > 0 or degree == 3


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_degree_above_the_scenes_changes_nothing(profile):
    data, _ = encode_scene(random_scene(50, 1, seed=41), Config(profile))
    assert_same_floats(decode_part(data, Part(sh_degree=3))[0], decode_scene(data))


BOXES = {
    "half": (-9.0, -9.0, -9.0, 0.0, 9.0, 9.0),
    "corner": (0.2, 0.2, 0.2, 1.0, 1.0, 1.0),
    "slab": (-9.0, 0.1, -9.0, 9.0, 0.15, 9.0),
    "all": (-99.0, -99.0, -99.0, 99.0, 99.0, 99.0),
}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("degree", [None, 1])
@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_box_is_the_whole_masked(profile, box, degree):
    part = Part(BOXES[box], degree)
    whole, _ = decode_part(large(profile), Part(sh_degree=degree))
    found, file = decode_part(large(profile), part, threads=2)
    low, high = np.array(BOXES[box][:3]), np.array(BOXES[box][3:])
    inside = np.all((low <= whole.positions.T) & (high >= whole.positions.T), axis=1)
    assert inside.sum() > 0
    assert inside.all() == (box == "all")
    assert_same_floats(found, whole.take(np.flatnonzero(inside)))
    assert file.bytes_read <= len(large(profile))


def needed(data: bytes, box: Sequence[float]) -> int:
    """Bytes of the scene-wide sections, and of the blocks whose box of centres overlaps the box."""
    file, positions = read_file(data), decode_scene(data).positions.T
    low, high = np.array(box[:3]), np.array(box[3:])
    total = file.header_size
    for (section_id, block), size in file.sizes.items():
        if section_id in SCENE_SECTIONS:
            total += size
            continue
        points = positions[slice(*file.header.block_range(block))]
        points = np.where(np.isfinite(points), points, np.nan)
        least, most = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
        total += size * bool((low <= most).all() and (least <= high).all())
    return total


@pytest.mark.one_in(3)
@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_box_reads_no_more_than_it_needs(profile, box):
    file = decode_part(large(profile), Part(BOXES[box]))[1]
    assert file.bytes_read == needed(large(profile), BOXES[box])


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_box_of_one_gaussian_reads_few_blocks(profile):
    whole = decode_scene(large(profile))
    at = whole.positions[:, 17].astype(float)
    found, file = decode_part(large(profile), Part((*at, *at)))
    assert found.count >= 1
    np.testing.assert_array_equal(found.positions[:, 0], whole.positions[:, 17])
    assert file.bytes_read < 0.6 * len(large(profile))


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_box_of_nothing_is_empty(profile):
    found, file = decode_part(large(profile), Part((50.0, 50, 50, 51, 51, 51)))
    assert (found.count, found.sh_degree) == (0, 3)
    for group in GROUPS:
        assert getattr(found, group).shape[1] == 0
    assert file.bytes_read < 0.25 * len(large(profile))


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(
    ("rows", "inside"), [((0, 1, 2), True), ((0, 2), True), ((0, 1, 2), False)]
)
def test_box_of_constant_positions(profile, rows, inside):
    scene = random_scene(2500, 1, seed=50)
    scene.positions[list(rows)] = 0.25
    data, _ = encode_scene(scene, Config(profile, block_size=BLOCK))
    low = (0.25 if inside else 0.3,) * 3
    found, file = decode_part(data, Part((*low, 9.0, 9.0, 9.0)))
    assert found.count == np.count_nonzero(decode_scene(data).positions[1] >= low[1])
    assert file.bytes_read == needed(data, (*low, 9.0, 9.0, 9.0))


@pytest.mark.parametrize("kept", [False, True], ids=["sorted", "kept"])
def test_box_of_lossless_has_all_centres_inside_and_no_nan(kept):
    scene = any_bits(3000, 1, 51)
    scene = replace(scene, extra={"label": np.arange(3000, dtype="<i4")})
    data, _ = encode_scene(scene, Config("lossless", block_size=BLOCK, keep_order=kept))
    box = (-1.0, -1.0, -1.0, 0.0, 1.0, 1.0)
    found, file = decode_part(data, Part(box))
    inside = np.flatnonzero(Part(box).contains(scene.positions))
    assert 0 < inside.size < 3000
    assert sorted(found.extra["label"]) == inside.tolist()
    assert_same_floats(found, scene.take(found.extra["label"]))
    assert file.bytes_read == needed(data, box)


@pytest.mark.parametrize("seed", range(60))
def test_parts_of_damaged_files_do_not_crash(seed):
    rng = np.random.default_rng(seed)
    data = bytearray(large(("paper-m", "lossless")[seed % 2]))
    header_size = read_file(data).header_size
    for _ in range(rng.integers(1, 6)):
        end = header_size + 30_000 if rng.random() < 0.5 else len(data)
        data[rng.integers(HEADER, end)] = rng.integers(256)
    try:
        decode_part(with_checksums(data), Part(BOXES["corner"], 1), max_bytes=1 << 24)
    except GsCodecError as error:
        assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_box_of_an_empty_scene_is_empty(profile):
    data, _ = encode_scene(random_scene(0, 2), Config(profile))
    assert decode_part(data, Part((0.0, 0, 0, 1, 1, 1), 1))[0].count == 0


@pytest.mark.parametrize(
    "box",
    [
        (0.0,) * 5, (0.0,) * 7, (), (1.0, 0, 0, 0, 1, 1), (0.0, 0, 1, 1, 1, 0),
        (np.nan, 0, 0, 1, 1, 1), (0.0, 0, 0, np.inf, 1, 1), (-np.inf, 0, 0, 1, 1, 1),
    ],
    ids=str,
)  # fmt: skip
def test_bad_boxes_are_refused(box):
    with pytest.raises(InvalidInput, match=r"^box .*expected lowest"):
        Part(box)


@pytest.mark.parametrize("degree", [-1, 4, 100])
def test_bad_degrees_are_refused(degree):
    with pytest.raises(InvalidInput, match=f"SH degree {degree}: expected 0-3"):
        Part(sh_degree=degree)
