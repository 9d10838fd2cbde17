"""The paper's tables with our figures beside them: other scenes, another machine."""

from __future__ import annotations

from gs_codec import paper
from gs_codec.analysis.page import number
from gs_codec.bench.suite.results import Line, Results, finite, median_of
from gs_codec.bench.suite.tables import Cells, seconds, signed

#: What stands for a step of the paper's where ours has another name.
_STEPS = {"colour refit": "optimisation"}

#: The profile that has the paper's 4 bits for SH-AC.
_PROFILE = "paper-m"


def entropy_table(results: Results) -> tuple[list[str], Cells]:
    """Entropy of a symbol, and what parametric models cost over it, of `paper-m`."""
    columns = ["scene, group", "entropy, bits", "the paper", "models over entropy, %"]
    cells = []
    for line in results.of("codec"):
        if line.get("profile") != _PROFILE:
            continue
        for group, bits in paper.ENTROPY_BITS.items():
            if known := line.get("entropy", {}).get(group):
                over = finite(known["parametric_overhead_percent"])
                row = [f"{line['scene']}, {group}", number(finite(known["bits_per_symbol"]))]
                row += [number(bits), number(over, 2), number(paper.OVERHEAD_PERCENT[group], 2)]
                cells.append([*row, number(finite(known["coded_overhead_percent"]), 3)])
    return [*columns, "the paper, %", "what is coded, over entropy, %"], cells


def ablation_table(results: Results, scene: str) -> tuple[list[str], Cells]:
    """Size and quality after each step, beside the paper's."""
    columns = ["step", "Gaussians", "MB", "of the input", "PSNR dB", "delta", "the paper: MB"]
    cells = []
    lines = results.of("ablation", scene)
    start = paper.ABLATION["original"]
    for line in lines:
        psnr, delta = (finite(line.get(of, {}).get("psnr")) for of in ("quality", "delta"))
        step = str(line["step"])
        published = paper.ABLATION.get(_STEPS.get(step, step))
        row = [line["step"], f"{line['gaussians']:,}", f"{line['file_bytes'] / 1e6:.2f}"]
        row.append(f"{100 * line['file_bytes'] / max(lines[0]['file_bytes'], 1):.1f} %")
        row += ["equal" if psnr is None else f"{psnr:.2f}", signed(delta, 2)]
        if published:
            row += [f"{published[1]:.1f}", f"{100 * published[1] / start[1]:.1f} %"]
            row += [f"{published[0]:.2f}", signed(published[0] - start[0], 2)]
        cells.append(row + [""] * (10 - len(row)))
    return [*columns, "of the input", "PSNR dB", "delta"], cells


def time_table(results: Results) -> tuple[list[str], Cells]:
    """Seconds of whole encodings and decodings, and those of a million Gaussians."""
    columns = ["scene", "codec, machine", "Gaussians", "encode s", "decode s"]
    cells = []
    for line in results.of("codec"):
        if line["profile"] not in (_PROFILE, "m"):
            continue
        times = [median_of(line[f"{way}_seconds"]) for way in ("encode", "decode")]
        cells.append(_time_row(line["scene"], line["profile"], line["gaussians"], times))
    for line in _as_large(results):
        times = [finite(line[way]["seconds"]) for way in ("encode", "decode")]
        name = f"{line['profile']}, whole processes"
        cells.append(_time_row("the largest, tiled", name, line["gaussians"], times))
    for device, known in paper.SECONDS.items():
        times = [known["encode"], known["decode"]]
        name = f"the paper, {device}"
        cells.append(_time_row("its mean scene", name, paper.MEAN_GAUSSIANS, times))
    return [*columns, "encode s / million", "decode s / million"], cells


def _as_large(results: Results) -> list[Line]:
    """Of each profile, the scene of the scaling that is nearest to the paper's in size."""
    nearest: dict[str, Line] = {}
    order = sorted(results.of("scaling"), key=lambda x: abs(x["gaussians"] - paper.MEAN_GAUSSIANS))
    for line in order:
        nearest.setdefault(line["profile"], line)
    return list(nearest.values())


def _time_row(scene: str, name: str, count: int, times: list[float | None]) -> list[str]:
    a_million = [None if t is None else 1e6 * t / max(count, 1) for t in times]
    return [scene, name, f"{count:,}", *map(seconds, times), *map(seconds, a_million)]
