"""Write files atomically: an output appears completely or not at all."""

from __future__ import annotations

import math
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import BinaryIO

from gs_codec.errors import InvalidInput, one_line

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


#: Characters that Windows reserves: a colon leads to a drive or an alternate data stream.
_RESERVED = re.compile('[<>:"|?*]')


def possible_name(name: str) -> str:
    """The name of a file, on Windows with underscores for characters that it reserves."""
    return _RESERVED.sub("_", name) if os.sep == "\\" else name


def check_writable(path: str | Path, overwrite: bool = True, makes_folder: bool = False) -> None:
    """Check that a file can be written to a path.

    Raises InvalidInput if it is a directory or device, its directory is missing or not writable,
    or, without `overwrite`, it exists. If it `makes_folder`, only the directory above must exist.
    """
    target = Path(path)
    if os.path.isdir(target):
        raise InvalidInput(f"{target}: a directory, expected a file name")
    if os.path.exists(target) and not target.is_file():
        raise InvalidInput(f"{target}: not a regular file")
    if os.path.lexists(target) and not overwrite:
        raise InvalidInput(f"{target}: already exists; choose another name or pass overwrite=True")
    folder = target.parent
    if makes_folder and not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        raise InvalidInput(f"{target}: no directory '{folder}'")
    if not os.access(folder, os.W_OK):
        raise InvalidInput(f"{target}: no permission to write in '{folder}'")


def check_folder(path: str | Path, overwrite: bool = True) -> None:
    """Check that files can be written into a folder, which need not exist.

    Raises InvalidInput if it is a file, it or the folder to make it in is not writable, or, without
    `overwrite`, it is not empty.
    """
    if os.path.lexists(path) and not os.path.isdir(path):
        raise InvalidInput(f"{path}: exists, expected a folder")
    target = Path(path)
    there = next(folder for folder in (target, *target.parents) if folder.is_dir())
    if not os.access(there, os.W_OK):
        raise InvalidInput(f"{path}: no permission to write in '{there}'")
    if not overwrite and os.path.isdir(path) and os.listdir(path):
        raise InvalidInput(f"{path}: not empty; choose another folder or pass overwrite=True")


def make_folder(path: str | Path) -> Path:
    """Make the folder `path` if it is missing; `InvalidInput` if it cannot be made."""
    try:
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise InvalidInput(f"{path}: {one_line(error)}, expected a folder") from error
    return Path(path)


def temporary_name(name: str, mark: str = "") -> str:
    """Hidden name of a file until it is complete; `mark` identifies its writer."""
    return f".{name[:100]}.{mark}{secrets.token_hex(4)}"


def leftovers(entries: Iterable[str], names: Iterable[str], mark: str = "") -> list[str]:
    """The entries of a folder that are temporary names, with this mark, of the files `names`."""
    begun, pattern = {name[:100] for name in names}, rf"\.(.*)\.{mark}[0-9a-f]{{8}}"
    found = [(entry, re.fullmatch(pattern, entry, re.DOTALL)) for entry in entries]
    return [entry for entry, match in found if match and match[1] in begun]


def remove_leftover(path: str | Path) -> None:
    """Remove a temporary file, unless another process is writing it or it cannot be opened."""
    try:
        descriptor = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    except OSError:
        return
    try:
        unused = try_lock(descriptor)
    finally:
        os.close(descriptor)
    if unused:
        with suppress(OSError):  # Windows does not remove a file that another process is writing
            os.unlink(path)


def try_lock(descriptor: int) -> bool:
    """Lock an open file; False if another process has locked it. Not all systems have locks."""
    if fcntl:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # a file system without locks
            return True
    return True


@contextmanager
def alone(path: str | Path, patience: float = math.inf) -> Iterator[None]:
    """Keep a file or folder locked within the block, once no other process has locked it.

    After `patience` seconds the block runs without the lock, as on systems without locks. The
    system releases the lock of a killed process.
    """
    descriptor, end = None, time.monotonic() + patience
    try:
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY)
            while not try_lock(descriptor) and time.monotonic() < end:
                time.sleep(0.02)
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


@contextmanager
def _locked(descriptor: int) -> Iterator[None]:
    """Keep a file locked within the block, even after it is closed."""
    own = os.dup(descriptor)
    try:
        try_lock(own)
        yield
    finally:
        os.close(own)


@contextmanager
def atomic_writer(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file that becomes `path` if the block succeeds; it is flushed to disk.

    If the system supports it, the file has no name until it is complete, so a process killed at any
    moment leaves nothing behind. Exception: if `path` exists, a process killed between the two
    system calls that name and move the file leaves a complete, hidden copy. A file that is replaced
    passes on its permissions. Raises InvalidInput if the file cannot be written; then nothing is
    left behind.
    """
    check_writable(path)
    target = Path(path)
    hidden = target.with_name(temporary_name(target.name))
    try:
        descriptor, named = _create(target.parent, hidden)
        with _locked(descriptor) if fcntl else nullcontext():
            with open(descriptor, "wb") as file:
                yield file
                file.flush()
                if hasattr(os, "fchmod"):
                    with suppress(OSError):  # there is no file yet
                        os.fchmod(descriptor, stat.S_IMODE(os.stat(target).st_mode))
                os.fsync(descriptor)
                if not named:
                    _name(descriptor, target, hidden)
            if named:
                os.replace(hidden, target)
        _keep_name(target.parent)
    except BaseException as error:
        with suppress(OSError):
            os.unlink(hidden)
        if isinstance(error, OSError):
            raise InvalidInput(f"{target}: {error.strerror or error}") from error
        raise


def _create(folder: Path, hidden: Path) -> tuple[int, bool]:
    """Create a file, without a name if possible; return whether it is named `hidden`."""
    nameless = getattr(os, "O_TMPFILE", None)
    if nameless is not None and os.path.isdir("/proc/self/fd"):
        with suppress(OSError):
            return os.open(folder, nameless | os.O_WRONLY | os.O_CLOEXEC, 0o666), False
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    return os.open(hidden, flags, 0o666), True


def _name(descriptor: int, target: Path, hidden: Path) -> None:
    """Give a file without a name the name `target`; replace an existing one through `hidden`."""
    source, moved = f"/proc/self/fd/{descriptor}", (os.fspath(hidden), os.fspath(target))
    folder = os.open(target.parent, getattr(os, "O_PATH", os.O_RDONLY))
    try:
        # Python follows the link to the file only if a folder is given.
        try:
            os.link(source, target.name, dst_dir_fd=folder, follow_symlinks=True)
        except FileExistsError:
            os.link(source, hidden.name, dst_dir_fd=folder, follow_symlinks=True)
            os.replace(*moved)
    finally:
        os.close(folder)


def _keep_name(folder: Path) -> None:
    """Flush the directory entry of a new file to disk, if the system supports it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_files(folder: str | Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Write files by name into a folder; missing folders are created.

    They are moved there, in their order, once all are complete. A process killed until then leaves
    a hidden folder. Raises InvalidInput if a folder cannot be made, or a file cannot be written; a
    new folder is then removed.
    """
    existed = os.path.isdir(folder)
    target = make_folder(folder)
    hidden = target / temporary_name(target.name)
    for name in files:
        if (target / name).parent.is_dir():
            check_writable(target / name)
    try:
        for name, content in files.items():
            make_folder((hidden / name).parent)
            with atomic_writer(hidden / name) as file:
                file.write(content)
        for name in files:
            make_folder((target / name).parent)
            os.replace(hidden / name, target / name)
        _keep_name(target)
    except OSError as error:
        raise InvalidInput(f"{target}: {one_line(error)}") from error
    except InvalidInput as error:
        raise InvalidInput(str(error).replace(str(hidden), str(target))) from error
    finally:
        shutil.rmtree(hidden, ignore_errors=True)
        if not existed:
            with suppress(OSError):  # not empty, unless nothing was written
                os.rmdir(target)
