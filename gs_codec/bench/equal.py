"""Other codecs' bits beside ours at the quality that they have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from gs_codec.bench.beside import is_ours
from gs_codec.bench.curves import Curve
from gs_codec.config import LOSSLESS


def compare_at_equal_quality(lines: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """A result line for each other codec and each curve of ours, of the lines of one scene.

    Lines are those of `measure_beside`, with views, and of `measure_gains`. Bits of a curve are
    None where it does not reach the codec's quality. What comes back exactly, whose PSNR is None,
    stands beside profile `lossless`.
    """
    curves: dict[str, list[dict[str, Any]]] = {}
    for line in lines:
        if line["kind"] == "point":
            curves.setdefault(line["curve"], []).append(line)
    drawn = {name: Curve.through_lines(points) for name, points in curves.items()}
    measured = [line for line in lines if line["kind"] == "beside" and "mean" in line]
    exact = {line["codec"]: line["bits_per_gaussian"] for line in measured}.get(LOSSLESS)
    for line in measured:
        if is_ours(line["codec"]):
            continue
        psnr = line["mean"]["psnr"]
        if psnr is None:
            yield _equal(line, LOSSLESS, exact)
            continue
        for name, curve in drawn.items():
            yield _equal(line, name, curve.bits_at(psnr))


def _equal(line: dict[str, Any], curve: str, bits: float | None) -> dict[str, Any]:
    theirs = line["bits_per_gaussian"]
    return {
        "kind": "equal",
        "scene": line["scene"],
        "codec": line["codec"],
        "psnr": line["mean"]["psnr"],
        "bits_per_gaussian": theirs,
        "curve": curve,
        "curve_bits_per_gaussian": bits,
        "saving_percent": None if bits is None else 100 * (1 - bits / theirs),
    }
