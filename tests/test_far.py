"""Far Gaussians: selection, exact centres, and no cost for the other Gaussians."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import reference_decoder
from damage import REFUSALS, with_section
from in_tasks import in_tasks, saved, whole
from javascript import NODE, digest, run
from level_files import AWAY, NEAR, encoded, in_level
from orbits import cameras, quality
from requested import as_requested
from scenes import (
    SHARED,
    assert_same_floats,
    encode_by,
    made_up_guide,
    random_scene,
    shared_scene_path,
    with_far,
)

from gs_codec.cameras.camera import Camera
from gs_codec.codecs import decode_part, decode_scene, encode_scene, slabs
from gs_codec.codecs.adaptive.arrange import arrange_scene
from gs_codec.codecs.adaptive.costs import block_costs
from gs_codec.codecs.adaptive.decode import Blocks
from gs_codec.codecs.adaptive.grid import choose_grid
from gs_codec.codecs.adaptive.lattice import grid_codes, outside
from gs_codec.codecs.adaptive.step_conversion import mean_octaves
from gs_codec.codecs.gaussian_costs import describe_gaussian, gaussian_bits
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.matching import GridOrder, order_of
from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import verify_file
from gs_codec.config import ADAPTIVE_PROFILES, Config, RateTarget
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.egs.header import Feature
from gs_codec.egs.index import levels_of, open_level
from gs_codec.errors import CorruptStream, InvalidInput, MissingTool
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.files.sharing import page_of
from gs_codec.formats.ply.file import read_ply
from gs_codec.plan import Plan, Steps
from gs_codec.scene import Scene
from gs_codec.views.find import find_cameras
from samples.generate import generate

LARGEST = float(np.finfo(np.float32).max)

#: Log2 of the wanted step sizes in the table below: 0.001.
WANTED = -10.0


def normal(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(3, count))


def far_away(count: int, share: float) -> np.ndarray:
    """Some centres near the origin, and a share of them in random directions, up to 1e9 away."""
    places, rng = normal(count, 1), np.random.default_rng(2)
    moved = rng.random(count) < share
    away = places[:, moved] / np.linalg.norm(places[:, moved], axis=0)
    places[:, moved] = away * 10 ** rng.uniform(4, 9, moved.sum())
    return places


def beside(*clusters: tuple[int, float, float, float]) -> np.ndarray:
    """Clusters, each of a number of centres around a position."""
    return np.concatenate(
        [normal(n, k) + np.array([place]).T for k, (n, *place) in enumerate(clusters)], axis=1
    )


def one_at(place: tuple[float, float, float], count: int = 2000) -> np.ndarray:
    places = normal(count)
    places[:, 7] = place
    return places


#: Centres, and the minimum and maximum share of them that may be far.
CHOICES = {
    "none": (normal(2000), 0, 0),
    "one in x": (one_at((1e6, 0, 0)), 1 / 2000, 1 / 2000),
    "one in -z": (one_at((0, 0, -1e9)), 1 / 2000, 1 / 2000),
    "one at the end of floats": (one_at((LARGEST, -LARGEST, 0)), 1 / 2000, 1 / 2000),
    "one, not in the sample": (one_at((1e6, 0, 0), 60_000), 1 / 60_000, 1 / 60_000),
    "1 %": (far_away(5000, 0.01), 0.008, 0.013),
    "10 %": (far_away(5000, 0.1), 0.08, 0.12),
    "UTM": (normal(2000) + 5e5, 0, 0),
    "UTM and the origin": (beside((2000, 5e5, 4e6, 100.0), (3, 0, 0, 0)), 3 / 2003, 3 / 2003),
    "two clusters": (beside((900, 0, 0, 0), (600, 1e8, 1e8, 1e8)), 0.4, 0.4),
    # Most are at 1e8 in x, and most at 0 in y, but few at both.
    "three clusters": (
        beside((800, 0, 0, 0), (600, 1e8, 0, 0), (600, 1e8, 1e8, 0)), 0.6, 0.6,
    ),
    "a city": (np.random.default_rng(3).uniform(-4000, 4000, (3, 20_000)), 0, 0),
    "flat": (normal(2000) * [[1], [1], [0]], 0, 0),
    "flat, and one in the plane": (one_at((1e7, 0, 0)) * [[1], [1], [0]], 1 / 2000, 1 / 2000),
    "flat, and one beside": (
        one_at((0, 0, 1e7)) * np.r_[1, 1, 1e-30][:, None] * [[1], [1], [1e30]], 0, 1 / 2000,
    ),
    "in one place": (np.zeros((3, 50)), 0, 0),
    "one": (normal(1), 0, 0),
    "two": (np.array([[0, 1e9], [0, 0], [0, 0]]), 0.5, 0.5),
    "three": (np.array([[0, 1, 1e9], [0, 1, 0], [0, 1, 0]]), 1 / 3, 1 / 3),
}  # fmt: skip


def chosen(places: np.ndarray, **options):
    positions = places.astype(np.float32)
    bounds = positions.min(axis=1), positions.max(axis=1)
    some = positions[:, ::3] if positions.shape[1] > 50_000 else positions
    grid, unit = choose_grid(bounds, some, np.full(some.shape[1], WANTED), **options)
    return positions, grid, unit


@pytest.mark.parametrize("name", CHOICES)
def test_selection_of_far_gaussians(name):
    places, least, most = CHOICES[name]
    positions, grid, unit = chosen(places)
    far = outside(positions, grid)
    if not grid.has_far:
        far[:] = False  # up to rounding
    assert least <= far.mean() <= most + 1e-9
    assert grid.has_far == far.any()
    assert max(grid.bits) <= 21
    assert grid.total_bits + grid.has_far <= 63
    assert np.isfinite(grid.origin).all()
    codes = grid_codes(positions, grid)
    assert codes.min() >= 0
    np.testing.assert_array_equal(codes >> grid.total_bits > 0, far)
    if name != "a city":
        assert unit <= WANTED + 1.5
    everything = chosen(places, may_have_far=False)[1]
    assert not everything.has_far
    if not grid.has_far:
        assert grid == everything


def test_coarser_steps_are_compared_with_far_gaussians():
    """A city uses a coarser grid where a scene with a few outliers would store far centres."""
    _, grid, unit = chosen(CHOICES["a city"][0])
    assert WANTED < unit <= WANTED + 3
    assert not grid.has_far
    # A few Gaussians that need finer steps do not justify a file that older readers reject.
    wanted = np.where(np.arange(2000) < 20, WANTED, 0.0)
    positions = one_at((5e4, 0, 0)).astype(np.float32)
    bounds = positions.min(axis=1), positions.max(axis=1)
    assert choose_grid(bounds, positions, wanted)[0].has_far
    wanted[1:] = 0.0
    assert not choose_grid(bounds, positions, wanted)[0].has_far


def test_steps_finer_than_floats_gain_nothing():
    """At 1e6, the last bit of a float32 is 1/16, so a grid of 1/8 is as good as any."""
    places = np.random.default_rng(5).uniform(1e6, 1e6 + 2.0**18, (3, 4000)).astype(np.float32)
    bounds = places.min(axis=1), places.max(axis=1)
    grid, _ = choose_grid(bounds, places, np.full(4000, -40.0))
    assert not grid.has_far


GUIDES = {"free": None, "guided": made_up_guide(seed=4)}


def matched(data: bytes, scene: Scene) -> tuple[Scene, Scene]:
    """A decoded scene, and the original in its order."""
    decoded, grid = decode_scene(data), inspect_bytes(data).grid
    assert grid is not None
    return decoded, GridOrder(grid).apply(scene, decoded)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("guide", GUIDES)
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
@pytest.mark.parametrize("distance", [1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 3e38, -3e38])
def test_one_far_centre_is_exact_and_does_not_affect_others(profile, guide, distance):
    near = random_scene(3000, 1, seed=70)
    scene = replace(near, positions=near.positions.copy())
    scene.positions[0, 11] = distance
    config = Config(profile, block_size=1024)
    data, before = (encode_by(each, config, GUIDES[guide]) for each in (scene, near))
    decoded, original = matched(data, scene)
    info = inspect_bytes(data)
    assert info.far == 1 or distance == 1e3
    if info.far:
        assert decoded.positions[0, -1] == np.float32(distance)
        assert decoded.positions[:, -1].tobytes() == original.positions[:, -1].tobytes()
    rms = []
    for found, others in ((decoded.take(np.arange(2999)), original), matched(before, near)):
        errors = found.positions - others.positions[:, : found.count]
        rms.append(math.sqrt(np.mean(np.square(errors, dtype=np.float64))))
    assert rms[0] <= (1.05 if info.far else 1.15) * rms[1]
    assert len(data) < 1.01 * len(before)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("guide", GUIDES)
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
@pytest.mark.parametrize("number", [50, 500, 4990])
def test_many_far_centres_are_exact(profile, guide, number):
    scene = with_far(random_scene(5000, 3, seed=71), number)
    data = encode_by(scene, Config(profile, block_size=1024), GUIDES[guide])
    decoded, original = matched(data, scene)
    found = inspect_bytes(data)
    # Some are near enough for the grid.
    assert 0.8 * number <= found.far <= number + 5
    assert {s.name: s.bytes for s in found.streams}["far"] == 12 * found.far
    assert decoded.positions[:, -found.far :].tobytes() == (
        original.positions[:, -found.far :].tobytes()
    )
    errors = np.abs(decoded.positions - original.positions)[:, : -found.far]
    assert errors.max() < 0.1


def test_a_scene_that_failed_before():
    path = SHARED.parent / "cases" / "far_gaussian.ply"
    if not path.exists():
        pytest.skip("the shared cases are not on this machine")
    scene = read_scene(path)
    near = scene.take(np.flatnonzero(np.abs(scene.positions).max(axis=0) < 100))
    assert near.count == 999
    for profile in ADAPTIVE_PROFILES:
        apart = []
        for each in (scene, near):
            decoded, original = matched(encode_scene(each, Config(profile))[0], each)
            errors = np.abs(decoded.positions - original.positions).max(axis=0)
            apart.append((errors / np.exp(original.log_scale.max(axis=0)))[:999])
        assert np.median(apart[0]) < 0.05
        assert np.quantile(apart[0], 0.99) <= 1.1 * np.quantile(apart[1], 0.99)


def test_files_without_far_gaussians_are_version_1():
    for scene in (random_scene(3000, 1), random_scene(0), random_scene(1)):
        data = encode_scene(scene, Config("m"))[0]
        info = inspect_bytes(data)
        assert (info.version, info.features, info.far) == (1, (), 0)
        assert not any(section == SectionId.FAR for section, _ in read_file(data).table)


def test_depths_and_coarseness():
    scene = with_far(random_scene(3000, 1, seed=72), 20)
    depths = {"depths": {"sh-ac": 6}}, {"depths": {"geometry": 12}}
    for options in ({"coarseness": 4.0}, {"coarseness": 0.25}, *depths):
        data = encode_scene(scene, Config("m", **options))[0]
        decoded, original = matched(data, scene)
        far = inspect_bytes(data).far
        assert far >= 20
        assert np.array_equal(decoded.positions[:, -far:], original.positions[:, -far:])


def test_a_depth_of_geometry_covers_the_near_range():
    near, depths = random_scene(3000, 1, seed=72), {"geometry": 12}
    far = with_far(near, 20)
    assert mean_octaves(far, depths) == pytest.approx(mean_octaves(near, depths), abs=0.1)


def test_far_gaussians_do_not_change_the_calibration():
    near = random_scene(8000, 1, seed=73)
    near.log_scale[:] += 1.5
    found = []
    for scene in (near, with_far(near, 80)):
        report = as_requested(scene, Config("m"))[1]
        found.append(report.coarseness)
    assert abs(math.log2(found[1] / found[0])) <= 0.25


def shown(
    scene: Scene, moved: np.ndarray, encode: Callable[[Scene], bytes], held_out: Sequence[Camera]
) -> tuple[list[float], list[int]]:
    """Quality of views and size, of a scene and of the scene without the moved Gaussians."""
    both = scene, scene.take(np.flatnonzero(~moved))
    files = [encode(each) for each in both]
    found = [quality(a, decode_scene(b), held_out) for a, b in zip(both, files, strict=True)]
    assert [inspect_bytes(data).far > 0 for data in files] == [True, False]
    return found, [len(data) for data in files]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("number", [1, 60])
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_views_and_sizes_are_nearly_those_without_far_gaussians(
    number, profile, guided, monkeypatch
):
    """In such a small scene, moving any few Gaussians changes views by up to 3 dB."""
    monkeypatch.setattr("gs_codec.encoding.retry._MOST_ENCODINGS", 1)
    near, config, views = generate(6000, 1, 5), Config(profile), cameras(12)
    plan = Plan(Steps(), views) if guided else None
    scene = with_far(near, number, 6)
    moved = (scene.positions != near.positions).any(axis=0)

    def encode(each: Scene) -> bytes:
        return as_requested(each, config, plan)[0] if guided else encode_scene(each, config)[0]

    held_out = [camera for camera in views if camera.split == "test"]
    psnr, sizes = shown(scene, moved, encode, held_out)
    assert psnr[0] > psnr[1] - 4
    assert sizes[0] < 1.04 * sizes[1]


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0, 100])
def test_views_and_sizes_of_a_real_scene_are_those_without_far_gaussians(share):
    """One centre, or 1 %."""
    near = read_ply(shared_scene_path("bonsai/point_cloud.ply"))
    scene = with_far(near, near.count // share if share else 1, 6)
    moved = (scene.positions != near.positions).any(axis=0)
    views = find_cameras(SHARED / "bonsai" / "cameras.json", near, "test", 200)[::4]
    psnr, sizes = shown(scene, moved, lambda each: encode_scene(each, Config("m"))[0], views)
    assert psnr[0] > psnr[1] - 0.2
    assert sizes[0] < 1.03 * sizes[1]


@pytest.mark.thorough
def test_cameras_can_be_estimated_and_targets_met():
    # Nearer ones may be inside the grid if steps are coarse.
    scene = with_far(generate(6000, 1, 5), 60, lowest=1e4)
    data = as_requested(scene, Config("m"), Plan(Steps()))[0]
    assert inspect_bytes(data).far >= 60
    target = RateTarget(ratio=20)
    data = as_requested(scene, Config("m"), None, target, scene.float_bytes)[0]
    assert 20 <= scene.float_bytes / len(data) < 25


def test_far_gaussians_sort_last_next_to_their_neighbours():
    scene = with_far(random_scene(4000, 0, seed=74), 400)
    arranged = arrange_scene(scene, Config("m"), None)
    grid = arranged.lattice.grid
    far = outside(scene.positions, grid)[arranged.order]
    assert far.sum() >= 400
    assert far[-far.sum() :].all()
    assert (np.diff(arranged.codes) >= 0).all()
    away = scene.positions[:, arranged.order[far]].astype(np.float64)
    away /= np.linalg.norm(away, axis=0)
    along = np.sum(away[:, 1:] * away[:, :-1], axis=0)
    assert along.mean() > 0.5  # with random directions: 0


def many(profile: str = "m", degree: int = 2) -> tuple[Scene, bytes]:
    """Three blocks of near Gaussians, one mixed, and one of far ones."""
    scene = with_far(random_scene(5000, degree, seed=75), 1500)
    return scene, encode_scene(scene, Config(profile, block_size=1024))[0]


def test_parts_slabs_and_blocks(tmp_path, monkeypatch):
    _, data = many()
    whole = decode_scene(data)
    file = read_file(data)
    blocks = {block for section, block in file.table if section == SectionId.FAR}
    assert len(blocks) == 2 < file.header.block_count
    for box in ((-1.0, -1.0, -1.0, 0.5, 0.5, 0.5), (10.0, -1e38, -1e38, 1e38, 1e38, 1e38)):
        for degree in (0, 1, None):
            part, read = decode_part(data, Part(box, degree))
            inside = np.flatnonzero(Part(box).contains(whole.positions))
            assert 0 < part.count == len(inside)
            assert_same_floats(
                replace(part, f_rest=part.f_rest[:0]),
                replace(whole.take(inside), f_rest=part.f_rest[:0]),
            )
            assert (read.bytes_read < len(data)) == (degree is not None or box[0] > 0)
    (tmp_path / "a.egs").write_bytes(data)
    monkeypatch.setattr(slabs, "_SLAB", 1)
    assert verify_file(tmp_path / "a.egs", threads=1).count == 5000
    decode_file(tmp_path / "a.egs", tmp_path / "a.ply", threads=1)
    decoded = read_scene(tmp_path / "a.ply")
    assert_same_floats(decoded, whole)
    order = order_of(decoded)
    assert isinstance(order, GridOrder)
    assert order.grid == inspect_bytes(data).grid
    assert str(order).endswith(" far")


@pytest.mark.parametrize("mark", ["0 0 0 1 21 21 21 far", "0 0 0 1 2 2 far", "0 0 0 1 2 2 2 afar"])
def test_invalid_orders_are_refused(mark):
    scene = replace(random_scene(5), comments=(f"gs_codec order grid {mark}",))
    with pytest.raises(InvalidInput, match="comment"):
        order_of(scene)


def test_bits_of_far_gaussians():
    _, data = many()
    file = read_file(data)
    assert gaussian_bits(file).sum() == pytest.approx(8 * len(data))
    far = inspect_bytes(data).far
    costs = block_costs(Blocks(file, 2), file.header.block_count - 1)
    assert (costs.bits["far"] == 96).all()
    assert (costs.steps["geometry"] == 0).all()
    near, last = describe_gaussian(file, 0), describe_gaussian(file, 4999)
    assert "far" not in {stream.name for stream in near.streams}
    assert {s.name: s.bits for s in last.streams}["far"] == pytest.approx(96)
    assert far >= 1500


@pytest.mark.parametrize("size", [500, 2000])
@pytest.mark.parametrize("number", [1, 300])
def test_tasks_give_the_same_file(tmp_path, number, size):
    scene = with_far(random_scene(6000, 1, seed=76), number)
    path = saved(tmp_path / "a.ply", scene)
    config = Config("m", block_size=1024)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert inspect_bytes(expected[0]).far
    assert in_tasks([path], tmp_path / "tasks.egs", config, size) == expected


@pytest.mark.parametrize("number", [2, 900])
def test_tasks_give_the_same_levels(tmp_path, number):
    scene = with_far(random_scene(6000, 1, seed=77), number)
    path = saved(tmp_path / "a.ply", scene)
    config = Config("m", block_size=1024, lod=True)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert levels_of(read_file(expected[0]))
    assert in_tasks([path], tmp_path / "tasks.egs", config, 5000) == expected


# Levels


def in_levels(number: int = 20) -> bytes:
    return encoded(with_far(random_scene(300, 1, seed=330), number))


def test_levels_with_and_without_far_gaussians():
    data = in_levels()
    file = read_file(data)
    levels = [open_level(file, level) for level in levels_of(file)]
    assert file.header.features == Feature.FAR
    assert {found.version for found in levels} == {1, 2}
    assert file.data[8:12] == b"\2\0\0\0"
    found = reference_decoder.decode(data)["levels"]
    for level, values in enumerate(found, 1):
        scene = decode_part(data, Part(level=level))[0]
        for row, name in zip(scene.positions, "xyz", strict=True):
            np.testing.assert_array_equal(values["values"][name].view("u4"), row.view("u4"))
    for view in (NEAR, AWAY):
        assert decode_part(data, Part(view=view))[0].count


def test_levels_of_a_file_without_far_gaussians_have_none():
    """Even if their own step sizes suggested them."""
    data = in_levels(0)
    level = bytes(read_file(in_levels()).read().sections[SectionId.LEVEL, 1])
    damaged = in_level(data, lambda _: level)
    with pytest.raises(REFUSALS, match="level 1: header: does not match a level of this file"):
        decode_part(damaged, Part(level=1))
    with pytest.raises(ValueError, match="level 1: features"):
        reference_decoder.decode(damaged)
    assert decode_scene(damaged).count == 300


# Damage


def with_bits(content: bytes) -> bytes:
    """The section `lattice` with 21 bits per axis."""
    return content[:16] + b"\x15\x15\x15" + content[19:]


DAMAGED = {
    "empty": (SectionId.FAR, lambda old: b"", "0 bytes, expected a multiple of 12"),
    "cut": (SectionId.FAR, lambda old: old[:-1], "bytes, expected a multiple of 12"),
    "too many": (SectionId.FAR, lambda old: bytes(12 * 60), "bytes, expected a multiple of 12"),
    "one more": (SectionId.FAR, lambda old: old + bytes(12), "geometry of block 0"),
    "one fewer": (SectionId.FAR, lambda old: old[12:], "geometry of block 0"),
    "NaN": (SectionId.FAR, lambda old: struct.pack("<f", math.nan) + old[4:], "not finite"),
    "infinite": (SectionId.FAR, lambda old: old[:-4] + struct.pack("<f", -math.inf), "not finite"),
    "another": (SectionId.FAR, lambda old: struct.pack("<f", -3e38) + old[4:], "section 'index'"),
    "63 bits": (SectionId.LATTICE, with_bits, "bits (21, 21, 21) of the grid"),
}


@pytest.fixture(scope="module")
def small() -> bytes:
    """A file with a single block."""
    return encode_scene(with_far(random_scene(40, 1, seed=78), 20), Config("m"))[0]


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_sections_are_refused(small, name):
    section, change, message = DAMAGED[name]
    damaged = with_section(small, section, change)
    with pytest.raises(CorruptStream) as caught:
        decode_scene(damaged)
    assert message in str(caught.value)
    with pytest.raises((ValueError, IndexError, struct.error)):
        reference_decoder.decode(damaged)


def test_sections_need_the_feature_and_its_version(small):
    plain = bytearray(with_section(small, SectionId.FAR, lambda _: None))
    with pytest.raises(CorruptStream, match="geometry of block 0"):
        decode_scene(bytes(plain))
    assert read_file(bytes(plain)).version == 1


needs_node = pytest.mark.skipif(NODE is None, reason="needs Node")


@needs_node
def test_javascript_has_the_same_floats_and_refuses_the_same(small):
    files = [many("s")[1], many("l", 0)[1], small]
    for data, found in zip(files, run(*({"bytes": data} for data in files)), strict=True):
        assert found.get("hash") == digest(decode_scene(data)), found
    broken = [with_section(small, section, change) for section, change, _ in DAMAGED.values()]
    for name, found in zip(DAMAGED, run(*({"bytes": data} for data in broken)), strict=True):
        assert found.get("error") == "CorruptError", (name, found)


@needs_node
def test_javascript_has_the_same_headers(small):
    changes = {8: 1, 24: 0, 31: 6}
    files = []
    from damage import with_checksums

    for at, value in changes.items():
        changed = bytearray(small)
        changed[at] = value
        files.append(with_checksums(changed))
    files.append(with_section(small, SectionId.FAR, lambda _: None))
    later = bytearray(small)
    later[24] |= 96
    files.append(with_checksums(later))
    *found, named = run(*({"bytes": data} for data in files))
    assert [each.get("error") for each in found] == ["CorruptError"] * 4
    assert named["message"] == "header: features 5 and 6"


@needs_node
def test_javascript_has_the_same_levels():
    data = in_levels()
    levels = [decode_part(data, Part(level=level))[0] for level in range(4)]
    chosen = [[k, list(range(-(-scene.count // 8)))] for k, scene in enumerate(levels)]
    jobs = [
        {"bytes": data, "open": {"chosen": chosen}, "workers": 2},
        {"bytes": in_level(in_levels(0), lambda _: bytes(
            read_file(data).sections[SectionId.LEVEL, 1])), "open": {"chosen": []}},
    ]  # fmt: skip
    found, refused = run(*jobs)
    assert found.get("decoded") == [digest(scene) for scene in levels], found
    assert refused.get("error") == "CorruptError", refused


@needs_node
def test_javascript_decodes_parts_and_lower_degrees():
    _, data = many()
    whole = decode_scene(data)
    block = read_file(data).header.block_size
    (found,) = run({"bytes": data, "as": "url", "box": [[1e7, -1e39, -1e39], [1e39, 1e39, 1e39]]})
    kept = [
        np.arange(b, min(b + block, whole.count))
        for b in range(0, whole.count, block)
        if whole.positions[0, b : b + block].max() >= 1e7
    ]
    assert found["hash"] == digest(whole.take(np.concatenate(kept)))


# Commands


def test_inspect_counts_far_gaussians(tmp_path, run_codec):
    _, data = many()
    (tmp_path / "a.egs").write_bytes(data)
    number = inspect_bytes(data).far
    told = []
    for options in ([], ["--json"]):
        status, out, _ = run_codec("inspect", tmp_path / "a.egs", *options)
        assert status == 0
        told.append(out)
    assert "version 2, profile m with far Gaussians, 5,000 Gaussians" in told[0]
    assert f"far Gaussians: {number:,}, with exact centres" in told[0]
    found = json.loads(told[1])
    assert (found["far"], found["version"], found["grid"]["has_far"]) == (number, 2, True)


@pytest.mark.thorough
def test_memory_limits_do_not_change_the_file(tmp_path):
    path = saved(tmp_path / "a.ply", many()[0])
    encode_file(path, tmp_path / "a.egs", Config("m"))
    encode_file(path, tmp_path / "b.egs", Config("m"), max_memory=1 << 30)
    assert (tmp_path / "a.egs").read_bytes() == (tmp_path / "b.egs").read_bytes()


def test_pages_embed_them_unchanged(tmp_path):
    pytest.importorskip("viewer")
    data = encode_scene(with_far(random_scene(3000, 1, seed=74), 5), Config("m"))[0]
    (tmp_path / "far.egs").write_bytes(data)
    try:
        [shared], _ = page_of([tmp_path / "far.egs"], "auto", alone=True)
    except MissingTool:
        pytest.skip("the page is not built")
    assert (shared.data, shared.encoded) == (data, False)
