"""Ratio against loss, a line for each share that was pruned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gs_codec.analysis.figure import new_figure, save_figure


def plot_frontier(lines: list[dict[str, Any]], path: Path) -> None:
    """Plot results of `measure_frontier` to a PNG file.

    Raises
    ------
    MissingTool
        If matplotlib is not installed.
    """
    figure = new_figure(7, 4.5)
    axis = figure.add_subplot()
    groups: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for line in lines:
        groups.setdefault((f"{line['scene']}, {line['profile']}", line["percent"]), []).append(line)
    for (label, percent), points in groups.items():
        ratios = [point["ratio"] for point in points]
        losses = [point["delta"]["psnr"] for point in points]
        axis.plot(ratios, losses, marker="o", label=f"{label}, {percent:g} % pruned")
    axis.set_xlabel("times smaller than the PLY")
    axis.set_ylabel("delta-PSNR, dB")
    axis.set_title("Leave-one-out pruning and SH compaction (along each line), then coding")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    figure.tight_layout()
    save_figure(figure, path)
