"""Bits against quality: the profiles' curves, and where targets came to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gs_codec.analysis.figure import new_figure, save_figure


def plot_targets(lines: list[dict[str, Any]], path: Path) -> None:
    """Plot results of `measure_targets` to a PNG file, a panel for each scene.

    Raises
    ------
    MissingTool
        If matplotlib is not installed.
    """
    scenes = list(dict.fromkeys(line["scene"] for line in lines))
    figure = new_figure(6 * max(len(scenes), 1), 4.5)
    for number, scene in enumerate(scenes, 1):
        axis = figure.add_subplot(1, len(scenes), number)
        of_scene = [line for line in lines if line["scene"] == scene and "mean" in line]
        here = [line for line in of_scene if line["mean"]["psnr"] is not None]
        for colour, curve in enumerate(dict.fromkeys(line["curve"] for line in here)):
            for kind, style in (("profile", "o-"), ("target", "x")):
                points = sorted(
                    (line["bits_per_gaussian"], line["mean"]["psnr"])
                    for line in here
                    if (line["kind"], line["curve"]) == (kind, curve)
                )
                if points:
                    label = f"{'targets' if kind == 'target' else 'l, m, s'} {curve}"
                    axis.plot(*zip(*points, strict=True), style, color=f"C{colour}", label=label)
        axis.set_xlabel("bits a Gaussian")
        axis.set_ylabel("PSNR against the scene's own views, dB")
        axis.set_title(scene)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.tight_layout()
    save_figure(figure, path)
