"""With a refinement that does not pay, files are those without refinement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from orbits import cameras
from scenes import thorough

from gs_codec.config import Config, RateTarget
from gs_codec.encoding import unrefined
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.plan import Plan, Steps
from gs_codec.preparation import optimise
from gs_codec.preparation.balance import Balance
from gs_codec.preparation.pipeline import prepare_scene
from gs_codec.scene import Scene
from samples.generate import generate

pytestmark = pytest.mark.slow

REFINED = Steps(refine=4)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate(600, 1, 5)


@pytest.fixture(scope="module")
def plan() -> Plan:
    marked = [replace(c, split="train" if i % 4 else "test") for i, c in enumerate(cameras(8))]
    return Plan(Steps(), marked, views=6)


def coded(scene: Scene, plan: Plan, rate: RateTarget | None) -> tuple[bytes, dict | None]:
    parts, report = encode(scene, Request(Config("m", effort="fast"), plan, rate), None, 10**5)
    return b"".join(parts), report.prepared


@pytest.mark.parametrize("rate", [None, thorough(RateTarget(psnr_drop=0.3))])
def test_after_a_rejected_refinement_files_are_those_without_it(scene, plan, rate, monkeypatch):
    monkeypatch.setattr(optimise, "_SHARE", 1e9)
    data, report = coded(scene, replace(plan, steps=REFINED), rate)
    assert data == coded(scene, plan, rate)[0]
    assert report["gaussians"] == scene.count
    assert report["steps"][1]["details"]["left_out"]


def test_a_rejected_refinement_leaves_what_else_was_asked_for(scene, plan, monkeypatch):
    monkeypatch.setattr(optimise, "_SHARE", 1e9)
    others = Steps(prune=30)
    expected, _ = prepare_scene(scene, replace(plan, steps=others))
    found, report = prepare_scene(scene, replace(plan, steps=replace(others, refine=4)))
    np.testing.assert_array_equal(found.positions, expected.positions)
    assert report.rejected is report.steps[-1]
    assert report.rejected.count == report.removed["leave-one-out"] * 7 // 3


def test_at_a_size_the_better_file_is_kept(scene, plan, monkeypatch, caplog):
    rate = RateTarget(ratio=25)
    expected, _ = coded(scene, plan, rate)
    monkeypatch.setattr(Balance, "pays", lambda self, pruned: pruned.count > 60)
    data, _ = coded(scene, replace(plan, steps=REFINED), rate)
    assert data == expected
    assert "refine: skipped, because held-out views lose" in caplog.text
    monkeypatch.setattr(unrefined, "_CLEAR", 1e9)
    data, report = coded(scene, replace(plan, steps=REFINED), rate)
    assert report["gaussians"] < 100


@pytest.mark.thorough
def test_a_loss_that_refinement_cannot_reach_is_reached_without_it(
    scene, plan, monkeypatch, caplog
):
    rate = RateTarget(psnr_drop=0.05)
    monkeypatch.setattr(Balance, "pays", lambda self, pruned: pruned.count > 60)
    data, _ = coded(scene, replace(plan, steps=REFINED), rate)
    assert data == coded(scene, plan, rate)[0]
    assert "refine: skipped; with it, target 0.05 dB: unreachable" in caplog.text
