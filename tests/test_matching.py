"""Which of two scenes was decoded from the other, and which Gaussians correspond."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.codecs.matching import put_side_by_side
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.errors import InvalidInput
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import compare_files, read_scene
from gs_codec.formats.ply.writer import write_ply


@pytest.fixture(scope="module")
def decoded(tmp_path_factory):
    """A scene with numbered Gaussians, and its decoded version in each profile."""
    folder = tmp_path_factory.mktemp("decoded")
    scene = random_scene(1500, 1, seed=220)
    write_ply(folder / "scene.ply", replace(scene, extra={"label": np.arange(1500, dtype="<i4")}))
    for profile in PROFILE_CHOICES:
        egs = folder / f"{profile}.egs"
        encode_file(folder / "scene.ply", egs, Config(profile, extra="keep"))
        decode_file(egs, folder / f"{profile}.ply")
    return folder


@pytest.mark.one_in(4)
@pytest.mark.parametrize(("first", "again"), [*product(PROFILE_CHOICES, repeat=2)])
def test_a_decoded_scene_is_matched_with_its_own_encoding(decoded, tmp_path, first, again):
    source, target = decoded / f"{first}.ply", tmp_path / "again.egs"
    encode_file(source, target, Config(again, extra="keep"))
    scenes = [read_scene(source, "keep"), read_scene(target)]
    for pair in (scenes, scenes[::-1]):
        one, other, _ = put_side_by_side(*pair)
        np.testing.assert_array_equal(one.extra["label"], other.extra["label"])
    assert compare_files(source, target).counts == (1500, 1500)


def test_copies_and_edge_scenes_are_matched_or_refused():
    scene = random_scene(400, 1, seed=230)
    order = np.random.default_rng(231).permutation(400)
    copies = scene.take(np.arange(400) // 4)
    one, other, _ = put_side_by_side(copies, copies.take(order))
    np.testing.assert_array_equal(one.f_dc, other.f_dc)
    alike = scene.take(np.zeros(400, int))
    recoloured = replace(alike, f_dc=alike.f_dc + np.float32(0.1))
    assert put_side_by_side(alike, recoloured)[2] == "index"
    # Centres do not identify coincident Gaussians.
    place = replace(scene, positions=np.zeros_like(scene.positions))
    for first, second in ((place, place.take(order)), (scene, random_scene(400, 1, seed=232))):
        with pytest.raises(InvalidInput, match="Gaussians of the scenes do not match"):
            put_side_by_side(first, second)
    for value in (np.nan, np.inf, 3e38):
        broken = replace(scene, positions=scene.positions.copy(), rot=scene.rot.copy())
        broken.positions[:, :9], broken.rot[:, 5:20] = value, value
        one, other, _ = put_side_by_side(broken, broken.take(order))
        np.testing.assert_array_equal(one.f_dc[:, 9:], other.f_dc[:, 9:])


def test_other_decoded_scenes_are_not_matched(decoded, tmp_path):
    write_ply(tmp_path / "other.ply", random_scene(1500, 1, seed=221))
    encode_file(tmp_path / "other.ply", tmp_path / "other.egs", Config("paper-m"))
    decode_file(tmp_path / "other.egs", tmp_path / "decoded.ply")
    encode_file(tmp_path / "decoded.ply", tmp_path / "again.egs", Config("m"))
    with pytest.raises(InvalidInput, match="Gaussians of the scenes do not match"):
        compare_files(decoded / "paper-m.egs", tmp_path / "again.egs")


@pytest.mark.parametrize(("first", "second"), [
    ("l", "m"), ("m", "s"), ("l", "paper-l"), ("s", "lossless"), ("paper-l", "paper-s"),
])  # fmt: skip
def test_scenes_decoded_from_the_same_are_matched_by_the_nearest(decoded, first, second):
    for pair in ((first, second), (second, first)):
        scenes = [read_scene(decoded / f"{name}.egs", "keep") for name in pair]
        one, other, matched_by = put_side_by_side(*scenes)
        # By index if both grids happen to give the same order.
        assert matched_by in ("index", "nearest centre")
        assert np.mean(one.extra["label"] == other.extra["label"]) > 0.99
