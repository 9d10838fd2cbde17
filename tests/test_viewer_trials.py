"""Trial encodings in the viewer: files, numbers, and stopping at any step."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cli.main import app
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from gs_codec.views.find import find_cameras
from samples.generate import generate
from viewer.scenes import trial_list
from viewer.scenes.edits import Edits
from viewer.scenes.opened import Opened, open_scene, turned
from viewer.scenes.pose import look_at
from viewer.scenes.trial_list import EncodingSettings, Trial, Trials


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A scene, and four cameras, two of them held out."""
    folder = tmp_path_factory.mktemp("tries")
    scene = generate(1500, 1, 31)
    write_ply(folder / "a.ply", scene)
    centre = np.median(scene.positions, axis=1).astype(np.float64)
    size = float(np.quantile(np.abs(scene.positions.T - centre), 0.8))
    places = ((0.3, -0.5, -1), (1, -0.5, 0), (-0.4, -0.6, -0.9), (-1, -0.4, 0.1))
    entries = [
        look_at(centre + 4 * size * np.array(place), centre).camera(60, 40)
        | {"img_name": f"view{k}", "split": "test" if k % 2 else "train"}
        for k, place in enumerate(places)
    ]
    (folder / "cameras.json").write_text(json.dumps(entries))
    return folder


@pytest.fixture
def trials(folder, tmp_path_factory) -> Trials:
    files = tmp_path_factory.mktemp("files")
    return Trials(open_scene(folder / "a.ply"), files, read_cameras(folder / "cameras.json"))


def command(*arguments: object) -> dict:
    """The JSON printed by a command."""
    result = CliRunner().invoke(app, [*map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def files(trials: Trials, *done: Trial) -> bool:
    """Whether the only files are those of these trials."""
    return {path.name for path in trials.folder.iterdir()} == {each.path.name for each in done}


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("settings", "options"),
    [
        (EncodingSettings(), ["-p", "m"]),
        (
            EncodingSettings("s", "steps", 1.5, True),
            ["-p", "s", "--coarseness", "1.5", "--cameras", "C"],
        ),
        (EncodingSettings("m", "size", 40_000.0), ["-p", "m", "--target-size", "40kB"]),
        (EncodingSettings("l", "bits", 200.0), ["-p", "l", "--target-bpg", "200"]),
        (
            EncodingSettings("m", "loss", 0.5),
            ["-p", "m", "--max-psnr-drop", "0.5", "--cameras", "C"],
        ),
        (EncodingSettings("paper-s"), ["-p", "paper-s"]),
        (EncodingSettings("lossless"), ["-p", "lossless"]),
    ],
    ids=str,
)
def test_a_trial_equals_the_file_of_the_command(trials, folder, tmp_path, settings, options):
    options = [str(folder / "cameras.json") if each == "C" else each for each in options]
    told = command("encode", folder / "a.ply", tmp_path / "b.egs", *options)
    tried, opened = trials.encode(settings)
    assert tried.path.read_bytes() == (tmp_path / "b.egs").read_bytes()
    assert (tried.report.file_bytes, tried.report.ratio) == (told["output_bytes"], told["ratio"])
    assert opened.name == tried.name
    assert files(trials, tried)


def test_numbers_equal_those_of_the_commands(trials, folder, tmp_path):
    tried, opened = trials.encode(EncodingSettings("s"))
    trials.save(tried, tmp_path / "b.egs")
    inspected = command("inspect", tmp_path / "b.egs")
    assert tried.report.file_bytes == opened.file_bytes == inspected["input_bytes"]
    assert tried.bits == pytest.approx(sum(s["bits_per_gaussian"] for s in inspected["streams"]))
    assert opened.info.as_dict()["streams"] == inspected["streams"]
    quality = trials.measure(tried, opened)
    cameras = folder / "cameras.json"
    compared = command("compare", folder / "a.ply", tmp_path / "b.egs", "--cameras", cameras)
    assert [view.name for view in quality.views] == ["view1", "view3"]
    for told, found in ((compared["mean"], quality.mean), (compared["worst"], quality.worst)):
        assert told["view"] == found.name
        assert told["between"] == found.between.as_dict()


@pytest.mark.usefixtures("few_cameras")
def test_without_cameras_views_are_estimated_once(folder, tmp_path, monkeypatch):
    settings: list[tuple] = []

    def two_of_them(*arguments, progress):
        settings.append(arguments)
        return find_cameras(*arguments, progress=progress)[:2]

    monkeypatch.setattr(trial_list, "find_cameras", two_of_them)
    trials = Trials(open_scene(folder / "a.ply"), tmp_path)
    told: list[str] = []
    for _ in range(2):
        quality = trials.measure(
            *trials.encode(EncodingSettings("s")), lambda stage, *_: told.append(stage)
        )
        assert [view.name for view in quality.views] == ["auto_00", "auto_01"]
    assert [(cameras, split) for cameras, _, split in settings] == [("auto", "held-out")]
    assert told[-2:] == ["views", "views"]
    assert told.count("cameras") > 2


def test_a_cloud_is_encoded_like_its_file(trials, folder, tmp_path):
    cloud = gs_codec.read(folder / "a.ply")
    of_cloud = Trials(Opened("cloud", cloud), tmp_path, trials.cameras)
    for settings in (
        EncodingSettings("m"),
        EncodingSettings("m", "bits", 150.0),
        EncodingSettings("s", "steps", 1.0, True),
    ):
        tried, opened = of_cloud.encode(settings)
        assert tried.path.read_bytes() == trials.encode(settings)[0].path.read_bytes()
        assert tried.report.ratio == opened.raw_bytes / opened.file_bytes


@pytest.mark.parametrize("change", ["edited", "turned"])
def test_an_edited_scene_is_encoded_as_edited(folder, tmp_path, change):
    edits = Edits(open_scene(folder / "a.ply"))
    if change == "edited":
        edits.keep(np.arange(1500) % 3 > 0, "test")
    scene = edits.scene if change == "edited" else turned(edits.whole)
    opened = Trials(scene, tmp_path).encode(EncodingSettings("lossless"))[1]
    places = [np.sort(each.positions.view("<i4"), axis=0) for each in (opened, scene)]
    np.testing.assert_array_equal(*places)


def test_trials_are_kept_in_order_and_can_be_opened_again(trials):
    for settings in (EncodingSettings("s"), EncodingSettings("m", "bits", 150.0)):
        trials.add(trials.encode(settings)[0])
    assert [tried.name for tried in trials.all] == ["#1 s", "#2 m 150 bits"]
    opened = trials.all[1].open()
    assert opened.name == "#2 m 150 bits"
    assert opened.info.profile == "m"
    assert len(opened.bits) == opened.count == 1500
    measured = replace(trials.all[0], quality=trials.measure(trials.all[0]))
    trials.add(measured)
    assert [tried.quality is None for tried in trials.all] == [False, True]


class Stopped(Exception):
    """Ends an encode, like `Cancelled` in the window."""


def stopped_at(number: int) -> Callable[[str, int, int], None]:
    """A progress callback that stops at its `number`-th call."""
    calls = iter(range(number))

    def progress(stage: str, done: int, total: int) -> None:
        if next(calls, None) is None:
            raise Stopped

    return progress


@pytest.mark.parametrize(
    "settings",
    [
        EncodingSettings("m"),
        EncodingSettings("paper-m"),
        EncodingSettings("lossless"),
        EncodingSettings("m", "size", 40_000.0),
    ],
    ids=str,
)
def test_encoding_stops_at_any_step_and_leaves_nothing(trials, settings):
    steps: list[str] = []
    trials.encode(settings, lambda stage, *_: steps.append(stage))[0].path.unlink()
    assert len(steps) >= 3
    for number in {0, 1, len(steps) // 2, len(steps) - 1}:
        with pytest.raises(Stopped):
            trials.encode(settings, stopped_at(number))
        assert files(trials)


def test_every_trial_of_a_search_reports_progress(trials):
    steps: list[tuple[str, int, int]] = []
    tried, _ = trials.encode(
        EncodingSettings("m", "size", 40_000.0), lambda *step: steps.append(step)
    )
    # Each encode codes the one block; and the result is decoded once.
    assert steps.count(("code", 1, 1)) == tried.report.rate.encodings > 1


def test_measuring_stops(trials):
    tried, opened = trials.encode(EncodingSettings("s"))
    with pytest.raises(Stopped):
        trials.measure(tried, opened, stopped_at(0))


def test_an_unreachable_target_reports_the_range(trials):
    with pytest.raises(
        gs_codec.InvalidInput,
        match=r"target 50 bytes: unreachable, expected [\d,]+ to [\d,]+ bytes",
    ):
        trials.encode(EncodingSettings("m", "size", 50.0))
    assert files(trials)


def test_a_changed_file_is_refused(tmp_path):
    write_ply(tmp_path / "a.ply", random_scene(300, 0))
    trials = Trials(open_scene(tmp_path / "a.ply"), tmp_path)
    write_ply(tmp_path / "a.ply", random_scene(200, 0))
    with pytest.raises(gs_codec.GsCodecError, match=r"a\.ply: changed after it was opened"):
        trials.encode(EncodingSettings("m"))
    assert files(trials)


def test_only_lossless_keeps_nonfinite_gaussians(tmp_path):
    scene = random_scene(300, 0)
    scene.positions[0, 7] = np.nan
    trials = Trials(Opened("cloud", to_cloud(scene)), tmp_path)
    counts = {
        profile: trials.encode(EncodingSettings(profile))[1].count for profile in ("m", "lossless")
    }
    assert counts == {"m": 299, "lossless": 300}


def test_only_egs_is_saved(trials, tmp_path):
    tried, _ = trials.encode(EncodingSettings("s"))
    with pytest.raises(gs_codec.GsCodecError, match=r"b\.ply: expected a name that ends in \.egs"):
        trials.save(tried, tmp_path / "b.ply")
    with pytest.raises(gs_codec.GsCodecError):
        trials.save(tried, tmp_path / "missing" / "b.egs")
    assert not list(tmp_path.iterdir())


def test_a_trial_is_not_saved_over_its_source(trials, tmp_path):
    tried, _ = trials.encode(EncodingSettings("s"))
    source = tmp_path / "a.egs"
    source.write_bytes(tried.path.read_bytes())
    again = Trials(open_scene(source), tmp_path)
    with pytest.raises(gs_codec.InvalidInput, match="input and output are the same file"):
        again.save(tried, source)


def test_other_cameras_discard_measurements(trials):
    tried, opened = trials.encode(EncodingSettings("s"))
    for cameras in (trials.cameras, trials.cameras[:2]):
        trials.add(replace(tried, quality=trials.measure(tried, opened)))
        trials.look_from(cameras)
    assert trials.all[0].quality is None
    assert [view.name for view in trials.measure(tried).views] == ["view1"]
