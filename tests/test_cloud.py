"""Open3D clouds: documented attributes, shared memory, and the public API built on them."""

from __future__ import annotations

import gc
import logging
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from scenes import assert_same_floats, random_scene

import gs_codec
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import compare_files, read_scene
from gs_codec.files.writing import write_scene
from gs_codec.formats.cloud import from_cloud, to_cloud, turn_cloud
from gs_codec.formats.coordinates import turn_axes
from gs_codec.scene import ANTIALIASED, GROUPS, SH_COEFFICIENTS, Scene

PLY_TYPES = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")


def tensor(values) -> o3d.core.Tensor:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(values))


def assert_same_scene(first: Scene, second: Scene) -> None:
    assert_same_floats(first, second)
    assert first.has_normals == second.has_normals
    assert list(first.extra) == list(second.extra)
    for name, column in first.extra.items():
        assert column.dtype == second.extra[name].dtype
        np.testing.assert_array_equal(column, second.extra[name])


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("count", [0, 1, 50])
@pytest.mark.parametrize("sh_degree", range(4))
def test_round_trip_keeps_every_bit_seed1(sh_degree, count, normals):
    scene = replace(random_scene(count, sh_degree, seed=1), has_normals=normals)
    assert_same_scene(scene, from_cloud(to_cloud(scene)))


@pytest.mark.parametrize("sh_degree", range(4))
def test_attributes_are_as_documented_seed2(sh_degree):
    count, coefficients = 40, SH_COEFFICIENTS[sh_degree]
    scene = random_scene(count, sh_degree, seed=2)
    cloud = to_cloud(scene)
    arrays = {name: cloud.point[name].numpy() for name in cloud.point}
    assert {name: array.shape for name, array in arrays.items()} == {
        "positions": (count, 3),
        "f_dc": (count, 3),
        "f_rest": (count, coefficients, 3),
        "opacity": (count, 1),
        "log_scale": (count, 3),
        "scale": (count, 3),
        "rot": (count, 4),
    }
    assert {array.dtype for array in arrays.values()} == {np.dtype(np.float32)}
    for group in set(GROUPS) - {"f_rest"}:
        np.testing.assert_array_equal(arrays[group], getattr(scene, group).T)
    np.testing.assert_array_equal(arrays["scale"], np.exp(scene.log_scale).T)
    for k in range(coefficients):
        for colour in range(3):
            np.testing.assert_array_equal(
                arrays["f_rest"][:, k, colour], scene.f_rest[colour * coefficients + k]
            )


def test_zero_normals_are_an_attribute():
    cloud = to_cloud(replace(random_scene(5, 0), has_normals=True))
    np.testing.assert_array_equal(cloud.point["normals"].numpy(), np.zeros((5, 3), np.float32))


def test_every_cloud_is_right_down_forward_seed14(tmp_path):
    scene = random_scene(60, 3, seed=14)
    turned = turn_axes(scene, "RUB")
    write_scene(tmp_path / "rub.ply", turned, gs_codec.Config())
    encode_file(
        tmp_path / "rub.ply", tmp_path / "a.egs", gs_codec.Config("lossless", keep_order=True)
    )
    data = (tmp_path / "a.egs").read_bytes()
    clouds = (
        gs_codec.read(tmp_path / "rub.ply"),
        gs_codec.read(tmp_path / "a.egs"),
        gs_codec.decode(data),
    )
    unsaid = to_cloud(replace(turned, comments=()))
    for cloud in (*clouds, turn_cloud(unsaid, "RUB")):
        assert_same_scene(scene, from_cloud(cloud))
    assert_same_scene(replace(turned, comments=()), from_cloud(unsaid))
    with pytest.raises(InvalidInput, match="coordinates 'up'"):
        turn_cloud(unsaid, "up")


def test_a_lost_antialias_flag_is_reported_once(tmp_path, caplog):
    scene = replace(random_scene(60, 1), comments=(ANTIALIASED,))
    write_scene(tmp_path / "a.ply", scene, gs_codec.Config())
    encode_file(tmp_path / "a.ply", tmp_path / "a.egs")
    data, _ = encode_scene(scene, gs_codec.Config())
    gs_codec.encode_sequence(str(tmp_path / "a*.ply"), tmp_path / "frames.egs")
    for read in (
        lambda: gs_codec.read(tmp_path / "a.ply"),
        lambda: gs_codec.decode(tmp_path / "a.egs"),
        lambda: gs_codec.decode(data),
        lambda: list(gs_codec.decode_sequence(tmp_path / "frames.egs")),
    ):
        caplog.clear()
        read()
        [message] = caplog.messages
        assert message.startswith("a cloud does not keep the antialias flag")


@pytest.mark.parametrize("group", sorted(set(GROUPS) - {"rot"}))
def test_scene_and_cloud_share_memory(group):
    scene = random_scene(40, 3)
    cloud = to_cloud(scene)
    assert np.shares_memory(cloud.point[group].numpy(), getattr(scene, group))


def test_cloud_outlives_its_scene_seed3():
    cloud = to_cloud(random_scene(30_000, 3, seed=3))
    gc.collect()
    overwriting = [np.full((59, 30_000), 7, np.float32) for _ in range(3)]
    assert_same_scene(random_scene(30_000, 3, seed=3), from_cloud(cloud))
    assert len(overwriting) == 3


def test_changing_a_scene_from_a_cloud_keeps_the_cloud():
    scene = random_scene(40, 3)
    cloud = to_cloud(scene)
    made = from_cloud(cloud)
    before = {name: cloud.point[name].numpy().copy() for name in cloud.point}
    encode_scene(made, gs_codec.Config("paper-m"))
    for name, array in before.items():
        np.testing.assert_array_equal(cloud.point[name].numpy(), array)


# Present and missing attributes


def test_linear_scale_alone_is_enough_seed4():
    scene = random_scene(40, 1, seed=4)
    cloud = to_cloud(scene)
    del cloud.point["log_scale"]
    made = from_cloud(cloud)
    np.testing.assert_array_equal(made.log_scale, np.log(np.exp(scene.log_scale)))
    np.testing.assert_allclose(made.log_scale, scene.log_scale, rtol=1e-5)


def scaled_by_open3d(cloud):
    return cloud.scale(2, np.zeros(3, np.float32))


def with_one_scale_edited(cloud):
    cloud.point["scale"][17, 2] *= 1.001
    return cloud


def with_log_scale_edited(cloud):
    cloud.point["log_scale"] += 0.001
    return cloud


@pytest.mark.parametrize(
    ("edit", "count"),
    [(scaled_by_open3d, 40), (with_one_scale_edited, 1), (with_log_scale_edited, 40)],
)
def test_contradicting_scales_are_refused_seed5(edit, count, tmp_path):
    for cloud in (to_cloud(random_scene(40, 1, seed=5)), to_cloud(random_scene(40, 1)).clone()):
        edited = edit(cloud)
        for use in (
            gs_codec.encode,
            lambda cloud: gs_codec.write(tmp_path / "a.ply", cloud),
            lambda cloud: gs_codec.compare(cloud, cloud),
        ):
            with pytest.raises(InvalidInput, match=f"scale: .* log_scale in {count} Gaussian"):
                use(edited)
    assert list(tmp_path.iterdir()) == []


def test_the_remaining_scale_is_used_seed5(tmp_path):
    scene = random_scene(40, 1, seed=5)
    cloud = scaled_by_open3d(to_cloud(scene).clone())
    del cloud.point["log_scale"]
    gs_codec.write(tmp_path / "a.ply", cloud)
    larger = read_scene(tmp_path / "a.ply")
    np.testing.assert_allclose(larger.log_scale, scene.log_scale + np.log(2), atol=1e-6)
    np.testing.assert_array_equal(larger.positions, 2 * scene.positions)
    cloud = with_log_scale_edited(to_cloud(scene).clone())
    del cloud.point["scale"]
    np.testing.assert_array_equal(from_cloud(cloud).log_scale, scene.log_scale + np.float32(0.001))


def test_scales_beyond_the_float_range_agree():
    scene = random_scene(8, 0)
    scene.log_scale[0] = [np.nan, np.inf, -np.inf, 200, -200, -95, 88.7, 0]
    assert_same_scene(scene, from_cloud(to_cloud(scene), exact=True))


def test_scale_of_another_shape_is_refused():
    cloud = to_cloud(random_scene(40, 1))
    cloud.point["scale"] = tensor(np.ones((40, 1), np.float32))
    with pytest.raises(InvalidInput, match=r"scale: float32 \(40, 1\), expected float32 \(N, 3\)"):
        from_cloud(cloud)


def test_scale_of_zero_is_tiny_when_encoding():
    cloud = to_cloud(random_scene(40, 1))
    del cloud.point["log_scale"]
    cloud.point["scale"] = tensor(np.zeros((40, 3), np.float32))
    decoded = gs_codec.decode(gs_codec.encode(cloud, gs_codec.Config("paper-m")))
    np.testing.assert_allclose(decoded.point.log_scale.numpy(), -30, rtol=1e-6)


def test_f_rest_may_be_missing():
    scene = random_scene(40, 3)
    cloud = to_cloud(scene)
    del cloud.point["f_rest"]
    assert_same_scene(replace(scene, f_rest=scene.f_rest[:0]), from_cloud(cloud))


@pytest.mark.parametrize("name", ["positions", "f_dc", "opacity", "rot", "log_scale"])
def test_missing_attribute_is_refused(name):
    scene = random_scene(40, 1)
    full = to_cloud(scene)
    cloud = o3d.t.geometry.PointCloud()
    for other in full.point:
        if other not in (name, "scale"):
            cloud.point[other] = full.point[other]
    with pytest.raises(InvalidInput, match=f"'{name}': missing"):
        from_cloud(cloud)


def test_empty_cloud_is_refused():
    with pytest.raises(InvalidInput, match="'positions': missing"):
        from_cloud(o3d.t.geometry.PointCloud())


@pytest.mark.parametrize("dtype", ["f8", "i4", "u1"])
@pytest.mark.parametrize("name", GROUPS)
def test_wrong_type_is_refused(name, dtype):
    cloud = to_cloud(random_scene(40, 1))
    cloud.point[name] = tensor(cloud.point[name].numpy().astype(dtype))
    with pytest.raises(InvalidInput, match=f"{name}: {np.dtype(dtype)}.*expected float32"):
        from_cloud(cloud)


@pytest.mark.parametrize("name", GROUPS)
def test_wrong_shape_is_refused(name):
    cloud = to_cloud(random_scene(40, 1))
    shape = (40, 4, 3) if name == "f_rest" else (40, 5)
    wrong = o3d.t.geometry.PointCloud()
    for other in cloud.point:
        wrong.point[other] = (
            tensor(np.zeros(shape, np.float32)) if other == name else cloud.point[other]
        )
    with pytest.raises(InvalidInput, match=name):
        from_cloud(wrong)


def test_lengths_that_differ_are_refused():
    cloud = to_cloud(random_scene(40, 0))
    cloud.point["opacity"] = tensor(np.zeros((39, 1), np.float32))
    with pytest.raises(InvalidInput, match="opacity"):
        from_cloud(cloud)


@pytest.mark.parametrize("dtype", PLY_TYPES)
def test_extra_attributes_of_every_type(dtype):
    scene = random_scene(300, 0, seed=6)
    scene = replace(scene, extra={"label": np.arange(300).astype(dtype)})
    cloud = to_cloud(scene)
    assert cloud.point["label"].shape == [300, 1]
    assert_same_scene(scene, from_cloud(cloud, "keep"))
    assert from_cloud(cloud, "drop").extra == {}
    with pytest.raises(InvalidInput, match="label; choose"):
        from_cloud(cloud)
    decoded = decode_scene(encode_scene(scene, gs_codec.Config("paper-m"))[0])
    assert_same_scene(decoded, from_cloud(to_cloud(decoded), "keep"))


@pytest.mark.parametrize("name", ["positions", "scale", "rot", "normals", "f_rest"])
def test_extra_property_never_replaces_an_attribute(name, caplog):
    """A PLY may have a property ``scale``; the cloud's ``scale`` is the documented one."""
    scene = random_scene(40, 0)
    extra = {name: np.full(40, 5, np.float32)}
    cloud = to_cloud(replace(scene, extra=extra))
    assert caplog.messages == [f"a cloud: left out: properties {name}"]
    expected = to_cloud(scene)
    for other in expected.point:
        np.testing.assert_array_equal(cloud.point[other].numpy(), expected.point[other].numpy())


def test_extra_attributes_can_be_changed_after_decoding():
    scene = replace(random_scene(40, 0), extra={"label": np.arange(40, dtype="u1")})
    decoded = decode_scene(encode_scene(scene, gs_codec.Config("paper-m"))[0])
    assert decoded.extra["label"].flags.writeable


def test_normals_that_are_not_zero_are_refused_kept_or_dropped():
    scene = random_scene(40, 0)
    cloud = to_cloud(scene)
    normals = np.zeros((40, 3), np.float32)
    normals[7, 1] = 1
    cloud.point["normals"] = tensor(normals)
    with pytest.raises(InvalidInput, match="normals that are not all zero"):
        from_cloud(cloud)
    kept = from_cloud(cloud, "keep")
    columns = {f"n{axis}": normals[:, i] for i, axis in enumerate("xyz")}
    assert_same_scene(replace(scene, extra=columns), kept)
    assert from_cloud(cloud, "drop").extra == {}


# Our attributes in Open3D's methods


def test_open3d_reads_the_strided_attributes_right_seed7():
    scene = random_scene(500, 2, seed=7)
    cloud = to_cloud(scene)
    np.testing.assert_array_equal(cloud.get_min_bound().numpy(), scene.positions.min(axis=1))
    np.testing.assert_array_equal(cloud.get_max_bound().numpy(), scene.positions.max(axis=1))
    centre = scene.positions.astype(np.float64).mean(axis=1)
    np.testing.assert_allclose(cloud.get_center().numpy(), centre, atol=1e-5)
    points = np.asarray(cloud.to_legacy().points)
    np.testing.assert_array_equal(points, scene.positions.T.astype(np.float64))


def test_open3d_selects_and_copies_right_seed8():
    scene = random_scene(500, 2, seed=8)
    mask = scene.opacity[0] > 0
    assert 0 < mask.sum() < 500
    cloud = to_cloud(scene)
    assert_same_scene(scene.take(mask), from_cloud(cloud.select_by_mask(tensor(mask))))
    assert_same_scene(scene, from_cloud(cloud.clone()))
    both = from_cloud(cloud.append(cloud))
    assert_same_scene(scene.take(np.tile(np.arange(500), 2)), both)


def test_open3d_moves_a_copy_right_seed9():
    scene = random_scene(500, 0, seed=9)
    moved = to_cloud(scene).clone().translate(np.array([1, 2, 3], np.float32))
    expected = scene.positions + np.array([[1], [2], [3]], np.float32)
    np.testing.assert_array_equal(from_cloud(moved).positions, expected)


def test_open3d_turns_a_scene_without_sh_right_seed15():
    scene = random_scene(200, 0, seed=15)
    x, y, z = scene.positions
    w, i, j, k = scene.rot
    half_around_z = tensor(np.diag([-1, -1, 1]).astype(np.float32))
    for cloud in (to_cloud(scene).clone(), to_cloud(random_scene(200, 0, seed=15))):
        turned = from_cloud(cloud.rotate(half_around_z, np.zeros(3, np.float32)))
        np.testing.assert_allclose(turned.positions, [-x, -y, z], atol=1e-6)
        np.testing.assert_allclose(turned.rot, [-k, -j, i, w], atol=1e-6)


@pytest.mark.parametrize("sh_degree", range(4))
def test_open3d_opens_our_ply_seed10(sh_degree, tmp_path):
    scene = random_scene(60, sh_degree, seed=10)
    path = tmp_path / "scene.ply"
    gs_codec.write(path, to_cloud(scene))
    theirs = o3d.t.io.read_point_cloud(str(path))
    ours = to_cloud(scene)
    names = ["positions", "f_dc", "opacity", "rot"] + ["f_rest"] * (sh_degree > 0)
    for name in names:
        np.testing.assert_array_equal(theirs.point[name].numpy(), ours.point[name].numpy(), name)
    np.testing.assert_allclose(
        theirs.point["scale"].numpy(), ours.point["scale"].numpy(), rtol=1e-6
    )


def test_clouds_read_by_open3d_can_be_encoded_seed11(tmp_path):
    scene = random_scene(60, 3, seed=11)
    path = tmp_path / "scene.ply"
    gs_codec.write(path, to_cloud(scene))
    made = from_cloud(o3d.t.io.read_point_cloud(str(path)), "drop")
    np.testing.assert_array_equal(made.f_rest, scene.f_rest)
    np.testing.assert_allclose(made.log_scale, scene.log_scale, rtol=1e-5)


# The public API


def test_public_names_exist_and_are_few():
    assert set(gs_codec.__all__) <= set(dir(gs_codec))
    for name in gs_codec.__all__:
        assert getattr(gs_codec, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = gs_codec.nothing


def test_ply_round_trip_through_the_api_seed12(tmp_path):
    extra = {"label": np.arange(200, dtype="<i2")}
    scene = replace(random_scene(200, 3, seed=12), has_normals=True, extra=extra)
    gs_codec.write(tmp_path / "a.PLY", to_cloud(scene))
    assert_same_scene(scene, from_cloud(gs_codec.read(tmp_path / "a.PLY", "keep"), "keep"))
    assert_same_scene(scene, from_cloud(gs_codec.read(tmp_path / "a.PLY"), "keep"))
    with pytest.raises(InvalidInput, match="label"):
        gs_codec.read(tmp_path / "a.PLY", "error")


def test_egs_through_the_api_is_that_of_the_codec_seed13(tmp_path):
    scene = random_scene(700, 2, seed=13)
    config = gs_codec.Config("paper-l", {"opacity": 5})
    cloud = to_cloud(scene)
    expected, _ = encode_scene(scene, config)
    assert gs_codec.encode(cloud, config) == expected
    path = tmp_path / "a.egs"
    gs_codec.write(path, cloud, config)
    assert path.read_bytes() == expected
    decoded = decode_scene(expected)
    assert_same_scene(decoded, from_cloud(gs_codec.decode(expected)))
    assert_same_scene(decoded, from_cloud(gs_codec.read(str(path))))
    for source in (expected, path, str(path)):
        info = gs_codec.inspect(source)
        assert (info.count, info.sh_degree, info.profile) == (700, 2, "paper-l")


def test_empty_cloud_through_the_api(tmp_path):
    cloud = to_cloud(random_scene(0, 3))
    data = gs_codec.encode(cloud, gs_codec.Config("paper-m"))
    assert gs_codec.inspect(data).count == 0
    assert from_cloud(gs_codec.decode(data)).count == 0
    gs_codec.write(tmp_path / "a.ply", cloud)
    assert from_cloud(gs_codec.read(tmp_path / "a.ply")).count == 0


def test_compare_accepts_two_files_or_two_clouds(trio):
    matched = gs_codec.compare(trio.ply, str(trio.decoded))
    assert matched.matched_by == "stored order"
    assert matched == compare_files(trio.ply, trio.egs)
    decoded = gs_codec.read(trio.decoded)
    same = gs_codec.compare(decoded, gs_codec.read(trio.egs))
    assert same.matched_by == "index"
    assert {group.max for group in same.groups} == {0}
    with pytest.raises(InvalidInput, match="two files or two clouds"):
        gs_codec.compare(trio.ply, decoded)


def test_compare_of_clouds_ignores_extra_attributes():
    cloud = to_cloud(random_scene(40, 0))
    cloud.point["label"] = tensor(np.zeros((40, 1), np.int32))
    result = gs_codec.compare(cloud, to_cloud(random_scene(40, 0)))
    assert {group.max for group in result.groups} == {0}


@pytest.mark.parametrize("name", ["a.obj", "a", "a.egs.bak"])
def test_unknown_suffix_is_refused(name, tmp_path):
    with pytest.raises(InvalidInput, match=r"expected \.egs, .*\.ply, .* or \.collision\.glb"):
        gs_codec.write(tmp_path / name, to_cloud(random_scene(3)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("two words", np.zeros((40, 1), np.float32)),
        ("größe", np.zeros((40, 1), np.float32)),
        ("x", np.zeros((40, 1), np.float32)),
        ("label", np.zeros((40, 1), np.int64)),
        ("colors", np.zeros((40, 3), np.float32)),
    ],
    ids=["space", "non-ASCII", "taken", "int64", "three columns"],
)
@pytest.mark.parametrize("suffix", [".ply", ".egs"])
def test_attribute_that_no_file_can_store_is_refused(name, values, suffix, tmp_path):
    cloud = to_cloud(random_scene(40, 0))
    cloud.point[name] = tensor(values)
    with pytest.raises(InvalidInput, match=name):
        gs_codec.write(tmp_path / f"a{suffix}", cloud, gs_codec.Config(extra="keep"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["missing.ply", "missing.egs"])
def test_missing_files_are_refused(name, tmp_path):
    for function in (gs_codec.read, gs_codec.inspect):
        with pytest.raises(InvalidInput, match=f"{name}: No such file"):
            function(tmp_path / name)


def test_errors_are_of_one_family():
    for data in (b"", b"nothing", b"\x89EGS\r\n\x1a\n", bytes(100)):
        for function in (gs_codec.decode, gs_codec.inspect):
            with pytest.raises(gs_codec.GsCodecError):
                function(data)


def test_damage_of_an_egs_is_reported_with_the_file_name(trio, tmp_path):
    path = tmp_path / "bad.egs"
    path.write_bytes(trio.egs.read_bytes()[:-1])
    for function in (gs_codec.read, gs_codec.inspect):
        with pytest.raises(gs_codec.GsCodecError, match=r"bad\.egs: file: "):
            function(path)


def test_nothing_is_printed(trio, tmp_path, capfd, caplog):
    with caplog.at_level(logging.WARNING):
        cloud = gs_codec.read(trio.ply)
        gs_codec.write(tmp_path / "a.egs", cloud)
        gs_codec.compare(trio.ply, trio.egs)
        gs_codec.decode(gs_codec.encode(cloud, gs_codec.Config("paper-m")))
    assert capfd.readouterr() == ("", "")
    assert caplog.text == ""
