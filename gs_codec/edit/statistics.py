"""Statistics of a scene: attributes in natural units, and Gaussians that stand out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.extent import centre_bounds
from gs_codec.edit.shares import QUANTILE, Share, shares_of
from gs_codec.egs.index import Box
from gs_codec.formats.packed_values import sigmoid
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.scene import SH_C0, SH_COEFFICIENTS, Scene, channel_count, sh_bands

#: Bins of a histogram.
BINS = 40

#: Logarithms of the least and largest scale that is told apart: floats of 64 bits end there.
_LOG_RANGE = -708.0, 709.0

_LARGEST = float(np.finfo(np.float64).max)


@dataclass(frozen=True)
class AttributeStatistics:
    """Values of one attribute over all Gaussians, NaN and infinity apart.

    Attributes
    ----------
    name : str
        ``x``, ``y``, ``z``; ``opacity``; ``longest scale``, ``middle scale``, ``shortest scale``
        (of each Gaussian's three axes); ``red``, ``green``, ``blue``; ``SH band 1`` to
        ``SH band 3`` (all coefficients of the band, of all colours); ``rotation norm``; then extra
        properties by their own names.
    unit : str
        ``scene units`` (of scales, one standard deviation); ``0-1`` (of base colours, which may
        reach beyond); ``SH`` (of coefficients); ``1`` (of the norm); the type of an extra property.
    nan, infinite : int
        Number of values that are NaN, or infinite.
    minimum, median, maximum : float or None
        Of the finite values; None without any.
    low, high : float or None
        The values that 1 % are at or below, and 99 %.
    below, above : int
        Number of finite values beyond the histogram.
    counts : tuple of int
        Histogram of 40 bins from `low` to `high`; from `minimum` to `maximum` if these two are the
        same, and around the value if all are. Empty without finite values.
    edges : tuple of float
        The 41 edges of the bins, of which only the last holds its upper edge. Spaced evenly, those
        of scales by their logarithm.
    """

    name: str
    unit: str
    nan: int
    infinite: int
    minimum: float | None = None
    low: float | None = None
    median: float | None = None
    high: float | None = None
    maximum: float | None = None
    below: int = 0
    above: int = 0
    counts: tuple[int, ...] = ()
    edges: tuple[float, ...] = ()


@dataclass(frozen=True)
class Statistics:
    """What a scene holds.

    Attributes
    ----------
    count, sh_degree : int
        Number of Gaussians, and their SH degree.
    bounds : tuple of two tuples of float, or None
        Lowest and highest x, y, z of the finite centres; None if there are none.
    coordinates : str or None
        Directions of x, y and z as three letters (such as ``RDF``), if stated.
    antialiased : bool
        Whether opacity compensation is asked for.
    raw_bytes, bytes_per_gaussian : int
        Size of the attributes as float32, extra properties apart: of all, and of one.
    attributes : tuple of AttributeStatistics
    shares : tuple of Share
        ``transparent``, ``needle-like``, ``huge``, ``same centre``, ``duplicate``, ``not finite``.
    """

    count: int
    sh_degree: int
    bounds: Box | None
    coordinates: str | None
    antialiased: bool
    raw_bytes: int
    bytes_per_gaussian: int
    attributes: tuple[AttributeStatistics, ...]
    shares: tuple[Share, ...]

    def as_dict(self) -> dict:
        """The same as plain types, for JSON; every number is finite."""
        return asdict(self)


@dataclass(frozen=True)
class _Attribute:
    """An attribute: its stored values, of any shape, and what makes natural units of them."""

    name: str
    unit: str
    stored: Callable[[], NDArray]
    natural: Callable[[NDArray], NDArray] = np.asarray
    logarithmic: bool = False


def statistics_of(scene: Scene) -> Statistics:
    """Statistics of a scene, each attribute in natural units.

    Parameters
    ----------
    scene : Scene
        Of any values, NaN and infinity included.

    Returns
    -------
    Statistics
    """
    with using_threads(None, scene.count):
        attributes = run_all(_describe, _attributes(scene))
    return Statistics(
        count=scene.count,
        sh_degree=scene.sh_degree,
        bounds=centre_bounds(scene.positions),
        coordinates=scene.coordinates,
        antialiased=scene.antialiased,
        raw_bytes=scene.float_bytes,
        bytes_per_gaussian=4 * channel_count(SH_COEFFICIENTS[scene.sh_degree]),
        attributes=tuple(attributes),
        shares=shares_of(scene),
    )


def _attributes(scene: Scene) -> list[_Attribute]:
    def row(planes: NDArray, number: int) -> Callable[[], NDArray]:
        return lambda: planes[number]

    def band(coefficients: range) -> NDArray:
        planes = scene.f_rest.reshape(3, -1, scene.count)
        return planes[:, coefficients.start : coefficients.stop]

    scales, axes = np.sort(scene.log_scale, axis=0), ("shortest", "middle", "longest")
    bands = enumerate(sh_bands(len(scene.f_rest) // 3), 1)
    return [
        *(_Attribute(name, "scene units", row(scene.positions, i)) for i, name in enumerate("xyz")),
        _Attribute("opacity", "0-1", row(scene.opacity, 0), _opacity),
        *(
            _Attribute(f"{axes[i]} scale", "scene units", row(scales, i), _linear, True)
            for i in (2, 1, 0)
        ),
        *(
            _Attribute(name, "0-1", row(scene.f_dc, i), _colour)
            for i, name in enumerate(("red", "green", "blue"))
        ),
        *(_Attribute(f"SH band {b}", "SH", partial(band, members)) for b, members in bands),
        _Attribute("rotation norm", "1", lambda: _norm(scene.rot)),
        *(
            _Attribute(name, column.dtype.name, row(column[None], 0), _wide)
            for name, column in scene.extra.items()
        ),
    ]


def _opacity(logit: NDArray) -> NDArray[np.float64]:
    return sigmoid(logit.astype(np.float64))


def _linear(log_scale: NDArray) -> NDArray[np.float64]:
    return np.exp(np.clip(log_scale.astype(np.float64), *_LOG_RANGE))


def _colour(f_dc: NDArray) -> NDArray[np.float64]:
    return 0.5 + SH_C0 * f_dc.astype(np.float64)


def _wide(column: NDArray) -> NDArray[np.float64]:
    return column.astype(np.float64)


def _norm(rot: NDArray[np.float32]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.square(rot, dtype=np.float64).sum(axis=0))


def _describe(attribute: _Attribute) -> AttributeStatistics:
    stored = attribute.stored()
    finite = np.isfinite(stored)
    number = np.count_nonzero(finite)
    nan = np.count_nonzero(np.isnan(stored)) if number < stored.size else 0
    named = partial(AttributeStatistics, attribute.name, attribute.unit)
    counted = named(nan, stored.size - number - nan)
    if not number:
        return counted
    values = attribute.natural(stored.flatten() if number == stored.size else stored[finite])
    # The order of a few values among all is known without sorting.
    last = number - 1
    ranks = [int(QUANTILE * last), last // 2, number // 2, last - int(QUANTILE * last)]
    values.partition(sorted(set(ranks)))
    low, left, right, high = (float(values[rank]) for rank in ranks)
    minimum, maximum = float(values[: ranks[0] + 1].min()), float(values[ranks[3] :].max())
    edges = _edges(*((low, high) if low < high else (minimum, maximum)), attribute.logarithmic)
    below, *counts, above = _histogram(values, edges)
    return named(
        nan,
        counted.infinite,
        minimum,
        low,
        0.5 * left + 0.5 * right,
        high,
        maximum,
        below,
        above,
        tuple(counts),
        tuple(edges.tolist()),
    )


def _edges(low: float, high: float, logarithmic: bool) -> NDArray[np.float64]:
    """Edges ``(BINS + 1,)`` of bins, around a single value too."""
    if low == high:
        half = 0.5 * (abs(low) or 1.0)
        low, high = max(low - half, -_LARGEST), min(high + half, _LARGEST)
    if logarithmic:
        return np.geomspace(low, high, BINS + 1)
    # Halves: the difference of two finite numbers may be infinite.
    return 2 * np.linspace(0.5 * low, 0.5 * high, BINS + 1)


def _histogram(values: NDArray, edges: NDArray[np.float64]) -> list[int]:
    """Number of values below all bins, in each, and above all."""
    # A power of two less one, so that every search takes the same steps.
    ends = np.full((1 << len(edges).bit_length()) - 1, np.inf)
    ends[: len(edges)] = edges
    ends[len(edges) - 1] = np.nextafter(edges[-1], np.inf)
    counts = np.zeros(len(edges) + 1, np.int64)
    _count(values, ends, counts)
    return counts.tolist()


@kernel
def _count(values, ends, counts):
    """Count values by how many `ends`, of which there are ``2**k - 1``, are at or below them."""
    for i in range(values.size):
        value, place, step = values[i], 0, (len(ends) + 1) >> 1
        while step:
            place += step * (ends[place + step - 1] <= value)
            step >>= 1
        counts[place] += 1
