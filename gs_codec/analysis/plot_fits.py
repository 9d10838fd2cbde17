"""Plots of histograms of channels with the curves of their models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gs_codec.analysis.figure import new_figure
from gs_codec.analysis.fits import Fit
from gs_codec.scene import sh_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BARS, _CURVE = "0.72", "#00204c"  # light grey; the dark end of cividis

_TITLES = {
    "geometry": "positions",
    "sh-dc": "SH-DC",
    "opacity": "opacity (logit)",
    "scaling": "scaling (log)",
    "rotation": "rotation",
}


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
