"""Heat maps of mutual information."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.analysis.figure import new_figure
from gs_codec.analysis.maps import Map
from gs_codec.scene import sh_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: A colour map that also reads well in greyscale and with colour blindness.
_COLOURS = "cividis"


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
