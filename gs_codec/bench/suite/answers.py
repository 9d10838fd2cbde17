"""Questions of users, each answered by a table of the suite's results: for RESULTS.md."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from gs_codec.bench.side_by_side import BY_RENDERS, ESTIMATED, GUIDED, OURS_AS, REFINED, is_ours
from gs_codec.bench.suite.points import CAMERA_GUIDED, FREE, PAPER
from gs_codec.bench.suite.results import Line, Results, bd_rate
from gs_codec.bench.suite.suite_tables import (
    in_order,
    name_of,
    quality_text,
    ratio_text,
    times_text,
)
from gs_codec.config import LOSSLESS
from gs_codec.pages.tables import Table, escaped, number

#: Rows of the first tables: what is shown, and its codec; of several, the first that was measured.
_MAIN = {
    "from the PLY alone: `m`": ("m",),
    "with its cameras: `m --cameras`": (f"m{GUIDED}",),
    "refined: `--refine --target-ratio 60`": (f"m, 60{REFINED}", f"m, 60{BY_RENDERS}"),
    "bit-exact: `lossless`": (LOSSLESS,),
    "EntropyGS: `paper-m`": ("paper-m",),
    "Niantic's spz v4": ("spz v4",),
}

_CAMERAS = {
    "`l`": ("l",),
    "`m`": ("m",),
    "`s`": ("s",),
    "`m --cameras auto`": (f"m{ESTIMATED}",),
    "`l --cameras`": (f"l{GUIDED}",),
    "`m --cameras`": (f"m{GUIDED}",),
    "`s --cameras`": (f"s{GUIDED}",),
}

_REFINED = {
    "`m --cameras`": (f"m{GUIDED}",),
    "refined to renders, 60x": (f"m, 60{BY_RENDERS}",),
    "refined to photographs, 60x": (f"m, 60{REFINED}",),
    "refined to photographs, 100x": (f"m, 100{REFINED}",),
}

_FORMATS = {
    "spz v4: Niantic's encoder": ("spz v4",),
    "spz v4: ours": (f"{OURS_AS}spz v4, m",),
    "spz v4: ours, with cameras": (f"{OURS_AS}spz v4, m{GUIDED}",),
    "SOG: ours": (f"{OURS_AS}sog, m",),
    "SOG: ours, with cameras": (f"{OURS_AS}sog, m{GUIDED}",),
    "compressed PLY: splat-transform": ("splat-transform, compressed.ply",),
    "compressed PLY: ours": (f"{OURS_AS}compressed.ply, m",),
    "`.egs`: ours": ("m",),
    "`.egs`: ours, with cameras": (f"m{GUIDED}",),
}


def answers(results: Results) -> dict[str, Table]:
    """Questions with their tables; a table without rows was not measured."""

    def small(line: Line) -> str:
        megabytes = line["output_bytes"] / 1e6
        return f"{number(megabytes, '.2f' if megabytes < 10 else '.1f')} MB, {_short(line)}"

    def fast(line: Line) -> str:
        return " / ".join(times_text(line)) if "encode_seconds" in line else ""

    def bits(line: Line) -> str:
        return ", ".join([number(line["bits_per_gaussian"], ".1f"), *quality_text(line)])

    def against(line: Line) -> str:
        ours = [results.lossless_bits(line).split(" ")[0]]
        if not ours[0]:
            ours = [results.bits_at_quality(line, curve) for curve in (FREE, CAMERA_GUIDED)]
        return " / ".join([number(line["bits_per_gaussian"], ".1f"), *(x or "-" for x in ours)])

    others = {
        name_of(line): (line["codec"],)
        for scene in results.scenes
        for line in in_order(results, scene)
        if not (is_ours(line["codec"]) or line["codec"].startswith(OURS_AS))
    }
    return {
        "How small?": _by_scene(results, _MAIN, small),
        "How fast?": _by_scene(results, _MAIN, fast),
        "What if I have no cameras?": _by_scene(results, _CAMERAS, bits),
        "What does refinement add?": _by_scene(results, _REFINED, _short),
        "Against other programs?": _by_scene(results, others, against),
        "For other viewers?": _by_scene(results, _FORMATS, _short),
        "Against the paper?": _against_the_paper(results),
        "How large?": _by_size(results),
    }


def _short(line: Line) -> str:
    return ", ".join([ratio_text(line), *quality_text(line)])


def _by_scene(
    results: Results, rows: Mapping[str, Sequence[str]], cell: Callable[[Line], str]
) -> Table:
    """One cell for each scene; empty rows and columns are omitted."""
    known = {
        scene: {line["codec"]: line for line in results.of("beside", scene)}
        for scene in results.scenes
    }
    table = []
    for title, codecs in rows.items():
        found = [
            next((lines[codec] for codec in codecs if codec in lines), None)
            for lines in known.values()
        ]
        if any(found):
            table.append([title, *(cell(line) if line else "" for line in found)])
    titles = ["", *_titles(results)]
    shown = [k for k in range(len(titles)) if any(row[k] for row in table)]
    return Table([titles[k] for k in shown], [[row[k] for k in shown] for row in table])


def _against_the_paper(results: Results) -> Table:
    """BD-rates over the paper's profiles."""
    rows = []
    for name in (FREE, CAMERA_GUIDED):
        rates = [
            bd_rate(results.curve(scene, PAPER), results.curve(scene, name))
            for scene in results.scenes
        ]
        if any(rates):
            rows.append([name, *(f"{rate.percent:+.1f} %" if rate else "" for rate in rates)])
    return Table(["", *_titles(results)], rows)


def _titles(results: Results) -> list[str]:
    """Names of scenes, with the sizes of their PLYs."""
    lines = [results.first("scene", scene) for scene in results.scenes]
    sizes = [f", {line['input_bytes'] / 1e6:.1f} MB" if line else "" for line in lines]
    return [escaped(scene) + size for scene, size in zip(results.scenes, sizes, strict=True)]


def _by_size(results: Results) -> Table:
    """Size, processor time and memory of tiled scenes, with profile `m`."""
    rows = []
    for line in results.of("scaling"):
        if line["profile"] == "m":
            used = [line[way] for way in ("encode", "decode")]
            cells = [f"{x['cpu_seconds']:.1f} s, {x['peak_bytes'] / 1e9:.2f} GB" for x in used]
            sizes = [f"{line[key] / 1e6:,.1f} MB" for key in ("float_bytes", "output_bytes")]
            rows.append([f"{line['gaussians']:,}", *sizes, *cells])
    return Table(["Gaussians", "as floats", "`.egs`", "encode", "decode"], rows)
