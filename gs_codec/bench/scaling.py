"""How time and memory grow with the scene: each measurement is a process of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.analysis.figure import new_figure
from gs_codec.bench.apart import run_apart
from gs_codec.files import inspect_file


def measure_scaling(
    scenes: Sequence[Path], profiles: Sequence[str], options: Sequence[str], folder: Path
) -> Iterator[dict[str, Any]]:
    """A line for each scene and profile, then one for each profile: how costs grow.

    Parameters
    ----------
    scenes : sequence of Path
        PLY files.
    profiles : sequence of str
    options : sequence of str
        Of the commands: threads and memory.
    folder : Path
        Where there is room for what the largest scene decodes to.
    """
    for profile in profiles:
        lines = []
        for number, path in enumerate(scenes):
            if not number:  # compiles, and is not counted
                _measure(path, profile, options, folder)
            line = _measure(path, profile, options, folder)
            lines.append(line)
            yield line
        yield {"kind": "growth", "profile": profile, **_growth(lines)}


def _measure(path: Path, profile: str, options: Sequence[str], folder: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(dir=folder) as name:
        stream, back = Path(name) / "scene.egs", Path(name) / "back.ply"
        encode = run_apart(["encode", str(path), str(stream), "-p", profile, *options])
        decode = run_apart(["decode", str(stream), str(back), *options])
        info = inspect_file(stream)
        return {
            "kind": "scaling",
            "scene": path.stem,
            "profile": profile,
            "options": list(options),
            "gaussians": info.count,
            "float_bytes": info.raw_bytes,
            "ply_bytes": path.stat().st_size,
            "file_bytes": info.file_bytes,
            "encode": asdict(encode),
            "decode": asdict(decode),
        }


def _growth(lines: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Processor seconds as a line: at no Gaussian, for each million, and how far scenes are off."""
    counts = np.array([line["gaussians"] for line in lines], float)
    result: dict[str, Any] = {}
    for way in ("encode", "decode"):
        seconds = np.array([line[way]["cpu_seconds"] for line in lines])
        if len(np.unique(counts)) < 2:
            continue
        # Every scene counts the same, however large it is.
        slope, start = np.polyfit(counts, seconds, 1, w=1 / np.maximum(seconds, 1e-9))
        off = seconds / np.maximum(start + slope * counts, 1e-9) - 1
        result[way] = {
            "start_seconds": float(start),
            "seconds_per_million": 1e6 * float(slope),
            "most_off_percent": 100 * float(np.abs(off).max()),
        }
    return result


def plot_scaling(lines: Sequence[dict[str, Any]], path: Path) -> None:
    """Plot processor seconds and memory against the number of Gaussians to a PNG file.

    Raises
    ------
    MissingTool
        If matplotlib is not installed.
    """
    figure = new_figure(11, 4.5)
    times, memory = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    measured = [line for line in lines if line["kind"] == "scaling"]
    for colour, profile in enumerate(dict.fromkeys(line["profile"] for line in measured)):
        here = sorted(
            (line for line in measured if line["profile"] == profile),
            key=lambda line: line["gaussians"],
        )
        millions = [line["gaussians"] / 1e6 for line in here]
        for way, style in (("encode", "o-"), ("decode", "x--")):
            look: dict[str, Any] = {"color": f"C{colour}", "label": f"{profile}, {way}"}
            times.plot(millions, [line[way]["cpu_seconds"] for line in here], style, **look)
            memory.plot(millions, [line[way]["peak_bytes"] / 1e9 for line in here], style, **look)
    times.set_ylabel("processor seconds")
    memory.set_ylabel("peak memory, GB")
    for axis in (times, memory):
        axis.set_xlabel("million Gaussians")
        axis.set_xlim(left=0)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path)
