"""Pair the Gaussians of two scenes by appearance, and measure how many pairs are right.

Two Gaussians are compared by four terms: the distance of their centres, and the differences of
colour, opacity and scales. The unit of each is the typical difference between neighbours in one
scene. A pair is right if it differs less than a Gaussian and its most similar neighbour.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import spatial_order
from gs_codec.coding.neighbours import Neighbours
from gs_codec.scene import SH_C0, Scene

#: Number of nearest neighbours searched for a Gaussian's partner.
_NEIGHBOURS = 8

#: Approximate size of the sample that checks pairs.
_SAMPLE = 2000

#: Maximum value of a term.
_MOST = 4.0

#: A pair is certain if it differs at most by this share of any other candidate: in appearance, or
#: in the distance of the centres where only these count.
_SURE = 0.2

#: Rounds that accept only certain pairs.
_SURE_ROUNDS = 3

#: Rounds of the search for partners; Gaussians left over are paired in order.
_ROUNDS = 12

#: Maximum number of Gaussians matched at once.
_CHUNK = 1 << 16

#: Logarithms of scales are clipped to this, so that their differences are finite.
_LOG_LIMIT = 100.0

_TINY = np.finfo(float).tiny


class Pairing:
    """Two scenes with equal numbers of Gaussians, at least one.

    Parameters
    ----------
    first, second : Scene
        Both in the same coordinate system.
    by_centres : bool
        Whether partners are searched by their centres alone, for Gaussians that look alike.
    """

    def __init__(self, first: Scene, second: Scene, by_centres: bool = False) -> None:
        self.count = first.count
        # The terms that choose a partner, and those that make it certain.
        self._chosen = slice(1) if by_centres else slice(None)
        self._told = slice(1) if by_centres else slice(1, None)
        self._places = _places(first), _places(second)
        self._looks = _looks(first), _looks(second)
        self._some = np.arange(0, self.count, -(-self.count // _SAMPLE))

    def right(self, partners: NDArray[np.int64]) -> NDArray[np.float64]:
        """Share of Gaussians with the right partner: by all terms, by appearance, by centres.

        Appearance alone detects scenes that were moved. Centres alone (twice as near as a
        neighbour) detect coarsely quantised colours and scales.

        Parameters
        ----------
        partners : ndarray, shape (N,)
            Index in the second scene of each Gaussian's partner.
        """
        terms = self._terms(self._some, partners[self._some, None], self._places[0])[:, 0]
        own = self._own_terms
        if not own.shape[1]:
            return np.ones(3)
        # An identical neighbour is as good a partner.
        same = (own == 0).all(axis=2)
        shares = []
        for kept, share in ((slice(None), 1.0), (slice(1, None), 1.0), (slice(1), 0.5)):
            found, nearest = (_cost(each[..., kept], self._unit[kept]) for each in (terms, own))
            nearest[same] = np.inf
            shares.append(np.mean(found < share * nearest.min(axis=1)))
        return np.array(shares)

    def certain(self) -> float:
        """Share of a sample whose partner is unmistakable without a search of all."""
        _, _, sure = self._best(self._some, np.arange(self.count), self._places[0])
        return float(sure.mean())

    def nearest(self) -> NDArray[np.int64]:
        """Partners: for each Gaussian the most similar of the nearest, each used once.

        Unmistakable pairs come first; the other Gaussians are expected to move as those nearby do.
        """
        partners = np.full(self.count, -1)
        centres = self._places[0].copy()
        # Searching along a space-filling curve is several times faster.
        left, free = (spatial_order(each.T.astype(np.float32)) for each in self._places)
        for number in range(_ROUNDS):
            if not len(left):
                return partners
            best, cost, sure = self._best(left, free, centres)
            some = np.flatnonzero(sure | (number >= _SURE_ROUNDS))
            order = some[np.lexsort((cost[some], best[some]))]
            order = order[np.r_[True, np.diff(best[order]) > 0][: len(order)]]
            partners[left[order]] = best[order]
            taken = np.zeros(self.count, bool)
            taken[best[order]] = True
            left, free = left[partners[left] < 0], free[~taken[free]]
            if number < _SURE_ROUNDS:
                self._move(centres, left, partners)
        partners[left] = free
        return partners

    def _move(
        self, centres: NDArray[np.float64], left: NDArray[np.int64], partners: NDArray[np.int64]
    ) -> None:
        """Move the centres of Gaussians by the median motion of the nearest that have partners."""
        before, after = self._places
        paired = np.flatnonzero(partners >= 0)
        if not len(paired):
            return
        motion, others = after[partners[paired]] - before[paired], Neighbours(before[paired])
        for start in range(0, len(left), _CHUNK):
            part = left[start : start + _CHUNK]
            _, found = others.nearest(before[part], min(_NEIGHBOURS, len(paired)))
            centres[part] = before[part] + np.median(motion[found], axis=1)

    def _best(
        self, which: NDArray[np.int64], free: NDArray[np.int64], centres: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        """The most similar of the `free` Gaussians nearest to ``centres (N, 3)``; cost; certainty.

        A pair is certain if it differs far less than the others; see `_SURE`.
        """
        others = Neighbours(self._places[1][free])
        best, cost = np.empty(len(which), np.int64), np.empty(len(which))
        sure = np.empty(len(which), np.bool_)
        number = min(_NEIGHBOURS, len(free))
        for start in range(0, len(which), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            part = which[chunk]
            _, found = others.nearest(centres[part], number)
            terms = self._terms(part, free[found], centres)
            kinds = self._chosen, self._told
            costs, told = (_cost(terms[..., kind], self._unit[kind]) for kind in kinds)
            least = costs.argmin(axis=1)[:, None]
            best[chunk] = free[np.take_along_axis(found, least, 1)[:, 0]]
            cost[chunk] = np.take_along_axis(costs, least, 1)[:, 0]
            own = np.take_along_axis(told, least, 1)[:, 0]
            np.put_along_axis(told, least, np.inf, 1)
            sure[chunk] = own < _SURE * told.min(axis=1)
        return best, cost, sure

    def _terms(
        self, i: NDArray[np.int64], j: NDArray[np.int64], centres: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Terms ``(n, k, 4)`` of ``(n,)`` Gaussians at ``centres (N, 3)`` and ``(n, k)`` others."""
        return _differences(centres[i], self._looks[0][i], self._places[1][j], self._looks[1][j])

    @cached_property
    def _own_terms(self) -> NDArray[np.float64]:
        """Terms ``(n, k, 4)`` between sampled Gaussians of the first scene and their neighbours."""
        places, looks, some = self._places[0], self._looks[0], self._some
        number = min(_NEIGHBOURS + 1, self.count)
        _, found = Neighbours(places).nearest(places[some], number)
        others = found != some[:, None]
        others[others.all(axis=1), -1] = False
        found = found[others].reshape(len(some), number - 1)
        return _differences(places[some], looks[some], places[found], looks[found])

    @cached_property
    def _unit(self) -> NDArray[np.float64]:
        """The unit of each term: its median over neighbours."""
        own = self._own_terms
        return np.median(own, axis=(0, 1)) if own.size else np.zeros(own.shape[2])


def _differences(a: NDArray, b: NDArray, others: NDArray, looks: NDArray) -> NDArray[np.float64]:
    """Terms of centres ``(n, 3)`` and appearance ``(n, 7)`` against ``(n, k, ...)``."""
    differences = np.abs(looks - b[:, None])
    return np.stack(
        [
            np.sqrt(((others - a[:, None]) ** 2).sum(axis=2)),
            differences[..., :3].max(axis=2),
            differences[..., 3],
            differences[..., 4:].max(axis=2),
        ],
        axis=2,
    )


def _cost(terms: NDArray[np.float64], unit: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):
        return np.minimum(terms / np.maximum(unit, _TINY), _MOST).sum(axis=-1)


def _places(scene: Scene) -> NDArray[np.float64]:
    """Centres ``(N, 3)``, made finite."""
    return np.nan_to_num(scene.positions.T.astype(np.float64), nan=0.0, posinf=1e38, neginf=-1e38)


def _looks(scene: Scene) -> NDArray[np.float64]:
    """Colour, opacity, and sorted log-scales, ``(N, 7)``, made finite."""
    with np.errstate(over="ignore"):
        opacity = 1.0 / (1.0 + np.exp(-scene.opacity.astype(np.float64)))
    scales = np.sort(np.clip(scene.log_scale.astype(np.float64), -_LOG_LIMIT, _LOG_LIMIT), axis=0)
    colour = np.clip(SH_C0 * scene.f_dc.astype(np.float64), -_LOG_LIMIT, _LOG_LIMIT)
    return np.nan_to_num(np.concatenate([colour, opacity, scales]).T)
