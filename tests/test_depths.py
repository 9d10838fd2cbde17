"""Depths with profiles l, m and s: mean steps equal those of paper profiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lattices import Shaped, assert_on_lattices
from requested import to_rate
from scenes import encode_by, made_up_guide, random_scene

from gs_codec.codecs import encode_scene
from gs_codec.codecs.adaptive.arrange import arrange_scene
from gs_codec.codecs.adaptive.step_conversion import as_deep, mean_octaves
from gs_codec.codecs.adaptive.step_sizes import StepSizes
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.scene import Scene

#: Passes whose steps represent a group.
STREAMS = ("opacity", "scaling", "rotation", "sh-dc", "sh1", "sh2", "sh3")


@pytest.fixture(scope="module")
def scene() -> Scene:
    made = random_scene(3000, 3, seed=220)
    return replace(made, rot=made.rot / np.linalg.norm(made.rot, axis=0))


def finest_steps(data: bytes) -> dict[str, float]:
    """Finest step of each stream; for positions, the grid's."""
    info = inspect_bytes(data)
    steps = {item.stream: item.finest_step for item in info.passes if item.stream in STREAMS}
    assert info.grid is not None
    return {"geometry": info.grid.step, **steps}


def test_means_are_those_of_paper_files(scene):
    depths = {"geometry": 13, "rotation": 8, "opacity": 5, "sh-dc": 7, "sh2": 6}
    channels = inspect_bytes(encode_scene(scene, Config("paper-m", depths))[0]).channels
    found = mean_octaves(scene, depths)
    assert set(found) == set(depths)
    for group, octaves in found.items():
        steps = [c.quantiser.step for c in channels if c.stream == group]
        assert octaves == pytest.approx(np.log2(steps).mean())


def test_quaternions_count_as_unit_ones(scene):
    longer = replace(scene, rot=scene.rot * np.linspace(0.5, 9, scene.count, dtype=np.float32))
    assert mean_octaves(longer, {"rotation": 7}) == pytest.approx(
        mean_octaves(scene, {"rotation": 7}), abs=1e-5
    )


def test_a_constant_group_has_no_step(scene):
    flat = replace(scene, opacity=np.ones_like(scene.opacity))
    assert mean_octaves(flat, {"opacity": 8, "scaling": 8}).keys() == {"scaling"}
    encode_scene(flat, Config("m", {"opacity": 8}))


def test_only_the_means_change():
    rng = np.random.default_rng(221)
    known = np.concatenate([np.ones((1, 50)), rng.normal(size=(4, 50))])
    turns = ("turn_0", "turn_1", "turn_2")
    rules = ("opacity", "scale_0", "scale_1", "scale_2", *turns, "position", "colour")
    classes = rng.integers(0, 4, (2, 100)).astype(np.uint8)
    steps = StepSizes(
        classes[0], classes[1], {r: rng.normal(size=5) for r in rules}, (0.5, 0.25, 2.0)
    )
    some = slice(None, None, 2)

    def octaves(steps: StepSizes, rule: str) -> np.ndarray:
        of = steps.colour_class if rule == "colour" else steps.shape_class
        return of[some] + steps.coefficients[rule] @ known

    asked = {"rotation": -3.5, "scaling": -1.0, "geometry": 4.0, "sh-dc": -2.0, "sh2": -6.0}
    moved = as_deep(steps, some, known, asked)
    assert np.mean([octaves(moved, turn) for turn in turns]) == pytest.approx(-3.5)
    assert octaves(moved, "position").mean() == pytest.approx(4.0)
    assert octaves(moved, "colour").mean() == pytest.approx(-2.0)
    scales = [octaves(moved, f"scale_{k}") - octaves(steps, f"scale_{k}") for k in range(3)]
    assert np.ptp(scales) < 1e-9
    assert np.mean([octaves(moved, f"scale_{k}") for k in range(3)]) == pytest.approx(-1.0)
    np.testing.assert_array_equal(moved.coefficients["opacity"], steps.coefficients["opacity"])
    of_bands = octaves(moved, "colour").mean() + np.log2(moved.sh_ratios)
    as_before = octaves(steps, "colour").mean() + np.log2(steps.sh_ratios)
    np.testing.assert_allclose(of_bands, [as_before[0], -6.0, as_before[2]])
    assert as_deep(steps, some, known, {}).sh_ratios == pytest.approx(steps.sh_ratios)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
@pytest.mark.parametrize("group", ["geometry", *STREAMS])
def test_a_bit_more_halves_the_steps_of_one_group(scene, group, guided):
    guide = made_up_guide(seed=222) if guided else None
    depth = 12 if group == "geometry" else 6
    of = [
        finest_steps(encode_by(scene, Config("m", {group: bits}), guide))
        for bits in (depth, depth + 1)
    ]
    for name, step in of[0].items():
        halved = (2**depth - 1) / (2 ** (depth + 1) - 1) if name == group else 1
        assert of[1][name] == pytest.approx(step * halved, rel=0.02), name


def test_coarseness_does_not_change_requested_depths(scene):
    depths = {"rotation": 7, "sh-ac": 5}
    once, coarser = (
        finest_steps(encode_scene(scene, Config("m", depths, coarseness=factor))[0])
        for factor in (1.0, 4.0)
    )
    for name in once:
        factor = 1 if name in ("rotation", "sh1", "sh2", "sh3") else 4
        assert coarser[name] == pytest.approx(factor * once[name], rel=0.02), name


@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
def test_values_are_on_the_requested_lattices(scene, guided):
    guide = made_up_guide(seed=223) if guided else None
    depths = {"sh-ac": 5, "rotation": 6, "scaling": 9, "sh-dc": 4}
    data = encode_by(scene, Config("s", depths), guide)
    assert_on_lattices(Shaped.of(scene, "s", guide, depths), data, 0.5001 if guided else 1.5001)


def test_a_target_moves_only_the_others(scene):
    config = Config("m", {"rotation": 7})
    steps = finest_steps(encode_scene(scene, config)[0])
    for bits in (90, 220):
        data, _ = to_rate(scene, config, RateTarget(bits=bits))
        assert 0.98 * bits <= 8 * len(data) / scene.count <= bits
        found = finest_steps(data)
        assert found["rotation"] == steps["rotation"]
        assert found["scaling"] != pytest.approx(steps["scaling"], rel=0.1)


def test_an_empty_scene_may_have_depths():
    empty = random_scene(0, 3)
    assert arrange_scene(empty, Config("m", {"sh1": 4}), None).order.size == 0


def test_coarseness_scales_all_steps():
    plain, twice = Config("m").adaptive_profile(), Config("m", coarseness=2).adaptive_profile()
    assert twice.fineness == pytest.approx(2 * plain.fineness)
    assert twice.error == pytest.approx(4 * plain.error)
    assert twice.compaction == pytest.approx(4 * plain.compaction)


@pytest.mark.parametrize("value", [0.0, 1 / 65, 65.0, -1.0, float("nan")])
def test_coarseness_beyond_its_range_is_refused(value):
    with pytest.raises(InvalidInput, match="expected 1/64 to 64"):
        Config("m", coarseness=value)


@pytest.mark.parametrize("profile", ["paper-m", "lossless"])
def test_coarseness_is_for_profiles_of_steps(profile):
    with pytest.raises(InvalidInput, match="has none, l, m, s do"):
        Config(profile, coarseness=2.0)
    with pytest.raises(InvalidInput, match="expected l, m or s"):
        Config(profile).adaptive_profile()
