"""Markdown tables of the suite's results, for its report."""

from __future__ import annotations

from gs_codec.bench.side_by_side import ESTIMATED, GUIDED, REFINED, is_ours
from gs_codec.bench.suite.points import CAMERA_GUIDED, FREE, PAPER
from gs_codec.bench.suite.results import Line, Results, bd_rate, delta_of, is_exact, psnr_of
from gs_codec.config import LOSSLESS
from gs_codec.pages.tables import Table, escaped, number
from gs_codec.runtime.wording import counted

_OURS = ["ours at that PSNR, camera-free", "camera-guided"]


def codec_table(results: Results, scene: str) -> Table:
    """All codecs of a scene, without empty columns.

    Columns are size, quality, times, memory, and our bits at that PSNR.
    """
    peaks = {line["profile"]: line for line in results.of("memory", scene)}
    columns = ["codec", "ratio", "bits / Gaussian", "PSNR dB", "worst view", "delta-PSNR"]
    columns += ["encode", "decode", "encode MB", "decode MB"]
    rows = []
    for line in in_order(results, scene):
        worst, known = line.get("worst_psnr"), peaks.get(line["codec"], {})
        psnr = "equal" if is_exact(line) else number(psnr_of(line), ".2f")
        cells = [*_size(line), psnr, number(worst, ".2f"), number(delta_of(line), "+.3f")]
        memory = [known.get(f"{way}_peak_bytes") for way in ("encode", "decode")]
        megabytes = [number(x and x / 1e6, ".0f") for x in memory]
        rows.append([*cells, *times_text(line), *megabytes, *_ours(results, line)])
    columns += _OURS
    used = [i for i in range(len(columns)) if any(row[i] for row in rows)]
    return Table([columns[i] for i in used], [[row[i] for i in used] for row in rows])


def geometry_table(results: Results) -> Table:
    """Ways to divide positions; processor seconds per million points."""
    columns = ["scene", "by", "depth", "build", "walk", "decode", "bits / point"]
    rows = []
    for line in results.of("geometry"):
        million = max(line["gaussians"], 1) / 1e6
        seconds = [line.get(f"{step}_seconds") for step in ("build", "walk", "decode")]
        cells = [number(x and x / million, ".2f") for x in seconds]
        bits = line.get("bytes") and line["bytes"] * 8e-6 / million
        name = escaped(line["scene"])
        rows.append([name, line["coder"], str(line["depth"]), *cells, number(bits, ".1f")])
    return Table(columns, rows, left=(0, 1))


def device_table(results: Results) -> Table:
    """Results of a CUDA device, and whether they equal the CPU's."""
    columns = ["device", "Gaussians", "block", "decode", "CPU", "equal to CPU", "iterations / s"]
    rows = []
    for line in results.of("device"):
        cells = [escaped(line["device"]), f"{line['gaussians']:,}", str(line.get("block_size", ""))]
        for key in ("seconds", "cpu_seconds"):
            cells.append(_seconds(line[key]) if key in line else "")
        cells.append({True: "yes", False: "no", None: ""}[line.get("same")])
        rows.append([*cells, number(line.get("iterations_per_second"), ".0f")])
    return Table(columns, rows)


def rates(results: Results, scene: str) -> str:
    """A sentence on the BD-rate of our curves relative to the paper's profiles; may be empty."""
    differences = []
    for name in (FREE, CAMERA_GUIDED):
        rate = bd_rate(results.curve(scene, PAPER), results.curve(scene, name))
        if rate is not None:
            over = f"{rate.low:.1f} to {rate.high:.1f} dB"
            differences.append(f"{name} {rate.percent:+.1f} % ({over})")
    return f"BD-rate over EntropyGS (`paper-*`): {', '.join(differences)}." if differences else ""


def views(results: Results, scene: str) -> str:
    """A sentence on the views of a scene; empty if unknown."""
    line = results.first("scene", scene)
    if not line:
        return ""
    photographs = " against photographs" if line["photographs"] else ""
    return (
        f"PLY: {line['input_bytes'] / 1e6:.1f} MB. Cameras: {line['cameras']}; "
        f"{counted(line['measured_views'], 'held-out view')} of {line['width']} x {line['height']} "
        f"pixels measured{photographs}, {counted(line['encoded_by_views'], 'other view')} used by "
        "the encoder."
    )


def scene_title(results: Results, scene: str) -> str:
    """Name, Gaussians and SH degree of a scene."""
    line = results.first("scene", scene)
    return escaped(scene) + (f" ({line['gaussians']:,}, {line['sh_degree']})" if line else "")


def in_order(results: Results, scene: str) -> list[Line]:
    """Codecs of a scene: our profiles, guided, pruned, refined, lossless, the paper's, others."""

    def kind(line: Line) -> int:
        codec = line["codec"]
        if not is_ours(codec):
            return 6
        if codec.startswith("paper-") or codec == LOSSLESS:
            return 5 if codec != LOSSLESS else 4
        if REFINED in codec:
            return 3
        return 2 if codec.endswith("pruned") else int(codec.endswith((GUIDED, ESTIMATED)))

    return sorted(results.of("beside", scene), key=kind)


def _size(line: Line) -> list[str]:
    return [name_of(line), ratio_text(line), f"{line['bits_per_gaussian']:.1f}"]


def name_of(line: Line) -> str:
    """Name of a codec, with a ``*`` if its times include the start of a program."""
    profile, comma, how = line["codec"].partition(",")
    name = f"`{profile}`{comma}{how}" if is_ours(profile) else escaped(line["codec"])
    return (
        name + ": EntropyGS" * profile.startswith("paper-") + r" \*" * bool(line.get("own_process"))
    )


def ratio_text(line: Line) -> str:
    """Compression ratio relative to the PLY."""
    return f"{line['ratio']:.1f}x" if line["ratio"] >= 10 else f"{line['ratio']:.2f}x"


def quality_text(line: Line) -> list[str]:
    """Delta-PSNR, or PSNR against the scene's own views, if it is known."""
    delta, psnr = delta_of(line), psnr_of(line)
    if is_exact(line):
        return ["equal"]
    if delta is not None:
        return [f"{round(delta, 2) or 0.0:+.2f} dB".replace("+0.00", "0.00")]
    return [] if psnr is None else [f"{psnr:.1f} dB"]


def times_text(line: Line) -> list[str]:
    """Median times to encode and to decode."""
    return [_seconds(line[f"{way}_seconds"]["median"]) for way in ("encode", "decode")]


def _ours(results: Results, line: Line) -> list[str]:
    """Bits of our curves at a codec's quality, or of our lossless profile if it is lossless."""
    if exact := results.lossless_bits(line):
        return [exact, ""]
    return [results.bits_at_quality(line, curve) for curve in (FREE, CAMERA_GUIDED)]


def _seconds(value: float) -> str:
    if value >= 100:
        return f"{value / 60:.1f} min"
    if value < 0.0095:
        return f"{1000 * value:.1g} ms"
    return f"{value:.2f} s" if value < 10 else f"{value:.0f} s"
