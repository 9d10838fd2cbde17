"""Rows of the readable table of ``gs-codec bench``."""

from __future__ import annotations

from typing import Any

from gs_codec.cli.output import print_status

COLUMNS = [
    "scene, codec (* with its start)", "ratio", "bits/G", "over entropy", "encode s", "decode s",
    "peak MB", "PSNR dB", "delta-PSNR",
]  # fmt: skip


def add_to_rows(rows: dict[str, list[str]], line: dict[str, Any]) -> None:
    """Put a result line into the rows, which are by name."""
    kind, name = line["kind"], f"{line.get('scene')}, {line.get('profile')}"
    if kind == "codec":
        over = line["entropy"].get("total", {}).get("coded_overhead_percent", 0.0)
        rows[name] = [name, *_size(line), f"{over:.3f} %", *_times(line), "", "", ""]
    elif kind == "memory":
        rows[name][6] = f"{max(line['encode_peak_bytes'], line['decode_peak_bytes']) / 1e6:.0f}"
    elif kind == "rendered" and line["camera_guided"]:
        label = f"{name}, camera-guided"
        times = ["", f"{line['encode_seconds']:.1f}", "", ""]
        rows[label] = [label, *_size(line), *times, *_quality(line)]
    elif kind == "rendered":
        rows[name][7:] = _quality(line)
    elif kind == "beside" and "absent" not in line:
        label = f"{line['scene']}, {line['codec']}" + " *" * line["own_process"]
        rows[label] = [label, *_size(line), "", *_times(line), "", *_quality(line)]


def print_absent(lines: list[dict[str, Any]]) -> None:
    """Say which codecs could not be measured, and why; each reason once."""
    for reason in sorted({line["absent"] for line in lines if "absent" in line}):
        print_status(reason)


def _size(line: dict[str, Any]) -> list[str]:
    return [f"{line['ratio']:.2f}", f"{line['bits_per_gaussian']:.1f}"]


def _times(line: dict[str, Any]) -> list[str]:
    return [f"{line[f'{way}_seconds']['median']:.3f}" for way in ("encode", "decode")]


def _quality(line: dict[str, Any]) -> list[str]:
    """PSNR and delta-PSNR, as far as they were measured."""
    if "mean" not in line:
        return ["", ""]
    psnr, delta = line["mean"]["psnr"], line.get("delta")
    return ["equal" if psnr is None else f"{psnr:.2f}", f"{delta['psnr']:+.3f}" if delta else ""]
