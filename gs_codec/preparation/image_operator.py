"""Images as a linear function of SH, and its transpose.

Apart from the clamp of colours at black, an image is linear in SH: a pixel is the sum of the
Gaussians' colours, weighted by alpha T. The rasteriser's trace gives these weights.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.preparation.sh_weights import sh_row
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.traced_view import SQUARED, TraceBuffers, TracedView, trace_view
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import Scene

#: Image ``(H, W, 3)`` of each view.
Images = Sequence[NDArray]

Advance = Callable[[], None] | None

#: Gaussians whose gradient one task adds up.
_CHUNK = 1 << 14

#: Views processed at the same time; each takes about 300 bytes a Gaussian.
_MOST_AT_ONCE = 4

#: Traced views are kept up to this many bytes; the others are traced again each time.
_KEPT_BYTES = 1 << 31


class Linear(NamedTuple):
    """Images linearised at some coefficients.

    Attributes
    ----------
    gradient : ndarray, shape (3, 1 + K, N)
        The transposed operator applied to the residual: minus half the gradient of `error`.
    curvature : ndarray, shape (3, 1 + K, N)
        Diagonal of the normal equations.
    lit : ndarray, shape (views, N), uint8
        Bit 0, 1, 2: whether R, G, B of the Gaussian are above black in the view, if it is seen.
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

    Coefficients are ``(3, 1 + K, N)``, DC first, float32 or float64; results have their dtype.

    Parameters
    ----------
    scene : Scene
        Its colours are not used.
    cameras : sequence of Camera
    background : sequence of three float
    """

    scene: Scene
    cameras: Sequence[Camera]
    background: Sequence[float] = (0.0, 0.0, 0.0)
    kept: dict[int, TracedView] = field(default_factory=dict, init=False, repr=False)
    all_buffers: list[TraceBuffers] = field(default_factory=list, init=False, repr=False)

    def linearise(self, coefficients: NDArray, targets: Images, advance: Advance = None) -> Linear:
        """Linearise all views at `coefficients`; the residual is ``target - image``.

        Raises
        ------
        InvalidInput
            If a target does not have the shape of its camera's image.
        """
        gradient, curvature = np.zeros_like(coefficients), np.zeros_like(coefficients)
        lit = np.zeros((len(self.cameras), self.scene.count), np.uint8)

        def gather(view: int) -> _Gathered:
            target = _target(targets, view, self.cameras[view])
            return self._gather(view, coefficients, lit[view], target)

        error = self._add_up(gather, lit, gradient, curvature, advance)
        return Linear(gradient, curvature, lit, error)

    def errors(
        self,
        coefficients: NDArray,
        targets: Images,
        views: Sequence[int] | None = None,
        advance: Advance = None,
    ) -> NDArray[np.float64]:
        """Squared residual of each of the `views` (default all), summed over pixels and colours."""

        def measure(view: int) -> tuple[TracedView, float]:
            target = _target(targets, view, self.cameras[view])
            lit = np.empty(self.scene.count, np.uint8)
            traced = self._traced(view)
            colours = self._colours(traced, coefficients, lit, clamp=True)
            return traced, traced.error(colours, target, np.array(self.background, np.float64))

        chosen = range(len(self.cameras)) if views is None else views
        errors = []
        for group in self._groups(chosen):
            for view, (traced, error) in zip(
                group, run_all(measure, group, len(group), advance), strict=True
            ):
                errors.append(error)
                self._keep(view, traced)
        return np.array(errors)

    def apply(self, direction: NDArray, lit: NDArray[np.uint8], advance: Advance = None) -> NDArray:
        """Apply the normal equations to a change of SH: the operator, then its transpose."""
        product = np.zeros_like(direction)

        def gather(view: int) -> _Gathered:
            return self._gather(view, direction, lit[view], None)

        self._add_up(gather, lit, product, product[:0], advance)
        return np.negative(product, out=product)

    def _gather(
        self, view: int, coefficients: NDArray, lit: NDArray[np.uint8], target: NDArray | None
    ) -> _Gathered:
        """Apply the transpose to a view's residual; without a target, to minus its change by SH."""
        camera, traced = self.cameras[view], self._traced(view)
        colours = self._colours(traced, coefficients, lit, clamp=target is not None)
        if target is None:
            background = np.zeros(3)
            target = np.zeros((camera.height, camera.width, 3), np.float32)
        else:
            background = np.array(self.background, np.float64)
        return _Gathered(traced, *traced.transpose(colours, target, background))

    def _colours(
        self, traced: TracedView, coefficients: NDArray, lit: NDArray[np.uint8], clamp: bool
    ) -> NDArray[np.float64]:
        """Colours ``(V, 3)`` of the Gaussians that a view sees; see `_fill_colours`."""
        colours = np.empty((len(traced.seen), 3))
        seen = (self.scene.positions, traced.camera.position, traced.seen)
        _fill_colours(*seen, coefficients, clamp, lit, colours)
        return colours

    def _add_up(
        self,
        gather: Callable[[int], _Gathered],
        lit: NDArray[np.uint8],
        gradient: NDArray,
        curvature: NDArray,
        advance: Advance,
    ) -> float:
        """Add views in order to the gradient and, unless empty, curvature; return their error."""
        error = 0.0
        for group in self._groups(range(len(self.cameras))):
            for view, found in zip(group, run_all(gather, group, len(group), advance), strict=True):
                error += found.error
                self._keep(view, found.traced)
                seen, camera = found.traced.seen, self.cameras[view]
                of_view = (self.scene.positions, camera.position, seen, found.sums, lit[view])

                def add(start: int, of_view: tuple = of_view, count: int = len(seen)) -> None:
                    stop = min(start + _CHUNK, count)
                    _add_gradient(*of_view, start, stop, gradient, curvature)

                run_all(add, range(0, len(seen), _CHUNK))
        return error

    def _groups(self, views: Sequence[int]) -> Iterator[Sequence[int]]:
        """Groups of views that are processed together."""
        at_once = min(available_threads(), _MOST_AT_ONCE)
        for first in range(0, len(views), at_once):
            yield views[first : first + at_once]

    def _traced(self, view: int) -> TracedView:
        if view in self.kept:
            return self.kept[view]
        try:
            buffers = self.all_buffers.pop()
        except IndexError:
            buffers = None
        traced, buffers = trace_view(self.scene, self.cameras[view], buffers)
        self.all_buffers.append(buffers)
        return traced

    def _keep(self, view: int, traced: TracedView) -> None:
        taken = sum(known.nbytes for known in self.kept.values())
        if view not in self.kept and taken + traced.nbytes <= _KEPT_BYTES:
            self.kept[view] = traced


class _Gathered(NamedTuple):
    """A view, sums ``(V, 4)`` over its pixels, and its squared error."""

    traced: TracedView
    sums: NDArray[np.float64]
    error: float


def _target(targets: Images, view: int, camera: Camera) -> NDArray:
    target = targets[view]
    if target.shape != (camera.height, camera.width, 3):
        raise InvalidInput(
            f"target {view}: shape {target.shape}, "
            f"expected ({camera.height}, {camera.width}, 3) of camera '{camera.name}'"
        )
    return target


@kernel
def _fill_colours(positions, camera, seen, coefficients, clamp, lit, colours):
    """Fill ``colours (V, 3)``: colours clamped at black, or the change of colours by SH.

    With `clamp`, bits 0-2 of ``lit (N,)`` are set where a colour is above black. Without it they
    are read, because a change of SH does not change a clamped colour.
    """
    row = np.empty(coefficients.shape[1])
    for j in range(len(seen)):
        i = seen[j]
        sh_row(positions, i, camera, row)
        if clamp:
            lit[i] = 0
        for channel in range(3):
            value = 0.5 if clamp else 0.0
            for k in range(len(row)):
                value += row[k] * coefficients[channel, k, i]
            if clamp and value > 0.0:
                lit[i] |= 1 << channel
            colours[j, channel] = value if lit[i] >> channel & 1 else 0.0


@kernel
def _add_gradient(positions, camera, seen, sums, lit, start, stop, gradient, curvature):
    """Add a view's share to ``gradient (3, 1 + K, N)`` and, if it is not empty, `curvature`."""
    row = np.empty(gradient.shape[1])
    for j in range(start, stop):
        if sums[j, SQUARED] == 0.0:
            continue
        i = seen[j]
        sh_row(positions, i, camera, row)
        for channel in range(3):
            if lit[i] >> channel & 1:
                for k in range(len(row)):
                    gradient[channel, k, i] += row[k] * sums[j, channel]
                    if len(curvature):
                        curvature[channel, k, i] += row[k] * row[k] * sums[j, SQUARED]
