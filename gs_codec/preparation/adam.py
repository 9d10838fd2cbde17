"""Adam over the planes of a scene: step sizes, steps, and checkpoints that resume a run."""

from __future__ import annotations

import hashlib
import os
import tokenize
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.errors import InvalidInput, one_line
from gs_codec.formats.limits import FAILURES
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import GROUPS, Scene

BETA_1 = 0.9
BETA_2 = 0.999
EPSILON = np.float32(1e-15)

#: Larger derivatives count as 0, because their squares overflow float32.
LARGEST = np.float32(1e15)

#: Smaller means become 0, because processors are slow with denormal floats.
_SMALLEST = np.float32(1e-30)


#: Initial step sizes; positions in radii of the camera rig (see `rig_radius`). The 3DGS trainer
#: uses 1.6e-4, 2.5e-3, 1.25e-4, 0.05, 5e-3 and 1e-3 over 30,000 iterations; its rate for positions
#: decays to 1 %, the others are constant. Our runs have a tenth of those iterations; on bonsai,
#: higher rates that all decay were better.
RATES = {
    "positions": 6.4e-5,
    "f_dc": 1e-2,
    "f_rest": 5e-4,
    "opacity": 0.1,
    "log_scale": 2e-2,
    "rot": 4e-3,
}

#: Factor on all rates at the end of a run; they decay exponentially.
LAST = 0.03


def rig_radius(cameras: Sequence[Camera]) -> float:
    """Unit of position rates in 3DGS: 1.1 times the largest distance of a camera from the mean."""
    centres = np.array([camera.position for camera in cameras])
    return 1.1 * float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())


def step_sizes(scene: Scene, cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """Initial step sizes ``(C,)`` of Adam, for each channel in the order of `GROUPS`."""
    sizes = RATES | {"positions": RATES["positions"] * rig_radius(cameras)}
    return np.concatenate([np.full(len(getattr(scene, group)), sizes[group]) for group in GROUPS])


class AdamState(NamedTuple):
    """Values of the attributes, and Adam's running means of their derivatives.

    ``values``, ``first`` and ``second``, each ``(N, C)`` float32: the channels, the running means
    of their derivatives, and of the squared derivatives.
    """

    values: NDArray[np.float32]
    first: NDArray[np.float32]
    second: NDArray[np.float32]


def new_state(values: NDArray[np.float32]) -> AdamState:
    """The state before the first step from ``values (C, N)``, which are copied."""
    values = values.T.copy()
    return AdamState(values, np.zeros_like(values), np.zeros_like(values))


@kernel
def adam_step(values, first, second, step, rates, slopes, chosen, start, stop):
    """Step number `step`, from 1, of Adam (Kingma & Ba 2015, Algorithm 1).

    It updates Gaussians `start` to `stop`, including those not visible in the view, which follow
    the mean of their earlier derivatives. On bonsai this fits better than skipping them (Mallick et
    al. 2024).

    ``rates (C,)`` are the step sizes. ``slopes (M, C)`` are the derivatives of Gaussians
    ``chosen (M,)``, ascending; those of the others are 0. A value that would become infinite or NaN
    is not changed.
    """
    root = np.float32(1.0 / (1.0 - BETA_2**step))
    old_1, new_1 = np.float32(BETA_1), np.float32(1.0 - BETA_1)
    old_2, new_2 = np.float32(BETA_2), np.float32(1.0 - BETA_2)
    scaled = (rates / (1.0 - BETA_1**step)).astype(np.float32)
    none, number = np.zeros(values.shape[1], np.float32), 0
    for i in range(start, stop):
        seen = number < len(chosen) and chosen[number] == i
        slope = slopes[number] if seen else none
        number += seen
        value, mean, square = values[i], first[i], second[i]
        for c in range(len(none)):
            by = slope[c] if abs(slope[c]) < LARGEST else np.float32(0.0)
            m = old_1 * mean[c] + new_1 * by
            m = m if abs(m) > _SMALLEST else np.float32(0.0)
            v = old_2 * square[c] + new_2 * (by * by)
            mean[c] = m
            square[c] = v
            after = value[c] - scaled[c] * m / (np.sqrt(v * root) + EPSILON)
            value[c] = after if abs(after) < np.inf else value[c]


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
