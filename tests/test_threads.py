"""Work distributed to threads: in order, with a limited number of items at once."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from gs_codec.runtime.threads import available_threads, run_all, using_threads


@pytest.mark.parametrize("threads", [1, 2, 3, 16, None])
@pytest.mark.parametrize("count", [0, 1, 2, 100])
def test_results_are_in_order_and_counted(threads, count):
    steps: list[int] = []
    squares = run_all(lambda i: i * i, range(count), threads, lambda: steps.append(len(steps)))
    assert squares == [i * i for i in range(count)]
    assert steps == list(range(count))


@pytest.mark.parametrize("threads", [1, 3])
def test_items_are_made_on_demand(threads):
    begun: list[int] = []
    done: list[int] = []

    def items() -> Iterator[int]:
        for i in range(50):
            begun.append(i)
            # One more than the threads, which waits for a free thread.
            assert len(begun) - len(done) <= threads + 1
            yield i

    run_all(done.append, items(), threads)
    assert sorted(done) == list(range(50))


@pytest.mark.parametrize("threads", [1, 4])
def test_an_error_ends_the_work(threads):
    def work(item: int) -> None:
        if item == 5:
            raise ValueError("five")

    def items() -> Iterator[int]:
        # The error is raised once the started items are done, however many remain.
        yield from range(1 << 60)

    with pytest.raises(ValueError, match="five"):
        run_all(work, items(), threads)
    assert threading.active_count() < 50


def test_one_setting_applies_to_all_calls():
    with using_threads(3):
        assert available_threads() == 3
        with using_threads(None):
            assert available_threads() == 3
        with using_threads(1):
            assert run_all(lambda _: threading.get_ident(), range(2)) == [threading.get_ident()] * 2
        assert available_threads() == 3


def test_nested_calls_stay_in_their_thread():
    def work(_: int) -> list[int]:
        return [threading.get_ident(), *run_all(lambda _: threading.get_ident(), range(4))]

    for found in run_all(work, range(4), 4):
        assert len(set(found)) == 1
    assert run_all(lambda _: available_threads(), range(1), 4) == [available_threads()]


def test_one_thread_is_the_callers():
    assert run_all(lambda _: threading.get_ident(), range(3), 1) == [threading.get_ident()] * 3
