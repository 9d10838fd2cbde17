"""A traced view: the weight alpha T of every Gaussian in every pixel that it is added to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.rendering.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import TILE
from gs_codec.rendering.trace import tile_bounds, tile_buffers, trace_splat
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene

#: Column of (alpha T)^2 in the sums over pixels, after R, G, B.
SQUARED = 3

#: Weights are kept in 16 bits: to 1/500 of what an image of 8 bits shows.
_UNITS = 65535.0

_PIXELS = TILE * TILE
_GREEN, _BLUE = np.uint64(_PIXELS), np.uint64(2 * _PIXELS)

#: Initial size of the buffers, entries; at least those of one splat in a tile.
_FIRST_ENTRIES = 1 << 16


class TracedView(NamedTuple):
    """Weights of a view, by splat-tile pair; the pairs of a tile are nearest first.

    Attributes
    ----------
    camera : Camera
    seen : ndarray, shape (V,), int64
        Gaussians that may be seen, ascending.
    pairs : ndarray, shape (pairs,), int32
        Index in `seen` of each pair's Gaussian.
    starts : ndarray, shape (tiles + 1,), int64
        Where the pairs of each tile start.
    ends : ndarray, shape (pairs,), int64
        Where the entries of each pair end.
    pixels : ndarray, shape (entries,), uint8
        Pixel in the tile.
    weights : ndarray, shape (entries,), uint16
        In units of 1 / 65535.
    left : ndarray, shape (tiles, 256), float32
        Transmittance of each pixel behind all splats.
    """

    camera: Camera
    seen: NDArray[np.int64]
    pairs: NDArray[np.int32]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    pixels: NDArray[np.uint8]
    weights: NDArray[np.uint16]
    left: NDArray[np.float32]

    @property
    def nbytes(self) -> int:
        """Memory it takes."""
        return sum(array.nbytes for array in self[1:])

    def residual(
        self,
        colours: NDArray[np.float64],
        target: NDArray,
        background: NDArray[np.float64],
        summed: bool,
    ) -> tuple[NDArray[np.float64], float]:
        """Sums ``(V, 4)`` of alpha T times the residual and of (alpha T)^2, and the squared error.

        Parameters
        ----------
        colours : ndarray, shape (V, 3)
            Of the Gaussians in ``seen``.
        target : ndarray, shape (H, W, 3)
            The residual is this minus the image.
        background : ndarray, shape (3,)
        summed : bool
            Whether to sum; without, the sums are empty, and it takes half the time.
        """
        sums = np.zeros((len(self.seen) if summed else 0, SQUARED + 1))
        columns = -(-self.camera.width // TILE)
        return sums, _residual(*self[2:], columns, colours, target, background, sums)


#: Pixels and weights of entries, reused because new memory takes longer than tracing.
TraceBuffers = tuple[NDArray[np.uint8], NDArray[np.uint16]]


def trace_view(
    scene: Scene, camera: Camera, buffers: TraceBuffers | None = None
) -> tuple[TracedView, TraceBuffers]:
    """Trace a view, see `render`; and the buffers that took, for the next."""
    frame = make_frame(scene, camera)
    order = np.argsort(frame.splats.gaussians)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    ends = np.zeros(frame.pairs, np.int64)
    left = np.zeros((frame.columns * frame.rows, TILE * TILE), np.float32)
    size = (frame.columns, camera.width, camera.height)
    if buffers is None:
        buffers = np.empty(_FIRST_ENTRIES, np.uint8), np.empty(_FIRST_ENTRIES, np.uint16)
    buffers = _trace(frame.splats.fields, *frame.lists, *size, left, ends, *buffers)
    pixels, weights = buffers
    used = ends.max(initial=0)
    traced = TracedView(
        camera,
        frame.splats.gaussians[order],
        rank[frame.lists.splats],
        frame.lists.starts,
        ends,
        pixels[:used].copy(),
        weights[:used].copy(),
        left,
    )
    return traced, buffers


@kernel
def _trace(fields, splats, starts, columns, width, height, left_of, ends, pixels, weights):
    """Fill the outputs; return `pixels` and `weights`, which are enlarged if needed."""
    left, traced, alphas, before = tile_buffers()
    used = 0
    for tile in range(len(starts) - 1):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        left[:] = 1.0
        still_open = (x1 - x0) * (y1 - y0)
        for pair in range(starts[tile], starts[tile + 1]):
            if still_open > 0:
                field = fields[splats[pair]]
                count, done = trace_splat(field, x0, x1, y0, y1, left, traced, alphas, before)
                still_open -= done
                if used + count > len(pixels):
                    pixels = np.concatenate((pixels, np.empty_like(pixels)))
                    weights = np.concatenate((weights, np.empty_like(weights)))
                for i in range(count):
                    pixels[used] = traced[i]
                    weights[used] = np.uint16(_UNITS * alphas[i] * before[i] + 0.5)
                    used += 1
            ends[pair] = used
        for pixel in range(len(left)):
            left_of[tile, pixel] = abs(left[pixel])
    return pixels, weights


@kernel
def _residual(
    pairs, starts, ends, pixels, weights, left, columns, colours, target, background, sums
):
    """Fill ``sums (V, 4)``, if it is not empty; returns the squared error."""
    height, width = target.shape[:2]
    # Red, green and blue, one after another. Indices are unsigned, so that numba does not test each
    # for being negative.
    residual = np.zeros(3 * _PIXELS)
    error = 0.0
    start = 0
    for tile in range(len(starts) - 1):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        residual[:] = 0.0
        for y in range(y0, y1):
            for x in range(x0, x1):
                pixel = (y - y0) * TILE + x - x0
                for channel in range(3):
                    behind = left[tile, pixel] * background[channel]
                    residual[pixel + channel * _PIXELS] = target[y, x, channel] - behind
        first = start
        for pair in range(starts[tile], starts[tile + 1]):
            red, green, blue = colours[pairs[pair]] / _UNITS
            for j in range(start, ends[pair]):
                pixel, weight = np.uint64(pixels[np.uint64(j)]), np.float64(weights[np.uint64(j)])
                residual[pixel] -= weight * red
                residual[pixel + _GREEN] -= weight * green
                residual[pixel + _BLUE] -= weight * blue
            start = ends[pair]
        error += np.sum(residual * residual)
        if len(sums) == 0:
            continue
        start = first
        for pair in range(starts[tile], starts[tile + 1]):
            red = green = blue = squared = 0.0
            for j in range(start, ends[pair]):
                pixel, weight = np.uint64(pixels[np.uint64(j)]), np.float64(weights[np.uint64(j)])
                red += weight * residual[pixel]
                green += weight * residual[pixel + _GREEN]
                blue += weight * residual[pixel + _BLUE]
                squared += weight * weight
            total = sums[pairs[pair]]
            total[0] += red / _UNITS
            total[1] += green / _UNITS
            total[2] += blue / _UNITS
            total[SQUARED] += squared / _UNITS**2
            start = ends[pair]
    return error
