"""Joint rounding: values move to levels whose errors cancel in the views."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from orbits import cameras, orbit, visible_scene
from requested import as_requested
from scenes import made_up_guide, random_scene

from gs_codec.codecs import decode_scene
from gs_codec.codecs.adaptive.encode import code_shaped, shape_scene
from gs_codec.codecs.adaptive.lattice import far_among
from gs_codec.codecs.adaptive.shaped import ShapedScene
from gs_codec.coding.ycocg import to_ycocg
from gs_codec.config import Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.guidance import joint_rounding
from gs_codec.guidance.joint_rounding import round_jointly
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.reference_views import ReferenceViews, draw_reference_views
from gs_codec.report import StageTimes
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene
from samples.generate import generate

BLOCK = 1024


def shaped_by(scene: Scene, seed: int = 0) -> ShapedScene:
    config = Config("s", block_size=BLOCK)
    return shape_scene(scene, config, made_up_guide(seed)(scene, config), StageTimes())


def coded(shaped: ShapedScene) -> bytes:
    return b"".join(code_shaped(shaped, StageTimes())[0])


@pytest.mark.parametrize("count", [1, 1500])
def test_decoded_sh_dc_is_known_before_coding(count):
    shaped = shaped_by(random_scene(count, 1, seed=501))
    np.testing.assert_array_equal(shaped.decoded_dc(), decode_scene(coded(shaped)).f_dc)


def test_values_are_within_half_a_step_of_their_levels():
    scene = random_scene(1500, 0, seed=502)
    shaped = shaped_by(scene)
    source, decoded = scene.take(shaped.order), shaped.decoded()
    steps = shaped.value_steps()
    assert steps.shape == (13, 1500)
    scales = np.sort(source.log_scale, axis=0)[::-1]
    dc, coded_dc = to_ycocg(source.f_dc), to_ycocg(shaped.decoded_dc())
    pairs = [
        (source.positions, decoded.positions, steps[:3]),
        (dc, coded_dc, steps[3:6]),
        (source.opacity, decoded.opacity, steps[6:7]),
        (scales, decoded.log_scale, steps[7:10]),
    ]
    for before, after, step in pairs:
        off = np.abs(after - before) / step
        assert off.max() < 0.501
        assert np.quantile(off, 0.9) > 0.4


def test_far_gaussians_have_no_position_steps():
    scene = random_scene(1500, 0, seed=503)
    scene.positions[:, ::300] *= 1e5
    shaped = shaped_by(scene)
    number = far_among(shaped.arranged.codes, shaped.arranged.lattice.grid)
    assert number == 5
    assert np.count_nonzero(shaped.value_steps()[:3].max(axis=0) == 0) == 5


def test_a_changed_source_keeps_lattices_and_classes():
    scene = random_scene(1500, 1, seed=504)
    shaped = shaped_by(scene)
    same = shaped.reshaped(scene)
    assert coded(same) == coded(shaped)
    mirrored = replace(scene, positions=-scene.positions)
    other = shaped.reshaped(mirrored)
    assert other.arranged.lattice is shaped.arranged.lattice
    for one in (shaped, other):
        classes = np.empty_like(one.arranged.classes)
        classes[:, one.order] = one.arranged.classes
        if one is shaped:
            expected = classes
    np.testing.assert_array_equal(classes, expected)


HALF_TURNS = np.eye(4)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    w, x, y, z = a
    p, q, r, s = b
    return np.array(
        [
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        ]
    )


@pytest.mark.parametrize("half_turn", range(4))
def test_turns_are_about_the_axes_of_the_source_despite_half_turns(half_turn):
    rng = np.random.default_rng(half_turn)
    own = rng.normal(size=4)
    own /= np.linalg.norm(own)
    decoded = product(own, HALF_TURNS[half_turn])
    row = rng.normal(size=(1, 14)).astype(np.float32)
    slopes = np.zeros((1, 13), np.float32)
    joint_rounding._add(
        row, np.array([0]), 0, decoded[:, None].astype(np.float32),
        own[:, None].astype(np.float32), slopes,
    )  # fmt: skip
    np.testing.assert_array_equal(slopes[0, :10], row[0, :10])
    for axis in range(3):
        turned = product(own, np.insert(np.eye(3)[axis] / 2, 0, 0.0))
        along = product(turned, HALF_TURNS[half_turn]) @ row[0, 10:]
        assert slopes[0, 10 + axis] == pytest.approx(along, abs=1e-6)


def test_derivatives_that_overflow_move_nothing():
    slopes = np.array([[np.inf, -np.inf, np.nan, 1e30, *[1.0] * 9]], np.float32)
    steps = np.ones((1, 13), np.float32)
    first, second, moved = np.zeros((3, 1, 13), np.float32)
    planes = [np.zeros((rows, 1), np.float32) for rows in (3, 3, 1, 3, 4)]
    one = np.float32(1.0)
    joint_rounding._move(
        slopes, steps, 0, first, second, moved, one, one, one, *planes,
    )  # fmt: skip
    after = np.concatenate([plane[:, 0] for plane in planes[:4]])
    assert not after[:4].any()
    assert np.all(after[4:] < 0)
    np.testing.assert_array_equal(moved[0, :10], after)


@cache
def rounded() -> tuple[ShapedScene, ShapedScene, ReferenceViews]:
    scene = visible_scene(1200, 505, sh_degree=1)
    views = draw_reference_views(scene, orbit(12, 505), (0.0, 0.0, 0.0))
    shaped = shaped_by(scene)
    error = views.error(decode_scene(coded(shaped))) * 12 * 40 * 40 * 3 / (scene.count * 23)
    return shaped, round_jointly(shaped, views, error, 96), views


def test_errors_cancel_in_the_views():
    plain, joint, views = rounded()
    before, after = (coded(shaped) for shaped in (plain, joint))
    assert views.error(decode_scene(after)) < 0.85 * views.error(decode_scene(before))
    assert len(after) < 1.01 * len(before)


def test_held_out_views_gain_too():
    plain, joint, _ = rounded()
    others = draw_reference_views(plain.source, orbit(6, 506), (0.0, 0.0, 0.0))
    before, after = (others.error(decode_scene(coded(shaped))) for shaped in (plain, joint))
    assert after < 0.95 * before


def test_sh_ac_stay():
    plain, joint, _ = rounded()
    np.testing.assert_array_equal(joint.source.f_rest, plain.source.f_rest)
    assert np.any(joint.source.f_dc != plain.source.f_dc)


def test_threads_do_not_change_the_result():
    plain, _, views = rounded()
    found = set()
    for threads in (1, 3):
        with using_threads(threads):
            found.add(coded(round_jointly(plain, views, 1e-3, 10)))
    assert len(found) == 1


GENERATED = generate(1500, 1, 507)
PLAN = Plan(Steps(), cameras(8))


def test_effort_sets_how_long_values_are_rounded():
    fast, normal, high = (
        Config("m", effort=effort).adaptive_profile() for effort in ("fast", "normal", "high")
    )
    assert fast.looks == 0 < normal.looks < high.looks
    assert fast.left == 1 > normal.left > high.left
    assert fast.error == normal.error == high.error
    seconds = {
        effort: as_requested(GENERATED, Config("m", effort=effort), PLAN)[1].seconds["round"]
        for effort in ("fast", "normal")
    }
    assert seconds["fast"] < 0.01 < seconds["normal"]


def test_a_file_rounded_jointly_is_within_its_target():
    for target in (RateTarget(ratio=25), RateTarget(psnr_drop=0.3)):
        data, report = as_requested(GENERATED, Config("m"), PLAN, target, GENERATED.float_bytes)
        assert report.rate is not None
        if target.ratio:
            assert GENERATED.float_bytes / len(data) >= 25
            assert GENERATED.float_bytes / len(data) < 25 * 1.03
        else:
            assert report.rate.psnr_drop <= 0.3


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"profile": "lossless", "effort": "fast"}, "effort: profile 'lossless' has none, l, m, s"),
        ({"profile": "paper-m", "effort": "high"}, "effort: profile 'paper-m'"),
        (
            {"format": "splat", "effort": "fast"},
            "effort: format 'splat', expected .egs, .spz, ",
        ),
    ],
)
def test_effort_without_effect_is_refused(config, message):
    with pytest.raises(InvalidInput, match=message):
        Config(**config)


def test_much_effort_needs_cameras():
    with pytest.raises(
        InvalidInput, match=r"effort 'high': has no effect on an \.egs without cameras"
    ):
        as_requested(GENERATED, Config("m", effort="high"), None)
