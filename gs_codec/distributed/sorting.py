"""Sort Gaussians of spans into one order, without holding all of them in memory.

Each span is sorted by itself (a *run*). Cuts are found in the sorted codes of all runs, such that a
*chunk* of consecutive blocks is a slice of each run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import PositionGrid, grid_codes
from gs_codec.coding.morton import canonical_order
from gs_codec.distributed.folder import Folder
from gs_codec.formats.ply.writer import to_planes, to_rows
from gs_codec.scene import GROUPS, Scene, group_rows


def save_run(folder: Folder, number: int, scene: Scene, grid: PositionGrid) -> None:
    """Sort a span's Gaussians by `grid_codes`, and save them with their codes."""
    codes = grid_codes(scene.positions, grid)
    order = canonical_order(codes)
    folder.save_mapped(f"codes-{number}", codes[order])
    # Gathering rows is faster than gathering planes value by value.
    folder.save_mapped(_rows(number), np.take(to_rows(planes_of(scene)), order, axis=0))
    folder.save(f"sort-{number}", {})


def _rows(number: int) -> str:
    return f"rows-{number}"


def find_cuts(folder: Folder, runs: int, ranks: Sequence[int], bits: int) -> NDArray[np.int64]:
    """Cuts of each run, ``(runs, R)``, such that `rank` Gaussians in total come before each cut.

    The order is by code (of `bits` bits), then by span, then the sorted order within a span.
    """
    codes = [folder.mapped(f"codes-{number}") for number in range(runs)]

    def below(values: NDArray[np.int64], side: str = "left") -> NDArray[np.int64]:
        return np.stack([np.searchsorted(run, values, side) for run in codes])  # type: ignore[call-overload]

    # The largest code with at most `rank` Gaussians below it.
    wanted = np.array(ranks, np.int64)
    found = np.zeros(len(wanted), np.int64)
    for bit in range(bits - 1, -1, -1):
        higher = found | (1 << bit)
        found = np.where(below(higher).sum(axis=0) <= wanted, higher, found)
    first = below(found)
    ties = below(found, "right") - first
    # Among equal codes, those of earlier spans come first.
    before = np.cumsum(ties, axis=0) - ties
    return first + np.clip(wanted - first.sum(axis=0) - before, 0, ties)


def load_chunk(
    folder: Folder, begins: NDArray[np.int64], ends: NDArray[np.int64], head: Scene
) -> tuple[Scene, NDArray[np.int64]]:
    """The Gaussians from one cut of all runs up to the next, in order, and their codes."""
    slices = [(n, slice(a, b)) for n, (a, b) in enumerate(zip(begins, ends, strict=True)) if a < b]
    codes = np.concatenate([folder.mapped(f"codes-{number}")[span] for number, span in slices])
    rows = np.concatenate([folder.mapped(_rows(number))[span] for number, span in slices])
    order = canonical_order(codes)
    return scene_of_rows(np.take(rows, order, axis=0), head), codes[order]


def planes_of(scene: Scene) -> list[NDArray[np.float32]]:
    """The planes of a scene, group by group."""
    return [plane for group in GROUPS for plane in getattr(scene, group)]


def scene_of_rows(rows: NDArray[np.float32], head: Scene) -> Scene:
    """The scene whose planes are the columns of ``rows (N, C)``; the rest is that of `head`."""
    planes = to_planes(rows)
    sizes = group_rows(len(head.f_rest) // 3)
    ends = np.cumsum([sizes[group] for group in GROUPS])[:-1]
    groups: dict[str, Any] = dict(zip(GROUPS, np.split(planes, ends), strict=True))
    return replace(head, **groups)
