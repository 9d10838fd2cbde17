"""PAPER.md refers to names that exist."""

from __future__ import annotations

import re
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest

from gs_codec.codecs.entropygs import paper
from gs_codec.presets import PRESETS

PAPER = Path(__file__).parents[1] / "gs_codec" / "PAPER.md"
NOTEBOOK = PAPER.with_name("bench") / "LAB_NOTEBOOK.md"
PARTS, _, FIGURES = PAPER.read_text().partition("## Published figures")


def rows_of(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


ROWS = rows_of(PARTS)
NAMES = sorted({name for row in ROWS for name in re.findall(r"`(gs_codec\.[\w.]+)`", row[1])})


def found(name):
    """The object of a dotted name: the longest module path, then attributes."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            module = import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        return reduce(getattr, parts[end:], module)
    raise AssertionError(name)


@pytest.mark.parametrize("name", NAMES)
def test_names_in_the_document_exist(name):
    assert found(name) is not None


def test_every_row_names_code_and_states_whether_it_is_exact():
    assert len(ROWS) > 15
    for section, code, exact in ROWS[1:]:
        assert "`gs_codec." in code, section
        assert exact.strip(), section


def test_every_section_and_table_is_covered():
    text = " ".join(row[0] for row in ROWS)
    for part in ("3.1", "3.2", "3.3", "4.1", "4.2", "4.3", "4.4", "5,"):
        assert part in text
    for number in range(1, 5):
        assert f"Table {number}" in text


def test_published_figures_are_those_of_the_paper():
    shown = {row[0]: row[1] for row in rows_of(FIGURES)}
    (before, whole), *_ = paper.ABLATION.values()
    for step, (psnr, size) in list(paper.ABLATION.items())[1:]:
        expected = f"{whole / size:.1f}x, {psnr - before:+.2f}"
        assert shown[step].removesuffix(" dB") == expected
    for group, bits in paper.ENTROPY_BITS.items():
        name = "SH-AC, 4 bits" if group == "sh-ac" else group
        assert shown[name] == f"{bits:.3f}, {paper.OVERHEAD_PERCENT[group]:.2f} %"
    times = {row[0]: row[1:3] for row in rows_of(FIGURES)}
    for way in ("encode", "decode"):
        assert times[way] == [f"{known[way]}" for known in paper.SECONDS.values()]


def test_our_figures_are_those_of_the_notebook():
    steps, scene = {}, ""
    for row in rows_of(NOTEBOOK.read_text().partition("## The paper's whole")[2]):
        if len(row) == 10:
            scene = row[0] or scene
            steps[scene, row[1]] = f"{row[4]}, {row[6]}"
    shown = [row for row in rows_of(FIGURES) if row[0] in paper.ABLATION]
    assert len(shown) == 6
    for step, _, *ours, _ in shown:
        assert ours == [steps[name, step] for name in ("bonsai", "mouse", "orbit, dense")]


def test_its_numbers_are_those_of_the_preset():
    text, steps = PAPER.read_text(), PRESETS["entropygs"].steps
    for stated in (
        f"theta1 = {steps.prune_importance:g} %", f"theta2 = {steps.prune_geometry:g} %",
        f"{steps.rectify:g} Laplace scales", f"{steps.refine:,} iterations",
    ):  # fmt: skip
        assert stated in text
