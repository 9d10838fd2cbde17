"""Matplotlib figures in one style."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from typing import TYPE_CHECKING, Any

from gs_codec.runtime.optional import needed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Matplotlib settings for every figure.
_STYLE = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.dpi": 130,
    "font.size": 9.5,
    "grid.color": "#e2e2e2",
    "legend.edgecolor": "none",
    "legend.fontsize": 8.5,
    "legend.framealpha": 1.0,
}


def new_figure(width: float, height: float) -> Figure:
    """A new figure; width and height in inches.

    Raises MissingTool if matplotlib is not installed.
    """
    return needed("matplotlib.figure", "plots").Figure(figsize=(width, height))


def png_of(plot: Callable[..., Figure], *args: Any) -> bytes:
    """PNG data of the figure ``plot(*args)``, in the common style.

    Raises MissingTool if matplotlib is not installed.
    """
    canvas = needed("matplotlib.backends.backend_agg", "plots").FigureCanvasAgg
    buffer = BytesIO()
    with needed("matplotlib", "plots").rc_context(_STYLE):
        canvas(plot(*args)).print_png(buffer)  # `savefig` would draw a figure with a layout twice
    return buffer.getvalue()


def make_logarithmic(axis: Axes, which: str) -> None:
    """Make axis ``x`` or ``y`` logarithmic, with plain numbers at 1, 2 and 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    (axis.set_xscale if which == "x" else axis.set_yscale)("log")
    side = axis.xaxis if which == "x" else axis.yaxis
    side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    side.set_minor_locator(NullLocator())
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
