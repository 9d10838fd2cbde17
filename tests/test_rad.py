"""Spark's `.rad` files: every encoding of every property, trees, chunks in other files, damage."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import foreign
import numpy as np
import pytest
from refusals import assert_refused
from scenes import random_scene

from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import read_scene
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.packed_values import sigmoid, unit_quaternions
from gs_codec.formats.rad.file import RadFile
from gs_codec.formats.registry import open_scene, overview_of, scene_files
from gs_codec.levels.tree import leaf_order, pack_rad
from gs_codec.runtime.mapped import opened
from gs_codec.scene import ANTIALIASED, SH_C0


def written(folder, files, name="a.rad"):
    for each, data in files.items():
        (folder / (each or name)).write_bytes(data)
    return folder / name


def assert_read(scene, values, bound=1e-6):
    """A scene has the values of Gaussians in a file."""
    degree = sum(f"sh{band}" in values for band in (1, 2, 3))
    assert (scene.count, scene.sh_degree) == (values["alpha"].shape[1], degree)
    xyz = values["orientation"]
    found = {
        "center": scene.positions,
        "alpha": sigmoid(scene.opacity.astype(np.float64)),
        "rgb": 0.5 + SH_C0 * scene.f_dc,
        "scales": np.exp(scene.log_scale),
        "orientation": scene.rot[1:],
    }
    rest = scene.f_rest.reshape(3, -1, scene.count).transpose(1, 0, 2)
    for band, (first, last) in enumerate(((0, 3), (3, 8), (8, 15))[:degree], 1):
        found[f"sh{band}"] = rest[first:last].reshape(-1, scene.count)
    for name, rows in found.items():
        np.testing.assert_allclose(rows, values[name], rtol=bound, atol=bound, err_msg=name)
    wide = np.sqrt(1 - (xyz * xyz).sum(axis=0))
    np.testing.assert_allclose(scene.rot[0], wide, rtol=0, atol=2 * bound + 1e-6)


#: Encodings of properties, bounds of bytes, and the largest error.
ENCODINGS = {
    "floats": ({}, (0, 1), 1e-6),
    "halves": (
        dict.fromkeys(("alpha", "rgb", "orientation", "sh1", "sh2", "sh3"), "f16")
        | {"center": "f16", "scales": "ln_f16"},
        (0, 1),
        4e-3,
    ),
    "planes": ({"center": "f16_lebytes"}, (0, 1), 4e-3),
    "bytes": ({"alpha": "r8", "rgb": "r8", "sh1": "s8"}, (-0.5, 1.25), 6e-3),
    "differences": ({"rgb": "r8_delta", "sh1": "s8_delta", "sh2": "r8_delta"}, (-0.75, 1), 6e-3),
    "scales": ({"scales": "ln_0r8"}, (-9.0, 0.5), 0.02),
    "rotations": ({"orientation": "oct88r8"}, (0, 1), 0.015),
}


@pytest.mark.parametrize("case", ENCODINGS)
def test_values_are_read_in_every_encoding(case, tmp_path):
    encodings, bounds, bound = ENCODINGS[case]
    values = foreign.rad_values(50, 3, seed=1)
    path = written(tmp_path, foreign.rad_file([foreign.rad_chunk(values, encodings, bounds)]))
    assert_read(read_scene(path), values, bound)


@pytest.mark.parametrize(("size", "read"), [(8_200_000, True), (17_000_000, False)])
def test_the_description_of_many_small_chunks_is_read(size, read, tmp_path):
    """LichtFeld Studio writes 8 MB for 137 million Gaussians."""
    values = foreign.rad_values(5, 0, seed=1)
    chunk = foreign.rad_chunk(values, *ENCODINGS["floats"][:2])
    path = written(tmp_path, foreign.rad_file([chunk], comment="c" * size))
    if read:
        assert read_scene(path).count == 5
    else:
        with pytest.raises(InvalidInput, match="expected b'RAD0' and a description"):
            read_scene(path)


@pytest.mark.parametrize("degree", range(4))
def test_only_leaves_of_all_chunks_are_read(degree, tmp_path, caplog):
    values = [foreign.rad_values(n, degree, seed=n, levels=True) for n in (9, 4)]
    values[1]["child_count"][:] = 0
    leaves = {
        name: np.concatenate([values[0][name][:, 1:], values[1][name]], axis=1)
        for name in values[0]
    }
    chunks = [foreign.rad_chunk(each, {}) for each in values]
    for prefix in (None, "a-"):
        path = written(tmp_path, foreign.rad_file(chunks, prefix=prefix))
        assert_read(read_scene(path), leaves)
    with open_scene(path) as file:
        assert file.stored_bytes == sum(each.stat().st_size for each in tmp_path.iterdir())
    assert {*scene_files(path)} == {*tmp_path.iterdir()}
    alone = tmp_path / "a-0.radc"
    assert (overview_of(alone).format, overview_of(alone).count) == ("rad", 8)
    assert caplog.messages == 2 * [
        f"{alone}: one of several files; the others contain the rest of the scene"
    ]


def test_sh_may_be_rows_of_a_table(tmp_path):
    values = [foreign.rad_values(7, 3, seed=seed) for seed in range(2)]
    tables = foreign.rad_values(3, 3, seed=5)
    labels = [np.arange(7)[None] % 3, np.arange(1, 8)[None] % 3]
    for each, rows in zip(values, labels, strict=True):
        for band in (1, 2, 3):
            each[f"sh{band}"] = tables[f"sh{band}"][:, rows[0]]
    stored = [{n: v for n, v in each.items() if not n.startswith("sh")} for each in values]
    stored[0] |= {f"sh{band}_code": tables[f"sh{band}"] for band in (1, 2, 3)}
    chunks = [
        foreign.rad_chunk(each | {"sh_label": rows}, {})
        for each, rows in zip(stored, labels, strict=True)
    ]
    path = written(tmp_path, foreign.rad_file(chunks))
    whole = {name: np.concatenate([each[name] for each in values], axis=1) for name in values[0]}
    assert_read(read_scene(path), whole)


def test_bytes_of_transparent_opaque_and_flat_gaussians(tmp_path, caplog):
    values = foreign.rad_values(3, 0, seed=1)
    values["alpha"][:] = [0, 1, 2]
    values["scales"][0, 0] = 1e-30
    encodings = {"alpha": "r8", "scales": "ln_0r8"}
    chunk = foreign.rad_chunk(values, encodings, (-20, 2))
    scene = read_scene(written(tmp_path, foreign.rad_file([chunk])), exact=True)
    assert np.isneginf(scene.log_scale[0, 0])
    assert np.isfinite(scene.opacity).all()


#: Changes of the description of a file, and of its chunk: a value by its path.
OF_FILE = {
    "version": ({"version": 2}, "version 2, expected 1"),
    "type": ({"type": "mesh"}, "type 'mesh', expected gsplat"),
    "count": ({"count": 6}, "chunks of 5 Gaussians, expected 6"),
    "many": ({"count": 1 << 39}, "at most 1,073,741,824 are read"),
    "degree": ({"maxSh": 4}, "SH degree 4, expected 0 to 3"),
    "chunks": ({"chunks": 3}, "chunks: expected a list"),
    "no chunks": ({"chunks": []}, "chunks of 0 Gaussians, expected 5"),
    "beyond": ({"chunks": [{"offset": 9999, "bytes": 9}]}, "chunk 0: 9 bytes at .*, of "),
    "overlap": ({"chunks": 99 * [{"bytes": 900}]}, "chunks of 89,100 bytes, of "),
    "elsewhere": (
        {"chunks": [{"filename": "../b.radc"}]},
        "chunks in '../b.radc'..., expected names of different files",
    ),
    "again": ({"chunks": 2 * [{"filename": "b.radc"}]}, "chunks in 'b.radc'..., expected names of"),
}
OF_CHUNK = {
    "version of a chunk": ("version", True, "chunk 0: version True, expected 1"),
    "many in a chunk": ("count", 1 << 39, "chunks of 549,755,813,888 Gaussians, expected"),
    "count of a chunk": ("count", 4, "chunks of 4 Gaussians, expected 5"),
    "properties": ("properties", {}, "chunk 0: properties: expected a list"),
    "twice": ("properties.1.property", "center", "properties: two with the same name"),
    "absent": ("properties.1.property", "beta", "property 'alpha': missing"),
    "encoding": ("properties.0.encoding", "f64", "'center': encoding 'f64', expected f32, f16"),
    "other type": ("properties.0.encoding", "f16", "'center': 31 bytes, expected 30"),
    "compression": ("properties.0.compression", "zstd", "compression 'zstd', expected gz"),
    "offset": ("properties.0.offset", 9999, "'center': .* bytes at .*, of "),
    "size": ("properties.0.bytes", 4, "deflate stream: cut off"),
    "start": ("properties.1.offset", 3, "'alpha': deflate stream: 'Error"),
    "bound": ("properties.2.max", "x", "'rgb': bound 'x', expected a float32 number"),
}


@pytest.mark.parametrize("case", [*OF_FILE, *OF_CHUNK])
def test_damaged_files_are_refused_in_one_line(case, tmp_path):
    values = foreign.rad_values(5, 1, seed=3)
    about, payload = foreign.rad_chunk(values, {"rgb": "r8"})
    changes, message = OF_FILE.get(case, ({"count": 5, "maxSh": 1}, ""))
    if case in OF_CHUNK:
        where, value, message = OF_CHUNK[case]
        *keys, last = (int(key) if key.isdigit() else key for key in where.split("."))
        node: Any = about
        for key in keys:
            node = node[key]
        node[last] = value
    assert_refused(written(tmp_path, foreign.rad_file([(about, payload)], **changes)), message)


def test_a_missing_chunk_is_named(tmp_path):
    chunk = foreign.rad_chunk(foreign.rad_values(5, 0, seed=3), {})
    path = written(tmp_path, foreign.rad_file([chunk, chunk], prefix="a-"))
    (tmp_path / "a-1.radc").unlink()
    with pytest.raises(InvalidInput, match=r"a.rad: chunk 1: \S*a-1.radc: No such file"):
        read_scene(path)


def test_trees_without_leaves_and_truncated_files_are_refused(tmp_path):
    values = foreign.rad_values(5, 0, seed=3, levels=True)
    values["child_count"][:] = 1
    [whole] = foreign.rad_file([foreign.rad_chunk(values, {})]).values()
    assert_refused(written(tmp_path, {"": whole}), "a tree of 5 Gaussians without leaves")
    for size in (3, 7, 40, len(whole) - 1):
        with pytest.raises(InvalidInput, match=r"a\.rad: "):
            read_scene(written(tmp_path, {"": whole[:size]}))


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [1, 2, 700])
def test_errors_of_written_files_are_within_half_a_step(count, degree, tmp_path):
    scene = random_scene(count, degree, seed=degree)
    scene = replace(scene, f_dc=np.clip(scene.f_dc, -1.7, 5), f_rest=np.clip(scene.f_rest, -1, 1))
    data, lost = pack_rad(scene)
    back = read_scene(written(tmp_path, {"": data}))
    scene = scene.take(leaf_order(scene))
    assert (back.count, back.sh_degree) == (count, degree)
    np.testing.assert_array_equal(back.positions, scene.positions)
    np.testing.assert_allclose(back.f_dc, scene.f_dc, atol=0.5 / 255 * 3 / SH_C0 + 1e-6)
    np.testing.assert_allclose(back.f_rest, scene.f_rest, atol=0.5 / 127 + 1e-6)
    flat = np.maximum(scene.log_scale, scene.log_scale.max() - 15.875)
    np.testing.assert_allclose(back.log_scale, flat, atol=1 / 32 + 1e-5)
    shares = [sigmoid(each.opacity.astype(np.float64)) for each in (back, scene)]
    np.testing.assert_allclose(*shares, atol=0.76 / 255)
    first, second = (unit_quaternions(each.rot) for each in (back, scene))
    assert np.abs((first * second).sum(axis=0)).min() > np.cos(0.015)
    assert lost[0] == "opacity, colours, scales, rotations and SH rounded to 8 bits"


@pytest.mark.parametrize("count", [2, 5, 300, pytest.param(70_000, marks=pytest.mark.slow)])
def test_every_gaussian_but_the_root_has_one_parent_before_it(count, tmp_path):
    path = written(tmp_path, {"": pack_rad(random_scene(count, 0))[0]})
    with opened(path) as data:
        chunks = [
            (c.count, c.read("child_count").numbers[0], c.read("child_start").numbers[0])
            for c in RadFile(path, data).chunks()
        ]
    sizes, *columns = zip(*chunks, strict=True)
    assert all(size == 1 << 16 for size in sizes[:-1])
    number, start = (np.concatenate(each).astype(np.int64) for each in columns)
    parents = np.flatnonzero(number)
    found = np.concatenate([np.arange(start[i], start[i] + number[i]) for i in parents])
    np.testing.assert_array_equal(found, np.arange(1, len(number)))
    assert (start[parents] > parents).all()
    assert (number == 0).sum() == count


def test_coarser_levels_hide_as_much(tmp_path):
    """The root of four equal Gaussians at one place has their shape, and four times the opacity."""
    scene = random_scene(1, 1, seed=2).take(np.zeros(4, np.intp))
    tenth = np.full_like(scene.opacity, np.log(0.1 / 0.9))
    path = written(tmp_path, {"": pack_rad(replace(scene, opacity=tenth))[0]})
    with opened(path) as data:
        [chunk] = RadFile(path, data).chunks()
        alpha, scales = chunk.read("alpha").scaled()[0], chunk.read("scales").numbers
    assert alpha[0] == pytest.approx(4 * alpha[1], rel=0.03)
    np.testing.assert_array_equal(np.sort(scales[:, 0]), np.sort(scales[:, 1]))


def test_steps_and_effort_make_a_file_smaller(tmp_path):
    scene = random_scene(2000, 3, seed=1)
    scene = replace(scene, f_rest=np.clip(scene.f_rest, -0.9, 0.9))
    steps = AttributeSteps.least(scene)
    steps = replace(steps, positions=steps.positions + 2**-7, f_rest=steps.f_rest + 0.1)
    fast, high = (pack_rad(scene, steps, effort)[0] for effort in ("fast", "high"))
    assert len(high) < len(fast) < 0.8 * len(pack_rad(scene)[0])
    back = read_scene(written(tmp_path, {"": high}))
    scene = scene.take(leaf_order(scene))
    assert (np.mod(back.positions, 2**-7) == 0).all()
    assert np.abs(back.positions - scene.positions).max() <= 2**-8
    assert 0.01 < np.abs(back.f_rest - scene.f_rest).max() <= 0.05
    assert len(np.unique(np.abs(back.f_rest))) < 40


def test_values_that_cannot_be_stored_are_told_or_refused():
    scene = random_scene(40, 1)
    f_dc, f_rest, log_scale = scene.f_dc.copy(), scene.f_rest.copy(), scene.log_scale.copy()
    f_dc[:, :3], f_rest[4, :5], log_scale[1, :7] = 9, -1.5, -30
    _, lost = pack_rad(replace(scene, f_dc=f_dc, f_rest=f_rest, log_scale=log_scale))
    for each in ("colours", "SH", "log-scales"):
        assert sum(line.startswith(each) and line.endswith("format's range") for line in lost) == 1
    comments, label = (ANTIALIASED, "one"), np.zeros(40, "u1")
    _, lost = pack_rad(replace(scene, comments=comments, extra={"label": label}))
    assert lost[-1] == "left out: antialias flag; comments (1); properties label"
    with pytest.raises(InvalidInput, match="values that are not finite"):
        pack_rad(replace(scene, f_dc=f_dc * np.nan))
    with pytest.raises(InvalidInput, match=r"no Gaussians, \.rad needs at least one"):
        pack_rad(random_scene(0, 0))
