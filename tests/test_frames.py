"""Frames of sequences on disk: their order, names and errors, and animations."""

from __future__ import annotations

import logging
import zipfile
from dataclasses import replace
from pathlib import Path

import foreign
import numpy as np
import pytest
from plyfile import PlyData
from refusals import assert_one_line
from scenes import assert_same_bits, random_scene

from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.writer import write_ply
from gs_codec.formats.splat import pack_splat
from gs_codec.scene import Scene
from gs_codec.sequences.frame_sources import Frames, open_frames

NAMES = ["frame2", "frame3", "frame10"]


def saved(folder: Path, names: list[str] = NAMES) -> Path:
    """A folder of frames as PLY, each of one Gaussian more than the one before."""
    for number, name in enumerate(names):
        path = folder / f"{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_ply(path, random_scene(3 + number, 1, seed=number))
    return folder


def zipped(path: Path, names: list[str]) -> Path:
    """A zip of the files in the folder of `path`, under these names."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            archive.write(path.parent / name.rpartition("/")[2], name)
    return path


def assert_frames(frames: Frames, names: list[str] = NAMES) -> None:
    assert frames.names == names
    assert len(frames) == len(names)
    assert frames.fps is None
    for number, scene in enumerate(frames):
        assert_same_bits(scene, random_scene(3 + number, 1, seed=number))
    assert_same_bits(frames.read(1), random_scene(4, 1, seed=1))


def test_files_in_a_folder_are_frames_in_natural_order(tmp_path):
    folder = saved(tmp_path)
    (folder / "cameras.json").write_text("[]")
    (folder / ".frame4.ply").write_text("")
    frames = open_frames(folder)
    assert_frames(frames)
    assert frames.stored_bytes == sum((folder / f"{name}.ply").stat().st_size for name in NAMES)


def test_files_of_a_pattern_are_frames(tmp_path):
    saved(tmp_path)
    (tmp_path / "scene.ply").write_text("")
    assert_frames(open_frames(f"{tmp_path}/frame*.ply"))


def test_a_folder_whose_name_is_a_pattern_is_a_folder(tmp_path):
    assert_frames(open_frames(saved(tmp_path / "take[1]*")))


def test_files_in_a_zip_are_frames(tmp_path):
    saved(tmp_path)
    names = [f"take/{name}.ply" for name in NAMES]
    path = zipped(tmp_path / "a.zip", [*reversed(names), *(f"__MACOSX/{n}" for n in names)])
    assert_frames(open_frames(path))
    assert open_frames(path).stored_bytes == open_frames(tmp_path).stored_bytes


@pytest.mark.parametrize("start", ["1\u00b2", "\u0663/", "0" * 5000, "9" * 5000])
def test_digits_of_other_scripts_and_long_numbers_are_names(tmp_path, start):
    names = [f"{start}2", f"{start}10"]
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name in (*names[::-1], "a/b"):
            archive.writestr(f"{name}.ply", b"ply")
    found = [name for name in open_frames(tmp_path / "a.zip").names if name != "b"]
    assert found == [name.rpartition("/")[2] for name in names]


@pytest.mark.parametrize("last", ["point_cloud", "iteration_9/point_cloud"])
def test_frames_of_one_name_are_called_by_their_folders(tmp_path, last):
    saved(tmp_path, [f"t{number}/{last}" for number in (2, 3, 10)])
    assert_frames(open_frames(f"{tmp_path}/*/{last}.ply"), ["t2", "t3", "t10"])


def test_two_names_are_not_the_same(tmp_path):
    saved(tmp_path, ["a/b_c/s", "a_b/c/s"])
    with pytest.raises(InvalidInput, match=r"two frames of the same name 'a_b_c'"):
        open_frames(f"{tmp_path}/*/*/s.ply")


def test_frames_of_other_formats(tmp_path):
    scenes = [random_scene(20, 0, seed) for seed in range(2)]
    for number, scene in enumerate(scenes):
        (tmp_path / f"{number}.splat").write_bytes(pack_splat(scene)[0])
    frames = open_frames(tmp_path)
    assert (frames.names, frames.stored_bytes) == (["0", "1"], 2 * 20 * 32)
    np.testing.assert_array_equal(frames.read(1).positions, scenes[1].positions)
    (tmp_path / "2.ply").write_text("")
    with pytest.raises(InvalidInput, match=r"2 \.splat, 1 \.ply; expected frames of one of the"):
        open_frames(tmp_path)


def test_what_all_frames_leave_out_is_told_once(tmp_path, caplog):
    for number, name in enumerate(["glow", "glow", "heat"]):
        scene = random_scene(5, 1)
        write_ply(tmp_path / f"{number}.ply", replace(scene, extra={name: scene.opacity[0]}))
    frames = open_frames(tmp_path, extra="drop")
    assert len([*frames, *frames]) == 6
    told = [f"{tmp_path / '0.ply'}: left out: properties glow"]
    assert caplog.messages == [*told, f"{tmp_path / '2.ply'}: left out: properties heat"]


@pytest.mark.parametrize("name", ["tileset.json", "lod-meta.json", "meta.json"])
def test_folders_of_a_scene_of_several_files_name_it(tmp_path, name):
    write_ply(tmp_path / "a.ply", random_scene(9, 1))
    path = tmp_path / "scene" / name
    path.parent.mkdir()
    convert_file(tmp_path / "a.ply", path)
    if name == "tileset.json":  # a folder of tiles, as other programs write it
        (path.parent / "tiles/0/0.glb").rename(path.parent / "0.glb")
        path.write_text(path.read_text().replace("tiles/0/0.glb", "0.glb"))
    with pytest.raises(InvalidInput) as caught:
        open_frames(path.parent)
    text = f"{path.parent}: files of one scene, no frames; expected {path}"
    assert str(caught.value) == text
    with pytest.raises(InvalidInput) as caught:
        read_scene(path.parent)
    assert str(caught.value) == f"{path.parent}: files of one scene; expected {path}"


def test_frames_are_turned_into_the_usual_system(tmp_path):
    scene = random_scene(5)
    write_ply(tmp_path / "0.ply", turn_axes(scene, "RUB"))
    np.testing.assert_array_equal(open_frames(tmp_path).read(0).positions, scene.positions)


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["1", "2", "5", "6"], "frames are missing between 2 and 5"),
        (["a1", "a3", "a7", "a9", "a12", "a20"], "a3 and a7, a9 and a12, a12 and a20"),
        (["0", "10", "20"], None),
        (["1", "2", "last"], None),
        (["7"], None),
    ],
)  # fmt: skip
def test_gaps_in_numbers_are_reported(tmp_path, caplog, names, told):
    saved(tmp_path, names)
    with caplog.at_level(logging.WARNING):
        open_frames(tmp_path)
    assert [told in message for message in caplog.messages] == ([True] if told else [])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (".", "no frames, expected files of one of .ply, "),
        ("*.ply", "no frames, expected files of"),
        ("*.txt", "1 of another kind; expected frames of one of the formats .ply"),
        ("none.ply", "No such file or directory"),
        ("none.zip", "No such file"),
        ("notes.txt", "begins with b'text', expected"),
        ("empty.zip", "no frames, expected files of"),
        ("bad.zip", "zip: "),
    ],
)
def test_sources_without_frames_are_refused(tmp_path, source, message):
    (tmp_path / "notes.txt").write_text("text")
    (tmp_path / "bad.zip").write_text("text")
    zipped(tmp_path / "empty.zip", ["notes.txt"])
    with pytest.raises(InvalidInput) as refused:
        open_frames(tmp_path / source)
    assert message in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path))


def test_one_scene_is_not_a_sequence(tmp_path):
    saved(tmp_path, ["scene"])
    with pytest.raises(InvalidInput, match="one scene, expected frames: a folder, a pattern"):
        open_frames(tmp_path / "scene.ply")


@pytest.mark.parametrize("fps", [0, -1, np.nan, np.inf])
def test_frames_per_second_are_positive(tmp_path, fps):
    with pytest.raises(InvalidInput, match=r"fps: .*, expected more than 0"):
        open_frames(tmp_path, fps)
    assert open_frames(saved(tmp_path), 24).fps == 24


def test_errors_name_the_frame(tmp_path):
    (saved(tmp_path) / "frame3.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    frames = open_frames(tmp_path)
    with pytest.raises(InvalidInput) as refused:
        frames.read(1)
    assert_one_line(refused.value, tmp_path / "frame3.ply")
    path = zipped(tmp_path / "a.zip", [f"{name}.ply" for name in NAMES])
    with pytest.raises(InvalidInput) as refused:
        open_frames(path).read(1)
    assert_one_line(refused.value, path / "frame3.ply")
    assert_same_bits(frames.read(2), random_scene(5, 1, seed=2))


def test_memory_limit_of_a_frame(tmp_path):
    with pytest.raises(InvalidInput, match=r"frame2\.ply: 3 Gaussians of .*max-bytes"):
        open_frames(saved(tmp_path), max_bytes=100).read(0)


# Animations of Brush


def animation(
    path: Path, scene: Scene, frames: list[dict[str, np.ndarray]], range_of: dict
) -> Path:
    """Save an animation, with the same range (low, high) of differences for all frames."""
    write_ply(path, scene)
    elements = [("vertex", np.array(PlyData.read(path, mmap=False)["vertex"].data))]
    for number, columns in enumerate(frames):
        for k, end in enumerate(("min", "max") if range_of else ()):
            row = np.array(
                [tuple(ends[k] for ends in range_of.values())], [(n, "f4") for n in range_of]
            )
            elements.append((f"meta_delta_{end}_{number:05d}", row))
        rows = np.empty(
            len(next(iter(columns.values()))), [(n, c.dtype) for n, c in columns.items()]
        )
        for name, column in columns.items():
            rows[name] = column
        elements.append((f"delta_vertex_{number:05d}", rows))
    path.write_bytes(foreign.ply_file(elements))
    return path


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_an_animation_of_brush_has_differences_within_ranges(tmp_path, dtype):
    scene, most = random_scene(4, 1), 1 if dtype == np.float32 else np.iinfo(dtype).max - 1
    shares = np.array([0, 1, 0.5, 1]) * most
    frames = [{"x": (k * shares).astype(dtype), "rot_3": shares.astype(dtype)} for k in (0, 1)]
    path = animation(tmp_path / "a.ply", scene, frames, {"x": (-1, 3), "rot_3": (0.5, 0.75)})
    found = open_frames(path, 12)
    assert (found.names, found.fps) == (["00000", "00001"], 12)
    assert found.stored_bytes == path.stat().st_size
    first, second = found
    np.testing.assert_allclose(first.positions[0], scene.positions[0] - 1, rtol=1e-6)
    np.testing.assert_allclose(second.positions[0] - scene.positions[0], [-1, 3, 1, 3], atol=1e-6)
    np.testing.assert_allclose(second.rot[3] - scene.rot[3], [0.5, 0.75, 0.625, 0.75], atol=1e-6)
    rest = replace(first, positions=scene.positions, rot=scene.rot)
    assert_same_bits(rest, scene)


def test_differences_without_ranges_are_added(tmp_path):
    scene, change = random_scene(4, 0), np.arange(4, dtype=np.float32)
    path = animation(tmp_path / "a.ply", scene, [{"scale_1": change}] * 40, {})
    frames = open_frames(path)
    assert len(frames) == 40
    np.testing.assert_array_equal(frames.read(39).log_scale[1], scene.log_scale[1] + change)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"x": np.zeros(3, np.float32)}, "'delta_vertex_00000': 3 rows, expected 4 as in 'vertex'"),
        ({"x": np.zeros(4, np.int8)}, "differences of type int8, expected float or unsigned"),
    ],
)  # fmt: skip
def test_differences_of_other_gaussians_are_refused(tmp_path, columns, message):
    path = animation(tmp_path / "a.ply", random_scene(4, 0), [columns], {})
    with pytest.raises(InvalidInput, match=message) as refused:
        open_frames(path).read(0)
    assert_one_line(refused.value, path)
