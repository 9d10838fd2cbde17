"""Bits of single Gaussians: they add up to the file and its sections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import SmallBlocks, edge_scenes, encode_by, made_up_guide, random_scene

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.adaptive.costs import block_costs, gaussian_classes
from gs_codec.codecs.adaptive.decode import Blocks
from gs_codec.codecs.adaptive.sh_ac import code_bands
from gs_codec.codecs.gaussian_costs import describe_gaussian, gaussian_bits
from gs_codec.codecs.inspection import describe
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.egs.egs_file import DESCRIPTIONS, SCENE_SECTIONS, SectionId, read_file


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
def test_bits_of_symbols_add_up_to_sections(profile, sh_degree):
    """Up to the coder's partly filled words: every pass is counted, including tables."""
    scene = random_scene(6000, sh_degree, seed=4)
    file = read_file(encode_scene(scene, Config(profile))[0])
    own = block_costs(Blocks(file, sh_degree), 0).bits
    names = set(own)
    bands = {f"sh{band}" for band in range(1, sh_degree + 1)}
    assert names == bands | {"low-bits", "classes", "opacity", "scaling", "rotation", "sh-dc"}
    coded = {name: 8 * file.sizes[SectionId.of_stream(name), 0] for name in names}
    assert sum(own.values()).sum() == pytest.approx(sum(coded.values()), rel=0.003)
    for name in names - {"classes"}:  # which have almost no bits
        # Streams of a pass share coder states, which shifts bits between them.
        assert own[name].sum() == pytest.approx(coded[name], rel=0.03)


def test_symbols_of_sh_are_of_the_gaussian_whose_levels_they_are():
    """By walking the symbols in the order of FORMAT.md."""
    rng = np.random.default_rng(6)
    levels = np.rint(rng.laplace(scale=0.4, size=(3, 15, 40))).astype(np.int32)
    levels[:, :, ::3] = 0
    near = np.zeros((40, 2), np.uint8)
    coded = code_bands(levels, near, np.zeros(40, np.int64), owned=True)
    bands = [levels[:, band] for band in (slice(0, 3), slice(3, 8), slice(8, 15))]
    left = np.abs(levels).sum(axis=(0, 1))
    for number, (band, (values, _, owners)) in enumerate(zip(bands, coded, strict=True)):
        expected = [(i, left[i]) for i in range(40)] if number == 0 else []
        shares = np.abs(band).sum(axis=(0, 1))
        if number < 2:
            expected += [(i, shares[i]) for i in range(40) if left[i]]
        left = left - shares
        rest = shares.copy()
        flat = band.reshape(-1, 40)
        for k, row in enumerate(flat):
            expected += [
                (i, row[i] if k < len(flat) - 1 else np.sign(row[i])) for i in range(40) if rest[i]
            ]
            rest -= np.abs(row)
        assert [*zip(owners.tolist(), np.abs(values).tolist(), strict=True)] == [
            (i, abs(value)) for i, value in expected
        ]


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_streams_of_gaussians_add_up_to_those_of_the_file(profile):
    config = SmallBlocks(profile, block_size=100)
    data = encode_scene(random_scene(150, 2, seed=7), config)[0]
    file, bits = read_file(data, lambda s, _: s in DESCRIPTIONS), gaussian_bits(read_file(data))
    every = [describe_gaussian(file, index) for index in range(150)]
    sums: dict[str, float] = {}
    for index, found in enumerate(every):
        assert found.block == index // file.header.block_size
        assert sum(stream.bits for stream in found.streams) == pytest.approx(bits[index])
        for stream in found.streams:
            sums[stream.name] = sums.get(stream.name, 0.0) + stream.bits
    expected = {stream.name: 8 * stream.bytes for stream in describe(file).streams}
    assert list(sums) == list(expected)
    assert sums == pytest.approx(expected)
    own = {stream.name for stream in every[0].streams if not stream.shared}
    assert bool(own) == (profile in ("l", "m", "s"))


@pytest.mark.parametrize("guide", [None, made_up_guide()], ids=["camera-free", "guided"])
def test_values_are_multiples_of_their_steps(guide):
    """Steps are among those that `inspect` reports, and depend on the classes."""
    scene = random_scene(1500, 1, seed=8)
    file = read_file(encode_by(scene, Config("m", block_size=1024), guide))
    decoded = decode_scene(bytes(file.data))
    info, classes = describe(file), gaussian_classes(file)
    assert (classes.max() > 3) == (guide is not None)
    ranges: dict[str, list[float]] = {}
    for item in info.passes:
        if item.finest_step < 1 and "sum" not in item.name and item.stream != "classes":
            ranges.setdefault(item.stream, []).extend((item.finest_step, item.coarsest_step))
    for index in range(0, 1500, 50):
        steps = describe_gaussian(file, index).steps
        assert [len(own) for own in steps.values()] == [3, 1, 3, 3, 1, 1]
        for stream, (*known,) in ranges.items():
            assert min(known) <= min(steps[stream]) <= max(steps[stream]) <= max(known)
        longest, middle, shortest = decoded.log_scale[:, index].astype(float)
        for value, step in (
            (longest - middle, steps["scaling"][1]),
            (middle - shortest, steps["scaling"][2]),
        ):
            assert value / step == pytest.approx(round(value / step), abs=1e-3)
        grid = info.grid
        sides = np.array(steps["geometry"])
        cells = (decoded.positions[:, index] - np.array(grid.origin)) / sides
        np.testing.assert_allclose(cells % 1, 0.5, atol=0.02)


def test_classes_equal_the_encoders():
    scene, steps = random_scene(900, 0, seed=9), []

    def guide(scene, config):
        steps.append(made_up_guide()(scene, config))
        return steps[-1]

    classes = gaussian_classes(read_file(encode_by(scene, Config("m"), guide)))
    for own, asked in zip(classes, (steps[0].shape_class, steps[0].colour_class), strict=True):
        np.testing.assert_array_equal(np.bincount(own), np.bincount(asked))


def test_more_complex_gaussians_take_more_bits():
    """Gaussians whose SH-AC were set to 0 take fewer bits than the others."""
    scene = random_scene(4000, 3, seed=5)
    f_rest = scene.f_rest.copy()
    f_rest[:, ::2] = 0
    scene = replace(scene, f_rest=f_rest)
    data = encode_scene(scene, Config("m"))[0]
    plain = ~decode_scene(data).f_rest.any(axis=0)
    assert 1800 < plain.sum() < 2600
    bits = gaussian_bits(read_file(data))
    assert bits[plain].mean() < 0.7 * bits[~plain].mean()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", ["m", "paper-m", "lossless"])
@pytest.mark.parametrize("name", edge_scenes())
def test_edge_scenes_have_bits(profile, name):
    data = encode_scene(edge_scenes()[name], Config(profile))[0]
    bits = gaussian_bits(read_file(data))
    assert np.isfinite(bits).all()
    assert bits.sum() == pytest.approx(8 * len(data) * bool(len(bits)))
