"""Levels of detail in the JavaScript decoder, run by Node, against Python's."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from damage import flipped, with_section
from javascript import NODE, blocks, digest, run, upto
from level_files import NO_LEVELS, city, encoded, errors_changed, in_level, sample
from scenes import random_scene

from gs_codec.cameras.camera import Camera, facing
from gs_codec.codecs import decode_part, decode_scene
from gs_codec.codecs.blocks_for_view import select_blocks
from gs_codec.codecs.part import Part
from gs_codec.config import ADAPTIVE_PROFILES
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.egs.index import levels_of, open_level

pytestmark = [pytest.mark.skipif(NODE is None, reason="needs Node"), pytest.mark.slow]


def as_view(camera: Camera) -> dict:
    """A camera as JSON."""
    fields = ("width", "height", "fx", "fy", "cx", "cy")
    view = {name: getattr(camera, name) for name in fields}
    return view | {"rotation": camera.rotation.tolist(), "position": camera.position.tolist()}


def random_views(count: int, seed: int, size: float) -> list[Camera]:
    """Cameras inside and far from a scene, with random directions and aspect ratios."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        position = rng.normal(size=3) * size * 10 ** rng.uniform(-1, 1.5)
        direction = rng.normal(size=3) - (k % 2) * position / size
        width, height = (int(side) for side in rng.integers(1, 900, 2))
        fx, fy = 10 ** rng.uniform(1, 4, 2)
        cx, cy = rng.uniform(-0.5, 1.5, 2) * (width, height)
        turn = facing(direction, rng.normal(size=3))
        found.append(Camera(f"{k}", width, height, fx, fy, cx, cy, turn, position))
    return found


@cache
def many() -> bytes:
    """A file of 250 blocks and five levels."""
    return encoded(random_scene(4000, 1, seed=7), "s", 16)


def test_the_blocks_selected_are_those_of_python():
    rng = np.random.default_rng(3)
    data = many()
    file = read_file(data)
    levels = [file, *(open_level(file, level) for level in levels_of(file))]
    cameras = random_views(60, 5, 3.0)
    views, expected = [], []
    for k, camera in enumerate(cameras):
        tolerance = float([0.0, 1.0, 10 ** rng.uniform(-2, 3)][k % 3])
        budget = None if k % 4 == 0 else int(rng.integers(0, 3000))
        given = {} if budget is None else {"budget": budget}
        views.append({"view": as_view(camera), "tolerance": tolerance, **given})
        expected.append(select_blocks(levels, camera, budget, tolerance))
    (found,) = run({"bytes": data, "open": {"views": views}})
    assert found["selected"] == expected
    used = [sum(bool(selected[level]) for selected in expected) for level in range(len(levels))]
    assert min(used) > 0, used
    assert found["levels"] == [[each.header.count, each.header.block_count] for each in levels]


def test_no_view_without_levels_has_any_but_level_0():
    data = blocks()
    cameras = random_views(5, 6, 3.0)
    expected = [select_blocks([read_file(data)], camera, None, 1.0) for camera in cameras]
    views = [{"view": as_view(camera)} for camera in cameras]
    found, whole = run(
        {"bytes": data, "open": {"views": views}},
        {"bytes": data, "open": {"chosen": [[0, [0, 1, 2, 3, 4]]]}},
    )
    assert found["selected"] == expected
    assert whole["decoded"] == [digest(decode_scene(data))]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_every_level_has_the_floats_of_python(profile):
    data = sample(300, 2, profile)
    levels = [decode_part(data, Part(level=level))[0] for level in range(4)]
    chosen = [[k, list(range(-(-scene.count // 8)))] for k, scene in enumerate(levels)]
    jobs = [
        {"bytes": data, "as": kind, "open": {"chosen": chosen, "together": together}, **given}
        for kind, together, given in (
            ("bytes", False, {}),
            ("bytes", True, {"workers": 2}),
            ("blob", True, {}),
            ("stream", True, {"chunk": 700}),
            ("response", False, {}),
            ("url", True, {"workers": 1}),
            ("unranged", True, {}),
        )
    ]
    lower = {"bytes": data, "open": {"chosen": chosen, "shDegree": 1}}
    *found, less = run(*jobs, lower)
    for each in found:
        assert each.get("decoded") == [digest(scene) for scene in levels], each
        assert each["alive"] == 0
        assert each["size"] == len(data)
    assert less["decoded"] == [digest(upto(scene, 1)) for scene in levels]
    assert less["fetched"] < found[0]["fetched"]


def test_chosen_blocks_are_reported_and_no_others_fetched():
    data = many()
    scene = decode_part(data, Part(level=2))[0]
    (found,) = run({"bytes": data, "as": "url", "open": {"chosen": [[2, [9, 2, 3]]]}})
    rows = np.concatenate([np.arange(16 * b, 16 * b + 16) for b in (9, 2, 3)])
    assert found["decoded"] == [digest(scene.take(rows))]
    assert sorted(found["blocks"]) == [[2, 1, 16, 16], [3, 1, 32, 16], [9, 1, 0, 16]]
    sizes = open_level(read_file(data), 2).sizes
    needed = sum(size for (_, block), size in sizes.items() if block in (9, 2, 3))
    assert 0 < found["fetched"] - found["begun"] <= needed


@pytest.mark.thorough
def test_a_first_view_takes_a_tenth_of_a_file():
    data = city()
    top = len(levels_of(read_file(data)))
    (found,) = run({"bytes": data, "as": "url", "open": {"chosen": [[top, [0]]]}})
    asked = sum(end - begin for begin, end in found["asked"])
    assert asked == found["fetched"]
    assert asked < 0.1 * len(data)
    assert decode_part(data, Part(level=top))[0].count == found["levels"][top][0]


BAD_LEVELS = [
    *NO_LEVELS,
    lambda level: level[:7],
    errors_changed(float("nan")),
    errors_changed(float("inf")),
    errors_changed(-1.0),
]


@pytest.mark.thorough
def test_levels_of_another_file_are_refused():
    damaged = [in_level(sample(), change) for change in BAD_LEVELS]
    damaged += [in_level(sample(), change, 3) for change in BAD_LEVELS]
    damaged.append(in_level(sample(), errors_changed(0.0), 2))
    jobs = [{"bytes": data, "open": {}} for data in damaged]
    for k, found in enumerate(run(*jobs)):
        level = 1 + (k >= len(BAD_LEVELS)) * 2 - (k == 2 * len(BAD_LEVELS))
        assert found.get("error") == "CorruptError", (k, found)
        assert found["message"].startswith(f"level {level}: "), (k, found)
    # A reader of the scene alone does not read them.
    for found in run(*({"bytes": data} for data in damaged)):
        assert found.get("hash") == digest(decode_scene(sample()))


@pytest.mark.thorough
def test_misplaced_sections_of_levels_are_refused():
    missing = [with_section(sample(), SectionId.LEVEL, lambda _: None, k) for k in (1, 3)]
    surplus = [with_section(sample(), SectionId.LEVEL, lambda _: b"", k) for k in (0, 4)]
    errors = with_section(sample(), SectionId.ERRORS, lambda _: bytes(4))
    paper = with_section(blocks("paper-m"), SectionId.LEVEL, lambda _: b"", 1)
    files = [*missing, *surplus, errors, paper]
    jobs = [{"bytes": data, **kind} for data in files for kind in ({}, {"open": {}})]
    for found in run(*jobs):
        assert found.get("error") == "CorruptError", found


@pytest.mark.thorough
def test_damage_in_a_level_is_found_where_it_is_read():
    """The result is never another scene; damage in unread parts is not found."""
    data, rng = sample(), np.random.default_rng(336)
    position, size, _ = read_file(data).table[SectionId.LEVEL, 1]
    places = rng.choice(size, 40, replace=False)
    chosen = [[1, list(range(10))]]
    files = [bytes(flipped(data, 8 * (position + int(at)) + int(rng.integers(8)))) for at in places]
    jobs = [{"bytes": each, "open": {"chosen": chosen}} for each in files]
    jobs.append({"bytes": files[0], "open": {"chosen": [[0, [0]]]}})
    kinds = ("CorruptError", "UnsupportedError")
    for found in run(*jobs[:-1]):
        assert found.get("error") in kinds, found
        assert found["message"].startswith("level 1: ")
    last = bytes(flipped(data, 8 * (position + size - 1)))
    whole, other = run(
        {"bytes": last, "open": {"chosen": [[2, [0]]]}},
        {"bytes": data, "open": {"chosen": [[2, [0]]]}},
    )
    assert whole["decoded"] == other["decoded"]


@pytest.mark.thorough
def test_every_truncation_is_refused():
    data = sample(40, 0)
    chosen = [[0, [0, 1, 2, 3, 4]], [1, [0, 1]]]
    jobs = [
        {"bytes": data[:size], "as": kind, "chunk": 999, "open": {"chosen": chosen}}
        for size in range(0, len(data), 7)
        for kind in ("bytes", "stream")
    ]
    for found in run(*jobs):
        assert found.get("error") == "CorruptError", found


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("given", "error", "text"),
    [
        ({"answer": "longer"}, "SourceError", "more bytes than were asked for"),
        ({"answer": "shorter"}, "CorruptError", "cut off"),
        ({"answer": "none"}, "CorruptError", "cut off"),
        ({"answer": "failing"}, "SourceError", "503"),
        ({"answer": "cut"}, "SourceError", "connection lost"),
        ({"answer": "silent"}, "SourceError", "no data for"),
        ({"as": "stream", "chunk": 99, "broken": 3000}, "SourceError", "reset"),
        ({"open": {"closed": "call"}}, "Error", "of the caller"),
        (
            {"as": "stream", "chunk": 99, "stalled": -1, "open": {"closed": "file"}},
            "EgsError",
            "closed",
        ),
        ({"open": {"chosen": [[4, [0]]]}}, "RangeError", "level 4"),
        ({"open": {"chosen": [[1, [10]]]}}, "RangeError", "blocks 10"),
        ({"open": {"chosen": [[1, [0, 0]]]}}, "RangeError", "each once"),
        ({"open": {"shDegree": 4}}, "RangeError", "shDegree"),
    ],
    ids=str,
)
def test_failures_are_reported(given, error, text):
    chosen = {"chosen": [[0, list(range(38))]]}
    job = {"bytes": sample(), "as": "url", "workers": 1} | given
    if "stalled" in job:  # after the levels
        job["stalled"] = len(sample()) - 300
    (found,) = run(job | {"open": chosen | job.get("open", {})})
    assert found.get("error") == error, found
    assert text in found["message"]
    assert found["alive"] == 0
