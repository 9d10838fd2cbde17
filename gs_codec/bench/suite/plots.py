"""Plots of quality: at equal quality, against bits, and against time."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Literal

from gs_codec.analysis.figure import new_figure
from gs_codec.bench.suite.labels import Drawn, Label, place_labels
from gs_codec.bench.suite.looks import CURVE_LOOKS, Look, plain, point_name
from gs_codec.bench.suite.quality import QualityAxis
from gs_codec.bench.suite.results import CURVES, Line, Results, is_exact, psnr_of
from gs_codec.bench.suite.tables import STARTED, equal_rows, front_of, is_started, timed_codecs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Inches that all figures are wide.
WIDTH = 8.4


def plot_equal(results: Results, scene: str, looks: dict[str, Look], title: str) -> Figure:
    """Bits of each codec, and ours at its quality, on a line for each."""
    rows = [row for row in equal_rows(results, scene) if any(row.ours.values())]
    figure = new_figure(WIDTH, 1.5 + 0.42 * len(rows))
    axis = figure.add_subplot()
    for place, row in enumerate(rows):
        own = [bits.bits for bits in row.ours.values() if bits]
        axis.plot([min(own), row.bits], [place, place], color="#b9b9b9", lw=2.2, zorder=1)
        look = looks.get(row.codec, CURVE_LOOKS["paper"])
        axis.plot(row.bits, place, look.mark, color=look.colour, ms=8, mfc=look.face)
        axis.annotate(
            f"{row.bits:.0f}", (row.bits, place), (8, 0), textcoords="offset points",
            va="center", fontsize=8.5, color=look.colour,
        )  # fmt: skip
        for curve, there in row.ours.items():
            if there:
                known = CURVE_LOOKS[curve]
                face = "white" if there.at_most else known.colour
                axis.plot(there.bits, place, known.mark, color=known.colour, ms=7, mfc=face)
        best = min((bits for bits in row.ours.values() if bits), key=lambda bits: bits.bits)
        axis.annotate(
            best.words(row.bits), (1.02, place), xycoords=("axes fraction", "data"),
            va="center", fontsize=8.5,
        )  # fmt: skip
    names = [f"{plain(row.codec, 34)}, {row.psnr:.1f} dB" for row in rows]
    axis.set_yticks(range(len(rows)), names)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlim(0, 1.12 * max(row.bits for row in rows))
    axis.set_xlabel("bits a Gaussian")
    axis.text(1.02, 1.0, "ours, at best", transform=axis.transAxes, fontsize=8.5, weight="bold")
    axis.grid(axis="y", visible=False)
    return titled(figure, title, [(_curve_title(curve), CURVE_LOOKS[curve]) for curve in CURVES])


def plot_rate(results: Results, scene: str, looks: dict[str, Look], title: str) -> Figure:
    """Quality against bits a Gaussian: curves of ours and the paper's, peers as marks."""
    kinds = [False, True] if results.by_photographs(scene) else [False]
    figure = new_figure(WIDTH, 0.7 + 4.5 * len(kinds))
    axes = [figure.add_subplot(len(kinds), 1, i + 1) for i in range(len(kinds))]
    drawn = [
        _draw_rate(axis, results, scene, looks, QualityAxis(photographs))
        for axis, photographs in zip(axes, kinds, strict=True)
    ]
    axes[-1].set_xlabel("bits a Gaussian (logarithmic)")
    curves = [curve for curve in CURVE_LOOKS if results.points(scene, curve)]
    titled(figure, title, [(_curve_title(curve), CURVE_LOOKS[curve]) for curve in curves])
    for axis, (labels, lines) in zip(axes, drawn, strict=True):
        place_labels(axis, labels, lines)
    return figure


def has_rate(results: Results, scene: str) -> bool:
    """Whether a scene has lossy codecs, or points of curves, with a PSNR."""
    return any(psnr_of(x) is not None for x in results.codecs(scene) + results.of("point", scene))


def _curve_title(curve: str) -> str:
    return "EntropyGS (paper-*)" if curve == "paper" else f"ours, {curve}"


def _draw_rate(
    axis: Axes, results: Results, scene: str, looks: dict[str, Look], scale: QualityAxis
) -> tuple[list[Label], list[Drawn]]:
    """Marks of a panel; labels and lines to be told apart once its layout is final."""
    labels: list[Label] = []
    lines: list[Drawn] = []
    for curve, look in CURVE_LOOKS.items():
        points = [p for p in results.points(scene, curve) if scale.value(p) is not None]
        x = [point["bits_per_gaussian"] for point in points]
        y = [scale.place(scale.value(point) or 0.0) for point in points]
        axis.plot(x, y, look.mark + "-", color=look.colour, ms=5.5, lw=1.6)
        lines.append((x, y))
        names = [plain(point_name(point["point"])) for point in points]
        labels += [Label(*at, look.colour) for at in zip(x, y, names, strict=True)]
    for line in results.codecs(scene):
        look = looks[line["codec"]]
        value = scale.value(line)
        shown = look.kind in ("peer", "pruned") or not results.points(scene, look.kind)
        if value is None or is_exact(line) or not shown:
            continue
        label = Label(line["bits_per_gaussian"], scale.place(value), look.name, look.colour)
        axis.plot(label.x, label.y, look.mark, color=look.colour, mfc=look.face, ms=7.5)
        labels.append(label)
    axis.set_xscale("log")
    ticks_of_logs(axis, [label.x for label in labels], "x")
    scale.dress(axis, [label.y for label in labels], exact=False)
    return labels, lines


def plot_time(results: Results, scene: str, looks: dict[str, Look], title: str) -> Figure:
    """Quality against seconds of encoding, and of decoding, with the front of lossy codecs."""
    scale = QualityAxis(results.by_photographs(scene))
    codecs = timed_codecs(results, scene)
    places = dict(zip([c["codec"] for c in codecs], scale.places(codecs), strict=True))
    figure = new_figure(WIDTH, 9.4)
    axes = [figure.add_subplot(2, 1, i + 1) for i in range(2)]
    drawn = [
        _draw_time(axis, codecs, places, looks, scale, way, front_of(results, scene, way))
        for axis, way in zip(axes, ("encode", "decode"), strict=True)
    ]
    titled(figure, title)
    for axis, (labels, lines) in zip(axes, drawn, strict=True):
        place_labels(axis, labels, lines)
    return figure


def _draw_time(
    axis: Axes,
    codecs: Sequence[Line],
    places: dict[str, float | None],
    looks: dict[str, Look],
    scale: QualityAxis,
    way: str,
    front: Sequence[str],
) -> tuple[list[Label], list[Drawn]]:
    spot = {
        line["codec"]: (line[f"{way}_seconds"]["median"], places[line["codec"]] or 0.0)
        for line in codecs
    }
    labels: list[Label] = []
    lines: list[Drawn] = []
    for line in codecs:
        look, (x, y) = looks[line["codec"]], spot[line["codec"]]
        known = line[f"{way}_seconds"]
        lines.append(([known["min"], known["max"]], [y, y]))
        axis.plot(*lines[-1], color=look.colour, lw=1.4, alpha=0.55)
        size = 8.5 if line["codec"] in front else 6.5
        axis.plot(x, y, look.mark, color=look.colour, mfc=look.face, ms=size)
        text = f"{look.name}{STARTED * is_started(line)}: {line['bits_per_gaussian']:.0f} bits"
        labels.append(Label(x, y, text, look.colour, line["codec"] in front))
    lines.append(_stairs(sorted(spot[name] for name in front)))
    axis.plot(*lines[-1], color="#222222", lw=1.1, ls=(0, (4, 2)), zorder=1)
    axis.set_xscale("log")
    ticks_of_logs(axis, [end for x, _ in lines for end in x], "x")
    axis.set_xlabel(f"seconds to {way} (logarithmic)")
    scale.dress(axis, [label.y for label in labels], any(is_exact(line) for line in codecs))
    return labels, lines


def _stairs(points: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """The edge of what points of a front are better than."""
    x: list[float] = []
    y: list[float] = []
    for number, (across, up) in enumerate(points):
        if number:
            x.append(across)
            y.append(y[-1])
        x.append(across)
        y.append(up)
    return x, y


def ticks_of_logs(axis: Axes, values: Sequence[float], which: Literal["x", "y"]) -> None:
    """Limits and plain numbers at 1, 2, 5 of every decade of a logarithmic axis."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    drawn = [value for value in values if value > 0] or [1.0, 10.0]
    low, high = min(drawn), max(drawn)
    ratio = max((high / low) ** 0.08, 1.12)
    side = axis.xaxis if which == "x" else axis.yaxis
    (axis.set_xlim if which == "x" else axis.set_ylim)(low / ratio, high * ratio)
    dense: tuple[float, ...] = (1, 2, 5) if high / low < 3000 else (1,)
    if high / low < 8:
        dense = (1, 1.5, 2, 3, 4, 5, 6, 8)
    side.set_major_locator(FixedLocator([m * 10.0**e for e in range(-6, 9) for m in dense]))
    side.set_minor_locator(NullLocator())
    side.set_major_formatter(FuncFormatter(lambda value, _: _short(value)))


def _short(value: float) -> str:
    """A number of an axis without noughts by the thousand."""
    for power, letter in ((1e6, " M"), (1e3, " k")):
        if value >= power and value >= 1e4:
            return f"{value / power:g}{letter}"
    return f"{value:g}"


def titled(figure: Figure, title: str, legend: Sequence[tuple[str, Look]] = ()) -> Figure:
    """Write what was found above the plot, what colours mean below it, and lay out."""
    from matplotlib.lines import Line2D

    height = figure.get_figheight()
    text = fill(title, 86)
    figure.text(0.012, 1 - 0.1 / height, text, fontsize=11.5, weight="bold", va="top")
    down = 0.22 + 0.2 * (text.count("\n") + 1)
    if legend:
        handles = [
            Line2D([], [], color=look.colour, marker=look.mark, mfc=look.face, label=name)
            for name, look in legend
        ]
        at = (0.005, 1 - (down - 0.06) / height)
        figure.legend(handles=handles, loc="upper left", ncols=4, bbox_to_anchor=at, fontsize=9)
        down += 0.22
    figure.tight_layout(rect=(0, 0, 1, 1 - (down - 0.04) / height))
    return figure
