"""Analyse the file of a scene, and write a folder with the report."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.analysis.analyse import Analysis, Options, analyse_scene
from gs_codec.analysis.maps import plot_across_colours, plot_others, plot_within_colours
from gs_codec.analysis.plots import (
    new_figure,
    plot_attributes,
    plot_bits,
    plot_sensitivity,
    plot_sh,
)
from gs_codec.analysis.report import write_page
from gs_codec.files.scenes import read_scene
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import check_writable, write_files

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def analyse_file(
    source: str | Path,
    folder: str | Path,
    options: Options | None = None,
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> dict[str, Any]:
    """Analyse the scene of a file, and write ``report.html``, its pictures and ``report.json``.

    Returns
    -------
    dict
        Contents of ``report.json``.

    Raises
    ------
    InvalidInput
        If the scene cannot be used, or the folder cannot be written to.
    MissingTool
        If matplotlib is not installed.
    """
    # Find out that the report cannot be written before doing the work.
    new_figure(1, 1)
    target = Path(folder)
    there = next(path for path in (target, *target.absolute().parents) if path.exists())
    check_writable(there / "report.html")
    scene = read_scene(source, "drop", max_bytes=max_bytes)
    analysis = analyse_scene(scene, str(source), options, progress)
    pictures = draw_pictures(analysis, progress)
    content = analysis.as_dict() | {"pictures": list(pictures)}
    files = pictures | {
        "report.json": (json.dumps(content, allow_nan=False) + "\n").encode(),
        "report.html": write_page(analysis, pictures).encode(),
    }
    write_files(target, files)
    return content


def draw_pictures(analysis: Analysis, progress: Progress | None = None) -> dict[str, bytes]:
    """Draw the plots of an analysis: PNG data by file name."""
    plots = _plots(analysis)
    advance = step_counter(progress, "pictures", len(plots))
    pictures = {}
    for name, plot in plots.items():
        buffer = BytesIO()
        plot().savefig(buffer, format="png")
        pictures[name] = buffer.getvalue()
        if advance is not None:
            advance()
    return pictures


def _plots(analysis: Analysis) -> dict[str, Callable[[], Figure]]:
    maps, fits = analysis.maps, analysis.fits
    plots: dict[str, Callable[[], Figure]] = {}
    if "sh-ac" in maps:
        panels = [
            (f"{'Y, Co, Cg' if suffix else 'R, G, B'}, {which}", maps[f"{name}{suffix}"])
            for name, which in (("sh-ac", "all Gaussians"), ("sh-ac-coloured", "coloured ones"))
            for suffix in ("", "-ycocg")
        ]
        others = [
            ("all Gaussians", maps["sh-ac-others"]),
            ("coloured ones", maps["sh-ac-coloured-others"]),
        ]
        plots["sh_ac_within_colours.png"] = lambda: plot_within_colours(
            maps["sh-ac"], maps["sh-ac-coloured"]
        )
        plots["sh_ac_across_colours.png"] = lambda: plot_across_colours(panels)
        plots["sh_ac_others.png"] = lambda: plot_others(others)
    plots["histograms.png"] = lambda: plot_attributes(fits)
    if "sh-ac" in maps:
        for colour, letter in enumerate("rgb"):
            name = f"histograms_sh_ac_{letter}.png"
            plots[name] = lambda colour=colour: plot_sh(fits, colour)  # type: ignore[misc]
    if (measured := analysis.sensitivity) is not None:
        plots["sensitivity.png"] = lambda: plot_sensitivity(measured)
    plots["bits.png"] = lambda: plot_bits(analysis.bits)
    return plots
