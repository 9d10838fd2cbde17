"""FORMAT.md against the codec: the reference decoder written from the text gives the same bits."""

import struct
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from reference_channels import model_frequencies
from reference_decoder import decode, read_file
from reference_lattice import read_lattice
from reference_tools import frequencies
from scenes import edge_scenes, encode_by, made_up_guide, random_scene, with_far

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.entropygs.models import Component, MixtureModel
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.coding.frequency_table import normalise
from gs_codec.config import DEPTH_GROUPS, Config
from gs_codec.formats.ply.file import read_ply
from gs_codec.scene import other_comments

TINY = Path(__file__).parents[2] / "shared" / "scenes" / "tiny_sh3.ply"
ROWS = {
    "positions": ("x", "y", "z"),
    "f_dc": ("f_dc_0", "f_dc_1", "f_dc_2"),
    "f_rest": tuple(f"f_rest_{i}" for i in range(45)),
    "opacity": ("opacity",),
    "log_scale": ("scale_0", "scale_1", "scale_2"),
    "rot": ("rot_0", "rot_1", "rot_2", "rot_3"),
}


def config(profile="paper-m", extra="error", models="best", **depths):
    depths = {"rotation": 6} | {group.replace("_", "-"): bits for group, bits in depths.items()}
    return Config(profile, depths, extra=extra, threads=1, block_size=1024, models=models)


def lattice_config(profile="m", extra="error"):
    return Config(profile, extra=extra, threads=1, block_size=1024)


def scene_of(seed, count, sh_degree=3):
    return random_scene(count, sh_degree, seed)


def with_rows(scene, group, values):
    """The scene with constants in some rows of a group: {row: value}."""
    plane = getattr(scene, group).copy()
    for row, value in values.items():
        plane[row] = value
    return replace(scene, **{group: plane})


def far_apart(seed, count):
    """Positions up to the largest float32, whose cells reach beyond it."""
    scene = random_scene(count, seed=seed)
    largest = np.finfo(np.float32).max
    positions = scene.positions / np.abs(scene.positions).max() * largest
    positions[:, 0], positions[:, 1] = -largest, largest
    # Large ones, as small ones would be far Gaussians.
    return replace(scene, positions=positions, log_scale=scene.log_scale + np.float32(80))


def some_far(seed, count, number):
    return with_far(random_scene(count, 2, seed=seed), number, seed)


def identical(seed, count):
    return random_scene(1, seed=seed).take(np.zeros(count, dtype=np.intp))


def duplicated(seed, count):
    """Each Gaussian several times, in any order."""
    return random_scene(count // 8, seed=seed).take(
        np.random.default_rng(seed).integers(0, count // 8, count)
    )


def one_place(seed, count):
    return with_rows(random_scene(count, seed=seed), "positions", {0: 0.5, 1: -2.0, 2: 7.25})


def few_levels(seed, count):
    """Opacities and scales of a few far-apart values, for which no parametric model is near."""
    rng = np.random.default_rng(seed)
    opacity = rng.choice(
        [-5.0, -1.3, 0.2, 4.0, 9.0], size=(1, count), p=[0.4, 0.1, 0.3, 0.15, 0.05]
    )
    log_scale = rng.choice([-9.0, -7.0, -2.5, 0.0], size=(3, count), p=[0.5, 0.2, 0.2, 0.1])
    scene = random_scene(count, seed=seed)
    return replace(
        scene, opacity=opacity.astype(np.float32), log_scale=log_scale.astype(np.float32)
    )


def with_extra(seed, count):
    rng = np.random.default_rng(seed)
    extra = {
        "label": rng.integers(0, 5, count).astype(np.uint8),
        "offset": rng.integers(-128, 128, count).astype(np.int8),
        "rank": rng.integers(-30000, 30000, count).astype(np.int16),
        "tile": rng.integers(0, 65536, count).astype(np.uint16),
        "delta": rng.integers(-(2**31), 2**31, count).astype(np.int32),
        "id": rng.integers(0, 2**32, count).astype(np.uint32),
        "error": rng.normal(size=count).astype(np.float32),
        "time": rng.normal(size=count),
    }
    comments = ("trained for 30000 steps", "", "a\ttab")
    return replace(random_scene(count, 1, seed), has_normals=True, comments=comments, extra=extra)


def every_depth(bits):
    return {group.replace("-", "_"): bits for group in DEPTH_GROUPS}


CASES = {
    **{
        f"degree{degree}-seed{degree}": (scene_of, (degree, 200, degree), config())
        for degree in range(4)
    },
    **{f"count{count}-seed5": (scene_of, (5, count), config()) for count in (0, 1, 2, 33, 1500)},
    "count0-degree0-seed5": (scene_of, (5, 0, 0), config()),
    "count1024-degree0-seed5": (scene_of, (5, 1024, 0), config()),
    "count1025-degree0-seed5": (scene_of, (5, 1025, 0), config()),
    "identical-seed6": (identical, (6, 1100), config()),
    "duplicated-seed7": (duplicated, (7, 1500), config()),
    "one-place-seed8": (one_place, (8, 1100), config()),
    "few-levels-seed9": (few_levels, (9, 1500), config()),
    "all-1-bit-seed10": (scene_of, (10, 400), config(**every_depth(1))),
    "all-12-bits-seed11": (scene_of, (11, 400), config(**every_depth(12))),
    "12-bits-blocks-seed12": (scene_of, (12, 1500, 0), config(**every_depth(12))),
    "geometry21-seed13": (scene_of, (13, 1500, 0), config(geometry=21)),
    **{
        f"{profile}-seed14": (scene_of, (14, 300), config(profile, models="parametric"))
        for profile in ("paper-l", "paper-m", "paper-s")
    },
    "extra-seed15": (with_extra, (15, 1100), config(extra="keep")),
}


@cache
def encoded(case):
    make, arguments, settings = CASES[case]
    return encode_scene(make(*arguments), settings)


def assert_same(data):
    """Reference decoder and codec agree on every bit of a file; returns the reference's."""
    ours, reference = decode_scene(data), decode(data)
    assert (ours.count, ours.sh_degree) == (reference["count"], reference["sh_degree"])
    assert list(other_comments(ours.comments)) == reference["comments"]
    for name in ("has_normals", "antialiased", "coordinates"):
        assert getattr(ours, name) == reference[name], name
    assert list(ours.extra) == list(reference["extra"])
    for name, column in ours.extra.items():
        assert column.dtype == reference["extra"][name].dtype
        assert column.tobytes() == reference["extra"][name].tobytes(), name
    rows = [
        (name, row)
        for group, names in ROWS.items()
        for name, row in zip(names, getattr(ours, group), strict=False)
    ]
    assert {name for name, _ in rows} == set(reference["values"])
    for name, row in rows:
        np.testing.assert_array_equal(
            row.view(np.uint32), reference["values"][name].view(np.uint32), err_msg=name
        )
    return reference


@pytest.mark.one_in(3)
@pytest.mark.parametrize("case", CASES)
def test_reference_decoder_gives_the_same_bits(case):
    reference = assert_same(encoded(case)[0])
    assert reference["count"] == CASES[case][1][1]


@pytest.mark.parametrize(("group", "rows"), [
    ("positions", (0,)), ("positions", (1,)), ("positions", (2,)), ("positions", (0, 2)),
    ("f_dc", (0,)), ("f_dc", (1,)), ("f_dc", (2,)), ("f_dc", (0, 1)), ("f_dc", (0, 1, 2)),
    ("opacity", (0,)), ("log_scale", (0, 1, 2)), ("rot", (0, 1, 2, 3)),
    ("f_rest", (0, 5, 44)), ("f_rest", tuple(range(45))),
])  # fmt: skip
def test_constant_channels_seed20(group, rows):
    scene = with_rows(random_scene(150, seed=20), group, {row: 0.25 * (row + 1) for row in rows})
    reference = assert_same(encode_scene(scene, config())[0])
    constant = {ROWS[group][row] for row in rows}
    assert constant.isdisjoint(reference["symbols"])
    if group in ("positions", "f_dc"):
        assert all(
            np.all(reference["values"][ROWS[group][row]] == 0.25 * (row + 1)) for row in rows
        )


def test_identical_gaussians_have_no_symbols():
    assert decode(encoded("identical-seed6")[0])["symbols"] == {}


def test_cases_cover_every_model():
    models = {cost.model for case in CASES for cost in encoded(case)[1].costs}
    assert {"laplace", "mixture", "table"} <= models


LATTICE_CASES = {
    **{f"degree{degree}-seed{degree}": (scene_of, (degree, 200, degree)) for degree in range(4)},
    **{f"count{count}-seed5": (scene_of, (5, count)) for count in (0, 1, 2, 31, 33)},
    "blocks-seed5": (scene_of, (5, 1500)),
    "blocks-of-degree0-seed5": (scene_of, (5, 2049, 0)),
    "identical-seed6": (identical, (6, 1100)),
    "duplicated-seed7": (duplicated, (7, 1100)),
    "one-place-seed8": (one_place, (8, 200)),
    "few-levels-seed9": (few_levels, (9, 300)),
    "far-apart-seed16": (far_apart, (16, 50)),
    "one-far-seed17": (some_far, (17, 50, 1)),
    "many-far-seed18": (some_far, (18, 1100, 400)),
    "two-far-seed19": (some_far, (19, 3, 2)),
}


@pytest.mark.one_in(9)
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
@pytest.mark.parametrize("profile", ["l", "m", "s"])
@pytest.mark.parametrize("case", LATTICE_CASES)
def test_reference_decoder_gives_the_same_bits_of_lattices(case, profile, guided):
    make, arguments = LATTICE_CASES[case]
    guide = made_up_guide(seed=arguments[0]) if guided else None
    data = encode_by(make(*arguments), lattice_config(profile), guide)
    assert assert_same(data)["count"] == arguments[1]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", edge_scenes())
def test_reference_decoder_gives_the_same_bits_of_edge_scenes(name):
    data, _ = encode_scene(edge_scenes()[name], lattice_config("m"))
    assert_same(data)


def test_extra_of_lattices_is_carried_seed15():
    assert_same(encode_scene(with_extra(15, 1100), lattice_config("m", extra="keep"))[0])


def test_lattice_cases_have_classes_shifts_and_shared_tables():
    """What the text says of these is only tested where they differ."""
    scene, guide = scene_of(5, 1500), made_up_guide(seed=5)
    data = encode_by(scene, lattice_config("m"), guide)
    header, sections = read_file(data)
    lattice = read_lattice(sections[13, 0], header.sh_degree)
    assert min(lattice.classes) > 4
    assert lattice.rules["positions"].limit > 0
    assert any(c for rule in lattice.rules.values() for c in rule.c)
    assert any(len({id(table) for table in tables}) > 1 for tables in lattice.tables)
    assert any(len({id(table) for table in tables}) < len(tables) for tables in lattice.tables)


@pytest.mark.thorough
def test_tiny_scene():
    if not TINY.exists():
        pytest.skip(f"{TINY} is not here")
    scene = read_ply(TINY)
    data, report = encode_scene(scene, config("paper-l"))
    assert_same(data)
    assert {cost.model for cost in report.costs} >= {"table"}


@pytest.mark.parametrize("seed", range(30, 60))
def test_random_mixture_gives_the_same_table(seed):
    """Three and four components, and as many symbols as slots, which our encoder seldom writes."""
    rng = np.random.default_rng(seed)
    depth, number = int(rng.integers(1, 13)), int(rng.integers(1, 5))
    precision = int(rng.integers(max(8, depth), 16))
    highs = (65536, (1 << depth) + 1 << 16, 1 << int(rng.integers(2, depth + 17)))
    components = [[int(rng.integers(1, high)) for high in highs] for _ in range(number)]
    packed = b"".join(struct.pack("<HII", *component) for component in components)
    told = model_frequencies(struct.pack("<BBB", 1, precision, number) + packed, 1 << depth)
    model = MixtureModel(tuple(Component(*component) for component in components), precision)
    assert told == model.frequencies(1 << depth).frequencies.tolist()


@pytest.mark.parametrize("seed", range(60, 80))
def test_random_weights_give_the_same_table(seed):
    """Weights from 0 to 2^32, most of them far too small for a share of their own."""
    rng = np.random.default_rng(seed)
    weights = (2 ** rng.uniform(0, 32, 256)).astype(np.int64) * rng.integers(0, 2, 256)
    told = frequencies(weights.tolist(), 8)
    assert told == normalise(weights, 8).frequencies.tolist()


def test_version_that_is_told_is_the_files_own():
    for version, scene in enumerate((random_scene(5, 0), with_far(random_scene(5, 0), 1)), 1):
        assert inspect_bytes(encode_scene(scene, Config("m"))[0]).version == version
