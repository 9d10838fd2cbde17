"""Properties of every scene in every profile, tested with fixed hypothesis examples."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from bounds import error_over_bound
from hypothesis import given
from hypothesis import strategies as st
from reference_decoder import decode as reference_decode
from scenes import SmallBlocks, random_scene

from gs_codec.codecs import decode_part, decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.config import LOSSLESS, PROFILE_CHOICES, Config
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene

FLOATS = st.floats(width=32, allow_nan=False, allow_infinity=False)
PATTERNS = st.integers(0, (1 << 32) - 1)


@st.composite
def scenes(draw: st.DrawFn, values: st.SearchStrategy = FLOATS, most: int = 40) -> Scene:
    """A few Gaussians like those of a scene, some repeated, some with arbitrary values."""
    count = draw(st.integers(0, most))
    scene = random_scene(count, draw(st.integers(0, 3)), seed=draw(st.integers(0, 1 << 16)))
    if count and draw(st.booleans()):
        scene = scene.take(np.array(draw(st.lists(st.integers(0, count - 1), max_size=most)), int))
    places = st.tuples(st.sampled_from(GROUPS), st.integers(0, 44), st.integers(0, most), values)
    for group, row, column, value in draw(st.lists(places, max_size=6)):
        plane = getattr(scene, group)
        if plane.size:
            where = row % len(plane), column % scene.count
            if isinstance(value, int):
                plane.view(np.uint32)[where] = value
            else:
                plane[where] = value
    return scene


def config_of(profile: str, blocks: bool = True, threads: int = 1, **more: bool) -> Config:
    """Options with small blocks, or one."""
    size = 7 if blocks else 1 << 16
    return SmallBlocks(profile, extra="keep", threads=threads, block_size=size, **more)


def assert_equal(first: Scene, second: Scene) -> None:
    for group in GROUPS:
        a, b = (getattr(scene, group).view(np.uint32) for scene in (first, second))
        np.testing.assert_array_equal(a, b, err_msg=group)


@given(scene=scenes(), profile=st.sampled_from(PROFILE_CHOICES), blocks=st.booleans())
def test_decoded_values_are_within_bounds(scene, profile, blocks):
    config = config_of(profile, blocks)
    data, _ = encode_scene(scene, config)
    assert error_over_bound(scene, decode_scene(data, 1), data, config)[0] <= 1.0


@given(
    scene=scenes(),
    profile=st.sampled_from(PROFILE_CHOICES),
    normals=st.booleans(),
    comments=st.lists(st.text(st.characters(min_codepoint=32, max_codepoint=126)), max_size=3),
    kinds=st.lists(st.sampled_from(["i1", "<u2", "<i4", "<f4", "<f8"]), max_size=3),
)
def test_extra_data_round_trips(scene, profile, normals, comments, kinds):
    rng = np.random.default_rng(scene.count)
    raw = {f"p{i}": rng.bytes(scene.count * np.dtype(k).itemsize) for i, k in enumerate(kinds)}
    extra = {name: np.frombuffer(raw[name], k) for name, k in zip(raw, kinds, strict=True)}
    index = {"index": np.arange(scene.count, dtype="<i4")}
    carried = replace(
        scene, has_normals=normals, comments=tuple(comments), extra={**extra, **index}
    )
    decoded = decode_scene(encode_scene(carried, config_of(profile))[0], 1)
    assert (decoded.count, decoded.sh_degree) == (scene.count, scene.sh_degree)
    assert (decoded.has_normals, decoded.comments) == (normals, tuple(comments))
    order = decoded.extra["index"]
    assert sorted(order) == list(range(scene.count))
    for name, column in extra.items():
        assert decoded.extra[name].tobytes() == column[order].tobytes()


@given(scene=scenes(PATTERNS), keep_order=st.booleans(), blocks=st.booleans())
def test_lossless_keeps_every_bit(scene, keep_order, blocks):
    config = config_of(LOSSLESS, blocks, keep_order=keep_order)
    data, _ = encode_scene(scene, config)
    decoded = decode_scene(data, 1)
    if keep_order:
        assert_equal(decoded, scene)
    else:
        assert error_over_bound(scene, decoded, data, config)[0] == 0.0
        assert encode_scene(decoded, config)[0] == data


@given(scene=scenes(PATTERNS), seed=st.integers(0, 1 << 16))
def test_order_of_the_input_does_not_matter_to_lossless(scene, seed):
    shuffled = scene.take(np.random.default_rng(seed).permutation(scene.count))
    config = config_of(LOSSLESS)
    assert encode_scene(shuffled, config)[0] == encode_scene(scene, config)[0]


@given(scene=scenes(), profile=st.sampled_from(PROFILE_CHOICES))
def test_bytes_and_floats_are_reproducible_and_independent_of_threads(scene, profile):
    config = config_of(profile)
    data, _ = encode_scene(scene, config)
    assert encode_scene(scene, config)[0] == data
    assert encode_scene(scene, config_of(profile, threads=3))[0] == data
    assert_equal(decode_scene(data, 1), decode_scene(data, 3))


@given(
    scene=scenes(),
    profile=st.sampled_from(PROFILE_CHOICES),
    corners=st.tuples(*[st.floats(-2, 2)] * 6),
    degree=st.integers(0, 3),
)
def test_a_part_is_that_part_of_the_whole(scene, profile, corners, degree):
    box = tuple(min(corners[i], corners[i + 3]) for i in range(3))
    box += tuple(max(corners[i], corners[i + 3]) for i in range(3))
    part = Part(box, degree)
    data, _ = encode_scene(scene, config_of(profile))
    whole = decode_scene(data, 1)
    expected = with_degree(whole.take(part.contains(whole.positions)), degree)
    assert_equal(decode_part(data, part, 1)[0], expected)


@given(scene=scenes(), profile=st.sampled_from(PROFILE_CHOICES), degree=st.integers(0, 3))
def test_a_lower_degree_is_a_prefix(scene, profile, degree):
    data, _ = encode_scene(scene, config_of(profile))
    less, file = decode_part(data, Part(sh_degree=degree), 1)
    assert_equal(less, with_degree(decode_scene(data, 1), degree))
    assert file.bytes_read <= len(data)


def with_degree(scene: Scene, degree: int) -> Scene:
    kept = min(SH_COEFFICIENTS[degree], len(scene.f_rest) // 3)
    rest = scene.f_rest.reshape(3, -1, scene.count) if scene.count else scene.f_rest
    if not scene.count:
        return replace(scene, f_rest=np.zeros((3 * kept, 0), np.float32))
    return replace(scene, f_rest=rest[:, :kept].reshape(3 * kept, scene.count))


@given(scene=scenes(), profile=st.sampled_from(PROFILE_CHOICES))
def test_inspect_is_correct(scene, profile):
    data, report = encode_scene(scene, config_of(profile))
    info, decoded = inspect_bytes(data), decode_scene(data, 1)
    json.dumps(info.as_dict(), allow_nan=False)
    assert (info.count, info.sh_degree, info.profile) == (scene.count, scene.sh_degree, profile)
    assert info.file_bytes == len(data) == report.file_bytes
    assert info.file_bytes == sum(stream.bytes for stream in info.streams)
    if scene.count:
        low, high = np.array(info.bounds, np.float32)
        assert np.all(decoded.positions.min(axis=1) >= low)
        assert np.all(decoded.positions.max(axis=1) <= high)


@given(scene=scenes(most=12), profile=st.sampled_from(PROFILE_CHOICES))
def test_the_decoder_of_the_specification_agrees(scene, profile):
    """That decoder is written only from FORMAT.md."""
    data, _ = encode_scene(scene, config_of(profile))
    decoded, values = decode_scene(data, 1), reference_decode(data)["values"]
    rows = {f"f_rest_{i}": row for i, row in enumerate(decoded.f_rest)}
    rows |= {f"f_dc_{i}": decoded.f_dc[i] for i in range(3)}
    rows |= {f"scale_{i}": decoded.log_scale[i] for i in range(3)}
    rows |= {f"rot_{i}": decoded.rot[i] for i in range(4)}
    rows |= {"x": decoded.positions[0], "y": decoded.positions[1], "z": decoded.positions[2]}
    rows["opacity"] = decoded.opacity[0]
    for name, row in rows.items():
        np.testing.assert_array_equal(values[name].view(np.uint32), row.view(np.uint32), name)
