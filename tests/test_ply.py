"""PLY files: every layout is read bit-exactly, one is written, invalid files are rejected."""

from __future__ import annotations

import logging
import os
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
from refusals import assert_one_line
from scenes import assert_same_bits, assert_same_floats, random_scene, shared_scene_path

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.edit.actions import Action
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import turn_shift
from gs_codec.formats.ply import ply_header
from gs_codec.formats.ply.body import ply_of
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows, write_ply
from gs_codec.formats.registry import open_scene
from gs_codec.runtime import mapped
from gs_codec.runtime.mapped import opened
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene, offset_of

#: Every scalar type of the PLY format.
PLY_TYPES = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")
NORMALS = ["nx", "ny", "nz"]


def inria_properties(sh_degree: int, normals: bool) -> list[str]:
    """The order of the INRIA trainer's ``construct_list_of_attributes``."""
    rest = 3 * SH_COEFFICIENTS[sh_degree]
    return [
        *("x", "y", "z"),
        *(NORMALS if normals else ()),
        *("f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(rest)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]


def write_rows(path: Path, rows: np.ndarray, comments: tuple[str, ...] = (), **options) -> Path:
    """Write structured rows with plyfile alone, independently of `write_ply`."""
    element = plyfile.PlyElement.describe(rows, "vertex")
    plyfile.PlyData([element], comments=list(comments), **options).write(str(path))
    return path


def with_columns(rows: np.ndarray, columns: dict[str, np.ndarray]) -> np.ndarray:
    """The rows with some columns of another type, or added at the end."""
    types = {name: rows.dtype[name] for name in rows.dtype.names}
    types |= {name: column.dtype for name, column in columns.items()}
    result = np.empty(len(rows), list(types.items()))
    for name in types:
        result[name] = columns[name] if name in columns else rows[name]
    return result


def random_bits(dtype: str, count: int, seed: int) -> np.ndarray:
    """Random bit patterns, including NaN payloads, infinities and denormals."""
    data = np.random.default_rng(seed).bytes(count * np.dtype(dtype).itemsize)
    return np.frombuffer(data, dtype)


def nonfinite_scene(count: int, sh_degree: int, seed: int) -> Scene:
    """A scene of random bits, so that any conversion would show."""
    scene = random_scene(count, sh_degree, seed)
    planes = {
        group: random_bits("<f4", getattr(scene, group).size, seed + i).reshape(-1, count)
        for i, group in enumerate(GROUPS)
        if getattr(scene, group).size
    }
    return replace(scene, **planes)


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("sh_degree", range(4))
def test_round_trip_keeps_every_bit_seed1(sh_degree, normals, tmp_path):
    scene = nonfinite_scene(100, sh_degree, seed=1)
    scene = replace(scene, has_normals=normals, comments=("one", "", "  two\twords"))
    write_ply(tmp_path / "a.ply", scene)
    back = read_ply(tmp_path / "a.ply")
    assert_same_bits(scene, back)
    assert back.sh_degree == sh_degree


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("sh_degree", range(4))
def test_written_properties_are_the_trainers(sh_degree, normals, tmp_path):
    scene = replace(random_scene(3, sh_degree), has_normals=normals, comments=("made by a test",))
    write_ply(tmp_path / "a.ply", scene)
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    names = inria_properties(sh_degree, normals)
    assert header.decode().splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        "comment made by a test",
        "element vertex 3",
        *(f"property float {name}" for name in names),
    ]
    rows = np.frombuffer(body, "<f4").reshape(3, len(names))
    for name, plane in (("x", scene.positions[0]), ("rot_3", scene.rot[3])):
        np.testing.assert_array_equal(rows[:, names.index(name)], plane)
    assert not normals or not rows[:, 3:6].any()


@pytest.mark.parametrize("count", [0, 1, 2, 4097])
@pytest.mark.parametrize("sh_degree", [0, 3])
@pytest.mark.parametrize("form", [{}, {"text": True}, {"byte_order": ">"}], ids=str)
def test_forms_and_counts_seed2(form, sh_degree, count, tmp_path):
    if form.get("text"):
        count = min(count, 50)
    scene = replace(random_scene(count, sh_degree, seed=2), has_normals=True)
    assert_same_bits(scene, read_ply(write_rows(tmp_path / "a.ply", vertex_rows(scene), **form)))


@pytest.mark.parametrize("form", [{}, {"text": True}, {"byte_order": ">"}], ids=str)
@pytest.mark.parametrize("seed", range(3))
def test_order_of_properties_does_not_matter(seed, form, tmp_path):
    scene = replace(random_scene(20, 3, seed), has_normals=True)
    rows = vertex_rows(scene)
    names = np.random.default_rng(seed).permutation(rows.dtype.names).tolist()
    shuffled = np.empty(20, [(name, "<f4") for name in names])
    for name in names:
        shuffled[name] = rows[name]
    assert_same_bits(scene, read_ply(write_rows(tmp_path / "a.ply", shuffled, **form)))


@pytest.mark.parametrize("name", ["x", "f_rest_44", "rot_0"])
def test_exact_doubles_are_read_without_a_message_seed3(name, tmp_path, caplog):
    scene = random_scene(20, 3, seed=3)
    rows = vertex_rows(scene)
    doubles = with_columns(rows, {name: rows[name].astype("<f8")})
    assert_same_bits(scene, read_ply(write_rows(tmp_path / "a.ply", doubles)))
    assert caplog.text == ""


def test_rounded_doubles_are_reported_seed4(tmp_path, caplog):
    scene = random_scene(20, 1, seed=4)
    rows = vertex_rows(scene)
    values = rows["opacity"].astype("<f8")
    values[[3, 7, 11]] += 1e-9
    path = write_rows(tmp_path / "a.ply", with_columns(rows, {"opacity": values}))
    with caplog.at_level(logging.WARNING):
        assert_same_bits(scene, read_ply(path))
    assert caplog.messages == [f"{path}: opacity rounded to float32 in 3 Gaussians"]


def test_doubles_beyond_float32_are_infinite_not_rounded(tmp_path, caplog):
    rows = vertex_rows(random_scene(20, 0))
    far = rows["x"].astype("<f8")
    far[5] = 1e300
    scene = read_ply(write_rows(tmp_path / "a.ply", with_columns(rows, {"x": far})))
    assert np.flatnonzero(np.isinf(scene.positions[0])).tolist() == [5]
    assert caplog.text == ""


@pytest.mark.parametrize("name", ["tiny_sh3.ply", "bonsai/point_cloud.ply"])
def test_real_files_are_written_back_byte_for_byte(name, tmp_path):
    path = shared_scene_path(name)
    write_ply(tmp_path / "a.ply", read_ply(path))
    assert (tmp_path / "a.ply").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("newline", [b"\r\n", b"\n"])
def test_line_ends_of_the_header_are_not_surplus(newline, tmp_path, caplog):
    path = tmp_path / "a.ply"
    scene = random_scene(5, 0)
    write_ply(path, scene)
    header, body = path.read_bytes().split(b"end_header\n")
    path.write_bytes(header.replace(b"\n", newline) + b"end_header" + newline + body)
    assert_same_bits(scene, read_ply(path))
    assert caplog.text == ""


def test_ignored_content_is_reported(tmp_path, caplog):
    path = tmp_path / "a.ply"
    write_ply(path, random_scene(5, 0))
    data = path.read_bytes().replace(b"element", b"obj_info from a scanner\nelement")
    path.write_bytes(data + bytes(17))
    assert read_ply(path).count == 5
    assert caplog.messages == [
        f"{path}: left out: 17 bytes after the last vertex",
        f"{path}: left out: obj_info (1)",
    ]


def test_text_after_the_last_vertex_is_reported(tmp_path, caplog):
    path = tmp_path / "a.ply"
    for count in (5, 0):
        caplog.clear()
        write_rows(path, vertex_rows(random_scene(count, 0)), text=True)
        assert read_ply(path).count == count
        assert caplog.messages == []
        path.write_bytes(path.read_bytes() + b"1 2 3\n\n4\n")
        assert read_ply(path).count == count
        assert caplog.messages == [f"{path}: left out: 2 lines after the last vertex"]


@pytest.mark.parametrize("form", [{}, {"byte_order": ">"}], ids=str)
def test_16_bit_integers_are_half_floats_seed15(form, tmp_path, caplog):
    """PLY has no type for half floats; some programs state ``ushort``."""
    scene = random_scene(40, 1, seed=15)
    halves = {g: getattr(scene, g).astype("<f2").astype("<f4") for g in GROUPS}
    expected = replace(scene, **halves, extra={"label": np.arange(40, dtype="<u2")})
    rows = vertex_rows(expected)
    names = inria_properties(1, False)
    stated = with_columns(rows, {n: rows[n].astype("<f2").view("<u2") for n in names})
    path = write_rows(tmp_path / "a.ply", stated, **form)
    assert_same_bits(expected, read_ply(path))
    told = f"16-bit integers read as half floats: {', '.join(names[:8])}, 15 more"
    assert caplog.messages == [f"{path}: {told}"]


def test_extra_properties_are_refused_kept_or_dropped(tmp_path, caplog):
    scene = random_scene(30, 1, seed=5)
    extra = {"label": np.arange(30, dtype="<i4"), "weight": np.linspace(0, 1, 30)}
    path = write_rows(tmp_path / "a.ply", with_columns(vertex_rows(scene), extra))
    with pytest.raises(InvalidInput, match=r'label, weight .*extra="keep" or extra="drop"'):
        read_ply(path, "error")
    assert_same_bits(replace(scene, extra=extra), read_ply(path, "keep"))
    assert caplog.messages == []
    assert_same_bits(scene, read_ply(path, "drop"))
    assert caplog.messages == [f"{path}: left out: properties label, weight"]


@pytest.mark.parametrize("extra", ["keep", "error", "drop"])
def test_degree_4_is_dropped_seed6(extra, tmp_path, caplog):
    scene = random_scene(9, 3, seed=6)
    rest = scene.f_rest.reshape(3, 15, 9)
    whole = np.concatenate([rest, np.ones((3, 9, 9), np.float32)], axis=1).reshape(72, 9)
    rows = vertex_rows(replace(scene, f_rest=np.empty((0, 9), np.float32)))
    rows = with_columns(rows, {f"f_rest_{i}": column for i, column in enumerate(whole)})
    path = write_rows(tmp_path / "a.ply", rows)
    back = read_scene(path, extra)
    assert_same_floats(back, scene)
    assert not back.extra
    assert caplog.messages == [f"{path}: left out: SH of degree 4"]


def test_normals_that_are_not_zero_are_refused_kept_or_dropped(tmp_path):
    scene = replace(random_scene(30, 1, seed=6), has_normals=True)
    nz = np.zeros(30, "<f4")
    nz[17] = 1
    path = write_rows(tmp_path / "a.ply", with_columns(vertex_rows(scene), {"nz": nz}))
    with pytest.raises(InvalidInput, match="normals are not all zero"):
        read_ply(path, "error")
    zero = np.zeros(30, "<f4")
    kept = read_ply(path, "keep")
    assert_same_bits(
        replace(scene, has_normals=False, extra={"nx": zero, "ny": zero, "nz": nz}), kept
    )
    write_ply(tmp_path / "b.ply", kept)
    assert_same_bits(kept, read_ply(tmp_path / "b.ply", "keep"))
    assert_same_bits(scene, read_ply(path, "drop"))


@pytest.mark.parametrize("names", [["nx"], ["ny", "nz"]], ids="-".join)
def test_some_normals_are_extra_properties(names, tmp_path):
    rows = with_columns(
        vertex_rows(random_scene(5, 0)), {n: np.arange(5, dtype="<f4") for n in names}
    )
    path = write_rows(tmp_path / "a.ply", rows)
    with pytest.raises(InvalidInput, match=", ".join(names)):
        read_ply(path, "error")
    kept = read_ply(path, "keep")
    assert (kept.has_normals, list(kept.extra)) == (False, names)


@pytest.mark.parametrize("byte_order", ["<", ">"])
def test_extra_of_every_type_stays_with_its_gaussian_bit_for_bit_seed7(byte_order, tmp_path):
    count = 3000
    scene = random_scene(count, 1, seed=7)
    extra = {f"p{i}": random_bits(t, count, 70 + i) for i, t in enumerate(PLY_TYPES)}
    extra["id"] = np.arange(count, dtype="<u4")
    rows = with_columns(vertex_rows(scene), extra)
    path = write_rows(tmp_path / "a.ply", rows, ("a comment",), byte_order=byte_order)
    data, _ = encode_scene(read_ply(path, "keep"), Config("paper-m", block_size=1024))
    write_ply(tmp_path / "b.ply", decode_scene(data))
    back = read_ply(tmp_path / "b.ply", "keep")
    assert back.comments == ("a comment",)
    order = back.extra["id"]
    assert sorted(order) == list(range(count))
    for name, column in extra.items():
        assert back.extra[name].dtype == column.dtype
        assert back.extra[name].tobytes() == column[order].tobytes(), name
    # 16 bits over a range below 8: half a step is 6e-5.
    np.testing.assert_allclose(back.positions, scene.positions[:, order], atol=1e-4)


@pytest.mark.parametrize("comment", ["bell\x07", "form\x0cfeed", "\x1cseparator", "delete\x7f"])
def test_unusual_comment_is_refused_or_decodes(comment, tmp_path):
    path = write_rows(tmp_path / "a.ply", vertex_rows(random_scene(5, 0)), (comment,))
    try:
        data, _ = encode_scene(read_ply(path))
    except InvalidInput:
        return
    assert decode_scene(data).count == 5


@pytest.mark.parametrize("name", ["bell\x07", "n" * 300], ids=["control", "long"])
def test_unusual_name_is_dropped(name, tmp_path, caplog):
    extra = {name: np.arange(5, dtype="<f4")}
    path = write_rows(tmp_path / "a.ply", with_columns(vertex_rows(random_scene(5, 0)), extra))
    assert read_ply(path, "keep").extra == {}
    assert caplog.messages == [f"{path}: left out: properties {name[:60]}"]


@pytest.mark.parametrize("form", [{}, {"text": True}, {"byte_order": ">"}], ids=str)
def test_plyfile_reads_the_same_numbers_of_every_type_seed13(form, tmp_path):
    scene = random_scene(40, 1, seed=13)
    extra = {f"p{i}": random_bits(t, 40, 130 + i) for i, t in enumerate(PLY_TYPES)}
    path = write_rows(tmp_path / "a.ply", with_columns(vertex_rows(scene), extra), **form)
    rows, back = plyfile.PlyData.read(str(path))["vertex"].data, read_ply(path, "keep")
    for name, column in {"x": back.positions[0], "rot_3": back.rot[3], **back.extra}.items():
        np.testing.assert_array_equal(column, rows[name])
    assert [column.dtype for column in back.extra.values()] == list(map(np.dtype, PLY_TYPES))


@pytest.mark.parametrize("form", [{}, {"text": True}, {"byte_order": ">"}], ids=str)
def test_rows_are_read_in_tiles_and_picked_in_any_order_seed14(form, tmp_path):
    scene = random_scene(9000, 0, seed=14)
    write_rows(tmp_path / "a.ply", vertex_rows(scene), **form)
    index = np.random.default_rng(14).permutation(9000)[:5000]
    with opened(tmp_path / "a.ply") as data:
        rows = ply_of(tmp_path / "a.ply", data).rows("vertex")
        found = {}
        rows.for_tiles(lambda place, tile: found.update({place.start: tile["x"].copy()}))
        picked = rows.pick(index).all()["y"]
        part = rows.pick(slice(4000, 8000)).all()["z"]
    x, y, z = scene.positions
    assert max(map(len, found.values())) <= 4096
    np.testing.assert_array_equal(np.concatenate([found[start] for start in sorted(found)]), x)
    np.testing.assert_array_equal(picked, y[index])
    np.testing.assert_array_equal(part, z[4000:8000])


def test_reading_allocates_the_planes_and_a_tile(tmp_path):
    write_ply(tmp_path / "a.ply", random_scene(20_000, 3))
    read_ply(tmp_path / "a.ply")
    tracemalloc.start()
    try:
        scene = read_ply(tmp_path / "a.ply")
        assert tracemalloc.get_traced_memory()[1] < 1.02 * scene.float_bytes + 1_100_000
    finally:
        tracemalloc.stop()


def cut(path: Path) -> None:
    os.truncate(path, 500)


def write_over(path: Path) -> None:
    data = path.read_bytes()
    with path.open("r+b") as file:
        file.write(data)
    os.utime(path, ns=(1, 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [(cut, "truncated while it was read: 500 bytes, expected"), (write_over, "was changed while")],
    ids=["cut", "written over"],
)
def test_file_that_changes_after_its_header_was_read_is_refused(change, message, tmp_path):
    path = tmp_path / "a.ply"
    write_ply(path, random_scene(5, 0))
    with open_scene(path) as file:
        assert file.ply.header.size < 500
        change(path)
        with pytest.raises(InvalidInput, match=message) as caught:
            file.scene()
    assert_one_line(caught.value, path)


def test_files_are_read_without_functions_of_posix(tmp_path, monkeypatch):
    """Windows can only move the position of a file, which threads share."""
    scene = random_scene(3000, 2)
    write_ply(tmp_path / "a.ply", scene)
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs", Config("m", block_size=1024))
    expected = read_scene(tmp_path / "a.egs")
    monkeypatch.delattr(os, "preadv")
    monkeypatch.setattr(mapped, "_MOST", 999)
    assert_same_floats(read_scene(tmp_path / "a.ply"), scene)
    with using_threads(3):
        assert_same_floats(read_scene(tmp_path / "a.egs"), expected)
    with open_scene(tmp_path / "a.ply") as file:
        cut(tmp_path / "a.ply")
        with pytest.raises(InvalidInput, match="truncated while it was read: 500 bytes, expected"):
            file.scene()


@pytest.mark.parametrize("change", [Path.unlink, lambda path: write_ply(path, random_scene(6, 1))])
def test_file_that_is_removed_or_replaced_is_read_as_it_was(change, tmp_path):
    path, scene = tmp_path / "a.ply", random_scene(5, 0)
    write_ply(path, scene)
    with open_scene(path) as file:
        change(path)
        np.testing.assert_array_equal(file.scene().positions, scene.positions)


@pytest.mark.parametrize("name", ["two words", "é", "x", "f_dc_0", ""])
def test_names_invalid_in_ply_are_refused(name, tmp_path):
    scene, extra = random_scene(5, 0), {name: np.arange(5, dtype="<f4")}
    with pytest.raises(InvalidInput, match=f"'{name}'"):
        write_ply(tmp_path / "a.ply", replace(scene, extra=extra))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("dtype", ["i8", "u8", "f2", "c8"])
def test_types_invalid_in_ply_are_refused(dtype, tmp_path):
    scene, extra = random_scene(5, 0), {"label": np.arange(5).astype(dtype)}
    with pytest.raises(InvalidInput, match="label"):
        write_ply(tmp_path / "a.ply", replace(scene, extra=extra))
    assert list(tmp_path.iterdir()) == []


def rewritten(old: str, new: str, form: str = "binary_little_endian"):
    """Make files: a valid PLY with the first `old` in its header replaced by `new`."""

    def make(good: bytes) -> bytes:
        header, body = good.split(b"end_header\n")
        assert old.encode() in header
        header = header.replace(b"binary_little_endian", form.encode())
        return header.replace(old.encode(), new.encode("latin-1"), 1) + b"end_header\n" + body

    return make


def one_row(text: str) -> bytes:
    """An ASCII file with one Gaussian, of degree 1."""
    names = "".join(f"property float {name}\n" for name in inria_properties(1, False))
    return f"ply\nformat ascii 1.0\nelement vertex 1\n{names}end_header\n{text}".encode()


@pytest.mark.parametrize("number", ["1e999", "9" * 100_000, "-1e400"], ids=["e", "digits", "-e"])
def test_numbers_too_large_for_a_float_are_infinite(number, tmp_path):
    (tmp_path / "a.ply").write_bytes(one_row(" ".join([number] + ["1"] * 22)))
    assert np.isinf(read_ply(tmp_path / "a.ply").positions[0, 0])


LIST = "property list uchar float "
BAD_FILES = {
    "empty": (lambda good: b"", "empty file"),
    "text": (lambda good: b"hello\nworld\n", "expected 'ply'"),
    "UTF-8 text": (lambda good: "hällo".encode(), "expected 'ply'"),
    "binary": (lambda good: bytes(range(256)), "PLY"),
    "signature alone": (lambda good: b"ply\n", "end-of-file"),
    "truncated header": (lambda good: good[:100], "end-of-file"),
    "no data": (lambda good: good.split(b"end_header\n")[0] + b"end_header\n", "row 0"),
    "truncated data": (lambda good: good[:-1], "row 4"),
    "truncated ASCII": (
        lambda good: rewritten("", "", "ascii")(good).split(b"end_header")[0] + b"end_header\n1 2",
        "5 rows of 23 numbers after 0 of others, but 3 bytes",
    ),
    "not a number": (
        lambda good: (
            rewritten("vertex 5", "vertex 1", "ascii")(good).split(b"end_header")[0]
            + b"end_header\n"
            + b"x " * 23
        ),
        "could not convert",
    ),
    "missing property": (rewritten("property float opacity\n", ""), "'opacity'"),
    "8 of f_rest": (rewritten("property float f_rest_8\n", ""), "8 f_rest .*9, 24 or 45"),
    "10 of f_rest": (rewritten("opacity", "f_rest_9"), "10 f_rest .*9, 24 or 45"),
    "gap in f_rest": (rewritten("f_rest_8", "f_rest_80"), "'f_rest_8'"),
    "list property": (rewritten("property float rot_3", LIST + "rot_3"), "rot_3"),
    "list beside the layout": (rewritten("property float x", LIST + "a\nproperty float x"), "'a'"),
    "no element": (lambda good: b"ply\nformat ascii 1.0\nend_header\n", "elements none"),
    "other element": (rewritten("element vertex", "element point"), "'point'"),
    "duplicate property": (rewritten("property float y", "property float x"), "same name"),
    "unknown type": (rewritten("property float y", "property quad y"), "quad"),
    "unknown format": (rewritten("1.0", "1.0", "binary_middle_endian"), "format"),
    "10^18 Gaussians": (rewritten("vertex 5", f"vertex {10**18 - 1}"), "row 5"),
    "10^11 Gaussians in ASCII": (rewritten("vertex 5", f"vertex {10**11}", "ascii"), "."),
    "10^30 Gaussians": (rewritten("vertex 5", f"vertex {10**30}"), "."),
    "negative count": (rewritten("vertex 5", "vertex -5"), "count"),
    "negative count in ASCII": (rewritten("vertex 5", "vertex -5", "ascii"), "count"),
    "fractional count": (rewritten("vertex 5", "vertex 5.0"), "count"),
    "non-ASCII name": (rewritten("opacity", "opacit\xe9"), "missing property 'opacity'"),
    "header without end": (
        lambda good: b"ply\nformat ascii 1.0\n" + b"comment lorem ipsum\n" * (1 << 20),
        "no end of the header: beyond 16 MiB",
    ),
    "2^63 Gaussians": (rewritten("vertex 5", f"vertex {2**63}"), "count"),
    "2^59 rows before": (
        rewritten("element", f"element a {2**59}\nproperty double i\nelement"),
        "row 0|beside",
    ),
    "2^59 rows before in ASCII": (
        rewritten("element", f"element a {2**59}\nproperty double i\nelement", "ascii"),
        "numbers|beside",
    ),
    "rows before beyond 2^63 in ASCII": (
        rewritten(
            "element",
            "".join(f"element a{i} {10**18 - 1}\nproperty double i\n" for i in range(20))
            + "element",
            "ascii",
        ),
        "after 19,999,999,999,999,999,980 of others|beside",
    ),
    "60 elements of long names": (
        rewritten(
            "element vertex", "".join(f"element {i:090} 0\n" for i in range(60)) + "element p"
        ),
        "expected 'vertex'",
    ),
    "two of an element": (
        rewritten("element", "element vertex 0\nproperty float x\nelement"),
        "two elements of the same name",
    ),
    "100,000 elements": (
        rewritten("element", "".join(f"element e{i} 0\n" for i in range(10**5)) + "element"),
        "more than 65536 elements",
    ),
    "100,000 properties": (
        rewritten("property", "".join(f"property char e{i}\n" for i in range(10**5)) + "property"),
        "more than 65536 properties",
    ),
    "property before elements": (rewritten("element", "property int i\nelement"), "not expected"),
    "no format": (rewritten("format binary_little_endian 1.0\n", ""), "not expected"),
    "other version": (rewritten("1.0", "2.0"), "expected 1.0"),
    "two formats": (rewritten("element", "format ascii 1.0\nelement"), "not expected"),
    "text rows too short": (
        lambda good: one_row(" ".join(["1"] * 22) + "\n\n\n"),
        "1 row of 22 numbers, expected 1 of 23",
    ),
    "a byte of 300": (
        lambda good: one_row("1 " * 22 + "300\n").replace(b"float rot_3", b"uchar rot_3"),
        "'rot_3': a number that is not a valid uint8",
    ),
}


def scalar_rows(scene: Scene, order: list[str]) -> np.ndarray:
    """The trainer's rows with properties reordered or removed."""
    rows = vertex_rows(scene)
    picked = np.empty(len(rows), [(name, "<f4") for name in order])
    for name in order:
        picked[name] = rows[name]
    return picked


#: Property orders of various exporters, for SH degree 1.
DIALECTS = {
    "nerfstudio": inria_properties(1, True),
    "gsplat": inria_properties(1, False),
    "Postshot": [
        *("x", "y", "z", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
        *("opacity", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(9))),
    ],
    "SuperSplat": [
        *("x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3", "scale_0", "scale_1", "scale_2"),
        *("f_dc_0", "f_dc_1", "f_dc_2", "opacity", *(f"f_rest_{i}" for i in range(9))),
    ],
}


@pytest.mark.parametrize("name", DIALECTS)
@pytest.mark.parametrize("form", [{}, {"text": True}, {"byte_order": ">"}], ids=str)
def test_dialects_are_read_seed8(name, form, tmp_path):
    scene = replace(random_scene(20, 1, seed=8), has_normals="nx" in DIALECTS[name])
    comments = ("Vertical Axis: z", "antialiased 1")
    rows = scalar_rows(scene, DIALECTS[name])
    back = read_ply(write_rows(tmp_path / "a.ply", rows, comments, **form))
    assert_same_bits(replace(scene, comments=comments), back)
    assert back.antialiased


def test_byte_colours_replace_missing_sh_seed9(tmp_path):
    scene = random_scene(20, 0, seed=9)
    rng = np.random.default_rng(9)
    names = [name for name in inria_properties(0, False) if not name.startswith("f_dc")]
    colours = {name: rng.integers(0, 256, 20).astype("u1") for name in ("red", "green", "blue")}
    rows = with_columns(scalar_rows(scene, names), colours)
    back = read_ply(write_rows(tmp_path / "a.ply", rows))
    expected = (np.stack(list(colours.values())) / 255 - 0.5) / 0.28209479177387814
    np.testing.assert_allclose(back.f_dc, expected, atol=1e-6)
    assert back.extra == {}


def test_colours_next_to_sh_are_extra_properties_seed10(tmp_path):
    scene = random_scene(20, 1, seed=10)
    colours = {name: np.arange(20, dtype="u1") for name in ("red", "green", "blue")}
    path = write_rows(tmp_path / "a.ply", with_columns(vertex_rows(scene), colours))
    with pytest.raises(InvalidInput, match=r'red, green, blue .*extra="keep" or extra="drop"'):
        read_ply(path, "error")
    assert_same_bits(replace(scene, extra=colours), read_ply(path, "keep"))


def with_elements(path: Path, scene: Scene, before: str, after: str, text: bool) -> Path:
    """A file with additional elements of five rows; those after the Gaussians have lists."""
    write_rows(path, vertex_rows(scene), text=text)
    header, body = path.read_bytes().split(b"end_header\n")
    extra = header.replace(b"element vertex", before.encode() + b"element vertex")
    rows = [b"1 2\n" * 5, b"3 0 1 2\n" * 5] if text else [bytes(5 * 6), b"\3" + bytes(64)]
    body = (rows[0] if before else b"") + body + (rows[1] if after else b"")
    path.write_bytes(extra + after.encode() + b"end_header\n" + body)
    return path


BEFORE = "element camera 5\nproperty uchar id\nproperty uchar kind\nproperty int size\n"
AFTER = "element face 5\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
@pytest.mark.parametrize(
    ("before", "after", "named"), [(BEFORE, "", "camera"), ("", AFTER, "face")]
)
def test_other_elements_are_refused_or_dropped(before, after, named, text, tmp_path, caplog):
    scene = random_scene(20, 1, seed=11)
    path = with_elements(tmp_path / "a.ply", scene, before, after, text)
    with pytest.raises(
        InvalidInput, match=f"element '{named}' in addition to 'vertex'; choose extra="
    ):
        read_ply(path, "error")
    assert caplog.messages == []
    for extra in ("drop", "keep"):
        assert_same_bits(scene, read_ply(path, extra))
    assert caplog.messages == 2 * [f"{path}: left out: elements {named}"]


def test_other_elements_without_rows_do_not_matter(tmp_path):
    scene = random_scene(20, 1, seed=12)
    write_ply(tmp_path / "a.ply", scene)
    data = (tmp_path / "a.ply").read_bytes()
    face = b"element face 0\nproperty list uchar int vertex_indices\n"
    for place in (b"element vertex", b"end_header"):
        (tmp_path / "b.ply").write_bytes(data.replace(place, face + place, 1))
        assert_same_bits(scene, read_ply(tmp_path / "b.ply"))


def test_lists_before_the_gaussians_are_refused(tmp_path):
    path = with_elements(tmp_path / "a.ply", random_scene(5, 0), AFTER, "", False)
    with pytest.raises(InvalidInput, match="element 'face' with lists before 'vertex'") as caught:
        read_ply(path, "drop")
    assert_one_line(caught.value, path)


class Counted(str):
    """A string that counts its comparisons."""

    comparisons = 0
    __hash__ = str.__hash__

    def __eq__(self, other: object) -> bool:
        Counted.comparisons += 1
        return str.__eq__(self, other)

    def split(self, *options) -> list[str]:  # type: ignore[override]
        return [Counted(word) for word in super().split(*options)]


@pytest.mark.parametrize("kind", ["list uchar int", "char"])
def test_work_on_a_header_is_linear_in_its_properties(kind, monkeypatch):
    def split(head: memoryview) -> tuple[list[str], int]:
        lines, size = split_lines(head)
        return [Counted(line) for line in lines], size

    split_lines = ply_header._split_lines
    monkeypatch.setattr(ply_header, "_split_lines", split)
    counts = []
    for number in (500, 1000, 2000):
        lines = [f"property {kind} p{i}\n" for i in range(number)]
        header = f"ply\nformat ascii 1.0\nelement vertex 0\n{''.join(lines)}end_header\n"
        before = Counted.comparisons
        ply_header.read_header(memoryview(header.encode()))
        counts.append(Counted.comparisons - before)
    assert counts[2] - counts[1] < 2.1 * (counts[1] - counts[0])


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", BAD_FILES)
@pytest.mark.parametrize("extra", ["error", "keep", "drop"])
def test_bad_file_is_refused_in_one_line(name, extra, tmp_path):
    make, message = BAD_FILES[name]
    path = tmp_path / "bad.ply"
    write_ply(path, random_scene(5, 1))
    path.write_bytes(make(path.read_bytes()))
    with pytest.raises(InvalidInput, match=message) as caught:
        read_ply(path, extra)
    assert_one_line(caught.value, path)


@pytest.mark.parametrize(
    ("name", "message"),
    [("missing.ply", "No such file"), (".", "directory"), ("x" * 300, "name too long")],
    ids=["missing", "directory", "long name"],
)
def test_path_that_is_not_a_file_is_refused_in_one_line(name, message, tmp_path):
    path = tmp_path / name
    with pytest.raises(InvalidInput, match=message) as caught:
        read_ply(path)
    assert_one_line(caught.value, path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no/such/a.ply", "no directory"),
        (".", "directory"),
        ("x" * 300 + ".ply", "name too long"),
    ],
    ids=["no folder", "directory", "long name"],
)
def test_path_that_cannot_be_written_is_refused_in_one_line(name, message, tmp_path):
    path = tmp_path / name
    with pytest.raises(InvalidInput, match=message) as caught:
        write_ply(path, random_scene(5, 0))
    assert_one_line(caught.value, path)
    assert list(tmp_path.iterdir()) == []


def test_writing_replaces_a_file_atomically(tmp_path):
    path = tmp_path / "a.ply"
    write_ply(path, random_scene(500, 3))
    write_ply(path, random_scene(5, 0))
    assert read_ply(path).count == 5
    assert list(tmp_path.iterdir()) == [path]


def far_scene(path: Path) -> tuple[Path, np.ndarray]:
    """A scene at UTM coordinates in float64, and its centres ``(300, 3)``."""
    scene = random_scene(300, 0, seed=8)
    rows = vertex_rows(scene)
    centres = np.add(scene.positions.T, [512_345.0, 5_212_345.0, 400.0])
    return write_rows(path, with_columns(rows, dict(zip("xyz", centres.T, strict=True)))), centres


def test_the_rounding_of_centres_is_reported_in_units_and_sizes(tmp_path, caplog):
    path, centres = far_scene(tmp_path / "a.ply")
    scene = read_ply(path)
    error = np.abs(scene.positions.T - centres).max(axis=1)
    share = (error / np.exp(scene.log_scale.max(axis=0))).max()
    [line] = caplog.messages
    assert line.startswith(f"{path}: x, y, z rounded to float32 in 300 Gaussians, ")
    assert f"by up to {error.max():.2g} units, {share:.2g} times a Gaussian's size" in line
    assert 0.2 < error.max() < 0.3
    middle = np.rint((centres.min(axis=0) + centres.max(axis=0)) / 2)
    shift = ",".join(f"{-x:.0f}" for x in middle)
    said = f'; shift them first: Action("translate", "{shift}")'
    assert line.endswith(said)


def test_a_translation_comes_before_rounding(tmp_path, caplog):
    path, centres = far_scene(tmp_path / "a.ply")
    shift = (-512_345.0, -5_212_345.0, -400.0)
    actions = [Action("translate", "-512345,-5212345,-400")]
    done = convert_file(path, tmp_path / "b.ply", actions=actions)
    assert [each.before for each in done.actions] == [300]
    scene = read_ply(tmp_path / "b.ply")
    np.testing.assert_allclose(scene.positions.T, centres + shift, atol=1e-6)
    assert offset_of(scene.comments) == tuple(-x for x in shift)
    assert caplog.text == ""
    encode_file(path, tmp_path / "a.egs", Config("lossless", keep_order=True), actions=actions)
    coded = read_scene(tmp_path / "a.egs")
    np.testing.assert_array_equal(coded.positions, scene.positions)
    assert offset_of(coded.comments) == tuple(-x for x in shift)
    moved = convert_file(
        tmp_path / "b.ply", tmp_path / "c.ply", actions=[Action("translate", "0,1,0")]
    )
    assert moved.count == 300
    assert offset_of(read_ply(tmp_path / "c.ply").comments) == (512_345.0, 5_212_344.0, 400.0)
    convert_file(tmp_path / "b.ply", tmp_path / "d.ply", actions=[Action("rotate", "0,90,0")])
    assert offset_of(read_ply(tmp_path / "d.ply").comments) is None


@pytest.mark.parametrize("system", ["RUB", "LFU"])
@pytest.mark.parametrize("is_stated", [False, True], ids=["comment", "option"])
def test_a_translation_of_other_axes_comes_before_rounding(system, is_stated, tmp_path, caplog):
    """The translation is in the trainer's axes, whatever the axes of the file."""
    path, own = far_scene(tmp_path / "a.ply")
    text = path.read_bytes()
    comment = b"" if is_stated else f"comment CoordinateSystem: {system}\n".encode()
    path.write_bytes(text.replace(b"element", comment + b"element", 1))
    centres = np.array([turn_shift(tuple(row), system, "RDF") for row in own.tolist()])
    middle = np.array(turn_shift((512_345.0, 5_212_345.0, 400.0), system, "RDF"))
    if not is_stated:
        read_ply(path)
        [said] = re.findall('"translate", "(.*)"', caplog.messages[-1])
        assert np.abs(np.array([float(x) for x in said.split(",")]) + middle).max() < 5
        caplog.clear()
    shift = Action("translate", ",".join(f"{-x:.0f}" for x in middle))
    stated = f"{system}:RDF" if is_stated else "RDF"
    convert_file(path, tmp_path / "b.ply", coordinates=stated, actions=[shift])
    scene = read_ply(tmp_path / "b.ply")
    np.testing.assert_allclose(scene.positions.T, centres - middle, atol=1e-6)
    assert offset_of(scene.comments) == tuple(middle)
    assert caplog.text == ""
    convert_file(tmp_path / "b.ply", tmp_path / "c.ply", coordinates=system)
    back = read_ply(tmp_path / "c.ply")
    np.testing.assert_allclose(back.positions.T + offset_of(back.comments), own, atol=1e-6)
