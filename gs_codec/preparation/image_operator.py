"""Images as a linear function of SH, and its transpose.

Apart from the clamp of colours at black, an image is linear in SH: a pixel is the sum of the
Gaussians' colours, weighted by alpha T. The rasteriser's trace gives these weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.ycocg import luma_chroma, red_green_blue
from gs_codec.preparation.reference_views import ReferenceViews, evenly
from gs_codec.preparation.sh_weights import sh_row
from gs_codec.rendering.traced_view import SQUARED, TraceBuffers, TracedView, trace_view
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import LANES
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import SH_C0, Scene

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


class Places(NamedTuple):
    """Which coefficients ``(N, 3, 1 + K)`` may differ from 0: M of them, in order; all SH-DC may.

    Attributes
    ----------
    starts : ndarray, shape (3 N + 1,), int64
        Start of those of each Gaussian and colour.
    numbers : ndarray, shape (M,), uint8
        The number of each, 0 to K.
    """

    starts: NDArray[np.int64]
    numbers: NDArray[np.uint8]

    @classmethod
    def of(cls, used: NDArray[np.bool_]) -> Places:
        """The places where ``used (N, 3, 1 + K)`` is true, as it must be for SH-DC."""
        starts = np.empty(3 * len(used) + 1, np.int64)
        numbers = np.empty(np.count_nonzero(used), np.uint8)
        _list_places(used.reshape(3 * len(used), used.shape[2]), starts, numbers)
        return cls(starts, numbers)


class Linear(NamedTuple):
    """Images linearised at some coefficients.

    Attributes
    ----------
    gradient : ndarray, shape (M,)
        The transposed operator applied to the residual: minus half the gradient of the error.
    curvature : ndarray, shape (M,)
        Diagonal of the normal equations.
    lit : ndarray, shape (views, N), uint8
        Bit 0, 1, 2: whether R, G, B of a visible Gaussian are above black in the view.
    errors : ndarray, shape (views,)
        Squared residual of each view, summed over pixels and colours.
    """

    gradient: NDArray
    curvature: NDArray
    lit: NDArray[np.uint8]
    errors: NDArray[np.float64]


@dataclass(frozen=True)
class ImageOperator:
    """Images of a scene as a function of its SH; its other attributes are fixed.

    Coefficients ``(M,)`` are those of `coefficients_of` at some places, float32 or float64; results
    have their dtype. The others are 0.

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

    def linearise(self, coefficients: NDArray, places: Places, advance: Advance = None) -> Linear:
        """Linearise all views at `coefficients`."""
        gradient, curvature = np.zeros_like(coefficients), np.zeros_like(coefficients)
        lit = np.zeros((len(self.views.cameras), self.scene.count), np.uint8)
        errors = self._add_up(coefficients, places, lit, True, gradient, curvature, advance)
        return Linear(gradient, curvature, lit, errors)

    def errors(
        self,
        coefficients: NDArray,
        places: Places,
        chosen: Sequence[int],
        advance: Advance = None,
        lit: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.float64]:
        """Squared residual of each of the `chosen` views, summed over pixels and colours.

        With `lit`, `coefficients` are a change of SH, and the squared change of each view results.
        """

        def measure(view: int, traced: TracedView) -> float:
            own = np.empty(self.scene.count, np.uint8) if lit is None else lit[view]
            clamp = lit is None
            found = self._residual(view, traced, coefficients, places, own, clamp, summed=False)
            return found[1]

        return np.array([error for *_, error in self._of_each(measure, chosen, advance)])

    def pixels(self, view: int) -> int:
        """Number of pixels of a view that count, once it is traced."""
        return self.kept[view].pixels

    def apply(
        self, direction: NDArray, places: Places, lit: NDArray[np.uint8], advance: Advance = None
    ) -> tuple[NDArray, NDArray[np.float64]]:
        """Apply the normal equations to a change of SH: the operator, then its transpose.

        Also returns the squared change of each view.
        """
        product = np.zeros_like(direction)
        squares = self._add_up(direction, places, lit, False, product, product[:0], advance)
        return product, squares

    def _residual(
        self,
        view: int,
        traced: TracedView,
        coefficients: NDArray,
        places: Places,
        lit: NDArray[np.uint8],
        clamp: bool,
        summed: bool = True,
    ) -> tuple[NDArray[np.float64], float]:
        """Residual of a view, as `TracedView.residual`; without `clamp`, its change by SH."""
        colours = np.empty((len(traced.seen), 3), np.float32)
        seen = (self.scene.positions, traced.camera.position, traced.seen)
        _fill_colours(*seen, coefficients, *places, clamp, lit, colours)
        target, background = self.views.images[view], np.array(self.views.background, np.float64)
        if not clamp:
            target, background = np.zeros_like(target), np.zeros(3)
        return traced.residual(colours, target, background, summed=summed, faint=clamp)

    def _add_up(
        self,
        coefficients: NDArray,
        places: Places,
        lit: NDArray[np.uint8],
        clamp: bool,
        gradient: NDArray,
        curvature: NDArray,
        advance: Advance,
    ) -> NDArray[np.float64]:
        """Add views in order to the gradient and, unless empty, curvature; return their errors."""

        def gather(view: int, traced: TracedView) -> tuple[NDArray[np.float64], float]:
            return self._residual(view, traced, coefficients, places, lit[view], clamp)

        errors = np.empty(len(lit))
        for view, traced, (sums, error) in self._of_each(gather, range(len(lit)), advance):
            errors[view] = error
            count = len(traced.seen)
            of_view = (self.scene.positions, traced.camera.position, traced.seen, sums, lit[view])

            def add(start: int, of_view: tuple = of_view, count: int = count) -> None:
                stop = min(start + _CHUNK, count)
                _add_gradient(*of_view, start, stop, *places, gradient, curvature)

            run_all(add, range(0, count, _CHUNK))
        return errors

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
    def _plain(self) -> Scene:
        """The scene without SH-AC, which tracing does not need; not finite where they are not."""
        finite = np.isfinite(self.scene.f_rest).all(axis=0)
        f_dc = np.where(finite, self.scene.f_dc, np.float32(np.nan))
        return replace(self.scene, f_dc=f_dc, f_rest=self.scene.f_rest[:0])

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
        traced, buffers = trace_view(self._plain, self.views.cameras[view], every, view, buffers)
        self.all_buffers.append(buffers)
        return traced


@kernel
def _list_places(used, starts, numbers):
    count = 0
    for row in range(len(used)):
        starts[row] = count
        for k in range(used.shape[1]):
            if used[row, k]:
                numbers[count] = k
                count += 1
    starts[len(used)] = count


@inlined
def _has_ac(positions, i, camera, starts, numbers, row):
    """Whether Gaussian i has SH-AC; then ``row (16,)`` is filled with the SH basis it needs."""
    if starts[3 * i + 3] - starts[3 * i] == 3:
        return False
    last = 0
    for channel in range(3):
        last = max(last, np.int64(numbers[starts[3 * i + channel + 1] - 1]))
    size = 4 if last < 4 else 9 if last < 9 else 16
    sh_row(positions, i, camera, row[:size])
    return True


@kernel
def _fill_colours(positions, camera, seen, coefficients, starts, numbers, clamp, lit, colours):
    """Fill ``colours (V, 3)``: colours clamped at black, or minus the change of colours by SH.

    With `clamp`, bits 0-2 of ``lit (N,)`` are set where a colour is above black. Without it they
    are read, because a change of SH does not change a clamped colour.
    """
    row, values = np.empty(LANES), np.empty(3)
    for j in range(len(seen)):
        i = seen[j]
        first = starts[3 * i]
        if not _has_ac(positions, i, camera, starts, numbers, row):
            for channel in range(3):
                values[channel] = SH_C0 * coefficients[first + channel]
        else:
            for channel in range(3):
                value = 0.0
                for m in range(starts[3 * i + channel], starts[3 * i + channel + 1]):
                    value += row[numbers[m]] * coefficients[m]
                values[channel] = value
        values[0], values[1], values[2] = red_green_blue(values[0], values[1], values[2])
        if clamp:
            lit[i] = 0
        for channel in range(3):
            value = values[channel] + 0.5 if clamp else -values[channel]
            if clamp and value > 0.0:
                lit[i] |= 1 << channel
            colours[j, channel] = value if lit[i] >> channel & 1 else 0.0


@kernel
def _add_gradient(
    positions, camera, seen, sums, lit, start, stop, starts, numbers, gradient, curvature
):
    """Add a view's part to ``gradient (M,)`` and, unless empty, `curvature`."""
    row, of_colour, of_square = np.empty(LANES), np.empty(3), np.empty(3)
    for j in range(start, stop):
        square = sums[j, SQUARED]
        i = seen[j]
        if square == 0.0 or lit[i] == 0:
            continue
        red, green, blue = lit[i] & 1, lit[i] >> 1 & 1, lit[i] >> 2
        of_colour[0], of_colour[1], of_colour[2] = luma_chroma(
            sums[j, 0] * red, sums[j, 1] * green, sums[j, 2] * blue
        )
        of_square[0] = square * (red + green + blue) / 3.0
        of_square[1] = square * (red + blue) / 2.0
        of_square[2] = square * (red + 4.0 * green + blue) / 6.0
        if not _has_ac(positions, i, camera, starts, numbers, row):
            first = starts[3 * i]
            for channel in range(3):
                gradient[first + channel] += SH_C0 * of_colour[channel]
                if len(curvature):
                    curvature[first + channel] += SH_C0 * SH_C0 * of_square[channel]
            continue
        for channel in range(3):
            for m in range(starts[3 * i + channel], starts[3 * i + channel + 1]):
                value = row[numbers[m]]
                gradient[m] += value * of_colour[channel]
                if len(curvature):
                    curvature[m] += value * value * of_square[channel]
