"""Far Gaussians: which are far, and how orders and writers treat the others."""

from __future__ import annotations

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
from scenes import SmallBlocks, antialiased, edge_scenes, random_scene, shared_scene_path
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras.camera import Camera
from gs_codec.cli.main import app
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.entropygs import encode as entropygs
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.interchange import decode_interchange
from gs_codec.codecs.matching import order_of_file, put_side_by_side, with_order
from gs_codec.coding.far import bring_nearer, draw_nearer, find_far
from gs_codec.coding.morton import spatial_order
from gs_codec.config import Config
from gs_codec.edit.floaters import FLOATERS, find_floaters
from gs_codec.files.scenes import read_scene
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from gs_codec.levels.streaming import stream_levels
from gs_codec.scene import Scene, join_scenes

COUNT = 3000
DISTANCES = [1e3, 1e6, 1e9]
SHARES = [0.0, 0.01]

#: Formats that store centres in a grid, and formats with floats.
GRIDS = {
    "spz": Config(format="spz"),
    "spz 4": Config(format="spz", spz_version=4),
    "sog": Config(format="sog"),
    "compressed.ply": Config(format="compressed.ply"),
    "paper-l": Config("paper-l"),
    "paper-s": Config("paper-s"),
}
FLOATS = {"splat": Config(format="splat"), "glb": Config(format="glb")}

#: Maximum ratio of errors of centres to those without far Gaussians: `.sog` has larger steps. Up to
#: 255 centres of a packed PLY share a chunk with far ones.
FACTORS = {"sog": 1.7}
CHUNK = 256


@pytest.fixture(scope="module")
def scene() -> Scene:
    return random_scene(COUNT, 1, seed=71)


def moved_away(scene: Scene, distance: float, share: float = 0.0) -> tuple[Scene, np.ndarray]:
    """Move one Gaussian, or a share of them, to a distance in random directions.

    Also returns which ones ``(N,)``.
    """
    rng = np.random.default_rng(0)
    which = rng.choice(scene.count, max(1, round(share * scene.count)), replace=False)
    rays = rng.normal(size=(3, len(which)))
    positions = scene.positions.copy()
    positions[:, which] = distance * rays / np.linalg.norm(rays, axis=0)
    far = np.zeros(scene.count, bool)
    far[which] = True
    return replace(scene, positions=positions), far


def coded(scene: Scene, config: Config) -> tuple[Scene, tuple[str, ...]]:
    """A decoded scene, with the comment that states its order, and the losses."""
    data, report = encode_scene(scene, config)
    if config.format != "egs":
        return decode_interchange(data, config), report.lost
    return with_order(decode_scene(data), order_of_file(inspect_bytes(data))), report.lost


def moved_lines(lost: tuple[str, ...]) -> list[str]:
    return [line for line in lost if "moved nearer" in line]


# Which are far


@pytest.mark.parametrize("distance", [30.0, *DISTANCES, 1e30])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.03])
def test_far_gaussians_are_found(scene, distance, share):
    moved, far = moved_away(scene, distance if share < 0.02 else 1e3 * distance, share)
    found = find_far(moved.positions, moved.log_scale)
    np.testing.assert_array_equal(found.far, np.flatnonzero(far))
    np.testing.assert_array_equal(found.near.low, moved.positions[:, ~far].min(axis=1))
    np.testing.assert_array_equal(found.near.high, moved.positions[:, ~far].max(axis=1))
    assert found.reach < 10 < found.farthest <= distance * 1e4


@pytest.mark.parametrize("name", edge_scenes())
def test_ordinary_scenes_have_no_far_gaussians(name):
    scene = edge_scenes()[name]
    assert find_far(scene.positions, scene.log_scale) is None
    assert bring_nearer(scene) == (scene, ())


@pytest.mark.parametrize(
    "name",
    [
        "bonsai/point_cloud.ply",
        "fox/point_cloud.ply",
        "mouse/point_cloud.ply",
        "village/point_cloud.ply",
        "flowers_sh2.ply",
        "showroom_sh0.ply",
        "tiny_sh3.ply",
        "plant.splat",
        "biker.spz",
        "biker.compressed.ply",
    ],
)
def test_real_scenes_have_far_gaussians_only_if_added(name):
    scene = read_scene(shared_scene_path(name), "drop")
    assert find_far(scene.positions, scene.log_scale) is None
    reach = float(np.abs(scene.positions).max())
    for share in SHARES:
        moved, far = moved_away(scene, 20 * reach, share)
        found = find_far(moved.positions, moved.log_scale)
        np.testing.assert_array_equal(found.far, np.flatnonzero(far))


def test_a_background_of_large_gaussians_is_not_far(scene):
    moved, far = moved_away(scene, 50.0, 0.01)
    sizes = np.where(far, np.float32(np.log(7.0)), moved.log_scale)
    assert find_far(moved.positions) is not None
    assert find_far(moved.positions, sizes) is None
    # Any grid would be too coarse for this one.
    moved, far = moved_away(scene, 5e4, 0.01)
    sizes = np.where(far, np.float32(np.log(7e3)), moved.log_scale)
    assert find_far(moved.positions, sizes).far.size == far.sum()


def test_far_gaussians_at_all_distances(scene):
    """A tail without gaps, from 100 to 1e9: nearly all of it is far."""
    moved, far = moved_away(scene, 1.0, 0.02)
    tail = np.geomspace(100, 1e9, far.sum())
    positions = moved.positions.copy()
    positions[:, far] *= tail
    found = find_far(positions.astype(np.float32), moved.log_scale)
    assert found.reach < 30
    assert set(np.flatnonzero(far)) == set(found.far)


@pytest.mark.parametrize("count", range(1, 10))
def test_few_gaussians(count):
    scene, _ = moved_away(random_scene(count, 0), 1e9)
    found = find_far(scene.positions, scene.log_scale)
    assert (found is None) == (count < 8)
    assert sorted(spatial_order(scene.positions)) == list(range(count))


# Drawn nearer


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_moved_gaussians_look_the_same_from_the_middle(scene, distance, factor):
    moved, far = moved_away(scene, distance, 0.01)
    large = np.where(far, np.float32(np.log(0.1 * distance)), moved.log_scale)
    moved = replace(moved, log_scale=large)
    before = moved.positions.copy(), moved.log_scale.copy()
    found = find_far(moved.positions, moved.log_scale)
    drawn, (line,) = bring_nearer(moved, factor)
    np.testing.assert_array_equal(moved.positions, before[0])
    np.testing.assert_array_equal(moved.log_scale, before[1])
    np.testing.assert_array_equal(drawn.positions[:, ~far], moved.positions[:, ~far])
    np.testing.assert_array_equal(drawn.log_scale[:, ~far], moved.log_scale[:, ~far])
    box = found.box(factor)
    after = drawn.positions.T.astype(np.float64)
    assert (after >= box.low - 1e-5).all()
    assert (after <= box.high + 1e-5).all()
    rays = [s.positions.T[far].astype(np.float64) - found.middle for s in (moved, drawn)]
    lengths = [np.linalg.norm(each, axis=1) for each in rays]
    cosines = (rays[0] * rays[1]).sum(axis=1) / (lengths[0] * lengths[1])
    np.testing.assert_allclose(cosines, 1, atol=1e-6)
    angles = [np.exp(s.log_scale[0, far]) / r for s, r in zip((moved, drawn), lengths, strict=True)]
    np.testing.assert_allclose(angles[0], angles[1], rtol=1e-4)
    assert f"{far.sum()} of {COUNT:,} Gaussians" in line
    assert 'Action("remove-floaters")' in line


def test_far_dots_fade_without_opacity_compensation(scene):
    moved, far = moved_away(scene, 1e6, 0.01)
    drawn, _ = bring_nearer(moved)
    np.testing.assert_array_equal(drawn.opacity[:, ~far], moved.opacity[:, ~far])
    assert (drawn.opacity[:, far] < np.log(1 / 254)).all()
    assert (drawn.opacity[:, far] <= moved.opacity[:, far]).all()
    kept, _ = bring_nearer(antialiased(moved))
    np.testing.assert_array_equal(kept.opacity, moved.opacity)
    # One pixel: 0.5 mrad.
    sizes = np.where(far, np.float32(np.log(500.0)), moved.log_scale)
    drawn, _ = bring_nearer(replace(moved, log_scale=sizes))
    shares = [1 / (1 + np.exp(-s.opacity[0, far].astype(np.float64))) for s in (moved, drawn)]
    lengths = np.linalg.norm(moved.positions.T[far] - find_far(moved.positions).middle, axis=1)
    expected = 1 / (1 + 0.3 * (lengths / 1e6) ** 2)
    kept = shares[1] > 0.002
    np.testing.assert_allclose((shares[1] / shares[0])[kept], expected[kept], rtol=1e-3)
    large = np.where(far, np.float32(np.log(1e5)), moved.log_scale)
    drawn, _ = bring_nearer(replace(moved, log_scale=large))
    np.testing.assert_allclose(drawn.opacity, moved.opacity, atol=0.05)


def test_opaque_and_fully_transparent_far_gaussians(scene):
    moved, far = moved_away(scene, 1e6, 0.01)
    opacity = np.where(far, np.float32(200.0), moved.opacity)
    opacity[0, np.flatnonzero(far)[0]] = -200.0
    for size in (-40.0, np.log(1e5)):
        sizes = np.where(far, np.float32(size), moved.log_scale)
        drawn, _ = bring_nearer(replace(moved, opacity=opacity, log_scale=sizes))
        assert np.isfinite(drawn.opacity).all()
        assert (drawn.opacity <= opacity).all()


def test_small_far_gaussians_stay_finite_and_flat_scenes_keep_a_thickness(scene):
    flat = scene.positions.copy()
    flat[1] = 0.25
    moved, far = moved_away(replace(scene, positions=flat), 1e9, 0.01)
    drawn, _ = bring_nearer(moved)
    assert (drawn.log_scale[:, far] > -20).all()
    apart = np.abs(drawn.positions[:, far] - np.median(flat, axis=1)[:, None]).max(axis=0)
    assert apart.min() > 0.1
    reach = find_far(moved.positions).reach
    assert np.ptp(drawn.positions[1]) <= 0.26 * reach


@pytest.mark.parametrize("logit", [0.5, 40.0])
def test_only_centres_and_scales_of_huge_gaussians_change(scene, logit):
    moved, far = moved_away(scene, 1e9, 0.01)
    sizes = np.where(far, np.float32(400.0), moved.log_scale)
    large = replace(moved, log_scale=sizes, opacity=np.full_like(moved.opacity, logit))
    drawn, lost = draw_nearer(large, found := find_far(moved.positions), found.box())
    assert len(lost) == 1
    np.testing.assert_allclose(drawn.opacity, logit, rtol=1e-6)
    assert (drawn.log_scale[:, far] < 390).all()


@pytest.mark.parametrize("height", [1e20, -3.4e38])
@pytest.mark.parametrize("also_along", [False, True])
def test_a_scene_without_thickness_far_from_the_origin(scene, height, also_along):
    """All other coordinates are far from 0, and the box is flat too."""
    moved, far = moved_away(scene, 1e9, 0.01)
    positions = moved.positions.copy()
    positions[2] = height
    if also_along:
        positions[2, far] = -height
    drawn, (line,) = bring_nearer(replace(moved, positions=positions))
    assert line.startswith("30 of 3,000 Gaussians")
    np.testing.assert_array_equal(drawn.positions[2], np.float32(height))
    assert np.abs(drawn.positions[:2]).max() < 30
    assert np.isfinite(drawn.log_scale).all()


def test_gaussians_inside_the_box_are_unchanged(scene):
    moved, _ = moved_away(scene, 1e3, 0.01)
    found = find_far(moved.positions)
    assert draw_nearer(moved, found, found.box(1e6)) == (moved, ())


# Order


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("share", SHARES)
def test_far_gaussians_come_last_and_do_not_affect_the_order(scene, distance, share):
    moved, far = moved_away(scene, distance, share)
    order = spatial_order(moved.positions, moved.log_scale)
    near = np.flatnonzero(~far)
    expected = near[spatial_order(scene.positions[:, near])]
    np.testing.assert_array_equal(order[: len(near)], expected)
    np.testing.assert_array_equal(np.sort(order), np.arange(COUNT))


# Writers


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("share", SHARES)
def test_near_centres_are_as_precise_as_without_far_ones(scene, name, distance, share):
    config = GRIDS[name]
    moved, far = moved_away(scene, distance, share)
    decoded, lost = coded(moved, config)
    first, second, how = put_side_by_side(moved, decoded)
    assert how == ("stored order" if config.format == "egs" else "Morton order")
    near = np.abs(first.positions).max(axis=0) < 20
    assert near.sum() == (~far).sum()
    error = np.abs(first.positions.astype(np.float64) - second.positions).max(axis=0)
    plain = scene.take(np.flatnonzero(~far))
    alone, other, _ = put_side_by_side(plain, coded(plain, config)[0])
    usual = np.abs(alone.positions.astype(np.float64) - other.positions).max(axis=0)
    bound = FACTORS.get(name, 1.0) * usual.max() * (1 + 1e-3)
    late = error[near] > bound
    assert late.sum() < (CHUNK if name == "compressed.ply" else 1)
    # Near Gaussians in such a chunk have steps of the scene's extent.
    assert error[near].max() <= max(bound, np.ptp(plain.positions, axis=1).max() / 1023)
    assert np.abs(second.positions).max() < 200
    (line,) = moved_lines(lost)
    assert f"{far.sum()} of {COUNT:,} Gaussians, " in line
    assert 'Action("remove-floaters")' in line


@pytest.mark.parametrize("name", FLOATS)
def test_float_formats_keep_far_gaussians(scene, name):
    moved, _ = moved_away(scene, 1e9, 0.01)
    decoded, lost = coded(moved, FLOATS[name])
    np.testing.assert_array_equal(decoded.positions, moved.positions)
    assert not moved_lines(lost)


@pytest.mark.parametrize("name", GRIDS)
def test_scenes_without_far_gaussians_report_nothing(scene, name):
    assert not moved_lines(coded(scene, GRIDS[name])[1])


@pytest.mark.parametrize("name", GRIDS)
def test_sizes_hardly_change(scene, name):
    usual = len(encode_scene(scene, GRIDS[name])[0])
    for share in SHARES:
        moved, _ = moved_away(scene, 1e9, share)
        assert len(encode_scene(moved, GRIDS[name])[0]) < 1.03 * usual


def test_spz_moves_only_unrepresentable_centres(scene):
    moved, _ = moved_away(scene, 100.0)
    decoded, lost = coded(moved, GRIDS["spz"])
    assert not moved_lines(lost)
    np.testing.assert_allclose(
        np.abs(decoded.positions).max(), np.abs(moved.positions).max(), atol=0.01
    )
    # Not rounded beyond the range of 24 bits.
    assert not any("clipped" in line and "centres" in line for line in lost)
    for distance in DISTANCES:
        _, lost = coded(moved_away(scene, distance, 0.01)[0], GRIDS["spz"])
        assert not any("clipped" in line and "centres" in line for line in lost)


def test_streamed_sog(scene):
    moved, _ = moved_away(scene, 1e9, 0.01)
    files, lost = stream_levels(moved, SmallBlocks(block_size=500))
    bounds = json.loads(files["lod-meta.json"])["tree"]["bound"]
    assert max(map(abs, (*bounds["min"], *bounds["max"]))) < 200
    assert len(moved_lines(lost)) == 1


def test_a_file_of_full_range_is_matched(scene, monkeypatch):
    """As written by earlier versions."""
    moved, _ = moved_away(scene, 1e3, 0.01)
    monkeypatch.setattr(entropygs, "bring_nearer", lambda scene: (scene, ()))
    decoded, lost = coded(moved, GRIDS["paper-l"])
    assert not lost
    first, second, _ = put_side_by_side(moved, decoded)
    assert np.abs(first.positions - second.positions).max() < 0.1


# Commands and API


@pytest.mark.parametrize(
    "arguments",
    [
        ["encode", "a.ply", "a.egs", "--profile", "paper-m"],
        ["encode", "a.ply", "a.spz"],
        ["convert", "a.ply", "a.sog"],
        ["convert", "a.ply", "a.compressed.ply"],
    ],
    ids=lambda arguments: arguments[2],
)
def test_convert_reports_moved_gaussians(scene, tmp_path, monkeypatch, caplog, arguments):
    monkeypatch.chdir(tmp_path)
    write_ply("a.ply", moved_away(scene, 1e6, 0.01)[0])
    with caplog.at_level(logging.WARNING):
        result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    assert len(moved_lines(tuple(said["lost"]))) == 1
    assert sum("moved nearer" in record.getMessage() for record in caplog.records) == 1


def test_encode_reports_moved_gaussians(scene, caplog):
    with caplog.at_level(logging.WARNING):
        gs_codec.encode(to_cloud(moved_away(scene, 1e6)[0]), Config("paper-m"))
    assert sum("moved nearer" in record.getMessage() for record in caplog.records) == 1


# Floaters


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("size", [None, 0.03, 0.3])
def test_remove_floaters_removes_them(scene, distance, share, size):
    moved, far = moved_away(scene, distance, share)
    if size is not None:
        large = np.where(far, np.float32(np.log(size * distance)), moved.log_scale)
        moved = replace(moved, log_scale=large)
    assert find_floaters(moved)[far].all()
    away = Camera("a", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(3), np.array([0, 0, 50.0]))
    assert find_floaters(moved.take(np.flatnonzero(~far))).sum() < 100
    if size is None:
        assert find_floaters(moved, [away])[far].all()


def test_a_far_cluster_is_removed(scene):
    cluster = scene.take(np.arange(40))
    cluster = replace(cluster, positions=cluster.positions + np.float32([[1e5], [0], [0]]))
    labels = find_floaters(join_scenes([scene, cluster]))
    assert labels[COUNT:].all()
    assert (labels[COUNT:] == FLOATERS.index("outside")).any()
