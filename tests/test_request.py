"""Requests reject options without effect, in every interface."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scenes import random_scene

import gs_codec
from gs_codec.batch.scene_tasks import Options
from gs_codec.config import Config, RateTarget
from gs_codec.edit.actions import Action
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.files.writing import write_scene
from gs_codec.plan import Plan, Steps

TARGET = RateTarget(ratio=9)
PRUNING = replace(TARGET, allow_prune=True)

#: Requests, and why they are rejected.
REFUSED = {
    "memory and views": (
        {"config": Config(), "plan": Plan(), "max_memory": 10**10},
        "max-memory: cannot be combined with views, preparation or a target",
    ),
    "memory and a target": (
        {"config": Config(), "rate": TARGET, "max_memory": 10**10}, "max-memory: cannot be combined"
    ),
    "memory and levels": (
        {"config": Config(lod=True), "max_memory": 10**10}, "lod: with max-memory, dask is needed"
    ),
    "memory and a format": (
        {"config": Config(format="rad"), "max_memory": 10**10}, "max-memory: format 'rad', expected"
    ),
    "memory and an action": (
        {"config": Config(), "actions": (Action("keep", "50%"),), "max_memory": 10**10},
        "needs the whole scene in memory",
    ),
    "a moved scene and its cameras": (
        {"config": Config(), "plan": Plan(cameras="c.json"), "actions": (Action("scale", "2"),)},
        "expected none or auto",
    ),
    "levels and a target": ({"config": Config(lod=True), "rate": TARGET}, "lod: cannot be"),
    "fixed steps and a target": (
        {"config": Config("paper-m"), "rate": TARGET}, "target: profile 'paper-m' has fixed steps"
    ),
    "refinement and pruning": (
        {"config": Config(), "plan": Plan(Steps(refine=9)), "rate": PRUNING},
        "allow_prune: not needed with refine",
    ),
    "a fixed size and pruning": (
        {"config": Config(format="splat"), "rate": PRUNING}, "sets the number of Gaussians"
    ),
    "workers and a target": (
        {"config": Config(), "rate": TARGET, "dask": "local"}, "dask: cannot be combined with views"
    ),
    "workers and a profile": ({"config": Config("lossless"), "dask": "local"}, "dask: profile"),
}  # fmt: skip


@pytest.mark.parametrize("kind", [Request, Options])
@pytest.mark.parametrize("name", REFUSED)
def test_a_request_without_effect_is_refused(name, kind):
    options, why = REFUSED[name]
    with pytest.raises(InvalidInput, match=why):
        kind(**options)


@pytest.mark.parametrize("name", ["levels and a target", "fixed steps and a target"])
def test_functions_refuse_it_before_they_read(name, tmp_path):
    options, why = REFUSED[name]
    missing = tmp_path / "missing.ply"
    with pytest.raises(InvalidInput, match=f"^{why}"):
        gs_codec.encode(missing, **options)
    with pytest.raises(InvalidInput, match=f"^{why}"):
        gs_codec.encode_file(missing, tmp_path / "a.egs", **options)


def test_workers_divide_a_scene_with_levels_below_a_limit():
    assert Request(Config(lod=True), max_memory=10**10, dask="local").config.lod


def test_after_actions_a_ratio_counts_from_the_floats(tmp_path):
    first, second = tmp_path / "a.spz", tmp_path / "b.spz"
    write_scene(first, random_scene(200, 1, seed=5), Config())
    report = gs_codec.encode_file(first, second, actions=[Action("sh-degree", "0")])
    assert (report.float_bytes, report.sh_degree) == (200 * 14 * 4, 0)
    assert report.ratio == report.float_bytes / report.file_bytes


def test_a_batch_that_converts_is_free_of_what_coding_refuses():
    moved = (Action("remove-floaters"), Action("scale", "2"))
    plan = Plan(cameras="cameras.json")
    assert Options(Config(), plan, actions=moved, plain="ply").format == "ply"
    with pytest.raises(InvalidInput, match="expected none or auto"):
        Options(Config(), plan, actions=moved)
