"""The report of the suite: Markdown with plots, and short answers."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.bench.side_by_side import is_ours
from gs_codec.bench.suite import suite_plots, suite_tables
from gs_codec.bench.suite.answers import answers
from gs_codec.bench.suite.datasets import DATASETS, dataset_table, introduction, survey_files
from gs_codec.bench.suite.results import Results
from gs_codec.pages.figures import png_of
from gs_codec.pages.tables import escaped
from gs_codec.runtime.atomic import write_files
from gs_codec.runtime.optional import check_installed
from gs_codec.runtime.wording import counted, size_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_INTRODUCTION = (
    "All codecs were measured on the same scenes in one process, taking turns. PSNR and delta-PSNR "
    "are those of views that no codec has seen: PSNR against renders before coding, delta-PSNR "
    "the change against photographs. Times are medians (camera-guided and pruned: one run); \\* "
    "marks a separate program, whose times include its start. Memory is the peak of the whole "
    'process. "Ours at that PSNR" is interpolated from the curves of `l`, `m`, `s`; ≤ means that '
    "even their coarsest point is better. Bits of pruned scenes are per Gaussian of the input."
)

_POSITIONS = (
    "Processor seconds per million points, medians. Count tree: quantising, Morton codes and "
    "sorting; coding them; decoding. Open3D's class: `convert_from_point_cloud`; `traverse`, "
    "which calls Python for each node, here to read its children."
)

_GROWTH = (
    "The largest scene, tiled; each measurement is a process of its own and includes its start."
)

_DEVICE = (
    "Profile `m`, medians, on the largest scene, also tiled: decoding to tensors on the device "
    "(including the CPU's part) and on the CPU, and refinement with gsplat."
)


def write_report(lines: Sequence[dict[str, Any]], folder: Path) -> None:
    """Write ``report.md``, its plots as PNG files, and ``answers.md`` into a folder.

    Results of a dataset are also written as the survey's files, in ``results``. `lines` are all or
    some result lines of the suite; sections without lines are omitted. Raises MissingTool if
    matplotlib is not installed. Raises InvalidInput if a file cannot be written.
    """
    check_installed("matplotlib", "plots")
    results, pictures = Results(lines), dict[str, bytes]()

    def draw(name: str, shown: str, plot: Callable[..., Figure], *args: Any) -> str:
        plain = re.sub(r"[^A-Za-z0-9]+", "-", name)[:60].strip("-")
        file = f"{plain}.png" if f"{plain}.png" not in pictures else f"{plain}-{len(pictures)}.png"
        pictures[file] = png_of(plot, *args)
        return f"![{shown}]({file})"

    parts = ["# Benchmarks of gs_codec", _INTRODUCTION]
    dataset = DATASETS.get(results.first("machine").get("dataset") or "")
    if dataset is not None:
        table = dataset_table(results, dataset).markdown()
        parts += [f"## {dataset.title}", introduction(results, dataset), table]
    for scene in results.scenes:
        parts += _scene_parts(results, scene, draw)
    if results.of("geometry"):
        parts += ["## Positions", _POSITIONS, suite_tables.geometry_table(results).markdown()]
    if results.of("scaling"):
        picture = draw("scaling", "Time and memory by Gaussians", suite_plots.plot_scaling, results)
        parts += ["## Scaling", _GROWTH, picture]
    if results.of("device"):
        parts += ["## On a CUDA device", _DEVICE, suite_tables.device_table(results).markdown()]
    parts += _circumstances(results)
    answered = {q: table.markdown() for q, table in answers(results).items() if table.rows}
    short = "".join(f"## {question}\n\n{table}\n\n" for question, table in answered.items())
    text = "\n\n".join(part for part in parts if part) + "\n"
    write_files(
        folder,
        {
            **pictures,
            **(survey_files(results, dataset) if dataset else {}),
            "answers.md": short.encode("utf-8", "backslashreplace"),
            "report.md": text.encode("utf-8", "backslashreplace"),
        },
    )


def _scene_parts(results: Results, scene: str, draw: Any) -> list[str]:
    """Tables and pictures of a scene."""
    codecs = results.of("beside", scene)
    parts = [f"## {suite_tables.scene_title(results, scene)}", suite_tables.views(results, scene)]
    parts += [
        suite_tables.codec_table(results, scene).markdown(),
        suite_tables.rates(results, scene),
    ]
    drawn = [("rate", "bits per Gaussian", suite_plots.plot_rate)]
    if codecs:
        drawn.append(("time", "seconds", suite_plots.plot_time))
        drawn.append(("frontier", "compression ratio", suite_plots.plot_frontier))
    for name, over, plot in drawn:
        parts.append(draw(f"{name}-{scene}", f"Quality against {over}", plot, results, scene))
    return parts


def _circumstances(results: Results) -> list[str]:
    """Machine, versions, and measurements that were skipped."""
    machine, facts = results.first("machine"), []
    for name in ("command", "date", "commit", "processor", "threads", "system", "python"):
        if machine.get(name) is not None:
            facts.append(f"- {name}: {escaped(str(machine[name]))}")
    known = {x["codec"]: x["version"] for x in results.of("beside") if not is_ours(x["codec"])}
    versions = [f"{name} ({v})" for name, v in (machine.get("packages", {}) | known).items()]
    facts += [f"- versions: {', '.join(versions)}"] if versions else []
    facts += [
        f"- installed, {name}: {counted(size['packages'], 'package')}, {size_text(size['bytes'])}"
        for name, size in machine.get("installed", {}).items()
    ]
    facts += [f"- not measured: {escaped(reason)}" for reason in results.absent]
    facts += [f"- skipped with --skip: {group}" for group in machine.get("skipped", ())]
    return ["## Circumstances", "\n".join(facts)] if facts else []
