"""Analyse the file of a scene, and write a report: a page of text, tables and pictures; JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.analysis.analyse import REFERENCE, Analysis, analyse_scene
from gs_codec.analysis.fits import Fit
from gs_codec.analysis.page import heading, listing, number, page, paragraph, picture, table
from gs_codec.analysis.plots import draw_pictures, new_figure
from gs_codec.analysis.sensitivity import THRESHOLD
from gs_codec.files.scenes import read_scene
from gs_codec.report import Progress
from gs_codec.runtime.atomic import check_writable, write_files

_GROUPS = ("rotation", "scaling", "opacity", "sh-ac", "total")

#: Columns of the tables of entropies: title, key in `entropy_by_group`, and digits.
_ENTROPY = (
    ("entropy", "bits_per_symbol", 3),
    ("coded", "coded_bits_per_symbol", 3),
    ("over %", "coded_overhead_percent", 2),
    ("parametric %", "parametric_overhead_percent", 2),
    ("paper: entropy", "paper_bits_per_symbol", 3),
    ("over %", "paper_overhead_percent", 2),
)


def analyse_file(
    source: str | Path,
    folder: str | Path,
    *,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Analyse the scene of a file, and write ``report.html``, its pictures and ``report.json``.

    `options` are those of `analyse_scene`.

    Returns
    -------
    dict
        Contents of ``report.json``.

    Raises
    ------
    InvalidInput
        If the scene cannot be used, or the folder cannot be written to.
    MissingTool
        If matplotlib is not installed.
    """
    # Find out that the report cannot be written before doing the work.
    new_figure(1, 1)
    target = Path(folder)
    there = next(path for path in (target, *target.absolute().parents) if path.exists())
    check_writable(there / "report.html")
    scene = read_scene(source, "drop", max_bytes=max_bytes)
    analysis = analyse_scene(scene, str(source), progress=progress, **options)
    pictures = draw_pictures(analysis, progress)
    content = analysis.as_dict() | {"pictures": list(pictures)}
    files = pictures | {
        "report.json": (json.dumps(content, allow_nan=False) + "\n").encode(),
        "report.html": _page(analysis, pictures).encode(),
    }
    write_files(target, files)
    return content


def _page(analysis: Analysis, pictures: Mapping[str, bytes]) -> str:
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
    yield _means_table(analysis, "SH-AC with SH-AC", "pairs", ("", "-ycocg"), 3)
    yield _means_table(analysis, "SH-AC with other attributes", "SH-AC with", ("-others",), 4)
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


def _means_table(
    analysis: Analysis, caption: str, column: str, kinds: Sequence[str], digits: int
) -> str:
    """Means over pairs of channels, of all Gaussians and of the coloured ones."""
    means, rows = analysis.means(), []
    for kind in kinds:
        every, coloured = means[f"sh-ac{kind}"], means[f"sh-ac-coloured{kind}"]
        for name in every:
            rows.append([name, number(every[name], digits), number(coloured[name], digits)])
    return table(f"{caption}: mean over the pairs", [column, "all Gaussians", "coloured"], rows)


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
    depth, known = fit.channel.quantiser.depth, fit.parameters
    shape = "none" if depth else "constant"
    if fit.model == "mixture":
        parts = zip(known["weights"], known["means"], known["sigmas"], strict=True)
        shape = ",  ".join(f"{w:.2f} x {m:.3g} ± {s:.2g}" for w, m, s in parts)
    numbers = [number(value) for value in (fit.entropy_bits, fit.ks, fit.kl_bits)]
    return [fit.channel.name, str(depth), *numbers, shape]


def _laplace_row(fit: Fit) -> list[str]:
    known = fit.parameters
    if fit.model != "laplace":
        return [fit.channel.name, f"{known['value']:.4g}", "constant", *[""] * 5]
    shape = [f"{known['median']:.4g}", f"{known['scale']:.4g}", f"{fit.zeros:.1%}"]
    measured = (fit.entropy_bits, fit.ks, fit.ks_nonzero, fit.kl_bits)
    return [fit.channel.name, *shape, *(number(value) for value in measured)]


def _entropy(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Entropy and coded size")
    yield paragraph(
        "Bits per symbol, for all Gaussians. Coded: the streams of a group in the file. Overheads "
        "are relative to the Shannon entropy: of the coded streams, of the best parametric model "
        "alone, and the paper's (means over Mip-NeRF 360, SH-AC at 4 bits). The last row also "
        "counts what a decoder needs: models, quantisers, coder states."
    )
    columns = ["group", "Q", *(title for title, _, _ in _ENTROPY)]
    for profile, known in analysis.entropy.items():
        rows = []
        for group in _GROUPS:
            if measured := known["groups"].get(group):
                cells = [number(measured.get(key), digits) for _, key, digits in _ENTROPY]
                rows.append([group, known["depths"].get(group, ""), *cells])
        yield table(profile, columns, rows)


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
    columns = ["attribute", "standard deviations", "of the range", f"{found.profile}: std."]
    rows = []
    for curve in found.ranked():
        errors = (curve.tolerance, curve.tolerance_of_range, curve.profile_level)
        rows.append([curve.attribute, *("-" if x is None else f"{x:.2e}" for x in errors)])
    yield table(f"Error at which views fall to {THRESHOLD:.0f} dB", columns, rows)


def _bits(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Bits by attribute")
    yield paragraph(
        "Bits per Gaussian in a file of each profile, encoded without cameras. The rest: header, "
        "checksums, tables, coder states, bounds, normals."
    )
    yield picture(pictures["bits.png"], "Bits per Gaussian by attribute.")
    bits = analysis.as_dict()["bits_per_gaussian"]
    rows = [[part, *(number(of[part], 2) for of in bits.values())] for part in bits[REFERENCE]]
    yield table("Bits per Gaussian", ["attribute", *bits], rows)
