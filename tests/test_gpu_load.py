"""Splats over a pixel, and the devices that can draw a scene: `gs-codec inspect --gpu`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from command_line import strict_json
from orbits import orbit
from scenes import random_scene, with_threads

from gs_codec.analysis.gpu_load import DEVICES, gpu_load
from gs_codec.files.scenes import read_scene
from gs_codec.rendering.overdraw import count_splats
from gs_codec.rendering.renderer import render


def test_splats_are_those_that_are_drawn_alone():
    """Even where opaque ones hide them."""
    scene, camera = random_scene(90, 0, seed=3), orbit(1, side=50)[0]
    scene = replace(scene, opacity=np.full_like(scene.opacity, 9.0))
    alone = [render(scene.take(np.array([i])), camera).alpha > 0 for i in range(scene.count)]
    counts = count_splats(scene, camera)
    np.testing.assert_array_equal(counts, np.sum(alone, axis=0))
    assert counts.max() > 5


def test_threads_change_nothing():
    scene, camera = random_scene(300, 0, seed=4), orbit(1, side=70)[0]
    one, two = (with_threads(n, lambda: count_splats(scene, camera)) for n in (1, 2))
    np.testing.assert_array_equal(one, two)


def test_a_device_copes_while_nothing_is_too_much():
    dense = np.repeat(np.arange(200), 60)
    scene, views = random_scene(200, 3, seed=5).take(dense), orbit(30, side=32)
    load = gpu_load(scene, views)
    assert load.views == 24
    assert load.densest >= load.mean > 0
    assert load.percentile_95 > load.mean
    # Three texels of 16 bytes, two of projections, six of SH-AC, and the order.
    assert load.page_bytes == 12_000 * (11 * 16 + 4)
    assert [verdict.device for verdict in load.verdicts] == list(DEVICES)
    for verdict in load.verdicts:
        device = verdict.device
        assert verdict.fragments == load.densest * device.pixels * device.pictures
        assert verdict.copes == (verdict.fragments <= device.fragments)
    assert {verdict.copes for verdict in load.verdicts} == {True, False}


def test_inspect_tells_the_load(folder):
    for file in ("scene.ply", "scene.egs"):
        told = strict_json(
            folder.run("inspect", file, "--gpu", "--cameras", "cameras.json", "--json").out
        )
        load = gpu_load(read_scene(file), orbit(1))
        assert told["gpu"]["page_bytes"] == load.page_bytes
        out = folder.run("inspect", file, "--gpu", "--cameras", "cameras.json").out
        assert "splats per pixel: " in out
        assert " in 1 view; " in out
        rows = [line.split() for line in out.splitlines()[-3:]]
        assert [row[0] for row in rows] == [device.name for device in DEVICES]
        assert {row[1] for row in rows} <= {"yes", "no"}
    assert "--cameras needs --gpu" in folder.refuse("inspect", "scene.ply", "--cameras", "auto")
