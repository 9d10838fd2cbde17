"""PLY files in the dialects of other programs: what is read, and what is logged."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from threading import Thread

import foreign
import numpy as np
import pytest
from refusals import assert_refused
from scenes import made_up_sensitivity, random_scene

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows, write_ply
from gs_codec.formats.registry import read_written
from gs_codec.guidance.guide import steps_adding
from gs_codec.scene import GROUPS, Scene, property_names

#: Elements that Apple's SHARP writes after the Gaussians, with their rows.
SHARP = {
    "extrinsic": ("float", 16), "intrinsic": ("float", 9), "image_size": ("uint", 2),
    "frame": ("int", 2), "disparity": ("float", 2), "color_space": ("uchar", 1),
    "version": ("uchar", 3),
}  # fmt: skip


def sharp_file(path: Path, scene: Scene) -> Path:
    """A PLY with the elements of SHARP."""
    write_ply(path, scene)
    header, body = path.read_bytes().split(b"end_header\n")
    sizes = {"float": 4, "uint": 4, "int": 4, "uchar": 1}
    for name, (kind, rows) in SHARP.items():
        header += f"element {name} {rows}\nproperty {kind} {name}\n".encode()
        body += bytes(sizes[kind] * rows)
    path.write_bytes(header + b"end_header\n" + body)
    return path


@pytest.mark.parametrize("profile", ["m", "lossless"])
def test_one_line_names_everything_beyond_the_gaussians(profile, tmp_path, caplog):
    columns = {name: np.arange(30, dtype="<f4") for name in ("nx", "ny", "nz", "red")}
    scene = replace(random_scene(30, 0), extra=columns)
    path = sharp_file(tmp_path / "a.ply", scene)
    encode_file(path, tmp_path / "a.egs", Config(profile))
    kept = profile == "lossless"
    said = f"{path}: left out: elements {', '.join(SHARP)}"
    assert caplog.messages == [said if kept else f"{said}; properties nx, ny, nz, red"]
    back = read_scene(tmp_path / "a.egs")
    assert (back.count, list(back.extra)) == (30, list(columns) if kept else [])


def test_properties_in_an_egs_follow_the_same_rule(tmp_path, caplog):
    scene = replace(random_scene(30, 0), extra={"label": np.arange(30, dtype="<i4")})
    write_ply(tmp_path / "a.ply", scene)
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs", Config("lossless"))
    encode_file(tmp_path / "a.egs", tmp_path / "b.egs")
    assert caplog.messages == [f"{tmp_path / 'a.egs'}: left out: properties label"]
    convert_file(tmp_path / "a.egs", tmp_path / "c.egs", Config("s"))
    extras = [list(read_scene(tmp_path / f"{name}.egs").extra) for name in "abc"]
    assert extras == [["label"], [], ["label"]]
    with pytest.raises(InvalidInput, match=r'properties label .*extra="keep" or extra="drop"'):
        encode_file(tmp_path / "a.egs", tmp_path / "d.egs", Config(extra="error"))


def mip_filtered(scene: Scene, deviations: np.ndarray) -> Scene:
    """The scene as written by `save_fused_ply` of Mip-Splatting, in float64."""
    squares = np.exp(2 * scene.log_scale.astype(np.float64))
    wide = squares + deviations.astype(np.float64) ** 2
    opacity = 1 / (1 + np.exp(-scene.opacity.astype(np.float64)))
    opacity = opacity * np.sqrt(squares.prod(axis=0) / wide.prod(axis=0))
    logit = np.log(opacity / (1 - opacity))
    return replace(
        scene,
        log_scale=(np.log(wide) / 2).astype(np.float32),
        opacity=logit.astype(np.float32),
    )


@pytest.mark.parametrize("profile", ["m", "lossless"])
def test_the_filter_of_mip_splatting_is_fused_seed21(profile, tmp_path, caplog):
    scene = random_scene(40, 1, seed=21)
    deviations = np.linspace(0, 3, 40, dtype="<f4")
    write_ply(tmp_path / "a.ply", replace(scene, extra={"filter_3D": deviations}))
    expected, back = mip_filtered(scene, deviations), read_scene(tmp_path / "a.ply", "error")
    np.testing.assert_allclose(back.log_scale, expected.log_scale, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(back.opacity, expected.opacity, rtol=1e-5, atol=1e-6)
    assert back.opacity[0, 0] == scene.opacity[0, 0]
    line = f"{tmp_path / 'a.ply'}: filter_3D of Mip-Splatting fused into scales and opacity"
    assert caplog.messages == [line]
    write_ply(tmp_path / "b.ply", back)
    for name in "ab":
        encode_file(tmp_path / f"{name}.ply", tmp_path / f"{name}.egs", Config(profile))
    assert caplog.messages == 2 * [line]
    assert (tmp_path / "a.egs").read_bytes() == (tmp_path / "b.egs").read_bytes()


def test_a_filter_stored_in_an_egs_is_fused_on_reading(tmp_path, caplog):
    scene = replace(random_scene(40, 1), extra={"filter_3D": np.full(40, 0.5, "<f4")})
    data, _ = encode_scene(scene, Config("lossless", extra="keep", keep_order=True))
    (tmp_path / "a.egs").write_bytes(data)
    back, expected = read_scene(tmp_path / "a.egs"), mip_filtered(scene, np.full(40, 0.5))
    np.testing.assert_allclose(back.log_scale, expected.log_scale, rtol=1e-6, atol=1e-6)
    assert back.extra == {}
    assert "filter_3D of Mip-Splatting fused" in caplog.text


@pytest.mark.parametrize(
    ("names", "named"),
    [
        (["trbf_center", "trbf_scale", "motion_0", "omega_3"], "trbf_center, trbf_scale, motion_0"),
        (["t", "scale_t", "label"], "t, scale_t"),
    ],
)
@pytest.mark.parametrize("extra", ["keep", "drop"])
def test_dynamic_scenes_are_named(names, named, extra, tmp_path, caplog):
    columns = {name: np.ones(9, "<f4") for name in names}
    write_ply(tmp_path / "a.ply", replace(random_scene(9, 0), extra=columns))
    back = read_scene(tmp_path / "a.ply", extra)
    assert list(back.extra) == (names if extra == "keep" else [])
    first, *rest = caplog.messages
    start = f"{tmp_path / 'a.ply'}: a 4D scene, read as a static one; these describe its motion"
    assert first.startswith(f"{start}: {named}")
    left_out = "label" in names and extra == "drop"
    assert rest == ([f"{tmp_path / 'a.ply'}: left out: properties label"] if left_out else [])


def test_texture_coordinates_are_not_time(tmp_path, caplog):
    columns = {name: np.ones(9, "<f4") for name in "st"}
    write_ply(tmp_path / "a.ply", replace(random_scene(9, 0), extra=columns))
    read_scene(tmp_path / "a.ply", "drop")
    assert caplog.messages == [f"{tmp_path / 'a.ply'}: left out: properties s, t"]


@pytest.mark.parametrize("linear", [["opacity"], ["log_scale"], ["opacity", "log_scale"]])
def test_linear_values_are_named(linear, tmp_path, caplog):
    """Some programs write values after activation."""
    scene = random_scene(200, 0)
    values = {"opacity": 1 / (1 + np.exp(-scene.opacity)), "log_scale": np.exp(scene.log_scale)}
    path = tmp_path / "a.ply"
    write_ply(path, replace(scene, **{group: values[group] for group in linear}))
    read_scene(path)
    named = {"opacity": "opacities (read as logits)", "log_scale": "scales (read as logarithms)"}
    told = "these look linear, unlike a trainer's: " + ", ".join(named[group] for group in linear)
    assert caplog.messages == [f"{path}: {told}"]
    caplog.clear()
    write_ply(path, scene)
    read_scene(path)
    assert caplog.messages == []


def rewritten(path: Path, *pairs: tuple[bytes, bytes]) -> Path:
    """A file with some byte strings replaced, once each."""
    data = path.read_bytes()
    for old, new in pairs:
        assert old in data
        data = data.replace(old, new, 1)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("before", [b"scalar_", b"scalar_scalar_", b"scalar_scal_", b"scal_"])
def test_names_of_cloud_compare_are_those_of_the_layout(before, tmp_path, caplog):
    scene = replace(random_scene(9, 1), extra={"label": np.arange(9, dtype="<f4")})
    write_ply(tmp_path / "a.ply", scene)
    names = [*(f"f_dc_{i}" for i in range(3)), "opacity", "label", "rot_3", "f_rest_0", "scale_2"]
    changes = [(b" %b\n" % name.encode(), b" %b%b\n" % (before, name.encode())) for name in names]
    back = read_scene(rewritten(tmp_path / "a.ply", *changes))
    assert list(back.extra) == [f"{before.decode()}label"]
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(back, group), getattr(scene, group))
    assert caplog.messages == []


def test_a_scalar_field_beside_the_property_itself_is_another(tmp_path):
    columns = {"scalar_opacity": np.ones(9, "<f4")}
    scene = replace(random_scene(9, 0), extra=columns)
    write_ply(tmp_path / "a.ply", scene)
    back = read_scene(tmp_path / "a.ply")
    np.testing.assert_array_equal(back.opacity, scene.opacity)
    assert list(back.extra) == ["scalar_opacity"]


def text_ply(names: list[str], rows: list[str], *lines: str) -> str:
    header = ["ply", "format ascii 1.0", *lines, f"element vertex {len(rows)}"]
    return "\n".join([*header, *(f"property float {n}" for n in names), "end_header", *rows, ""])


LAYOUT = [name for group in property_names(0).values() for name in group]


def test_2d_gaussians_are_flat(tmp_path, caplog):
    names = [name for name in LAYOUT if name != "scale_2"]
    path = tmp_path / "a.ply"
    path.write_text(text_ply(names, ["1 2 3 4 5 6 7 8 9 1 0 0 0"] * 2))
    scene = read_scene(path)
    np.testing.assert_array_equal(scene.log_scale[:, 0], np.float32([8, 9, -2]))
    np.testing.assert_array_equal(scene.rot[:, 1], [1, 0, 0, 0])
    assert caplog.messages == [f"{path}: a 2DGS scene without scale_2; its Gaussians are flat"]
    path.write_text(text_ply([*names, "scale_2"], ["1 2 3 4 5 6 7 8 9 1 0 0 0 -inf"] * 2))
    np.testing.assert_array_equal(read_scene(path).log_scale, scene.log_scale)


def test_isotropic_gaussians_have_one_scale(tmp_path, caplog):
    names = [name for name in LAYOUT if name not in ("scale_1", "scale_2")]
    (tmp_path / "a.ply").write_text(text_ply(names, ["1 2 3 4 5 6 7 -3 1 0 0 0"] * 2))
    scene = read_scene(tmp_path / "a.ply")
    np.testing.assert_array_equal(scene.log_scale, np.full((3, 2), -3, np.float32))
    assert (scene.extra, caplog.messages) == ({}, [])
    names.insert(names.index("scale_0"), "scale_2")
    (tmp_path / "a.ply").write_text(text_ply(names, ["1 2 3 4 5 6 7 -3 -3 1 0 0 0"] * 2))
    with pytest.raises(InvalidInput, match="missing property 'scale_1'"):
        read_scene(tmp_path / "a.ply")


def test_2d_gaussians_stay_so_in_sog_and_ply(tmp_path, caplog):
    """SOG states the model, as splat-transform does; a PLY has its comment."""
    names = [name for name in LAYOUT if name != "scale_2"]
    (tmp_path / "a.ply").write_text(text_ply(names, ["1 2 3 4 5 6 7 -3 -4 1 0 0 0"] * 2))
    convert_file(tmp_path / "a.ply", tmp_path / "a.sog")
    assert "gs_codec-" not in caplog.text  # the temporary file that is decoded to measure the loss
    convert_file(tmp_path / "a.sog", tmp_path / "b.ply")
    convert_file(tmp_path / "b.ply", tmp_path / "meta.json")
    for path in (tmp_path / "meta.json", tmp_path / "a.sog"):
        caplog.clear()
        scene = read_scene(path)
        assert caplog.messages == [f"{path}: a 2DGS scene; its Gaussians are flat"]
        np.testing.assert_allclose(scene.log_scale[:, 0], [-3, -4, -14], atol=1e-3)
    assert scene.comments == read_ply(tmp_path / "b.ply").comments == ("SplatRenderMode: 2dgs",)
    assert json.loads((tmp_path / "meta.json").read_text())["model"] == "2dgs"


def test_warnings_of_other_threads_are_logged_while_a_written_file_is_read(
    tmp_path, caplog, monkeypatch
):
    write_ply(tmp_path / "a.ply", replace(random_scene(20, 0), comments=("SplatRenderMode: 2dgs",)))
    convert_file(tmp_path / "a.ply", tmp_path / "a.sog")
    caplog.clear()

    def meanwhile(scene):
        thread = Thread(target=read_scene, args=[tmp_path / "a.sog"])
        thread.start()
        thread.join()
        return scene, None

    monkeypatch.setattr("gs_codec.formats.registry.finite_ends", meanwhile)
    read_written(tmp_path / "a.sog")
    assert caplog.messages == [f"{tmp_path / 'a.sog'}: a 2DGS scene; its Gaussians are flat"]


@pytest.mark.parametrize("suffix", ["egs", "spz", "splat", "glb", "csv", "rad"])
def test_formats_without_2d_gaussians_say_so(tmp_path, suffix):
    scene = replace(random_scene(20, 0), comments=("SplatRenderMode: 2dgs",))
    write_ply(tmp_path / "a.ply", scene)
    lost = convert_file(tmp_path / "a.ply", tmp_path / f"b.{suffix}").lost
    assert "left out: 2DGS flag" in lost
    if suffix == "egs":
        lossless = encode_file(tmp_path / "a.ply", tmp_path / "c.egs", "lossless")
        assert lossless.lost == ("left out: 2DGS flag",)


def test_the_first_frame_of_an_animation_of_brush_is_read(tmp_path, caplog):
    vertex = np.zeros(3, [(name, "<f4") for name in LAYOUT])
    vertex["rot_0"] = 1
    more = np.zeros(3, [(name, "u1") for name in ("x", "y", "z")])
    elements = [("vertex", vertex), ("meta_delta_min_1", more[:1]), ("delta_vertex_1", more)]
    (tmp_path / "a.ply").write_bytes(foreign.ply_file(elements))
    assert read_scene(tmp_path / "a.ply").count == 3
    told = "left out: elements meta_delta_min_1, delta_vertex_1"
    assert caplog.messages == [f"{tmp_path / 'a.ply'}: {told}"]


@pytest.mark.parametrize("profile", ["m", "paper-m"])
def test_2d_gaussians_are_as_flat_after_encoding(profile):
    scene = random_scene(200, 0)
    scene.log_scale[2] = scene.log_scale[:2].min(axis=0) - 10
    back = np.sort(decode_scene(encode_scene(scene, Config(profile))[0]).log_scale, axis=0)
    assert (back[1] - back[0] > 8).all()


def test_steps_do_not_follow_the_rounding_of_a_thickness():
    """Two scales whose difference is the same in all Gaussians, except for the last bits."""
    scene = random_scene(3000, 0)
    scene.log_scale[2] = scene.log_scale[:2].min(axis=0) - 10
    steps = steps_adding(scene, made_up_sensitivity(scene))(1e-3)
    assert all(np.abs(row).max() < 50 for row in steps.coefficients.values())


@pytest.mark.parametrize("thinner", [10.0, 90.0])
def test_flatness_takes_no_bits(thinner):
    scene = random_scene(3000, 0)
    sizes = []
    for by in (3.0, thinner):
        scene.log_scale[2] = scene.log_scale[:2].min(axis=0) - by
        sizes.append(len(encode_scene(scene, Config("m"))[0]))
    assert sizes[1] < 1.06 * sizes[0]


NOT_GAUSSIANS = {
    "points": (["x", "y", "z", "red"], "", "a point cloud without opacity and scales, not"),
    "mesh": (["x", "y", "z", "nx"], "element face 12\nproperty list uchar int vertex_indices\n",
             "a mesh of 12 faces without opacity and scales, not Gaussians"),
    "Scaffold-GS": (["x", "y", "z", "f_offset_0", "f_anchor_feat_0", "opacity", "scale_5"], "",
                    "anchors of Scaffold-GS, not Gaussians: a neural network"),
}  # fmt: skip


@pytest.mark.parametrize("kind", NOT_GAUSSIANS)
def test_files_that_are_not_scenes_are_named(kind, tmp_path):
    names, element, said = NOT_GAUSSIANS[kind]
    path = tmp_path / "a.ply"
    path.write_text(text_ply(names, [" ".join("1" for _ in names)]))
    rewritten(path, (b"end_header", element.encode() + b"end_header"))
    assert_refused(path, said)


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252", "cp932"])
def test_comments_that_are_not_ascii_are_dropped_with_a_warning(encoding, tmp_path, caplog):
    scene = replace(random_scene(9, 0), comments=("one", "two"))
    write_ply(tmp_path / "a.ply", scene)
    text = {"cp1252": "Übersicht", "cp932": "工場のソ"}.get(encoding, "Übersicht 工厂")
    changed = f"comment {text}".encode(encoding)
    back = read_scene(rewritten(tmp_path / "a.ply", (b"comment one", changed)))
    np.testing.assert_array_equal(back.positions, scene.positions)
    assert back.comments == ("two",)
    assert caplog.messages == [f"{tmp_path / 'a.ply'}: left out: comments that are not ASCII (1)"]


def test_names_that_are_not_ascii_are_dropped(tmp_path, caplog):
    scene = random_scene(9, 0)
    write_ply(tmp_path / "a.ply", replace(scene, extra={"height": np.ones(9, "<f4")}))
    back = read_scene(rewritten(tmp_path / "a.ply", (b"height", "höhe".encode())))
    assert (back.count, back.extra) == (9, {})
    assert caplog.messages == [f"{tmp_path / 'a.ply'}: left out: properties höhe"]


ROWS = [
    "1 2 3 0 0 0 -nan(ind) 1 1 1 1 0 0 0",
    "1 2 3 0 nan(snan) -1.#QNAN 1.#INF -1.#INF00 -inf infinity 1 0 1.#IND -1.#IND00",
]
READ = [
    [1, 2, 3, 0, 0, 0, np.nan, 1, 1, 1, 1, 0, 0, 0],
    [1, 2, 3, 0, np.nan, np.nan, np.inf, -np.inf, -np.inf, np.inf, 1, 0, np.nan, np.nan],
]


@pytest.mark.parametrize("start", [b"", b"\xef\xbb\xbf"], ids=["", "byte order mark"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["lf", "crlf", "cr"])
@pytest.mark.parametrize("space", [" ", "\t"], ids=["spaces", "tabs"])
def test_text_of_other_compilers_and_editors_is_read(start, newline, space, tmp_path):
    text = text_ply(LAYOUT, ROWS, "obj_info of a scanner").replace(" ", space)
    path = tmp_path / "a.ply"
    path.write_bytes(start + text.replace("\n", newline).encode())
    rows = vertex_rows(read_ply(path)).tolist()
    np.testing.assert_array_equal(rows, READ)


def test_a_ply_with_a_byte_order_mark_is_recognised_by_any_name(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbf" + text_ply(LAYOUT, ["1 " * 14]).encode())
    assert read_scene(path).count == 1


def test_a_network_is_named_as_such(tmp_path):
    with zipfile.ZipFile(tmp_path / "color_mlp.pt", "w") as archive:
        archive.writestr("color_mlp/data.pkl", b"\x80\x02}.")
        archive.writestr("color_mlp/code/__torch__/torch/nn.py", "")
    assert_refused(
        tmp_path / "color_mlp.pt", r"a network of TorchScript \(as of Scaffold-GS\), not"
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bits", [0x7FA00001, 0x7FC00000, 0x7F800000, 0xFF800000, 0x7F7FFFFF])
def test_nan_causes_no_numpy_warning(bits, tmp_path):
    value = np.full(9, bits, "<u4").view("<f4")
    scene = random_scene(9, 0)
    for group in GROUPS:
        getattr(scene, group)[:, :3] = value[0]
    columns = dict.fromkeys(("nx", "ny", "nz", "filter_3D"), value)
    write_ply(tmp_path / "a.ply", replace(scene, extra=columns))
    assert read_scene(tmp_path / "a.ply").count == 9
    flat = rewritten(tmp_path / "a.ply", (b" scale_2\n", b" s\n"), (b" filter_3D\n", b" f\n"))
    assert read_scene(flat, "drop").count == 9
