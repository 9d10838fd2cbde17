"""Files written by earlier builds still decode to the same floats, in every format."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from golden.make import GUIDES, golden_levels, golden_scenes, golden_sequences
from golden.make_other import COUNT, HOME, written
from moving_scenes import decode
from other_programs import check, stored_numbers
from reference_decoder import decode as reference_decode
from reference_sequence import decode_sequence
from scenes import encode_by

from gs_codec.codecs import decode_part, decode_scene
from gs_codec.codecs.part import Part
from gs_codec.scene import GROUPS, Scene

FOLDER = Path(__file__).parent / "golden"
SEQUENCES = [FOLDER / f"{name}.egs" for name in golden_sequences()]
FILES = [path for path in sorted(FOLDER.glob("*.egs")) if path not in SEQUENCES]


def test_there_are_golden_files_of_all_versions():
    assert {path.stem for path in FILES} == {*golden_scenes(), *golden_levels()}


def test_golden_files_never_change():
    listed = [line.split() for line in (FOLDER / "SHA256SUMS").read_text().splitlines()]
    found = {path.name: sha256(path.read_bytes()).hexdigest() for path in FOLDER.glob("v?-*")}
    assert {name: digest for digest, name in listed} == found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_golden_file_decodes_to_the_same_floats(path):
    decoded = decode_scene(path.read_bytes())
    with np.load(path.with_suffix(".npz")) as expected:
        for group in GROUPS:
            before, after = expected[group], getattr(decoded, group)
            np.testing.assert_array_equal(after.view(np.uint32), before.view(np.uint32))


@pytest.mark.parametrize("name", golden_levels())
def test_levels_of_a_golden_file_decode_to_the_same_floats(name):
    path = FOLDER / f"{name}.egs"
    found = [decode_part(path.read_bytes(), Part(level=level))[0] for level in (1, 2, 3)]
    values = [level["values"]["z"] for level in reference_decode(path.read_bytes())["levels"]]
    with np.load(path.with_suffix(".npz")) as expected:
        for level, (scene, z) in enumerate(zip(found, values, strict=True), 1):
            np.testing.assert_array_equal(scene.positions[2].view("u4"), z.view("u4"))
            for group in GROUPS:
                before, after = expected[f"level {level} {group}"], getattr(scene, group)
                np.testing.assert_array_equal(after.view(np.uint32), before.view(np.uint32))


@pytest.mark.parametrize("path", SEQUENCES, ids=lambda path: path.stem)
def test_frames_of_a_golden_file_decode_to_the_same_floats(path):
    frames = decode(path.read_bytes())
    values = [frame["values"] for frame in decode_sequence(path.read_bytes())["frames"]]
    with np.load(path.with_suffix(".npz")) as expected:
        for number, (scene, row) in enumerate(zip(frames, values, strict=True)):
            np.testing.assert_array_equal(scene.positions[2].view("u4"), row["z"].view("u4"))
            for group in GROUPS:
                before, after = expected[f"frame {number} {group}"], getattr(scene, group)
                np.testing.assert_array_equal(after.view(np.uint32), before.view(np.uint32))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_reference_decoder_agrees_on_golden_files(path):
    values = reference_decode(path.read_bytes())["values"]
    decoded = decode_scene(path.read_bytes())
    rows = {"x": decoded.positions[0], "opacity": decoded.opacity[0], "rot_3": decoded.rot[3]}
    for name, row in rows.items():
        np.testing.assert_array_equal(values[name].view(np.uint32), row.view(np.uint32))


@pytest.mark.parametrize("name", golden_scenes())
def test_encoders_write_no_more_bytes_than_then(name):
    """Which bytes is not promised."""
    scene, config = golden_scenes()[name]
    size = (FOLDER / f"{name}.egs").stat().st_size
    assert len(encode_by(scene, config, GUIDES.get(name))) <= size


@pytest.mark.parametrize("path", SEQUENCES, ids=lambda path: path.stem)
def test_frames_take_no_more_bytes_than_then(path):
    assert len(golden_sequences()[path.stem]()) <= path.stat().st_size


@pytest.mark.parametrize("form", HOME)
def test_our_reader_agrees_with_the_formats_program(form):
    with np.load(FOLDER / f"other.{form}.npz") as planes:
        theirs = Scene(**planes)
    assert theirs.count == COUNT
    check(theirs, stored_numbers(FOLDER / f"other.{form}"), form, exact=True)


@pytest.mark.parametrize("form", HOME)
def test_writers_of_other_formats_still_write_the_same_numbers(form, tmp_path):
    """Bytes may differ with the versions of compression libraries."""
    now, golden = (
        stored_numbers(path) for path in (written(form, tmp_path), FOLDER / f"other.{form}")
    )
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(now, group), getattr(golden, group))
