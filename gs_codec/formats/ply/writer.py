"""Write PLY files in the trainer's layout; convert between planes ``(C, N)`` and rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO

import numpy as np
import plyfile
from numpy.typing import NDArray

from gs_codec.runtime.arrays import empty
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.threads import run_all, work_behind
from gs_codec.scene import GROUPS, NORMALS, Scene, property_names

#: Rows moved at once: a tile of 62 columns (1 MB) stays in the second-level cache.
TILE = 4096
_CHUNK = 1 << 16


def to_planes(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Planes ``(C, N)`` of rows ``(N, C)``."""
    planes = empty((rows.shape[1], len(rows)), np.float32)

    def gather(start: int, stop: int) -> None:
        for channel, plane in enumerate(planes):
            plane[start:stop] = rows[start:stop, channel]

    for_tiles(gather, len(rows))
    return planes


def to_rows(planes: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Rows ``(N, C)`` of C planes ``(N,)``."""
    rows = np.empty((len(planes[0]), len(planes)), np.float32)

    def scatter(start: int, stop: int) -> None:
        for channel, plane in enumerate(planes):
            rows[start:stop, channel] = plane[start:stop]

    for_tiles(scatter, len(rows))
    return rows


def for_tiles(move: Callable[[int, int], None], count: int) -> None:
    """Call ``move(start, stop)`` for all of `count` rows, tile by tile, from several threads."""

    def run(start: int) -> None:
        end = min(start + _CHUNK, count)
        for tile in range(start, end, TILE):
            move(tile, min(tile + TILE, end))

    run_all(run, range(0, count, _CHUNK))


#: Rows written at once: 4 MB with SH of degree 3, memory that the C library reuses.
_ROWS = 1 << 14


def write_ply(path: str | Path, scene: Scene) -> tuple[()]:
    """Write `scene` as little-endian binary PLY in the INRIA trainer's property order.

    Returns
    -------
    tuple
        Empty: there are no losses.
    """
    with atomic_writer(path) as file:
        write_vertices(file, scene.count, [scene])
    return ()


def write_vertices(file: BinaryIO, count: int, slabs: Iterable[Scene]) -> None:
    """Write a PLY of `count` Gaussians from slabs of the same layout, one after another.

    With threads, a slab is written while the next one is made.
    """

    def write(number: int, slab: Scene) -> None:
        if not number:
            file.write(ply_header(slab, count))
        for start in range(0, slab.count, _ROWS):
            file.write(vertex_rows(slab.between(start, start + _ROWS)).data)

    work_behind(write, slabs)


def ply_header(scene: Scene, count: int) -> bytes:
    """The header of a PLY of `count` Gaussians with the properties of the scene."""
    row = np.zeros((), vertex_rows(scene.between(0, 0)).dtype)
    element = plyfile.PlyElement.describe(np.broadcast_to(row, (count,)), "vertex")
    header = plyfile.PlyData([element], byte_order="<", comments=list(scene.comments)).header
    return f"{header}\n".encode("ascii")


def vertex_rows(scene: Scene) -> NDArray:
    """Structured rows ``(N,)`` in the trainer's order; extra properties come last."""
    groups = property_names(len(scene.f_rest) // 3)
    names, planes = [], []
    for group in GROUPS:
        names += groups[group]
        planes += [*getattr(scene, group)]
        if group == "positions" and scene.has_normals:
            names += NORMALS
            planes += [np.zeros(scene.count, np.float32)] * 3
    rows = to_rows(planes).view([(name, "<f4") for name in names])[:, 0]
    if not scene.extra:
        return rows
    dtype = np.dtype(rows.dtype.descr + [(n, a.dtype.str) for n, a in scene.extra.items()])
    full = np.empty(scene.count, dtype)
    for name in names:
        full[name] = rows[name]
    for name, column in scene.extra.items():
        full[name] = column
    return full
