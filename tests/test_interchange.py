"""Scenes in the formats of other programs: content, precision and size."""

from __future__ import annotations

import gzip
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from orbits import cameras
from requested import as_requested
from scenes import assert_same_floats, edge_scenes, random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.cli.main import app
from gs_codec.codecs import encode_scene
from gs_codec.codecs.adaptive.step_conversion import camera_free_steps, wanted_steps
from gs_codec.codecs.decode import decode_as
from gs_codec.coding.morton import spatial_order
from gs_codec.config import ADAPTIVE_PROFILES, Config
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import compare_files, read_scene
from gs_codec.files.writing import write_scene
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.packed_values import largest_omitted, largest_restored
from gs_codec.formats.ply.packed import pack_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.sog.writer import pack_sog
from gs_codec.formats.spz.scene import pack_spz
from gs_codec.metrics.attributes import compare_scenes
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.reference_views import draw_reference_views
from gs_codec.preparation.view_selection import choose_views
from gs_codec.runtime.optional import is_available
from gs_codec.scene import ANTIALIASED, Scene
from samples.generate import generate

#: test_usd reports if usd-core is not installed.
USD = ("usdz",) if is_available("pxr") else ()
ALL = ("spz", "sog", "rad", "compressed.ply", "splat", "glb", "gltf", *USD)
ROUNDING = ("spz", "sog", "rad", "compressed.ply", "splat")
SORTED = ("spz", "sog", "compressed.ply")
WITH_STEPS = ("spz", "sog", "rad")
EDGES = edge_scenes()


def usual(count: int, degree: int, seed: int = 0) -> Scene:
    """A random scene with values that all formats can represent."""
    scene = random_scene(count, degree, seed)
    return replace(
        scene,
        f_dc=np.clip(scene.f_dc, -1.5, 1.5),
        f_rest=np.clip(scene.f_rest, -0.9, 0.9),
        log_scale=np.clip(scene.log_scale, -9.5, 5),
    )


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def share(scene: Scene) -> np.ndarray:
    return 1 / (1 + np.exp(-scene.opacity.astype(np.float64)))


def angle(first: Scene, second: Scene) -> np.ndarray:
    """Angles between rotations, in radians."""
    a, b = (s.rot / np.linalg.norm(s.rot.astype(np.float64), axis=0) for s in (first, second))
    return 2 * np.arccos(np.clip(np.abs((a * b).sum(axis=0)), 0, 1))


# .spz


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [1, 2, 700])
def test_spz_errors_are_within_half_a_step(count, degree, version, tmp_path):
    scene = usual(count, degree, seed=count + degree)
    data, lost = pack_spz(scene, version)
    back = read_scene(written(tmp_path / "a.spz", data))
    scene = scene.take(spatial_order(scene.positions))
    assert (back.count, back.sh_degree, back.coordinates) == (count, degree, "RDF")
    np.testing.assert_allclose(back.positions, scene.positions, atol=2.0**-17 + 1e-7)
    np.testing.assert_allclose(back.f_dc, scene.f_dc, atol=0.5 / 255 / 0.15 + 1e-6)
    np.testing.assert_allclose(back.f_rest, scene.f_rest, atol=0.5 / 128 + 1e-7)
    np.testing.assert_allclose(back.log_scale, scene.log_scale, atol=0.5 / 16 + 1e-6)
    np.testing.assert_allclose(share(back), share(scene), atol=0.5 / 255 + 0.26 / 255)
    assert angle(back, scene).max() < 4 * np.sqrt(0.5) / 511
    assert lost == ("opacity, colours, scales and SH rounded to 8 bits, rotations to 10",)


def test_headers_of_spz_are_as_specified():
    scene = replace(usual(9, 2), comments=(ANTIALIASED,))
    plain = gzip.decompress(pack_spz(scene, 3)[0])
    assert struct.unpack("<4sIIBBBB", plain[:16]) == (b"NGSP", 3, 9, 2, 16, 1, 0)
    assert len(plain) == 16 + 9 * (9 + 1 + 3 + 3 + 4 + 24)
    data = pack_spz(scene, 4)[0]
    head = struct.unpack("<4sIIBBBBI12x", data[:32])
    assert head == (b"NGSP", 4, 9, 2, 16, 1, 6, 32)
    table = np.frombuffer(data[32 : 32 + 96], "<u8").reshape(6, 2)
    assert table[:, 1].tolist() == [9 * size for size in (9, 1, 3, 3, 4, 24)]
    assert 128 + table[:, 0].sum() == len(data)
    first = zstandard.ZstdDecompressor().decompress(data[128 : 128 + int(table[0, 0])])
    assert first == plain[16 : 16 + 81]


def test_spz_has_fewer_fraction_bits_for_far_centres(tmp_path):
    for farthest, bits in ((100.0, 16), (130.0, 15), (3000.0, 11), (1e7, 0)):
        scene = usual(20, 0)
        positions = scene.positions * np.float32(farthest / np.abs(scene.positions).max())
        scene = replace(scene, positions=positions)
        data, lost = pack_spz(scene)
        assert gzip.decompress(data)[13] == bits
        assert len(lost) == 1 + (farthest > 1 << 23)
        back = read_scene(written(tmp_path / "a.spz", data))
        ordered = positions[:, spatial_order(positions)]
        bound = np.float32(2.0 ** (-bits - 1)) + np.spacing(np.float32(farthest))
        inside = np.abs(ordered) < 1 << 23
        assert np.abs(back.positions - ordered)[inside].max() <= bound


@pytest.mark.parametrize(("unit", "typed"), [(8.0, "0.001"), (-9.0, "100000")])
def test_scenes_in_other_units_are_told_the_scale_that_fits_spz(unit, typed):
    sizes = np.linspace(unit - 6, unit - 2, 150, dtype=np.float32)
    scene = replace(usual(50, 1), log_scale=sizes.reshape(3, 50))
    hint = f"scaled by {typed}, the scene would fit the format's range better"
    assert hint in pack_spz(scene)[1]
    fitted = np.array(scene.log_scale)
    fitted[:] = -4
    fitted[0, :20] = -30  # outliers, which no scale brings into the range
    lost = pack_spz(replace(scene, log_scale=fitted))[1]
    assert "log-scales of 20 Gaussians clipped to the format's range" in lost
    assert not any("scaled by" in line for line in lost)
    for beyond in (-3e38, -1e30, -800.0, 800.0, 3e38):  # whose powers of ten no float holds
        lost = pack_spz(replace(scene, log_scale=np.full_like(fitted, beyond)))[1]
        assert not any("scaled by" in line for line in lost)


def test_values_out_of_range_of_spz_are_clipped_and_counted(tmp_path):
    scene = usual(50, 1)
    f_dc, f_rest, log_scale = scene.f_dc.copy(), scene.f_rest.copy(), scene.log_scale.copy()
    f_dc[:, :3], f_rest[4, :5], log_scale[1, :7] = 4, -1.5, -30
    scene = replace(scene, f_dc=f_dc, f_rest=f_rest, log_scale=log_scale)
    data, lost = pack_spz(scene)
    for line in ("colours of 3", "log-scales of 7", "SH of 5"):
        assert f"{line} Gaussians clipped to the format's range" in lost
    back = read_scene(written(tmp_path / "a.spz", data))
    assert back.log_scale.min() == -10
    assert np.abs(back.f_rest).max() >= 127 / 128
    assert back.f_dc.max() == pytest.approx(0.5 / 0.15)


def varied_steps() -> AttributeSteps:
    """Steps of 2,000 Gaussians."""
    rng = np.random.default_rng(0)
    return AttributeSteps(
        positions=np.exp(rng.normal(-5, 1, 2000)),
        f_dc=np.exp(rng.normal(-4, 1, 2000)),
        f_rest=np.exp(rng.normal(-3, 1, (3, 2000))),
        opacity=np.exp(rng.normal(-2, 1, 2000)),
        log_scale=np.exp(rng.normal(-2, 1, (3, 2000))),
        rot=np.exp(rng.normal(-4, 1, 2000)),
    )


@pytest.mark.parametrize("version", [3, 4])
def test_effort_makes_an_spz_smaller(version, tmp_path):
    scene, steps = usual(2000, 3), varied_steps()
    efforts = ("fast", "normal", "high")
    files = [pack_spz(scene, version, steps, effort)[0] for effort in efforts]
    fast, normal, high = map(len, files)
    assert fast != normal > high < fast
    for number, data in enumerate(files):
        back = read_scene(written(tmp_path / f"{number}.spz", data))
        np.testing.assert_array_equal(back.positions, read_scene(tmp_path / "0.spz").positions)


def test_steps_make_an_spz_smaller_and_bound_its_errors(tmp_path):
    scene = usual(2000, 3)
    order = spatial_order(scene.positions)
    steps = varied_steps()
    data, _ = pack_spz(scene, 4, steps)
    assert len(data) < 0.8 * len(pack_spz(scene, 4)[0])
    back, scene = read_scene(written(tmp_path / "a.spz", data)), scene.take(order)
    steps = steps.take(order)
    assert (np.abs(back.positions - scene.positions) <= np.maximum(steps.positions, 2.0**-16)).all()
    assert (np.abs(back.log_scale - scene.log_scale) <= np.maximum(steps.log_scale, 1 / 16)).all()
    bands = [0] * 3 + [1] * 5 + [2] * 7
    allowed = np.maximum(np.tile(steps.f_rest[bands], (3, 1)), 1 / 128)
    assert (np.abs(back.f_rest - scene.f_rest) <= allowed).all()
    # Rounded to multiples of powers of two, as many as the step allows.
    levels = np.rint(128 * back.f_rest)
    octaves = np.floor(np.log2(np.clip(128 * np.tile(steps.f_rest[bands], (3, 1)), 1, 128)))
    inside = levels < 127
    assert (np.mod(levels, 2.0**octaves)[inside] == 0).all()


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_quaternions_of_any_norm_lose_their_largest(scale):
    rng = np.random.default_rng(1)
    rot = rng.normal(size=(4, 500)).astype(np.float32)
    rot[:, :4] = np.eye(4)
    rot[:, 4:8] = -np.eye(4)
    three, largest = largest_omitted(rot * np.float32(scale))
    unit = rot / np.linalg.norm(rot, axis=0)
    back = largest_restored(three, largest)
    np.testing.assert_allclose(np.abs((back * unit).sum(axis=0)), 1, atol=1e-6)
    assert np.abs(three).max() <= np.sqrt(0.5) + 1e-12
    three, largest = largest_omitted(np.zeros((4, 1), np.float32))
    assert (three.ravel().tolist(), largest.tolist()) == ([0, 0, 0], [0])


# .compressed.ply


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [1, 255, 256, 257, 700])
def test_packed_ply_errors_are_within_half_a_step(count, degree, tmp_path):
    scene = usual(count, degree, seed=count)
    data, _ = pack_ply(scene)
    back = read_scene(written(tmp_path / "a.compressed.ply", data))
    scene = scene.take(spatial_order(scene.positions))
    for first in range(0, count, 256):
        some = slice(first, first + 256)
        for group, bits in (("positions", (11, 10, 11)), ("log_scale", (11, 10, 11))):
            for row, width in enumerate(bits):
                values, read = (getattr(s, group)[row, some] for s in (scene, back))
                step = np.ptp(values) / ((1 << width) - 1)
                assert np.abs(values - read).max() <= 0.5 * step + 1e-6
        for values, read in zip(scene.f_dc[:, some], back.f_dc[:, some], strict=True):
            assert np.abs(values - read).max() <= 0.5 * np.ptp(values) / 255 + 1e-5
    np.testing.assert_allclose(back.f_rest, scene.f_rest, atol=0.5 / 32 + 1e-6)
    np.testing.assert_allclose(share(back), share(scene), atol=0.5 / 255 + 0.26 / 255)
    assert angle(back, scene).max() < 4 * np.sqrt(2) / 1023
    assert len(data) == data.index(b"end_header\n") + 11 + (
        -(-count // 256) * 72 + count * (16 + 3 * (0, 3, 8, 15)[degree])
    )


# All formats


@pytest.mark.one_in(8)
@pytest.mark.parametrize("form", ALL)
@pytest.mark.parametrize("name", EDGES)
def test_edge_scenes_are_written_and_read(name, form, tmp_path):
    scene = EDGES[name]
    config = Config(format=form)
    if name == "huge range" and form in ("splat", "glb", "gltf", *USD):
        with pytest.raises(InvalidInput, match="log-scale"):
            encode_scene(scene, config)
        return
    if name == "empty" and form in ("rad", "splat", "glb", "gltf"):
        with pytest.raises(InvalidInput, match="no Gaussians"):
            encode_scene(scene, config)
        return
    with np.errstate(all="raise", under="ignore"):
        data, report = encode_scene(scene, config)
    assert report.file_bytes == len(data)
    back = read_scene(written(tmp_path / f"a.{form}", data))
    assert back.count == report.count == scene.count
    for group in ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot"):
        assert np.isfinite(getattr(back, group)).all()


@pytest.mark.thorough
@pytest.mark.parametrize("form", ALL)
def test_threads_do_not_change_bytes(form):
    scene = random_scene(70_000, 1)
    first, second = (encode_scene(scene, Config(format=form, threads=n))[0] for n in (1, 2))
    assert first == second


@pytest.mark.parametrize("form", ALL)
def test_nonfinite_values_are_refused(form):
    scene = random_scene(30, 1)
    f_rest = scene.f_rest.copy()
    f_rest[2, 7] = np.inf
    scene = replace(scene, f_rest=f_rest)
    with pytest.raises(InvalidInput, match="not finite: 1 in f_rest"):
        encode_scene(scene, Config(format=form))
    assert encode_scene(scene, Config(format=form, nonfinite="drop"))[1].count == 29
    for pack in (pack_spz, pack_ply, pack_sog):
        with pytest.raises(InvalidInput, match="not finite"):
            pack(scene)


@pytest.mark.parametrize("form", ["spz", "sog"])
def test_profiles_choose_how_finely_a_file_is_written(form):
    scene = usual(3000, 3)
    sizes = [len(encode_scene(scene, Config(p, format=form))[0]) for p in "lms"]
    assert sizes[0] > 1.05 * sizes[1] > 1.1 * sizes[2]


def test_wanted_steps_are_those_of_the_rules():
    scene = replace(usual(5, 3), rot=np.tile([[1], [0], [0], [0]], 5).astype(np.float32))
    scene = replace(scene, log_scale=np.array([[-3, -1, -2]] * 5, np.float32).T)
    found = camera_free_steps(scene, ADAPTIVE_PROFILES["m"])
    steps = wanted_steps(scene, found)
    known = [1, min(float(scene.opacity[0, 2]), 0), -1, -2, -3]
    for rule, value in (
        ("position", steps.positions[2]),
        ("colour", steps.f_dc[2]),
        ("opacity", steps.opacity[2]),
        ("scale_0", steps.log_scale[1, 2]),
        ("scale_1", steps.log_scale[2, 2]),
        ("scale_2", steps.log_scale[0, 2]),
    ):
        assert value == pytest.approx(2.0 ** float(found.coefficients[rule] @ known))
    turns = [2.0 ** float(found.coefficients[f"turn_{k}"] @ known) for k in range(3)]
    assert min(turns) <= steps.rot[2] <= max(turns)
    np.testing.assert_allclose(steps.f_rest, np.tile(steps.f_dc * 2.0**-0.25, (3, 1)))


# With cameras, and to targets


@pytest.fixture(scope="module")
def seen() -> tuple[Scene, Plan]:
    """A scene of surfaces, and a plan with cameras around it."""
    scene = generate(count=4000, sh_degree=2, seed=3)
    return scene, Plan(Steps(), cameras(12))


def loss(scene: Scene, coded: Scene, plan: Plan) -> float:
    """Mean squared error of a coded scene in the plan's own views."""
    views = draw_reference_views(scene, list(plan.cameras), plan.background)
    return views.error(coded)


@pytest.mark.thorough
@pytest.mark.parametrize("form", ROUNDING)
def test_colours_compensate_for_rounding(form, seen):
    scene, plan = seen
    config = Config(format=form)
    plain = as_requested(scene, config)[0]
    size = int(0.9 * len(plain)) if form in WITH_STEPS else len(plain)
    rate = {"size": size} if form in WITH_STEPS else None
    guided = as_requested(scene, config, plan, rate)[0]
    assert 0.98 * size <= len(guided) <= size
    before, after = (loss(scene, decode_as(config, data), plan) for data in (plain, guided))
    assert after < 0.7 * before


@pytest.mark.thorough
def test_sizes_of_an_spz_are_met_from_below(seen):
    scene, plan = seen
    size = int(0.8 * len(encode_scene(scene, Config(format="spz"))[0]))
    for chosen in (None, plan):
        data, report = as_requested(scene, Config(format="spz"), chosen, {"size": size})
        assert 0.98 * size <= len(data) <= size
        assert report.rate.steps == {}


@pytest.mark.one_in(3)
@pytest.mark.parametrize("form", ["compressed.ply", "splat", "glb"])
def test_sizes_of_fixed_formats_are_met_by_pruning(form, seen):
    scene, plan = seen
    whole = len(encode_scene(scene, Config(format=form))[0])
    size = int(0.7 * whole)
    data, report = as_requested(scene, Config(format=form), plan, {"size": size})
    assert 0.97 * size <= len(data) <= size
    assert report.rate.pruned == scene.count - report.count > 0.25 * scene.count
    data, report = as_requested(scene, Config(format=form), None, {"size": whole})
    assert (len(data), report.rate.pruned) == (whole, 0)
    with pytest.raises(InvalidInput, match="target 40 bytes: one Gaussian alone takes"):
        as_requested(scene, Config(format=form), plan, {"size": 40})


@pytest.mark.thorough
def test_a_loss_of_a_fixed_format_is_met_by_pruning(seen):
    scene, plan = seen
    config = Config(format="compressed.ply")
    held_out = choose_views(scene, plan).held_out
    before = held_out.errors(scene)
    free = held_out.drop(held_out.errors(decode_as(config, encode_scene(scene, config)[0])), before)
    data, report = as_requested(scene, config, plan, {"psnr_drop": free + 2.0})
    lost = held_out.drop(held_out.errors(decode_as(config, data)), before)
    assert report.rate.psnr_drop == pytest.approx(lost)
    assert lost <= free + 2.0
    assert report.rate.pruned > 0
    with pytest.raises(InvalidInput, match="the format itself loses"):
        as_requested(scene, config, plan, {"psnr_drop": 1e-6})


@pytest.mark.parametrize(
    ("plan", "target"),
    [
        (Plan(Steps(prune=20)), {"size": 9000}),
        (Plan(Steps(gaussians=9)), {"size": 9000}),
        (None, {"size": 9000, "allow_prune": True}),
    ],
)
def test_pruning_twice_is_refused(plan, target, seen):
    with pytest.raises(InvalidInput, match="sets the number of Gaussians"):
        as_requested(seen[0], Config(format="splat"), plan, target)


# Files and commands


@pytest.fixture
def ply(tmp_path) -> Path:
    path = tmp_path / "scene.ply"
    write_ply(path, usual(400, 2, seed=8))
    return path


def refused(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert isinstance(result.exception, InvalidInput), result.output
    return str(result.exception)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("form", ALL)
def test_the_suffix_selects_the_format(form, ply, tmp_path):
    for command in ("encode", "convert"):
        out = tmp_path / f"{command}.{form}"
        result = CliRunner().invoke(app, [command, str(ply), str(out), "--json"])
        assert result.exit_code == 0, result.output
        report = json.loads(result.stdout)
        assert report["output_bytes"] == out.stat().st_size
        assert report["lost"]
        assert read_scene(out).count == 400
    assert (tmp_path / f"encode.{form}").read_bytes() == (tmp_path / f"convert.{form}").read_bytes()


def test_python_writes_all_formats(ply, tmp_path):
    cloud = gs_codec.read(ply)
    for form in ALL:
        gs_codec.write(tmp_path / f"a.{form}", cloud)
        data = gs_codec.encode(cloud, gs_codec.Config(format=form))
        assert (tmp_path / f"a.{form}").read_bytes() == data
    with pytest.raises(InvalidInput, match=r"format 'spz', expected \.spz"):
        encode_file(ply, tmp_path / "b.splat", Config(format="spz"))
    assert to_cloud(read_scene(tmp_path / "a.spz")).point.f_rest.shape == (400, 8, 3)


def test_versions_of_spz_are_chosen(ply, tmp_path):
    CliRunner().invoke(app, ["encode", str(ply), str(tmp_path / "a.spz")])
    CliRunner().invoke(app, ["encode", str(ply), str(tmp_path / "b.spz"), "--spz-version", "4"])
    assert (tmp_path / "a.spz").read_bytes()[:2] == b"\x1f\x8b"
    assert (tmp_path / "b.spz").read_bytes()[:8] == b"NGSP\x04\x00\x00\x00"


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("o.egs --spz-version 4", "spz_version: format 'egs', expected .spz"),
        ("o.splat --spz-version 4", "--spz-version has no effect on o.splat"),
        ("o.spz --format splat", "--format has no effect on o.spz, whose suffix sets the format"),
        ("o.splat -p l", "--profile has no effect on o.splat, expected an .egs"),
        ("o.compressed.ply --coarseness 2", "--coarseness has no effect on o.compressed.ply"),
        (
            "o.spz --block-size 2048",
            "--block-size has no effect on o.spz, expected .egs, .ssog, lod-meta.json",
        ),
        ("o.spz --depth sh-ac=3", "--depth has no effect on o.spz"),
        ("o.spz -p paper-m", "format 'spz': profile 'paper-m', expected l, m, s"),
        ("o.rad --max-memory 1GB", "--max-memory has no effect on o.rad"),
        ("o.glb --cameras auto", "--cameras has no effect on .glb, whose values are exact"),
        ("o.usdz --cameras auto", "--cameras has no effect on .usdz, whose values are exact"),
        ("o.splat --views 8", "--views has no effect without views"),
        ("o.ksplat", "suffix '.ksplat', expected .egs, .spz, "),
        ("o.ply", "suffix '.ply', expected .egs, .spz, "),
    ],
)
def test_options_without_effect_are_refused(typed, message, ply, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in refused("encode", "scene.ply", *typed.split())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.ply"]


@pytest.mark.parametrize(
    "options",
    [{"depths": {"sh-ac": 3}}, {"block_size": 2048}, {"spz_version": 5}, {"profile": "lossless"}],
)
def test_configurations_of_an_egs_are_refused_for_others(options):
    with pytest.raises(InvalidInput):
        Config(**({"format": "spz"} | options))
    with pytest.raises(InvalidInput, match="coarseness"):
        Config(format="splat", coarseness=2)


def test_an_spz_has_coordinates_of_its_own(ply, tmp_path):
    done = convert_file(ply, tmp_path / "a.spz")
    assert (done.coordinates, done.turned_from) == ("RUB", "RDF")
    for coordinates in ("RUB", "keep"):
        again = convert_file(ply, tmp_path / "b.spz", coordinates=coordinates, overwrite=True)
        assert again.coordinates == "RUB"
        assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()
    with pytest.raises(InvalidInput, match="coordinates 'LUF', expected RUB"):
        convert_file(ply, tmp_path / "c.spz", coordinates="LUF")


def test_a_batch_writes_all_formats(ply, tmp_path):
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["batch", str(tmp_path), str(out), "--format", "spz"])
    assert result.exit_code == 0, result.output
    assert read_scene(out / "scene.spz").count == 400


@pytest.mark.parametrize("form", ALL)
def test_formats_are_compared_gaussian_by_gaussian(form, ply, tmp_path):
    fine = Config("l", coarseness=0.05) if form in WITH_STEPS else Config()
    encode_file(ply, tmp_path / f"a.{form}", fine)
    compared = compare_files(ply, tmp_path / f"a.{form}")
    order = "Morton order" if form in SORTED else "index"
    assert compared.matched_by == ("nearest centre" if form == "rad" else order)
    back = compare_files(tmp_path / f"a.{form}", ply)
    assert back.matched_by == compared.matched_by
    for one in (compared, back):
        errors = {group.name: group.max for group in one.groups}
        assert errors["positions"] < 0.02
        assert errors["f_dc"] < 0.1


@pytest.mark.parametrize("suffix", [*SORTED, "splat", "glb"])
@pytest.mark.parametrize("count", [2, 3, 300])
def test_small_gaussians_are_matched_correctly(count, suffix, tmp_path):
    """They are smaller than the steps of centres, so only other attributes identify them."""
    scene = random_scene(count, 1, seed=11)
    scene = replace(scene, log_scale=(0.1 * scene.log_scale - 9).astype(np.float32))
    shuffled = scene.take(np.random.default_rng(12).permutation(count))
    write_ply(tmp_path / "scene.ply", scene)
    write_ply(tmp_path / "shuffled.ply", shuffled)
    convert_file(tmp_path / "scene.ply", tmp_path / f"a.{suffix}")
    for source in ("scene.ply", "shuffled.ply"):
        for pair in ((source, f"a.{suffix}"), (f"a.{suffix}", source)):
            errors = {g.name: g.max for g in compare_files(*(tmp_path / n for n in pair)).groups}
            assert errors["positions"] < 0.01
            # A .splat clips colours.
            assert errors["f_dc"] < 3


@pytest.mark.parametrize("suffix", ["spz", "sog"])
def test_rotations_rounded_coarsely_are_of_unit_length(suffix, tmp_path):
    """Including those of equal components, whose rounded values tend to be too large."""
    likely = np.array([[0.72, 0.69, 0, 0], [0.72, 0, 0.69, 0], [0.72, 0, 0, 0.69]])
    rot = np.concatenate([np.repeat(likely, 300, axis=0), np.full((9, 4), 0.5)])
    scene = replace(usual(len(rot), 0), rot=np.ascontiguousarray(rot.T, np.float32))
    steps = AttributeSteps.least(scene)
    for octave in range(-8, 4):
        coarse = replace(steps, rot=np.full(scene.count, 2.0**octave))
        data = (pack_spz(scene, 4, coarse) if suffix == "spz" else pack_sog(scene, coarse))[0]
        back = read_scene(written(tmp_path / f"a.{suffix}", data)).rot.astype(np.float64)
        np.testing.assert_allclose((back * back).sum(axis=0), 1, atol=1e-6)


def test_steps_are_no_coarser_than_those_of_an_egs():
    """A Gaussian invisible in all views would otherwise have an unlimited step."""
    scene = usual(50, 3)
    known = camera_free_steps(scene, ADAPTIVE_PROFILES["m"])
    endless = {rule: np.array([30.0, 0, 0, 0, 0]) for rule in known.coefficients}
    wanted = wanted_steps(scene, replace(known, coefficients=endless))
    assert wanted.opacity.max() == wanted.log_scale.max() == 2
    assert wanted.rot.max() == pytest.approx(2)
    assert wanted.f_dc.max() == 4
    assert wanted.positions.max() == 2**30


@pytest.mark.parametrize(
    ("name", "write"),
    [
        *((name, convert_file) for name in ("b.spz", "b.sog", "meta.json", "b.ssog")),
        *((name, encode_file) for name in ("b.spz", "b.sog")),
    ],
)
def test_rounded_scenes_keep_the_formats_precision(name, write, tmp_path):
    source = tmp_path / "a.spz"
    write_scene(source, random_scene(300, 2, seed=4), Config("s"))
    before, target = read_scene(source), tmp_path / "b" / name
    target.parent.mkdir()
    done = write(source, target)
    assert "profile" not in done.lost[0]
    after = read_scene(target)
    if name == "b.spz":
        first, second = before.take(order_of(before)), after.take(order_of(after))
        # The largest component, which is not stored, may be a different one.
        signs = np.sign((first.rot * second.rot).sum(axis=0))
        np.testing.assert_allclose(first.rot, signs * second.rot, atol=2 / 511)
        assert_same_floats(first, replace(second, rot=first.rot))
    own = attribute_errors(before, after)
    done = write(source, target, overwrite=True, by_profile=True)
    assert name == "b.ssog" or done.lost[0].endswith("or to the steps of profile m")
    profile = attribute_errors(before, read_scene(target))
    assert own["scaling"] < 0.3 * profile["scaling"]
    assert own["rotation"] < 0.3 * profile["rotation"]
    done = write(source, target, Config("l"), overwrite=True)
    assert name == "b.ssog" or done.lost[0].endswith("or to the steps of profile l")


def test_targets_and_batches_of_rounded_scenes(tmp_path):
    source, target = tmp_path / "a.spz", tmp_path / "b.spz"
    write_scene(source, random_scene(300, 2, seed=4), Config("s"))
    lines = []
    for asked in ({"rate": {"ratio": 9.0}}, {"config": "m"}, {}):
        lines.append(encode_file(source, target, overwrite=True, **asked).lost[0])
    assert [line.endswith("or to the steps of profile m") for line in lines] == [True, True, False]
    sizes = []
    for typed in ([], ["-p", "m"]):
        command = ["batch", tmp_path / "a.spz", tmp_path / f"out{len(typed)}", "--format", "spz"]
        result = CliRunner().invoke(app, [*map(str, command), *typed])
        assert result.exit_code == 0, result.output
        sizes.append((tmp_path / f"out{len(typed)}" / "a.spz").stat().st_size)
    assert sizes == [target.stat().st_size, sizes[1]]
    assert sizes[1] < sizes[0]


def order_of(scene):
    return np.lexsort(scene.positions)


def attribute_errors(first, second) -> dict[str, float]:
    pair = [scene.take(order_of(scene)) for scene in (first, second)]
    return {group.name: group.rms for group in compare_scenes(*pair).groups}
