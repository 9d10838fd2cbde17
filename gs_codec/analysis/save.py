"""Analyse the file of a scene, and write a folder with the report."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.analysis.analyse import Analysis, analyse_scene
from gs_codec.analysis.plots import (
    new_figure,
    plot_across_colours,
    plot_attributes,
    plot_bits,
    plot_others,
    plot_sensitivity,
    plot_sh,
    plot_within_colours,
    png_of,
)
from gs_codec.analysis.report import write_page
from gs_codec.files.scenes import read_scene
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import check_writable, write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def analyse_file(
    source: str | Path,
    folder: str | Path,
    *,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Analyse the scene of a file, and write ``report.html``, its pictures and ``report.json``.

    `options` are those of `analyse_scene`.

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
    analysis = analyse_scene(scene, str(source), progress=progress, **options)
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
    figures = list(_figures(analysis))
    advance = step_counter(progress, "pictures", len(figures))
    pictures = {}
    for name, figure in figures:
        pictures[f"{name}.png"] = png_of(figure)
        advance()
    return pictures


def _figures(analysis: Analysis) -> Iterator[tuple[str, Figure]]:
    if analysis.sh_degree:
        yield "sh_ac_within_colours", plot_within_colours(analysis.maps)
        yield "sh_ac_across_colours", plot_across_colours(analysis.maps)
        yield "sh_ac_others", plot_others(analysis.maps)
    yield "histograms", plot_attributes(analysis.fits)
    if analysis.sh_degree:
        for colour, letter in enumerate("rgb"):
            yield f"histograms_sh_ac_{letter}", plot_sh(analysis.fits, colour)
    if analysis.sensitivity is not None:
        yield "sensitivity", plot_sensitivity(analysis.sensitivity)
    yield "bits", plot_bits(analysis.bits)
