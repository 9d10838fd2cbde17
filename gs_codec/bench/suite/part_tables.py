"""Tables of parts of the codec: what they save, coders by themselves, errors, machine."""

from __future__ import annotations

from gs_codec.analysis.page import number
from gs_codec.bench.suite.looks import looks_of
from gs_codec.bench.suite.results import Line, Results, finite, median_of
from gs_codec.bench.suite.tables import Cells, seconds, spread

#: Lines that parts are measured by, and are none.
_MEASURES = ("nothing", "steps as fine")

#: Decibels beyond which what a part saves is told by a slope that was measured far from there.
_FAR = 6.0

#: What a machine line has beside packages, in order, and what it is called.
_MACHINE = {
    "processor": "processor",
    "cores": "cores",
    "threads": "threads used",
    "memory_bytes": "memory",
    "system": "system",
    "gs_codec": "gs_codec",
    "commit": "commit",
    "python": "Python",
    "date": "date",
    "seed": "seed",
    "repeats": "timed runs, of which medians are shown",
    "command": "command to reproduce it",
}


def part_lines(results: Results, scene: str) -> list[Line]:
    """Lines of parts that were taken out."""
    return [line for line in results.of("part", scene) if line["without"] not in _MEASURES]


def is_far(line: Line, results: Results) -> bool:
    """Whether quality without a part is so far off that its price is no more than a guess."""
    known = results.of("part", line["scene"])
    whole = finite(next((x["psnr"] for x in known if x["without"] == _MEASURES[0]), None))
    without = finite(line["psnr"])
    return whole is not None and without is not None and abs(whole - without) > _FAR


def part_table(results: Results, scene: str) -> tuple[list[str], Cells]:
    """Bits and quality without each part."""
    cells = [
        [line["without"], line["profile"] + ", by views" * line["by_views"]]
        + [number(finite(line[key]), 2) for key in ("bits_per_gaussian", "psnr", "saved_bits")]
        for line in results.of("part", scene)
    ]
    return ["without", "profile", "bits / Gaussian", "PSNR dB", "saves at equal PSNR"], cells


def coder_table(results: Results) -> tuple[list[str], Cells]:
    """Entropy coders on the same symbols under the same tables."""
    cells = [
        [f"{line['scene']}, {line['profile']}, {line['coder']}", f"{line['symbols']:,}"]
        + [f"{line['bytes']:,}", number(finite(line["overhead_percent"]))]
        + [seconds(median_of(line[f"{way}_seconds"])) for way in ("encode", "decode")]
        for line in results.of("coder")
    ]
    columns = ["scene, profile, coder", "symbols", "bytes", "over entropy, %"]
    return [*columns, "encode s", "decode s"], cells


def start_table(results: Results) -> tuple[list[str], Cells]:
    """What each command takes of a small scene, by the clock and of processors."""
    cells = [
        [line["command"], *(spread(line[name]) for name in ("seconds", "cpu_seconds"))]
        for line in results.of("start")
    ]
    return ["command", "seconds", "CPU s"], cells


def points_table(results: Results) -> tuple[list[str], Cells]:
    """Bits of geometry and SH-DC, and processor time of whole encodings and decodings."""
    cells = []
    for line in results.of("points"):
        bits = [line[f"{part}_bits_per_gaussian"] for part in ("geometry", "colour")]
        times = [median_of(line[f"{way}_cpu_seconds"]) for way in ("encode", "decode")]
        peak = max(line["encode_peak_bytes"], line["decode_peak_bytes"]) / 1e6
        name = f"{line['scene']}, {line['coder']}"
        shown = (f"{value:.2f}" for value in (*bits, sum(bits)))
        cells.append([name, *shown, *map(seconds, times), f"{peak:.0f}"])
    columns = ["scene, coder", "geometry, bits", "SH-DC, bits", "both"]
    return [*columns, "encode CPU s", "decode CPU s", "peak MB"], cells


def error_table(results: Results, scene: str) -> tuple[list[str], Cells]:
    """Root mean square and largest error of each attribute under each profile."""
    lines = results.of("error", scene)
    groups = {(g["name"], g["unit"]): None for line in lines for g in line["groups"]}
    cells = []
    for name, unit in groups:
        row = [f"{name}, {unit}"]
        for line in lines:
            known = [g for g in line["groups"] if (g["name"], g["unit"]) == (name, unit)]
            row += [f"{_error(g['rms'])} ({_error(g['max'])})" for g in known] or [""]
        cells.append(row)
    return ["attribute: rms (largest)", *(line["profile"] for line in lines)], cells


def views_table(results: Results) -> tuple[list[str], Cells]:
    """Scenes, and the views they were measured in."""
    cells = [
        [
            line["scene"],
            f"{line['gaussians']:,}",
            str(line["sh_degree"]),
            f"{line['ply_bytes'] / 1e6:.1f}",
            str(line["cameras"]),
            str(line["measured_views"]),
            f"{line['width']} x {line['height']}",
            str(line["encoded_by_views"]),
            "yes" if line["photographs"] else "no",
        ]
        for line in results.of("scene")
    ]
    columns = ["scene", "Gaussians", "SH degree", "PLY, MB", "cameras", "views measured in"]
    return [*columns, "pixels", "other views encoded by", "photographs"], cells


def _error(value: float) -> str:
    known = finite(value)
    return "-" if known is None else f"{known:.2g}"


def machine_facts(results: Results) -> list[str]:
    """What was measured on, with what, and by which command."""
    line = results.first("machine")
    known = {label: line[key] for key, label in _MACHINE.items() if line.get(key) is not None}
    if "memory" in known:
        known["memory"] = f"{known['memory'] / 1e9:.1f} GB"
    if packages := line.get("packages"):
        known["packages"] = ", ".join(f"{name} {version}" for name, version in packages.items())
    versions = {x["codec"]: x["version"] for x in results.of("beside") if x.get("version")}
    looks = looks_of(results)
    peers = [f"{name} ({versions[name]})" for name in versions if looks[name].kind == "peer"]
    if peers:
        known["other codecs"] = ", ".join(peers)
    return [f"{label}: {value}" for label, value in known.items()]
