"""The up direction: an axis by name, or derived from cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import UP_AXES
from gs_codec.errors import InvalidInput

#: Unit vectors of `UP_AXES`, by name.
UPS: dict[str, NDArray[np.float64]] = {
    name: np.eye(3)["xyz".index(name[-1])] * (-1 if len(name) > 1 else 1) for name in UP_AXES
}

#: Name of the up axis derived from cameras, given or estimated.
BY_CAMERAS = "cameras"

#: Message if the up axis of a scene is not certain.
UNSURE = "cameras 'auto': the up axis is uncertain; choose an axis (up), or give its cameras"

#: Minimum mean square of right axes along a direction that is not level.
_LOOSE = 1e-3


def up_axis(name: str) -> NDArray[np.float64]:
    """The unit vector of an up axis, by name.

    Raises InvalidInput if there is no axis of that name.
    """
    if name not in UPS:
        raise InvalidInput(f"up '{name}': expected {', '.join(UPS)}")
    return UPS[name]


def up_of(rotations: Sequence[NDArray]) -> NDArray[np.float64]:
    """The up vector of upright cameras with these rotations, orthogonal to their right axes.

    If that is ambiguous, as for cameras that look in one direction, it is the one nearest to their
    own up.
    """
    right, down, _ = np.moveaxis(np.array(rotations), 1, 0)
    level = right.T @ right / len(right)
    up = -np.linalg.solve(level + _LOOSE * np.eye(3), down.mean(axis=0))
    if not np.linalg.norm(up) > _LOOSE:
        up = np.linalg.eigh(level)[1][:, 0]
    return up / np.linalg.norm(up)
