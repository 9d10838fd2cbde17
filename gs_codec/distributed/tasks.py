"""Tasks of a run, executed in stages by workers."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from typing import NamedTuple

from gs_codec.distributed.folder import Folder
from gs_codec.errors import GsCodecError, InvalidInput, one_line
from gs_codec.report import Progress
from gs_codec.runtime.optional import check_installed
from gs_codec.runtime.threads import available_threads, using_threads
from gs_codec.runtime.wording import counted
from gs_codec.scene import float_bytes
from gs_codec.workers.interface import Listener, Place, Serial, WorkerLost, Workers

#: Approximate number of Gaussians per task; fewer with a memory limit.
_GAUSSIANS = 1 << 19

#: Memory of a worker without a task, in bytes. Measured, rounded up.
_FIXED = 330_000_000

#: Memory of a task, in copies of its floats. Measured, rounded up.
_COPIES = 5


class Numbered(NamedTuple):
    """A task of a stage, whose memory is limited by its size."""

    name: str
    number: int
    need: int = 0


class Crew(NamedTuple):
    """Workers, and a callback for their progress."""

    workers: Workers
    progress: Progress | None = None

    def do_all(self, folder: Folder, stage: str, work: Callable[[int], None], count: int) -> None:
        """Call `work` with each number from 0 to `count` without a result ``STAGE-NUMBER``.

        Raises
        ------
        GsCodecError
            The error of the first task that fails.
        """
        shown = f"{folder.label}{stage}"
        left = [k for k in range(count) if not folder.has(f"{stage}-{k}")]
        tasks = [Numbered(f"{shown}-{k}", k) for k in left]
        with closing(self.workers.run(partial(_alone, work), tasks)) as results:
            for number, done in enumerate(results, 1):
                if done.error is not None:
                    raise self._failed(shown, done.error)
                if self.progress is not None:
                    self.progress(shown, number, len(tasks))

    def _failed(self, stage: str, error: BaseException) -> GsCodecError:
        if isinstance(error, GsCodecError):
            return error
        text = one_line(error) or type(error).__name__
        if isinstance(error, WorkerLost):
            text = "workers kept failing; choose a smaller max-memory"
        return InvalidInput(f"{self.workers.name}: {stage}: {text}")


def _alone(work: Callable[[int], None], task: Numbered, place: Place) -> None:
    """Run a task in one thread, because other threads run other tasks."""
    with using_threads(1):
        work(task.number)


def size_within(max_memory: int | None, at_once: int, sh_degree: int, least: int) -> int:
    """Number of Gaussians per task (at least `least`), if workers have a memory limit.

    Raises InvalidInput if the limit is too low.
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


@contextmanager
def crew_at(address: str | None, progress: Progress | None) -> Iterator[Crew]:
    """The workers of the Dask scheduler at an address, or local ones; or this process (None).

    Locally, there is one worker per available thread. Raises InvalidInput or MissingTool, as in
    `dask_workers`; or if Dask is not installed, or if there are no workers.
    """
    if address is None:
        yield Crew(Serial(tempfile.gettempdir()), progress)
        return
    check_installed("distributed", "dask")
    from gs_codec.workers.dask import dask_workers

    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch,
        dask_workers(address, available_threads(), scratch, Listener()) as workers,
    ):
        if not workers.at_once:
            raise InvalidInput(f"{workers.name}: no workers")
        yield Crew(workers, progress)
