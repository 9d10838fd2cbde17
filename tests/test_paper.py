"""PAPER.md refers to names that exist."""

from __future__ import annotations

import re
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest

from gs_codec.presets import PRESETS

PAPER = Path(__file__).parents[1] / "gs_codec" / "PAPER.md"
ROWS = [line.split("|")[1:-1] for line in PAPER.read_text().splitlines() if line.startswith("| ")]
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


def test_its_numbers_are_those_of_the_preset():
    text, steps = PAPER.read_text(), PRESETS["entropygs"].steps
    for stated in (
        f"theta1 = {steps.prune_importance:g} %", f"theta2 = {steps.prune_geometry:g} %",
        f"{steps.rectify:g} Laplace scales", f"{steps.refine:,} iterations",
    ):  # fmt: skip
        assert stated in text
