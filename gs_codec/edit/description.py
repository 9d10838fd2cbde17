"""Statistics of a scene: attributes in natural units, and Gaussians that stand out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.extent import centre_bounds
from gs_codec.edit.distribution import finite_values, histogram, ranked
from gs_codec.edit.shares import Share, ends_of, shares_of
from gs_codec.egs.index import Box
from gs_codec.formats.packed_values import sigmoid
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.scene import SH_C0, SH_COEFFICIENTS, Scene, channel_count, sh_bands

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

#: Number of bins of a histogram.
BINS = 40

#: Log-scales are clipped to this range, in which float64 exponentials are finite and above 0.
_LOG_RANGE = -708.0, 709.0


@dataclass(frozen=True)
class AttributeStatistics:
    """Distribution of one attribute over all Gaussians, ignoring NaN and infinity.

    Attributes
    ----------
    name : str
        ``x``, ``y``, ``z``; ``opacity``; ``longest scale``, ``middle scale``, ``shortest scale``
        (of each Gaussian); ``red``, ``green``, ``blue``; ``SH band 1`` to ``SH band 3`` (all
        coefficients of the band, of all colours); ``rotation norm``; then the names of extra
        properties.
    unit : str
        ``scene units`` (of scales, one standard deviation); ``0-1`` (of base colours, which may
        reach beyond); ``SH`` (of coefficients); ``1`` (of the norm); the type of an extra property.
    nan, infinite : int
        Number of values that are NaN, or infinite.
    minimum, low, median, high, maximum : float or None
        Minimum, 1st percentile, median, 99th percentile and maximum of the finite values; None if
        there are none.
    below, above : int
        Number of finite values beyond the histogram.
    counts : tuple of int
        Histogram of 40 bins from `low` to `high`; from `minimum` to `maximum` if those are equal,
        and around the value if all are equal. Empty without finite values.
    edges : tuple of float
        The 41 edges of the bins, evenly spaced (for scales, in the logarithm). Only the last bin
        includes its upper edge.

    Examples
    --------
    >>> found = gs_codec.edit.statistics(gs_codec.read("scene.ply"))
    >>> [opacity] = [each for each in found.attributes if each.name == "opacity"]
    >>> opacity.unit, opacity.low <= opacity.median <= opacity.high, len(opacity.counts)
    ('0-1', True, 40)
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
    """Statistics of a scene.

    Attributes
    ----------
    count, sh_degree : int
        Number of Gaussians, and their SH degree.
    bounds : tuple of two tuples of float, or None
        Lowest and highest x, y, z of the finite centres; None if there are none.
    coordinates : str or None
        Directions of x, y and z as three letters (such as ``RDF``), if stated.
    antialiased : bool
        Whether the scene uses opacity compensation; False for a cloud, which does not state it.
    raw_bytes, bytes_per_gaussian : int
        Size of the attributes as float32, without extra properties: of all Gaussians, and per
        Gaussian.
    attributes : tuple of AttributeStatistics
        Each attribute in its natural unit.
    shares : tuple of Share
        ``transparent``, ``needle-like``, ``huge``, ``same centre``, ``duplicate``, ``not finite``.

    Examples
    --------
    >>> found = gs_codec.edit.statistics(gs_codec.read("scene.ply"))
    >>> found.sh_degree, found.raw_bytes == found.count * found.bytes_per_gaussian
    (3, True)
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

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain types, for JSON; every number is finite."""
        return asdict(self)


@dataclass(frozen=True)
class _Attribute:
    """An attribute: planes of values, and a monotonic function to natural units."""

    name: str
    unit: str
    planes: Sequence[NDArray]
    natural: Callable[[NDArray[np.float64]], NDArray[np.float64]] = np.asarray


@checked
def statistics(cloud: PointCloud) -> Statistics:
    """Statistics of a scene: attributes in natural units, and Gaussians that stand out.

    Parameters
    ----------
    cloud : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`; values may be NaN or infinite.

    Returns
    -------
    Statistics
        The statistics that ``gs-codec inspect --histogram`` shows.

    Raises
    ------
    InvalidInput
        If the cloud lacks an attribute of a scene.

    Examples
    --------
    >>> found = gs_codec.edit.statistics(gs_codec.read("scene.ply"))
    >>> found.count, [share.name for share in found.shares][:3]
    (2000, ['transparent', 'needle-like', 'huge'])
    """
    from gs_codec.formats.cloud import from_cloud

    return statistics_of(from_cloud(cloud, "keep", exact=True))


def statistics_of(scene: Scene) -> Statistics:
    """See `statistics`."""
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


def _attributes(scene: Scene) -> Iterator[_Attribute]:
    for name, row in zip("xyz", scene.positions, strict=True):
        yield _Attribute(name, "scene units", [row])
    yield _Attribute("opacity", "0-1", [_opacity(scene.opacity[0])])
    axes = zip(("shortest", "middle", "longest"), np.sort(scene.log_scale, axis=0), strict=True)
    for name, row in reversed(list(axes)):
        yield _Attribute(f"{name} scale", "scene units", [row], _linear)
    for name, row in zip(("red", "green", "blue"), scene.f_dc, strict=True):
        yield _Attribute(name, "0-1", [row], _colour)
    coefficients = len(scene.f_rest) // 3
    for band, members in enumerate(sh_bands(coefficients), 1):
        rows = [scene.f_rest[k * coefficients + i] for k in range(3) for i in members]
        yield _Attribute(f"SH band {band}", "SH", rows)
    yield _Attribute("rotation norm", "1", [_norm(scene.rot)])
    for name, column in scene.extra.items():
        yield _Attribute(name, column.dtype.name, [column.astype(np.float64)])


def _opacity(logit: NDArray[np.float32]) -> NDArray[np.float64]:
    wide = logit.astype(np.float64)
    return np.where(np.isfinite(wide), sigmoid(wide), wide)


def _linear(log_scale: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.exp(np.clip(log_scale, *_LOG_RANGE))


def _colour(f_dc: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.5 + SH_C0 * f_dc


def _norm(rot: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.sqrt(np.square(rot, dtype=np.float64).sum(axis=0))


def _describe(attribute: _Attribute) -> AttributeStatistics:
    planes = attribute.planes
    values = finite_values(planes)
    nan = sum(int(np.count_nonzero(np.isnan(plane))) for plane in planes)
    infinite = sum(plane.size for plane in planes) - values.size - nan
    named = partial(AttributeStatistics, attribute.name, attribute.unit, nan, infinite)
    if not values.size:
        return named()
    last, ends = values.size - 1, ends_of(values.size)
    ranks = [0, ends[0], last // 2, (last + 1) // 2, ends[1], last]
    found = ranked(values, ranks)
    span = (found[1], found[4]) if found[1] < found[4] else (found[0], found[5])
    (below, *counts, above), edges = histogram(values, *span, BINS)
    least, low, left, right, high, largest = attribute.natural(np.array(found)).tolist()
    return named(
        minimum=least,
        low=low,
        # Halve first, because the sum of two finite numbers may be infinite.
        median=0.5 * left + 0.5 * right,
        high=high,
        maximum=largest,
        below=below,
        above=above,
        counts=tuple(counts),
        edges=tuple(attribute.natural(edges).tolist()),
    )
