"""The measured loss of an encode, and the reaction to it."""

from __future__ import annotations

import json
import logging
from dataclasses import replace

import numpy as np
import pytest
from requested import as_requested
from scenes import edge_scenes, made_up_guide, random_scene, with_far, with_threads
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.cli.main import app
from gs_codec.cli.output import print_rendered
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import encode_cleaned
from gs_codec.config import Config
from gs_codec.edit.actions import Action
from gs_codec.encoding import order as planned
from gs_codec.encoding import retry as checked
from gs_codec.encoding.loss import Check, _Seen, error_of
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.formats.ply.writer import write_ply
from gs_codec.guidance.calibrate import finer, wanted_error
from gs_codec.guidance.windows import choose_windows, sample_of, windows_of
from gs_codec.plan import Plan, Steps
from gs_codec.rendering.renderer import render
from gs_codec.report import RenderedLoss, StageTimes, psnr_loss
from gs_codec.scene import GROUPS
from samples.captures.capture import capture
from samples.generate import generate, orbit_cameras


@pytest.fixture(scope="module")
def still_life():
    return generate(6000, 1, 1)


@pytest.fixture(scope="module")
def cameras():
    return [
        replace(as_camera(camera), split="test" if i % 4 == 1 else "train")
        for i, camera in enumerate(orbit_cameras(16, 90, 60))
    ]


def check_of(scene):
    return Check.of(scene, choose_windows(sample_of(scene), scene.count).checking)


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("guided", [False, True], ids=["free", "guided"])
@pytest.mark.parametrize("far", [0, 7])
def test_watched_values_are_those_that_a_decoder_returns(degree, guided, far):
    scene = with_far(random_scene(3000, degree, seed=5), far)
    config = Config("m", block_size=1024)
    index = np.flatnonzero(np.random.default_rng(6).random(3000) < 0.2)
    index = np.union1d(index, np.arange(2990, 3000))  # including far Gaussians
    if not degree:
        index = index[-3:]  # none in other blocks
    watched = Watched(scene, index)
    steps = made_up_guide(seed=7)(scene, config) if guided else None
    parts, _ = encode_cleaned(scene, config, StageTimes(), steps=steps, watched=watched)
    decoded, found = decode_as(config, b"".join(parts)), watched.decoded()
    names = [f"{group} {row}" for group in GROUPS for row in range(len(getattr(found, group)))]
    rows = [[*np.concatenate([getattr(s, g) for g in GROUPS]).T.tolist()] for s in (found, decoded)]
    assert len(rows[0]) == len(index)
    assert len(rows[0][0]) == len(names)
    assert set(map(tuple, rows[0])) <= set(map(tuple, rows[1]))
    # In stream order, next to their previous positions.
    assert np.array_equal(np.sort(watched.index), index)
    assert np.array_equal(watched.find(watched.index[1:3]), np.arange(1, 3))
    index = watched.index
    near = np.abs(found.positions - scene.positions[:, index]).max(axis=0)
    assert np.median(near) < 0.01 * np.ptp(random_scene(3000, degree, seed=5).positions)
    if far:
        np.testing.assert_array_equal(
            found.positions, np.where(near == 0, scene.positions[:, index], found.positions)
        )


def true_loss(scene, coded, views):
    images = [
        [render(each, view, device="cpu").colour for each in (scene, coded)] for view in views
    ]
    return psnr_loss(float(np.mean([np.mean((a - b) ** 2) for a, b in images])))


def test_measured_loss_equals_that_of_true_views(still_life, cameras):
    data, report = as_requested(still_life, Config("s"))
    loss = report.rendered
    assert loss.views == "likely"
    assert loss.away is None
    assert loss.encodings == 1
    assert loss.aimed == pytest.approx(psnr_loss(wanted_error(Config("s"))))
    true = true_loss(still_life, decode_as(Config(), data), cameras)
    assert true / 1.6 < loss.loss < 1.6 * true
    assert loss.loss <= loss.worst
    assert loss.psnr == pytest.approx(-10 * np.log10(error_of(loss.loss)))


def test_both_measurements_agree(still_life):
    check, config = check_of(still_life), Config("m")
    watched = check.watch()
    parts, _ = encode_cleaned(still_life, config, StageTimes(), watched=watched)
    kept, decoded = (
        check.measure_watched(watched),
        check.measure(decode_as(config, b"".join(parts))),
    )
    # A few other Gaussians reach into a window after rounding.
    assert kept.loss == pytest.approx(decoded.loss, rel=0.05)
    assert kept.windows == decoded.windows


def test_checking_windows_are_from_other_positions(still_life):
    windows = choose_windows(sample_of(still_life), still_life.count)
    assert len(windows.choosing) == 96
    assert len(windows.checking) == 64
    places = [{tuple(view.position.tolist()) for view in each} for each in windows[:2]]
    assert not places[0] & places[1]


def test_windows_of_given_cameras_are_parts_of_their_views(cameras):
    windows = windows_of(cameras[:1])
    corners = np.array([[45 - window.cx, 30 - window.cy] for window in windows])
    assert {(w.width, w.height, w.fx) for w in windows} == {(32, 32, cameras[0].fx)}
    assert corners.min(axis=0).tolist() == [0, 0]
    assert corners.max(axis=0).tolist() == [58, 28]


def test_too_coarse_steps_are_made_finer(still_life, monkeypatch, caplog, capsys):
    monkeypatch.setattr(
        "gs_codec.guidance.calibrate.calibrated", lambda _, c, *__: replace(c, coarseness=9.0)
    )
    _, report = as_requested(still_life, Config())
    loss = report.rendered
    assert loss.encodings > 1
    assert report.coarseness < 4
    assert loss.remedy == f"{report.coarseness:.2f}x those of the profile"
    print_rendered(loss)
    assert f"step sizes {loss.remedy}, finer than at first" in capsys.readouterr().out
    assert loss.loss <= 2 * loss.aimed
    assert not caplog.records


@pytest.mark.parametrize(
    ("known", "encodings"),
    [({}, 1), ({"format": "sog"}, 2), ({"format": "spz"}, 2), ({"format": "compressed.ply"}, 1)],
    ids=["egs", "sog", "spz", "compressed.ply"],
)
def test_other_formats_come_closer_to_the_aim(known, encodings):
    config = Config(**known)

    def attempt(chosen):
        loss = psnr_loss(1.6 * wanted_error(chosen))
        return chosen, RenderedLoss(50.0, loss, loss, windows=64, views="likely")

    chosen, loss = checked.encode_within_loss(attempt, config, config, check=Check(None, None))
    assert loss.encodings == encodings
    if encodings > 1:
        assert chosen.coarseness < config.coarseness
        assert loss.loss == pytest.approx(loss.aimed, rel=0.05)


@pytest.mark.parametrize(
    ("first", "share", "power", "found"),
    [(0.5, 0.6, 1.76, 0.5), (0.5, 0.4, 1.76, 0.84), (0.5, 0.4, 3.6, 0.5), (1.0, 0.4, 1.76, 1.0)],
    ids=["near the aim", "below half of it", "coarser ones lose too much", "not calibrated"],
)
def test_needlessly_fine_steps_are_made_coarser(first, share, power, found):
    config = Config()

    def attempt(chosen):
        loss = psnr_loss(share * wanted_error(config) * (chosen.coarseness / first) ** power)
        return chosen, RenderedLoss(50.0, loss, loss, windows=64, views="likely")

    calibrated = Config(coarseness=first)
    chosen, loss = checked.encode_within_loss(attempt, config, calibrated, check=Check(None, None))
    assert chosen.coarseness == pytest.approx(found, rel=0.01)
    assert loss.remedy is None


@pytest.mark.parametrize(
    ("power", "found"), [(0.55, 1.0), (1.2, 0.063)], ids=["hardly helps", "helps"]
)
def test_finer_steps_must_come_halfway_to_the_aim(power, found):
    config = Config()

    def attempt(chosen):
        loss = psnr_loss(40 * wanted_error(config) * chosen.coarseness**power)
        return chosen, RenderedLoss(40.0, loss, loss, windows=64, views="likely")

    chosen, loss = checked.encode_within_loss(attempt, config, config, check=Check(None, None))
    assert chosen.coarseness == pytest.approx(found, rel=0.05)
    assert (loss.remedy is None) == (found == 1)


def test_what_pruning_lost_does_not_count():
    before = 20 * wanted_error(Config())

    def attempt(chosen):
        loss = psnr_loss(before + wanted_error(Config()))
        return chosen, RenderedLoss(40.0, loss, loss, windows=64, views="given")

    strict, pruned = Config(strict=True), Check(None, None, before=before)
    chosen, loss = checked.encode_within_loss(attempt, strict, strict, pruned)
    assert (chosen, loss.encodings) == (strict, 1)
    with pytest.raises(InvalidInput, match="views lose"):
        checked.encode_within_loss(attempt, strict, strict, Check(None, None))


def test_views_of_few_pixels_are_measured_in_smaller_windows(still_life, cameras, monkeypatch):
    sides = {}
    for most in (5000, 600):
        for module in ("gs_codec.guidance.windows", "gs_codec.encoding.loss"):
            monkeypatch.setattr(f"{module}.MOST_SHOWN", most)
        given = Check.by_plan(still_life, Plan(cameras=cameras)).given
        assert max(map(len, given.shown)) <= most
        sides[most] = {window.width for window in given.windows}
    assert sides == {5000: {32}, 600: {16}}


def test_useless_finer_steps_are_reported(still_life, monkeypatch, caplog):
    def clipped(scene, config, times, *_, **__):
        """Like a format that cannot represent such colours."""
        return encode_cleaned(replace(scene, f_dc=np.minimum(scene.f_dc, 0)), config, times)

    monkeypatch.setattr(planned, "encode_cleaned", clipped)
    monkeypatch.setattr(checked.Check, "watch", lambda _: None)
    _, report = as_requested(still_life, Config())
    assert report.rendered.loss > 2 * report.rendered.aimed
    assert report.rendered.remedy is None
    [record] = caplog.records
    assert record.getMessage() == (
        f"rendered views lose {report.rendered.loss:.2f} dB (aim: 0.05 dB)"
    )
    with pytest.raises(InvalidInput, match="rendered views lose"):
        as_requested(still_life, Config(strict=True))


def test_given_cameras_measure_in_held_out_views(still_life, cameras):
    data, report = as_requested(still_life, Config("s"), Plan(cameras=cameras))
    loss = report.rendered
    held_out = [camera for camera in cameras if camera.split == "test"]
    true = true_loss(still_life, decode_as(Config(), data), held_out)
    assert loss.views == "given"
    assert true / 1.5 < loss.loss < 1.5 * true
    assert 0 < loss.away < 4


def test_the_limits_of_a_format_are_not_blamed_on_cameras(still_life, cameras, caplog):
    """In small units, an `.spz` clips scales, whatever the cameras."""
    large = replace(
        still_life,
        positions=np.float32(1e5) * still_life.positions,
        log_scale=still_life.log_scale + np.float32(np.log(1e5)),
    )
    views = [replace(camera, position=1e5 * camera.position) for camera in cameras]
    as_requested(large, Config(format="spz"), Plan(cameras=views))
    assert "because of the limits of .spz" in caplog.text
    assert "do not fit" not in caplog.text
    flipped = [replace(c, rotation=np.diag([1.0, -1, -1]) @ c.rotation) for c in cameras]
    as_requested(still_life, Config(format="spz"), Plan(cameras=flipped))
    assert "cameras do not fit the scene" in caplog.text


def test_cameras_of_another_scene_do_not_guide(still_life, cameras, caplog):
    flipped = [replace(c, rotation=np.diag([1.0, -1, -1]) @ c.rotation) for c in cameras]
    data, report = as_requested(still_life, Config(), Plan(cameras=flipped))
    assert data == as_requested(still_life, Config())[0]
    assert report.rendered.views == "likely"
    [record] = [r for r in caplog.records if r.levelno == logging.WARNING]
    assert "cameras do not fit the scene: guided by them, views lose" in record.getMessage()
    with pytest.raises(InvalidInput, match="cameras do not fit the scene"):
        as_requested(still_life, Config(strict=True), Plan(cameras=flipped))


@pytest.mark.parametrize(("empty", "fits"), [(0.0, True), (0.1, True), (0.15, False)])
def test_cameras_that_see_nothing_in_some_views_may_cause_smaller_errors(still_life, empty, fits):
    left = [1.0] * round(100 * empty) + [0.0] * round(100 * (1 - empty))
    check = Check(still_life, None, _Seen([], [], [], left, []))
    loss = RenderedLoss(45.0, 0.05, 0.1, 128, "given", away=psnr_loss(100 * 1.16e-5))
    assert checked._misfits(check, loss, 1.16e-5, Config()) != fits


def _warnings(caplog):
    found = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    caplog.clear()
    return found


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("prune", "target"),
    [
        (0, {"bits": 25}),
        (0, {"bits": 40, "allow_prune": True}),
        (0, {"psnr_drop": 0.1}),
        (50, None),
    ],
    ids=str,
)
def test_cameras_of_another_scene_are_reported(still_life, cameras, prune, target, caplog):
    strict = Config(strict=target is None)
    steps = Steps(prune=prune)
    as_requested(still_life, strict, Plan(steps, cameras), target)
    assert not _warnings(caplog)
    flipped = [replace(c, rotation=np.diag([1.0, -1, -1]) @ c.rotation) for c in cameras]
    as_requested(still_life, Config(), Plan(steps, flipped), target)
    assert "cameras do not fit the scene: away from them, views lose" in _warnings(caplog)[-1]


def test_actions_by_cameras_of_another_scene_are_reported(still_life, cameras, tmp_path, caplog):
    write_ply(tmp_path / "a.ply", still_life)
    flipped = [replace(c, rotation=np.diag([1.0, -1, -1]) @ c.rotation) for c in cameras]
    for given, fits in ((cameras, True), (flipped, False)):
        target, keep = tmp_path / f"{fits}.ply", [Action("keep", "30%")]
        convert_file(tmp_path / "a.ply", target, actions=keep, plan=Plan(cameras=given))
        said = "cameras do not fit the scene: away from them"
        assert fits != any(said in text for text in _warnings(caplog))


def test_prepared_scenes_are_compared_with_the_scene_before(still_life, cameras):
    plan = Plan(Steps(prune=40), cameras)
    _, report = as_requested(still_life, Config("l"), plan)
    _, whole = as_requested(still_life, Config("l"), Plan(cameras=cameras))
    assert report.rendered.loss > 2 * whole.rendered.loss
    assert report.rendered.aimed is None


def test_a_requested_loss_is_the_target(still_life, cameras):
    target = {"psnr_drop": 0.2}
    _, report = as_requested(still_life, Config(), Plan(cameras=cameras), target)
    assert report.rendered.aimed == 0.2
    assert report.rendered.loss < 0.4
    _, report = as_requested(still_life, Config(), None, {"bits": 60})
    assert report.rendered.aimed is None
    assert report.rendered.loss > 0.05


@pytest.mark.parametrize("config", [Config("lossless"), Config("paper-m"), Config(format="splat")])
def test_strict_needs_a_target_loss(config):
    with pytest.raises(InvalidInput, match="strict: profile"):
        replace(config, strict=True)


@pytest.mark.parametrize("name", edge_scenes())
def test_scenes_at_the_limits(name):
    scene = edge_scenes()[name]
    _, report = as_requested(scene, Config(nonfinite="drop"))
    assert report.rendered is None or np.isfinite(report.rendered.loss)


def test_invisible_scenes_are_not_measured(still_life):
    clear = replace(still_life, opacity=np.full_like(still_life.opacity, -20))
    assert as_requested(clear, Config())[1].rendered is None


def test_threads_do_not_matter(still_life):
    found = [with_threads(n, as_requested, still_life, Config())[1].rendered for n in (1, 3)]
    assert found[0] == found[1]


def test_finer_steps_stay_in_range():
    assert finer(Config(coarseness=1 / 64), 0.1).coarseness == 1 / 64
    assert finer(Config(), 2.0**-1.76).coarseness == pytest.approx(0.5)


@pytest.mark.parametrize("suffix", ["egs", "spz", "sog", "compressed.ply", "splat", "glb"])
def test_every_format_reports_the_loss_of_views(suffix, tmp_path, still_life):
    write_ply(tmp_path / "scene.ply", still_life)
    report = gs_codec.encode_file(tmp_path / "scene.ply", tmp_path / f"out.{suffix}")
    done = gs_codec.convert_file(tmp_path / "scene.ply", tmp_path / f"again.{suffix}")
    assert report.rendered.loss == done.rendered.loss
    assert (report.rendered.aimed is None) == (suffix not in ("egs", "spz", "sog"))
    assert gs_codec.convert_file(tmp_path / "scene.ply", tmp_path / "again.ply").rendered is None


def test_commands_report_the_loss(tmp_path, still_life):
    write_ply(tmp_path / "scene.ply", still_life)
    run = CliRunner().invoke
    line = (
        r"rendered views: \d\d\.\d dB against the original, a loss of about 0\.\d\d dB at 30 dB; "
    )
    encoded = run(app, ["encode", str(tmp_path / "scene.ply"), str(tmp_path / "a.egs")])
    assert encoded.exit_code == 0, encoded.output
    assert __import__("re").search(line, encoded.output)
    converted = run(
        app, ["convert", str(tmp_path / "scene.ply"), str(tmp_path / "a.spz"), "--json"]
    )
    assert json.loads(converted.stdout)["rendered"]["aimed"] == pytest.approx(0.0501, abs=1e-4)
    batch = run(app, ["batch", str(tmp_path / "scene.ply"), str(tmp_path / "out")])
    assert batch.exit_code == 0, batch.output
    [record] = map(json.loads, (tmp_path / "out" / "report.jsonl").read_text().splitlines())
    assert record["rendered"]["windows"] > 15


@pytest.fixture(scope="module")
def captured():
    return capture("arc", 3000, 5, 60, width=60)


def test_views_away_from_given_cameras_are_measured_too(captured):
    _, report = as_requested(captured.scene, Config(), Plan(cameras=captured.cameras))
    assert report.rendered.views == "given"
    assert 0 < report.rendered.away < 2.5


def test_cameras_of_another_scale_do_not_guide(captured, caplog):
    scaled = [replace(c, position=3 * c.position) for c in captured.cameras]
    _, report = as_requested(captured.scene, Config(), Plan(cameras=scaled))
    assert report.rendered.views == "likely"
    assert "cameras do not fit the scene: guided by them, views lose" in caplog.text


def test_cameras_that_see_nothing_do_not_guide(captured, caplog):
    away = [replace(c, position=c.position - 1e3 * c.rotation[2]) for c in captured.cameras]
    back = [replace(c, rotation=np.diag([1.0, -1, -1]) @ c.rotation) for c in away]
    _, report = as_requested(captured.scene, Config(), Plan(cameras=back))
    assert report.rendered.views == "likely"
    assert "they see 0% of the Gaussians; encoded without them" in caplog.text
