"""Images as a linear function of SH, and its transpose.

Apart from the clamp of colours at black, an image is linear in SH: a pixel is the sum of the
Gaussians' colours, weighted by alpha T. The rasteriser's trace gives these weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.ycocg import luma_chroma, red_green_blue
from gs_codec.preparation.reference_views import ReferenceViews, evenly
from gs_codec.preparation.sh_weights import sh_row
from gs_codec.rendering.traced_view import SQUARED, TraceBuffers, TracedView, trace_view
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import Scene

Advance = Callable[[], None] | None
Result = TypeVar("Result")

#: Number of Gaussians whose gradient one task sums.
_CHUNK = 1 << 14

#: Views processed at the same time; each takes about 300 bytes per Gaussian.
_MOST_AT_ONCE = 4

#: Approximate maximum bytes of all traced views; beyond it, some of their tiles are skipped.
_KEPT_BYTES = 1 << 30

#: Number of views used to estimate the bytes of one.
_SAMPLE = 8


class Linear(NamedTuple):
    """Images linearised at some coefficients.

    Attributes
    ----------
    gradient : ndarray, shape (N, 3, 1 + K)
        The transposed operator applied to the residual: minus half the gradient of `error`.
    curvature : ndarray, shape (N, 3, 1 + K)
        Diagonal of the normal equations.
    lit : ndarray, shape (views, N), uint8
        Bit 0, 1, 2: whether R, G, B of a visible Gaussian are above black in the view.
    error : float
        Sum over views, pixels and colours of the squared residual.
    """

    gradient: NDArray
    curvature: NDArray
    lit: NDArray[np.uint8]
    error: float


@dataclass(frozen=True)
class ImageOperator:
    """Images of a scene as a function of its SH; its other attributes are fixed.

    Coefficients are those of `coefficients_of`, Y, Co, Cg ``(N, 3, 1 + K)``, float32 or float64;
    results have their dtype.

    Parameters
    ----------
    scene : Scene
        The scene; its colours are not used.
    views : ReferenceViews
        A residual is ``reference - image``.
    """

    scene: Scene
    views: ReferenceViews
    kept: dict[int, TracedView] = field(default_factory=dict, init=False, repr=False)
    all_buffers: list[TraceBuffers] = field(default_factory=list, init=False, repr=False)

    def linearise(self, coefficients: NDArray, advance: Advance = None) -> Linear:
        """Linearise all views at `coefficients`."""
        gradient, curvature = np.zeros_like(coefficients), np.zeros_like(coefficients)
        lit = np.zeros((len(self.views.cameras), self.scene.count), np.uint8)
        error = self._add_up(coefficients, lit, True, gradient, curvature, advance)
        return Linear(gradient, curvature, lit, error)

    def errors(
        self, coefficients: NDArray, chosen: Sequence[int], advance: Advance = None
    ) -> NDArray[np.float64]:
        """Squared residual of each of the `chosen` views, summed over pixels and colours."""

        def measure(view: int, traced: TracedView) -> float:
            lit = np.empty(self.scene.count, np.uint8)
            return self._residual(view, traced, coefficients, lit, clamp=True, summed=False)[1]

        return np.array([error for *_, error in self._of_each(measure, chosen, advance)])

    def pixels(self, view: int) -> int:
        """Number of pixels of a view that count, once it is traced."""
        return self.kept[view].pixels

    def apply(self, direction: NDArray, lit: NDArray[np.uint8], advance: Advance = None) -> NDArray:
        """Apply the normal equations to a change of SH: the operator, then its transpose."""
        product = np.zeros_like(direction)
        self._add_up(direction, lit, False, product, product[:0], advance)
        return np.negative(product, out=product)

    def _residual(
        self,
        view: int,
        traced: TracedView,
        coefficients: NDArray,
        lit: NDArray[np.uint8],
        clamp: bool,
        summed: bool = True,
    ) -> tuple[NDArray[np.float64], float]:
        """Residual of a view, as `TracedView.residual`; without `clamp`, minus its change by SH."""
        colours = np.empty((len(traced.seen), 3), np.float32)
        seen = (self.scene.positions, traced.camera.position, traced.seen)
        _fill_colours(*seen, coefficients, clamp, lit, colours)
        target, background = self.views.images[view], np.array(self.views.background, np.float64)
        if not clamp:
            target, background = np.zeros_like(target), np.zeros(3)
        return traced.residual(colours, target, background, summed=summed, faint=clamp)

    def _add_up(
        self,
        coefficients: NDArray,
        lit: NDArray[np.uint8],
        clamp: bool,
        gradient: NDArray,
        curvature: NDArray,
        advance: Advance,
    ) -> float:
        """Add views in order to the gradient and, unless empty, curvature; return their error."""

        def gather(view: int, traced: TracedView) -> tuple[NDArray[np.float64], float]:
            return self._residual(view, traced, coefficients, lit[view], clamp)

        total = 0.0
        for view, traced, (sums, error) in self._of_each(gather, range(len(lit)), advance):
            total += error
            count = len(traced.seen)
            of_view = (self.scene.positions, traced.camera.position, traced.seen, sums, lit[view])

            def add(start: int, of_view: tuple = of_view, count: int = count) -> None:
                stop = min(start + _CHUNK, count)
                _add_gradient(*of_view, start, stop, gradient, curvature)

            run_all(add, range(0, count, _CHUNK))
        return total

    def _of_each(
        self, function: Callable[[int, TracedView], Result], chosen: Sequence[int], advance: Advance
    ) -> Iterator[tuple[int, TracedView, Result]]:
        """Call a function for the `chosen` views, a few in parallel; yield its results in order."""
        every = self._every

        def run(view: int) -> tuple[int, TracedView, Result]:
            if view not in self.kept:
                self.kept[view] = self._trace(view, every)
            traced = self.kept[view]
            return view, traced, function(view, traced)

        at_once = min(2 * available_threads(), _MOST_AT_ONCE)
        for first in range(0, len(chosen), at_once):
            yield from run_all(run, chosen[first : first + at_once], advance=advance)

    @cached_property
    def _every(self) -> int:
        """Trace every n-th tile of a view, so that all views fit into memory; returns n."""
        count = len(self.views.cameras)
        some = evenly(range(count), _SAMPLE)
        traced = run_all(lambda view: self._trace(view, 1), some)
        taken = sum(each.nbytes for each in traced) / max(len(some), 1) * count
        every = max(1, math.ceil(taken / _KEPT_BYTES))
        if every == 1:
            self.kept.update(zip(some, traced, strict=True))
        return every

    def _trace(self, view: int, every: int) -> TracedView:
        try:
            buffers = self.all_buffers.pop()
        except IndexError:
            buffers = None
        traced, buffers = trace_view(self.scene, self.views.cameras[view], every, view, buffers)
        self.all_buffers.append(buffers)
        return traced


@kernel
def _fill_colours(positions, camera, seen, coefficients, clamp, lit, colours):
    """Fill ``colours (V, 3)``: colours clamped at black, or the change of colours by SH.

    With `clamp`, bits 0-2 of ``lit (N,)`` are set where a colour is above black. Without it they
    are read, because a change of SH does not change a clamped colour.
    """
    row, values = np.empty(coefficients.shape[2]), np.empty(3)
    for j in range(len(seen)):
        i = seen[j]
        sh_row(positions, i, camera, row)
        values[:] = 0.0
        for channel in range(3):
            for k in range(len(row)):
                values[channel] += row[k] * coefficients[i, channel, k]
        values[0], values[1], values[2] = red_green_blue(values[0], values[1], values[2])
        if clamp:
            lit[i] = 0
        for channel in range(3):
            value = values[channel] + (0.5 if clamp else 0.0)
            if clamp and value > 0.0:
                lit[i] |= 1 << channel
            colours[j, channel] = value if lit[i] >> channel & 1 else 0.0


@kernel
def _add_gradient(positions, camera, seen, sums, lit, start, stop, gradient, curvature):
    """Add a view's part to ``gradient (N, 3, 1 + K)`` and, unless empty, `curvature`."""
    row, of_colour, of_square = np.empty(gradient.shape[2]), np.empty(3), np.empty(3)
    for j in range(start, stop):
        square = sums[j, SQUARED]
        i = seen[j]
        if square == 0.0 or lit[i] == 0:
            continue
        sh_row(positions, i, camera, row)
        red, green, blue = lit[i] & 1, lit[i] >> 1 & 1, lit[i] >> 2
        of_colour[0], of_colour[1], of_colour[2] = luma_chroma(
            sums[j, 0] * red, sums[j, 1] * green, sums[j, 2] * blue
        )
        of_square[0] = square * (red + green + blue) / 3.0
        of_square[1] = square * (red + blue) / 2.0
        of_square[2] = square * (red + 4.0 * green + blue) / 6.0
        for channel in range(3):
            for k in range(len(row)):
                gradient[i, channel, k] += row[k] * of_colour[channel]
                if len(curvature):
                    curvature[i, channel, k] += row[k] * row[k] * of_square[channel]
