"""Match the Gaussians of a decoded scene to those of its source.

A decoded PLY has a comment line that states how it was sorted; sorting the original the same way
aligns the two. A scene that was coded several times has a line for each time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import (
    MOST_AXIS_BITS,
    MOST_FAR_BITS,
    PositionGrid,
    grid_codes,
)
from gs_codec.codecs.inspection import Info
from gs_codec.coding.morton import spatial_order
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import CONVENTION, turn_axes
from gs_codec.scene import ORDER, Scene, inverse_of

if TYPE_CHECKING:
    from gs_codec.coding.quantise import Quantiser

_GRID = "grid"
_FLOATS = "floats"

#: Last word of the comment of a grid whose far Gaussians come last.
_FAR = "far"

#: Method of matching if no order matches the Gaussians.
NEAREST = "nearest centre"

_INSTEAD = 'compare rendered views (cameras="auto")'
_UNRELATED = (
    f"Gaussians of the scenes do not match, so there are no errors by attribute: {_INSTEAD}"
)

#: Share of right pairs at which no other match is tried.
_SURELY = 0.95

#: Minimum share of right pairs. Versions of a scene reach 0.75 or more (coarse profiles), two
#: halves of one scene 0.5 with nearest centres.
_MOSTLY = 0.7

#: Minimum mean of the three shares with nearest centres: versions reach 0.68, halves 0.36.
_MOSTLY_NEAREST = 0.6

#: Minimum gain in the sum of the three shares for a match to replace an earlier one.
_BETTER = 0.06

#: Scenes with at most this many Gaussians are matched by every method.
_FEW = 100

#: Share of Gaussians that rounding to float32 may have moved out of their cells.
_MOVED = 0.01


@dataclass(frozen=True)
class DepthOrder:
    """Order by quantised positions and SH-DC with these depths (`paper` profiles)."""

    depths: tuple[int, ...]

    def __str__(self) -> str:
        return " ".join(map(str, self.depths))

    def apply(self, original: Scene, decoded: Scene) -> Scene:
        """Bring the original into the decoded scene's order.

        Min-max quantisers keep the extremes, so the decoded scene still has the same ranges.
        """
        from gs_codec.codecs.entropygs.symbols import order_like
        from gs_codec.coding.far import bring_nearer
        from gs_codec.coding.quantise import fit_range

        rows = (*decoded.positions, *decoded.f_dc)
        quantisers = [fit_range(r, max(d, 1)) for r, d in zip(rows, self.depths, strict=True)]
        # Far Gaussians were moved nearer, except by earlier encoders.
        for coded in (bring_nearer(original)[0], original):
            order = order_like(coded, quantisers)
            if _are_within_steps(coded.take(order), decoded, quantisers):
                return original.take(order)
        raise InvalidInput(_UNRELATED)


def _are_within_steps(first: Scene, second: Scene, quantisers: Sequence[Quantiser]) -> bool:
    """Whether centres of the same index are within half a step."""
    for a, b, quantiser in zip(first.positions, second.positions, quantisers[:3], strict=True):
        bound = 0.51 * quantiser.step + np.spacing(np.abs(b).max(initial=0.0))
        if (np.abs(a.astype(np.float64) - b) > bound).any():
            return False
    return True


@dataclass(frozen=True)
class GridOrder:
    """Order by the cells of a grid (profiles `l`, `m` and `s`), with axes sorted by length."""

    grid: PositionGrid

    def __str__(self) -> str:
        numbers = " ".join(f"{x!r}" for x in (*self.grid.origin, self.grid.step))
        far = f" {_FAR}" * self.grid.has_far
        return f"{_GRID} {numbers} {' '.join(map(str, self.grid.bits))}{far}"

    def apply(self, original: Scene, decoded: Scene) -> Scene:
        """Bring the original into the decoded scene's order, with its axes as coded."""
        from gs_codec.coding.axes import nearest_quaternions, sort_axes
        from gs_codec.coding.clean import identity_for_zero

        codes = grid_codes(original.positions, self.grid)
        order = np.argsort(codes, kind="stable")
        codes, coded = codes[order], grid_codes(decoded.positions, self.grid)
        # Codes are sorted: a Gaussian must lie between the decoded ones before and after it.
        outside = (coded[:-1] > codes[1:]).sum() + (coded[1:] < codes[:-1]).sum()
        if outside > _MOVED * original.count:
            raise InvalidInput(_UNRELATED)
        ordered, _ = identity_for_zero(original.take(order))
        _, scales, vectors = sort_axes(ordered.log_scale, ordered.rot)
        rot = nearest_quaternions(vectors, decoded.rot)
        return replace(ordered, log_scale=scales.astype(np.float32), rot=rot)


@dataclass(frozen=True)
class FloatOrder:
    """Order by the floats themselves (profile `lossless`)."""

    def __str__(self) -> str:
        return _FLOATS

    def apply(self, original: Scene, decoded: Scene) -> Scene:
        """Bring the original into the decoded scene's order."""
        from gs_codec.codecs.lossless.lossless import lossless_order

        ordered = original.take(lossless_order(original))
        if ordered.positions.tobytes() != decoded.positions.tobytes():
            raise InvalidInput(_UNRELATED)
        return ordered


Order = DepthOrder | GridOrder | FloatOrder


def order_of_file(info: Info) -> Order | None:
    """The order of the scene that a file decodes to; None if it is the source's order."""
    if info.keeps_order:
        return None
    if info.grid is not None:
        return GridOrder(info.grid)
    if not info.channels:
        return FloatOrder()
    return DepthOrder(tuple(channel.quantiser.depth for channel in info.channels[:6]))


def order_of(scene: Scene) -> Order | None:
    """The order stated in a scene's comments; None for an original.

    Raises InvalidInput if the comment is malformed.
    """
    marks = _marks(scene)
    if not marks:
        return None
    fields = marks[-1].removeprefix(ORDER).split()
    if fields == [_FLOATS]:
        return FloatOrder()
    if fields[:1] == [_GRID]:
        return GridOrder(_grid_of(marks[-1], fields[1:]))
    if len(fields) != 6 or not all(field.isdigit() and int(field) <= 21 for field in fields):
        raise InvalidInput(f"comment '{marks[-1]}': expected six depths")
    return DepthOrder(tuple(int(field) for field in fields))


def _marks(scene: Scene) -> tuple[str, ...]:
    """The comments that state orders; the last one is the current order."""
    return tuple(line for line in scene.comments if line.startswith(ORDER))


def _grid_of(mark: str, fields: list[str]) -> PositionGrid:
    has_far = fields[-1:] == [_FAR]
    try:
        x, y, z, step = (float(field) for field in fields[:4])
        a, b, c = (int(field) for field in fields[4 : len(fields) - has_far])
    except ValueError:
        raise InvalidInput(f"comment '{mark}': expected four numbers and three depths") from None
    finite = all(map(math.isfinite, (x, y, z, step))) and step > 0
    grid = PositionGrid((x, y, z), step, (a, b, c), has_far)
    many = max(a, b, c) > MOST_AXIS_BITS or (has_far and grid.total_bits > MOST_FAR_BITS)
    if not finite or min(a, b, c) < 0 or many:
        raise InvalidInput(f"comment '{mark}': a number is out of range")
    return grid


def with_order(scene: Scene, order: Order | None) -> Scene:
    """Add a comment that states the scene's order, if given."""
    return scene if order is None else replace(scene, comments=(*scene.comments, f"{ORDER}{order}"))


def without_order(scene: Scene) -> Scene:
    """Remove comments that state orders."""
    marks = _marks(scene)
    return replace(scene, comments=tuple(line for line in scene.comments if line not in marks))


def put_side_by_side(
    first: Scene, second: Scene, in_order: bool = False
) -> tuple[Scene, Scene, str]:
    """Bring two scenes, such as an original and its decoded version, into one order.

    Raises InvalidInput if the Gaussians do not match.

    Parameters
    ----------
    first, second : Scene
    in_order : bool
        Whether to try only stored orders, not nearest centres, which take seconds.

    Returns
    -------
    first, second : Scene
    matched_by : str
        How they were matched: ``stored order``, ``index``, ``Morton order`` (in which other formats
        are written) or ``nearest centre``, which also compares appearance.
    """
    if first.count != second.count:
        return first, second, "index"
    marks = _marks(first), _marks(second)
    orders = order_of(first), order_of(second)
    try:
        # A decoded scene keeps the lines of its source, if any, and adds its own.
        if orders[1] is not None and marks[0] in ((), marks[1][:-1]):
            return orders[1].apply(first, second), second, "stored order"
        if orders[0] is not None and marks[1] in ((), marks[0][:-1]):
            return first, orders[0].apply(second, first), "stored order"
    except InvalidInput:  # neither was decoded from the other
        pass
    return _matched(first, second, in_order)


def _matched(first: Scene, second: Scene, in_order: bool) -> tuple[Scene, Scene, str]:
    """Match by the Gaussians alone; see `put_side_by_side`."""
    index = np.arange(first.count)
    if _are_equal(first, second):
        return first, second, "index"
    from gs_codec.codecs.pairing import Pairing

    pairing = Pairing(first, second)
    ways: list[tuple[str, Callable[[], NDArray[np.int64]]]] = [
        ("index", lambda: index),
        ("Morton order", lambda: inverse_of(_morton_order(first))),
        ("Morton order", lambda: _morton_order(second)),
        (NEAREST, pairing.nearest),
    ]
    shares, found = [], []
    for name, partners_of in ways[:-1] if in_order else ways:
        found.append((partners_of(), name))
        shares.append(pairing.right(found[-1][0]))
        if shares[-1].max() >= _SURELY and first.count > _FEW:
            break
    sums = np.sum(shares, axis=1)
    best = int(np.argmax(sums >= sums.max() - _BETTER))
    partners, matched_by = found[best]
    by_chance = matched_by == NEAREST and shares[best].mean() < _MOSTLY_NEAREST
    if by_chance or shares[best].max() < _MOSTLY:
        raise InvalidInput(_UNRELATED)
    if matched_by == "index":
        return first, second, matched_by
    return first, second.take(partners), matched_by


def _are_equal(first: Scene, second: Scene) -> bool:
    """Whether most Gaussians of the same index are equal, apart from SH-AC and rotations."""
    equal = np.ones(first.count, bool)
    for group in ("positions", "f_dc", "opacity", "log_scale"):
        equal &= (getattr(first, group) == getattr(second, group)).all(axis=0)
    return not first.count or bool(np.mean(equal) > _SURELY)


def _morton_order(scene: Scene) -> NDArray[np.int64]:
    """Order used by writers: Morton order of centres in the convention's coordinate system."""
    turned = turn_axes(scene, CONVENTION)
    return spatial_order(np.nan_to_num(turned.positions), turned.log_scale)
