"""Scene to stream and back: error bounds, order, determinism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import (
    DAMAGE,
    REAL_SCENES,
    assert_same_floats,
    edge_scenes,
    random_scene,
    shared_scene_path,
)

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.entropygs.symbols import order_like
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import PROFILES, Config
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.scene import GROUPS, Scene

EDGES = edge_scenes()


def assert_within_half_steps(original: Scene, data: bytes) -> Scene:
    """Every value is within half a step (plus float32 rounding) of the quantised one.

    SH-AC beyond the Laplace range are compared after rectification.
    """
    decoded, channels = decode_scene(data), inspect_bytes(data).channels
    assert decoded.count == original.count
    original = original.take(order_like(original, [c.quantiser for c in channels[:6]]))
    for channel in channels:
        values = getattr(original, channel.group)[channel.index].astype(np.float64)
        result = getattr(decoded, channel.group)[channel.index].astype(np.float64)
        quantiser = channel.quantiser
        if quantiser.kind == "centred":
            reach = quantiser.half_range
            values = values.clip(quantiser.centre - reach, quantiser.centre + reach)
        error = np.abs(values - result).max(initial=0.0)
        rounding = np.spacing(np.abs(values).max(initial=0.0).astype(np.float32))
        assert error <= quantiser.step * 0.5000001 + rounding, channel.name
    return decoded


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("name", EDGES)
def test_edge_scene_is_within_half_steps(name, profile):
    data, report = encode_scene(EDGES[name], Config(profile))
    assert_within_half_steps(EDGES[name], data)
    assert report.file_bytes == len(data)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("profile", PROFILES)
def test_blocks_and_degrees_are_within_half_steps(profile, sh_degree):
    scene = random_scene(5000, sh_degree, seed=sh_degree)
    data, _ = encode_scene(scene, Config(profile, block_size=1024))
    assert inspect_bytes(data).blocks == 5
    assert assert_within_half_steps(scene, data).sh_degree == sh_degree


@pytest.mark.one_in(4)
@pytest.mark.parametrize("name", REAL_SCENES)
def test_real_scene_is_within_half_steps(name):
    scene = read_ply(shared_scene_path(name))
    data, report = encode_scene(scene, Config("paper-m"))
    decoded = assert_within_half_steps(scene, data)
    assert decoded.has_normals == scene.has_normals
    f_rest_values = max(scene.f_rest.size, 1)
    assert report.rectified / f_rest_values < 0.005


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("models", "overhead"), [("parametric", 0.015), ("best", 0.0015)])
def test_bonsai_is_ten_times_smaller_and_close_to_its_entropy(models, overhead):
    path = shared_scene_path("bonsai/point_cloud.ply")
    data, report = encode_scene(read_ply(path), Config("paper-m", models=models))
    assert report.count == 199_831
    assert path.stat().st_size / len(data) >= 10
    entropy = sum(cost.shannon_bits for cost in report.costs)
    streams = {cost.stream for cost in report.costs} | {"states", "channels"}
    coded = 8 * sum(report.section_bytes[name] for name in streams)
    assert coded <= (1 + overhead) * entropy


@pytest.mark.parametrize("depths", [{"sh-ac": 1}, {"rotation": 1, "opacity": 12}, {"geometry": 21}])
def test_depths_override_the_profile(depths):
    scene = random_scene(2000, 3, seed=3)
    data, _ = encode_scene(scene, Config("paper-s", depths))
    assert_within_half_steps(scene, data)
    used = {c.stream: c.quantiser.depth for c in inspect_bytes(data).channels}
    expected = Config("paper-s", depths).resolved_depths()
    assert used == expected


def test_extremes_decode_exactly():
    scene = random_scene(3000, 0, seed=4)
    decoded = decode_scene(encode_scene(scene, Config("paper-m"))[0])
    for group in ("positions", "f_dc", "opacity", "log_scale", "rot"):
        for before, after in zip(getattr(scene, group), getattr(decoded, group), strict=True):
            assert before.min() == after.min()
            assert before.max() == after.max()


@pytest.mark.parametrize("profile", PROFILES)
def test_recoding_a_decoded_scene_changes_only_sh_ac(profile):
    scene = random_scene(3000, 0, seed=5)
    once = decode_scene(encode_scene(scene, Config(profile))[0])
    twice = decode_scene(encode_scene(once, Config(profile))[0])
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(once, group), getattr(twice, group))


def test_bytes_and_floats_do_not_depend_on_threads():
    scene = random_scene(9000, 3, seed=6)
    streams = [
        encode_scene(scene, Config("paper-m", threads=t, block_size=1024))[0] for t in (1, 2, 7)
    ]
    assert streams[0] == streams[1] == streams[2]
    decoded = [decode_scene(streams[0], threads=t) for t in (1, 2, 7)]
    assert_same_floats(decoded[0], decoded[1])
    assert_same_floats(decoded[0], decoded[2])


def test_order_of_the_input_does_not_matter():
    scene = random_scene(4000, 1, seed=7)
    shuffled = scene.take(np.random.default_rng(7).permutation(scene.count))
    assert encode_scene(scene, Config("paper-m"))[0] == encode_scene(shuffled, Config("paper-m"))[0]


def test_no_argument_is_changed():
    scene = random_scene(1000, 3, seed=8)
    scene.rot[:, 0] = 0
    before = {group: getattr(scene, group).copy() for group in GROUPS}
    encode_scene(scene, Config("paper-m"))
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(scene, group), before[group])


def test_duplicates_keep_their_own_attributes():
    scene = random_scene(600, 3, seed=9)
    positions = np.repeat(scene.positions[:, :200], 3, axis=1)
    f_dc = np.repeat(scene.f_dc[:, :200], 3, axis=1)
    scene = replace(scene, positions=positions, f_dc=f_dc)
    assert_within_half_steps(scene, encode_scene(scene, Config("paper-m"))[0])


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("group", "value"), DAMAGE)
def test_nonfinite_values_are_refused_or_dropped(group, value):
    scene = random_scene(50, 3, seed=10)
    getattr(scene, group)[0, [3, 17]] = value
    with pytest.raises(InvalidInput, match=f"2 in {group}"):
        encode_scene(scene, Config("paper-m"))
    data, report = encode_scene(scene, Config("paper-m", nonfinite="drop"))
    assert report.dropped == 2
    assert_within_half_steps(scene.take(np.delete(np.arange(50), [3, 17])), data)


def test_zero_quaternions_become_the_identity():
    scene = random_scene(50, 0, seed=11)
    scene.rot[:, [4, 9]] = 0
    data, report = encode_scene(scene, Config("paper-m"))
    assert report.zero_quaternions == 2
    scene.rot[0, [4, 9]] = 1
    assert_within_half_steps(scene, data)


def test_absent_bands_and_constant_channels_cost_a_flag():
    flat = random_scene(2000, 3, seed=12)
    flat = replace(flat, f_rest=np.full_like(flat.f_rest, 0.5))
    flat = replace(flat, opacity=np.full_like(flat.opacity, 2), rot=np.ones_like(flat.rot))
    report = encode_scene(flat, Config("paper-m"))[1]
    assert {"sh1", "sh2", "sh3", "opacity", "rotation"}.isdisjoint(report.section_bytes)
    without = encode_scene(replace(flat, f_rest=flat.f_rest[:0]), Config("paper-m"))[1]
    assert report.section_bytes["channels"] - without.section_bytes["channels"] in (224, 228)


def test_extra_properties_and_comments_stay_with_their_gaussians():
    scene = random_scene(300, 0, seed=13)
    extra = {"label": np.arange(300, dtype="<i4"), "weight": scene.positions[0].astype("<f8")}
    scene = replace(scene, extra=extra, comments=("made by a test", ""), has_normals=True)
    decoded = decode_scene(encode_scene(scene, Config("paper-m", depths={"geometry": 21}))[0])
    assert decoded.comments == scene.comments
    assert decoded.has_normals
    np.testing.assert_array_equal(decoded.extra["weight"], extra["weight"][decoded.extra["label"]])
    np.testing.assert_allclose(decoded.positions[0], decoded.extra["weight"], atol=1e-5)


def test_decoder_refuses_scenes_above_the_size_limit():
    data, _ = encode_scene(random_scene(1000, 3, seed=14))
    with pytest.raises(CorruptStream, match="the limit is 1,000"):
        decode_scene(data, max_bytes=1000)


def test_progress_reaches_the_total_of_every_stage():
    seen = {}
    scene = random_scene(3000, 1, seed=15)

    def progress(stage, done, total):
        assert done == seen.get(stage, (0, total))[0] + 1
        seen[stage] = (done, total)

    data, _ = encode_scene(scene, Config("paper-m", block_size=1024), progress)
    decode_scene(data, progress=progress)
    assert seen == {"quantise": (17, 17), "code": (9, 9), "decode": (6, 6)}
