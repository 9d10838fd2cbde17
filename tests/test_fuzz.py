"""Fuzzing seeds are valid, and past findings stay fixed."""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

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


#: Slow targets, whose readers other tests also give damaged files.
MANY = ("decode", "sequence", "browser", "usd")


@pytest.mark.parametrize("name", [thorough(name) if name in MANY else name for name in TARGETS])
def test_damaged_seeds_are_refused_in_one_line(name):
    rng = np.random.default_rng(7)
    for seed in TARGETS[name].seeds():
        for _ in range(20):
            damaged = bytearray(seed)
            damaged[rng.integers(len(seed))] = rng.integers(256)
            TARGETS[name].check(bytes(damaged[: rng.integers(1, len(seed) + 1)]))
            TARGETS[name].check(bytes(damaged))


#: JSON replacements for a value: useless numbers, other types, and names outside the folder.
ODD = (
    "1" + 400 * "0", "1e400", "-1", "1.5", "NaN", "9223372036854775808", "true", "null", "[]", "{}",
    "[[1]]", '"x"', '"../../x"', '"\\u0000"', '"\\ud800"', 999 * "[" + 999 * "]",
)  # fmt: skip


def places(node: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths of the values of a document."""
    yield path
    keys = node if isinstance(node, dict) else range(len(node) if isinstance(node, list) else 0)
    for key in keys:
        yield from places(node[key], (*path, key))


def with_odd(document: Any, path: tuple, odd: str) -> bytes:
    """A document with one value replaced by other JSON."""
    root = {"": copy.deepcopy(document)}
    node = root
    for key in (whole := ("", *path))[:-1]:
        node = node[key]
    node[whole[-1]] = "HERE"
    return json.dumps(root[""]).replace('"HERE"', odd).encode()


def documents(name: str) -> Iterator[tuple[bytes, Any]]:
    """The bytes before a document in a seed, and the document."""
    for seed in TARGETS[name].seeds():
        begin = 2 + int.from_bytes(seed[:2], "little") if name == "pruned" else 0
        text = seed[begin:].splitlines()[0] if name == "ledger" else seed[begin:]
        if text.startswith((b"{", b"[")):
            yield seed[:begin], json.loads(text)


@pytest.mark.parametrize(
    "name",
    [
        *("sog-meta", thorough("lod-meta"), "cameras", "pruned", "ledger", "gltf", "tileset"),
        *("rad-description", "lcc-a", "lcc2"),
    ],
)
def test_odd_values_in_json_are_refused_in_one_line(name):
    rng = np.random.default_rng(8)
    for before, document in documents(name):
        found = list(places(document))
        for number in rng.permutation(len(found))[:25]:
            for odd in ODD:
                TARGETS[name].check(before + with_odd(document, found[number], odd))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("found/*/*")), ids=lambda path: path.name)
def test_past_findings_stay_fixed(path):
    TARGETS[path.parent.name].check(path.read_bytes())
