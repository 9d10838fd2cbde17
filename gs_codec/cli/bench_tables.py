"""Rows of the readable tables of ``gs-codec bench``, and what stands below them."""

from __future__ import annotations

from typing import Any

from gs_codec.cli.output import print_status

#: Lines of the readable table: header, and the place of its figure in a result.
COLUMNS = [
    "scene, profile", "ratio", "bits/G", "over entropy", "encode s", "decode s", "peak MB",
    "PSNR dB", "delta-PSNR", "s/view",
]  # fmt: skip

#: Those of the other modes.
PREPARATION_COLUMNS = [
    "scene", "rule or profile", "pruned %", "SH strength", "ratio", "delta-PSNR",
]  # fmt: skip
PEER_COLUMNS = ["scene, codec (* its start is timed)", *(COLUMNS[i] for i in (1, 2, 4, 5, 7, 8))]
TARGET_COLUMNS = [
    "scene, steps", "asked", "reached", "pruned", "ratio", "bits/G", "profiles' bits/G", "PSNR dB",
    "delta-PSNR", "s",
]  # fmt: skip
POINT_COLUMNS = [
    "scene, coder", "geometry bits/G", "SH-DC bits/G", "both", "encode CPU s", "decode CPU s",
    "peak MB", "tmc3 MB",
]  # fmt: skip
PART_COLUMNS = ["scene, profile", "without", "bits/G", "PSNR dB", "saves bits/G at equal PSNR"]
START_COLUMNS = ["scene, command", "seconds", "CPU s"]
STRESS_COLUMNS = ["case, profile", "error/bound", "of", "moved", "bits/G", "s"]
EQUAL_COLUMNS = [
    "scene, codec", "PSNR dB", "bits/G", "by attributes", "by views", "paper", "lossless",
]  # fmt: skip
GAIN_COLUMNS = ["scene, steps", "at", "PSNR dB", "paper bits/G", "bits/G", "saved"]


def _decibels(quality: dict[str, float | None]) -> str:
    psnr = quality["psnr"]
    return "equal" if psnr is None else f"{psnr:.2f}"


def peer_row(line: dict[str, Any]) -> list[str]:
    """A row of a codec that is there."""
    return [
        f"{line['scene']}, {line['codec']}" + (" *" if line["own_process"] else ""),
        f"{line['ratio']:.2f}",
        f"{line['bits_per_gaussian']:.1f}",
        f"{line['encode_seconds']['median']:.3f}",
        f"{line['decode_seconds']['median']:.3f}",
        _decibels(line["mean"]) if "mean" in line else "",
        f"{line['delta']['psnr']:+.3f}" if "delta" in line else "",
    ]


def preparation_row(line: dict[str, Any]) -> list[str]:
    """A row of a pruning rule, or of a point of the frontier."""
    loss = line["delta"]["psnr"]
    shown = "" if loss is None else f"{loss:+.3f}"
    if line["kind"] == "pruning":
        return [line["scene"], line["rule"], str(line["percent"]), "", "", shown]
    size = [str(line["percent"]), f"{line['strength']:g}", f"{line['ratio']:.2f}"]
    return [line["scene"], line["profile"], *size, shown]


def add_to_rows(rows: dict[str, list[str]], line: dict[str, Any]) -> None:
    """Put a result into the readable table."""
    kind, name = line["kind"], f"{line.get('scene')}, {line.get('profile')}"
    if kind == "codec":
        over = line["entropy"].get("total", {}).get("coded_overhead_percent", 0.0)
        rows[name] = [
            name,
            f"{line['ratio']:.2f}",
            f"{line['bits_per_gaussian']:.1f}",
            f"{over:.3f} %",
            f"{line['encode_seconds']['median']:.3f}",
            f"{line['decode_seconds']['median']:.3f}",
            *[""] * 4,
        ]
    elif kind == "memory":
        rows[name][6] = f"{max(line['encode_peak_bytes'], line['decode_peak_bytes']) / 1e6:.0f}"
    elif kind == "rendered" and line["by_views"]:
        label = f"{name}, by views"
        size = [f"{line['ratio']:.2f}", f"{line['bits_per_gaussian']:.1f}", ""]
        loss = f"{line['delta']['psnr']:+.3f}" if "delta" in line else ""
        quality = [_decibels(line["mean"]), loss, ""]
        rows[label] = [label, *size, f"{line['encode_seconds']:.1f}", "", "", *quality]
    elif kind == "rendered":
        rows[name][7] = _decibels(line["mean"])
        rows[name][8] = f"{line['delta']['psnr']:+.3f}" if "delta" in line else ""
    elif kind == "render":
        label = f"{line['scene']}, views of {line['width']}x{line['height']}"
        rows[label] = [label, *[""] * 8, f"{line['seconds']['median']:.3f}"]
    elif kind == "coder" and "absent" not in line:
        over = f"{line['overhead_percent']:.3f} %"
        times = [f"{line[f'{way}_seconds']:.3f}" for way in ("encode", "decode")]
        label = f"{name}, {line['coder']}"
        rows[label] = [label, "", "", over, *times, *[""] * 4]
    elif kind == "paper":
        label = f"the paper, {line['device']}"
        rows[label] = [label, "", "", "", str(line["encode"]), str(line["decode"]), *[""] * 4]


def gain_row(line: dict[str, Any]) -> list[str]:
    """A row of what is saved at equal quality: at a profile, or over all that curves share."""
    label = f"{line['scene']}, {line['curve']}"
    if line["kind"] == "bd-rate":
        if line["percent"] is None:
            return [label, "BD-rate", "", "", "", "out of range"]
        low, high = line["range"]
        return [label, "BD-rate", f"{low:.1f}-{high:.1f}", "", "", f"{-line['percent']:.1f} %"]
    bits = [line["paper_bits_per_gaussian"], line["bits_per_gaussian"]]
    shown = ["" if value is None else f"{value:.1f}" for value in bits]
    saving = line["saving_percent"]
    saved = "out of range" if saving is None else f"{saving:.1f} %"
    return [label, line["at"], f"{line['psnr']:.2f}", *shown, saved]


def point_row(line: dict[str, Any]) -> list[str]:
    """A row of what codes geometry and SH-DC."""
    bits = [line[f"{part}_bits_per_gaussian"] for part in ("geometry", "colour")]
    times = [line[f"{way}_cpu_seconds"]["median"] for way in ("encode", "decode")]
    peak = max(line["encode_peak_bytes"], line["decode_peak_bytes"])
    return [
        f"{line['scene']}, {line['coder']}",
        *(f"{number:.2f}" for number in (*bits, sum(bits), *times)),
        f"{peak / 1e6:.0f}",
        f"{line['tool_peak_bytes'] / 1e6:.0f}" if "tool_peak_bytes" in line else "",
    ]


def start_row(line: dict[str, Any]) -> list[str]:
    """A row of a command that starts."""
    times = [f"{line[name]['median']:.2f}" for name in ("seconds", "cpu_seconds")]
    return [f"{line['scene']}, {line['command']}", *times]


def stress_row(line: dict[str, Any]) -> list[str]:
    """A row of a profile and a scene that tries the numbers."""
    label = f"{line['case']}, {line['profile']}"
    if line["refused"] is not None:
        return [label, "refused", "", "", "", ""]
    numbers = [f"{line['moved']:,}", f"{line['bits_per_gaussian']:.1f}", f"{line['seconds']:.3f}"]
    return [label, f"{line['error_over_bound']:.3f}", line["where"], *numbers]


def part_row(line: dict[str, Any]) -> list[str]:
    """A row of the codec without one of its parts."""
    label = f"{line['scene']}, {line['profile']}" + (", by views" if line["by_views"] else "")
    numbers = [line["bits_per_gaussian"], line["psnr"], line["saved_bits"]]
    return [label, line["without"], *(f"{number:.2f}" for number in numbers)]


def target_row(line: dict[str, Any]) -> list[str]:
    """A row of a profile, or of a file of a wanted size or quality."""
    asked, reached, pruned, of_profiles = line.get("profile", ""), "", "", ""
    if line["kind"] == "refused":
        asked = ", ".join(f"{k} {v:g}" for k, v in line["target"].items() if k != "allow_prune")
        row = [f"{line['scene']}, {line['curve']}", asked, "refused"]
        return row + [""] * (len(TARGET_COLUMNS) - len(row))
    if line["kind"] == "target":
        pruned = f"{100 * line['pruned'] / line['gaussians']:.0f} %" if line["pruned"] else ""
        bits = line["profiles_bits_per_gaussian"]
        of_profiles = "out of range" if bits is None else f"{bits:.1f}"
        if line["limit_bytes"] is not None:
            asked = f"{line['limit_bytes']:,} bytes"
            reached = f"{line['file_bytes']:,}"
        else:
            asked = f"{line['target']['psnr_drop']:g} dB"
            reached = f"{line['psnr_drop']:.4f}"
    size = [f"{line['ratio']:.2f}", f"{line['bits_per_gaussian']:.1f}", of_profiles]
    loss = f"{line['delta']['psnr']:+.3f}" if "delta" in line else ""
    quality = [_decibels(line["mean"]), loss, f"{line['encode_seconds']:.1f}"]
    return [f"{line['scene']}, {line['curve']}", asked, reached, pruned, *size, *quality]


def equal_rows(lines: list[dict[str, Any]]) -> list[list[str]]:
    """A row for each other codec: its bits, and those of our curves at its quality."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for line in lines:
        if line["kind"] == "equal":
            row = rows.setdefault((line["scene"], line["codec"]), {"line": line})
            row[line["curve"]] = line["curve_bits_per_gaussian"]
    return [
        [
            f"{scene}, {codec}",
            _decibels(row["line"]),
            f"{row['line']['bits_per_gaussian']:.1f}",
            *(_bits(row, curve) for curve in EQUAL_COLUMNS[3:]),
        ]
        for (scene, codec), row in rows.items()
    ]


def _bits(row: dict[str, Any], curve: str) -> str:
    if curve not in row:
        return ""
    return "out of range" if row[curve] is None else f"{row[curve]:.1f}"


def print_absent(lines: list[dict[str, Any]]) -> None:
    """Say what could not be measured, and why; each once."""
    for reason in sorted({line["absent"] for line in lines if "absent" in line}):
        print_status(reason)
