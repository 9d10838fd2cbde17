"""Entropy of each group next to the published figures, and the bits of each attribute."""

from __future__ import annotations

from typing import Any

from gs_codec.codecs.entropygs import paper
from gs_codec.config import SH_STREAMS, Config
from gs_codec.report import ChannelCost, EncodeReport

#: Sections of each attribute; all other sections count as "the rest".
_SECTIONS = {
    "positions": ("geometry", "low-bits", "far"),
    "SH-DC": ("sh-dc",),
    "SH-AC, degree 1": ("sh1",),
    "SH-AC, degree 2": ("sh2",),
    "SH-AC, degree 3": ("sh3",),
    "opacity": ("opacity",),
    "scaling": ("scaling",),
    "rotation": ("rotation",),
}


def entropy_by_group(report: EncodeReport) -> dict[str, dict[str, Any]]:
    """Coded bits of each rANS-coded group, its Shannon entropy, and the paper's figures.

    Coded bits include everything a decoder needs: words, and for each channel an equal share of the
    common states, models and quantisers.
    """
    groups: dict[str, list[ChannelCost]] = {}
    for cost in report.costs:
        groups.setdefault("sh-ac" if cost.stream.startswith("sh") else cost.stream, []).append(cost)
    result: dict[str, dict[str, Any]] = {}
    for group, members in groups.items():
        entropy = sum(cost.shannon_bits for cost in members)
        size = report.coded_bits(members)
        parametric = sum(cost.parametric_bits for cost in members)
        symbols = report.count * len(members)
        result[group] = {
            "channels": len(members),
            "bits_per_symbol": entropy / symbols,
            "coded_bits_per_symbol": size / symbols,
            "coded_overhead_percent": _over(size, entropy),
            "parametric_overhead_percent": _over(parametric, entropy),
            "paper_overhead_percent": paper.OVERHEAD_PERCENT.get(group),
            "paper_bits_per_symbol": paper.ENTROPY_BITS.get(group),
        }
    if report.costs:
        result["total"] = {"coded_overhead_percent": 100 * report.entropy_overhead}
    return result


def depths_by_group(config: Config, sh_degree: int) -> dict[str, str]:
    """Bits per symbol of each group of a paper profile; ``4/3/3`` if SH bands differ."""
    depths = config.resolved_depths()
    bands = [str(depths.pop(band)) for band in SH_STREAMS][:sh_degree]
    named = {group: str(bits) for group, bits in depths.items()}
    return named | {"sh-ac": bands[0] if len(set(bands)) == 1 else "/".join(bands)}


def bits_by_attribute(report: EncodeReport, sh_degree: int) -> dict[str, float]:
    """Bits per Gaussian of each attribute in a file.

    ``the rest`` is everything else: header, checksums, tables, coder states, classes, index,
    comments.
    """
    count = max(report.count, 1)
    bits = {
        attribute: 8 * sum(report.section_bytes.get(name, 0) for name in sections) / count
        for attribute, sections in _SECTIONS.items()
        if not set(sections) & set(SH_STREAMS[sh_degree:])
    }
    return bits | {"the rest": 8 * report.file_bytes / count - sum(bits.values())}


def _over(bits: float, entropy: float) -> float:
    return 100 * (bits / entropy - 1) if entropy else 0.0
