"""The report of a batch: a line of JSON for each attempt at a scene; the latest line counts."""

from __future__ import annotations

import errno
import json
import logging
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, BinaryIO

from gs_codec.errors import InvalidInput, one_line
from gs_codec.runtime.atomic import check_writable

try:
    import fcntl
except ImportError:  # Windows: two batches with the same report are not detected
    fcntl = None  # type: ignore[assignment]

log = logging.getLogger(__name__)

_START = b'{"source": '


@dataclass(frozen=True)
class Record:
    """Result of encoding one scene.

    Attributes
    ----------
    source, output : str
        Paths or URLs, without secrets.
    options : str
        Digest of the options that the output bytes depend on.
    versions : dict of str to str
        Versions of gs_codec and of the packages that it computes with.
    input_bytes, input_modified, input_sha256
        The source as it was read; -1 or empty if unknown.
    output_bytes, output_sha256, gaussians, ratio, bits_per_gaussian
        The output; -1 or empty if nothing was written.
    seconds : dict of str to float
        Seconds per stage.
    changed : dict of str to int
        Number of Gaussians or values that were changed, by reason.
    warnings : list of str
    error : dict of str to str, optional
        ``kind`` and ``text`` of the error.
    """

    source: str
    output: str
    options: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    input_bytes: int = -1
    input_modified: int | str = ""
    input_sha256: str = ""
    output_bytes: int = -1
    output_sha256: str = ""
    gaussians: int = -1
    ratio: float = -1.0
    bits_per_gaussian: float = -1.0
    seconds: dict[str, float] = field(default_factory=dict)
    changed: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    error: dict[str, str] | None = None


class Ledger:
    """An open report, locked so that no other batch writes to it.

    Attributes
    ----------
    path : Path
    records : dict of (str, str) to Record
        The latest record of each source and output, from the lines found when it was opened.
    """

    def __init__(self, path: Path, file: BinaryIO, records: dict[tuple[str, str], Record]) -> None:
        self.path, self._file, self.records = path, file, records

    def add(self, record: Record) -> None:
        """Append a record; it is on the disk when this returns.

        Raises
        ------
        InvalidInput
            If it cannot be written.
        """
        try:
            line = json.dumps(asdict(record)).encode() + b"\n"
            if self._file.write(line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InvalidInput(f"{self.path}: {one_line(error)}") from error


@contextmanager
def open_ledger(path: str | Path, resume: bool, overwrite: bool = True) -> Iterator[Ledger]:
    """Open a report: to continue it (`resume`), or to start it again from empty.

    Raises
    ------
    InvalidInput
        If it cannot be written, another batch writes to it, the file is not a report, or it has
        lines and neither `resume` nor `overwrite` is given.
    """
    check_writable(path)
    try:
        file = open(path, "a+b", buffering=0)  # noqa: SIM115
    except OSError as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from error
    with file:
        _lock(path, file)
        file.seek(0)
        content = file.read()
        if content and not content.startswith(_START) and not _START.startswith(content):
            raise InvalidInput(f"{path}: exists and is not a report of gs-codec batch")
        if not resume:
            if content and not overwrite:
                raise InvalidInput(f"{path}: exists, expected --resume or --overwrite")
            content = b""
        # A last line without a line end was cut off when its process died.
        content = content[: content.rfind(b"\n") + 1]
        file.truncate(len(content))
        yield Ledger(Path(path), file, _read_records(path, content))


def _lock(path: str | Path, file: Any) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InvalidInput(f"{path}: another batch is writing to it") from error
    except OSError as error:  # file systems without locks
        log.warning("%s: cannot be locked (%s)", path, one_line(error))


def _read_records(path: str | Path, content: bytes) -> dict[tuple[str, str], Record]:
    records, broken = {}, 0
    for line in content.splitlines():
        record = parse_record(line)
        if record is None:
            broken += 1
        else:
            records[record.source, record.output] = record
    if broken:
        log.warning("%s: %d lines are not records, skipped", path, broken)
    return records


def parse_record(line: bytes) -> Record | None:
    """The record in a line, or None if the line is not a record."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    known = {f.name: found[f.name] for f in fields(Record) if f.name in found}
    sound = {"source", "output"} <= known.keys() and all(map(_is_sound, known, known.values()))
    return Record(**known) if sound else None


def _is_sound(name: str, value: Any) -> bool:
    """Whether a field has the expected type."""
    kind, inner = _TYPES[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        return False
    if isinstance(value, dict):
        return all(isinstance(v, inner) and not isinstance(v, bool) for v in value.values())
    if isinstance(value, list):
        return all(isinstance(v, inner) for v in value)
    return not isinstance(value, float) or math.isfinite(value)


_NUMBER = (int, float)

#: Type of each field, and of its items.
_TYPES: dict[str, tuple[Any, Any]] = {
    "source": (str, None),
    "output": (str, None),
    "options": (str, None),
    "versions": (dict, str),
    "input_bytes": (int, None),
    "input_modified": ((int, str), None),
    "input_sha256": (str, None),
    "output_bytes": (int, None),
    "output_sha256": (str, None),
    "gaussians": (int, None),
    "ratio": (_NUMBER, None),
    "bits_per_gaussian": (_NUMBER, None),
    "seconds": (dict, _NUMBER),
    "changed": (dict, int),
    "warnings": (list, str),
    "error": ((dict, type(None)), str),
}
