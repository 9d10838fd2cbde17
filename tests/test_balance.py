"""How far refinement prunes by default: as long as coarser steps would lose more."""

from __future__ import annotations

from dataclasses import replace

import pytest
from orbits import cameras
from requested import as_requested

from gs_codec.codecs import decode_scene
from gs_codec.config import ADAPTIVE_PROFILES, Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.balance import ADDED, Balance, profile_steps
from gs_codec.preparation.pipeline import prepare_scene
from gs_codec.preparation.view_selection import choose_views
from gs_codec.rate.allocate import step_error_for
from gs_codec.scene import Scene
from samples.generate import generate


@pytest.fixture(scope="module")
def seen() -> tuple[Scene, Plan]:
    return generate(1200, 1, 6), Plan(Steps(refine=1), cameras(9))


def left(scene: Scene, plan: Plan, error: float | None = None) -> int:
    known = None if error is None else lambda views: lambda size, lost: error
    return prepare_scene(scene, plan, None, known)[0].count


@pytest.mark.thorough
def test_coarser_steps_leave_fewer_gaussians(seen):
    scene, plan = seen
    counts = [left(scene, plan, error) for error in (0.0, 1e-4, 1e-2)]
    assert counts[0] > counts[1] > counts[2] > 0
    assert left(scene, plan) == left(scene, plan, ADAPTIVE_PROFILES["m"].error)


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    "steps", [{"prune": 0}, {"prune": 10}, {"prune_importance": 10}, {"prune_max_psnr_drop": 0.0}]
)
def test_the_requested_number_is_pruned(seen, steps):
    scene, plan = seen
    asked = Steps(refine=1, **steps)
    assert not asked.balanced
    expected = prepare_scene(scene, replace(plan, steps=replace(asked, refine=0)))[0].count
    assert left(scene, replace(plan, steps=asked), 1e-2) == expected


def test_nothing_is_pruned_without_refinement():
    assert not Steps(compact_sh=1e-5).balanced
    assert not Steps(prune=0).wanted


def test_rounds_are_compared_with_the_previous_one(seen):
    scene, plan = seen
    renders = choose_views(scene, plan).renders.evenly(16)
    half = scene.take(range(0, scene.count, 2))
    sizes: list[tuple[float, float]] = []

    def step_error(size: float, lost: float) -> float:
        sizes.append((size, lost))
        return 0.0

    balance = Balance(scene, renders, False, 500, step_error)
    assert not balance.pays(half)
    assert balance.pays(half)  # Neither costs nor saves anything.
    assert sizes[0] == sizes[1]
    assert 0.4 < sizes[0][0] < 0.7
    assert sizes[0][1] == pytest.approx(0.13 * renders.error(half))
    # Photographs have information that renders of the input lack.
    assert not Balance(scene, renders, True, 500, step_error).pays(half)
    assert sizes[2][1] == pytest.approx(0.07 * renders.error(half))
    # Many iterations recover more, few recover little.
    assert not Balance(scene, renders, True, 16000, step_error).pays(half)
    assert sizes[3][1] == pytest.approx(0.0175 * renders.error(half))
    assert not Balance(scene, renders, True, 1, step_error).pays(half)
    assert 0.8 * renders.error(half) < sizes[4][1] <= renders.error(half)


@pytest.mark.parametrize(("factor", "pays"), [(1.01, True), (0.99, False)])
def test_a_round_must_add_less_error_than_steps_that_save_as_much(seen, factor, pays):
    scene, plan = seen
    renders = choose_views(scene, plan).renders.evenly(16)
    half = scene.take(range(0, scene.count, 2))
    limit = 0.13 * renders.error(half)

    def step_error(size: float, lost: float) -> float:
        # Without the round, the same file takes an error that is larger by this factor.
        return factor * limit / (size**-4.4 - 1) / ADDED

    assert Balance(scene, renders, False, 500, step_error).pays(half) is pays


@pytest.mark.thorough
def test_targets_choose_the_number_of_gaussians(seen):
    scene, plan = seen
    counts = []
    for bits in (60, 25):
        data, report = as_requested(scene, Config(), plan, RateTarget(bits=bits))
        assert 0.98 * bits * scene.count <= 8 * len(data) <= bits * scene.count
        assert decode_scene(data).count == report.count
        counts.append(report.count)
    assert scene.count > counts[0] > counts[1]


@pytest.mark.thorough
def test_profiles_choose_the_number_of_gaussians(seen):
    scene, plan = seen
    counts = [as_requested(scene, Config(p), plan)[1].count for p in ("l", "s")]
    assert scene.count >= counts[0] > counts[1]


def test_error_of_the_steps_of_a_size(seen):
    scene, plan = seen
    views = choose_views(scene, plan)
    found = [step_error_for(scene, 1, Config(), RateTarget(bits=bits), views) for bits in (60, 30)]
    # Coarser for a smaller file; finer once Gaussians are removed.
    assert found[1](1.0, 0.0) > found[0](1.0, 0.0) == pytest.approx(found[1](0.5, 0.0))


def test_error_of_the_steps_of_a_size_without_reliable_cameras(seen):
    scene, plan = seen
    views = choose_views(scene, plan)
    guided, *blind = (
        step_error_for(scene, 1, Config(), RateTarget(bits=60), views._replace(renders=renders))
        for renders in (
            views.renders,
            replace(views.renders, origin="anywhere"),
            replace(views.renders.first(1), origin="anywhere"),
        )
    )
    assert blind[0](1.0, 0.0) == blind[1](1.0, 0.0) > guided(1.0, 0.0)


def test_error_of_the_steps_of_a_loss(seen):
    scene, plan = seen
    views = choose_views(scene, plan)
    found = step_error_for(scene, 1, Config(), RateTarget(psnr_drop=0.1), views)
    whole = views.renders.error_for(0.1, 0.0)
    assert found(1.0, 0.0) == pytest.approx(4 * whole)
    assert found(1.0, whole / 2) == pytest.approx(2 * whole)
    assert found(1.0, 2 * whole) == 0.0


def test_profiles_without_steps_prune_like_the_default():
    for profile, like in (("lossless", "m"), ("l", "l")):
        assert profile_steps(Config(profile))(None)(1.0, 0.0) == ADAPTIVE_PROFILES[like].error


def test_pruning_twice_is_refused(seen):
    scene, plan = seen
    target = RateTarget(bits=60, allow_prune=True)
    with pytest.raises(InvalidInput, match="not needed with refine"):
        as_requested(scene, Config(), plan, target)
