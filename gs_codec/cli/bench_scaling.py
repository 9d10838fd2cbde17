"""``gs-codec bench --scaling``."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from gs_codec.cli.output import print_table, print_text

_COLUMNS = [
    "scene, profile", "Gaussians", "MB", "encode CPU s", "peak MB", "decode CPU s", "peak MB",
]  # fmt: skip


def measure(
    scenes: list[Path],
    profiles: list[str],
    threads: int | None,
    max_memory: str | None,
    plot: Path | None,
) -> None:
    """Measure scenes of growing size: lines on stdout, a table on stderr, a plot if asked."""
    from gs_codec.bench.measure import machine
    from gs_codec.bench.scaling import measure_scaling, plot_scaling

    options = [] if threads is None else ["--threads", str(threads)]
    options += [] if max_memory is None else ["--max-memory", max_memory]
    print_text(json.dumps(machine()))
    lines: list[dict[str, Any]] = []
    folder = Path(tempfile.gettempdir())
    for line in measure_scaling(scenes, profiles, options, folder):
        print_text(json.dumps(line))
        lines.append(line)
    if plot is not None:
        plot_scaling(lines, plot)
    print_table(_COLUMNS, [_row(line) for line in lines], sys.stderr)


def _row(line: dict[str, Any]) -> list[str]:
    """A scene; or how the costs of a profile grow."""
    if line["kind"] == "growth":
        cells = [f"a million more, {line['profile']}", "1,000,000", ""]
        for way in ("encode", "decode"):
            growth = line.get(way)
            cells += ["", ""] if growth is None else [f"{growth['seconds_per_million']:.2f}", ""]
        return cells
    cells = [f"{line['scene']}, {line['profile']}", f"{line['gaussians']:,}"]
    cells.append(f"{line['file_bytes'] / 1e6:.2f}")
    for way in ("encode", "decode"):
        cells += [f"{line[way]['cpu_seconds']:.1f}", f"{line[way]['peak_bytes'] / 1e6:.0f}"]
    return cells
