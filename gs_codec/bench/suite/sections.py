"""Sections of the suite's report, each of the lines that it has something to say of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from gs_codec.analysis.page import listing, paragraph, subheading
from gs_codec.analysis.page import table as plain_table
from gs_codec.bench.suite import findings, paper_tables, part_tables, plot_costs, plots, tables

if TYPE_CHECKING:
    from gs_codec.bench.suite.report import Drawing

#: Spaces and dashes in figures that lines are not broken at.
_FIXED = str.maketrans({" ": "\N{NO-BREAK SPACE}", "–": "\N{WORD JOINER}–\N{WORD JOINER}"})

#: Letters of a name that is kept on a line.
_SHORT = 24

_PROGRAMS = "A program that is started each time, which its times include, has a * behind its name."

_ELSEWHERE = "The paper's figures are means over other scenes (Mip-NeRF 360), on another machine."


def table(
    caption: str, made: tuple[list[str], tables.Cells], strong: set[int] | None = None
) -> str:
    """Titles and cells as a table whose figures stay on their lines."""
    columns, cells = made
    rows = [
        [cell.translate(_FIXED) if place or len(cell) < _SHORT else cell for place, cell in row]
        for row in map(enumerate, cells)
    ]
    return plain_table(caption, columns, rows, strong or set())


def at_equal_quality(report: Drawing) -> Iterator[str]:
    """What each codec takes, and ours at its quality."""
    for scene in report.results.scenes:
        columns, cells = tables.equal_table(report.results, scene)
        rates = tables.bd_cells(report.results, scene)
        if not cells and not rates:
            continue
        yield subheading(report.results.title(scene))
        if any(any(row.ours.values()) for row in tables.equal_rows(report.results, scene)):
            title = findings.equal_finding(report.results, scene)
            yield report.draw(
                f"equal-{scene}",
                plots.plot_equal(report.results, scene, report.looks, title),
                "Bits a Gaussian of each codec, on the right, and what ours takes at the very PSNR "
                "that it has, read off the curves of the next section. Hollow: ours is better even "
                "so, its coarsest point measured.",
                f"{title}. A line for each codec; the table below has its figures.",
            )
        if cells:
            yield table("Bits a Gaussian at equal PSNR of the scene's own views", (columns, cells))
        if rates:
            titles = ["ours", "over the range", "bits over the paper's, BD-rate"]
            yield table("BD-rate against EntropyGS (paper-*)", (titles, rates))


def rate_distortion(report: Drawing) -> Iterator[str]:
    """Quality against bits."""
    for scene in report.results.scenes:
        if not plots.has_rate(report.results, scene):
            continue
        title = findings.rate_finding(report.results, scene)
        exact = tables.exact_note(report.results, scene)
        figure = plots.plot_rate(report.results, scene, report.looks, title)
        yield report.draw(
            f"rate-{scene}",
            figure,
            "Up and left is better. Letters are profiles; + 1 has one bit more of each depth, / 2 "
            f"half the steps, x 2 twice. Hollow: pruned, bits are those of the input. {exact}",
            f"{title}. Curves of profiles, and other codecs as single marks.",
        )


def run_time(report: Drawing) -> Iterator[str]:
    """Quality against seconds, and the table of all codecs."""
    for scene in report.results.scenes:
        lines = report.results.codecs(scene)
        if not lines:
            continue
        yield subheading(report.results.title(scene))
        if tables.timed_codecs(report.results, scene):
            title = findings.time_finding(report.results, scene, report.looks)
            yield report.draw(
                f"time-{scene}",
                plots.plot_time(report.results, scene, report.looks, title),
                "Up and left is better. Marks are medians, whiskers the least and the largest; "
                "beside the names, bits a Gaussian, which this plot does not show else. Dashed and "
                "bold: the Pareto front of the codecs that lose something. By views: one run.",
                f"{title}. Quality against seconds to encode, above, and to decode, below.",
            )
        columns, cells = tables.codec_table(report.results, scene)
        strong = {i for i, row in enumerate(cells) if row[-1]}
        caption = "All codecs: medians, and in brackets least and largest"
        yield table(caption, (columns, cells), strong)
        if any(tables.is_started(line) for line in lines):
            yield paragraph(_PROGRAMS)
        if beaten := tables.beaten_codecs(report.results, scene):
            yield paragraph(
                f"Beaten by another in size, quality and both times alike: {', '.join(beaten)}."
            )


def stages(report: Drawing) -> Iterator[str]:
    """Time by stage."""
    for scene in report.results.scenes:
        lines = [line for line in report.results.of("codec", scene) if line.get("stages")]
        if not lines:
            continue
        title = findings.stage_finding(lines, scene)
        figure = plot_costs.plot_stages(lines, title)
        caption = "Medians of each stage; profiles by attributes, without views."
        yield report.draw(f"stages-{scene}", figure, caption, f"{title}. A bar for each profile.")


def scaling(report: Drawing) -> Iterator[str]:
    """Cost against Gaussians."""
    if not report.results.of("scaling"):
        return
    title = findings.scaling_finding(report.results)
    yield report.draw(
        "scaling",
        plot_costs.plot_scaling(report.results, title),
        "The largest scene, tiled; every measurement a process of its own. The start of Python and "
        "loading of kernels is what the left ends of the curves show.",
        f"{title}. Processor seconds and peak memory against Gaussians, logarithmic.",
    )
    if report.results.of("start"):
        table_of_start = part_tables.start_table(report.results)
        yield table(
            "Start of commands: all they do of 1,000 Gaussians, compiled before", table_of_start
        )


def memory(report: Drawing) -> Iterator[str]:
    """Peak memory by profile."""
    for scene in report.results.scenes:
        lines = [x for x in report.results.of("memory", scene) if x["encode_peak_bytes"]]
        if not lines:
            continue
        title = findings.memory_finding(lines, scene)
        figure = plot_costs.plot_memory(lines, title)
        caption = "From file to file, Python and its packages included."
        yield report.draw(f"memory-{scene}", figure, caption, f"{title}. Bars for each profile.")


def the_papers_tables(report: Drawing) -> Iterator[str]:
    """Entropies, ablation and times beside those published."""
    results = report.results
    entropies = paper_tables.entropy_table(results)
    times = paper_tables.time_table(results)
    ablations = [scene for scene in results.scenes if results.of("ablation", scene)]
    if not entropies[1] and not results.of("codec") and not ablations:
        return
    yield paragraph(_ELSEWHERE)
    if entropies[1]:
        yield table("Entropy of a symbol, and overhead of parametric models (paper-m)", entropies)
    for scene in ablations:
        made = paper_tables.ablation_table(results, scene)
        yield table(f"Ablation, {scene}: ours, and the paper's on the right", made)
    if ablations:
        yield paragraph(
            "The paper's optimisation trains; here colours alone are refitted in its place. "
            "Megabytes of the first rows are floats, of the last the file."
        )
    if results.of("codec"):
        yield table("Run times of whole encodings and decodings", times)


def parts(report: Drawing) -> Iterator[str]:
    """What each part of the codec saves."""
    for scene in report.results.scenes:
        lines = part_tables.part_lines(report.results, scene)
        if not lines:
            continue
        far = [part_tables.is_far(line, report.results) for line in lines]
        near = [line for line, guess in zip(lines, far, strict=True) if not guess]
        title = findings.part_finding(near or lines, scene)
        yield report.draw(
            f"parts-{scene}",
            plot_costs.plot_parts(lines, far, title),
            "Each part taken out alone: bits more, or quality less at the price of bits that "
            "coarser steps tell. Pale: more than 6 dB are lost, and that price is a guess.",
            f"{title}. A bar for each part; the table below has its figures.",
        )
        yield table("Without each part", part_tables.part_table(report.results, scene))


def coders(report: Drawing) -> Iterator[str]:
    """Entropy coders, and coders of points."""
    if report.results.of("coder"):
        yield table("The same symbols, the same tables", part_tables.coder_table(report.results))
    if report.results.of("points"):
        yield table("Geometry and SH-DC: bits a Gaussian", part_tables.points_table(report.results))


def errors(report: Drawing) -> Iterator[str]:
    """Errors of attributes."""
    for scene in report.results.scenes:
        if report.results.of("error", scene):
            caption = f"{report.results.title(scene)}; rms, and in brackets the largest"
            yield table(caption, part_tables.error_table(report.results, scene))


def circumstances(report: Drawing) -> Iterator[str]:
    """What is not here, and what all was measured on."""
    results = report.results
    if results.absent:
        yield subheading("Not measured")
        yield listing(results.absent)
    if skipped := [str(line["group"]) for line in results.of("skipped")]:
        yield paragraph(f"Left out with --skip: {', '.join(skipped)}.")
    views = part_tables.views_table(results)
    if views[1]:
        yield table("Scenes and views", views)
    if results.of("machine"):
        yield subheading("Machine and versions")
        yield listing(part_tables.machine_facts(results))


#: Titles of the sections, in their order, and what makes them.
SECTIONS = {
    "What comes out at equal quality": at_equal_quality,
    "Rate and distortion": rate_distortion,
    "Run time against error": run_time,
    "Time by stage": stages,
    "Scaling": scaling,
    "Memory": memory,
    "The paper's tables": the_papers_tables,
    "What each part saves": parts,
    "Coders by themselves": coders,
    "Errors by attribute": errors,
    "Circumstances": circumstances,
}
