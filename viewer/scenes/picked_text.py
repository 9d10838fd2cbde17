"""Texts about a picked Gaussian."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from gs_codec.config import ADAPTIVE_PROFILES
from viewer.scenes.matched import Difference
from viewer.scenes.picked import Contribution, Picked

#: A heading, and its rows of name and value.
Section = tuple[str, list[tuple[str, str]]]

#: Domains of step sizes: for profiles `l`, `m` and `s`, and for the others if different.
_DOMAINS = {
    "geometry": ("scene units",) * 2,
    "opacity": ("logit",) * 2,
    "scaling": ("log",) * 2,
    "rotation": ("sin half angle", "quaternion"),
}

#: Suffix after the bits of a shared stream, and its explanation.
_SHARED = {"": "  ", "block": " b", "file": " f"}
_SHARED_NOTE = "b: shared by its block, f: by the file", ""

#: Maximum number of step sizes listed.
_LISTED = 4


def picked_sections(picked: Picked, letters: Sequence[str] = "AB") -> list[Section]:
    """Headings and rows with all information about a picked Gaussian, with units."""
    hit, scene = picked.hit, picked.scene
    row = "row, from 0", f"{scene.rows[hit.row]:,} of {scene.file_count:,}"
    sections: list[Section] = [(f"Gaussian of {letters[hit.which]}", [row, *_attributes(picked)])]
    wide, high = picked.contribution.size
    sections.append((f"In this view, {wide}x{high}", _in_view(picked.contribution, hit.weight)))
    if picked.difference is not None:
        other = f"{letters[1 - hit.which]}'s {picked.difference.row:,}"
        sections.append((f"Error against {other}", _error(picked.difference)))
    if picked.coded is not None:
        bits = picked.coded.streams
        total = sum(stream.bits for stream in bits)
        rows = [(s.name, f"{s.bits:.2f}" + _SHARED[s.shared]) for s in bits]
        rows.append(_SHARED_NOTE)
        sections.append((f"Bits: {total:.1f}", rows))
        sections.append((f"Step sizes (block {picked.coded.block})", _steps(picked)))
    else:
        sections.append((f"Bits unknown: {scene.bits_unknown}", []))
    return sections


def _attributes(picked: Picked) -> list[tuple[str, str]]:
    angle, axis = picked.turn
    rows = [("pruned by", picked.pruned_by)] if picked.pruned_by else []
    rows += [
        ("x, y, z, units", _numbers(picked.position)),
        ("axes, units", _numbers(picked.scales)),
        ("rotation wxyz", " ".join(f"{value:.3f}" for value in picked.rotation)),
        ("turn", f"{angle:.1f} deg about"),
        ("", " ".join(f"{value:.3f}" for value in axis)),
        ("opacity, 0-1", f"{picked.opacity:.4f}"),
        ("RGB, 0-255", " ".join(f"{value:.0f}" for value in picked.colour)),
    ]
    for band, energy in enumerate(picked.sh_energy, 1):
        rows.append((f"SH energy, band {band}", f"{energy:.3g}"))
    return rows


def _in_view(contribution: Contribution, weight: float | None) -> list[tuple[str, str]]:
    rows = [] if weight is None else [("of the clicked pixel", f"{100 * weight:.1f} %")]
    return [
        *rows,
        ("of the view", f"{100 * contribution.share:.3g} %"),
        ("sum of weights", f"{contribution.weight:.4g}"),
        ("pixels", f"{contribution.pixels:,}"),
    ]


def _error(difference: Difference) -> list[tuple[str, str]]:
    rows = [
        ("matched by", difference.matched_by),
        ("position, units", f"{difference.position:.3g}"),
        ("axes, %", " ".join(f"{100 * ratio:+.2g}" for ratio in difference.scales)),
        ("rotation, deg", f"{difference.rotation:.3g}"),
        ("opacity, 0-1", f"{difference.opacity:+.3g}"),
        ("colour, of 255", f"{difference.colour:.3g}"),
    ]
    return rows if difference.sh is None else [*rows, ("SH-AC, rms", f"{difference.sh:.3g}")]


def _steps(picked: Picked) -> list[tuple[str, str]]:
    assert picked.coded is not None
    if not picked.coded.steps:
        return [("all", "exact")]
    info = picked.scene.info
    other = info is None or info.profile not in ADAPTIVE_PROFILES
    rows = []
    for stream, steps in picked.coded.steps.items():
        domain = _DOMAINS.get(stream, ("SH",) * 2)[other]
        name = "position" if stream == "geometry" else stream
        rows.append((f"{name}, {domain}", _few(steps)))
    return rows


def _few(steps: Sequence[float]) -> str:
    """Step sizes of channels: one if all are equal, the range if there are many."""
    texts = [f"{step:.2g}" for step in steps]
    if len(set(texts)) == 1:
        return texts[0]
    return " ".join(texts) if len(texts) <= _LISTED else f"{min(steps):.2g} to {max(steps):.2g}"


def _numbers(values: NDArray) -> str:
    """Values with four digits, and large ones with all of float32."""
    return " ".join(f"{value:.4g}" if abs(value) < 1e4 else f"{value:.8g}" for value in values)
