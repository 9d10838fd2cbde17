"""Write the report of an analysis as HTML: text, tables and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gs_codec.analysis.analyse import REFERENCE, Analysis
from gs_codec.analysis.fits import Fit
from gs_codec.analysis.page import heading, listing, number, page, paragraph, picture, table
from gs_codec.analysis.sensitivity import THRESHOLD, SensitivityCurves

_GROUPS = ("rotation", "scaling", "opacity", "sh-ac", "total")


def write_page(analysis: Analysis, pictures: Mapping[str, bytes]) -> str:
    """The report as HTML; `pictures` are PNG data by file name, from `draw_pictures`."""
    parts = [
        paragraph(
            f"{analysis.count:,} Gaussians of SH degree {analysis.sh_degree}. The observations of "
            "EntropyGS (arXiv 2508.10227, Section 3) on trained scenes, measured on this scene."
        )
    ]
    if analysis.notes:
        parts.append(listing(analysis.notes))
    for section in (_information, _histograms, _entropy, _sensitivity, _bits):
        parts += section(analysis, pictures)
    return page(f"Analysis of {analysis.name}", parts)


def _information(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Mutual information between channels")
    bias = max(float(found.information.bias.max()) for found in analysis.maps.values())
    yield paragraph(
        "Normalised mutual information, 2 I(X; Y) / (H(X) + H(Y)): 0 for independent channels, 1 "
        f"if each channel determines the other. Values are put into at most {analysis.bins} bins "
        f"of equal counts. A finite sample gives a small value even for independent channels, here "
        f"up to {bias:.4f}; it is measured with one channel shuffled, and removed: "
        "(NMI - shuffled) / (1 - shuffled)."
    )
    yield _colour_table(analysis)
    if "sh-ac" not in analysis.maps:
        return
    every, coloured = analysis.maps["sh-ac"], analysis.maps["sh-ac-coloured"]
    yield paragraph(
        f"Coloured Gaussians ({coloured.gaussians:,} of {every.gaussians:,}) are those without a "
        "colour channel whose SH-AC are all zero (at most a hundredth of the channel's mean "
        "magnitude). Training leaves the SH-AC of a colour at zero if it is stuck at black; this "
        "makes otherwise independent channels look dependent."
    )
    yield _relation_table(analysis)
    yield _attribute_table(analysis)
    yield picture(
        pictures["sh_ac_within_colours.png"],
        "SH-AC with SH-AC of the same colour. Grey: a channel with itself.",
    )
    yield picture(pictures["sh_ac_others.png"], "SH-AC with rotation, scaling, opacity and SH-DC.")
    yield picture(
        pictures["sh_ac_across_colours.png"],
        "SH-AC across colours, before (R, G, B) and after YCoCg. Diagonals of the blocks off the "
        "main diagonal: the same coefficient of two colours.",
    )


def _colour_table(analysis: Analysis) -> str:
    rows = []
    for name in ("sh-dc", "sh-dc-ycocg"):
        found = analysis.maps[name]
        for i, j in ((0, 1), (0, 2), (1, 2)):
            value = number(found.information.corrected[i, j])
            rows.append([f"{found.rows[i]} and {found.rows[j]}", value])
    return table("SH-DC across colours", ["pair", "NMI"], rows)


def _relation_table(analysis: Analysis) -> str:
    means = analysis.means()
    rows = []
    for suffix in ("", "-ycocg"):
        every, coloured = means[f"sh-ac{suffix}"], means[f"sh-ac-coloured{suffix}"]
        rows += [[name, number(every[name]), number(coloured[name])] for name in every]
    columns = ["pairs", "all Gaussians", "coloured"]
    return table("SH-AC with SH-AC: mean over the pairs", columns, rows)


def _attribute_table(analysis: Analysis) -> str:
    means = analysis.means()
    every, coloured = means["sh-ac-others"], means["sh-ac-coloured-others"]
    rows = [[name, number(every[name], 4), number(coloured[name], 4)] for name in every]
    columns = ["SH-AC with", "all Gaussians", "coloured"]
    return table("SH-AC with other attributes: mean over the pairs", columns, rows)


def _histograms(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Distributions of values")
    yield paragraph(
        "Bars: the values, without the outermost 0.1 % on either side. Curves: mixtures of at most "
        f"four Gaussians, fitted by expectation maximisation to the histogram of {REFERENCE}'s "
        "symbols, as in the codec; for SH-AC a Laplace distribution from median and mean absolute "
        "deviation, which is tent-shaped on the logarithmic axis. KS is the Kolmogorov-Smirnov "
        "distance of the values from the curve. KL is the divergence of the model's table from the "
        "symbols' histogram: the cost of coding with the model beyond the entropy, bits per "
        "symbol. Positions are coded as a tree, without a model per channel."
    )
    yield picture(pictures["histograms.png"], "All channels but SH-AC.")
    shaped = [fit for fit in analysis.fits if fit.channel.group != "f_rest"]
    yield table(
        f"Models at the depths of {REFERENCE}",
        ["channel", "bits", "entropy", "KS", "KL", "weight x mean ± sigma"],
        [_mixture_row(fit) for fit in shaped],
    )
    flat = [fit for fit in analysis.fits if fit.channel.group == "f_rest"]
    if not flat:
        return
    zeros = float(np.mean([fit.zeros for fit in flat]))
    yield paragraph(
        f"{zeros:.1%} of all SH-AC values are zero (as above). No Laplace distribution has such a "
        "step, so KS of all values may contain half of that share; KS of the other values is "
        "given too. After quantisation the zeros are in the fullest bin, so KL stays small."
    )
    for letter in "RGB":
        name = f"histograms_sh_ac_{letter.lower()}.png"
        yield picture(pictures[name], f"SH-AC of {letter}, one row per SH degree.")
    yield table(
        f"SH-AC at the depths of {REFERENCE}",
        ["channel", "median", "scale", "zeros", "entropy", "KS", "KS of others", "KL"],
        [_laplace_row(fit) for fit in sorted(flat, key=lambda fit: fit.channel.index)],
    )


def _mixture_row(fit: Fit) -> list[str]:
    depth = str(fit.channel.quantiser.depth)
    row = [fit.channel.name, depth, number(fit.entropy_bits), number(fit.ks), number(fit.kl_bits)]
    if fit.model != "mixture":
        return [*row, "constant" if depth == "0" else "none"]
    known = fit.parameters
    parts = zip(known["weights"], known["means"], known["sigmas"], strict=True)
    return [*row, ",  ".join(f"{w:.2f} x {m:.3g} ± {s:.2g}" for w, m, s in parts)]


def _laplace_row(fit: Fit) -> list[str]:
    if fit.model != "laplace":
        return [fit.channel.name, f"{fit.parameters['value']:.4g}", "constant", *[""] * 5]
    known = fit.parameters
    return [
        fit.channel.name,
        f"{known['median']:.4g}",
        f"{known['scale']:.4g}",
        f"{fit.zeros:.1%}",
        number(fit.entropy_bits),
        number(fit.ks),
        number(fit.ks_nonzero),
        number(fit.kl_bits),
    ]


def _entropy(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Entropy and coded size")
    yield paragraph(
        "Bits per symbol, for all Gaussians. Coded: the streams of a group in the file. Overheads "
        "are relative to the Shannon entropy: of the coded streams, of the best parametric model "
        "alone, and the paper's (means over Mip-NeRF 360, SH-AC at 4 bits). The last row also "
        "counts what a decoder needs: models, quantisers, coder states."
    )
    columns = [
        "group",
        "Q",
        "entropy",
        "coded",
        "over %",
        "parametric %",
        "paper: entropy",
        "over %",
    ]
    for profile, known in analysis.entropy.items():
        rows = [
            _entropy_row(group, known["depths"].get(group, ""), known["groups"][group])
            for group in _GROUPS
            if group in known["groups"]
        ]
        yield table(profile, columns, rows)


def _entropy_row(group: str, depth: str, known: Mapping[str, float | None]) -> list[str]:
    return [
        group,
        depth,
        number(known.get("bits_per_symbol")),
        number(known.get("coded_bits_per_symbol")),
        number(known["coded_overhead_percent"], 2),
        number(known.get("parametric_overhead_percent"), 2),
        number(known.get("paper_bits_per_symbol")),
        number(known.get("paper_overhead_percent"), 2),
    ]


def _sensitivity(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    found = analysis.sensitivity
    if found is None:
        return
    yield heading("Sensitivity of views to errors")
    width, height = found.cameras[0].width, found.cameras[0].height
    yield paragraph(
        "Uniform noise, like quantisation error, in all channels of one attribute at a time. PSNR "
        f"is against the unchanged scene, mean over {len(found.cameras)} views of {width} x "
        f"{height} pixels; seed {found.seed}. Most sensitive first: "
        f"{', '.join(curve.attribute for curve in found.ranked())}."
    )
    yield picture(
        pictures["sensitivity.png"],
        f"Quality against normalised error; 120 dB stands for 120 dB or more, and for equal views. "
        f"Large hollow marks: the error of {found.profile}.",
    )
    yield _tolerance_table(found)


def _tolerance_table(found: SensitivityCurves) -> str:
    def cell(value: float | None) -> str:
        return "-" if value is None else f"{value:.2e}"

    rows = [
        [c.attribute, cell(c.tolerance), cell(c.range_tolerance), cell(c.profile_level)]
        for c in found.ranked()
    ]
    columns = ["attribute", "standard deviations", "of the range", f"{found.profile}: std."]
    return table(f"Error at which views fall to {THRESHOLD:.0f} dB", columns, rows)


def _bits(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Bits by attribute")
    yield paragraph(
        "Bits per Gaussian in a file of each profile, encoded without cameras. The rest: header, "
        "checksums, tables, coder states, bounds, normals."
    )
    yield picture(pictures["bits.png"], "Bits per Gaussian by attribute.")
    profiles = list(analysis.bits)
    rows = [
        [part, *(number(analysis.bits[profile][part], 2) for profile in profiles)]
        for part in analysis.bits[profiles[0]]
    ]
    totals = [number(sum(analysis.bits[profile].values()), 2) for profile in profiles]
    yield table("Bits per Gaussian", ["attribute", *profiles], [*rows, ["total", *totals]])
