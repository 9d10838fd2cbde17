"""Workers of all kinds do each task once, and pass on its error, progress and place."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest

from gs_codec.errors import InvalidInput
from gs_codec.workers.interface import Listener, Place, Serial, WorkerLost, Workers
from gs_codec.workers.pool import Pool


class Sum(NamedTuple):
    """A task."""

    name: str
    number: int = 0
    need: int = 0


class Ears(Listener):
    """Records everything it hears."""

    def __init__(self) -> None:
        self.heard = list[tuple]()

    def started(self, task: Sum) -> None:
        self.heard.append(("started", task.name))

    def stage(self, task: Sum, stage: str, done: int, total: int) -> None:
        self.heard.append((stage, task.name, done, total))


def work(factor: int, task: Sum, place: Place) -> int:
    """A product. A task ``bad`` raises an error, and ``killed`` kills its process."""
    place.progress("multiply", task.number, 9)
    if task.name == "bad":
        raise InvalidInput("bad: cannot be multiplied")
    if task.name == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    Path(place.folder, task.name).touch()
    return factor * task.number * place.jobs


@contextmanager
def serial(folder: str, ears: Ears) -> Iterator[Workers]:
    yield Serial(folder, ears)


def pool(folder: str, ears: Ears) -> Pool:
    return Pool(1, None, folder, ears)


def cluster(folder: str, ears: Ears):
    reason = "the extra 'cluster' is not installed"
    dask = pytest.importorskip("gs_codec.workers.dask", reason=reason, exc_type=ImportError)
    return dask.dask_workers("local", 1, folder, ears)


EACH = [serial, pool, pytest.param(cluster, marks=pytest.mark.thorough)]


@pytest.mark.parametrize("kind", EACH)
def test_each_task_is_done_once_with_its_error_and_progress(tmp_path, kind):
    ears, tasks = Ears(), [Sum("a", 1), Sum("bad", 2), Sum("c", 3)]
    with kind(str(tmp_path), ears) as workers:
        assert workers.at_once == 1
        for factor in (2, 5):  # workers can be reused
            done = {each.task.name: each for each in workers.run(partial(work, factor), tasks)}
            assert {name: each.value for name, each in done.items()} == {
                "a": factor,
                "bad": None,
                "c": 3 * factor,
            }
            assert str(done["bad"].error) == "bad: cannot be multiplied"
        assert list(workers.run(partial(work, 1), [])) == []
    assert ears.heard.count(("multiply", "c", 3, 9)) == 2


@pytest.mark.parametrize("kind", EACH[:2])
def test_no_task_is_started_after_stop(tmp_path, kind):
    ears, tasks = Ears(), [Sum(name) for name in "abc"]
    with (
        kind(str(tmp_path), ears) as workers,
        closing(workers.run(partial(work, 1), tasks)) as results,
    ):
        for done in results:
            assert done.task.name == "a"
            workers.stop()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_task_that_kills_its_process_twice_is_abandoned(tmp_path):
    tasks = [Sum("killed"), Sum("b", 1)]
    with pool(str(tmp_path), Ears()) as workers:
        found = list(workers.run(partial(work, 1), tasks))
    assert [each.task.name for each in found] == ["b", "killed"]
    assert isinstance(found[1].error, WorkerLost)
    assert "was stopped by SIGKILL, twice" in str(found[1].error)


def test_abandoned_tasks_end_with_their_processes(tmp_path):
    with pool(str(tmp_path), Ears()) as workers:
        with closing(workers.run(partial(work, 1), [Sum("a"), Sum("b")])) as results:
            assert next(results).task.name == "a"
        assert [each.value for each in workers.run(partial(work, 1), [Sum("c", 7)])] == [7]
