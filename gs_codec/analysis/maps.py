"""Maps of mutual information between the channels of a scene (paper, Section 3.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.analysis.information import (
    BINS,
    Bins,
    Information,
    into_bins,
    is_zero,
    mutual_information,
)
from gs_codec.coding.ycocg import to_ycocg
from gs_codec.report import Progress, step_counter
from gs_codec.scene import Scene

_RGB = ("R", "G", "B")
_YCOCG = ("Y", "Co", "Cg")

#: Attributes that SH-AC are compared with.
_OTHERS = {"rot": "rotation", "log_scale": "scaling", "opacity": "opacity", "f_dc": "SH-DC"}
_COMPONENTS = {"rot": "wxyz", "log_scale": "012", "opacity": " ", "f_dc": "RGB"}


@dataclass(frozen=True)
class Map:
    """Normalised mutual information of the channels `rows` with the channels `columns`.

    `information` has results for bins of equal ``counts`` and of equal ``widths``.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    gaussians: int
    information: Mapping[Bins, Information]

    def as_dict(self) -> dict:
        """Convert for JSON."""
        return {
            "rows": self.rows,
            "columns": self.columns,
            "gaussians": self.gaussians,
        } | {
            kind: {
                "nmi": np.round(found.corrected, 6).tolist(),
                "nmi_uncorrected": np.round(found.raw, 6).tolist(),
                "nmi_shuffled_mean": float(found.bias.mean()),
                "nmi_shuffled_max": float(found.bias.max()),
            }
            for kind, found in self.information.items()
        }


class _Channels(NamedTuple):
    """Binned channels, with either kind of bins ``(C, N)``, and their names."""

    codes: Mapping[Bins, NDArray[np.int8]]
    labels: tuple[str, ...]


def maps_of(scene: Scene, bins: int, seed: int, progress: Progress | None = None) -> dict[str, Map]:
    """The maps of a scene, by name; SH-AC maps only if it has SH-AC.

    ``sh-ac`` and ``sh-dc`` compare the channels of the three colours with each other, as stored
    and, with ``-ycocg``, after the colour transform. ``sh-ac-others`` compares SH-AC with the other
    attributes. ``coloured`` excludes Gaussians in which the SH-AC of a colour are all (nearly)
    zero, because these make independent channels look dependent.
    """
    rngs = {kind: np.random.default_rng(seed) for kind in BINS}
    advance = step_counter(progress, "mutual information", 8 if scene.sh_degree else 2)
    maps: dict[str, Map] = {}

    def compare(name: str, rows: _Channels, columns: _Channels) -> None:
        information = {
            kind: mutual_information(rows.codes[kind], columns.codes[kind], bins, rngs[kind])
            for kind in BINS
        }
        count = rows.codes["counts"].shape[1]
        maps[name] = Map(rows.labels, columns.labels, count, information)
        advance()

    def compare_colours(name: str, planes: NDArray[np.float32]) -> _Channels:
        stored = _colours(planes, _RGB, bins)
        transformed = to_ycocg(_by_colour(planes)).reshape(planes.shape)
        compare(name, stored, stored)
        other = _colours(transformed, _YCOCG, bins)
        compare(f"{name}-ycocg", other, other)
        return stored

    compare_colours("sh-dc", scene.f_dc)
    if not scene.sh_degree:
        return maps
    coloured = scene.take(_coloured(_by_colour(scene.f_rest)))
    for name, part in (("sh-ac", scene), ("sh-ac-coloured", coloured)):
        sh_ac = compare_colours(name, part.f_rest)
        planes = np.concatenate([getattr(part, group) for group in _OTHERS])
        labels = [f"{_OTHERS[g]} {c}".strip() for g in _OTHERS for c in _COMPONENTS[g]]
        compare(f"{name}-others", _Channels(_codes(planes, bins), tuple(labels)), sh_ac)
    return maps


def mean_by_relation(of_colours: Map, kind: Bins = "counts") -> dict[str, float | None]:
    """Mean information of pairs of SH-AC channels, by kind of pair.

    Kinds: different coefficients of one colour, for each colour; the same coefficient of two
    colours, for each pair of colours; different coefficients of two colours. None if there are no
    such pairs.
    """
    size = len(of_colours.rows) // 3
    values = of_colours.information[kind].corrected
    blocks = values.reshape(3, size, 3, size).transpose(0, 2, 1, 3)
    letters = [of_colours.rows[size * i].split()[0] for i in range(3)]
    same = np.eye(size, dtype=bool)
    pairs = ((0, 1), (0, 2), (1, 2))
    means = {f"{letters[i]}, different coefficients": _mean(blocks[i, i][~same]) for i in range(3)}
    means |= {
        f"{letters[i]} and {letters[j]}, same coefficient": _mean(blocks[i, j][same])
        for i, j in pairs
    }
    across = [blocks[i, j][~same] for i, j in pairs]
    which = f"two of {', '.join(letters)}, different coefficients"
    return means | {which: _mean(np.concatenate(across))}


def mean_by_attribute(of_others: Map, kind: Bins = "counts") -> dict[str, float | None]:
    """Mean information of SH-AC channels with the channels of each other attribute."""
    owners = np.array([name.split()[0] for name in of_others.rows])
    values = of_others.information[kind].corrected
    return {name: _mean(values[owners == name]) for name in dict.fromkeys(owners.tolist())}


def _coloured(colours: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Gaussians without a colour channel whose SH-AC ``(3, K, N)`` are all zero."""
    return ~np.any(np.all(is_zero(colours), axis=1), axis=0)


def _mean(values: NDArray) -> float | None:
    return float(values.mean()) if values.size else None


def _by_colour(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Reshape planes ``(3 K, N)`` to ``(3, K, N)``."""
    return planes.reshape(3, len(planes) // 3, planes.shape[1])


def _colours(planes: NDArray, letters: tuple[str, ...], bins: int) -> _Channels:
    """Channels of three colours ``(3 K, N)``."""
    number = len(planes) // 3
    numbered = [f"{letter} {k + 1}" for letter in letters for k in range(number)]
    return _Channels(_codes(planes, bins), letters if number == 1 else tuple(numbered))


def _codes(planes: NDArray, bins: int) -> dict[Bins, NDArray[np.int8]]:
    return {kind: into_bins(planes, bins, kind) for kind in BINS}
