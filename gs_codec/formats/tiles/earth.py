"""Places on the earth: longitude, latitude and height on the ellipsoid WGS 84, and ECEF."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput

#: Longitude and latitude in degrees, and height above the ellipsoid in metres.
Place = tuple[float, float, float]

#: Half axis at the equator, in metres, and squared eccentricity.
_RADIUS = 6378137.0
_SQUARED = 0.00669437999014

#: Distances from the centre of the earth, in metres, of places on it.
_NEAR, _FAR = 6.2e6, 6.6e6

#: Iterations to find a latitude; each adds two digits.
_ITERATIONS = 8


def check_place(place: Sequence[float]) -> Place:
    """A place, checked; `InvalidInput` if it is not on the earth."""
    longitude, latitude, height = (float(value) for value in place)
    if not (abs(longitude) <= 180 and abs(latitude) <= 90 and abs(height) < 1e5):
        raise InvalidInput(
            f"at {longitude:g},{latitude:g},{height:g}: expected a longitude from -180 to 180, "
            "a latitude from -90 to 90, and a height of less than 100,000 metres"
        )
    return longitude, latitude, height


def frame_at(place: Place) -> NDArray[np.float64]:
    """The matrix ``(4, 4)`` from metres east, north and up of a place to ECEF."""
    east, north = math.radians(place[0]), math.radians(place[1])
    (sin_e, cos_e), (sin_n, cos_n) = ((math.sin(a), math.cos(a)) for a in (east, north))
    up = np.array([cos_n * cos_e, cos_n * sin_e, sin_n])
    curvature = _RADIUS / math.sqrt(1 - _SQUARED * sin_n**2)
    frame = np.eye(4)
    frame[:3, 0] = -sin_e, cos_e, 0
    frame[:3, 1] = -sin_n * cos_e, -sin_n * sin_e, cos_n
    frame[:3, 2] = up
    frame[:3, 3] = curvature * up * (1, 1, 1 - _SQUARED) + place[2] * up
    return frame


def place_of(point: NDArray[np.float64]) -> Place | None:
    """The place of a point in ECEF; None if it is not near the surface of the earth."""
    x, y, z = point.tolist()
    if not _NEAR < math.hypot(x, y, z) < _FAR:
        return None
    across = math.hypot(x, y)
    latitude = math.atan2(z, across * (1 - _SQUARED))
    for _ in range(_ITERATIONS):
        sine = math.sin(latitude)
        curvature = _RADIUS / math.sqrt(1 - _SQUARED * sine**2)
        latitude = math.atan2(z + _SQUARED * curvature * sine, across)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    curvature = _RADIUS / math.sqrt(1 - _SQUARED * sine**2)
    # Along the normal, which is exact at the poles, too.
    height = (across - curvature * cosine) * cosine
    height += (z - (1 - _SQUARED) * curvature * sine) * sine
    return math.degrees(math.atan2(y, x)), math.degrees(latitude), height
