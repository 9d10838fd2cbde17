"""Distorted lenses, and the pinhole cameras that replace them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.runtime.arguments import check_fields

#: Maximum side of an image, in pixels.
MAX_SIDE = 1 << 14

#: Names of the coefficients in OpenCV's order: for a fisheye lens, and for any other.
FISHEYE = ("k1", "k2", "k3", "k4")
BROWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")

_VIEW = ("width", "height", "fx", "fy", "cx", "cy")

#: Maximum number of edge pixels that are undistorted to find the valid image area.
_EDGE = 4096

#: Where the distortion cannot be inverted at an image's edges, a margin of this share of the side
#: is left out. Action cameras calibrated with one coefficient need 1 %.
_MARGIN = 0.05

#: Maximum growth of an image's sides, as in COLMAP; wide fisheye images would grow without limit.
_MAX_GROWTH = 2.0

#: Minimum growth of an image's sides; COLMAP has 0.2. Less means wrong coefficients.
_MIN_GROWTH = 0.1

#: Maximum number of iterations of Newton's method, as in COLMAP.
_ITERATIONS = 100

#: Maximum length of a step: absolute, or relative to the distance from the centre.
_STEP = 0.1

#: Iteration stops when steps are shorter than this.
_DONE = 1e-10

#: Size of a complex step, whose derivative is exact.
_TINY = 1e-20


@dataclass(frozen=True)
class Lens:
    """The lens of a photograph: its size, focal lengths, principal point and distortion.

    A point at ``(x, y)`` on a pinhole camera's plane at distance 1, with ``r2 = x x + y y``, is
    seen from the principal point, in focal lengths, at::

        x (1 + k1 r2 + k2 r2^2 + k3 r2^3 + r8 r2^4) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
            + 2 p1 x y + p2 (r2 + 2 x x)

    and similarly in y, with p1 and p2 swapped. For a fisheye lens, x and y are first scaled so that
    their distance from the centre is the angle from the axis; then it is seen at::

        x (1 + k1 r2 + k2 r2^2 + k3 r2^3 + k4 r2^4)

    These are the models FULL_OPENCV and OPENCV_FISHEYE of COLMAP and OpenCV; COLMAP's others have
    fewer coefficients. `r8` is ``k4`` in RealityCapture, Metashape and nerfstudio.

    Parameters
    ----------
    width, height : int
        Size of the photograph, pixels.
    fx, fy : float
        Focal lengths, pixels.
    cx, cy : float
        Principal point, pixels; the first pixel's centre is (0.5, 0.5), as in `Camera`.
    fisheye : bool
        Whether it is a fisheye lens.
    coefficients : tuple of float
        k1, k2, k3, k4 if `fisheye`, else k1, k2, p1, p2, k3, k4, k5, k6.
    r8 : float
        Coefficient of the 8th power of the distance; 0 if `fisheye`.

    Raises
    ------
    InvalidInput
        If a value is out of range or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> lens = gs_codec.Lens(640, 480, 500.0, 500.0, 320.0, 240.0, False, (-0.1,) + 7 * (0.0,))
    >>> pinhole = lens.pinhole()
    >>> pinhole["width"], pinhole["height"], pinhole["fx"]
    (668, 490, 500.0)
    >>> camera = gs_codec.Camera("a.jpg", **pinhole, rotation=np.eye(3), position=np.zeros(3))
    >>> camera.lens == lens  # photographs are undistorted when they are read for this camera
    True
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    fisheye: bool
    coefficients: tuple[float, ...]
    r8: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        check_view("lens", self)
        names = FISHEYE if self.fisheye else BROWN
        if len(self.coefficients) != len(names) or not np.isfinite(self.coefficients).all():
            raise InvalidInput(
                f"lens: coefficients {self.coefficients}, expected {len(names)} finite numbers"
            )
        if not np.isfinite(self.r8) or (self.fisheye and self.r8):
            raise InvalidInput(
                f"lens: r8 {self.r8}, expected a finite number, 0 for a fisheye lens"
            )

    def pinhole(self) -> dict[str, Any]:
        """Fields of a pinhole `Camera` that replaces the lens; `lens` is one of them.

        This is the camera of COLMAP's image undistorter: the focal lengths do not change, and the
        image has the largest size at which all pixels are inside the photograph, at most twice the
        original. If the distortion cannot be inverted at two opposite edges, 5 % of the side is
        left out at each; COLMAP doubles the side.

        Raises
        ------
        InvalidInput
            If the distortion cannot be inverted there either.
        """
        x, y = _growth(self)
        width, height = max(1, int(x * self.width)), max(1, int(y * self.height))
        cx, cy = self.cx * width / self.width, self.cy * height / self.height
        view = (width, height, self.fx, self.fy, cx, cy)
        return {**dict(zip(_VIEW, view, strict=True)), "lens": self}

    def distort(self, points: NDArray) -> NDArray[np.float64]:
        """Project points ``(2, n)`` on a pinhole camera's plane at distance 1 into the photograph.

        The inverse of `undistort`; the result is in pixels.
        """
        x, y = np.asarray(points, np.float64)
        if self.fisheye:
            distance = np.hypot(x, y)
            scale = np.arctan(distance) / np.where(distance > 0, distance, 1.0)
            x, y = (np.where(distance > 0, scale, 1.0) * along for along in (x, y))
        return _bend(self, x, y) * [[self.fx], [self.fy]] + [[self.cx], [self.cy]]

    def undistort(self, points: NDArray) -> NDArray[np.float64]:
        """Map pixels ``(2, n)`` of the photograph to a pinhole camera's plane at distance 1.

        Infinite behind the camera, NaN if there is no solution.
        """
        with np.errstate(all="ignore"):
            bent = (np.asarray(points) - [[self.cx], [self.cy]]) / [[self.fx], [self.fy]]
            straight = _solve(self, bent)
            if not self.fisheye:
                return straight
            angle = np.hypot(*straight)
            stretch = np.where(angle > 0, np.tan(angle) / angle, 1.0)
            return np.where(angle < np.pi / 2, stretch, np.inf) * straight


def lens_fields(
    where: str,
    view: tuple[int, int, float, float, float, float],
    fisheye: bool,
    coefficients: Mapping[str, float],
) -> dict[str, Any]:
    """Fields of a `Camera` from a file's intrinsics; ranges are checked if they distort.

    Raises InvalidInput, as in `Lens.pinhole`.

    Parameters
    ----------
    where : str
        Location for error messages.
    view : tuple
        Width, height, fx, fy, cx and cy, pixels.
    fisheye : bool
    coefficients : mapping
        By name, including `r8`; missing ones are 0.
    """
    if not fisheye and not any(coefficients.values()):
        return dict(zip(_VIEW, view, strict=True))
    names = FISHEYE if fisheye else BROWN
    try:
        values = tuple(coefficients.get(key, 0.0) for key in names)
        return Lens(*view, fisheye, values, coefficients.get("r8", 0.0)).pinhole()
    except InvalidInput as error:
        raise InvalidInput(f"{where}: {error}") from error


def check_view(where: str, view: Any) -> None:
    """Check the size, focal lengths and principal point of a camera or lens.

    Raises InvalidInput.
    """
    for side in ("width", "height"):
        value = getattr(view, side)
        if not 1 <= value <= MAX_SIDE:
            raise InvalidInput(f"{where}: {side} {value}, expected 1 to {MAX_SIDE} pixels")
    for axis in ("fx", "fy"):
        value = getattr(view, axis)
        if not (np.isfinite(value) and value > 0):
            raise InvalidInput(f"{where}: {axis} {value}, expected a focal length above 0")
    if not np.isfinite([view.cx, view.cy]).all():
        raise InvalidInput(f"{where}: principal point {view.cx}, {view.cy} is not finite")


def _bend(lens: Lens, x: NDArray, y: NDArray) -> NDArray:
    """Apply the distortion to points; for a fisheye lens, given by their angle from the axis."""
    squared = x * x + y * y
    if lens.fisheye:
        k1, k2, k3, k4 = lens.coefficients
        radial = 1 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4)))
        return np.stack([x * radial, y * radial])
    k1, k2, p1, p2, k3, k4, k5, k6 = lens.coefficients
    radial = 1 + squared * (k1 + squared * (k2 + squared * (k3 + squared * lens.r8)))
    radial = radial / (1 + squared * (k4 + squared * (k5 + squared * k6)))
    u = x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x * x)
    v = y * radial + 2 * p2 * x * y + p1 * (squared + 2 * y * y)
    return np.stack([u, v])


def _solve(lens: Lens, bent: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of `_bend` by Newton's method; NaN where it does not converge."""
    point = bent.copy()
    size = np.full(bent.shape[1], np.inf)
    for _ in range(_ITERATIONS):
        x, y = point
        error = _bend(lens, x, y) - bent
        a, c = _bend(lens, x + 1j * _TINY, y).imag / _TINY
        b, d = _bend(lens, x, y + 1j * _TINY).imag / _TINY
        step = np.stack([d * error[0] - b * error[1], a * error[1] - c * error[0]]) / (
            a * d - b * c
        )
        size = np.hypot(*step)
        allowed = _STEP * np.maximum(1, np.hypot(x, y))
        point -= step * np.where(size > allowed, allowed / size, 1)
        if not (size > _DONE).any():
            break
    return np.where(size <= _DONE, point, np.nan)


@lru_cache(maxsize=1024)
@np.errstate(all="ignore")
def _growth(lens: Lens) -> tuple[float, float]:
    """Growth factors of width and height, as in COLMAP's UndistortCamera."""
    growth = []
    for axis, (side, focal, centre) in enumerate(
        ((lens.width, lens.fx, lens.cx), (lens.height, lens.fy, lens.cy))
    ):
        if not 0.5 < centre < side - 0.5:
            raise InvalidInput(f"lens: principal point {centre:g}, expected within the image")
        for margin in (0.5, _MARGIN * side):
            first, last = (
                centre + focal * lens.undistort(_edge(lens, axis, at))[axis]
                for at in (margin, side - margin)
            )
            if not (np.isnan(first).all() and np.isnan(last).all()):
                break
        else:
            raise InvalidInput("lens: its distortion cannot be inverted at the image's edges")
        # Points behind the camera impose no limit.
        before, after = (
            np.fmin.reduce(away, initial=np.inf) for away in (centre - first, last - centre)
        )
        factor = min(before / centre, after / (side - 0.5 - centre), _MAX_GROWTH)
        if not factor > 0:
            raise InvalidInput("lens: its distortion turns the image inside out")
        if factor < _MIN_GROWTH:
            text = f"lens: its distortion leaves {100 * factor:.2g} % of a side of the image"
            raise InvalidInput(f"{text}, expected {100 * _MIN_GROWTH:g} % or more")
        growth.append(float(factor))
    return growth[0], growth[1]


def _edge(lens: Lens, axis: int, at: float) -> NDArray[np.float64]:
    """Centres of pixels ``(2, n)`` along the edge where `axis` is `at`."""
    length = (lens.height, lens.width)[axis]
    along = np.round(np.linspace(0, length - 1, min(length, _EDGE))) + 0.5
    across = np.full_like(along, at)
    return np.stack([across, along] if axis == 0 else [along, across])
