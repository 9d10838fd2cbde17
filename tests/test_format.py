"""FORMAT.md against the codec: a reference decoder, written from the text, gives the same bits."""

import struct
from pathlib import Path

import numpy as np
import pytest
from format_cases import (
    CASES,
    LATTICE_CASES,
    ROWS,
    assert_same_values,
    config,
    encoded,
    lattice_config,
    scene_of,
    with_extra,
    with_rows,
)
from reference_channels import model_frequencies
from reference_decoder import decode, read_file
from reference_lattice import read_lattice
from reference_tools import frequencies
from scenes import edge_scenes, encode_by, made_up_guide, random_scene, with_far

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.entropygs.models import Component, MixtureModel
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.coding.frequency_table import normalise
from gs_codec.config import Config
from gs_codec.formats.ply.file import read_ply
from gs_codec.scene import other_comments

TINY = Path(__file__).parents[2] / "shared" / "scenes" / "tiny_sh3.ply"


def assert_same(data):
    """Reference decoder and codec agree on every bit of a file; return the reference's result."""
    ours, reference = decode_scene(data), decode(data)
    assert (ours.count, ours.sh_degree) == (reference["count"], reference["sh_degree"])
    assert list(other_comments(ours.comments)) == reference["comments"]
    for name in ("has_normals", "antialiased", "coordinates"):
        assert getattr(ours, name) == reference[name], name
    assert list(ours.extra) == list(reference["extra"])
    for name, column in ours.extra.items():
        assert column.dtype == reference["extra"][name].dtype
        assert column.tobytes() == reference["extra"][name].tobytes(), name
    assert_same_values(ours, reference["values"])
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


def test_extra_properties_with_lattices_round_trip_seed15():
    assert_same(encode_scene(with_extra(15, 1100), lattice_config("m", extra="keep"))[0])


def test_lattice_cases_have_classes_shifts_and_shared_tables():
    """The text on these is only tested where they vary."""
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
    """Weights from 0 to 2^32, most of them far too small for a slot of their own."""
    rng = np.random.default_rng(seed)
    weights = (2 ** rng.uniform(0, 32, 256)).astype(np.int64) * rng.integers(0, 2, 256)
    told = frequencies(weights.tolist(), 8)
    assert told == normalise(weights, 8).frequencies.tolist()


def test_reported_version_is_the_files_own():
    for version, scene in enumerate((random_scene(5, 0), with_far(random_scene(5, 0), 1)), 1):
        assert inspect_bytes(encode_scene(scene, Config("m"))[0]).version == version
