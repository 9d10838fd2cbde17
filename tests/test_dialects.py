"""PLY files as other programs write them: what is read, and what one line says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.coding import encode_file
from gs_codec.files.conversion import convert_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.ply import write_ply
from gs_codec.scene import Scene

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
def test_one_line_names_all_that_a_file_has_beyond_the_gaussians(profile, tmp_path, caplog):
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
    with pytest.raises(InvalidInput, match=r"properties label .*--extra keep or --extra drop"):
        encode_file(tmp_path / "a.egs", tmp_path / "d.egs", Config(extra="error"))
