"""Analyse the file of a scene, and write a folder with the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gs_codec.analysis.analyse import analyse_scene
from gs_codec.analysis.plots import draw_pictures, new_figure
from gs_codec.analysis.report import write_page
from gs_codec.files.scenes import read_scene
from gs_codec.report import Progress
from gs_codec.runtime.atomic import check_writable, write_files


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
