"""The folder that workers share; results are files there, so that a run can be resumed."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec import __version__
from gs_codec.errors import InvalidInput, one_line
from gs_codec.runtime.atomic import atomic_writer, make_folder, try_lock

#: Prefix of the folders of runs.
_RUN = "run-"

#: Arrays of a result, by name.
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Folder:
    """Results by name: arrays, written once and atomically. Stages of tasks have a label there."""

    path: Path
    label: str = ""

    def within(self, name: str) -> Folder:
        """A subfolder."""
        return Folder(make_folder(self.path / name), f"{name} ")

    def has(self, name: str) -> bool:
        """Whether a result exists."""
        return self._file(name).exists()

    def save(self, name: str, arrays: Arrays) -> None:
        """Write a result."""
        with atomic_writer(self._file(name)) as file:
            # NumPy before 2.1 saves its option `allow_pickle` as an array.
            np.savez(file, **arrays)  # type: ignore[arg-type]

    def load(self, name: str, *wanted: str) -> Arrays:
        """The arrays of a result, or only the wanted ones.

        Raises InvalidInput if it does not exist, or is not a result.
        """
        try:
            with np.load(self._file(name)) as found:
                return {key: found[key] for key in wanted or found.files}
        except (OSError, KeyError, ValueError) as error:
            raise self._unreadable(name, error) from error

    def save_mapped(self, name: str, array: NDArray) -> None:
        """Write an array that is later read in parts."""
        with atomic_writer(self.path / f"{name}.npy") as file:
            np.save(file, array, allow_pickle=False)

    def mapped(self, name: str) -> NDArray:
        """Map an array of `save_mapped`; only used parts are read."""
        try:
            return np.load(self.path / f"{name}.npy", mmap_mode="r")
        except (OSError, ValueError) as error:
            raise self._unreadable(name, error) from error

    def remove_mapped(self) -> None:
        """Remove all arrays of `save_mapped`."""
        for file in self.path.glob("*.npy"):
            file.unlink()

    def _file(self, name: str) -> Path:
        return self.path / f"{name}.npz"

    def _unreadable(self, name: str, error: Exception) -> InvalidInput:
        return InvalidInput(
            f"{self.path}: no result '{name}' ({one_line(error)}), "
            "expected a folder that all workers share"
        )


def identity_of(paths: Iterable[Path], **settings: Any) -> dict[str, Any]:
    """What two runs must have in common for one to reuse the results of the other."""
    found = [(path, os.stat(path)) for path in paths]
    stamps = [(path, status.st_size, status.st_mtime_ns) for path, status in found]
    return {"version": __version__, "files": stamps, **settings}


@contextmanager
def work_folder(target: Path, identity: dict[str, Any]) -> Iterator[Folder]:
    """The folder ``TARGET.parts`` next to an output, with results of a run of the same identity.

    Results of runs with another identity are removed, and those of this run once the block
    succeeds. Other files are kept. Raises InvalidInput if it cannot be created, or another run is
    using it.
    """
    outer = make_folder(target.with_name(f"{target.name}.parts"))
    text = json.dumps(identity, sort_keys=True, default=str)
    # Workers of a killed run may still write, but to a different folder.
    digest = hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()
    own = outer / f"{_RUN}{digest[:16]}"
    descriptor = _locked(outer)
    try:
        for entry in outer.glob(f"{_RUN}*"):
            if entry != own:
                shutil.rmtree(entry, ignore_errors=True)
        make_folder(own)
        yield Folder(own)
        shutil.rmtree(own, ignore_errors=True)
        with suppress(OSError):  # not empty
            outer.rmdir()
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _locked(folder: Path) -> int | None:
    """A descriptor that locks the folder; None if folders cannot be locked."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    if not try_lock(descriptor):
        os.close(descriptor)
        raise InvalidInput(f"{folder}: another run is using it; wait until it ends")
    return descriptor
