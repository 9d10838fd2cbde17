"""Bits of single Gaussians: they add up to the file, and to the sections that they are in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import edge_scenes, random_scene

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.adaptive.costs import symbol_bits
from gs_codec.codecs.costs import gaussian_bits
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.egs.file import SCENE_SECTIONS, SectionId, read_file

#: Sections of symbols that `symbol_bits` leaves out, or that have none.
_POSITIONS = {SectionId.GEOMETRY, SectionId.LOW_BITS}
_OTHERS = SCENE_SECTIONS | _POSITIONS | {SectionId.STATES}


@pytest.mark.parametrize("profile", PROFILE_CHOICES)
@pytest.mark.parametrize("block_size", [1024, 8192])
def test_bits_add_up_to_the_file(profile, block_size):
    data = encode_scene(random_scene(2500, 2, seed=3), Config(profile, block_size=block_size))[0]
    file = read_file(data)
    bits = gaussian_bits(file)
    assert bits.shape == (2500,)
    assert bits.min() > 0
    assert bits.sum() == pytest.approx(8 * len(data))
    once = file.header_size + sum(
        size for (section, _), size in file.sizes.items() if section in SCENE_SECTIONS
    )
    for block in range(file.header.block_count):
        sizes = [n for (s, b), n in file.sizes.items() if b == block and s not in SCENE_SECTIONS]
        span = slice(*file.header.block_range(block))
        shared = 8 * once / 2500 * len(bits[span])
        assert bits[span].sum() == pytest.approx(8 * sum(sizes) + shared)
    uniform = profile not in ("l", "m", "s")
    assert (len(np.unique(bits.round(6))) <= file.header.block_count) == uniform


@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("profile", ["l", "s"])
def test_symbols_take_what_their_sections_do(profile, sh_degree):
    """To the words that the coder leaves unfilled: every pass is counted, with its tables."""
    scene = random_scene(6000, sh_degree, seed=4)
    file = read_file(encode_scene(scene, Config(profile))[0])
    coded = 8 * sum(n for (section, _), n in file.sizes.items() if section not in _OTHERS)
    assert symbol_bits(file).sum() == pytest.approx(coded, rel=0.003)


def test_what_is_richer_takes_more():
    """The Gaussians whose SH-AC were set to 0 take fewer bits than the others."""
    scene = random_scene(4000, 3, seed=5)
    f_rest = scene.f_rest.copy()
    f_rest[:, ::2] = 0
    scene = replace(scene, f_rest=f_rest)
    data = encode_scene(scene, Config("m"))[0]
    plain = ~decode_scene(data).f_rest.any(axis=0)
    assert 1800 < plain.sum() < 2600
    bits = gaussian_bits(read_file(data))
    assert bits[plain].mean() < 0.7 * bits[~plain].mean()


@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
@pytest.mark.parametrize("name", edge_scenes())
def test_edge_scenes_have_bits(profile, name):
    data = encode_scene(edge_scenes()[name], Config(profile))[0]
    bits = gaussian_bits(read_file(data))
    assert np.isfinite(bits).all()
    assert bits.sum() == pytest.approx(8 * len(data) * bool(len(bits)))
