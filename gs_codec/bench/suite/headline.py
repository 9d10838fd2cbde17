"""The table of the README's first screen, of a run of the suite."""

from __future__ import annotations

from collections.abc import Sequence

from gs_codec import paper
from gs_codec.bench.suite.looks import in_order, looks_of
from gs_codec.bench.suite.results import CURVES, Line, Results, delta_of, is_exact, psnr_of
from gs_codec.bench.suite.results import median_of as median
from gs_codec.bench.suite.tables import EqualRow, equal_rows, is_started
from gs_codec.config import LATTICE_PROFILES, LOSSLESS

_TITLES = (
    "scene (Gaussians, SH degree)", "codec", "times smaller", "bits / Gaussian", "{quality}",
    "encode", "decode", "ours at that PSNR, by attributes", "by views",
)  # fmt: skip

#: The paper's profile that is shown, what would say little beside others, and what is shown of
#: scenes after the first.
_PAPER = "paper-m"
_LEFT_OUT = {
    "l", "s", "paper-l", "paper-s", "splat-transform, spz", "zstd, PLY", "zstd, byte planes",
}  # fmt: skip
_SHORT = ("m", "m, by views")


def headline(lines: Sequence[Line]) -> list[str]:
    """Lines of a Markdown table: the first scene with photographs in full, others in short.

    Quality is delta-PSNR, or PSNR against the scene's own views where that says so. A codec whose
    times are those of a program, its start included, has a ``*``.
    """
    results = Results(lines)
    looks = looks_of(results)
    measured = [scene for scene in results.scenes if results.codecs(scene)]
    measured.sort(key=lambda scene: not results.by_photographs(scene))
    photographs = any(results.by_photographs(scene) for scene in measured)
    quality = "delta-PSNR" if photographs else "PSNR"
    titles = [title.format(quality=quality) for title in _TITLES]
    table = [_row(titles), _row(["---"] * len(titles))]
    for number, scene in enumerate(measured):
        known = {line["codec"]: line for line in results.codecs(scene)}
        shown = [codec for codec in known if _is_shown(codec, in_full=not number)]
        chosen = [known[codec] for codec in in_order(shown, looks)]
        equal = {row.codec: row for row in equal_rows(results, scene)}
        for place, line in enumerate(chosen):
            name = "" if place else _scene(results, scene)
            table.append(_row([name, *_cells(results, scene, line, equal, photographs)]))
    return [*table, _row(_paper_cells(photographs))]


def _is_shown(codec: str, in_full: bool) -> bool:
    return codec not in _LEFT_OUT if in_full else codec in _SHORT


def _scene(results: Results, scene: str) -> str:
    line = results.first("scene", scene)
    name = _escaped(scene)
    return f"{name} ({line['gaussians']:,}, {line['sh_degree']})" if line else name


def _cells(
    results: Results, scene: str, line: Line, equal: dict[str, EqualRow], photographs: bool
) -> list[str]:
    times = [_seconds(median(line.get(f"{way}_seconds"))) for way in ("encode", "decode")]
    return [
        _codec(line["codec"]) + r" \*" * is_started(line),
        f"{line['ratio']:.1f}x" if line["ratio"] >= 10 else f"{line['ratio']:.2f}x",
        f"{line['bits_per_gaussian']:.1f}",
        _quality(line, photographs),
        *times,
        *_ours(results, scene, line, equal),
    ]


def _codec(name: str) -> str:
    """Our profiles as code, with what is done beside; others as they are called."""
    profile, comma, rest = name.partition(",")
    if profile in LATTICE_PROFILES or name == LOSSLESS:
        return f"`{profile}`{comma} {_escaped(rest)}".strip()
    return f"`{name}`: EntropyGS" if name == _PAPER else _escaped(name)


def _ours(results: Results, scene: str, line: Line, equal: dict[str, EqualRow]) -> list[str]:
    """Bits of our curves at a codec's quality; of our lossless profile where that is exact."""
    row = equal.get(line["codec"])
    if row is not None:
        found = [row.ours[curve] for curve in CURVES]
        return ["" if x is None else f"{'≤ ' * x.at_most}{x.bits:.1f}" for x in found]
    ours = results.codec(scene, LOSSLESS)
    if is_exact(line) and ours and line is not ours:
        return [f"{ours['bits_per_gaussian']:.1f} (`{LOSSLESS}`)", ""]
    return ["", ""]


def _quality(line: Line, photographs: bool) -> str:
    delta, psnr = delta_of(line), psnr_of(line)
    if is_exact(line):
        return "0" if photographs else "equal"
    if photographs and delta is not None:
        return f"{round(delta, 2) or 0.0:+.2f} dB".replace("+0.00", "0.00")
    return "" if psnr is None else f"{psnr:.1f} dB" + " PSNR" * photographs


def _paper_cells(photographs: bool) -> list[str]:
    known = paper.SECONDS["CPU"]
    million = paper.MEAN_GAUSSIANS / 1e6
    loss = paper.ABLATION["quantisation"][0] - paper.ABLATION["optimisation"][0]
    cells = [f"the paper, its mean scene ({million:.2f} M), CPU", "", "", ""]
    cells += [f"{loss:+.2f} dB" if photographs else ""]
    cells += [f"{known[way]:g} s" for way in ("encode", "decode")]
    return [f"*{cell}*" if cell else "" for cell in [*cells, "", ""]]


def _seconds(value: float | None) -> str:
    if value is None:
        return ""
    if value >= 100:
        return f"{value / 60:.1f} min"
    if value < 0.0095:
        return f"{1000 * value:.1g} ms"
    return f"{value:.2f} s" if value < 10 else f"{value:.0f} s"


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escaped(text: str) -> str:
    """Text from elsewhere, such that it is no markup and stays in its cell."""
    plain = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;")
    return "".join(f"\\{letter}" if letter in "\\|`*_[]" else letter for letter in plain)
