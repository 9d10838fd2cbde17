"""SOG writer: specification, wanted steps, and palettes as large as pays off."""

from __future__ import annotations

import io
import itertools
import json
import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes import random_scene, with_threads

from gs_codec.coding.morton import spatial_order
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats import cells, codebook
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.cells import WORTH, row_means, split_cells
from gs_codec.formats.codebook import (
    choose_colours,
    choose_levels,
    label_bits,
    make_table,
)
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.registry import open_scene
from gs_codec.formats.sog.nearest_rows import nearest_rows
from gs_codec.formats.sog.palette import fit_palette
from gs_codec.formats.sog.writer import pack_sog
from gs_codec.scene import ANTIALIASED, Scene, sh_bands


def unpacked(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """`meta.json`, and the pixels of each image."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}
        files = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(files.pop("meta.json"))
    images = {}
    for name, content in files.items():
        assert content[12:16] == b"VP8L", "lossless"
        images[name] = np.asarray(Image.open(io.BytesIO(content)).convert("RGBA"))
    return meta, images


def decoded(data: bytes, folder: Path) -> Scene:
    path = folder / "a.sog"
    path.write_bytes(data)
    return read_scene(path)


def steps_of(scene: Scene, step: float) -> AttributeSteps:
    """The same steps for all values."""
    least = AttributeSteps.least(scene)
    names = ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot")
    return replace(least, **{name: np.full_like(getattr(least, name), step) for name in names})


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [1, 3, 300])
def test_files_are_as_specified(count, degree, tmp_path):
    """The formulas of the specification, Gaussian by Gaussian."""
    scene = random_scene(count, degree)
    meta, images = unpacked(pack_sog(scene)[0])
    assert (meta["version"], meta["count"]) == (2, count)
    assert "model" not in meta
    named = [
        name
        for group in meta.values()
        if isinstance(group, dict)
        for name in group.get("files", ())
    ]
    assert named == list(images)
    assert ("shN" in meta) == (degree > 0)
    for name, pixels in images.items():
        if name != "shN_centroids.webp":
            assert pixels.shape[0] % 4 == pixels.shape[1] % 4 == 0
            assert 4 <= pixels.shape[0] <= pixels.shape[1]
    flat = {name: pixels.reshape(-1, 4).astype(int) for name, pixels in images.items()}
    ordered = scene.take(spatial_order(scene.positions))
    low, high = np.array(meta["means"]["mins"]), np.array(meta["means"]["maxs"])
    for i in range(count):
        share = (flat["means_l.webp"][i, :3] + 256 * flat["means_u.webp"][i, :3]) / 65535
        n = low + share * (high - low)
        centre = np.sign(n) * (np.exp(np.abs(n)) - 1)
        unit = (high - low) / 65535 * (1 + np.abs(ordered.positions[:, i]))
        assert (np.abs(centre - ordered.positions[:, i]) <= 0.51 * unit + 1e-6).all()
        *three, tag = flat["quats.webp"][i]
        three = (np.array(three) / 255 - 0.5) * np.sqrt(2)
        quaternion = np.insert(three, tag - 252, np.sqrt(max(0.0, 1 - (three**2).sum())))
        unit = ordered.rot[:, i] / np.linalg.norm(ordered.rot[:, i])
        assert abs(quaternion @ unit) > 0.9999
        scales = np.array(meta["scales"]["codebook"])[flat["scales.webp"][i, :3]]
        assert np.abs(scales - ordered.log_scale[:, i]).max() < 0.05
        colours = np.array(meta["sh0"]["codebook"])[flat["sh0.webp"][i, :3]]
        assert np.abs(colours - ordered.f_dc[:, i]).max() < 0.05
        alpha = flat["sh0.webp"][i, 3] / 255
        assert abs(alpha - 1 / (1 + np.exp(-float(ordered.opacity[0, i])))) <= 0.501 / 255
        if degree:
            row = flat["shN_labels.webp"][i] @ [1, 256, 0, 0]
            assert row < meta["shN"]["count"]
            wide = (0, 3, 8, 15)[degree]
            assert images["shN_centroids.webp"].shape[1] == 64 * wide
            pixels = images["shN_centroids.webp"][row // 64, row % 64 * wide :][:wide, :3]
            values = np.array(meta["shN"]["codebook"])[pixels.T].ravel()
            assert np.abs(values - ordered.f_rest[:, i]).max() < 0.05
    if degree:
        assert meta["shN"]["bands"] == degree


def test_a_scene_without_gaussians_is_valid():
    meta, images = unpacked(pack_sog(random_scene(0, 1))[0])
    assert meta["count"] == 0
    assert meta["shN"]["count"] == 1
    assert all(len(meta[name]["codebook"]) == 1 for name in ("scales", "sh0", "shN"))
    assert images["means_l.webp"].shape == (4, 4, 4)


def test_constant_attributes_take_one_value(tmp_path):
    scene = random_scene(1, 2).take(np.zeros(500, np.int64))
    data, _ = pack_sog(scene)
    meta, _ = unpacked(data)
    assert meta["shN"]["count"] == 1
    assert len(data) < 3000
    back = decoded(data, tmp_path)
    np.testing.assert_allclose(back.positions, scene.positions, rtol=1e-6)
    np.testing.assert_allclose(back.f_rest, scene.f_rest, atol=0.01)


def test_far_centres_and_zero_rotations_are_kept(tmp_path):
    scene = random_scene(4, 0)
    positions = np.array([[0, 1e30, -1e30, 3.4e38]] * 3, np.float32)
    scene = replace(scene, positions=positions, rot=np.zeros((4, 4), np.float32))
    back = decoded(pack_sog(scene)[0], tmp_path)
    order = spatial_order(positions)
    far = np.abs(positions[:, order]) > 1
    # Steps of the logarithm are 177 / 65535.
    np.testing.assert_allclose(back.positions[far], positions[:, order][far], rtol=2e-3)
    assert np.abs(back.positions[~far]).max() < 2e-3
    assert (np.argmax(np.abs(back.rot), axis=0) == 0).all()


def test_the_antialias_flag_is_kept_and_other_properties_are_not(tmp_path):
    scene = replace(
        random_scene(20, 0), comments=(ANTIALIASED, "by hand"), extra={"seen": np.zeros(20)}
    )
    data, lost = pack_sog(scene)
    assert unpacked(data)[0]["model"] == "antialiased"
    assert decoded(data, tmp_path).antialiased
    assert lost[1:] == ("left out: comments (1); properties seen",)


@pytest.mark.thorough
def test_the_same_scene_gives_the_same_bytes():
    scene = random_scene(20_000, 3)
    steps = steps_of(scene, 0.05)
    one, two = (with_threads(threads, pack_sog, scene, steps)[0] for threads in (1, 2))
    assert one == two


@pytest.mark.thorough
def test_steps_make_a_file_smaller_and_bound_its_errors(tmp_path):
    scene = random_scene(20_000, 1)
    ordered = scene.take(spatial_order(scene.positions))
    sizes = []
    for step in (0.0, 0.05, 0.2):
        data, _ = pack_sog(scene, steps_of(scene, step))
        sizes.append(len(data))
        back = decoded(data, tmp_path)
        if step:
            for name in ("f_dc", "log_scale", "positions"):
                error = getattr(back, name) - getattr(ordered, name)
                # A uniform quantiser has 1/12; the rest trades error for bits.
                assert (error**2).mean() < 0.2 * step**2, name
    assert sizes[0] > 1.1 * sizes[1] > 1.2 * sizes[2]


def test_zero_sh_stay_zero(tmp_path):
    scene = random_scene(5000, 2)
    f_rest = scene.f_rest.copy()
    f_rest[:, ::3] = 0
    scene = replace(scene, f_rest=f_rest)
    palette = fit_palette(scene.f_rest, steps_of(scene, 0.05).f_rest)
    values = palette.table[palette.levels[palette.labels]]
    assert not values[::3].any()
    assert values.any()


def test_rows_most_used_come_first_and_all_are_used():
    scene = random_scene(5000, 2)
    palette = fit_palette(scene.f_rest, steps_of(scene, 0.05).f_rest)
    counts = np.bincount(palette.labels, minlength=len(palette.levels))
    assert len(counts) == len(palette.levels) > 1
    assert (np.diff(counts) <= 0).all()
    assert counts.min() > 0


def palette_error(f_rest: np.ndarray, palette) -> float:
    return float(((palette.table[palette.levels[palette.labels]] - f_rest.T) ** 2).sum())


def test_a_palette_is_as_good_as_that_of_lloyd(monkeypatch):
    """With the same number of rows, 10 rounds of Lloyd from random rows have no smaller error."""
    rng = np.random.default_rng(4)
    groups = rng.normal(0, 0.3, (300, 24))
    vectors = (groups[rng.integers(0, 300, 4000)] + rng.normal(0, 0.05, (4000, 24))).astype("f4")
    monkeypatch.setattr("gs_codec.formats.sog.palette._MOST", 256)
    palette = fit_palette(np.ascontiguousarray(vectors.T), np.full((3, 4000), 1e-4))
    assert len(palette.levels) <= 256
    rows = vectors[rng.choice(4000, 256, replace=False)].astype(float)
    for _ in range(10):
        distances = (rows**2).sum(1) - 2 * vectors @ rows.T
        labels = distances.argmin(1)
        rows = np.stack(
            [vectors[labels == k].mean(0) if (labels == k).any() else rows[k] for k in range(256)]
        )
    distances = (vectors**2).sum(1)[:, None] + (rows**2).sum(1) - 2 * vectors @ rows.T
    assert palette_error(vectors.T, palette) < 1.02 * distances.min(1).sum()


def test_more_effort_finds_better_rows():
    rng = np.random.default_rng(5)
    f_rest = (rng.normal(size=(24, 3)) @ rng.normal(size=(3, 6000))).astype("f4")
    steps = np.full((3, 6000), 0.3)
    costs = []
    for effort in ("fast", "normal", "high"):
        palette = fit_palette(f_rest, steps, effort)
        labels = np.bincount(palette.labels)
        bits = label_bits(labels) @ labels
        costs.append(palette_error(f_rest, palette) / 0.3**2 + WORTH * bits)
    assert costs[0] > costs[1] > costs[2]


def test_gaussians_of_more_weight_are_nearer_to_their_rows():
    scene = random_scene(6000, 2)
    steps = np.full((3, 6000), 0.3)
    steps[:, ::2] = 0.03
    palette = fit_palette(scene.f_rest, steps)
    errors = ((palette.table[palette.levels[palette.labels]] - scene.f_rest.T) ** 2).mean(1)
    assert errors[1::2].mean() > 10 * errors[::2].mean()


def test_bands_have_steps_of_their_own():
    scene = random_scene(6000, 2)
    steps = np.full((3, 6000), 0.01)
    steps[1] = 0.5
    palette = fit_palette(scene.f_rest, steps)
    errors = (palette.table[palette.levels[palette.labels]].T - scene.f_rest) ** 2
    first, second = (
        np.mean([errors.reshape(3, 8, -1)[:, k] for k in band]) for band in sh_bands(8)
    )
    assert second > 5 * first


def test_absurd_sh_are_clipped_and_counted(tmp_path):
    scene = random_scene(300, 1)
    f_rest = scene.f_rest.copy()
    f_rest[4, 7] = -1e30
    data, lost = pack_sog(replace(scene, f_rest=f_rest))
    assert lost[1:] == ("SH of 1 Gaussian clipped to the format's range",)
    back = decoded(data, tmp_path)
    assert back.f_rest.min() == -4096
    assert np.count_nonzero(np.abs(back.f_rest) > 1) == 1


# Tables


def test_cells_are_split_while_it_pays_off():
    """Two distant clusters get two cells; their noise, below a step, is not split."""
    rng = np.random.default_rng(1)
    vectors = np.repeat([[0.0, 0.0], [10.0, 4.0]], 500, axis=0) + rng.normal(0, 0.1, (1000, 2))
    cells = split_cells(vectors.astype(np.float32), np.ones(1000), 100)
    assert cells.sizes().tolist() == [500, 500]
    labels = cells.labels()
    assert len(set(labels[:500])) == len(set(labels[500:])) == 1
    assert len(split_cells(vectors.astype(np.float32), np.full(1000, 1e6), 100).stops) == 100


@pytest.mark.parametrize("number", [1, 30, 700])
def test_the_nearest_row_is_that_of_the_least_cost(number):
    """If all blocks are searched, it is the best of all rows in use."""
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(number + 5, 9)).astype("f4")
    vectors = rng.normal(size=(2000, 9)).astype("f4")
    weights, labels = rng.uniform(0.1, 20, 2000), rng.integers(0, number, 2000).astype("i4")
    found = nearest_rows(vectors, weights, labels, rows, 10)
    bits = np.where(np.bincount(labels, minlength=len(rows)) > 0, 0, np.inf)
    bits += label_bits(np.bincount(labels, minlength=len(rows)))
    costs = weights[:, None] * ((vectors[:, None] - rows) ** 2).sum(2) + WORTH * bits
    np.testing.assert_allclose(costs[np.arange(2000), found], costs.min(1), rtol=1e-4)


def test_a_few_blocks_suffice_for_rows_in_the_order_of_cells():
    rng = np.random.default_rng(8)
    vectors = (rng.normal(size=(5000, 3)) @ rng.normal(size=(3, 24))).astype("f4")
    weights = np.full(5000, 50.0)
    cells = split_cells(vectors, weights, 2000)
    labels, number = cells.labels(), len(cells.stops)
    rows = row_means(vectors, weights, labels, number)[0].astype("f4")
    assert number == 2000
    few, all_blocks = (nearest_rows(vectors, weights, labels, rows, n) for n in (4, 16))
    errors = [((vectors - rows[found]) ** 2).sum() for found in (labels, few, all_blocks)]
    assert errors[1] - errors[2] < 0.1 * (errors[0] - errors[2])


def test_large_cells_are_split_by_a_sample():
    rng = np.random.default_rng(9)
    vectors = np.repeat([[0.0, 0.0], [3.0, 9.0]], 9000, axis=0) + rng.normal(0, 0.1, (18_000, 2))
    shuffled = rng.permutation(18_000)
    cells = split_cells(vectors[shuffled].astype("f4"), np.ones(18_000), 100)
    assert cells.sizes().tolist() == [9000, 9000]


def test_cells_are_the_same_when_vectors_are_moved_together(monkeypatch):
    vectors = np.random.default_rng(11).normal(size=(3000, 6)).astype("f4")
    apart = split_cells(vectors, np.full(3000, 40.0), 500)
    monkeypatch.setattr(cells, "_FEW", 10)
    together = split_cells(vectors, np.full(3000, 40.0), 500)
    assert len(apart.stops) == 500
    assert (together.order == apart.order).all()
    assert (together.stops == apart.stops).all()


def test_tables_of_many_values_are_made_from_every_few(monkeypatch):
    values, steps = np.random.default_rng(12).normal(size=(3, 20_000)), np.full(20_000, 0.1)
    whole = make_table(values, steps)
    monkeypatch.setattr(codebook, "_SORTED", 10_000)
    table = make_table(values, steps)
    errors = [np.abs(values[..., None] - each).min(2).std() for each in (whole, table)]
    assert not np.array_equal(table, whole)
    assert errors[1] < 1.1 * errors[0]


def test_a_table_contains_few_distinct_values_exactly():
    values = np.repeat(np.array([-3.0, 0.5, 7.25], np.float32), 40)
    assert make_table(values, np.full(120, 0.01)).tolist() == [-3.0, 0.5, 7.25]
    assert make_table(values[:0], values[:0]).tolist() == [0.0]


def test_a_table_is_no_worse_than_uniform():
    values = np.random.default_rng(3).normal(0, 1, 20_000)
    table = make_table(values, np.full(len(values), 1e-3))
    assert len(table) == 256
    near = table[choose_levels(values, np.zeros(len(values)), table)]
    width = (values.max() - values.min()) / 256
    assert ((near - values) ** 2).mean() < width**2 / 12


def test_levels_without_steps_are_the_nearest():
    rng = np.random.default_rng(5)
    values, table = rng.uniform(-1, 11, 500), np.arange(10.0)
    levels = choose_levels(values, np.zeros(500), table)
    assert (levels == np.abs(values[:, None] - table).argmin(1)).all()


def entropy(levels: np.ndarray) -> float:
    counts = np.bincount(levels.ravel())
    return float(label_bits(counts) @ counts / counts.sum())


def test_coarse_steps_take_fewer_bits_at_a_bounded_error():
    values, table = np.random.default_rng(6).uniform(0, 255, 20_000), np.arange(256.0)
    fine = choose_levels(values, np.full(len(values), 0.01), table)
    coarse = choose_levels(values, np.full(len(values), 16.0), table)
    assert entropy(coarse) < entropy(fine) - 3
    assert ((table[coarse] - values) ** 2).mean() < 0.15 * 16**2


def test_colours_with_fine_steps_are_the_nearest():
    rng = np.random.default_rng(8)
    values, table = rng.normal(0, 2, (3000, 3, 1)), np.sort(rng.normal(0, 2, 60))
    levels = choose_colours(values, np.exp(rng.uniform(-9, -5, (3000, 1))), table)
    nearest = np.abs(values[..., None] - table).min(axis=3)
    assert (np.abs(table[levels] - values) <= nearest + 0.05).all()


def test_colours_are_chosen_for_differences_to_green():
    rng = np.random.default_rng(7)
    grey = rng.normal(0, 20, (4000, 1, 3)) + rng.normal(0, 2, (4000, 3, 3)) + 128
    table, steps = np.arange(256.0), np.full((4000, 3), 4.0)
    apart = choose_levels(grey.ravel(), np.full(grey.size, 4.0), table).reshape(grey.shape)
    together = choose_colours(grey, steps, table)

    def bits(levels: np.ndarray) -> float:
        wide = levels.astype(int)
        others = [(wide[:, c] - wide[:, 1]) & 255 for c in (0, 2)]
        return sum(map(entropy, (wide[:, 1], *others)))

    def cost(levels: np.ndarray) -> float:
        return 3 * ((table[levels] - grey) ** 2).mean() / 16 + WORTH * bits(levels)

    assert bits(together) < bits(apart) - 1
    assert cost(together) < cost(apart)


# Files


def test_the_files_of_a_scene_may_be_in_a_folder(tmp_path):
    scene = random_scene(300, 2)
    write_ply(tmp_path / "scene.ply", scene)
    (tmp_path / "apart").mkdir()
    encode_file(tmp_path / "scene.ply", tmp_path / "one.sog")
    report = encode_file(tmp_path / "scene.ply", tmp_path / "apart" / "meta.json")
    assert report.file_bytes == (tmp_path / "one.sog").stat().st_size
    with zipfile.ZipFile(tmp_path / "one.sog") as archive:
        names = archive.namelist()
        for name in names:
            assert (tmp_path / "apart" / name).read_bytes() == archive.read(name)
    assert sorted(names) == sorted(path.name for path in (tmp_path / "apart").iterdir())
    first, second = (
        read_scene(path) for path in (tmp_path / "one.sog", tmp_path / "apart" / "meta.json")
    )
    for group in ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot"):
        np.testing.assert_array_equal(getattr(first, group), getattr(second, group))
    with pytest.raises(InvalidInput, match="exists"):
        encode_file(tmp_path / "scene.ply", tmp_path / "apart" / "meta.json", overwrite=False)


def test_a_full_disk_leaves_the_old_files_of_a_scene(tmp_path, monkeypatch):
    for seed in (1, 2):
        write_ply(tmp_path / f"{seed}.ply", random_scene(300, 1, seed=seed))
    encode_file(tmp_path / "1.ply", tmp_path / "meta.json")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    synced, original = itertools.count(1), os.fsync

    def fsync(descriptor: int) -> None:
        if next(synced) == 5:  # each file, and its folder
            raise OSError(28, "No space left on device")
        original(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    said = rf"^{tmp_path}/\w+\.webp: No space left on device$"
    with pytest.raises(InvalidInput, match=said):
        encode_file(tmp_path / "2.ply", tmp_path / "meta.json", overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    monkeypatch.undo()
    encode_file(tmp_path / "2.ply", tmp_path / "meta.json", overwrite=True)
    assert sorted(before) == sorted(tmp_path.iterdir())


def test_converting_counts_all_files(tmp_path):
    write_ply(tmp_path / "scene.ply", random_scene(300, 1))
    done = convert_file(tmp_path / "scene.ply", tmp_path / "meta.json")
    files = [path for path in tmp_path.iterdir() if path.suffix in (".json", ".webp")]
    assert len(files) == 8
    assert done.file_bytes == sum(path.stat().st_size for path in files)
    with open_scene(tmp_path / "meta.json") as file:
        assert file.format == "sog"
