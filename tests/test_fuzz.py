"""What fuzzing starts from is sound, and what it found stays mended."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import thorough

FOLDER = Path(__file__).parent / "fuzz"
sys.path.insert(0, str(FOLDER))

from targets import TARGETS  # noqa: E402


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_are_read(name):
    seeds = TARGETS[name].seeds()
    assert seeds
    for seed in seeds:
        TARGETS[name].read(seed)


#: Slow ones, whose readers other tests give damaged files as well.
MANY = ("decode", "browser", "usd")


@pytest.mark.parametrize("name", [thorough(name) if name in MANY else name for name in TARGETS])
def test_damaged_seeds_are_refused_in_one_line(name):
    rng = np.random.default_rng(7)
    for seed in TARGETS[name].seeds():
        for _ in range(20):
            damaged = bytearray(seed)
            damaged[rng.integers(len(seed))] = rng.integers(256)
            TARGETS[name].check(bytes(damaged[: rng.integers(1, len(seed) + 1)]))
            TARGETS[name].check(bytes(damaged))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("found/*/*")), ids=lambda path: path.name)
def test_what_was_found_stays_mended(path):
    TARGETS[path.parent.name].check(path.read_bytes())
