"""SH-AC in a local basis: fewer bits for the same error, exact decoders, refused damage."""

from __future__ import annotations

import struct
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import reference_decoder
from damage import BASIS, REFUSALS, sample, with_section
from in_tasks import in_tasks, saved, whole
from javascript import NODE, digest, run
from level_files import encoded, in_level
from scenes import (
    assert_same_floats,
    encode_by,
    made_up_guide,
    moved_apart,
    random_scene,
    seen_from,
)

from gs_codec.codecs import decode_part, decode_scene, encode_scene
from gs_codec.codecs.adaptive.arrange import arrange_scene
from gs_codec.codecs.adaptive.basis import bounds, choose_bases, read_bases
from gs_codec.codecs.adaptive.costs import block_costs
from gs_codec.codecs.adaptive.decode import Blocks
from gs_codec.codecs.gaussian_costs import gaussian_bits
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.coding.exact_math import eigenvectors, inverses
from gs_codec.coding.ycocg import from_ycocg
from gs_codec.config import Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.egs.header import Feature
from gs_codec.egs.index import levels_of, open_level
from gs_codec.errors import CorruptStream
from gs_codec.scene import Scene

SEEN = seen_from(random_scene(3000, 3, seed=400), 3)


def ac_bits(scene: Scene) -> int:
    """Bits of SH-AC and of bases."""
    sizes = encode_scene(scene, Config("m"))[1].section_bytes
    return 8 * sum(sizes.get(name, 0) for name in ("sh1", "sh2", "sh3", "basis"))


def test_colours_seen_from_few_directions_take_half_of_the_bits():
    """Both scenes have the same amplitudes, and one has them in any direction."""
    rng = np.random.default_rng(401)
    planes = SEEN.f_rest.reshape(3, 15, -1)
    anywhere = np.take_along_axis(planes, rng.random(planes.shape).argsort(axis=1), axis=1)
    other = replace(SEEN, f_rest=anywhere.reshape(SEEN.f_rest.shape))
    assert ac_bits(SEEN) < 0.5 * ac_bits(other)


def test_errors_are_below_a_step_size():
    """Diffusion and the coarser steps of small components make them larger than 1 / sqrt(12)."""
    data = encode_scene(SEEN, Config("m"))[0]
    arranged = arrange_scene(SEEN, Config("m"), None)
    blocks = Blocks(read_file(data), 3)
    steps = block_costs(blocks, 0).steps["sh1"][0]
    error = decode_scene(data).f_rest - arranged.source.take(arranged.order).f_rest
    assert 0.3 < np.sqrt(np.mean((error / steps) ** 2)) < 0.9


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_no_basis_where_it_saves_nothing(degree):
    for scene in (random_scene(3000, degree), random_scene(1, degree), random_scene(0, degree)):
        info = inspect_bytes(encode_scene(scene, Config("m"))[0])
        assert (info.version, info.features) == (1, ())


def test_files_encoded_fast_have_none():
    data = encode_scene(SEEN, Config("m", effort="fast"))[0]
    assert inspect_bytes(data).features == ()


def test_guided_files_have_none():
    data = encode_by(SEEN, Config("m"), made_up_guide(seed=402))
    assert inspect_bytes(data).features == ()


def test_bands_with_steps_of_their_own_have_none():
    data = encode_scene(SEEN, Config("m", depths={"sh3": 4}))[0]
    assert inspect_bytes(data).features == ()


def test_runs_have_their_own_bases():
    first, second = (seen_from(random_scene(1500, 3, k), 1, seed=k) for k in (403, 404))
    file = read_file(encode_scene(moved_apart(first, second), Config("m"))[0])
    assert file.header.features == Feature.LOCAL_BASIS
    bases = read_bases(file, 0)
    assert len(bases.entries) >= 2
    main = bases.entries[[0, -1], :, 0]
    cosine = abs(main[0] @ main[1]) / np.linalg.norm(main[0]) / np.linalg.norm(main[1])
    assert cosine < 0.9


def test_components_are_turned_back():
    values = SEEN.f_rest.reshape(3, 15, -1) * np.float32(30)
    bases = choose_bases(values)
    found = bases.components(values)
    matrices = bases.matrices / 64
    for matrix, (start, stop) in zip(
        matrices,
        np.lib.stride_tricks.sliding_window_view(bounds(len(matrices), values.shape[2]), 2),
        strict=True,
    ):
        back = np.einsum("kj,cjn->ckn", matrix, found[:, :, start:stop])
        np.testing.assert_allclose(back, values[:, :, start:stop], atol=1e-3)
    # The first components have nearly all of the energy.
    energy = np.sum(found**2, axis=(0, 2))
    assert energy[:3].sum() > 0.95 * energy.sum()


def test_levels_are_turned_exactly_where_most_are_zero():
    rng = np.random.default_rng(406)
    levels = rng.integers(-3, 4, (3, 15, 300), dtype=np.int32)
    levels[:, 5:, :200] = 0
    levels[2, :, 100:] = 0
    bases = choose_bases(SEEN.f_rest.reshape(3, 15, -1) * np.float32(30))
    ends, shifts = bounds(len(bases.entries), 300), rng.integers(0, 3, 300)
    found = np.empty((3, 15, 300), np.float32)
    assert bases.fill(levels, ends, 1 << 10, shifts, 1600.0, found)
    turned = np.empty(levels.shape)
    for matrix, span in zip(bases.matrices, pairwise(ends), strict=True):
        turned[:, :, slice(*span)] = np.einsum("kj,cjn->ckn", matrix, levels[:, :, slice(*span)])
    np.testing.assert_array_equal(found, from_ycocg(turned * 2.0 ** (shifts - 16)))


def test_eigenvectors_and_inverses():
    rng = np.random.default_rng(405)
    roots = rng.normal(size=(3, 7, 7))
    squares = roots @ roots.transpose(0, 2, 1)
    for matrix, values, vectors in zip(squares, *eigenvectors(squares), strict=True):
        np.testing.assert_allclose(vectors @ vectors.T, np.eye(7), atol=1e-12)
        np.testing.assert_allclose(vectors @ matrix @ vectors.T, np.diag(values), atol=1e-9)
    identities = np.broadcast_to(np.eye(7), roots.shape)
    np.testing.assert_allclose(inverses(roots) @ roots, identities, atol=1e-9)
    found = inverses(np.stack([np.eye(3), np.ones((3, 3))]))
    assert np.array_equal(found[0], np.eye(3))
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_a_lower_degree_is_part_of_the_whole(degree):
    data = encode_scene(SEEN, Config("m", block_size=1024))[0]
    whole_scene, file = decode_part(data, Part())
    part, read = decode_part(data, Part(sh_degree=degree))
    kept = part.f_rest.shape[0] // 3
    expected = whole_scene.f_rest.reshape(3, 15, 3000)[:, :kept].reshape(3 * kept, 3000)
    assert_same_floats(part, replace(whole_scene, f_rest=np.ascontiguousarray(expected)))
    # All components are needed, or none.
    assert (read.bytes_read < file.bytes_read) == (degree == 0)


def test_bits_are_those_of_the_file():
    data = encode_scene(SEEN, Config("m", block_size=1024))[0]
    assert gaussian_bits(read_file(data)).sum() == pytest.approx(8 * len(data))


@pytest.mark.parametrize("lod", [False, True])
def test_tasks_give_the_same_file(tmp_path, lod):
    path = saved(tmp_path / "a.ply", seen_from(random_scene(6000, 2, seed=406), 2))
    config = Config("m", block_size=1024, lod=lod)
    expected = whole(path, tmp_path / "whole.egs", config)
    assert inspect_bytes(expected[0]).features == ("local SH basis",)
    assert in_tasks([path], tmp_path / "tasks.egs", config, 2000 + 4000 * lod) == expected


# Levels


def test_levels_have_bases_or_not():
    data = encoded(seen_from(random_scene(300, 1, seed=407), 1, scale=100.0))
    file = read_file(data)
    levels = [open_level(file, level) for level in levels_of(file)]
    assert {Feature.LOCAL_BASIS} == {found.header.features for found in levels}
    found = reference_decoder.decode(data)["levels"]
    for level, values in enumerate(found, 1):
        scene = decode_part(data, Part(level=level))[0]
        row = values["values"]["f_rest_3"].view("u4")
        np.testing.assert_array_equal(row, scene.f_rest[3].view("u4"))


def test_levels_of_a_file_without_bases_have_none():
    plain = encoded(random_scene(300, 1, seed=407))
    seen = encoded(seen_from(random_scene(300, 1, seed=407), 1, scale=100.0))
    level = bytes(read_file(seen).read().sections[SectionId.LEVEL, 1])
    damaged = in_level(plain, lambda _: level)
    with pytest.raises(REFUSALS, match="level 1: header: does not match a level of this file"):
        decode_part(damaged, Part(level=1))
    with pytest.raises(ValueError, match="level 1: features"):
        reference_decoder.decode(damaged)


# Damage


def other_unit(content: bytes) -> bytes:
    """The section `lattice` with another unit of sh2."""
    at = 16 + 3 + 2 + 8 + 4 * 5
    (unit,) = struct.unpack_from("<I", content, at)
    return content[:at] + struct.pack("<I", unit + 1) + content[at + 4 :]


DAMAGED = {
    "empty": (SectionId.BASIS, lambda old: b"", "0 runs, expected 1-3"),
    "no run": (SectionId.BASIS, lambda old: b"\0" + old[1:], "0 runs, expected 1-3"),
    "too many": (SectionId.BASIS, lambda old: b"\4" + old[1:], "4 runs, expected 1-3"),
    "two": (SectionId.BASIS, lambda old: b"\2" + old[1:], "bytes, expected"),
    "cut": (SectionId.BASIS, lambda old: old[:-1], "bytes, expected"),
    "longer": (SectionId.BASIS, lambda old: old + b"\0", "bytes, expected"),
    "entry": (SectionId.BASIS, lambda old: old[:1] + b"\xff" + old[2:], "out of range"),
    "factor": (SectionId.BASIS, lambda old: old[:7] + b"\xff" + old[8:], "out of range"),
    "padding": (SectionId.BASIS, lambda old: old[:-1] + bytes([old[-1] | 1]), "padding bits"),
    "unit": (SectionId.LATTICE, other_unit, "units of SH-AC differ"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_sections_are_refused(name):
    section, change, message = DAMAGED[name]
    damaged = with_section(sample(BASIS), section, change)
    with pytest.raises(CorruptStream) as caught:
        decode_scene(damaged)
    assert message in str(caught.value)
    with pytest.raises((ValueError, IndexError)):
        reference_decoder.decode(damaged)


@pytest.mark.skipif(NODE is None, reason="needs Node")
def test_javascript_has_the_same_floats_and_refuses_the_same():
    whole_file = encode_scene(SEEN, Config("l"))[0]
    found, lower = run({"bytes": whole_file}, {"bytes": whole_file, "shDegree": 1})
    assert found.get("hash") == digest(decode_scene(whole_file)), found
    assert lower.get("hash") == digest(decode_part(whole_file, Part(sh_degree=1))[0]), lower
    given = sample(BASIS)
    broken = [with_section(given, section, change) for section, change, _ in DAMAGED.values()]
    for name, found in zip(DAMAGED, run(*({"bytes": data} for data in broken)), strict=True):
        assert found.get("error") == "CorruptError", (name, found)
