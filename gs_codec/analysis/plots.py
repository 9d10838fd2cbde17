"""Plots of distributions and of sensitivity curves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gs_codec.analysis.fits import Fit
from gs_codec.analysis.sensitivity import LEVELS, SensitivityCurves
from gs_codec.errors import MissingTool
from gs_codec.scene import sh_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = "osD^vX"
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
_HATCHES = ("", "//", "", "\\\\", "", "xx", "", "..", "")

_BARS, _CURVE = "0.72", "#00204c"  # light grey; the dark end of cividis

_TITLES = {
    "geometry": "positions",
    "sh-dc": "SH-DC",
    "opacity": "opacity (logit)",
    "scaling": "scaling (log)",
    "rotation": "rotation",
}


def new_figure(width: float, height: float) -> Figure:
    """A new figure; width and height in inches.

    Raises
    ------
    MissingTool
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingTool("plots: need matplotlib (pip install matplotlib)") from None
    return Figure(figsize=(width, height), dpi=110)


def plot_sensitivity(sensitivity: SensitivityCurves) -> Figure:
    """PSNR against the error of each attribute; hollow marks show the profile's own errors."""
    from matplotlib import colormaps

    figure = new_figure(9.5, 5.6)
    axis = figure.add_subplot()
    curves = sensitivity.curves
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(curves)))
    for i, curve in enumerate(curves):
        style = {"color": shades[i], "marker": _MARKERS[i], "ms": 5}
        axis.plot(LEVELS, curve.psnr, linestyle=_DASHES[i], label=curve.attribute, **style)
        if LEVELS[0] <= curve.profile_level <= LEVELS[-1]:
            at = np.interp(np.log(curve.profile_level), np.log(LEVELS), curve.psnr)
            hollow = style | {"ms": 13, "mfc": "none", "mew": 1.8}
            axis.plot(curve.profile_level, at, linestyle="none", **hollow)
    axis.set_xscale("log")
    axis.set_xlabel("error, root mean square, in standard deviations of the channel")
    axis.set_ylabel("PSNR of views against the unchanged scene, dB")
    axis.grid(alpha=0.3)
    axis.legend(title=f"error in (hollow: {sensitivity.profile})", fontsize=9)
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
    figure.legend(handles, labels, loc="upper center", ncols=5, fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0, 1, 0.9))
    return figure


def _stack(axis: Axes, bits: dict[str, dict[str, float]]) -> None:
    from matplotlib import colormaps

    names = list(bits)
    parts = list(bits[names[0]])
    shades = colormaps["cividis"](np.linspace(0.05, 1.0, len(parts)))
    left = np.zeros(len(names))
    for i, part in enumerate(parts):
        width = np.array([bits[name][part] for name in names])
        drawn = axis.barh(
            names, width, 0.7, left, color=shades[i], hatch=_HATCHES[i],
            edgecolor="white" if i < 5 else "0.35", lw=0.6, label=part,
        )  # fmt: skip
        for bar, value in zip(drawn, width, strict=True):
            if value > 0.05 * max(sum(row.values()) for row in bits.values()):
                x, y = bar.get_x() + value / 2, bar.get_y() + bar.get_height() / 2
                box = {"fc": "white", "ec": "none", "pad": 1.0, "alpha": 0.85}
                axis.text(x, y, f"{value:.0f}", ha="center", va="center", fontsize=8, bbox=box)
        left += width
    for row, total in enumerate(left):
        axis.text(total, row, f" {total:.1f}", va="center", fontsize=9, weight="bold")
    axis.invert_yaxis()
    axis.margins(x=0.08)
    axis.set_xlim(left=0)
    axis.spines[["top", "right"]].set_visible(False)


def plot_attributes(fits: Sequence[Fit]) -> Figure:
    """Histograms of all channels except SH-AC, one row per attribute."""
    groups = list(_TITLES)
    figure = new_figure(10.5, 10.5)
    axes = figure.subplots(len(groups), 4)
    for row, group in zip(axes, groups, strict=True):
        members = [fit for fit in fits if fit.channel.stream == group]
        for axis, fit in zip(row, members, strict=False):
            _draw(axis, fit, f"{_TITLES[group]}: {fit.channel.name}", False)
        for axis in row[len(members) :]:
            axis.set_visible(False)
    figure.tight_layout()
    return figure


def plot_sh(fits: Sequence[Fit], colour: int) -> Figure:
    """Histograms of SH-AC of one colour, one row per band, with logarithmic densities."""
    members = [fit for fit in fits if fit.channel.group == "f_rest"]
    size = len(members) // 3
    mine = [fit for fit in members if fit.channel.index // size == colour]
    bands = sh_bands(size)
    height = 1.8 * len(bands) + 0.3
    figure = new_figure(10.5, height)
    widest = max(map(len, bands))
    axes = figure.subplots(len(bands), widest, squeeze=False, sharey=True)
    for row, band in zip(axes, bands, strict=True):
        shown = [fit for fit in mine if fit.channel.index % size in band]
        for axis, fit in zip(row, shown, strict=False):
            _draw(axis, fit, fit.channel.name, True)
        for axis in row[len(band) :]:
            axis.set_visible(False)
    seen = np.concatenate([fit.density[fit.density > 0] for fit in mine])
    if seen.size:
        axes[0, 0].set_yscale("log")
        axes[0, 0].set_ylim(seen.min() / 2, seen.max() * 30)
    figure.subplots_adjust(0.045, 0.25 / height, 0.995, 1 - 0.25 / height, 0.08, 0.32)
    return figure


def _draw(axis: Axes, fit: Fit, title: str, logarithmic: bool) -> None:
    axis.set_title(title, fontsize=8)
    axis.tick_params(labelsize=6)
    axis.locator_params(axis="x", nbins=4)
    if not len(fit.density):
        axis.text(0.5, 0.5, "constant", ha="center", va="center", transform=axis.transAxes)
        axis.tick_params(bottom=False, labelbottom=False, left=False, labelleft=False)
        return
    axis.stairs(fit.density, fit.edges, fill=True, color=_BARS)
    if fit.model != "none" and fit.ks is not None:
        x = np.linspace(fit.edges[0], fit.edges[-1], 400)
        axis.plot(x, fit.pdf(x), color=_CURVE, lw=1.1)
        label = f"KS {fit.ks:.3f}\nKL {fit.kl_bits:.3f} bit"
        axis.text(0.97, 0.95, label, ha="right", va="top", fontsize=6, transform=axis.transAxes)
    axis.set_xlim(fit.edges[0], fit.edges[-1])
    if not logarithmic:
        axis.set_yticks([])
        axis.set_ylim(0, 1.4 * axis.get_ylim()[1])  # room for the numbers
