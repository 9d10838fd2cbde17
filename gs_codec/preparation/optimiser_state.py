"""Checkpoints of an optimisation on disk, to resume it after an interruption."""

from __future__ import annotations

import hashlib
import os
import tokenize
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, one_line
from gs_codec.formats.limits import FAILURES
from gs_codec.preparation.adam import AdamState
from gs_codec.runtime.atomic import atomic_writer

#: Exceptions that reading a damaged array archive may raise.
_DAMAGE: tuple[type[Exception], ...] = (
    *FAILURES, AttributeError, zipfile.BadZipFile, tokenize.TokenError
)  # fmt: skip


@dataclass(frozen=True)
class Checkpoint:
    """State of an optimisation.

    Attributes
    ----------
    state : AdamState
    errors : ndarray, shape (iterations done,), float64
        Mean squared error of each iteration's view, before its update.
    seconds : ndarray, shape (iterations done,), float64
        Time from the start of the run to the end of each iteration, without interruptions.
    """

    state: AdamState
    errors: NDArray[np.float64]
    seconds: NDArray[np.float64]


def digest_of(parts: Iterable[NDArray | str]) -> str:
    """Digest of arrays, including their types and shapes, and of strings."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        if isinstance(part, str):
            digest.update(f"{len(part)} {part}".encode("utf-8", "surrogateescape"))
        else:
            digest.update(f"{part.dtype.str} {part.shape}".encode())
            digest.update(np.ascontiguousarray(part).data)
    return digest.hexdigest()


def write_checkpoint(path: Path, digest: str, checkpoint: Checkpoint) -> None:
    """Write a checkpoint of a run whose inputs have `digest`, atomically.

    Raises InvalidInput if it cannot be written.
    """
    with atomic_writer(path) as file:
        np.savez(
            file,
            digest=np.array(digest),
            errors=checkpoint.errors,
            seconds=checkpoint.seconds,
            **checkpoint.state._asdict(),
        )


def read_checkpoint(path: Path, digest: str, fresh: AdamState) -> Checkpoint | None:
    """Read the checkpoint of a run that starts from `fresh`; None if there is no file.

    Raises InvalidInput if it cannot be read, is damaged, or belongs to other inputs.
    """
    if not os.path.lexists(path):
        return None
    try:
        # Opened here because numpy does not close a file that it cannot read.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            # Compared as bytes: numpy fails on invalid characters.
            found, own = archive["digest"], np.array(digest)
            if (found.dtype, found.tobytes()) == (own.dtype, own.tobytes()):
                return _unpack(archive, fresh)
    except _DAMAGE as error:
        raise InvalidInput(
            f"{path}: incomplete or damaged checkpoint ({one_line(error)})"
        ) from error
    raise InvalidInput(
        f"{path}: checkpoint of another scene, views or options; remove it to start again"
    )


def _unpack(archive: Any, fresh: AdamState) -> Checkpoint:
    arrays = []
    for name, like in fresh._asdict().items():
        array = archive[name]
        if (array.dtype, array.shape) != (like.dtype, like.shape):
            raise ValueError(f"{name}: {array.dtype} {array.shape}, expected {like.shape}")
        arrays.append(np.ascontiguousarray(array))
    errors, seconds = archive["errors"], archive["seconds"]
    if errors.ndim != 1 or errors.shape != seconds.shape:
        raise ValueError(f"errors: {errors.shape}, expected {seconds.shape}")
    return Checkpoint(AdamState(*arrays), errors, seconds)
