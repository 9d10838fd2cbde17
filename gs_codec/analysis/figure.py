"""Figures of the analysis and the benchmark."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gs_codec.errors import MissingTool

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
