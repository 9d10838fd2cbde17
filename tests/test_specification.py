"""Numbers and tables in FORMAT.md equal those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gs_codec import egs
from gs_codec.codecs.entropygs.models import normal_table
from gs_codec.egs.egs_file import DESCRIPTIONS, SCENE_SECTIONS, SectionId
from gs_codec.egs.header import PROFILE_NAMES
from gs_codec.rendering.harmonics import sh_basis
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import SH_C0

TEXT = (Path(egs.__file__).parent / "FORMAT.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """Cells of the tables of a section, including its subsections."""
    part = re.split(r"^#+ ", TEXT.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in part.splitlines()
        if line.startswith("|")
    ]


def test_normal_distribution():
    cells = [row[1:] for row in rows("Annex B: the normal distribution")[2:]]
    printed = [int(cell) for row in cells for cell in row if cell]
    assert printed == normal_table().tolist()
    assert len(printed) == 513


@kernel
def fill_basis(x, y, z, basis):
    sh_basis(x, y, z, 15, basis)


def test_spherical_harmonics():
    direction = np.random.default_rng(320).normal(size=3)
    direction /= np.linalg.norm(direction)
    basis = np.empty(15)
    fill_basis(*direction, basis)
    named = dict(zip("xyz", direction.tolist(), strict=True))
    listed = [row for row in rows("What the numbers mean") if row[1].isdigit()]
    assert [int(row[1]) for row in listed] == list(range(15))
    for row in listed:
        product = re.sub(r"(?<=[\dxyz)]) (?=[xyz(])", " * ", row[2])
        np.testing.assert_allclose(eval(product, {}, named), basis[int(row[1])], rtol=1e-12)
    assert f"0.5 + {SH_C0} f_dc_c" in TEXT


def test_sections():
    found = {}
    for numbers, names, of, *_ in rows("Section table entry"):
        if numbers[0].isdigit():
            for number, name in zip(numbers.split(", "), names.split(", "), strict=True):
                found[int(number)] = (name, of == "scene")
    assert found == {s.value: (s.label, s in SCENE_SECTIONS) for s in SectionId}
    order = ", ".join(f"`{section.label}`" for section in DESCRIPTIONS)
    assert f"The first sections of a file, where present, are {order}" in TEXT


def test_profiles():
    listed = ", ".join(f"{number} `{name}`" for number, name in enumerate(PROFILE_NAMES))
    assert listed in TEXT
