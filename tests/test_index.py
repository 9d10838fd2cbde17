"""The index: boxes of centres and of ellipsoids, with every profile."""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from damage import with_section
from scenes import any_bits, edge_scenes, random_scene

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.coding.extent import _POWERS, block_extent, centre_box
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.egs.index import index_of
from gs_codec.errors import CorruptStream
from gs_codec.scene import Scene

BLOCK = 1024
LARGEST = np.finfo(np.float32).max


@cache
def blocks(profile: str) -> bytes:
    return encode_scene(random_scene(2500, 1, seed=310), Config(profile, block_size=BLOCK))[0]


@cache
def small(profile: str) -> bytes:
    return encode_scene(random_scene(20, 0, seed=311), Config(profile))[0]


def directions(number: int, seed: int) -> np.ndarray:
    points = np.random.default_rng(seed).normal(size=(number, 3))
    return points / np.linalg.norm(points, axis=1)[:, None]


def surfaces(scene: Scene, number: int, seed: int) -> np.ndarray:
    """Points on the ellipsoids at 3 sigma, ``(number, N, 3)``, by independent formulas."""
    w, x, y, z = scene.rot.astype(np.float64) / np.linalg.norm(scene.rot.astype(np.float64), axis=0)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    scale = 3 * np.exp(scene.log_scale.astype(np.float64))
    offsets = np.einsum("akn,kn,dk->dna", rotation, scale, directions(number, seed))
    return scene.positions.T.astype(np.float64) + offsets


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_boxes_contain_the_decoded_gaussians(profile):
    scene, file = decode_scene(blocks(profile)), read_file(blocks(profile))
    extents = index_of(file)
    assert len(extents) == 3
    for block, extent in enumerate(extents):
        own = scene.between(*file.header.block_range(block))
        ends = own.positions.min(axis=1), own.positions.max(axis=1)
        np.testing.assert_array_equal(extent[:6], np.concatenate(ends))
        points = surfaces(own, 200, seed=312)
        assert (points.min(axis=(0, 1)) >= extent[6:9]).all()
        assert (points.max(axis=(0, 1)) <= extent[9:]).all()


@pytest.mark.thorough
def test_boxes_are_slightly_larger_than_the_ellipsoids():
    scene = random_scene(400, 0, seed=313)
    for k in range(scene.count):
        one = scene.take(np.array([k]))
        extent = block_extent(one.positions, one.log_scale, one.rot).astype(np.float64)
        points = surfaces(one, 4000, seed=314)
        reached = points.max(axis=(0, 1)) - one.positions[:, 0]
        half = (extent[9:] - extent[6:9]) / 2
        assert (half >= reached).all()
        assert (half <= 1.25 * reached).all()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", edge_scenes())
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_edge_scenes_have_an_index(profile, name):
    data = encode_scene(edge_scenes()[name], Config(profile))[0]
    extents = index_of(read_file(data))
    assert np.isfinite(extents).all()
    assert ((SectionId.INDEX, 0) in read_file(data).table) == bool(len(extents))
    assert (inspect_bytes(data).bounds is None) == (not len(extents))


def test_powers_are_rounded_up():
    for i, power in enumerate(_POWERS.tolist()):
        before = np.nextafter(power, 0)
        assert int(power * 2**52) ** 8 >= 2 ** (52 * 8 + i)
        assert i == 0 or int(before * 2**53) ** 8 < 2 ** (53 * 8 + i)


@pytest.mark.parametrize(
    ("log_scale", "most"),
    [(-3e38, 1e-30), (-100.0, 1e-40), (0.0, 3.3), (88.0, LARGEST), (3e38, LARGEST)],
)
def test_boxes_of_any_scale_are_valid(log_scale, most):
    scale = np.full((3, 1), log_scale, np.float32)
    extent = block_extent(np.zeros((3, 1), np.float32), scale, np.eye(4, 1, dtype=np.float32))
    assert (extent[9:] > 0).all()
    assert (extent[9:] <= max(most, 1e-44)).all()
    np.testing.assert_array_equal(extent[6:9], -extent[9:])


def test_zero_quaternions_get_the_largest_extent():
    scale = np.log(np.array([[1.0], [2.0], [4.0]], np.float32))
    extent = block_extent(np.zeros((3, 1), np.float32), scale, np.zeros((4, 1), np.float32))
    assert (extent[9:] >= 12).all()


def test_nonfinite_values_are_ignored():
    scene = any_bits(300, 0, 315)
    extent = block_extent(scene.positions, scene.log_scale, scene.rot)
    assert np.isfinite(extent).all()
    for axis, row in enumerate(scene.positions):
        finite = row[np.isfinite(row)]
        assert (extent[axis], extent[3 + axis]) == (finite.min(), finite.max())
    nowhere = np.full((3, 2), np.nan, np.float32)
    assert centre_box(nowhere).tobytes() == bytes(24)
    zeros = np.array([[-0.0, 0.0]] * 3, np.float32)
    assert centre_box(zeros).tobytes() == centre_box(-zeros).tobytes() == bytes(24)


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_an_index_that_is_not_of_the_blocks_is_refused(profile, number):
    def change(content: bytes) -> bytes:
        values = np.frombuffer(content, "<f4").copy()
        values[number] = np.nextafter(values[number], np.float32(-9 if number < 3 else 9))
        values[6:] = [*values[6:9] - 1, *values[9:] + 1]
        return values.tobytes()

    with pytest.raises(CorruptStream, match="section 'index': does not match block 0"):
        decode_scene(with_section(small(profile), SectionId.INDEX, change))


def test_a_negative_zero_is_refused():
    scene = random_scene(20, 0, seed=316)
    flat = replace(scene, positions=scene.positions * np.float32([[0], [1], [1]]))
    data = encode_scene(flat, Config("lossless"))[0]
    data = with_section(data, SectionId.INDEX, lambda good: struct.pack("<f", -0.0) + good[4:])
    with pytest.raises(CorruptStream, match="section 'index': does not match block 0"):
        decode_scene(data)


def replaced(number: int, value: float):
    return lambda good: good[: 4 * number] + struct.pack("<f", value) + good[4 * number + 4 :]


DAMAGE = {
    "short": (lambda good: good[:-4], "44 bytes, expected 48"),
    "twice": (lambda good: good * 2, "96 bytes, expected 48"),
    "empty": (lambda _: b"", "0 bytes, expected 48"),
    "turned": (lambda good: good[12:24] + good[:12] + good[24:], "no boxes of block 0"),
    "reach turned": (lambda good: good[:24] + good[36:] + good[24:36], "no boxes of block 0"),
    "reach within": (replaced(6, 0.0), "no boxes of block 0"),
    **{f"NaN {i}": (replaced(i, np.nan), "no boxes of block 0") for i in range(12)},
    **{f"infinite {i}": (replaced(i, np.inf), "no boxes of block 0") for i in (3, 11)},
    "missing": (lambda _: None, "missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGE)
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
def test_a_damaged_index_is_refused(profile, name):
    change, message = DAMAGE[name]
    data = with_section(small(profile), SectionId.INDEX, change)
    for read in (decode_scene, inspect_bytes):
        with pytest.raises(CorruptStream, match=f"section 'index'.*(?:{message})"):
            read(data)


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_an_index_of_nothing_is_refused(profile):
    data = encode_scene(random_scene(0), Config(profile))[0]
    with pytest.raises(CorruptStream, match="section 'index' of block 0: empty"):
        decode_scene(with_section(data, SectionId.INDEX, lambda _: b""))


def test_index_does_not_depend_on_threads():
    scene = random_scene(5000, 1, seed=317)
    for profile in ("s", "paper-s", "lossless"):
        found = [
            read_file(encode_scene(scene, Config(profile, threads=t, block_size=BLOCK))[0])
            for t in (1, 3)
        ]
        assert found[0].section(SectionId.INDEX) == found[1].section(SectionId.INDEX)
