"""Zip files: entries read within limits, and written alike on all systems."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from gs_codec.errors import InvalidInput
from gs_codec.formats.limits import refusing

ZIP = b"PK\x03\x04"

_ENTRIES = 10_000

#: Number of a system in a zip.
_UNIX = 3

#: Bytes before the name of an entry; the head of a field that only takes up space.
_HEADER, _SPACE = 30, struct.Struct("<2sH")


@contextmanager
def opened_zip(path: Path) -> Iterator[zipfile.ZipFile]:
    """A zip file, open while the block runs; `InvalidInput` if it is not valid."""
    with refusing("zip", zipfile.BadZipFile):
        archive = zipfile.ZipFile(path)
    with archive:
        number = len(archive.infolist())
        if number > _ENTRIES:
            raise InvalidInput(f"zip of {number} entries, expected at most {_ENTRIES}")
        yield archive


def read_entry(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    """The bytes of an entry.

    Raises
    ------
    InvalidInput
        If it is missing, damaged, encrypted, or larger than `limit`.
    """
    with refusing(f"zip entry '{name[:60]}'", zipfile.BadZipFile):
        entry = archive.getinfo(name)
        if entry.flag_bits & 1:
            raise InvalidInput(f"zip entry '{name[:60]}': encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InvalidInput(f"zip entry '{name[:60]}': compressed otherwise than by deflate")
        if entry.file_size > limit:
            raise InvalidInput(
                f"zip entry '{name[:60]}': {entry.file_size} bytes, expected at most {limit}"
            )
        with archive.open(entry) as file:
            data = file.read(entry.file_size + 1)
    if len(data) != entry.file_size:
        raise InvalidInput(f"zip entry '{name[:60]}': {len(data)} bytes of {entry.file_size}")
    return data


def write_zip(
    file: BinaryIO | io.BytesIO, files: Mapping[str, bytes | memoryview], multiple: int = 1
) -> None:
    """Write a zip of files as they are, each beginning at a `multiple` of bytes."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in files.items():
            # Its date is fixed; its system would be that of this machine.
            entry = zipfile.ZipInfo(name)
            entry.create_system = _UNIX
            if multiple > 1:
                start = file.tell() + _HEADER + len(name) + _SPACE.size
                space = -start % multiple
                entry.extra = _SPACE.pack(b"FB", space) + bytes(space)
            archive.writestr(entry, data)
