"""Zip files: entries are read within limits, and written identically on all systems."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, BinaryIO

from gs_codec.errors import InvalidInput
from gs_codec.formats.limits import most_bytes, refusing
from gs_codec.runtime.wording import counted

_ENTRIES = 10_000

#: Unused bytes are read in pieces of this size.
_PIECE = 1 << 20

#: Number of the system Unix in a zip.
_UNIX = 3

#: Bytes before the name of an entry.
_HEADER = 30

#: Header of an extra field that only pads.
_SPACE = struct.Struct("<2sH")


class Archive:
    """The files in a zip by name, with forward slashes, whatever the zip uses.

    Raises InvalidInput if there are too many entries, too many bytes in them, or duplicate names.

    Parameters
    ----------
    file : zipfile.ZipFile
    file_bytes : int
        Size of the zip.
    """

    def __init__(self, file: zipfile.ZipFile, file_bytes: int) -> None:
        entries, self.file_bytes = file.infolist(), file_bytes
        if len(entries) > _ENTRIES:
            raise InvalidInput(
                f"zip of {counted(len(entries), 'entry')}, expected at most {_ENTRIES:,}"
            )
        unpacked, most = sum(entry.file_size for entry in entries), most_bytes(file_bytes, None)
        if unpacked > most:
            raise InvalidInput(
                f"zip of {counted(unpacked, 'byte')} unpacked, expected at most {most:,}"
            )
        self._file, self._entries = file, dict[str, zipfile.ZipInfo]()
        for entry in entries:
            name = entry.filename.replace("\\", "/")
            if name.endswith("/"):
                continue
            name = str(PurePosixPath(name))
            if name in self._entries:
                raise InvalidInput(f"two zip entries {name!a:.60}")
            self._entries[name] = entry

    @property
    def names(self) -> list[str]:
        """Sorted names of all files."""
        return sorted(self._entries)

    def named(self, base: str) -> list[str]:
        """Sorted names of the files called `base`, in any folder."""
        return [name for name in self.names if name.rpartition("/")[2] == base]

    def read(self, name: str, limit: int) -> bytes:
        """The bytes of a file.

        Raises InvalidInput if it is missing, damaged, encrypted, or larger than `limit`.
        """
        size = self.size(name)
        if size > limit:
            raise InvalidInput(
                f"{_shown(name)}: {counted(size, 'byte')}, expected at most {limit:,}"
            )
        return self.read_part(name, 0, size)

    def size(self, name: str) -> int:
        """Bytes of a file; `InvalidInput` if it is missing, or cannot be read."""
        if name not in self._entries:
            raise InvalidInput(f"{_shown(name)}: missing")
        entry = self._entries[name]
        if entry.flag_bits & 1:
            raise InvalidInput(f"{_shown(name)}: encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InvalidInput(f"{_shown(name)}: compressed, but not by deflate")
        return entry.file_size

    def read_part(self, name: str, start: int, stop: int) -> bytes:
        """Bytes `start` to `stop` of a file; the rest is read in pieces, to check the whole file.

        Raises InvalidInput if it is missing, damaged or encrypted, or compressed and larger than
        the part.
        """
        shown, size = _shown(name), self.size(name)
        entry = self._entries[name]
        if entry.compress_type != zipfile.ZIP_STORED and stop - start < size:
            raise InvalidInput(
                f"{shown}: {counted(size, 'byte')} compressed, {stop - start} of them used"
            )
        with refusing(shown, zipfile.BadZipFile), self._file.open(entry) as file:
            before = _pass(file, start)
            data = file.read(stop - start)
            found = before + len(data) + _pass(file, size - stop + 1)
        if found != size:
            raise InvalidInput(f"{shown}: {counted(found, 'byte')} of {size:,}")
        return data


def _shown(name: str) -> str:
    return f"zip entry {name!a:.60}"


def _pass(file: IO[bytes], size: int) -> int:
    """Skip up to `size` bytes; return how many there were."""
    left = size
    while left and (piece := len(file.read(min(left, _PIECE)))):
        left -= piece
    return size - left


def only_scene(names: Sequence[str], expected: str) -> str:
    """The only name; `InvalidInput` if there are none, or several."""
    if not names:
        raise InvalidInput(f"a zip without {expected}")
    if len(names) > 1:
        shown = ", ".join(f"{name!a:.60}" for name in names[:3]) + ", ..." * (len(names) > 3)
        raise InvalidInput(
            f"a zip of {counted(len(names), 'scene')} ({shown}), expected one: unpack it first"
        )
    return names[0]


@contextmanager
def opened_zip(file: Path | BinaryIO) -> Iterator[Archive]:
    """Open the entries of a zip file for the block; `InvalidInput` if it is not valid."""
    with refusing("zip", zipfile.BadZipFile):
        opened = zipfile.ZipFile(file)
    with opened:
        size = file.stat().st_size if isinstance(file, Path) else file.seek(0, io.SEEK_END)
        yield Archive(opened, size)


def write_zip(
    file: BinaryIO | io.BytesIO, files: Mapping[str, bytes | memoryview], multiple: int = 1
) -> None:
    """Write a zip of uncompressed files, each beginning at a `multiple` of bytes."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in files.items():
            # Its date is fixed; its system would otherwise be that of this machine.
            entry = zipfile.ZipInfo(name)
            entry.create_system = _UNIX
            if multiple > 1:
                start = file.tell() + _HEADER + len(name) + _SPACE.size
                space = -start % multiple
                entry.extra = _SPACE.pack(b"FB", space) + bytes(space)
            archive.writestr(entry, data)
