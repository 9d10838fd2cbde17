"""glTF with KHR_gaussian_splatting: writing, and everything that readers may encounter."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from appearance import assert_held_exactly, assert_seen_alike
from scenes import assert_same_floats, random_scene

from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import state_system, turn_axes
from gs_codec.formats.gltf.compressed import pack_gltf_spz
from gs_codec.formats.gltf.scene import pack_gltf
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.registry import open_scene, overview_of
from gs_codec.formats.spz.file import read_streams
from gs_codec.formats.spz.scene import pack_spz
from gs_codec.scene import ANTIALIASED, SH_COEFFICIENTS

KHR = "KHR_gaussian_splatting"
SPZ_2 = f"{KHR}_compression_spz_2"
CODES = {"<f4": 5126, "<u1": 5121, "<i1": 5120, "<u2": 5123, "<i2": 5122}
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def split(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Document and buffer of a `.glb`."""
    magic, version, length, size, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    assert size % 4 == 0
    document = json.loads(data[20 : 20 + size])
    binary, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert (kind, 28 + size + binary) == (b"BIN\0", len(data))
    return document, data[28 + size :]


def joined(document: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def column(document: dict[str, Any], binary: bytes, name: str, primitive: int = 0) -> np.ndarray:
    """The rows of an attribute, in the layout of the specification."""
    attributes = document["meshes"][0]["primitives"][primitive]["attributes"]
    accessor = document["accessors"][attributes[name]]
    view = document["bufferViews"][accessor["bufferView"]]
    code = {v: k for k, v in CODES.items()}[accessor["componentType"]]
    width = {v: k for k, v in KINDS.items()}[accessor["type"]]
    start = view["byteOffset"] + accessor.get("byteOffset", 0)
    assert start % 4 == 0
    count = accessor["count"]
    assert view["byteLength"] == count * width * np.dtype(code).itemsize
    return np.frombuffer(binary, code, count * width, start).reshape(count, width)


def made(count: int = 6, degree: int = 1) -> tuple[dict[str, Any], bytes]:
    """A handwritten document with integers where the extension allows them."""
    rng = np.random.default_rng(degree)
    arrays = {
        "POSITION": rng.normal(size=(count, 3)).astype("<f4"),
        f"{KHR}:ROTATION": rng.integers(-127, 128, (count, 4)).astype("<i1"),
        f"{KHR}:SCALE": rng.integers(1, 9, (count, 3)).astype("<u2"),
        f"{KHR}:OPACITY": rng.integers(0, 65536, (count, 1)).astype("<u2"),
    }
    for band in range(degree + 1):
        for k in range(2 * band + 1):
            name = f"{KHR}:SH_DEGREE_{band}_COEF_{k}"
            arrays[name] = rng.normal(size=(count, 3)).astype("<f4")
    document: dict[str, Any] = {
        "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "bufferViews": [], "accessors": [],
    }  # fmt: skip
    binary = b""
    for array in arrays.values():
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes}
        accessor = {
            "bufferView": len(document["bufferViews"]),
            "componentType": CODES[array.dtype.str.replace("|", "<")],
            "count": count,
            "type": KINDS[array.shape[1]],
        }
        if array.dtype in (np.int8, np.uint16) and array.shape[1] != 3:
            accessor["normalized"] = True
        document["bufferViews"].append(view)
        document["accessors"].append(accessor)
        binary += array.tobytes() + bytes(-array.nbytes % 4)
    extension = {KHR: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    attributes = {name: number for number, name in enumerate(arrays)}
    primitive = {"attributes": attributes, "mode": 0, "extensions": extension}
    document["meshes"] = [{"primitives": [primitive]}]
    document["buffers"] = [{"byteLength": len(binary)}]
    return document, binary


def read(tmp_path: Path, document: dict[str, Any], binary: bytes):
    path = tmp_path / "a.glb"
    path.write_bytes(joined(document, binary))
    return read_scene(path, coordinates=None)


# Writing


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("count", [1, 300])
def test_attributes_are_as_specified(count, degree):
    scene = random_scene(count, degree, seed=degree)
    document, binary = split(pack_gltf(scene)[0])
    turned = turn_axes(scene, "LUF")
    centres = column(document, binary, "POSITION")
    np.testing.assert_array_equal(centres, turned.positions.T)
    np.testing.assert_array_equal(centres[:, 0], -scene.positions[0])
    np.testing.assert_array_equal(centres[:, 1], -scene.positions[1])
    accessor = document["accessors"][0]
    assert accessor["min"] == centres.min(axis=0).tolist()
    assert accessor["max"] == centres.max(axis=0).tolist()
    rotations = column(document, binary, f"{KHR}:ROTATION").astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=1), 1, atol=1e-6)
    unit = turned.rot / np.linalg.norm(turned.rot, axis=0)
    np.testing.assert_allclose(rotations[:, [3, 0, 1, 2]], unit.T, atol=1e-6)
    scales = column(document, binary, f"{KHR}:SCALE")
    np.testing.assert_allclose(scales, np.exp(scene.log_scale.T), rtol=1e-6)
    share = 1 / (1 + np.exp(-scene.opacity[0].astype(np.float64)))
    np.testing.assert_allclose(column(document, binary, f"{KHR}:OPACITY")[:, 0], share, rtol=1e-6)
    number = 0
    for band in range(1, degree + 1):
        for k in range(2 * band + 1):
            rows = column(document, binary, f"{KHR}:SH_DEGREE_{band}_COEF_{k}")
            coefficients = SH_COEFFICIENTS[degree]
            expected = turned.f_rest[[number, number + coefficients, number + 2 * coefficients]]
            np.testing.assert_array_equal(rows, expected.T)
            number += 1
    assert f"{KHR}:SH_DEGREE_{degree + 1}_COEF_0" not in str(document)
    colours = column(document, binary, "COLOR_0")
    shown = 0.5 + 0.28209479177387814 * scene.f_dc
    np.testing.assert_array_equal(colours[:, :3], np.rint(255 * np.clip(shown.T, 0, 1)))
    np.testing.assert_array_equal(colours[:, 3], np.rint(255 * share))
    assert document["extensionsUsed"] == [KHR]
    assert document["meshes"][0]["primitives"][0]["mode"] == 0


@pytest.mark.parametrize("form", ["glb", "gltf"])
@pytest.mark.parametrize("degree", range(4))
def test_written_gltf_round_trips(degree, form, tmp_path):
    scene = random_scene(200, degree, seed=9)
    path = tmp_path / f"a.{form}"
    path.write_bytes(pack_gltf(scene, form == "gltf")[0])
    back = read_scene(path)
    assert back.coordinates == "RDF"
    assert_held_exactly(back, scene)
    with open_scene(path) as file:
        assert file.stated_bytes() == scene.float_bytes


def test_a_gltf_of_text_has_the_same_numbers():
    scene = random_scene(20, 1)
    document, binary = split(pack_gltf(scene)[0])
    text = json.loads(pack_gltf(scene, as_text=True)[0])
    uri = text["buffers"][0].pop("uri")
    assert uri.startswith("data:application/octet-stream;base64,")
    assert base64.b64decode(uri.partition(",")[2]) == binary
    assert text == document


def test_an_empty_scene_cannot_be_written():
    with pytest.raises(InvalidInput, match="no Gaussians, glTF needs at least one"):
        pack_gltf(random_scene(0))


# With an .spz inside


def spz_inside(document: dict[str, Any], binary: bytes) -> bytes:
    """The `.spz` of a document."""
    [primitive] = document["meshes"][0]["primitives"]
    index = primitive["extensions"][KHR]["extensions"][SPZ_2]["bufferView"]
    view = document["bufferViews"][index]
    return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


@pytest.mark.parametrize("degree", range(4))
def test_an_spz_in_a_glb_has_the_numbers_of_gltf(degree, tmp_path):
    scene = random_scene(300, degree, seed=degree)
    data, lost = pack_gltf_spz(scene)
    document, binary = split(data)
    path = tmp_path / "a.glb"
    path.write_bytes(data)
    (tmp_path / "inside.spz").write_bytes(spz_inside(document, binary))
    inside = read_scene(tmp_path / "inside.spz", coordinates=None)
    assert_same_floats(state_system(inside, "LUF"), read_scene(path, coordinates=None))
    (tmp_path / "a.spz").write_bytes(pack_spz(scene)[0])
    one, other = read_scene(path), read_scene(tmp_path / "a.spz")
    # A quaternion and its negative are the same rotation; SH of -1 are stored, of 1 not quite.
    np.testing.assert_array_equal(abs(one.rot), abs(other.rot))
    np.testing.assert_allclose(one.f_rest, other.f_rest, atol=1 / 128)
    alike = {"rot": one.rot, "f_rest": one.f_rest}
    assert_same_floats(one, replace(other, **alike))
    told = overview_of(path)
    assert (told.format, told.count, told.coordinates) == ("gltf spz", 300, "LUF")
    assert lost[0].startswith("opacity, colours")
    with open_scene(path) as file:
        assert file.stated_bytes() == scene.float_bytes
        assert file.scene_format.is_rounded


def test_accessors_of_an_spz_state_the_decoded_attributes():
    scene = random_scene(50, 2)
    document, binary = split(pack_gltf_spz(scene)[0])
    [primitive] = document["meshes"][0]["primitives"]
    names = [name.removeprefix(f"{KHR}:") for name in primitive["attributes"]]
    coefficients = [f"SH_DEGREE_{d}_COEF_{k}" for d in (1, 2) for k in range(2 * d + 1)]
    assert names == ["POSITION", "COLOR_0", "SCALE", "ROTATION", *coefficients]
    assert not any("bufferView" in accessor for accessor in document["accessors"])
    assert {accessor["count"] for accessor in document["accessors"]} == {50}
    kinds = [accessor["type"] for accessor in document["accessors"]]
    assert kinds == ["VEC3", "VEC4", "VEC3", "VEC4"] + ["VEC3"] * 8
    header, _, _ = read_streams(Path("a"), memoryview(spz_inside(document, binary)), None)
    assert (header.version, header.count) == (3, 50)
    centres = turn_axes(scene, "LUF").positions
    unit = 2.0**-header.fraction_bits
    np.testing.assert_allclose(document["accessors"][0]["min"], centres.min(axis=1), atol=unit)
    np.testing.assert_allclose(document["accessors"][0]["max"], centres.max(axis=1), atol=unit)
    assert document["extensionsRequired"] == document["extensionsUsed"] == [KHR, SPZ_2]


def test_gltf_of_earlier_drafts_is_read(tmp_path, caplog):
    scene = random_scene(20, 1)
    document, binary = split(pack_gltf_spz(scene)[0])
    expected = read(tmp_path, document, binary)
    [primitive] = document["meshes"][0]["primitives"]
    splats = primitive["extensions"][KHR]
    for name in ("BT.709-sRGB", "BT.709"):
        splats["colorSpace"] = name
        assert_same_floats(read(tmp_path, document, binary), expected)
    del splats["kernel"], splats["colorSpace"]
    stated = splats["extensions"].pop(SPZ_2)
    splats["extensions"][f"{KHR}_compression_spz"] = stated
    assert_same_floats(read(tmp_path, document, binary), expected)
    primitive["extensions"] = {"KHR_spz_gaussian_splats_compression": stated}
    primitive["attributes"] |= {"_SCALE": 0, "_ROTATION": 0, "_SH_DEGREE_1_COEF_0": 0}
    assert_same_floats(read(tmp_path, document, binary), expected)
    assert caplog.messages == []


def test_what_other_extensions_add_to_an_spz_is_left_out(tmp_path, caplog):
    """As in tiles of 3DGS-PLY-3DTiles-Converter with more opacity than an `.spz` has."""
    document, binary = split(pack_gltf_spz(random_scene(20, 1))[0])
    expected = read(tmp_path, document, binary)
    splats = document["meshes"][0]["primitives"][0]["extensions"][KHR]
    splats["extensions"] = {"EXT_splat_opacity": {"version": 2}, **splats["extensions"]}
    assert_same_floats(read(tmp_path, document, binary), expected)
    [said] = caplog.messages
    assert said == f"{tmp_path / 'a.glb'}: left out: extensions 'EXT_splat_opacity'"


def test_nodes_move_an_spz(tmp_path):
    document, binary = split(pack_gltf_spz(random_scene(20, 1))[0])
    plain = read(tmp_path, document, binary)
    document["nodes"] = [{"mesh": 0, "translation": [1, 2, 3]}, {"mesh": 0}]
    document["scenes"] = [{"nodes": [0, 1]}]
    both = read(tmp_path, document, binary)
    assert both.count == 40
    np.testing.assert_allclose(
        both.positions[:, :20], plain.positions + np.array([[1], [2], [3]]), rtol=1e-6
    )


@pytest.mark.parametrize("form", ["glb", "gltf"])
def test_a_compressed_gltf_is_encoded_like_an_spz(form, tmp_path):
    scene = replace(random_scene(400, 1), comments=(ANTIALIASED,))
    write_ply(tmp_path / "a.ply", scene)
    config = Config(format=form, gltf_compression="spz", effort="fast")
    target = tmp_path / f"a.{form}"
    done = encode_file(tmp_path / "a.ply", target, config, rate={"ratio": 3})
    assert done.rate is not None
    assert done.rate.coarseness != 1
    assert done.file_bytes <= (tmp_path / "a.ply").stat().st_size / 3
    assert read_scene(target).antialiased
    convert_file(target, tmp_path / f"b.{form}", replace(config, effort="normal"))
    once, again = (read_scene(tmp_path / f"{name}.{form}") for name in "ab")
    # A file that rounds is converted at full precision, perhaps in another order.
    np.testing.assert_array_equal(np.sort(again.f_rest), np.sort(once.f_rest))
    np.testing.assert_array_equal(np.sort(again.log_scale), np.sort(once.log_scale))


def test_compression_is_of_gltf_alone():
    with pytest.raises(InvalidInput, match=r"gltf_compression: format 'spz', expected \.glb or"):
        Config(format="spz", gltf_compression="spz")
    with pytest.raises(InvalidInput, match="coarseness: format 'glb' has none"):
        Config(format="glb", coarseness=2)
    assert Config(format="glb", gltf_compression="spz", coarseness=2).has_steps
    with pytest.raises(InvalidInput, match="no Gaussians"):
        pack_gltf_spz(random_scene(0))


def test_an_spz_that_unpacks_to_too_much_is_refused(tmp_path):
    document, _ = split(pack_gltf_spz(random_scene(3))[0])
    bomb = zlib.compressobj(wbits=31)
    header = struct.pack("<4sIIBBBB", b"NGSP", 3, 1 << 31, 3, 12, 0, 0)
    packed = bomb.compress(header + bytes(1 << 20)) + bomb.flush()
    document["bufferViews"][0]["byteLength"] = document["buffers"][0]["byteLength"] = len(packed)
    with pytest.raises(InvalidInput, match="2,147,483,648 Gaussians of"):
        read(tmp_path, document, packed)


# Reading


def test_integers_follow_the_extension(tmp_path):
    document, binary = made()
    scene = read(tmp_path, document, binary)
    assert (scene.count, scene.sh_degree, scene.coordinates) == (6, 1, "LUF")
    turn = column(document, binary, f"{KHR}:ROTATION") / 127
    np.testing.assert_allclose(scene.rot, turn[:, [3, 0, 1, 2]].T, rtol=1e-6)
    scale = column(document, binary, f"{KHR}:SCALE")
    np.testing.assert_allclose(scene.log_scale, np.log(scale.T), rtol=1e-6, atol=1e-7)
    share = column(document, binary, f"{KHR}:OPACITY")[:, 0] / 65535
    np.testing.assert_allclose(1 / (1 + np.exp(-scene.opacity[0])), share, atol=1e-6)


def test_interleaved_attributes_are_read(tmp_path):
    document, binary = made()
    rows = [column(document, binary, name) for name in (f"{KHR}:OPACITY", "POSITION")]
    mixed = b"".join(a.tobytes() + bytes(2) + b.tobytes() for a, b in zip(*rows, strict=True))
    start = len(binary)
    document["buffers"][0]["byteLength"] += len(mixed)
    view = {"buffer": 0, "byteOffset": start, "byteLength": len(mixed), "byteStride": 16}
    document["bufferViews"].append(view)
    for index, offset in ((3, 0), (0, 4)):
        document["accessors"][index] |= {"bufferView": 6 + 2, "byteOffset": offset}
    expected = read(tmp_path, *made())
    scene = read(tmp_path, document, binary + mixed)
    np.testing.assert_array_equal(scene.positions, expected.positions)
    np.testing.assert_array_equal(scene.opacity, expected.opacity)


def test_nodes_shift_and_scale(tmp_path):
    document, binary = made()
    plain = read(tmp_path, document, binary)
    document["nodes"] = [
        {"children": [1, 2], "translation": [1, 2, 3], "scale": [2, 2, 2]},
        {"mesh": 0, "translation": [0.5, 0, 0]},
        {"mesh": 0, "matrix": [3, 0, 0, 0, 0, 3, 0, 0, 0, 0, 3, 0, 7, 8, 9, 1]},
        {"name": "empty", "rotation": [0, 0, 0, 1]},
    ]
    scene = read(tmp_path, document, binary)
    assert scene.count == 12
    shift = np.array([[1], [2], [3]])
    first = 2 * (plain.positions + np.array([[0.5], [0], [0]])) + shift
    second = 2 * (3 * plain.positions + np.array([[7], [8], [9]])) + shift
    np.testing.assert_allclose(scene.positions[:, :6], first, rtol=1e-6)
    np.testing.assert_allclose(scene.positions[:, 6:], second, rtol=1e-6)
    np.testing.assert_allclose(scene.log_scale[:, 6:], plain.log_scale + np.log(6), rtol=1e-6)


def test_nodes_turn_and_mirror(tmp_path):
    document, binary = made(degree=2)
    plain = read(tmp_path, document, binary)
    half = np.sqrt(0.5)
    document["nodes"] = [
        {"children": [1], "rotation": [half, 0, 0, half], "translation": [1, 2, 3]},
        {"children": [2], "scale": [-2, 2, 2]},
        # 120 degrees about (1, 1, 1): x to y to z.
        {"mesh": 0, "matrix": [0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 4, 5, 6, 1]},
    ]
    scene = read(tmp_path, document, binary)
    x, y, z = plain.positions
    inner = np.array([z + 4, x + 5, y + 6])
    mirrored = 2 * inner * np.array([[-1], [1], [1]])
    # 90 degrees about x: y to z, z to -y.
    expected = mirrored[[0, 2, 1]] * np.array([[1], [-1], [1]]) + np.array([[1], [2], [3]])
    np.testing.assert_allclose(scene.positions, expected, rtol=1e-6, atol=1e-6)
    turn = np.array([[0, 0, -1], [0, -1, 0], [1, 0, 0]])
    smaller = replace(scene, log_scale=scene.log_scale - np.float32(np.log(2)))
    assert_seen_alike(plain, smaller, turn)


@pytest.mark.parametrize(("shown", "moved"), [({}, 0), ({"scene": 1}, 5)])
def test_only_the_scene_is_read_and_the_rest_is_named(shown, moved, tmp_path, caplog):
    document, binary = made()
    plain = read(tmp_path, document, binary)
    document["nodes"] = [{"children": [2]}, {"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 0}]
    document["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}}, {}]})
    document |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "animations": [{}], **shown}
    assert caplog.messages == []
    scene = read(tmp_path, document, binary)
    np.testing.assert_allclose(scene.positions[0], plain.positions[0] + moved, rtol=1e-6)
    told = "primitives without Gaussians (2); meshes outside the scene (1); animations (1)"
    assert caplog.messages == [f"{tmp_path / 'a.glb'}: left out: {told}"]


def test_what_is_not_read_of_a_primitive_is_named(tmp_path, caplog):
    document, binary = made()
    expected = read(tmp_path, document, binary)
    [primitive] = document["meshes"][0]["primitives"]
    primitive["attributes"] |= {"COLOR_0": 0, "_FEATURE_ID_0": 0}
    primitive["extensions"]["EXT_mesh_features"] = {}
    primitive["targets"] = [{"POSITION": 0}]
    document["skins"] = [{"joints": [0]}]
    assert_same_floats(read(tmp_path, document, binary), expected)
    told = "primitives with morph targets (1); skins (1)"
    names = "attributes '_FEATURE_ID_0'; extensions 'EXT_mesh_features'"
    assert caplog.messages == [f"{tmp_path / 'a.glb'}: left out: {names}; {told}"]


def test_hidden_nodes_are_not_shown(tmp_path, caplog):
    document, binary = made()
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    document["nodes"] = [{"mesh": 0}, {"children": [2], **hidden}, {"mesh": 0}]
    document["scenes"] = [{"nodes": [0, 1]}]
    assert read(tmp_path, document, binary).count == 6
    assert caplog.messages == [f"{tmp_path / 'a.glb'}: left out: meshes outside the scene (1)"]
    hidden["extensions"]["KHR_node_visibility"]["visible"] = True
    assert read(tmp_path, document, binary).count == 12


def with_indices(document: dict[str, Any], binary: bytes, index: np.ndarray) -> bytes:
    """Give the primitive of a document indices; the buffer then."""
    start = len(binary) + -len(binary) % 4
    view = {"buffer": 0, "byteOffset": start, "byteLength": index.nbytes}
    kind = {1: 5121, 2: 5123, 4: 5125}[index.itemsize]
    accessor = {"componentType": kind, "count": len(index), "type": "SCALAR"}
    document["meshes"][0]["primitives"][0]["indices"] = len(document["accessors"])
    document["accessors"].append(accessor | {"bufferView": len(document["bufferViews"])})
    document["bufferViews"].append(view)
    document["buffers"][0]["byteLength"] = start + index.nbytes
    return binary.ljust(start, b"\0") + index.tobytes()


@pytest.mark.parametrize("pack", [pack_gltf, pack_gltf_spz])
@pytest.mark.parametrize("code", ["<u1", "<u2", "<u4"])
def test_indices_select_and_order_gaussians(code, pack, tmp_path):
    document, binary = split(pack(random_scene(20, 1))[0])
    plain = read(tmp_path, document, binary)
    index = np.array([7, 3, 19, 3], code)
    binary = with_indices(document, binary, index)
    assert_same_floats(read(tmp_path, document, binary), plain.take(index))
    assert overview_of(tmp_path / "a.glb").count == 4
    binary = with_indices(document, binary, np.array([0, 20], code))
    with pytest.raises(InvalidInput, match="glTF: index 20 of 20 Gaussians"):
        read(tmp_path, document, binary)
    document["accessors"][-1]["componentType"] = 5126
    with pytest.raises(InvalidInput, match="indices is 'SCALAR' of 5126, expected"):
        read(tmp_path, document, binary)


def test_a_separate_buffer_is_read(tmp_path):
    document, binary = made()
    (tmp_path / "a b.bin").write_bytes(binary + b"more")
    document["buffers"][0]["uri"] = "a%20b.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    expected = read(tmp_path, *made())
    scene = read_scene(tmp_path / "a.gltf", coordinates=None)
    np.testing.assert_array_equal(scene.positions, expected.positions)
    (tmp_path / "a b.bin").write_bytes(binary[:-1])
    with pytest.raises(InvalidInput, match=r"file 'a b\.bin': no file of"):
        read_scene(tmp_path / "a.gltf")


def test_extreme_opacities_and_scales_are_finite(tmp_path):
    document, binary = made(2, 0)
    mutable = bytearray(binary)
    for name, values in ((f"{KHR}:OPACITY", [0, 65535]), (f"{KHR}:SCALE", [0, 0, 0, 1, 2, 3])):
        attribute = document["meshes"][0]["primitives"][0]["attributes"][name]
        start = document["bufferViews"][attribute]["byteOffset"]
        struct.pack_into(f"<{len(values)}H", mutable, start, *values)
    scene = read(tmp_path, document, bytes(mutable))
    assert np.isfinite(scene.opacity).all()
    assert np.isfinite(scene.log_scale).all()
    assert scene.opacity[0, 0] < -17 < 17 < scene.opacity[0, 1]


@pytest.mark.parametrize(
    ("name", "plane", "said"),
    [
        ("SCALE", "log_scale", "negative scales, read as logarithms"),
        ("OPACITY", "opacity", "opacities beyond 0 to 1, read as logits"),
    ],
)
def test_values_before_activation_are_read_as_such(name, plane, said, tmp_path, caplog):
    """Scales as in splat-transform 1.9 to 2.6; both as in gsbox."""
    scene = random_scene(30, 1, seed=4)
    document, binary = split(pack_gltf(scene)[0])
    expected = read(tmp_path, document, binary)
    attribute = document["meshes"][0]["primitives"][0]["attributes"][f"{KHR}:{name}"]
    start = document["bufferViews"][attribute]["byteOffset"]
    stored = getattr(scene, plane).T.astype("<f4").tobytes()
    found = read(tmp_path, document, binary[:start] + stored + binary[start + len(stored) :])
    assert_same_floats(replace(found, **{plane: getattr(expected, plane)}), expected)
    np.testing.assert_allclose(getattr(found, plane), getattr(expected, plane), rtol=1e-5)
    assert caplog.messages == [f"{tmp_path / 'a.glb'}: {said}"]


def test_a_few_opacities_beyond_1_are_not_logits(tmp_path, caplog):
    document, binary = split(pack_gltf(random_scene(30, 0, seed=4))[0])
    expected = read(tmp_path, document, binary)
    attribute = document["meshes"][0]["primitives"][0]["attributes"][f"{KHR}:OPACITY"]
    start = document["bufferViews"][attribute]["byteOffset"]
    found = read(tmp_path, document, binary[:start] + struct.pack("<f", 1.1) + binary[start + 4 :])
    np.testing.assert_array_equal(found.opacity[:, 1:], expected.opacity[:, 1:])
    assert not any("logits" in text for text in caplog.messages)


def edited(*path: Any, to: Any) -> Any:
    """A function that sets the value at a path of names and indices in a document."""

    def edit(document: dict[str, Any]) -> None:
        *above, last = path
        place: Any = document
        for step in above:
            place = place[step]
        if to is None:
            del place[last]
        else:
            place[last] = to

    return edit


SPLATS = ("meshes", 0, "primitives", 0, "extensions", KHR)
ATTRIBUTES = ("meshes", 0, "primitives", 0, "attributes")
BAD = {
    "version 1": (edited("asset", "version", to="1.0"), "glTF version '1.0', expected 2"),
    "no asset": (edited("asset", to=None), "glTF version None"),
    "no Gaussians": (edited(*SPLATS[:-1], to={}), "not a scene of Gaussians"),
    "no nodes": (edited("nodes", to=[]), "not a scene of Gaussians"),
    "other kernel": (edited(*SPLATS, "kernel", to="box"), "kernel 'box'"),
    "linear colours": (edited(*SPLATS, "colorSpace", to="lin_rec709_display"), "lin_rec709"),
    "L-GSC": (edited(*SPLATS, "extensions", to={f"{KHR}_lgsc": {}}), r"_lgsc' \(L-GSC\) is not"),
    "EGSC": (
        edited(*SPLATS, "extensions", to={f"{KHR}_compression_EGSC": {}}),
        rf"_compression_EGSC' \(EGSC\) is not read, expected {SPZ_2}",
    ),
    "MPEG": (
        edited(*SPLATS, "extensions", to={"MPEG_gaussian_splatting": {}, SPZ_2: {}}),
        r"'MPEG_gaussian_splatting' \(MPEG's codec\) is not read",
    ),
    "meshopt": (
        edited("bufferViews", 0, "extensions", to={"EXT_meshopt_compression": {}}),
        "'EXT_meshopt_compression' is not read",
    ),
    "Draco": (
        edited("meshes", 0, "primitives", 0, "extensions", "KHR_draco_mesh_compression", to={}),
        "'KHR_draco_mesh_compression' is not read",
    ),
    "instances": (
        edited("nodes", 0, "extensions", to={"EXT_mesh_gpu_instancing": {"attributes": {}}}),
        "'EXT_mesh_gpu_instancing' of Gaussians is not read",
    ),
    "a name alone": (edited(*SPLATS, "extensions", to=SPZ_2), f"'{SPZ_2}' is not read"),
    "no .spz": (edited(*SPLATS, "extensions", to={SPZ_2: {}}), "bufferViews None, expected one"),
    "an .spz of text": (edited(*SPLATS, "extensions", to={SPZ_2: "0"}), "bufferViews None"),
    "other bytes": (
        edited(*SPLATS, "extensions", to={SPZ_2: {"bufferView": 0}}),
        f"{SPZ_2}: a gzip stream that begins|{SPZ_2}: gzip stream",
    ),
    "stretched": (edited("nodes", 0, to={"mesh": 0, "scale": [1, 2, 1]}), "stretches or shears"),
    "no scale": (edited("nodes", 0, to={"mesh": 0, "scale": [0] * 3}), "stretches or shears"),
    "no turn": (edited("nodes", 0, to={"mesh": 0, "rotation": [0] * 4}), "stretches or shears"),
    "large scale": (edited("nodes", 0, to={"mesh": 0, "scale": [1e150] * 3}), "stretches or shear"),
    "scale of text": (edited("nodes", 0, to={"mesh": 0, "scale": ["1"] * 3}), "expected a number"),
    "huge scale": (edited("nodes", 0, to={"mesh": 0, "scale": [1e999] * 3}), "glTF"),
    "children of text": (edited("nodes", 0, "children", to=["0"]), "node.children"),
    "circle": (
        edited("nodes", to=[{"children": [1]}, {"mesh": 0, "children": [1]}]),
        "two parents",
    ),
    "empty scene": (edited("scenes", to=[{}]), "not a scene of Gaussians"),
    "scenes of text": (edited("scenes", to=["0"]), "scenes is not a list of objects"),
    "nodes of text": (edited("scenes", to=[{"nodes": "0"}]), "scene.nodes is not a list of num"),
    "node beyond": (edited("scenes", to=[{"nodes": [9]}]), "nodes 9, expected one of 1"),
    "node twice": (edited("scenes", to=[{"nodes": [0, 0]}]), "two parents"),
    "two parents": (
        edited("nodes", to=[{"children": [2]}, {"children": [2]}, {"mesh": 0}]),
        "two parents",
    ),
    "mesh beyond": (edited("nodes", 0, "mesh", to=7), "meshes 7, expected one of 1"),
    "mesh of text": (edited("nodes", 0, "mesh", to="0"), "meshes '0'"),
    "no rotation": (
        edited(*ATTRIBUTES, f"{KHR}:ROTATION", to=None),
        f"glTF: no attribute {KHR}:ROTATION",
    ),
    "one of degree 1 missing": (
        edited(*ATTRIBUTES, f"{KHR}:SH_DEGREE_1_COEF_2", to=None),
        f"glTF: no attribute {KHR}:SH_DEGREE",
    ),
    "VEC3 rotation": (edited("accessors", 1, "type", to="VEC3"), "expected VEC4 of numbers"),
    "32-bit integers": (edited("accessors", 0, "componentType", to=5125), "5125, expected VEC3"),
    "sparse": (edited("accessors", 0, "sparse", to={}), "not sparse"),
    "one more": (edited("accessors", 0, "count", to=7), "beyond the buffer|expected 7"),
    "one less": (edited("accessors", 2, "count", to=5), "SCALE of 5, expected 6"),
    "2^32 Gaussians": (edited("accessors", 0, "count", to=1 << 32), "are read from a file"),
    "negative count": (edited("accessors", 0, "count", to=-1), "accessor.count is -1"),
    "count of text": (edited("accessors", 0, "count", to="6"), "accessor.count is '6'"),
    "offset beyond": (edited("accessors", 0, "byteOffset", to=1 << 30), "beyond the buffer"),
    "view beyond": (edited("bufferViews", 0, "byteOffset", to=1 << 30), "beyond the buffer"),
    "small stride": (edited("bufferViews", 0, "byteStride", to=4), "beyond the buffer"),
    "no views": (edited("bufferViews", to=None), "bufferViews 0, expected one of 0"),
    "views of text": (edited("bufferViews", to=["a"]), "bufferViews is not a list of objects"),
    "larger buffer": (edited("buffers", 0, "byteLength", to=1 << 20), "fewer bytes than"),
    "uri of a number": (edited("buffers", 0, "uri", to=7), "buffer.uri is not text"),
    "uri elsewhere": (
        edited("buffers", 0, "uri", to="../a.bin"),
        "expected a file in the same folder",
    ),
    "uri escaped": (
        edited("buffers", 0, "uri", to="..%2Fa.bin"),
        "expected a file in the same folder",
    ),
    "uri of dots": (edited("buffers", 0, "uri", to=".."), "expected a file in the same folder"),
    "no such file": (edited("buffers", 0, "uri", to="b.bin"), r"file 'b\.bin': no file of"),
    "extensions of a number": (edited(*SPLATS, "extensions", to=5), "5 is not read"),
    "components in a list": (edited("accessors", 0, "componentType", to=[5126]), r"of \[5126\]"),
    "10^400": (
        edited("nodes", 0, to={"mesh": 0, "translation": [10**400, 0, 0]}),
        "node.translation has inf",
    ),
    "count of 10^400": (edited("accessors", 0, "count", to=10**400), "accessor.count is inf"),
    "broken base64": (edited("buffers", 0, "uri", to="data:;base64,@@"), "buffer.uri: "),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_gltf_is_refused_in_one_line(name, tmp_path):
    document, binary = made()
    edit, message = BAD[name]
    edit(document)
    with pytest.raises(InvalidInput, match=message) as caught:
        read(tmp_path, document, binary)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "a.glb"))


def test_nodes_may_show_a_mesh_often_but_not_each_of_many_primitives(tmp_path):
    document, binary = made()
    document["scenes"] = []
    document["nodes"] = [{"mesh": 0}] * 300
    assert read(tmp_path, document, binary).count == 300 * 6
    document["meshes"][0]["primitives"] *= 300
    with pytest.raises(InvalidInput, match="nodes show more than 9,600 primitives"):
        read(tmp_path, document, binary)
    document["nodes"] = [{"mesh": 0}]
    assert read(tmp_path, document, binary).count == 300 * 6


def test_degree_4_is_dropped(tmp_path, caplog):
    document, binary = made(degree=3)
    expected = read(tmp_path, document, binary)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    attributes[f"{KHR}:SH_DEGREE_4_COEF_0"] = attributes[f"{KHR}:SH_DEGREE_3_COEF_0"]
    assert_same_floats(read(tmp_path, document, binary), expected)
    path = tmp_path / "a.glb"
    assert caplog.messages == [f"{path}: left out: SH of degree 4"]


def test_primitives_of_several_degrees_are_refused(tmp_path):
    document, binary = made()
    other = deepcopy(document["meshes"][0]["primitives"][0])
    for k in range(3):
        del other["attributes"][f"{KHR}:SH_DEGREE_1_COEF_{k}"]
    document["meshes"][0]["primitives"].append(other)
    with pytest.raises(InvalidInput, match="several SH degrees"):
        read(tmp_path, document, binary)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("form", ["glb", "gltf"])
@pytest.mark.parametrize("pack", [pack_gltf, pack_gltf_spz])
def test_truncated_files_are_refused(pack, form, tmp_path):
    data = pack(random_scene(3, 1), as_text=form == "gltf")[0]
    path = tmp_path / f"a.{form}"
    for end in range(len(data)):
        path.write_bytes(data[:end])
        with pytest.raises(InvalidInput) as caught:
            read_scene(path)
        assert "\n" not in str(caught.value)


def test_broken_containers_are_refused(tmp_path):
    data = joined(*made())
    for change, message in (
        (data[:4] + struct.pack("<I", 1) + data[8:], "version 1"),
        (data[:8] + struct.pack("<I", len(data) + 1) + data[12:], "bytes of"),
        (data[:16] + b"TEXT" + data[20:], "chunk b'TEXT'"),
        (data[:12] + struct.pack("<I", 1 << 31) + data[16:], "chunk b'JSON' of 2,147,483,648"),
        (data[:20], "bytes of 20"),
        (joined(made()[0], b""), "fewer bytes than"),
        (b"glTF" + struct.pack("<II", 2, 12), "12 bytes, expected a header and a chunk"),
    ):
        (tmp_path / "a.glb").write_bytes(change)
        with pytest.raises(InvalidInput, match=message):
            read_scene(tmp_path / "a.glb")
