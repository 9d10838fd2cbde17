"""Analyse a scene file, and write a report: an HTML page with tables and pictures; JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.analysis.analyse import REFERENCE, Analysis, analyse_scene
from gs_codec.analysis.fits import Fit
from gs_codec.analysis.information import BINS
from gs_codec.analysis.plots import draw_pictures
from gs_codec.analysis.sensitivity_curves import SCALES, THRESHOLD, Curve, ErrorScale
from gs_codec.files.scenes import read_scene
from gs_codec.pages.html import heading, listing, page, paragraph, picture
from gs_codec.pages.tables import Table, number
from gs_codec.report import Progress
from gs_codec.runtime.atomic import check_folder, write_files
from gs_codec.runtime.optional import check_installed
from gs_codec.runtime.wording import counted

#: Units of errors in column titles.
_ERRORS: dict[ErrorScale, str] = {"deviation": "std.", "mean": "MSE/mean"}
_SCALE_TEXTS: dict[ErrorScale, str] = {
    "deviation": "Errors are root mean squares, in standard deviations of the channel, so that "
    "attributes of any unit compare. The error scale `mean` gives them as the paper does.",
    "mean": "Errors are the mean square over the attribute's mean, as in the paper, Section 3.3. "
    "Positions and SH-AC have means of about zero, so the mean of the magnitudes of all stored "
    "values (logits, log-scales) is used; this is our reading. The quotient has the attribute's "
    "unit: with positions it depends on the scene's unit of length and origin. Constant attributes "
    "have no errors and no curve.",
}

_GROUPS = ("rotation", "scaling", "opacity", "sh-ac", "total")

#: Columns of the tables of entropies: title, key in `entropy_by_group`, and format.
_ENTROPY = (
    ("entropy", "bits_per_symbol", ".3f"),
    ("coded", "coded_bits_per_symbol", ".3f"),
    ("over %", "coded_overhead_percent", ".2f"),
    ("parametric %", "parametric_overhead_percent", ".2f"),
    ("paper: entropy", "paper_bits_per_symbol", ".3f"),
    ("over %", "paper_overhead_percent", ".2f"),
)


def analyse_file(
    source: str | Path,
    folder: str | Path | None,
    *,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Analyse the scene of a file, and write ``report.html``, its pictures and ``report.json``.

    Nothing is written if `folder` is None. `options` are the options of `analyse_scene`. Raises
    InvalidInput if the scene cannot be used, or the folder cannot be written to. Raises MissingTool
    if matplotlib, which draws the pictures, is not installed.

    Returns
    -------
    dict
        Contents of ``report.json``.
    """
    check_installed("scipy", "analyze")
    if folder is not None:
        # Check this before doing the work.
        check_installed("matplotlib", "plots")
        check_folder(folder)
    scene = read_scene(source, "drop", max_bytes=max_bytes)
    analysis = analyse_scene(scene, str(source), progress=progress, **options)
    if folder is None:
        return analysis.as_dict() | {"pictures": []}
    pictures = draw_pictures(analysis, progress)
    content = analysis.as_dict() | {"pictures": list(pictures)}
    files = pictures | {
        "report.json": (json.dumps(content, allow_nan=False) + "\n").encode(),
        "report.html": _page(analysis, pictures).encode("utf-8", "backslashreplace"),
    }
    write_files(folder, files)
    return content


def _page(analysis: Analysis, pictures: Mapping[str, bytes]) -> str:
    """The report as HTML; `pictures` are PNG data by file name, from `draw_pictures`."""
    parts = [
        paragraph(
            f"{counted(analysis.count, 'Gaussian')} of SH degree {analysis.sh_degree}. The "
            "observations of EntropyGS (arXiv 2508.10227, Section 3) on trained scenes, measured "
            "on this scene."
        )
    ]
    if analysis.notes:
        parts.append(listing(analysis.notes))
    for section in (_information, _histograms, _entropy, _sensitivity, _bits):
        parts += section(analysis, pictures)
    return page(f"Analysis of {analysis.name}", parts)


def _information(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Mutual information between channels")
    found = [each.information for each in analysis.maps.values()]
    counts, widths = (max(each[bins].bias.max() for each in found) for bins in BINS)
    yield paragraph(
        "Normalised mutual information, 2 I(X; Y) / (H(X) + H(Y)): 0 for independent channels, 1 "
        f"if each channel determines the other. Values are put into at most {analysis.bins} bins "
        'of equal counts, in the pictures too. Columns "widths" have as many bins of equal '
        "widths, the usual histogram, to compare with the paper (Section 3.1). These lie between "
        "the 0.1 % and the 99.9 % quantile, and the outermost hold the values beyond: with bins up "
        "to the outliers, nearly all values could share one. A finite sample gives a small value "
        f"even for independent channels, here up to {counts:.4f} (widths: {widths:.4f}); it is "
        "measured with one channel shuffled, and removed: (NMI - shuffled) / (1 - shuffled)."
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
    yield _means_table(analysis, "SH-AC with SH-AC", "pairs", ("", "-ycocg"), ".3f")
    yield _means_table(analysis, "SH-AC with other attributes", "SH-AC with", ("-others",), ".4f")
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
            values = [number(found.information[bins].corrected[i, j]) for bins in BINS]
            rows.append([f"{found.rows[i]} and {found.rows[j]}", *values])
    return Table(["pair", "NMI", "widths"], rows).html("SH-DC across colours")


def _means_table(
    analysis: Analysis, caption: str, column: str, kinds: Sequence[str], form: str
) -> str:
    """Means over channel pairs, of all Gaussians and of coloured ones, for either kind of bins."""
    columns = ["all Gaussians", "coloured", "all, widths", "coloured, widths"]
    means, rows = [analysis.means(bins) for bins in BINS], []
    for kind in kinds:
        cells = [of[f"{part}{kind}"] for of in means for part in ("sh-ac", "sh-ac-coloured")]
        for name in cells[0]:
            rows.append([name, *(number(cell[name], form) for cell in cells)])
    return Table([column, *columns], rows).html(f"{caption}: mean over the pairs")


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
    yield Table(
        ["channel", "bits", "entropy", "KS", "KL", "weight x mean ± sigma"],
        [_mixture_row(fit) for fit in shaped],
        left=(0, -1),
    ).html(f"Models at the depths of {REFERENCE}")
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
    yield Table(
        ["channel", "median", "scale", "zeros", "entropy", "KS", "KS of others", "KL"],
        [_laplace_row(fit) for fit in sorted(flat, key=lambda fit: fit.channel.index)],
    ).html(f"SH-AC at the depths of {REFERENCE}")


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
        "Bits per symbol, for all Gaussians. Coded: the streams of a group in a file of the best "
        "models, tables among them. Overheads are relative to the Shannon entropy: of the coded "
        "streams, of the best parametric model alone, and the paper's (means over Mip-NeRF 360, "
        "SH-AC at 4 bits). The last row also "
        "counts what a decoder needs: models, quantisers, coder states."
    )
    columns = ["group", "Q", *(title for title, _, _ in _ENTROPY)]
    for profile, known in analysis.entropy.items():
        rows = []
        for group in _GROUPS:
            if measured := known["groups"].get(group):
                cells = [number(measured.get(key), form) for _, key, form in _ENTROPY]
                rows.append([group, known["depths"].get(group, ""), *cells])
        yield Table(columns, rows).html(profile)


def _sensitivity(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    found = analysis.sensitivity
    if found is None:
        return
    yield heading("Sensitivity of views to errors")
    width, height = found.cameras[0].width, found.cameras[0].height
    yield paragraph(
        "Uniform noise, like quantisation error, in all channels of one attribute at a time. PSNR "
        "is against the unchanged scene, mean over "
        f"{counted(len(found.cameras), 'view')} of {width} x {height} pixels; seed {found.seed}. "
        "Most sensitive first: "
        f"{', '.join(curve.attribute for curve in found.ranked())}. Attributes whose views stay "
        f"above {THRESHOLD:.0f} dB come last; the table has the largest error measured (>)."
    )
    yield paragraph(_SCALE_TEXTS[found.scale])
    yield picture(
        pictures["sensitivity.png"],
        f"Quality against normalised error; 120 dB stands for 120 dB or more, and for equal views. "
        f"Large hollow marks: the error of {found.profile}.",
    )
    error = _ERRORS[found.scale]
    columns = ["attribute", error, "of the range", f"{found.profile}: {error}"]
    rows = [
        [
            curve.attribute,
            _tolerance(curve),
            number(curve.tolerance_of_range, ".2e"),
            f"{curve.profile_error:.2e}",
        ]
        for curve in found.ranked()
    ]
    caption = f"Error at which views fall to {THRESHOLD:.0f} dB: {SCALES[found.scale]}"
    yield Table(columns, rows).html(caption)


def _tolerance(curve: Curve) -> str:
    """The error at the threshold; or the largest error measured, if views stay above it."""
    if curve.tolerance is not None:
        return f"{curve.tolerance:.2e}"
    return f"> {curve.errors[-1]:.2e}" if curve.errors[-1] else ""


def _bits(analysis: Analysis, pictures: Mapping[str, bytes]) -> Iterator[str]:
    yield heading("Bits by attribute")
    yield paragraph(
        "Bits per Gaussian in a file of each profile, encoded without cameras. The rest: header, "
        "checksums, tables, coder states, index, normals."
    )
    yield picture(pictures["bits.png"], "Bits per Gaussian by attribute.")
    bits = analysis.as_dict()["bits_by_profile"]
    rows = [[part, *(number(of[part], ".2f") for of in bits.values())] for part in bits[REFERENCE]]
    yield Table(["attribute", *bits], rows).html("Bits per Gaussian")
