"""Errors between two versions of a scene, by attribute; the result of `compare`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.metrics.image_quality import View, mean_quality
from gs_codec.metrics.shape_errors import differences, shape_errors
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene


@dataclass(frozen=True)
class GroupError:
    """Errors of one attribute, over all its components.

    Attributes
    ----------
    name : str
        The attribute, ``scaling`` for log-scales.
    unit : str
        Unit of both errors: ``scene units``, ``SH``, ``logit``, ``0-1``, ``log``, ``stored``
        (components of quaternions) or ``degrees``.
    max : float
        Maximum absolute error.
    rms : float
        Root mean square.
    """

    name: str
    unit: str
    max: float
    rms: float


@dataclass(frozen=True)
class Comparison:
    """Comparison of two scenes: errors by attribute, or of rendered views.

    Attributes
    ----------
    counts : tuple of two int
        Number of Gaussians of each scene.
    matched_by : str or None
        ``stored order``, ``index``, ``Morton order`` or ``nearest centre``; None with cameras,
        which need no matching.
    groups : tuple of GroupError
        Errors by attribute, empty with cameras. Opacity and rotation appear twice, in two
        units.
    views : tuple of View
        Comparison of each view, in the cameras' order; empty without cameras.
    systems : tuple of two str
        Coordinate systems of the two files; if they differ, one scene was converted.
    backbone : str or None
        Network used for LPIPS; values of different networks are not comparable. None if LPIPS was
        not measured.
    """

    counts: tuple[int, int]
    matched_by: str | None = None
    groups: tuple[GroupError, ...] = ()
    views: tuple[View, ...] = ()
    systems: tuple[str, str] = (CONVENTION, CONVENTION)
    backbone: str | None = None

    @property
    def mean(self) -> View:
        """Means over the views.

        Raises
        ------
        InvalidInput
            If there are no views.
        """
        self._check_views()
        between = mean_quality([view.between for view in self.views])
        first = [view.first for view in self.views if view.first]
        second = [view.second for view in self.views if view.second]
        if not (first and second):
            return View("mean", between)
        return View("mean", between, mean_quality(first), mean_quality(second))

    @property
    def worst(self) -> View:
        """The view with the lowest PSNR between the scenes; the first if there are several.

        Raises
        ------
        InvalidInput
            If there are no views.
        """
        self._check_views()
        return min(self.views, key=lambda view: view.between.psnr)

    def _check_views(self) -> None:
        if not self.views:
            raise InvalidInput("comparison: made without cameras, so there are no views")


def compare_scenes(first: Scene, second: Scene, matched_by: str = "index") -> Comparison:
    """Compare Gaussian by Gaussian, in the order given.

    Positions, f_dc, f_rest, opacity (logit), log-scales and rotation components are compared as
    stored; opacity also after the sigmoid, rotation also as an angle in degrees. An ellipsoid has
    several equivalent parameterisations; the nearest is compared. Rotations about an axis do not
    count if the other two axes are equal within 5 %. Missing SH bands count as zero. Opacities of 0
    and 1, whose logit is infinite, are compared only after the sigmoid.

    Raises
    ------
    InvalidInput
        If the scenes differ in their number of Gaussians.
    """
    if first.count != second.count:
        raise InvalidInput(
            f"{counted(first.count, 'Gaussian')} against {second.count:,}: no match, so no "
            'errors by attribute: compare what cameras see (cameras="auto")'
        )
    coefficients = max(len(first.f_rest), len(second.f_rest)) // 3
    with np.errstate(over="ignore"):
        shapes = shape_errors(first, second)
        groups = (
            _group("positions", "scene units", first.positions, second.positions),
            _group("f_dc", "SH", first.f_dc, second.f_dc),
            _group("f_rest", "SH", _padded(first, coefficients), _padded(second, coefficients)),
            _group("opacity", "logit", *_finite(first.opacity, second.opacity)),
            _group("opacity", "0-1", _sigmoid(first.opacity), _sigmoid(second.opacity)),
            _errors("scaling", "log", shapes.log_scale, 3 * first.count),
            _errors("rotation", "stored", shapes.rot, 4 * first.count),
            _errors("rotation", "degrees", shapes.turn[None], first.count),
        )
    kept = tuple(group for group in groups if group.name != "f_rest" or coefficients)
    return Comparison((first.count, second.count), matched_by, kept)


def _group(name: str, unit: str, first: NDArray, second: NDArray) -> GroupError:
    """Errors over all rows, one row at a time to bound memory."""
    rows = (differences(a, b) for a, b in zip(first, second, strict=True))
    return _errors(name, unit, rows, first.size)


def _errors(name: str, unit: str, rows: Iterable[NDArray], size: int) -> GroupError:
    largest = total = 0.0
    for error in rows:
        largest = float(np.maximum(largest, error.max(initial=0.0)))
        total += float(error @ error)
    return GroupError(name, unit, largest, float(np.sqrt(total / max(size, 1))))


def _finite(first: NDArray, second: NDArray) -> tuple[NDArray, NDArray]:
    """Columns of both in which no value is infinite."""
    there = ~(np.isinf(first) | np.isinf(second)).any(axis=0)
    return first[:, there], second[:, there]


def _padded(scene: Scene, coefficients: int) -> NDArray[np.float32]:
    own = len(scene.f_rest) // 3
    planes, missing = scene.f_rest.reshape(3, own, scene.count), coefficients - own
    padded = np.pad(planes, ((0, 0), (0, missing), (0, 0))) if missing else planes
    return padded.reshape(3 * coefficients, scene.count)


def _sigmoid(logit: NDArray) -> NDArray[np.float64]:
    return 1.0 / (1.0 + np.exp(-logit.astype(np.float64)))
