"""What `inspect` shows for scenes of formats other than `.egs`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gs_codec.egs.sections import Box
from gs_codec.formats.registry import open_scene
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Overview:
    """Summary of a scene.

    Attributes
    ----------
    format : str
        ``ply``, ``compressed ply``, ``splat``, ``spz`` or ``sog``.
    count : int
        Number of Gaussians.
    sh_degree : int
        0-3.
    bounds : tuple of two tuples of float, or None
        Lowest and highest x, y, z of the finite centres; None if there are none.
    coordinates : str or None
        Directions of x, y and z as three letters (such as ``RUB``), if the file or its format
        states them.
    antialiased : bool
        Whether it asks for opacity compensation.
    extra : tuple of str
        Extra properties.
    file_bytes, raw_bytes : int
        Bytes of all its files, and of the attributes as float32.
    """

    format: str
    count: int
    sh_degree: int
    bounds: Box | None
    coordinates: str | None
    antialiased: bool
    extra: tuple[str, ...]
    file_bytes: int
    raw_bytes: int

    def as_dict(self) -> dict:
        """The same as plain types, for JSON."""
        return asdict(self)


def overview_of(path: str | Path, max_bytes: int | None = None) -> Overview:
    """Read a scene of any format but `.egs`, and summarise it; `max_bytes` is as in `read_ply`.

    Raises
    ------
    InvalidInput
        If it is not a valid file of a supported format.
    """
    with open_scene(path) as file:
        scene, file_bytes = file.scene("keep", max_bytes), file.stored_bytes
        name = "compressed ply" if file.format == "ply" and file.is_compressed else file.format
    return Overview(
        name,
        scene.count,
        scene.sh_degree,
        _bounds_of(scene),
        scene.coordinates,
        scene.antialiased,
        tuple(scene.extra),
        file_bytes,
        scene.float_bytes,
    )


def _bounds_of(scene: Scene) -> Box | None:
    finite = scene.positions[:, np.isfinite(scene.positions).all(axis=0)]
    if not finite.size:
        return None
    low, high = finite.min(axis=1).tolist(), finite.max(axis=1).tolist()
    return tuple(low), tuple(high)
