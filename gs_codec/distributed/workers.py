"""Tasks of a run, done in stages by the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from gs_codec.distributed.folder import Folder
from gs_codec.errors import InvalidInput
from gs_codec.report import Progress
from gs_codec.runtime.lazy import from_extra
from gs_codec.runtime.wording import counted
from gs_codec.scene import float_bytes

#: Gaussians of a task, about; fewer within a memory limit.
_GAUSSIANS = 1 << 19

#: Memory of a worker without a task, bytes. Measured, rounded up.
_FIXED = 330_000_000

#: Memory of a task, in copies of its floats. Measured, rounded up.
_COPIES = 5

#: A task, given its number.
Task = Callable[[int], None]


class Workers(Protocol):
    """What does tasks; each worker does `at_once` of them at a time."""

    at_once: int

    def run(self, stage: str, task: Task, numbers: Sequence[int]) -> None:
        """Do a task for each number; returns when all are done.

        Raises
        ------
        GsCodecError
            That of the first task that fails.
        """


def do_all(workers: Workers, folder: Folder, stage: str, task: Task, count: int) -> None:
    """Do tasks from 0 to `count` that have no result yet: ``STAGE-NUMBER``."""
    workers.run(
        f"{folder.label}{stage}", task, [k for k in range(count) if not folder.has(f"{stage}-{k}")]
    )


def size_within(max_memory: int | None, at_once: int, sh_degree: int, least: int) -> int:
    """How many Gaussians a task holds, at least so many, if workers have a memory limit.

    Raises
    ------
    InvalidInput
        If it is too low.
    """
    if max_memory is None:
        return _GAUSSIANS
    each = at_once * _COPIES * float_bytes(1, sh_degree)
    size = (max_memory - _FIXED) // each
    if size < least:
        needed = _FIXED + least * each
        raise InvalidInput(
            f"max-memory: {counted(max_memory, 'byte')}, expected at least {needed:,} for a worker"
        )
    return min(size, _GAUSSIANS)


def workers_at(address: str, progress: Progress | None) -> AbstractContextManager[Workers]:
    """The workers of the Dask scheduler at an address, or local ones; see `dask_workers`."""
    module = from_extra("gs_codec.distributed.dask", "cluster", "dask")
    return module.dask_workers(address, progress)
