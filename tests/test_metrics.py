"""Errors between scenes: known differences, and matching by the stored order."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import REAL_SCENES, edge_scenes, random_scene, shared_scene_path

from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import PROFILES, Config
from gs_codec.errors import InvalidInput
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import compare_files
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.attributes import compare_scenes
from gs_codec.metrics.comparison import Comparison, GroupError
from gs_codec.scene import Scene

UNITS = {
    "positions": ["scene units"],
    "f_dc": ["SH"],
    "f_rest": ["SH"],
    "opacity": ["logit", "0-1"],
    "scaling": ["log"],
    "rotation": ["stored", "degrees"],
}
EDGES = edge_scenes()


def error_of(comparison: Comparison, name: str, unit: str) -> GroupError:
    [group] = [g for g in comparison.groups if (g.name, g.unit) == (name, unit)]
    return group


def changed(scene: Scene, group: str, place, value: float) -> Scene:
    plane = getattr(scene, group).copy()
    plane[place] = value
    return replace(scene, **{group: plane})


def both_ways(first: Scene, second: Scene) -> Comparison:
    """The comparison, which must be symmetric."""
    comparison, back = compare_scenes(first, second), compare_scenes(second, first)
    near = partial(pytest.approx, abs=1e-6)
    for one, other in zip(comparison.groups, back.groups, strict=True):
        assert other == replace(one, max=near(one.max), rms=near(one.rms))
    return comparison


# Known differences


@pytest.mark.parametrize("name", EDGES)
def test_a_scene_has_no_error_against_itself(name):
    scene = EDGES[name]
    comparison = compare_scenes(scene, scene)
    assert comparison.counts == (scene.count, scene.count)
    assert comparison.matched_by == "index"
    names = [(name, unit) for name in UNITS for unit in UNITS[name]]
    if scene.sh_degree == 0:
        names.remove(("f_rest", "SH"))
    assert [(g.name, g.unit) for g in comparison.groups] == names
    assert {(g.max, g.rms) for g in comparison.groups} == {(0.0, 0.0)}


@pytest.mark.parametrize(
    ("group", "place", "name", "unit"),
    [
        ("positions", (1, 5), "positions", "scene units"),
        ("f_dc", (2, 0), "f_dc", "SH"),
        ("f_rest", (44, 9), "f_rest", "SH"),
        ("opacity", (0, 3), "opacity", "logit"),
        ("log_scale", (0, 7), "scaling", "log"),
        ("rot", (3, 2), "rotation", "stored"),
    ],
)
def test_a_single_difference_is_measured_in_its_attribute(group, place, name, unit):
    scene = changed(random_scene(10, 3), group, place, 1.0)
    comparison = both_ways(scene, changed(scene, group, place, 1.75))
    size = getattr(scene, group).size
    error = error_of(comparison, name, unit)
    assert (error.max, error.rms) == (0.75, pytest.approx(0.75 / np.sqrt(size)))
    others = [g for g in comparison.groups if g.name != name]
    assert {(g.max, g.rms) for g in others} == {(0.0, 0.0)}


def test_largest_and_mean_of_several_differences():
    scene = replace(random_scene(4, 0), positions=np.zeros((3, 4), np.float32))
    moved = np.zeros((3, 4), np.float32)
    moved[0, 1], moved[2, 3] = 3.0, -4.0
    error = error_of(both_ways(scene, replace(scene, positions=moved)), "positions", "scene units")
    assert (error.max, error.rms) == (4.0, pytest.approx(np.sqrt(25 / 12)))


def test_opacity_is_also_compared_after_the_sigmoid():
    scene = replace(random_scene(2, 0), opacity=np.zeros((1, 2), np.float32))
    other = changed(scene, "opacity", (0, 1), np.log(3))
    comparison = both_ways(scene, other)
    assert error_of(comparison, "opacity", "0-1").max == pytest.approx(0.25)
    assert error_of(comparison, "opacity", "0-1").rms == pytest.approx(0.25 / np.sqrt(2))
    assert error_of(comparison, "opacity", "logit").max == pytest.approx(np.log(3))


def turned(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    half = np.radians(degrees) / 2
    unit = np.array(axis) / np.linalg.norm(axis)
    return np.array([np.cos(half), *(np.sin(half) * unit)])[:, None]


def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    (w, x, y, z), (a, b, c, d) = first, second
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )


def angle_between(first: np.ndarray, second: np.ndarray) -> float:
    scene = replace(random_scene(1, 0), log_scale=np.array([[-1.0], [-3.0], [-2.0]], np.float32))
    first, second = (replace(scene, rot=q.astype(np.float32)) for q in (first, second))
    return error_of(both_ways(first, second), "rotation", "degrees").max


@pytest.mark.parametrize("factor", [1.0, -1.0, 0.3, -20.0])
@pytest.mark.parametrize("degrees", [0.0, 0.01, 1.0, 30.0, 60.0, 80.0])
def test_rotation_by_a_known_angle(degrees, factor):
    """Neither the sign nor the norm of a quaternion is a rotation."""
    start = turned((1, -2, 0.5), 71)
    other = factor * product(start, turned((0.2, 1, -3), degrees))
    assert angle_between(start, other) == pytest.approx(degrees, abs=2e-5)


@pytest.mark.parametrize("degrees", [100.0, 180.0, 190.0, 270.0, 359.0])
def test_the_short_way_round_counts_and_half_turns_do_not(degrees):
    identity = turned((1, 0, 0), 0)
    expected = abs((degrees + 90) % 180 - 90)
    assert angle_between(identity, turned((0, 1, 0), degrees)) == pytest.approx(expected, abs=2e-5)


EQUAL = ("scales", "axis", "degrees", "expected")


@pytest.mark.parametrize(EQUAL, [
    ((-1, -1, -1), (1, 2, 3), 118, 0),
    ((-1, -1.04, -0.97), (1, 2, 3), 118, 0),
    ((-1, -1, -3), (0, 0, 1), 70, 0),
    ((-1, -3, -3.03), (1, 0, 0), 70, 0),
    ((-1, -3, -1), (1, 0, 0), 25, 25),
    ((-1, -3, -3), (0, 1, 0), 130, 50),
    ((-1, -1.06, -3), (0, 0, 1), 70, 70),
])  # fmt: skip
def test_turns_about_an_axis_whose_others_are_equal_are_no_error(scales, axis, degrees, expected):
    scene = replace(random_scene(1, 0), log_scale=np.float32(scales)[:, None])
    start = turned((1, -2, 0.5), 71)
    first, second = (
        replace(scene, rot=q.astype(np.float32))
        for q in (start, product(start, turned(axis, degrees)))
    )
    error = error_of(both_ways(first, second), "rotation", "degrees")
    assert error.max == pytest.approx(expected, abs=2e-5)


def test_axes_in_another_order_are_no_error():
    scene = random_scene(50, 0, seed=5)
    # Axes x, y, z become y, z, x: 120 degrees about the diagonal.
    quarter = np.full((4, 1), 0.5)
    other = replace(
        scene,
        log_scale=scene.log_scale[[1, 2, 0]],
        rot=-3 * product(scene.rot, quarter).astype(np.float32),
    )
    errors = {(g.name, g.unit): g.max for g in both_ways(scene, other).groups}
    assert errors["scaling", "log"] == 0
    assert errors["rotation", "stored"] < 1e-6
    assert errors["rotation", "degrees"] < 1e-4


@pytest.mark.parametrize("value", [0.0, -0.0])
def test_zero_quaternion_is_the_identity(value):
    zero = np.full((4, 1), value)
    assert angle_between(zero, turned((1, 0, 0), 0)) == 0
    assert angle_between(zero, zero) == 0
    assert angle_between(zero, turned((1, 0, 0), 40)) == pytest.approx(40, abs=2e-5)


@pytest.mark.parametrize("degrees", [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)], ids=str)
def test_missing_bands_count_as_zero(degrees):
    low, high = degrees
    few, many = ((low + 1) ** 2 - 1, (high + 1) ** 2 - 1)
    scene = random_scene(20, high, seed=3)
    rest = scene.f_rest.reshape(3, many, 20).copy()
    cut = replace(scene, f_rest=rest[:, :few].reshape(-1, 20))
    padded = rest.copy()
    padded[:, few:] = 0
    padded = replace(scene, f_rest=padded.reshape(-1, 20))
    assert {g.max for g in both_ways(cut, padded).groups} == {0.0}
    error = error_of(both_ways(cut, scene), "f_rest", "SH")
    assert error.max == np.abs(rest[:, few:]).max()
    expected = np.sqrt((rest[:, few:].astype(np.float64) ** 2).sum() / rest.size)
    assert error.rms == pytest.approx(expected)


@pytest.mark.parametrize("sh_degree", [(0, 0), (0, 3), (3, 3)], ids=str)
def test_empty_scenes_have_no_error(sh_degree):
    first, second = (random_scene(0, degree) for degree in sh_degree)
    comparison = both_ways(first, second)
    assert comparison.counts == (0, 0)
    assert {(g.max, g.rms) for g in comparison.groups} == {(0.0, 0.0)}


@pytest.mark.parametrize("counts", [(0, 1), (5, 6), (6, 5)], ids=str)
def test_different_counts_are_refused(counts):
    first, second = (random_scene(count, 0) for count in counts)
    with pytest.raises(InvalidInput, match=f"{counts[0]} Gaussians? against {counts[1]}"):
        compare_scenes(first, second)


def test_largest_floats_give_finite_errors():
    scene, largest = random_scene(5, 1), np.finfo(np.float32).max
    first, second = scene, scene
    for group in ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot"):
        first = changed(first, group, (0, 1), largest)
        second = changed(second, group, (0, 1), -largest)
    comparison = both_ways(first, second)
    assert np.isfinite([(g.max, g.rms) for g in comparison.groups]).all()
    assert error_of(comparison, "opacity", "0-1").max == 1.0
    assert error_of(comparison, "positions", "scene units").max == 2 * float(largest)


@pytest.mark.parametrize("group", ["positions", "f_dc", "f_rest", "opacity", "log_scale", "rot"])
def test_nan_is_never_reported_as_no_error(group):
    scene = random_scene(5, 1)
    broken = changed(scene, group, (0, 1), np.nan)
    comparison = compare_scenes(scene, broken)
    name = {"log_scale": "scaling", "rot": "rotation"}.get(group, group)
    for unit in UNITS[name]:
        error = error_of(comparison, name, unit)
        assert np.isnan([error.max, error.rms]).all(), unit


@pytest.mark.parametrize("value", [np.inf, -np.inf])
@pytest.mark.parametrize("group", ["positions", "f_rest", "opacity"])
def test_the_same_infinity_is_no_error(group, value):
    scene = changed(random_scene(5, 1), group, (0, 1), value)
    assert {g.max for g in compare_scenes(scene, scene).groups} == {0.0}


# Matching through the stored order


def repeated(seed: int, share_colours: bool) -> Scene:
    """Every position four times, with different other attributes, shuffled."""
    rng = np.random.default_rng(seed)
    scene = random_scene(2000, 1, seed)
    source = rng.permutation(np.repeat(np.arange(500), 4))
    scene = replace(scene, positions=scene.positions[:, source])
    return replace(scene, f_dc=scene.f_dc[:, source]) if share_colours else scene


def on_ties(seed: int) -> Scene:
    """Positions halfway between 16-bit levels."""
    rng = np.random.default_rng(seed)
    positions = rng.integers(0, 65535, (3, 2000)).astype(np.float32) + np.float32(0.5)
    positions[:, 0], positions[:, 1] = 0, 65535
    return replace(random_scene(2000, 1, seed), positions=positions)


SCENES = {
    "plain-seed20": lambda: random_scene(3000, 3, seed=20),
    "positions-four-times-seed21": lambda: repeated(21, share_colours=False),
    "positions-and-colours-four-times-seed22": lambda: repeated(22, share_colours=True),
    "ties-seed23": lambda: on_ties(23),
    **{f"edge {name}": scene for name, scene in EDGES.items()},
}
CONFIGS = {
    "paper-m": Config("paper-m"),
    "paper-s": Config("paper-s", block_size=1024),
    "coarse": Config("paper-m", depths={"geometry": 3, "sh-dc": 1}),
    "fine": Config("paper-m", depths={"geometry": 21, "sh-dc": 12}),
}


def half_step(path, group: str) -> float:
    """Half the largest step of a group, plus float32 rounding of its largest value."""
    channels = [c for c in inspect_bytes(path.read_bytes()).channels if c.group == group]
    steps = [c.quantiser.step for c in channels]
    ends = [c.quantiser.origin + c.quantiser.step * 2**c.quantiser.depth for c in channels]
    return 0.5000001 * max(steps) + np.spacing(np.float32(np.abs(ends).max()))


def assert_matched(comparison: Comparison, egs) -> None:
    assert comparison.matched_by == "stored order"
    for group, name, unit in (
        ("positions", "positions", "scene units"),
        ("f_dc", "f_dc", "SH"),
        ("opacity", "opacity", "logit"),
        ("log_scale", "scaling", "log"),
        ("rot", "rotation", "stored"),
    ):
        assert error_of(comparison, name, unit).max <= half_step(egs, group), name


@pytest.mark.one_in(4)
@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("name", SCENES)
def test_original_is_matched_with_its_decoded_version(name, config, tmp_path):
    scene = SCENES[name]() if callable(SCENES[name]) else SCENES[name]
    ply, egs, decoded = (tmp_path / n for n in ("scene.ply", "scene.egs", "decoded.ply"))
    write_ply(ply, scene)
    encode_file(ply, egs, CONFIGS[config])
    decode_file(egs, decoded)
    with_egs = compare_files(ply, egs)
    assert_matched(with_egs, egs)
    for pair in ((egs, ply), (ply, decoded), (decoded, ply)):
        assert compare_files(*pair) == with_egs


@pytest.mark.thorough
@pytest.mark.parametrize("name", REAL_SCENES)
def test_real_scene_is_matched_with_its_encoded_version(name, tmp_path):
    ply, egs = shared_scene_path(name), tmp_path / "scene.egs"
    encode_file(ply, egs, Config("paper-m"))
    assert_matched(compare_files(ply, egs), egs)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("first", ["ply", "decoded", "egs"])
def test_scenes_coded_twice_are_never_matched_wrongly(trio, first, profile, tmp_path):
    """An error is right if the order is ambiguous; comparing in a wrong order is not."""
    again = tmp_path / "again.egs"
    encode_file(trio.decoded, again, Config(profile))
    try:
        comparison = compare_files(getattr(trio, first), again)
    except InvalidInput:
        return
    bound = half_step(trio.egs, "positions") + half_step(again, "positions")
    assert error_of(comparison, "positions", "scene units").max <= bound


def test_versions_in_the_same_order_are_matched_by_index(trio):
    comparison = compare_files(trio.decoded, trio.egs)
    assert comparison.matched_by == "index"
    assert {g.max for g in comparison.groups} == {0.0}


def test_originals_are_matched_by_index(trio, tmp_path):
    scene = read_ply(trio.ply)
    moved = replace(scene, positions=scene.positions + np.float32(1))
    write_ply(tmp_path / "moved.ply", moved)
    comparison = compare_files(trio.ply, tmp_path / "moved.ply")
    assert comparison.matched_by == "index"
    assert error_of(comparison, "positions", "scene units").max == pytest.approx(1, abs=1e-6)
    assert error_of(comparison, "rotation", "degrees").max == 0


def test_versions_in_other_orders_are_matched_by_the_nearest(trio, tmp_path):
    scene = read_ply(trio.ply)
    order = np.random.default_rng(24).permutation(scene.count)
    write_ply(tmp_path / "shuffled.ply", scene.take(order))
    shuffled = compare_files(trio.ply, tmp_path / "shuffled.ply")
    assert shuffled.matched_by == "nearest centre"
    assert {g.max for g in shuffled.groups} == {0}
    coarse = tmp_path / "coarse.egs"
    encode_file(trio.ply, coarse, Config("paper-m", depths={"geometry": 9}))
    comparison = compare_files(trio.egs, coarse)
    assert comparison.matched_by == "nearest centre"
    bound = half_step(trio.egs, "positions") + half_step(coarse, "positions")
    assert error_of(comparison, "positions", "scene units").max <= bound


def test_scenes_without_a_match_have_no_errors(trio, tmp_path):
    for count, message in (
        (1500, "Gaussians of the scenes do not match"),
        (3, "1,500 Gaussians against 3"),
    ):
        write_ply(tmp_path / "other.ply", random_scene(count, 1, seed=25))
        with pytest.raises(
            InvalidInput, match=rf"{message}.*so there are no errors by attribute: .*cameras="
        ):
            compare_files(trio.ply, tmp_path / "other.ply")


@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_scenes_of_two_coordinate_systems_are_compared_in_one(profile, tmp_path):
    scene = random_scene(300, 3, seed=25)
    paths = [tmp_path / name for name in ("rdf.ply", "rub.ply", "rdf.egs", "rub.egs")]
    turned = turn_axes(scene, "RUB")
    for path, each in zip(paths, (scene, turned), strict=False):
        write_ply(path, each)
        encode_file(path, path.with_suffix(".egs"), Config(profile))
    expected = compare_files(paths[0], paths[2])
    assert {g.max for g in compare_files(*paths[:2]).groups} == {0}
    for first, second in ((0, 1), (1, 0), (1, 2), (2, 1), (0, 3), (3, 0)):
        comparison = compare_files(paths[first], paths[second])
        assert comparison.systems == tuple(
            "RDF" if place % 2 == 0 else "RUB" for place in (first, second)
        )
        if 2 in (first, second):
            assert replace(comparison, systems=expected.systems) == expected


def test_two_real_formats_of_a_scene_are_compared_in_one_system():
    pair = [shared_scene_path(name) for name in ("biker.spz", "biker.compressed.ply")]
    comparison = compare_files(*pair)
    assert comparison.systems == ("RUB", "RDF")
    assert error_of(comparison, "positions", "scene units").max < 2**-13 + 1e-6
    assert error_of(comparison, "rotation", "degrees").max < 0.2


@pytest.mark.parametrize("depths", ["16 16 16", "16 16 16 8 8 x", "16 16 16 8 8 22", "-1 " * 6])
def test_invalid_order_is_refused(trio, depths, tmp_path):
    path = tmp_path / "odd.ply"
    write_ply(path, replace(read_ply(trio.ply), comments=(f"gs_codec order {depths}",)))
    with pytest.raises(InvalidInput, match=r"odd\.ply: .*expected six depths"):
        compare_files(trio.ply, path)


def test_infinite_logits_are_compared_as_opacities():
    first = random_scene(50, 0, seed=3)
    second = replace(first, opacity=first.opacity.copy())
    first.opacity[0, :2] = np.inf, -np.inf
    second.opacity[0, :3] += np.float32(0.5)
    errors = {(g.name, g.unit): g.max for g in compare_scenes(first, second).groups}
    assert errors["opacity", "logit"] == pytest.approx(0.5, abs=1e-5)
    seen = 1 / (1 + np.exp(-second.opacity[0, :2].astype(float)))
    assert errors["opacity", "0-1"] == pytest.approx(max(1 - seen[0], seen[1]), abs=0.13)
