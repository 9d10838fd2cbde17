"""What codecs take at equal quality, and the table of all of them."""

from __future__ import annotations

from dataclasses import dataclass

from gs_codec.analysis.page import number
from gs_codec.bench.suite.quality import QualityAxis, beats, on_front
from gs_codec.bench.suite.results import (
    CURVES,
    Line,
    Results,
    delta_of,
    finite,
    is_exact,
    median_of,
    psnr_of,
)
from gs_codec.config import LOSSLESS, PROFILES

Cells = list[list[str]]

#: Follows the name of a codec whose times are those of a program, its start included.
STARTED = " *"


@dataclass(frozen=True)
class There:
    """Bits a Gaussian of a curve at a quality; at most so many where it is better even so."""

    bits: float
    at_most: bool = False

    def change(self, of: float) -> float:
        """Percent that these bits are fewer than others."""
        return 100 * (1 - self.bits / of)

    def words(self, of: float) -> str:
        """How many fewer these bits are than others."""
        fewer = self.change(of)
        if fewer < 0:
            return f"{'at most ' * self.at_most}{-fewer:.0f} % more"
        return f"{'at least ' * self.at_most}{fewer:.0f} % fewer"

    def cell(self, of: float) -> str:
        """The bits, and how many fewer they are."""
        return f"{'≤ ' * self.at_most}{self.bits:.1f}, {self.words(of)}"


@dataclass(frozen=True)
class EqualRow:
    """A codec, and what curves take at its quality; None where they do not reach it."""

    codec: str
    bits: float
    psnr: float
    ours: dict[str, There | None]
    paper: There | None


def equal_rows(results: Results, scene: str) -> list[EqualRow]:
    """Peers and the paper's profiles of a scene at equal PSNR against its own views."""
    found: dict[str, dict[str, Line]] = {}
    for line in results.of("equal", scene):
        if finite(line["psnr"]) is not None:
            found.setdefault(line["codec"], {})[line["curve"]] = line
    rows = []
    for codec, curves in found.items():
        line = next(iter(curves.values()))
        there = {
            curve: _there(results, scene, curve, known["psnr"], known["curve_bits_per_gaussian"])
            for curve, known in curves.items()
        }
        ours = {curve: there.get(curve) for curve in CURVES}
        known = (codec, line["bits_per_gaussian"], line["psnr"])
        rows.append(EqualRow(*known, ours, there.get("paper")))
    return rows + _paper_rows(results, scene)


def _paper_rows(results: Results, scene: str) -> list[EqualRow]:
    rows: dict[str, EqualRow] = {}
    for line in results.of("gain", scene):
        bits = finite(line["paper_bits_per_gaussian"])
        if line["at"] in PROFILES and bits is not None:
            empty = EqualRow(line["at"], bits, line["psnr"], dict.fromkeys(CURVES), None)
            row = rows.setdefault(line["at"], empty)
            at = (line["curve"], line["psnr"], line["bits_per_gaussian"])
            row.ours[line["curve"]] = _there(results, scene, *at)
    return list(rows.values())


def _there(
    results: Results, scene: str, curve: str, psnr: float, bits: float | None
) -> There | None:
    if finite(bits) is not None:
        return There(float(bits or 0.0))
    most = results.bits_at_most(scene, curve, psnr)
    return None if most is None else There(most, at_most=True)


def equal_table(results: Results, scene: str) -> tuple[list[str], Cells]:
    """Titles and cells: each codec's bits, and ours at its quality."""
    columns = ["codec", "bits / Gaussian", "PSNR dB", "paper-* there", "ours, by attributes"]
    cells = [
        [row.codec, f"{row.bits:.1f}", f"{row.psnr:.2f}"]
        + ["" if row.codec in PROFILES else _cell(row.paper, row)]
        + [_cell(row.ours[curve], row) for curve in CURVES]
        for row in equal_rows(results, scene)
    ]
    cells += exact_cells(results, scene)
    return [*columns, "ours, by views"], cells


def _cell(there: There | None, row: EqualRow) -> str:
    return "out of range" if there is None else there.cell(row.bits)


def exact_cells(results: Results, scene: str) -> Cells:
    """Rows of peers whose views are equal, beside our lossless profile."""
    ours = results.codec(scene, LOSSLESS)
    exact = [line for line in results.codecs(scene) if is_exact(line) and line is not ours]
    if not ours:
        return []
    lossless = There(ours["bits_per_gaussian"])
    cells = []
    for line in exact:
        bits = line["bits_per_gaussian"]
        ours_there = f"lossless: {lossless.cell(bits)}"
        cells.append([line["codec"], f"{bits:.1f}", "equal", "", ours_there, ""])
    return cells


def bd_cells(results: Results, scene: str) -> Cells:
    """Curve, range and BD-rate over the paper's profiles."""
    cells = []
    for line in results.of("bd-rate", scene):
        known = line["range"]
        shown = f"{known[0]:.1f} to {known[1]:.1f} dB" if known else ""
        percent = finite(line["percent"])
        cells.append(
            [line["curve"], shown, "no overlap" if percent is None else f"{percent:+.1f} %"]
        )
    return cells


def codec_table(results: Results, scene: str) -> tuple[list[str], Cells]:
    """All codecs of a scene: size, quality, times with their spread, and what none beats."""
    lines = results.codecs(scene)
    fronts = {way: front_of(results, scene, way) for way in ("encode", "decode")}
    photographs = results.by_photographs(scene)
    columns = ["codec", "times smaller", "bits / Gaussian", "PSNR dB", "worst view"]
    columns += ["delta-PSNR dB"] * photographs
    cells = []
    for line in lines:
        cells.append(
            [line["codec"] + STARTED * is_started(line), number(finite(line.get("ratio")), 2)]
            + [number(finite(line["bits_per_gaussian"]), 1), decibels(line)]
            + [number(finite(line.get("worst_psnr")), 2)]
            + [signed(delta_of(line))] * photographs
            + [spread(line.get(f"{way}_seconds")) for way in ("encode", "decode")]
            + [_way([way for way, front in fronts.items() if line["codec"] in front])]
        )
    return [*columns, "encode s", "decode s", "on the front"], cells


def _way(ways: list[str]) -> str:
    """On which fronts a codec is."""
    return "both" if len(ways) > 1 else "".join(ways)


def timed_codecs(results: Results, scene: str) -> list[Line]:
    """Codecs that both times and quality are known of, by the quality they are compared by."""
    scale = QualityAxis(results.by_photographs(scene))
    return [
        line
        for line in results.codecs(scene)
        if (scale.value(line) is not None or is_exact(line))
        and all(median_of(line.get(f"{way}_seconds")) for way in ("encode", "decode"))
    ]


def front_of(results: Results, scene: str, way: str) -> list[str]:
    """Lossy codecs that no other is both faster and better than, fastest first."""
    scale = QualityAxis(results.by_photographs(scene))
    lossy = [line for line in timed_codecs(results, scene) if not is_exact(line)]
    points = [(line[f"{way}_seconds"]["median"], -(scale.value(line) or 0.0)) for line in lossy]
    found = zip(points, lossy, on_front(points), strict=True)
    chosen = sorted(((p, line["codec"]) for p, line, best in found if best), key=lambda x: x[0])
    return [codec for _, codec in chosen]


def beaten_codecs(results: Results, scene: str) -> list[str]:
    """Codecs that another beats in all alike, size, quality and both times, and by which."""
    scale = QualityAxis(results.by_photographs(scene))
    points = {
        line["codec"]: (
            line["bits_per_gaussian"],
            -(float("inf") if is_exact(line) else scale.value(line) or 0.0),
            line["encode_seconds"]["median"],
            line["decode_seconds"]["median"],
        )
        for line in timed_codecs(results, scene)
    }
    told = []
    for codec, point in points.items():
        by = [other for other, better in points.items() if beats(better, point)]
        if by:
            told.append(f"{codec} (by {by[0]})")
    return told


def is_started(line: Line) -> bool:
    """Whether a codec is a program that is started for each encoding and decoding."""
    return bool(line.get("own_process"))


def decibels(line: Line) -> str:
    """PSNR against the scene's own views."""
    return "equal" if is_exact(line) else number(psnr_of(line), 2)


def signed(value: float | None, digits: int = 3) -> str:
    """A difference; a dash where there is none."""
    return "-" if value is None else f"{value:+.{digits}f}" if value else "0"


def spread(known: object) -> str:
    """Median, and in brackets the least and the largest, where there is more than one."""
    if not isinstance(known, dict):
        return seconds(median_of(known))
    ends = [seconds(finite(known.get(end))) for end in ("min", "max")]
    if known.get("min") == known.get("max"):
        return seconds(median_of(known))
    return f"{seconds(median_of(known))} ({ends[0]}–{ends[1]})"


def seconds(value: float | None) -> str:
    """Seconds of three digits or so."""
    if value is None:
        return "-"
    digits = 3 if value < 0.1 else 2 if value < 10 else 1 if value < 100 else 0
    return f"{value:.{digits}f}"


def exact_note(results: Results, scene: str) -> str:
    """What plots of quality leave out: codecs whose views are equal, with their bits."""
    exact = [line for line in results.codecs(scene) if is_exact(line)]
    told = [f"{line['codec']}: {line['bits_per_gaussian']:.0f}" for line in exact]
    return f"Not drawn, as nothing is lost, bits of {'; '.join(told)}." if told else ""
