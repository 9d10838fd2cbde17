"""A scene projected for one camera, ready for kernels that process its tiles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.rendering.camera import Camera
from gs_codec.rendering.project import DEPTH, TILE, Splats, project
from gs_codec.rendering.tiles import TileLists, list_tiles
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import Scene

_CHUNK = 1 << 14


class Frame(NamedTuple):
    """Splats nearest first, and which of them each tile draws."""

    camera: Camera
    splats: Splats
    lists: TileLists
    columns: int
    rows: int

    @property
    def pairs(self) -> int:
        """Splat-tile pairs."""
        return len(self.lists.splats)

    def over_tiles(self, function: Callable, *arguments: Any) -> None:
        """Run a kernel over all tiles, in threads.

        It is called with ``fields (V, 11)``, the splats of the lists ``(pairs,)``, their starts
        ``(tiles + 1,)``, the first and end tile to work on, the number of tile columns, and
        `arguments`. It may write only to the pixels or pairs of its own tiles.
        """
        tiles = self.columns * self.rows
        size = -(-tiles // (16 * available_threads()))

        def run(first: int) -> None:
            end = min(first + size, tiles)
            function(self.splats.fields, *self.lists, first, end, self.columns, *arguments)

        run_all(run, range(0, tiles, size))

    def sum_pairs(self, count: int, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum ``values (pairs, K)`` over the pairs of each of `count` Gaussians: ``(count, K)``."""
        totals = np.zeros((count, values.shape[1]))
        _sum_pairs(self.splats.gaussians, self.lists.splats, values, totals)
        return totals


def make_frame(scene: Scene, camera: Camera, antialiased: bool | None = None) -> Frame:
    """Project a scene, sort its splats by depth, and list them by tile; see `render`."""
    if antialiased is None:
        antialiased = scene.antialiased
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    splats = _sorted_splats(scene, camera, antialiased)
    lists = list_tiles(splats.fields, splats.tiles, columns, rows)
    return Frame(camera, splats, lists, columns, rows)


def _sorted_splats(scene: Scene, camera: Camera, antialiased: bool) -> Splats:
    """Splats that the camera sees, nearest first; equal depths keep the scene's order."""
    parts = run_all(
        lambda start: project(scene, camera, antialiased, start, min(start + _CHUNK, scene.count)),
        range(0, scene.count, _CHUNK),
    )
    parts.append(project(scene, camera, antialiased, 0, 0))
    fields = np.concatenate([part.fields for part in parts])
    order = np.argsort(fields[:, DEPTH], kind="stable")
    tiles, gaussians = (np.concatenate([part[i] for part in parts])[order] for i in (1, 2))
    return Splats(fields[order], tiles, gaussians)


@kernel
def _sum_pairs(gaussians, splats, values, totals):
    for pair in range(len(splats)):
        total = totals[gaussians[splats[pair]]]
        for k in range(values.shape[1]):
            total[k] += values[pair, k]
