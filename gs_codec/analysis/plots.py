"""Plots of an analysis: maps, distributions, sensitivity curves, bits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.analysis.analyse import Analysis
from gs_codec.analysis.fits import Fit
from gs_codec.analysis.maps import Map
from gs_codec.analysis.sensitivity_curves import SCALES, SensitivityCurves
from gs_codec.pages.figures import new_figure, png_of
from gs_codec.report import Progress, step_counter
from gs_codec.scene import sh_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = "osD^vX"
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
_HATCHES = ("", "//", "", "\\\\", "", "xx", "", "..", "")

#: Maps of all Gaussians and of coloured ones, with their labels in plots.
_WHICH = {"sh-ac": "all Gaussians", "sh-ac-coloured": "coloured Gaussians"}

#: Colours as stored, and after the transform.
_COLOURS = ("R, G, B", "Y, Co, Cg")

#: Light grey.
_BARS = "0.72"

#: The dark end of cividis.
_CURVE = "#00204c"

_TITLES = {
    "geometry": "positions",
    "sh-dc": "SH-DC",
    "opacity": "opacity (logit)",
    "scaling": "scaling (log)",
    "rotation": "rotation",
}


def draw_pictures(analysis: Analysis, progress: Progress | None = None) -> dict[str, bytes]:
    """Draw the plots of an analysis: PNG data by file name."""
    plots = list(_plots(analysis))
    advance = step_counter(progress, "pictures", len(plots))
    pictures = {}
    for name, plot, *args in plots:
        pictures[f"{name}.png"] = png_of(plot, *args)
        advance()
    return pictures


def _plots(analysis: Analysis) -> Iterator[tuple[Any, ...]]:
    """Name of each picture, the function that plots it, and its arguments."""
    if analysis.sh_degree:
        yield "sh_ac_within_colours", plot_within_colours, analysis.maps
        yield "sh_ac_across_colours", plot_across_colours, analysis.maps
        yield "sh_ac_others", plot_others, analysis.maps
    yield "histograms", plot_attributes, analysis.fits
    if analysis.sh_degree:
        for colour, letter in enumerate("rgb"):
            yield f"histograms_sh_ac_{letter}", plot_sh, analysis.fits, colour
    if analysis.sensitivity is not None:
        yield "sensitivity", plot_sensitivity, analysis.sensitivity
    yield "bits", plot_bits, analysis.bits


def plot_within_colours(maps: Mapping[str, Map]) -> Figure:
    """SH-AC x SH-AC of each colour, for all Gaussians and for the coloured ones."""
    figure = new_figure(10.5, 7.4)
    axes = figure.subplots(2, 3)
    size = len(maps["sh-ac"].rows) // 3
    panels = []
    for row, (name, which) in zip(axes, _WHICH.items(), strict=True):
        for i, axis in enumerate(row):
            block = slice(size * i, size * (i + 1))
            values = _without_self(maps[name])[block, block]
            title = f"{'RGB'[i]}, {which}: mean {np.nanmean(values):.3f}"
            panels.append((axis, title, values))
    _draw_maps(figure, panels)
    for axis in axes.flat:
        _mark_bands(axis, size)
    return figure


def plot_across_colours(maps: Mapping[str, Map]) -> Figure:
    """SH-AC x SH-AC of all colours, before and after YCoCg."""
    figure = new_figure(10.5, 9.6)
    axes = figure.subplots(2, 2)
    names = [f"{name}{suffix}" for name in _WHICH for suffix in ("", "-ycocg")]
    titles = [f"{colours}, {which}" for which in _WHICH.values() for colours in _COLOURS]
    values = [_without_self(maps[name]) for name in names]
    _draw_maps(figure, list(zip(axes.flat, titles, values, strict=True)))
    for axis, name in zip(axes.flat, names, strict=True):
        _mark_colours(axis.set_xticks, axis.axvline, maps[name])
        _mark_colours(axis.set_yticks, axis.axhline, maps[name])
    return figure


def plot_others(maps: Mapping[str, Map]) -> Figure:
    """SH-AC channels against the other attributes."""
    figure = new_figure(10.5, 5.6)
    axes = figure.subplots(2, 1)
    found = [maps[f"{name}-others"] for name in _WHICH]
    values = [each.information["counts"].corrected for each in found]
    _draw_maps(figure, list(zip(axes, _WHICH.values(), values, strict=True)))
    for axis, each in zip(axes, found, strict=True):
        axis.set_aspect("auto")
        axis.set_yticks(range(len(each.rows)), each.rows, fontsize=7)
        _mark_colours(axis.set_xticks, axis.axvline, each)
    return figure


def _without_self(found: Map) -> NDArray[np.float64]:
    """The values of a map; NaN for a channel with itself."""
    values = found.information["counts"].corrected
    return np.where(np.eye(len(values), dtype=bool), np.nan, values)


def _draw_maps(figure: Figure, panels: Sequence[tuple[Axes, str, NDArray[np.float64]]]) -> None:
    """Draw panels with titles on one colour scale, with a colour bar; NaN is grey."""
    top = max(0.01, *(float(np.nanmax(values)) for _, _, values in panels))
    for axis, title, values in panels:
        axis.set_facecolor("0.75")
        # This colour map is also readable in greyscale and with colour blindness.
        image = axis.imshow(values, cmap="cividis", vmin=0.0, vmax=top, interpolation="nearest")
        axis.set_title(title, fontsize=10)
        axis.tick_params(length=0)
        axis.grid(False)
        axis.spines[:].set_visible(True)
    figure.set_layout_engine("constrained")
    label = "normalised mutual information"
    axes = [axis for axis, _, _ in panels]
    figure.colorbar(image, ax=axes, shrink=0.75, aspect=40, pad=0.02, label=label)


def _mark_bands(axis: Axes, size: int) -> None:
    """Put ticks in the middle of SH bands, and lines between them."""
    bands = sh_bands(size)
    middles = [(band[0] + band[-1]) / 2 for band in bands]
    names = [f"degree {band}" for band in range(1, 1 + len(bands))]
    axis.set_xticks(middles, names, fontsize=8)
    axis.set_yticks(middles, names, fontsize=8, rotation=90, va="center")
    for band in bands[1:]:
        axis.axhline(band[0] - 0.5, color="white", lw=0.8)
        axis.axvline(band[0] - 0.5, color="white", lw=0.8)


def _mark_colours(set_ticks: Callable, draw_line: Callable, found: Map) -> None:
    """Put ticks in the middle of the columns of each colour, and lines between them."""
    size = len(found.columns) // 3
    starts = [0, size, 2 * size]
    letters = [found.columns[start].split()[0] for start in starts]
    set_ticks([start + (size - 1) / 2 for start in starts], letters)
    for start in starts[1:]:
        draw_line(start - 0.5, color="white", lw=1.2)


def plot_sensitivity(sensitivity: SensitivityCurves) -> Figure:
    """PSNR against the error of each attribute; hollow marks show the errors of the profile."""
    from matplotlib import colormaps

    figure = new_figure(9.5, 5.6)
    axis = figure.add_subplot()
    curves = [curve for curve in sensitivity.curves if any(curve.errors)]
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(curves)))
    for i, curve in enumerate(curves):
        style = {"color": shades[i], "marker": _MARKERS[i], "ms": 5}
        axis.plot(curve.errors, curve.psnr, linestyle=_DASHES[i], label=curve.attribute, **style)
        if curve.errors[0] <= curve.profile_error <= curve.errors[-1]:
            at = np.interp(np.log(curve.profile_error), np.log(curve.errors), curve.psnr)
            hollow = style | {"ms": 13, "mfc": "none", "mew": 1.8}
            axis.plot(curve.profile_error, at, linestyle="none", **hollow)
    axis.set_xscale("log")
    axis.set_xlabel(f"error: {SCALES[sensitivity.scale]}")
    axis.set_ylabel("PSNR of views against the unchanged scene, dB")
    if curves:
        axis.legend(title=f"error in (hollow: {sensitivity.profile})")
    figure.tight_layout()
    return figure


def plot_bits(bits: dict[str, dict[str, float]]) -> Figure:
    """Stacked bars of bits per Gaussian; the lossless profile has its own axis."""
    lossy = {profile: parts for profile, parts in bits.items() if profile != "lossless"}
    figure = new_figure(9.5, 5.4)
    above, below = figure.subplots(2, 1, height_ratios=(len(lossy), 1.3))
    _stack(above, lossy)
    _stack(below, {"lossless": bits["lossless"]})
    below.set_xlabel("bits per Gaussian")
    handles, labels = above.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", ncols=5)
    figure.tight_layout(rect=(0, 0, 1, 0.9))
    return figure


def _stack(axis: Axes, bits: dict[str, dict[str, float]]) -> None:
    from matplotlib import colormaps

    names = list(bits)
    parts = list(bits[names[0]])
    shades = colormaps["cividis"](np.linspace(0.05, 1.0, len(parts)))
    totals = np.array([sum(bits[name].values()) for name in names])
    left = np.zeros(len(names))
    box = {"fc": "white", "ec": "none", "pad": 1.0, "alpha": 0.85}
    for i, part in enumerate(parts):
        width = np.array([bits[name][part] for name in names])
        bars = axis.barh(
            names, width, 0.7, left, color=shades[i], hatch=_HATCHES[i],
            edgecolor="white" if i < 5 else "0.35", lw=0.6, label=part,
        )  # fmt: skip
        labels = [f"{value:.0f}" if value > 0.05 * totals.max() else "" for value in width]
        axis.bar_label(bars, labels, label_type="center", fontsize=8, bbox=box)
        left += width
    axis.bar_label(bars, [f" {total:.1f}" for total in totals], fontsize=9, weight="bold")
    axis.invert_yaxis()
    axis.margins(x=0.08)
    axis.set_xlim(left=0)
    axis.grid(axis="y", visible=False)


def plot_attributes(fits: Sequence[Fit]) -> Figure:
    """Histograms of all channels except SH-AC, one row per attribute."""
    figure = new_figure(10.5, 10.5)
    axes = figure.subplots(len(_TITLES), 4)
    _draw_rows(axes, [[fit for fit in fits if fit.channel.stream == group] for group in _TITLES])
    figure.tight_layout()
    return figure


def plot_sh(fits: Sequence[Fit], colour: int) -> Figure:
    """Histograms of SH-AC of one colour, one row per band, with logarithmic densities."""
    members = [fit for fit in fits if fit.channel.group == "f_rest"]
    size = len(members) // 3
    mine = {fit.channel.index: fit for fit in members if fit.channel.index // size == colour}
    bands = sh_bands(size)
    height = 1.8 * len(bands) + 0.3
    figure = new_figure(10.5, height)
    axes = figure.subplots(len(bands), max(map(len, bands)), squeeze=False, sharey=True)
    _draw_rows(axes, [[mine[size * colour + k] for k in band] for band in bands])
    seen = np.concatenate([fit.density[fit.density > 0] for fit in mine.values()])
    if seen.size:
        axes[0, 0].set_yscale("log", subs=(2, 5))  # each tick of many axes takes time
        axes[0, 0].set_ylim(seen.min() / 2, seen.max() * 30)
    figure.subplots_adjust(0.045, 0.25 / height, 0.995, 1 - 0.25 / height, 0.08, 0.32)
    return figure


def _draw_rows(axes: NDArray, rows: Sequence[Sequence[Fit]]) -> None:
    """Draw a histogram on each axis; hide unused axes of a row."""
    for row, fits in zip(axes, rows, strict=True):
        for axis, fit in zip(row, fits, strict=False):
            _draw_histogram(axis, fit)
        for axis in row[len(fits) :]:
            axis.set_visible(False)


def _draw_histogram(axis: Axes, fit: Fit) -> None:
    """Draw bars, the model's curve, and the distance of the model."""
    title = _TITLES.get(fit.channel.stream)
    axis.set_title(f"{title}: {fit.channel.name}" if title else fit.channel.name, fontsize=8)
    axis.tick_params(labelsize=6)
    axis.locator_params(axis="x", nbins=4)
    if not len(fit.density):
        axis.text(0.5, 0.5, "constant", ha="center", va="center", transform=axis.transAxes)
        axis.tick_params(bottom=False, labelbottom=False, left=False, labelleft=False)
        return
    axis.stairs(fit.density, fit.edges, fill=True, color=_BARS)
    if fit.ks is not None:
        x = np.linspace(fit.edges[0], fit.edges[-1], 400)
        axis.plot(x, fit.pdf(x), color=_CURVE, lw=1.1)
        label = f"KS {fit.ks:.3f}\nKL {fit.kl_bits:.3f} bit"
        axis.text(0.97, 0.95, label, ha="right", va="top", fontsize=6, transform=axis.transAxes)
    axis.set_xlim(fit.edges[0], fit.edges[-1])
    if title:
        axis.set_yticks([])
        axis.set_ylim(0, 1.4 * axis.get_ylim()[1])  # space for the numbers
