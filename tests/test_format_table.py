"""Declarations of formats: their functions exist, FORMATS.md has their rows; a new format works."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest
from command_line import python
from scenes import random_scene, thorough

import gs_codec.formats
from gs_codec.format_table import FLAG, FORMATS, SceneFormat
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.lazy import Lazy

DOCUMENT = Path(gs_codec.formats.__file__).with_name("FORMATS.md").read_text()

named = pytest.mark.parametrize("known", FORMATS, ids=lambda known: known.name)


@named
def test_functions_named_by_a_format_exist(known):
    lazy = [value for value in vars(known).values() if isinstance(value, Lazy)]
    for each in lazy:
        assert callable(getattr(import_module(each.module), each.name)), each.name


def test_no_suffix_belongs_to_two_formats():
    for suffixes in ([s for f in FORMATS for s in f.read], [s for f in FORMATS for s in f.written]):
        assert len(set(suffixes)) == len(suffixes)


def row_of(known: SceneFormat) -> list[str]:
    """Expected cells of a format's row: names, read, written, contents."""
    names = {*known.written, *known.read} - {".json"}
    table = DOCUMENT[DOCUMENT.index("| | read | written |") : DOCUMENT.index("\n## ")]
    rows = [re.split(r" ?\| ?", line)[1:-1] for line in table.splitlines() if line.startswith("|")]
    suffixes = [set(re.findall(r"`(\.[\w.]+|[\w-]+\.json)`", cells[0])) for cells in rows]
    assert suffixes.count(names) == 1, known.name
    return rows[suffixes.index(names)]


@named
def test_the_documented_table_agrees(known):
    names, read, written, contents = row_of(known)
    assert (read != "no") == bool(known.read)
    assert (written != "no") == bool(known.written)
    without_flag = re.search(r"\bno [^;]*antialias flag", contents) is not None
    assert without_flag == (bool(known.written) and FLAG not in known.keeps)
    assert ("extra `" in names) == (known.require is not None)


#: A module that reads and writes a new format.
MODULE = """
import numpy as np
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.limits import check_count
from gs_codec.format_table import TOY
from gs_codec.scene import Scene


def stated_size(path, data):
    return (len(data) - 4) // 56, 0


def read(path, data, max_bytes):
    count, degree = stated_size(path, data)
    check_count(count, degree, len(data), max_bytes)
    planes = np.frombuffer(data, "<f4", offset=4).reshape(14, count).copy()
    empty = np.empty((0, count), np.float32)
    return Scene(planes[:3], planes[3:6], empty, planes[6:7], planes[7:10], planes[10:])


def pack(scene):
    groups = (scene.positions, scene.f_dc, scene.opacity, scene.log_scale, scene.rot)
    planes = np.concatenate(groups).astype("<f4")
    return b"TOY!" + planes.tobytes(), (TOY.rounding, *left_out_of(scene, TOY))
"""

#: Its record for the table.
RECORD = """
import os, sys
from gs_codec import format_table as table

table.TOY = table.SceneFormat(
    name="toy",
    read=(".toy",),
    signatures=(b"TOY!",),
    reader=table.Lazy("toy", "read"),
    stated_size=table.Lazy("toy", "stated_size"),
    written={".toy": {}},
    writer=table.Lazy("toy", "pack"),
    rounding="nothing rounded",
    sh_degrees={".toy": 0},
)
table.FORMATS += (table.TOY,)
table.BATCHED += table.TOY.batched
"""

#: Also imported by processes of a batch.
RUN = """
from gs_codec.cli.main import main

os.dup2(1, 2)
for line in LINES if __name__ == "__main__" else ():
    print("$", line, flush=True)
    sys.argv = ["gs-codec", *line.split()]
    try:
        main()
    except SystemExit as stop:
        print("status", stop.code or 0, flush=True)
"""

#: Commands, and what they print about the format.
LINES = {
    "convert scene.ply a.toy": "a.toy: 60 Gaussians, SH degree 0",
    "inspect a.toy": "a.toy: toy, 60 Gaussians",
    "inspect unnamed": "unnamed: toy, 60 Gaussians",
    "convert a.toy back.ply": "back.ply: 60 Gaussians, SH degree 0",
    "encode scene.ply b.toy --coarseness 2": "--coarseness has no effect on b.toy",
    "convert scene.ply a.obj": ".usdz, .toy, ",
    "inspect text": ", tileset.json, .toy of a scene",
    "convert --help": ".usdz or .toy;",
    "inspect --help": "or .toy; - is stdin.",
}


BATCH = {
    "convert in/one.ply in/two.toy": "in/two.toy: 30 Gaussians",
    "batch in out --format toy -j 1": "2 scenes encoded",
    "inspect out/two.toy": "out/two.toy: toy, 30 Gaussians",
}


@pytest.mark.parametrize("lines", [LINES, thorough(BATCH)], ids=["commands", "batch"])
def test_a_new_format_is_a_module_and_a_record(tmp_path, lines):
    write_ply(tmp_path / "scene.ply", random_scene(60, 1))
    (tmp_path / "toy.py").write_text(MODULE)
    (tmp_path / "text").write_text("hello")
    (tmp_path / "in").mkdir()
    write_ply(tmp_path / "in/one.ply", random_scene(30, 1))
    (tmp_path / "unnamed").symlink_to("a.toy")
    (tmp_path / "run.py").write_text(f"LINES = {[*lines]}{RECORD}{RUN}")
    status, out, err = python("run.py", cwd=tmp_path)
    assert status == 0, err
    _, *answers = re.split(r"^\$ ", out, flags=re.MULTILINE)
    for answer, (line, expected) in zip(answers, lines.items(), strict=True):
        assert answer.startswith(line)
        assert expected in " ".join(re.sub("[│─╭╮╰╯]", " ", answer).split()), answer
