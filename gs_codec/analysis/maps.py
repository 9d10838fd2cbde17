"""Maps of mutual information between the channels of a scene (paper, Section 3.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.analysis.information import Information, into_bins, is_zero, mutual_information
from gs_codec.analysis.plots import new_figure
from gs_codec.coding.ycocg import to_ycocg
from gs_codec.scene import Scene, sh_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_RGB, _YCOCG = ("R", "G", "B"), ("Y", "Co", "Cg")

#: Attributes that SH-AC are compared with.
_OTHERS = {"rot": "rotation", "log_scale": "scaling", "opacity": "opacity", "f_dc": "SH-DC"}
_COMPONENTS = {"rot": "wxyz", "log_scale": "012", "opacity": " ", "f_dc": "RGB"}


#: A colour map that also reads well in greyscale and with colour blindness.
_COLOURS = "cividis"


@dataclass(frozen=True)
class Map:
    """Normalised mutual information of the channels `rows` with the channels `columns`."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    gaussians: int
    information: Information

    def as_dict(self) -> dict:
        """For JSON."""
        return {
            "rows": self.rows,
            "columns": self.columns,
            "gaussians": self.gaussians,
            "nmi": np.round(self.information.corrected, 6).tolist(),
            "nmi_uncorrected": np.round(self.information.raw, 6).tolist(),
            "nmi_shuffled_mean": float(self.information.bias.mean()),
            "nmi_shuffled_max": float(self.information.bias.max()),
        }


def maps_of(
    scene: Scene, bins: int, seed: int, advance: Callable[[], None] | None = None
) -> dict[str, Map]:
    """The maps of a scene, by name; SH-AC maps only if it has SH-AC.

    ``sh-ac`` and ``sh-dc`` compare the channels of the three colours with each other, as stored
    and, with ``-ycocg``, after the colour transform. ``sh-ac-others`` compares SH-AC with the
    other attributes. ``coloured`` leaves out Gaussians that have a colour channel whose SH-AC are
    all (nearly) zero, because these make otherwise independent channels look dependent.
    """
    rng = np.random.default_rng(seed)
    maps: dict[str, Map] = {}

    def add(name: str, planes: NDArray, letters: tuple[str, ...]) -> NDArray[np.int8]:
        codes = into_bins(planes, bins)
        labels = _labels(letters, len(planes) // 3)
        information = mutual_information(codes, codes, bins, rng)
        maps[name] = Map(labels, labels, planes.shape[1], information)
        if advance is not None:
            advance()
        return codes

    add("sh-dc", scene.f_dc, _RGB)
    add("sh-dc-ycocg", to_ycocg(scene.f_dc), _YCOCG)
    if not scene.sh_degree:
        return maps
    colours = scene.f_rest.reshape(3, len(scene.f_rest) // 3, scene.count)
    for name, part in (("sh-ac", scene), ("sh-ac-coloured", scene.take(_coloured(colours)))):
        codes = add(name, part.f_rest, _RGB)
        add(f"{name}-ycocg", _chroma(part.f_rest), _YCOCG)
        others = into_bins(np.concatenate([getattr(part, group) for group in _OTHERS]), bins)
        information = mutual_information(others, codes, bins, rng)
        names = [f"{_OTHERS[g]} {c}".strip() for g in _OTHERS for c in _COMPONENTS[g]]
        maps[f"{name}-others"] = Map(tuple(names), maps[name].rows, part.count, information)
        if advance is not None:
            advance()
    return maps


def map_count(sh_degree: int) -> int:
    """Number of maps that `maps_of` makes."""
    return 8 if sh_degree else 2


def mean_by_relation(of_colours: Map) -> dict[str, float | None]:
    """Mean information of pairs of SH-AC channels, by kind of pair.

    Kinds: different coefficients of one colour, for each colour; the same coefficient of two
    colours, for each pair of colours; different coefficients of two colours. None if there are no
    such pairs.
    """
    size = len(of_colours.rows) // 3
    blocks = of_colours.information.corrected.reshape(3, size, 3, size).transpose(0, 2, 1, 3)
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


def mean_by_attribute(of_others: Map) -> dict[str, float | None]:
    """Mean information of SH-AC channels with the channels of each other attribute."""
    owners = np.array([name.split()[0] for name in of_others.rows])
    values = of_others.information.corrected
    return {name: _mean(values[owners == name]) for name in dict.fromkeys(owners.tolist())}


def _coloured(colours: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Gaussians without a colour channel whose SH-AC ``(3, K, N)`` are all zero."""
    return ~np.any(np.all(is_zero(colours), axis=1), axis=0)


def _mean(values: NDArray) -> float | None:
    return float(values.mean()) if values.size else None


def _chroma(planes: NDArray[np.float32]) -> NDArray[np.float64]:
    """Y, Co, Cg of R, G, B planes ``(3 K, N)``."""
    return to_ycocg(planes.reshape(3, len(planes) // 3, planes.shape[1])).reshape(planes.shape)


def _labels(letters: tuple[str, ...], coefficients: int) -> tuple[str, ...]:
    if coefficients == 1:
        return letters
    return tuple(f"{letter} {k + 1}" for letter in letters for k in range(coefficients))


def plot_within_colours(every: Map, coloured: Map) -> Figure:
    """SH-AC x SH-AC of each colour, for all Gaussians and for the coloured ones."""
    size = len(every.rows) // 3
    figure = new_figure(10.5, 7.4)
    axes = figure.subplots(2, 3, squeeze=False)
    top = _top([every, coloured], size)
    for row, (found, which) in enumerate(((every, "all"), (coloured, "coloured"))):
        for i, letter in enumerate("RGB"):
            block = slice(size * i, size * (i + 1))
            values = _without_self(found.information.corrected)[block, block]
            image = _draw(axes[row, i], values, top)
            _mark_bands(axes[row, i], size)
            mean = np.nanmean(values) if size > 1 else 0.0
            axes[row, i].set_title(f"{letter}, {which} Gaussians: mean {mean:.3f}", fontsize=10)
    _bar(figure, image, axes)
    return figure


def plot_across_colours(maps: Sequence[tuple[str, Map]]) -> Figure:
    """All SH-AC channels of the three colours, one panel for each of four maps."""
    figure = new_figure(10.5, 9.6)
    axes = figure.subplots(2, 2)
    top = _top([found for _, found in maps], len(maps[0][1].rows))
    for axis, (title, found) in zip(axes.flat, maps, strict=True):
        values = _without_self(found.information.corrected)
        image = _draw(axis, values, top)
        size = len(values) // 3
        middles = [size * (i + 0.5) - 0.5 for i in range(3)]
        letters = [found.rows[size * i].split()[0] for i in range(3)]
        axis.set_xticks(middles, letters)
        axis.set_yticks(middles, letters)
        axis.tick_params(length=0)
        for edge in (size, 2 * size):
            axis.axhline(edge - 0.5, color="white", lw=1.2)
            axis.axvline(edge - 0.5, color="white", lw=1.2)
        axis.set_title(title, fontsize=10)
    _bar(figure, image, axes)
    return figure


def plot_others(maps: Sequence[tuple[str, Map]]) -> Figure:
    """SH-AC channels against the other attributes."""
    figure = new_figure(10.5, 5.6)
    axes = figure.subplots(len(maps), 1, squeeze=False)
    top = max(float(found.information.corrected.max()) for _, found in maps)
    for axis, (title, found) in zip(axes.flat, maps, strict=True):
        image = _draw(axis, found.information.corrected, max(top, 0.01))
        axis.set_aspect("auto")
        size = len(found.columns) // 3
        axis.set_yticks(range(len(found.rows)), found.rows, fontsize=7)
        axis.set_xticks([size * (i + 0.5) - 0.5 for i in range(3)], ["SH-AC R", "G", "B"])
        axis.tick_params(length=0)
        for edge in (size, 2 * size):
            axis.axvline(edge - 0.5, color="white", lw=1.2)
        axis.set_title(title, fontsize=10)
    _bar(figure, image, axes)
    return figure


def _draw(axis: Axes, values: NDArray, top: float) -> Any:
    axis.set_facecolor("0.75")  # grey: a channel with itself
    return axis.imshow(values, cmap=_COLOURS, vmin=0.0, vmax=top, interpolation="nearest")


def _mark_bands(axis: Axes, size: int) -> None:
    """Put ticks in the middle of SH bands, and lines between them."""
    bands = sh_bands(size)
    middles = [(band[0] + band[-1]) / 2 for band in bands]
    names = [f"degree {band}" for band in range(1, 1 + len(bands))]
    axis.set_xticks(middles, names, fontsize=8)
    axis.set_yticks(middles, names, fontsize=8, rotation=90, va="center")
    axis.tick_params(length=0)
    for band in bands[1:]:
        axis.axhline(band[0] - 0.5, color="white", lw=0.8)
        axis.axvline(band[0] - 0.5, color="white", lw=0.8)


def _without_self(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.eye(len(values), dtype=bool), np.nan, values)


def _top(maps: Sequence[Map], size: int) -> float:
    """The largest value in the diagonal blocks of `size`, without the diagonal itself."""
    values = [
        _without_self(found.information.corrected)[start : start + size, start : start + size]
        for found in maps
        for start in range(0, len(found.rows), size)
    ]
    return max(float(np.nanmax(values)), 0.01)


def _bar(figure: Figure, image: Any, axes: NDArray) -> None:
    figure.set_layout_engine("constrained")
    label = "normalised mutual information"
    figure.colorbar(image, ax=axes, shrink=0.75, aspect=40, pad=0.02, label=label)
