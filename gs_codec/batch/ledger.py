"""The report of a batch: a JSON line for each attempt at a scene; the latest line counts."""

from __future__ import annotations

import errno
import json
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, get_args, get_origin, get_type_hints

from gs_codec.errors import InvalidInput, one_line
from gs_codec.report import SCHEMA, finite
from gs_codec.runtime.atomic import check_writable, try_lock
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

#: Prefixes of lines, in reports of this version and of 1.0.
_STARTS = (b'{"schema": ', b'{"source": ')


@dataclass(frozen=True)
class Record:
    """Result of encoding one scene.

    Attributes
    ----------
    input, output : str
        Paths or URLs, without secrets.
    options : str
        Digest of the options that the output bytes depend on.
    versions : dict of str to str
        Versions of gs_codec and of the packages that it computes with.
    input_bytes, input_modified, input_sha256, float_bytes
        The source as it was read, and the size of its floats; None or empty if unknown.
    output_bytes, output_sha256, gaussians, sh_degree, ratio, bits_per_gaussian
        The output; None or empty if nothing was written.
    seconds : float, optional
        Of all stages together.
    stages : dict of str to float
        Seconds by stage.
    changed : dict of str to int
        Number of Gaussians or values that were changed, by reason.
    prepared : dict, optional
        Report of preparation; see `EncodeReport`.
    rendered : dict, optional
        Loss in rendered views; see `RenderedLoss`.
    warnings : list of str
    error : dict of str to str, optional
        ``kind`` and ``text`` of the error.
    """

    input: str
    output: str
    options: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    input_bytes: int | None = None
    input_modified: int | str = ""
    input_sha256: str = ""
    float_bytes: int | None = None
    output_bytes: int | None = None
    output_sha256: str = ""
    gaussians: int | None = None
    sh_degree: int | None = None
    ratio: float | None = None
    bits_per_gaussian: float | None = None
    seconds: float | None = None
    stages: dict[str, float] = field(default_factory=dict)
    changed: dict[str, int] = field(default_factory=dict)
    prepared: dict[str, Any] | None = None
    rendered: dict[str, Any] | None = None
    warnings: list[str] = field(default_factory=list)
    error: dict[str, str] | None = None


class Ledger:
    """An open report, locked so that no other batch writes to it.

    `records` has the latest record of each source and output at the time of opening.
    """

    def __init__(self, path: Path, file: BinaryIO, records: dict[tuple[str, str], Record]) -> None:
        self.path, self._file, self.records = path, file, records

    def add(self, record: Record) -> None:
        """Append a record; it is flushed to disk when this returns."""
        try:
            plain = finite({"schema": SCHEMA} | asdict(record))
            line = json.dumps(plain, allow_nan=False).encode() + b"\n"
            if self._file.write(line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._file.fileno())
        except OSError as error:
            raise InvalidInput(f"{self.path}: {one_line(error)}") from error


@contextmanager
def open_ledger(path: str | Path, resume: bool, overwrite: bool = True) -> Iterator[Ledger]:
    """Open a report: to continue it (`resume`), or to start with an empty one.

    Raises InvalidInput if it cannot be written, another batch writes to it, the file is not a
    report, or it has lines and neither `resume` nor `overwrite` is given.
    """
    check_writable(path)
    try:
        file = open(path, "a+b", buffering=0)  # noqa: SIM115
    except OSError as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from error
    with file:
        if not try_lock(file.fileno()):
            raise InvalidInput(f"{path}: another batch is writing to it")
        file.seek(0)
        content = file.read()
        if not any(content[: len(start)] == start[: len(content)] for start in _STARTS):
            raise InvalidInput(f"{path}: exists and is not a report of gs-codec batch")
        if not resume:
            if content and not overwrite:
                raise InvalidInput(f"{path}: already exists; pass --resume or --overwrite")
            content = b""
        # A last line without a line end was cut off when its process died.
        content = content[: content.rfind(b"\n") + 1]
        file.truncate(len(content))
        yield Ledger(Path(path), file, _read_records(path, content))


def _read_records(path: str | Path, content: bytes) -> dict[tuple[str, str], Record]:
    records, broken = {}, 0
    for line in content.splitlines():
        record = parse_record(line)
        if record is None:
            broken += 1
        else:
            records[record.input, record.output] = record
    if broken:
        log.warning("%s: skipped %s without a record", path, counted(broken, "line"))
    return records


def parse_record(line: bytes) -> Record | None:
    """The record in a line, or None if the line is not a record."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    known = {name: found[name] for name in _TYPES if name in found}
    sound = all(_fits(value, _TYPES[name]) for name, value in known.items())
    return Record(**known) if sound and {"input", "output"} <= known.keys() else None


_TYPES = get_type_hints(Record)


def _fits(value: Any, kind: Any) -> bool:
    """Whether a JSON value has a type; an integer is accepted as a float."""
    items = get_args(kind)
    if get_origin(kind) is dict:
        return isinstance(value, dict) and all(_fits(v, items[1]) for v in value.values())
    if get_origin(kind) is list:
        return isinstance(value, list) and all(_fits(v, items[0]) for v in value)
    if items:  # a union
        return any(_fits(value, one) for one in items)
    if kind is Any or isinstance(value, bool):
        return kind is Any
    if kind is float:
        return isinstance(value, int | float) and abs(value) <= sys.float_info.max
    return isinstance(value, kind)
