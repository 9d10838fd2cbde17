"""Images of a scene, drawn on the CPU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import MissingTool
from gs_codec.kernels import kernel
from gs_codec.rendering import gsplat_backend
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.project import DEPTH, TILE, Splats, project
from gs_codec.rendering.rasterise import draw_tiles
from gs_codec.rendering.tiles import TileLists, list_tiles
from gs_codec.scene import Scene
from gs_codec.workers import available_threads, run_all

_CHUNK = 1 << 14


@dataclass(frozen=True)
class Accumulations:
    """Sums over the pixels a Gaussian was added to, each of shape (N,), in the scene's order.

    Attributes
    ----------
    weight : ndarray, float64
        Of alpha T, its share of the pixel's colour.
    squared_weight : ndarray, float64
        Of (alpha T)^2.
    transmittance : ndarray, float64
        Of T, the transmittance of what is before it.
    pixels : ndarray, int64
        Their number.
    """

    weight: NDArray[np.float64]
    squared_weight: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    pixels: NDArray[np.int64]


@dataclass(frozen=True)
class Rendering:
    """What a camera sees.

    Attributes
    ----------
    colour : ndarray, shape (H, W, 3), float32
        RGB, from 0 up; 1 is white, brighter is possible.
    alpha : ndarray, shape (H, W), float32
        Opacity of everything together, 0-1.
    depth : ndarray, shape (H, W), float32
        Mean distance along the optical axis, weighted by alpha T, scene units; 0 where
        nothing is.
    accumulations : Accumulations or None
        Where asked for.
    pairs : int
        Splat-tile pairs drawn; time grows with it.
    """

    colour: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]
    accumulations: Accumulations | None
    pairs: int


def render(
    scene: Scene,
    camera: Camera,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool | None = None,
    accumulate: bool = False,
    threads: int | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
) -> Rendering:
    """Draw a scene by the rule of the 3DGS rasteriser (Kerbl et al. 2023, Section 6).

    Gaussians of which an attribute is not finite, or the projection, are not drawn. On the CPU
    the same scene and camera give the same floats whatever the number of threads.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    background : sequence of three float
        RGB behind everything.
    antialiased : bool, optional
        Lower the opacity of splats that the low-pass widens (Yu et al. 2023, Mip-Splatting);
        by default as the scene says it was trained.
    accumulate : bool
        Keep sums for each Gaussian; always on the CPU.
    threads : int, optional
        Never changes the result. Default one for each available processor.
    device : {"auto", "cpu", "cuda"}
        ``cuda`` draws with gsplat, within 40 dB or better of the CPU; ``auto`` takes it where
        it is installed and torch sees a device.

    Raises
    ------
    MissingTool
        If ``cuda`` is asked for and not there.
    """
    if antialiased is None:
        antialiased = scene.antialiased
    if device == "cuda" and not gsplat_backend.is_available():
        raise MissingTool("device 'cuda': needs gsplat, and a CUDA device that torch sees")
    if device != "cpu" and not accumulate and gsplat_backend.is_available():
        colour, alpha, depth, pairs = gsplat_backend.draw(scene, camera, background, antialiased)
        return Rendering(colour, alpha, depth, None, pairs)
    threads = threads or available_threads()
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    splats = _sorted_splats(scene, camera, antialiased, threads)
    lists = list_tiles(splats.fields, splats.tiles, columns, rows, threads)
    shape = (camera.height, camera.width)
    colour = np.empty((*shape, 3), np.float32)
    alpha, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    sums = np.zeros((len(lists.splats) if accumulate else 0, 4))
    draw = partial(draw_tiles, splats.fields, *lists)
    images = (columns, np.array(background, np.float64), colour, alpha, depth, sums)
    run_all(lambda part: draw(*part, *images), _parts(columns * rows, 16 * threads), threads)
    accumulations = _gather(scene.count, splats, lists, sums) if accumulate else None
    return Rendering(colour, alpha, depth, accumulations, len(lists.splats))


def _sorted_splats(scene: Scene, camera: Camera, antialiased: bool, threads: int) -> Splats:
    """What the camera sees, nearest first; of equal depths, the first in the scene."""
    starts = range(0, scene.count, _CHUNK)
    parts = run_all(
        lambda start: project(scene, camera, antialiased, start, min(start + _CHUNK, scene.count)),
        starts,
        threads,
    )
    parts.append(project(scene, camera, antialiased, 0, 0))
    fields = np.concatenate([part.fields for part in parts])
    order = np.argsort(fields[:, DEPTH], kind="stable")
    tiles, gaussians = (np.concatenate([part[i] for part in parts])[order] for i in (1, 2))
    return Splats(fields[order], tiles, gaussians)


def _parts(count: int, parts: int) -> list[tuple[int, int]]:
    """Ranges that cover 0 to `count`, about `parts` of them."""
    size = -(-count // parts)
    return [(start, min(start + size, count)) for start in range(0, count, size)]


def _gather(count: int, splats: Splats, lists: TileLists, sums: NDArray) -> Accumulations:
    totals = np.zeros((count, 4))
    _add_pairs(splats.gaussians, lists.splats, sums, totals)
    weight, squared, transmittance, pixels = totals.T
    return Accumulations(weight, squared, transmittance, pixels.astype(np.int64))


@kernel
def _add_pairs(gaussians, splats, sums, totals):
    for pair in range(len(splats)):
        total = totals[gaussians[splats[pair]]]
        for k in range(4):
            total[k] += sums[pair, k]
