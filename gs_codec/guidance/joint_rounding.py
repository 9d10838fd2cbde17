"""Joint rounding: values move to other levels where the errors of overlapping splats then cancel.

Rounding each value to its nearest level treats the errors as independent, but a pixel shows the sum
of many. So the values move down the gradient of the squared error of views of the *decoded* scene,
as if decoding were the identity (straight-through estimator, Bengio et al. 2013), until their
nearest levels are better ones. Lattices, classes and SH-AC do not change, so the file hardly grows.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.shaped import VALUES, ShapedScene
from gs_codec.coding.axes import sort_axes, with_real_part
from gs_codec.preparation.adam import LARGEST
from gs_codec.preparation.optimise import view_of
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.rendering.gradients import Differentiated, differentiate
from gs_codec.rendering.image_loss import differentiate_squares
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Number of views that a step of the descent sees.
_TOGETHER = 2

#: Number of these steps between two quantisations of the scene.
_EVERY = 4

#: Largest movement in a step of the descent at the start, in step sizes of the quantiser; and the
#: factor on it at the end.
_RATE = 0.05
_LAST = 0.03

#: Derivatives, in units of the change that alone would cancel the error, from which movements
#: approach the largest. Smaller derivatives move a value in proportion, larger ones no further.
_LARGE = np.float32(10.0)

#: Weight of other views, in which each value's distance from where it was adds an error of its own.
#: Without it, values would fit the noise of few or small views.
_ELSEWHERE = np.float32(3.0)

#: Decay of the running means of derivatives and of their squares.
_BETA_1 = 0.9
_BETA_2 = 0.99

#: Groups of values that move, in the order of `_move`.
_MOVING = ("positions", "f_dc", "opacity", "log_scale", "rot")

#: Number of Gaussians that a task moves.
_CHUNK = 1 << 12


def round_jointly(
    shaped: ShapedScene,
    views: ReferenceViews,
    error: float,
    looks: int,
    progress: Progress | None = None,
) -> ShapedScene:
    """Move the values of a scene to better levels.

    Parameters
    ----------
    shaped : ShapedScene
        With its final SH-AC.
    views : ReferenceViews
        With images.
    error : float
        Squared error that a parameter may add, summed over the values of all views: that of its
        step size.
    looks : int
        Number of views to look at, each as often as any other.
    progress : callable, optional
    """
    number = looks // _TOGETHER
    descent = _Descent(shaped, views, error)
    advance = step_counter(progress, "round", number)
    for step in range(number):
        if step and step % _EVERY == 0:
            descent.quantise()
        descent.step(step, _RATE * _LAST ** (step / number))
        advance()
    return shaped.reshaped(shaped.changed_source(descent.source, _MOVING))


class _Descent:
    """The values of a scene, in their first stream order, and their running derivatives."""

    def __init__(self, shaped: ShapedScene, views: ReferenceViews, error: float) -> None:
        self.shaped, self.views = shaped.in_stream_order(), views
        self.first = np.zeros((shaped.source.count, VALUES), np.float32)
        self.second = np.zeros_like(self.first)
        self.moved = np.zeros_like(self.first)
        # Rounding adds s d^2 / 12, with s d^2 the squared error of moving by a step size d.
        self.scale = len(views.cameras) / _TOGETHER / (2 * 12 * error)
        self.source = _by_length(self.shaped.source)
        self.decoded, self.steps = self._decode()

    def quantise(self) -> None:
        """Quantise the current values."""
        self.source = _by_length(self.source)
        self.shaped = self.shaped.reshaped(self.source)
        self.decoded, self.steps = self._decode()

    def _decode(self) -> tuple[Scene, NDArray[np.float32]]:
        """The decoded scene, and step sizes ``(N, 13)``, in the order of the source."""
        shaped, decoded = self.shaped, dict[str, Any]()
        for group, plane in (shaped.decoded_shapes() | {"f_dc": shaped.decoded_dc()}).items():
            decoded[group] = np.empty_like(plane)
            decoded[group][:, shaped.order] = plane
        steps = np.empty((shaped.source.count, VALUES), np.float32)
        steps[shaped.order] = shaped.value_steps().T
        return replace(shaped.source, **decoded), steps

    def step(self, number: int, rate: float) -> None:
        """Move all values by the next views."""
        first = number * _TOGETHER
        order = [view_of(i, len(self.views.cameras)) for i in range(first, first + _TOGETHER)]
        seen = run_all(self._look, order)
        count, source = self.source.count, self.source
        planes = [getattr(source, group) for group in _MOVING]
        decay_1, decay_2 = (1 - beta ** (number + 1) for beta in (_BETA_1, _BETA_2))

        def move(start: int) -> None:
            stop = min(start + _CHUNK, count)
            slopes = np.zeros((stop - start, VALUES), np.float32)
            for view in seen:
                first, end = np.searchsorted(view.chosen, (start, stop))
                own, places = view.slopes(first, end, sh_ac=False), view.chosen[first:end]
                _add(own, places, start, self.decoded.rot, source.rot, slopes)
            _move(
                slopes, self.steps, start, self.first, self.second, self.moved,
                np.float32(self.scale), np.float32(rate / decay_1), np.float32(1 / decay_2),
                *planes,
            )  # fmt: skip

        run_all(move, range(0, count, _CHUNK))

    def _look(self, view: int) -> Differentiated:
        camera, image = self.views.cameras[view], self.views.images[view]
        return differentiate(
            self.decoded, camera, image, self.views.background, differentiate_squares
        )


def _by_length(source: Scene) -> Scene:
    """A copy of the scene in which axes descend, as they do when decoded."""
    _, scales, vectors = sort_axes(source.log_scale, source.rot)
    return replace(
        source,
        positions=source.positions.copy(),
        f_dc=source.f_dc.copy(),
        opacity=source.opacity.copy(),
        log_scale=scales.astype(np.float32),
        rot=with_real_part(vectors).astype(np.float32),
    )


@inlined
def _half_turn(a, b, i):
    """Signs of the axes of quaternion ``a[:, i]`` relative to those of ``b[:, i]``.

    Both describe about the same Gaussian, but may differ by a half turn about one of its axes,
    which reverses the other two.
    """
    aw, ax, ay, az = a[0, i], a[1, i], a[2, i], a[3, i]
    bw, bx, by, bz = b[0, i], b[1, i], b[2, i], b[3, i]
    none = abs(aw * bw + ax * bx + ay * by + az * bz)
    about_x = abs(-ax * bw + aw * bx + az * by - ay * bz)
    about_y = abs(-ay * bw - az * bx + aw * by + ax * bz)
    about_z = abs(-az * bw + ay * bx - ax * by + aw * bz)
    one = np.float32(1.0)
    if none >= max(about_x, about_y, about_z):
        return one, one, one
    if about_x >= max(about_y, about_z):
        return one, -one, -one
    return (-one, one, -one) if about_y >= about_z else (-one, -one, one)


@kernel
def _add(own, places, start, decoded, rot, slopes):
    """Add a view's derivatives of Gaussians `places` to ``slopes (chunk, 13)`` from `start`."""
    half = np.float32(0.5)
    for row in range(len(places)):
        i = places[row]
        slope, total = own[row], slopes[i - start]
        for k in range(10):
            total[k] += slope[k]
        by_w, by_x, by_y, by_z = slope[10], slope[11], slope[12], slope[13]
        w, x, y, z = decoded[0, i], decoded[1, i], decoded[2, i], decoded[3, i]
        one, two, three = _half_turn(decoded, rot, i)
        # A turn by t about the first axis multiplies the quaternion by (1, t / 2, 0, 0).
        total[10] += one * half * (w * by_x - x * by_w + z * by_y - y * by_z)
        total[11] += two * half * (w * by_y - y * by_w + x * by_z - z * by_x)
        total[12] += three * half * (w * by_z - z * by_w + y * by_x - x * by_y)


@kernel
def _move(
    slopes, steps, start, first, second, moved, scale, rate, root,
    positions, f_dc, opacity, log_scale, rot,
):  # fmt: skip
    """Take a step of Adam with a large epsilon, in units of each value's own step size.

    ``slopes (chunk, 13)`` belong to Gaussians from `start` on; the means of derivatives `first` and
    `second`, and what values have `moved` so far, are ``(N, 13)`` like `steps`. `scale` converts a
    derivative by steps to units of the change that alone would cancel the error; `rate` and `root`
    correct the means for their start at 0.
    """
    old_1, new_1 = np.float32(_BETA_1), np.float32(1 - _BETA_1)
    old_2, new_2 = np.float32(_BETA_2), np.float32(1 - _BETA_2)
    by = np.empty(slopes.shape[1], np.float32)
    half = np.float32(0.5)
    for row in range(len(slopes)):
        i = start + row
        step, mean, square = steps[i], first[i], second[i]
        for k in range(len(by)):
            slope = slopes[row, k] * step[k] * scale
            slope = slope if abs(slope) < LARGEST else np.float32(0.0)
            slope += _ELSEWHERE * moved[i, k]
            mean[k] = old_1 * mean[k] + new_1 * slope
            square[k] = old_2 * square[k] + new_2 * slope * slope
            change = rate * mean[k] / (np.sqrt(square[k] * root) + _LARGE)
            moved[i, k] -= change
            by[k] = change * step[k]
        for k in range(3):
            positions[k, i] -= by[k]
            f_dc[k, i] -= by[3 + k]
            log_scale[k, i] -= by[7 + k]
        opacity[0, i] -= by[6]
        w, x, y, z = rot[0, i], rot[1, i], rot[2, i], rot[3, i]
        a, b, c = -half * by[10], -half * by[11], -half * by[12]
        rot[0, i] = w - x * a - y * b - z * c
        rot[1, i] = x + w * a + y * c - z * b
        rot[2, i] = y + w * b + z * a - x * c
        rot[3, i] = z + w * c + x * b - y * a
