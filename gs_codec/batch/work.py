"""Process one scene of a batch: fetch it, encode it, store the output."""

from __future__ import annotations

import importlib.metadata
import logging
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from gs_codec import __version__
from gs_codec.batch.ledger import Record
from gs_codec.batch.local import LocalStorage, file_sha256, present_files
from gs_codec.batch.needed_memory import most_floats
from gs_codec.batch.remote import RemoteStorage, storage_of
from gs_codec.batch.scene_tasks import Options, Task
from gs_codec.errors import GsCodecError, InvalidInput, one_line
from gs_codec.format_table import SSOG, STREAMED, TILESET
from gs_codec.formats.registry import scene_files
from gs_codec.report import NOT_MEASURED, Progress, StageTimes, bits_per_gaussian, lacks_loss
from gs_codec.runtime.atomic import make_folder
from gs_codec.runtime.wording import counted
from gs_codec.workers.interface import Place

if TYPE_CHECKING:
    from gs_codec.files.conversion import ConvertReport
    from gs_codec.report import EncodeReport

#: Packages whose versions may change the output bytes.
_COMPUTING = ("numpy", "numba", "llvmlite", "pcodec")

#: Scenes of several files that are refused, besides SOG: format and what is expected, by name.
_SEVERAL = {
    STREAMED: ("streamed SOG", f"a bundle ({SSOG})"),
    TILESET: ("3D Tiles", "a scene in one file, converted from them"),
}


def record_scene(options: Options, task: Task, place: Place) -> Record:
    """Encode or convert a scene with its share of the processors; errors become part of the record.

    Copies of remote files are in a temporary folder.
    """
    options = options.with_share(place.jobs)
    blank = Record(*task.shown, versions=versions())
    warnings: list[str] = []
    try:
        with tempfile.TemporaryDirectory(dir=place.folder) as folder:
            record = _encode(task, options, Path(folder), place.progress, blank, warnings)
    except Exception as error:
        # Other scenes must still be encoded, whatever the error.
        kind = "InvalidInput" if isinstance(error, OSError) else type(error).__name__
        text = one_line(error) or kind
        if not isinstance(error, GsCodecError) and task.shown[0] not in text:
            text = f"{task.shown[0]}: {text}"
        record = replace(blank, error={"kind": kind, "text": text})
    return replace(record, warnings=warnings)


def _encode(
    task: Task,
    options: Options,
    folder: Path,
    progress: Progress,
    blank: Record,
    warnings: list[str],
) -> Record:
    sources, targets = storage_of(task.source.base), storage_of(task.target.base)
    if task.name.lower().endswith(".json"):
        # The other files of the scene would neither be copied nor checked for changes.
        name = PurePath(task.name.lower()).name
        kind, expected = _SEVERAL.get(name, ("SOG", "a bundle (.sog)"))
        raise InvalidInput(f"{task.shown[0]}: {kind} of several files, expected {expected}")
    times = StageTimes()
    with times.stage("fetch"):
        before = sources.stamp(task.source)
        file = sources.fetch(task.source, folder)
        remote = isinstance(sources, RemoteStorage)
        if remote and (number := len(scene_files(file))) > 1:
            text = f"a scene of {counted(number, 'file')}, expected one file in remote storage"
            raise InvalidInput(f"{task.shown[0]}: {text}")
        files = present_files(file)
        digest, size = file_sha256(*files), sum(each.stat().st_size for each in files)
    output = folder / f"scene.{options.format}"
    if isinstance(targets, LocalStorage):
        output = Path(task.target.path)
        make_folder(output.parent)
    limit = options.max_bytes
    if limit is None and isinstance(sources, RemoteStorage):
        limit = most_floats(size, task.name)
    with _named({str(file): task.shown[0], str(output): task.shown[1]}, warnings):
        report = _write(file, output, options, progress, limit)
    profile = options.config.profile if options.plain is None else None
    if lacks_loss(report.rendered, profile, options.prepares):
        warnings.append(f"{task.shown[0]}: {NOT_MEASURED}")
    after = sources.stamp(task.source)
    if before is None or before != after:
        # The source changed while it was read, so the output may mix old and new.
        output.unlink()
        raise InvalidInput(f"{task.shown[0]}: changed while it was read")
    times.seconds |= report.seconds
    with times.stage("store"):
        written = file_sha256(output), os.path.getsize(output)
        if isinstance(targets, RemoteStorage):
            targets.store(output, task.target, task.mark)
    names = ("dropped", "rectified", "zero_quaternions")
    changed = {name: getattr(report, name, 0) for name in names}
    changed["removed"] = sum(done.before - done.after for done in report.actions)
    return replace(
        blank,
        input_bytes=size,
        input_modified=before.modified,
        input_sha256=digest,
        float_bytes=report.float_bytes,
        output_bytes=written[1],
        output_sha256=written[0],
        gaussians=report.count,
        ratio=report.ratio,
        bits_per_gaussian=bits_per_gaussian(written[1], report.count),
        sh_degree=report.sh_degree,
        seconds=sum(times.seconds.values()),
        stages=times.seconds,
        changed={name: number for name, number in changed.items() if number},
        prepared=getattr(report, "prepared", None),
        rendered=None if report.rendered is None else asdict(report.rendered),
    )


def _write(
    file: Path, output: Path, options: Options, progress: Progress, max_bytes: int | None
) -> EncodeReport | ConvertReport:
    """Encode or convert a scene."""
    from gs_codec.files.conversion import convert_file
    from gs_codec.files.encode_file import encode_requested

    if options.plain is None:
        request = replace(options, max_bytes=max_bytes)
        return encode_requested(file, output, request, progress, overwrite=True)
    return convert_file(
        file, output, options.config, actions=options.actions, plan=options.plan,
        progress=progress, max_memory=options.max_memory, max_bytes=max_bytes, overwrite=True,
    )  # fmt: skip


@lru_cache
def versions() -> dict[str, str]:
    """Versions of gs_codec and of the packages that may affect the output bytes."""
    return {"gs_codec": __version__} | {
        name: importlib.metadata.version(name) for name in _COMPUTING
    }


@contextmanager
def _named(names: dict[str, str], warnings: list[str]) -> Iterator[None]:
    """Collect warnings of this thread; in them and in errors, show the original names."""

    def named(text: str) -> str:
        for file, shown in names.items():
            text = text.replace(file, shown)
        return text

    thread = threading.get_ident()

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == thread:
                warnings.append(named(record.getMessage()))

    logger, collector = logging.getLogger("gs_codec"), Collector(logging.WARNING)
    logger.addHandler(collector)
    try:
        yield
    except GsCodecError as error:
        raise type(error)(named(str(error))) from error
    finally:
        logger.removeHandler(collector)
