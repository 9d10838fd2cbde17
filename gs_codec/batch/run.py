"""Run a batch, from its options to its report."""

from __future__ import annotations

import glob
import hashlib
import os
import platform
import shutil
import tempfile
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from gs_codec import __version__
from gs_codec.batch.ledger import Ledger, Record, open_ledger
from gs_codec.batch.local import LocalStorage
from gs_codec.batch.remote import Storage, is_url, storage_of
from gs_codec.batch.scene_tasks import Options, Task, find_tasks
from gs_codec.batch.work import record_scene, versions
from gs_codec.errors import GsCodecError, InvalidInput, one_line
from gs_codec.format_table import format_of
from gs_codec.runtime.memory import available_bytes
from gs_codec.runtime.optional import check_installed
from gs_codec.runtime.redaction import redacted, without_secrets
from gs_codec.runtime.threads import available_threads
from gs_codec.runtime.wording import as_typed
from gs_codec.workers.interface import Done, Listener, Workers
from gs_codec.workers.pool import Pool

_REPORT = "report.jsonl"


@dataclass(frozen=True)
class Batch:
    """Options of a batch: what to encode, where to write it, and how.

    Raises InvalidInput if a value is outside its range.

    Parameters
    ----------
    source : str
        A file, folder or glob, or a URL of one.
    target : str
        A folder, or a URL of one, for the same tree of files.
    options : Options
        If `threads` is None, concurrent scenes share the processors equally.
    jobs : int, optional
        Maximum concurrent scenes. Default: processors divided by the threads of a scene.
    resume : bool
        Continue the existing report. Default False: start a new one.
    report : str, optional
        A file on this machine. Default ``report.jsonl`` in the target folder, or in the current
        folder if the target is remote.
    on_error : {"continue", "stop"}
        Whether to start more scenes after one has failed.
    dask : str, optional
        Address of a scheduler, or ``local`` for a cluster of `jobs` processes.
    overwrite : bool
        Without `resume`, whether to overwrite an existing report and existing outputs. Default
        True; the command line defaults to False.
    """

    source: str
    target: str
    options: Options
    jobs: int | None = None
    resume: bool = False
    report: str | None = None
    on_error: Literal["continue", "stop"] = "continue"
    dask: str | None = None
    overwrite: bool = True

    def __post_init__(self) -> None:
        if self.on_error not in ("continue", "stop"):
            raise InvalidInput(f"on_error '{self.on_error}': expected 'continue' or 'stop'")
        if self.jobs is not None and not 1 <= self.jobs <= 1024:
            raise InvalidInput(f"jobs {self.jobs}: expected 1 to 1024")
        if self.jobs is not None and self.dask not in (None, "local"):
            raise InvalidInput("jobs: has no effect with a Dask scheduler, whose workers set it")
        if self.report is not None and is_url(self.report):
            shown = without_secrets(self.report)
            raise InvalidInput(f"report {shown}: expected a local file")


@dataclass(frozen=True)
class Summary:
    """Result of a batch.

    Attributes
    ----------
    report : str
        Path of the report.
    done, skipped, failed, not_started : int
        Number of scenes encoded now, already done, failed, and not started because one failed.
    gaussians, input_bytes, output_bytes : int
        Total Gaussians and bytes of the complete scenes.
    ratio : float or None
        Total compression ratio: relative to the PLY files or, if some inputs are compressed, to the
        floats; None without scenes.
    seconds : float
    """

    report: str
    done: int
    skipped: int
    failed: int
    not_started: int
    gaussians: int
    input_bytes: int
    output_bytes: int
    ratio: float | None
    seconds: float


class Watcher(Listener):
    """Gets the events of a batch; this base class ignores them."""

    def begun(self, total: int, skipped: int, report: str) -> None:
        """The batch begins: `total` scenes to encode, `skipped` already done."""

    def ended(self, task: Task, record: Record) -> None:
        """A scene is done, or failed."""


def run_batch(batch: Batch, watcher: Watcher | None = None) -> Summary:
    """Encode the scenes of a folder or glob; a failed scene does not stop the others.

    Outputs appear atomically. The report gets a line for each scene when it is done. Raises
    InvalidInput or MissingTool if no scene matches, a storage cannot be used, the report cannot be
    written, or a package that the format needs is not installed.
    """
    start, watcher, records = time.perf_counter(), watcher or Watcher(), list[Record]()
    format_of(f".{batch.options.format}").check_installed()
    sources, targets = storage_of(batch.source), storage_of(batch.target)
    options = batch.options.absolute()
    path = batch.report or _default_report(targets)
    mark = batch_mark(path)
    tasks = find_tasks(batch.source, sources, targets, options, mark)
    targets.check_folder()
    if not (batch.resume or batch.overwrite):
        _refuse_existing(tasks, targets)
    with open_ledger(path, batch.resume, batch.overwrite) as ledger, _scratch(mark) as scratch:
        outputs = [task.target for task in tasks]
        targets.sweep(outputs, mark)
        digest = options.digest()
        known = {t: r for t in tasks if (r := _complete(t, ledger, digest, sources, targets))}
        waiting = [task for task in tasks if task not in known]
        opened, work = (
            _open_workers(batch, len(waiting), scratch, watcher),
            partial(record_scene, options),
        )
        watcher.begun(len(waiting), len(known), path)
        try:
            with opened as workers, closing(workers.run(work, waiting)) as results:
                for done in results:
                    records.append(record := _completed(done, digest))
                    ledger.add(record)
                    watcher.ended(done.task, record)
                    if record.error is not None and batch.on_error == "stop":
                        workers.stop()
        finally:
            if isinstance(targets, LocalStorage):
                targets.sweep(outputs, mark)
    return _sum_up(path, records, list(known.values()), len(waiting), time.perf_counter() - start)


def _completed(done: Done[Task, Record], digest: str) -> Record:
    """Fill in options and versions of a record, and remove secrets from its texts."""
    task, record = done.task, done.value
    if done.error is not None:
        kind = type(done.error).__name__
        text = f"{task.shown[0]}: {one_line(done.error) or kind}"
        record = Record(*task.shown, error={"kind": kind, "text": text})
    assert record is not None
    record = replace(record, options=digest, versions=record.versions or versions())
    urls = [url for file in (task.source, task.target) for url in (file.base, file.path)]
    record = replace(record, warnings=[redacted(as_typed(text), *urls) for text in record.warnings])
    if record.error is None:
        return record
    error = {name: redacted(as_typed(text), *urls) for name, text in record.error.items()}
    record = replace(record, error=error)
    size = None if task.stamp.size < 0 else task.stamp.size
    return replace(record, input_bytes=size, input_modified=task.stamp.modified)


def _refuse_existing(tasks: Sequence[Task], targets: Storage) -> None:
    for task in tasks:
        if targets.stamp(task.target) is not None:
            raise InvalidInput(f"{task.shown[1]}: already exists; pass --resume or --overwrite")


def _default_report(targets: Storage) -> str:
    return os.path.join(targets.path, _REPORT) if isinstance(targets, LocalStorage) else _REPORT


def _open_workers(
    batch: Batch, count: int, scratch: str, watcher: Watcher
) -> AbstractContextManager[Workers]:
    threads = batch.options.config.threads or 1
    jobs = batch.jobs or max(available_threads() // threads, 1)
    jobs = min(jobs, max(count, 1))
    if batch.dask is None:
        return Pool(jobs, available_bytes(), scratch, watcher)
    check_installed("distributed", "dask")
    from gs_codec.workers.dask import dask_workers

    return dask_workers(batch.dask, jobs, scratch, watcher)


def batch_mark(report: str) -> str:
    """An identifier of the batch, from its report and host, which marks unfinished files."""
    text = f"{platform.node()} {uuid.getnode()} {os.path.abspath(report)}"
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:8]


@contextmanager
def _scratch(mark: str) -> Iterator[str]:
    """A temporary folder for copies; first removes those of killed batches with this mark."""
    prefix = f"gs-codec-{mark}-"
    for old in glob.glob(os.path.join(glob.escape(tempfile.gettempdir()), prefix + "*")):
        shutil.rmtree(old, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as folder:
        yield folder


def _complete(
    task: Task, ledger: Ledger, digest: str, sources: Storage, targets: Storage
) -> Record | None:
    """The record of a scene that is done, if neither source nor output has changed since."""
    record = ledger.records.get(task.shown)
    if record is None or record.error is not None or record.options != digest:
        return None
    if record.versions.get("gs_codec") != __version__:
        return None
    try:
        written = targets.stamp(task.target)
        if written is None or written.size not in (-1, record.output_bytes):
            return None
        stamp, was = task.stamp, (record.input_bytes, record.input_modified)
        # A local file with a new modification time may still have the same content; a web server
        # may state none.
        by_content = isinstance(sources, LocalStorage) or not stamp.modified
        if ((stamp.size, stamp.modified) != was or not stamp.modified) and (
            not by_content
            or stamp.size != record.input_bytes
            or sources.sha256(task.source) != record.input_sha256
        ):
            return None
        same = targets.sha256(task.target) == record.output_sha256
    except GsCodecError:  # a file that cannot be read is not complete
        return None
    return record if same else None


def _sum_up(
    path: str, records: list[Record], known: list[Record], expected: int, seconds: float
) -> Summary:
    done = [record for record in records if record.error is None]
    complete = [*done, *known]
    written = sum(record.output_bytes or 0 for record in complete)
    whole = sum(_bases(complete))
    return Summary(
        path,
        len(done),
        len(known),
        len(records) - len(done),
        expected - len(records),
        sum(record.gaussians or 0 for record in complete),
        sum(record.input_bytes or 0 for record in complete),
        written,
        whole / written if written else None,
        seconds,
    )


def _bases(records: Sequence[Record]) -> list[int]:
    """Reference size for the ratio of each scene: file, or floats if some are compressed."""
    read = [record.input_bytes or 0 for record in records]
    own = [(record.ratio or 0) * (record.output_bytes or 0) for record in records]
    by_files = all(abs(a - b) < 1 for a, b in zip(own, read, strict=True))
    return read if by_files else [record.float_bytes or 0 for record in records]
