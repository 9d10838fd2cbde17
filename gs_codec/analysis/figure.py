"""Figures of the analysis and the benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.errors import MissingTool
from gs_codec.io.atomic import atomic_writer

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def new_figure(width: float, height: float) -> Figure:
    """A figure of so many inches.

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


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as its suffix says, or as PNG; the file appears whole or not at all.

    Raises
    ------
    InvalidInput
        If it cannot be written.
    """
    with atomic_writer(path) as file:
        figure.savefig(file, format=path.suffix[1:] or "png")
