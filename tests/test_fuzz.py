"""What fuzzing starts from is sound, and what it found stays mended."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parent / "fuzz"
sys.path.insert(0, str(FOLDER))

from targets import TARGETS  # noqa: E402


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_are_read(name):
    seeds = TARGETS[name].seeds()
    assert seeds
    for seed in seeds:
        TARGETS[name].read(seed)


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_seeds_are_refused_in_one_line(name):
    rng, seeds = np.random.default_rng(7), TARGETS[name].seeds()
    for seed in seeds:
        for _ in range(max(2, 60 // len(seeds))):
            damaged = bytearray(seed)
            damaged[rng.integers(len(seed))] = rng.integers(256)
            TARGETS[name].check(bytes(damaged[: rng.integers(1, len(seed) + 1)]))
            TARGETS[name].check(bytes(damaged))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("found/*/*")), ids=lambda path: path.name)
def test_what_was_found_stays_mended(path):
    TARGETS[path.parent.name].check(path.read_bytes())
