"""The report of an analysis in words, tables and pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gs_codec.analysis.analyse import REFERENCE, Analysis
from gs_codec.analysis.fits import Fit
from gs_codec.analysis.page import heading, listing, number, page, paragraph, picture, table
from gs_codec.analysis.sensitivity import THRESHOLD, Sensitivity

_GROUPS = ("rotation", "scaling", "opacity", "sh-ac", "total")


def write_page(analysis: Analysis, pictures: Mapping[str, bytes]) -> str:
    """The report as HTML; `pictures` are PNG files by name, those of `draw_pictures`."""
    parts = [
        paragraph(
            f"{analysis.count:,} Gaussians of SH degree {analysis.sh_degree}. What EntropyGS "
            "(arXiv 2508.10227, Section 3) says of trained scenes, measured on this one."
        )
    ]
    if analysis.notes:
        parts.append(listing(analysis.notes))
    for section in (_information, _histograms, _entropy, _sensitivity, _bits):
        parts += section(analysis, pictures)
    return page(f"Analysis of {analysis.name}", parts)


def _information(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("What channels tell of each other")
    bias = max(float(found.information.bias.max()) for found in analysis.maps.values())
    yield paragraph(
        "Normalised mutual information, 2 I(X; Y) / (H(X) + H(Y)): 0 for independent channels, 1 "
        f"where each follows from the other. Values fall into at most {analysis.bins} bins that "
        f"hold equally many. A finite sample shows some even of independent channels, here up to "
        f"{bias:.4f}; this is measured with one of the two shuffled, and taken off: "
        "(NMI - shuffled) / (1 - shuffled)."
    )
    yield _colour_table(analysis)
    if "sh-ac" not in analysis.maps:
        return
    every, coloured = analysis.maps["sh-ac"], analysis.maps["sh-ac-coloured"]
    yield paragraph(
        f"Coloured Gaussians ({coloured.gaussians:,} of {every.gaussians:,}) are those none of "
        "whose colours has SH-AC that are all zero (at most a hundredth of the channel's mean "
        "magnitude). Training leaves a colour's SH-AC at zero where it is stuck at black; that "
        "makes channels alike which otherwise are not."
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
        "SH-AC across colours, before (R, G, B) and after YCoCg. Diagonals off the centre: the "
        "same coefficient of two colours.",
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
    yield heading("How values are distributed")
    yield paragraph(
        "Bars: the values, without the outermost 0.1 % on either side. Curves: mixtures of at most "
        f"four Gaussians by expectation maximisation on the histogram of {REFERENCE}'s symbols, as "
        "the codec fits them; for SH-AC a Laplace distribution by median and mean absolute "
        "deviation, on a logarithmic axis, where it is a tent. KS is the Kolmogorov-Smirnov "
        "distance of the values from the curve. KL is the divergence of the model's table from the "
        "symbols' histogram: what coding by the model costs over the entropy, bits a symbol. "
        "Positions are coded as a tree, without a model of a channel."
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
        "step: half of that share can appear in KS of all values, which is why KS of the others is "
        "given too. Quantised, the zeros fall into the bin that is fullest anyway, so KL is small."
    )
    for letter in "RGB":
        name = f"histograms_sh_ac_{letter.lower()}.png"
        yield picture(pictures[name], f"SH-AC of {letter}, a row for each SH degree.")
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
    yield heading("Entropy, and what coding takes")
    yield paragraph(
        "Bits a symbol. Coded: the streams of a group in the file, of all Gaussians. Overheads are "
        "over the Shannon entropy: of what is coded, of the best parametric model alone, and the "
        "paper's (means over Mip-NeRF 360, SH-AC at 4 bits). The last row counts what it takes to "
        "decode, too: models, quantisers, coder states."
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
    yield heading("What views lose by errors")
    width, height = found.cameras[0].width, found.cameras[0].height
    yield paragraph(
        "Uniform noise, as quantisation makes it, in all channels of one attribute at a time. PSNR "
        f"is against the scene as it is, mean over {len(found.cameras)} views of {width} x "
        f"{height} pixels; seed {found.seed}. Most sensitive first: "
        f"{', '.join(curve.attribute for curve in found.ranked())}."
    )
    yield picture(
        pictures["sensitivity.png"],
        f"Quality against normalised error; 120 dB stands for more, and for equal views. Large "
        f"hollow marks: the error of {found.profile}.",
    )
    yield _tolerance_table(found)


def _tolerance_table(found: Sensitivity) -> str:
    def cell(value: float | None) -> str:
        return "-" if value is None else f"{value:.2e}"

    rows = [
        [c.attribute, cell(c.tolerance), cell(c.range_tolerance), cell(c.profile_level)]
        for c in found.ranked()
    ]
    columns = ["attribute", "standard deviations", "of the range", f"{found.profile}: std."]
    return table(f"Error at which views come to {THRESHOLD:.0f} dB", columns, rows)


def _bits(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Where the bits go")
    yield paragraph(
        "Bits a Gaussian of each profile's file, encoded without cameras. The rest: header, "
        "checksums, tables, coder states, bounds, normals."
    )
    yield picture(pictures["bits.png"], "Bits a Gaussian by attribute.")
    profiles = list(analysis.bits)
    rows = [
        [part, *(number(analysis.bits[profile][part], 2) for profile in profiles)]
        for part in analysis.bits[profiles[0]]
    ]
    totals = [number(sum(analysis.bits[profile].values()), 2) for profile in profiles]
    yield table("Bits a Gaussian", ["attribute", *profiles], [*rows, ["total", *totals]])
