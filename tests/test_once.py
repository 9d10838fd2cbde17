"""Files are opened once, and their descriptive sections are parsed once."""

from __future__ import annotations

import builtins
from collections import Counter

import pytest
from scenes import random_scene

from gs_codec.codecs.adaptive import section as lattice
from gs_codec.codecs.entropygs import section as channels
from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import verify_file
from gs_codec.config import Config, RateTarget
from gs_codec.files.conversion import convert_file
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import inspect_file, read_scene
from gs_codec.formats.ply.writer import write_ply


@pytest.fixture
def counts(monkeypatch) -> Counter[str]:
    """Counts of reads of each file, by name, and of parses of each kind of section."""
    counted: Counter[str] = Counter()

    def counting(name, function):
        def call(*arguments, **options):
            counted[name] += 1
            return function(*arguments, **options)

        return call

    def count_open(path, mode="r", *arguments, **options):
        if "r" in mode and isinstance(path, str):
            counted[path] += 1
        return opened(path, mode, *arguments, **options)

    opened = builtins.open
    monkeypatch.setattr(builtins, "open", count_open)
    for module, name in ((lattice, "read_lattice"), (channels, "read_channels")):
        monkeypatch.setattr(module, name, counting(name, getattr(module, name)))
    return counted


@pytest.fixture
def scene_file(tmp_path, monkeypatch) -> str:
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", random_scene(3000, 2, seed=140))
    return "scene.ply"


@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
@pytest.mark.parametrize("options", [{}, {"max_memory": 1 << 30}], ids=["", "max-memory"])
def test_encoding_opens_the_ply_once(scene_file, counts, profile, options):
    encode_file(scene_file, "coded.egs", Config(profile), **options)
    assert counts[scene_file] == 1


def test_encoding_to_a_target_opens_the_ply_once(scene_file, counts):
    encode_file(scene_file, "coded.egs", rate=RateTarget(ratio=10))
    assert counts[scene_file] == 1


def test_converting_opens_the_ply_once(scene_file, counts):
    convert_file(scene_file, "other.ply")
    assert counts[scene_file] == 1


READ = {
    "decode": lambda: decode_file("coded.egs", "decoded.ply"),
    "decode a box": lambda: decode_file(
        "coded.egs", "decoded.ply", part=Part(box=(-1.0, -1.0, -1.0, 9.0, 9.0, 9.0))
    ),
    "decode in slabs": lambda: decode_file("coded.egs", "decoded.ply", max_memory=1 << 30),
    "read": lambda: read_scene("coded.egs"),
    "inspect": lambda: inspect_file("coded.egs"),
    "verify": lambda: verify_file("coded.egs"),
}


@pytest.mark.parametrize("how", READ)
@pytest.mark.parametrize("profile", ["m", "paper-m"])
def test_descriptive_sections_are_parsed_once(scene_file, counts, monkeypatch, profile, how):
    monkeypatch.setattr("gs_codec.codecs.slabs._SLAB", 500)
    encode_file(scene_file, "coded.egs", Config(profile, block_size=1024, threads=1))
    counts.clear()
    READ[how]()
    parsed = {name: counts[name] for name in ("read_lattice", "read_channels")}
    own = "read_lattice" if profile == "m" else "read_channels"
    assert parsed == {"read_lattice": 0, "read_channels": 0} | {own: 1}
    assert counts["coded.egs"] == 1
