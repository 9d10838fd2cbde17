"""``bench --targets``: every target a line, beside the profiles' curve, and a plot."""

from __future__ import annotations

import json
import re

import pytest
from PIL import Image
from typer.testing import CliRunner

from gs_codec.bench import held_out, targets
from gs_codec.bench.curves import Curve
from gs_codec.cli.main import app
from gs_codec.config import Target
from gs_codec.errors import InvalidInput
from gs_codec.io.ply import write_ply
from samples.generate import generate


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> tuple[list[dict], str]:
    folder = tmp_path_factory.mktemp("targets")
    write_ply(folder / "scene.ply", generate(800, 1, 92))
    plot = folder / "targets.png"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(held_out, "_MEASURED", 3)
        patch.setattr(held_out, "_ENCODED_BY", 6)
        patch.setattr(targets, "RATIOS", (10.0, 6.0, 1000.0))
        patch.setattr(targets, "DROPS", (0.2,))
        patch.setattr(targets, "_PRUNED", (Target(ratio=14.0, allow_prune=True),))
        options = ["--targets", "--cameras", "auto", "--width", "36", "--plot", str(plot)]
        result = CliRunner().invoke(app, ["bench", str(folder / "scene.ply"), *options])
    assert result.exit_code == 0, result.output
    with Image.open(plot) as image:
        assert image.width > 300
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    return [line for line in lines if line["kind"] != "machine"], result.stderr


def test_profiles_come_first_and_then_targets(measured):
    lines, table = measured
    found = [(line["kind"], line["curve"]) for line in lines]
    assert found == [
        *[("profile", "by attributes")] * 3,
        *[("target", "by attributes")] * 2,
        ("refused", "by attributes"),
        *[("profile", "by views")] * 3,
        *[("target", "by views")] * 2,
        ("refused", "by views"),
        ("target", "by views"),
        ("target", "by views, pruned"),
    ]
    assert len(table.splitlines()) >= 1 + len(lines)
    assert "are in reach" in next(line for line in lines if line["kind"] == "refused")["message"]
    assert re.search(r"by views +ratio 1000 +refused", table)


def test_targets_are_met(measured):
    for line in measured[0]:
        if line["kind"] == "target" and line["limit_bytes"] is not None:
            assert 0.98 * line["limit_bytes"] <= line["file_bytes"] <= line["limit_bytes"]
        elif line["kind"] == "target":
            assert 0.1 <= line["psnr_drop"] <= 0.2  # so small a scene has jumps


def test_profiles_bits_are_those_of_their_curve(measured):
    lines, _ = measured
    for line in lines:
        if line["kind"] == "target":
            of_curve = line["curve"].removesuffix(", pruned")
            curve = Curve.through(
                (other["mean"]["psnr"], other["bits_per_gaussian"])
                for other in lines
                if (other["kind"], other["curve"]) == ("profile", of_curve)
            )
            expected = curve.bits_at(line["mean"]["psnr"])
            assert line["profiles_bits_per_gaussian"] == expected


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--targets needs --cameras"),
        (["--cameras", "auto", "-p", "m"], "--profile has no effect beside --targets"),
    ],
)
def test_targets_need_cameras_and_choose_profiles(options, message):
    result = CliRunner().invoke(app, ["bench", "scene.ply", "--targets", *options])
    assert isinstance(result.exception, InvalidInput)
    assert message in str(result.exception)
