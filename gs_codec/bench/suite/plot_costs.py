"""Plots of what coding costs: stages, memory, growth; and of what parts save."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gs_codec.analysis.figure import new_figure
from gs_codec.bench.suite.looks import ATTRIBUTES, PAPER, VIEWS, plain
from gs_codec.bench.suite.plots import WIDTH, ticks_of_logs, titled
from gs_codec.bench.suite.results import Line, Results, finite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Stages of decoding; all others are of encoding.
DECODING = ("decode", "rows")

#: Stages by names that say more.
_NAMES = {"decode": "decode to planes", "rows": "rows of a PLY", "read": "read the PLY"}

_SHADES = ("#c9d4df", "#0a6ebd", "#7fb3dc", "#d1580b", "#f0b48a", "#5b5b5b", "#12858a", "#a3468f")
_PROFILE_COLOURS = {"m": ATTRIBUTES, "paper-m": PAPER}


def plot_stages(lines: Sequence[Line], title: str) -> Figure:
    """Stacked bars of the stages of each profile: encoding, and below it decoding."""
    figure = new_figure(WIDTH, 1.7 + 0.62 * len(lines))
    above, below = figure.subplots(2, 1)
    encoding = [{n: s for n, s in line["stages"].items() if n not in DECODING} for line in lines]
    decoding = [{n: s for n, s in line["stages"].items() if n in DECODING} for line in lines]
    names = [plain(line["profile"]) for line in lines]
    shades = iter(_SHADES * 4)
    for axis, stages, way in ((above, encoding, "encode"), (below, decoding, "decode")):
        _stack(axis, names, stages, shades)
        axis.set_xlabel(f"seconds to {way}")
    return titled(figure, title)


def _merged(stages: Sequence[dict[str, float]]) -> list[str]:
    """All stages in the order they run in, those of some profiles after what is before them."""
    merged: list[str] = []
    for row in stages:
        at = 0
        for name in row:
            if name not in merged:
                merged.insert(at, name)
            at = merged.index(name) + 1
    return merged


def _stack(
    axis: Axes, names: Sequence[str], stages: Sequence[dict[str, float]], shades: Iterator[str]
) -> None:
    parts = _merged(stages)
    left = np.zeros(len(names))
    for part in parts:
        width = np.array([row.get(part, 0.0) for row in stages])
        axis.barh(
            range(len(names)),
            width,
            0.66,
            left,
            color=next(shades),
            label=_NAMES.get(part, plain(part)),
        )
        left += width
    for row, total in enumerate(left):
        axis.annotate(
            f"{total:.3f}", (total, row), (4, 0), textcoords="offset points", va="center",
            fontsize=8.5,
        )  # fmt: skip
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlim(0, 1.12 * max(left.max(initial=0.0), 1e-9))
    axis.grid(axis="y", visible=False)
    axis.legend(fontsize=8.5, loc="center left", bbox_to_anchor=(1.0, 0.5))


def plot_memory(lines: Sequence[Line], title: str) -> Figure:
    """Peak memory of encoding and of decoding with each profile, beside the floats' size."""
    figure = new_figure(WIDTH, 1.5 + 0.5 * len(lines))
    axis = figure.add_subplot()
    for offset, way, colour in ((-0.19, "encode", ATTRIBUTES), (0.19, "decode", "#7fb3dc")):
        peaks = [line[f"{way}_peak_bytes"] / 1e6 for line in lines]
        axis.barh(np.arange(len(lines)) + offset, peaks, 0.36, color=colour, label=way)
        for row, peak in enumerate(peaks):
            axis.annotate(
                f"{peak:.0f}", (peak, row + offset), (4, 0), textcoords="offset points",
                va="center", fontsize=8.5,
            )  # fmt: skip
    floats = lines[0]["float_bytes"] / 1e6
    axis.axvline(floats, color="#222222", lw=1.2, ls=(0, (4, 2)), label="the scene's floats")
    axis.set_yticks(range(len(lines)), [plain(line["profile"]) for line in lines])
    axis.invert_yaxis()
    axis.margins(x=0.1)
    axis.set_xlabel("peak resident memory of the whole process, MB")
    axis.grid(axis="y", visible=False)
    axis.legend(fontsize=8.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return titled(figure, title)


def plot_scaling(results: Results, title: str) -> Figure:
    """Processor seconds, and peak memory beside the floats' size, against Gaussians."""
    lines = sorted(results.of("scaling"), key=lambda line: line["gaussians"])
    figure = new_figure(WIDTH, 4.6)
    times, memory = figure.subplots(1, 2)
    profiles = list(dict.fromkeys(line["profile"] for line in lines))
    for number, profile in enumerate(profiles):
        here = [line for line in lines if line["profile"] == profile]
        counts = [line["gaussians"] for line in here]
        colour = _PROFILE_COLOURS.get(profile, (VIEWS, "#12858a", "#a3468f")[number % 3])
        for way, style, mark in (("encode", "-", "o"), ("decode", "--", "v")):
            look = {"color": colour, "ls": style, "marker": mark, "ms": 5, "lw": 1.5}
            label = f"{plain(profile)}, {way}"
            times.plot(counts, [line[way]["cpu_seconds"] for line in here], **look, label=label)
            memory.plot(counts, [line[way]["peak_bytes"] / 1e6 for line in here], **look)
    counts = [line["gaussians"] for line in lines]
    floats = [line["float_bytes"] / 1e6 for line in lines]
    memory.plot(counts, floats, color="#222222", lw=1.2, ls=":", label="the scene's floats")
    both = ("encode", "decode")
    seconds = [line[way]["cpu_seconds"] for line in lines for way in both]
    peaks = floats + [line[way]["peak_bytes"] / 1e6 for line in lines for way in both]
    for axis, values, name in (
        (times, seconds, "processor seconds, start included"),
        (memory, peaks, "peak memory, MB"),
    ):
        axis.set_xscale("log")
        axis.set_yscale("log")
        ticks_of_logs(axis, counts, "x")
        ticks_of_logs(axis, values, "y")
        axis.set_xlabel("Gaussians (both axes logarithmic)")
        axis.set_title(name)
    times.legend(fontsize=8.5)
    memory.legend(fontsize=8.5)
    return titled(figure, title)


def plot_parts(lines: Sequence[Line], far: Sequence[bool], title: str) -> Figure:
    """Bits a Gaussian that each part of the codec saves at equal quality; `far` are guesses."""
    parts = sorted(
        (finite(line["saved_bits"]) or 0.0, plain(line["without"], 60), guess)
        for line, guess in zip(lines, far, strict=True)
    )
    figure = new_figure(WIDTH, 1.2 + 0.36 * len(parts))
    axis = figure.add_subplot()
    for row, (value, _, guess) in enumerate(parts):
        axis.barh(row, value, 0.66, color="#c9d4df" if guess else ATTRIBUTES)
        axis.annotate(
            f"{round(value, 1) + 0.0:.1f}{' or so' * guess}", (max(value, 0.0), row), (4, 0),
            textcoords="offset points", va="center", fontsize=8.5,
        )  # fmt: skip
    axis.set_yticks(range(len(parts)), [name for _, name, _ in parts])
    axis.set_xlim(min(0.0, 1.1 * parts[0][0]), 1.16 * max(parts[-1][0], 1e-9))
    axis.set_xlabel("bits a Gaussian saved at equal PSNR")
    axis.grid(axis="y", visible=False)
    return titled(figure, title)
