"""When the viewer renders pictures, and at what resolution."""

from __future__ import annotations

import pytest

from viewer.window.pace import FULL, REST, Pace, Step


@pytest.fixture
def pace() -> Pace:
    """The pace of an idle scene that renders fully in 0.2 seconds."""
    pace = Pace()
    pace.put(200_000)
    pace.move(0.0)
    draw(pace, 0.0, 0.05)
    draw(pace, 1.0, 0.2)
    assert pace.resting
    return pace


def draw(pace: Pace, now: float, seconds: float) -> Step:
    """Render what is due next."""
    step = pace.next(now)
    assert step is not None
    assert pace.next(now) is None  # one at a time
    pace.done(step, seconds)
    return step


def drafts(pace: Pace, seconds: float, count: int = 20) -> list[Step]:
    """Drafts that each take this long."""
    found = []
    for k in range(count):
        pace.move(float(k))
        found.append(draw(pace, float(k), seconds))
    return found


def test_nothing_is_drawn_at_rest(pace):
    assert pace.next(100.0) is None
    assert Pace().next(0.0) is None
    assert Pace().resting


def test_a_draft_is_finished_during_a_move_and_the_next_one_follows(pace):
    pace.move(10.0)
    first = pace.next(10.0)
    assert not first.full
    for k in range(50):
        pace.move(10.0 + k / 100)
        assert pace.next(10.0 + k / 100) is None
    pace.done(first, 0.05)
    second = pace.next(10.5)
    assert not second.full
    pace.done(second, 0.05)
    assert pace.next(10.5) is None  # it has not moved since
    assert not pace.resting


def test_the_full_picture_follows_after_a_pause(pace):
    pace.move(10.0)
    assert not draw(pace, 10.0, 0.05).full
    assert pace.next(10.0 + 0.9 * REST) is None
    assert draw(pace, 10.0 + 1.1 * REST, 0.2) is FULL
    assert pace.resting
    assert pace.next(20.0) is None


def test_the_full_picture_follows_at_once_after_release(pace):
    pace.move(10.0)
    draft = pace.next(10.0)
    pace.move(10.01)
    pace.rest()
    assert pace.next(10.02) is None
    pace.done(draft, 0.05)
    assert draw(pace, 10.05, 0.2) is FULL


def test_a_full_picture_that_takes_long_has_a_draft_before_it(pace):
    pace.move(10.0)
    pace.rest()
    assert draw(pace, 10.0, 0.9) is FULL
    pace.move(20.0)
    pace.rest()
    assert not draw(pace, 20.0, 0.05).full
    assert draw(pace, 20.1, 0.9) is FULL


def test_a_move_does_not_wait_for_a_full_picture(pace):
    pace.move(10.0)
    pace.rest()
    assert pace.next(10.0) is FULL
    pace.move(10.1)
    draft = pace.next(10.1)
    assert not draft.full
    pace.done(draft, 0.05)
    assert draw(pace, 11.0, 0.2) is FULL
    assert pace.resting


def test_a_dropped_picture_makes_way(pace):
    pace.move(10.0)
    assert pace.next(10.0) is not None
    pace.drop()
    pace.move(10.1)
    assert pace.next(10.1) is not None


def test_slow_drafts_become_coarser_and_quick_ones_finer(pace):
    first = drafts(pace, 1.0)
    work = [1 / (step.shrink**2 * step.every) for step in first]
    assert work == sorted(work, reverse=True)
    assert first[-1] == Step(6, 4)  # 50,000 Gaussians
    assert drafts(pace, 0.05)[-1] == first[-1]
    later = drafts(pace, 0.01, 40)
    assert later[-1] == Step(1, 1)
    assert {*first} == {*later} - {Step(1, 1)}


def test_one_slow_draft_among_others_changes_nothing(pace):
    steps = [step for k in range(10) for step in drafts(pace, 1.0 if k % 2 else 0.05, 1)]
    assert len({*steps}) == 1


@pytest.mark.parametrize(
    ("count", "first"), [(0, 1), (10, 1), (300_000, 1), (1_200_000, 4), (6_000_000, 32)]
)
def test_the_first_draft_of_a_large_scene_is_of_few_gaussians(count, first):
    pace = Pace()
    pace.put(count)
    pace.move(0.0)
    step = draw(pace, 0.0, 0.05)
    assert not step.full
    assert step.shrink > 1
    assert step.every == first
