"""Disk cache of compiled kernels, in a folder of the user, never in the installed package."""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import config
from numba.core.caching import NullCache
from numba.misc.appdirs import AppDirs

#: Errors of a full disk, a folder without permission, or a damaged cache entry.
_CACHE_ERRORS: tuple[type[Exception], ...] = (
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    pickle.UnpicklingError,
)

#: Settings of numba that change machine code but are not in the key of its cache.
_SETTINGS = ("OPT", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "LOOP_VECTORIZE", "SLP_VECTORIZE")

#: Source files are named relative to the package, wherever it is installed.
_PACKAGE = Path(__file__).parents[1]


@functools.cache
def cache_folder() -> Path | None:
    """Folder of the user's compiled kernels: NUMBA_CACHE_DIR, or the first safe folder.

    Candidates are the user's cache folder and a folder for temporary files. No other user may write
    there, because code is loaded from it. None if there is no safe folder.
    """
    if config.CACHE_DIR:
        return Path(config.CACHE_DIR)
    return next(filter(_is_private, _places()), None)


def is_writable() -> bool:
    """Whether kernels can be written to `cache_folder`."""
    folder = cache_folder()
    while folder is not None and not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder is not None and folder.is_dir() and os.access(folder, os.W_OK)


def _places() -> Iterator[Path]:
    home = Path(os.path.expanduser("~/.cache/gs-codec"))
    user = Path(AppDirs("gs-codec", appauthor=False).user_cache_dir)
    yield user if user.is_absolute() else home  # the current folder may belong to another user
    yield Path(tempfile.gettempdir(), f"gs-codec-{os.geteuid() if _has_owners() else 'kernels'}")


def _is_private(folder: Path) -> bool:
    """Whether a folder exists or can be made that no other user can write to or move."""
    try:
        folder.parent.mkdir(0o700, exist_ok=True)
        if not _has_owners():
            folder.mkdir(exist_ok=True)
            return True
        around, others = folder.parent.stat(), stat.S_IWGRP | stat.S_IWOTH
        shared = around.st_mode & stat.S_IWOTH or around.st_uid not in (0, os.geteuid())
        if shared and not around.st_mode & stat.S_ISVTX:
            return False
        folder.mkdir(0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    return own and not found.st_mode & others


def _has_owners() -> bool:
    return sys.platform != "win32"


def kept(kind: Any, function: Callable, loading: Callable[[Any], Any]) -> Any:
    """Make a cache of one of numba's kinds for a kernel, in `cache_folder`.

    Its failures are ignored, because a kernel can be compiled again. `loading` wraps numba's target
    for loading machine code.
    """
    if cache_folder() is None or not os.path.exists(function.__code__.co_filename):
        return NullCache()
    return _kind(kind)(function, loading)


@functools.cache
def _kind(kind: Any) -> Any:
    class Files(kind._impl_class):
        _locator_classes = (_Place,)

    class Kept(kind):
        _impl_class = Files

        def __init__(self, function: Callable, loading: Callable[[Any], Any]) -> None:
            super().__init__(function)
            self._function, self._loading = function, loading

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            # Only now are all globals of the function's module defined.
            self._cache_file._source_stamp = stamp(self._function)
            try:
                return super().load_overload(sig, self._loading(target_context))
            except _CACHE_ERRORS:
                # Begin a new index, because kernels are not added to a damaged one.
                with suppress(OSError):
                    self.flush()
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            with suppress(*_CACHE_ERRORS):
                super().save_overload(sig, data)

        def _index_key(self, sig: Any, codegen: Any) -> Any:
            return *super()._index_key(sig, codegen), settings()

    return Kept


class _Place:
    """Location of the cached kernels of a source file, derived from its content."""

    def __init__(self, function: Callable, source: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._path = Path(cache_folder() or "", place_name(source))

    from_function = classmethod(lambda cls, function, source: cls(function, source))

    def get_cache_path(self) -> str:
        return str(self._path)

    def ensure_cache_path(self) -> None:
        self._path.mkdir(0o755, parents=True, exist_ok=True)

    def get_source_stamp(self) -> None:
        """Not used; a kernel has its own `stamp`."""

    def get_disambiguator(self) -> str:
        return str(self._line)


def place_name(source: str) -> str:
    """Name of the folder for a source file's kernels."""
    return f"{Path(source).stem}-{source_digest(source)[1][:16]}"


def settings() -> tuple[str, ...]:
    """Settings of numba that change machine code."""
    return tuple(f"{name}={getattr(config, name, None)}" for name in _SETTINGS)


@functools.cache
def source_digest(path: str) -> tuple[str, str]:
    """The name of a source file, relative to the package, and a digest of its content."""
    source = Path(path)
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    inside = source.is_relative_to(_PACKAGE)
    return (source.relative_to(_PACKAGE) if inside else source).as_posix(), digest


def stamp(function: Callable) -> list[Any]:
    """Everything a kernel is compiled from; numba's own stamp covers only its source file.

    These are the source files of all kernels that it calls, and the values of their globals.
    """
    found: dict[str, Any] = {}

    def add(function: Any) -> None:
        source, names = function.__code__.co_filename, function.__code__.co_names
        with suppress(OSError):
            source, found[source] = source_digest(source)
        for name in names:
            value, key = function.__globals__.get(name), f"{source}:{name}"
            called = getattr(value, "py_func", None)
            if called is not None and key not in found:
                found[key] = None
                add(called)
            elif isinstance(value, bool | int | float | tuple | np.generic | np.ndarray):
                found[key] = value.tobytes() if isinstance(value, np.ndarray) else repr(value)

    add(function)
    return sorted(found.items(), key=str)
