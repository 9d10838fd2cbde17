"""The plots of the suite: rate, time, pruning, scaling."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

from gs_codec.bench.side_by_side import BY_RENDERS, GUIDED, REFINED, is_ours
from gs_codec.bench.suite.points import CAMERA_GUIDED, FREE, PAPER
from gs_codec.bench.suite.results import Line, Results, delta_of, is_exact, psnr_of
from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS, PROFILES
from gs_codec.pages.figures import make_logarithmic, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Number = Callable[[Line], "float | None"]

#: Name of the curves of pruned scenes.
_PRUNED = "pruned"
_REFINED = "refined"
_BY_RENDERS = "refined to renders"

#: Label, colour, mark, and inner colour of each curve; distinguishable with colour blindness.
_CURVES = {
    PAPER: ("EntropyGS (paper-*)", "#5b5b5b", "^", "#5b5b5b"),
    FREE: ("ours, camera-free", "#0a6ebd", "o", "#0a6ebd"),
    CAMERA_GUIDED: ("ours, camera-guided", "#d1580b", "s", "#d1580b"),
    _PRUNED: ("m, camera-guided, after pruning", "#d1580b", "s", "white"),
    _REFINED: ("m, refined to photographs", "#8a2fa0", "D", "#8a2fa0"),
    _BY_RENDERS: ("m, refined to renders", "#8a2fa0", "D", "white"),
}
_COLOURS = ("#12858a", "#a3468f", "#8a6d00", "#b3203a", "#5a4fb0", "#3d7a1f")
_MARKS = ("*", "P", "X", "v", "D", "<", ">")

#: Ticks of the loss axis, which is logarithmic above the first.
_LOSSES = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


def plot_rate(results: Results, scene: str) -> Figure:
    """PSNR and, for scenes with photographs, delta-PSNR against bits per Gaussian."""
    qualities = [psnr_of, delta_of] if results.has_photographs(scene) else [psnr_of]
    figure = new_figure(9.5, 0.4 + 4.2 * len(qualities))
    axes = figure.subplots(len(qualities), 1, sharex=True, squeeze=False)[:, 0]
    lines = results.of("beside", scene)
    for axis, quality in zip(axes, qualities, strict=True):
        for curve in _CURVES:
            drawn = results.points(scene, curve) or _profiles(lines, curve)
            _draw_profiles(axis, drawn, curve, _bits, quality)
        _draw_others(axis, lines, _bits, quality)
        _dress_quality(axis, quality)
    axes[-1].margins(x=0.1)
    axes[-1].set_xlabel("bits / Gaussian")
    make_logarithmic(axes[-1], "x")
    return _with_legend(figure, axes[0])


def plot_time(results: Results, scene: str) -> Figure:
    """Quality against seconds to encode and to decode; bars from shortest to longest."""
    quality = delta_of if results.has_photographs(scene) else psnr_of
    lines = results.of("beside", scene)
    figure = new_figure(12, 4.8)
    axes = figure.subplots(1, 2, sharey=True)
    for axis, way in zip(axes, ("encode", "decode"), strict=True):

        def median(line: Line, way: str = way) -> float:
            return line[f"{way}_seconds"]["median"]

        for curve in _CURVES:
            _draw_profiles(axis, _profiles(lines, curve), curve, median, quality, ls="")
        _draw_others(axis, lines, median, quality)
        for line in lines:
            if (value := quality(line)) is not None:
                ends = [line[f"{way}_seconds"][end] for end in ("min", "max")]
                axis.plot(ends, [value] * 2, color="#999999", zorder=1)
        axis.set_xlabel(f"seconds to {way}")
        make_logarithmic(axis, "x")
    _dress_quality(axes[0], quality)
    return _with_legend(figure, axes[1])


def plot_frontier(results: Results, scene: str) -> Figure:
    """Quality against compression ratio: all profiles, and `m` after pruning and refinement."""
    quality = delta_of if results.has_photographs(scene) else psnr_of
    lines = results.of("beside", scene)
    figure = new_figure(9.5, 4.6)
    axis = figure.subplots()
    for curve in _CURVES:
        _draw_profiles(axis, _profiles(lines, curve), curve, lambda line: line["ratio"], quality)
    axis.set_xlabel("compression ratio, relative to the PLY")
    make_logarithmic(axis, "x")
    _dress_quality(axis, quality)
    return _with_legend(figure, axis)


def plot_scaling(results: Results) -> Figure:
    """Processor seconds and peak memory of processes against number of Gaussians."""
    lines = sorted(results.of("scaling"), key=lambda line: line["gaussians"])
    figure = new_figure(11, 4.4)
    times, memory = figure.subplots(1, 2)
    profiles = dict.fromkeys(line["profile"] for line in lines)
    for profile, colour in zip(profiles, cycle(("#0a6ebd", "#5b5b5b")), strict=False):
        here = [line for line in lines if line["profile"] == profile]
        counts = [line["gaussians"] for line in here]
        for way, style in (("encode", "o-"), ("decode", "v--")):
            look: dict[str, Any] = {"color": colour, "label": f"{profile}, {way}", "ms": 5}
            times.plot(counts, [line[way]["cpu_seconds"] for line in here], style, **look)
            memory.plot(counts, [line[way]["peak_bytes"] / 1e6 for line in here], style, **look)
    floats = [line["float_bytes"] / 1e6 for line in lines]
    memory.plot([line["gaussians"] for line in lines], floats, "k:", label="the scene's floats")
    times.set_ylabel("processor seconds")
    memory.set_ylabel("peak memory, MB")
    for axis in (times, memory):
        axis.set_xlabel("Gaussians")
        make_logarithmic(axis, "x")
        make_logarithmic(axis, "y")
        axis.legend()
    figure.tight_layout()
    return figure


def _bits(line: Line) -> float | None:
    return None if is_exact(line) else line["bits_per_gaussian"]


def _profiles(lines: Sequence[Line], curve: str) -> list[Line]:
    """Codecs that are points of a curve; the pruned curve starts at `m` without pruning."""
    found = {
        PAPER: lambda codec: codec in PROFILES,
        FREE: lambda codec: codec in ADAPTIVE_PROFILES,
        CAMERA_GUIDED: lambda codec: is_ours(codec) and codec.endswith(GUIDED),
        _PRUNED: lambda codec: codec == f"m{GUIDED}" or codec.endswith("pruned"),
        _REFINED: lambda codec: codec.endswith(REFINED),
        _BY_RENDERS: lambda codec: codec.endswith(BY_RENDERS),
    }
    chosen = [line for line in lines if found[curve](line["codec"])]
    return chosen if curve != _PRUNED or len(chosen) > 1 else []


def _draw_profiles(
    axis: Axes, lines: Sequence[Line], curve: str, across: Number, quality: Number, **look: Any
) -> None:
    """Draw the points of a curve, with names next to the marks, connected unless `look` differs."""
    label, colour, mark, face = _CURVES[curve]
    points = [(across(line), quality(line), _short_name(line)) for line in lines]
    points = [point for point in points if None not in point]
    if not points:
        return
    x, y, _ = zip(*points, strict=True)
    order = 2 if face == colour else 1.5
    axis.plot(x, y, color=colour, marker=mark, mfc=face, ms=6, label=label, zorder=order, **look)
    # Labels are below a rising line and above a falling one; above for pruned ones.
    rises = bool(look) or (y[-1] > y[0]) == (x[-1] > x[0])
    for a, b, name in points:
        place, align = ((5, -11) if rises else (5, 5)), "left"
        if curve == _PRUNED and rises:
            place, align = (-5, 5), "right"
        if curve != _PRUNED or name != "m":
            axis.annotate(
                name, (a, b), place, textcoords="offset points", ha=align, fontsize=8, color=colour
            )


def _short_name(line: Line) -> str:
    """``paper-l + 1 bit`` is ``l + 1``, ``m, 39 % pruned`` ``39 %``, ``60x refined`` ``60x``."""
    name = str(line.get("point", line.get("codec")))
    name = re.sub(" bits?$", "", name.removeprefix("paper-")).removesuffix(GUIDED)
    name = name.removeprefix("m, ").removesuffix(" pruned").replace(", steps", "")
    return name.partition(" refined")[0]


def _draw_others(axis: Axes, lines: Sequence[Line], across: Number, quality: Number) -> None:
    """Draw marks of the codecs that are on no curve."""
    looks = zip(cycle(_COLOURS), cycle(_MARKS), strict=True)
    others = [x for x in lines if x["codec"] == LOSSLESS or not is_ours(x["codec"])]
    for line, (colour, mark) in zip(others, looks, strict=False):
        x, y = across(line), quality(line)
        if x is not None and y is not None:
            axis.plot(x, y, ls="", ms=7.5, color=colour, marker=mark, label=line["codec"])


def _dress_quality(axis: Axes, quality: Number) -> None:
    """Label the quality axis; losses against photographs are on a logarithmic scale."""
    from matplotlib.ticker import FixedLocator, FuncFormatter

    if quality is psnr_of:
        axis.set_ylabel("PSNR against own views, dB")
        return
    axis.set_ylabel("delta-PSNR against photographs, dB")
    axis.set_yscale("symlog", linthresh=_LOSSES[0], linscale=0.4)
    low, high = axis.dataLim.intervaly
    axis.set_ylim(min(1.3 * low, -_LOSSES[0]), max(1.3 * high, _LOSSES[0] / 4))
    axis.yaxis.set_major_locator(FixedLocator([*(-loss for loss in _LOSSES), 0, *_LOSSES]))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:+g}" if value else "0"))


def _with_legend(figure: Figure, axis: Axes) -> Figure:
    """Lay out a figure with its legend on the right."""
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        axis.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.02))
    figure.tight_layout()
    return figure
