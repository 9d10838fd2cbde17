"""Plots of sensitivity curves and of bits per attribute."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gs_codec.analysis.figure import new_figure
from gs_codec.analysis.sensitivity import LEVELS, Sensitivity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKERS = "osD^vX"
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
_HATCHES = ("", "//", "", "\\\\", "", "xx", "", "..", "")


def plot_sensitivity(sensitivity: Sensitivity) -> Figure:
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
