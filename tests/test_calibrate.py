"""Camera-free calibration: the same loss in views of any scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from requested import as_requested
from scenes import edge_scenes, random_scene, shared_scene_path, with_threads

from gs_codec.cameras.inria import as_camera
from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import encode_scene
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.guidance.calibrate import calibrated
from gs_codec.rendering.renderer import render
from gs_codec.views.find import find_cameras
from samples.captures.capture import capture
from samples.generate import generate, orbit_cameras

#: PSNR of a scene against itself, in dB, at which a 30 dB scene loses 0.026 to 0.078 dB; the target
#: is 0.05.
LEAST, MOST = 47.4, 52.2


def own_psnr(scene, cameras, config):
    """PSNR of the decoded scene's views against the original's, from the mean error."""
    decoded = decode_as(config, as_requested(scene, config)[0])
    pairs = [[render(s, view, device="cpu").colour for s in (scene, decoded)] for view in cameras]
    return -10 * np.log10(np.mean([np.mean((a - b) ** 2, dtype=np.float64) for a, b in pairs]))


@pytest.fixture(scope="module")
def still_life():
    return generate(12_000, 3, 1)


@pytest.fixture(scope="module")
def views():
    return [as_camera(camera) for camera in orbit_cameras(24, 200, 133)[::3]]


@pytest.mark.one_in(2)
@pytest.mark.parametrize("contrast", [0.2, 1.0])
def test_profile_m_loses_the_same_at_any_contrast(still_life, views, contrast):
    """Only calibration sets colour steps; otherwise those of faint colours would be too fine."""
    scene = replace(
        still_life,
        f_dc=np.float32(contrast) * still_life.f_dc,
        f_rest=np.float32(contrast) * still_life.f_rest,
    )
    assert LEAST < own_psnr(scene, views, Config("m")) < MOST


def test_profile_m_loses_the_same_without_sh(views):
    """Without SH-AC, cameras cannot be estimated."""
    assert LEAST < own_psnr(generate(12_000, 0, 1), views, Config("m")) < MOST


def test_thin_objects_lose_the_same_where_they_are(still_life, views):
    """Wires cover little of any crop."""
    rng, count = np.random.default_rng(0), still_life.count
    ends = rng.uniform(-1, 1, (40, 2, 3))[rng.integers(40, size=count)]
    share = rng.random((count, 1))
    wires = replace(
        still_life,
        positions=np.float32(ends[:, 0] * (1 - share) + ends[:, 1] * share).T,
        log_scale=np.full((3, count), np.log(0.006), np.float32),
        opacity=np.full((1, count), 3.0, np.float32),
    )
    covered = np.mean([render(wires, view, device="cpu").alpha.mean() for view in views])
    assert covered < 0.5
    assert 45 < own_psnr(wires, views, Config("m")) + 10 * np.log10(covered) < MOST
    _, report = as_requested(wires, Config("m"))
    assert 0.02 < report.rendered.loss < 0.1


@pytest.mark.thorough
def test_profile_m_loses_the_same_in_a_small_capture():
    made = capture("forward", 6000, seed=3, iterations=40, width=120)
    cameras = [camera for camera in made.cameras if camera.split == "test"]
    assert LEAST < own_psnr(made.scene, cameras, Config("m")) < MOST


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "format"), [("bonsai", "egs"), ("mouse", "egs"), ("mouse", "spz")]
)
def test_profile_m_loses_the_same_in_real_scenes(name, format):  # noqa: A002
    scene = read_ply(shared_scene_path(f"{name}/point_cloud.ply"))
    cameras = find_cameras(shared_scene_path(f"{name}/cameras.json"), scene, "test", 200, None)
    assert LEAST < own_psnr(scene, cameras[::4], Config("m", format=format)) < MOST


@pytest.mark.thorough
def test_profiles_change_by_the_same_factor_and_coarseness_multiplies_it(still_life):
    found = calibrated(still_life, Config("m")).coarseness
    assert found != 1
    assert calibrated(still_life, Config("s")).coarseness == found
    assert calibrated(still_life, Config("m", coarseness=1.5)).coarseness == 1.5 * found
    assert calibrated(still_life, Config("m", coarseness=1 / 64)).coarseness == 1 / 64


@pytest.mark.thorough
def test_files_have_the_reported_coarseness(still_life):
    data, report = as_requested(still_life, Config("l"))
    assert report.coarseness == calibrated(still_life, Config("l")).coarseness
    told = Config("l", coarseness=report.coarseness)
    assert data == encode_scene(still_life, told)[0]
    assert as_requested(still_life, Config("l"))[0] == data
    assert "calibrate" in report.seconds


@pytest.mark.thorough
def test_threads_and_other_columns_do_not_matter(still_life):
    found = calibrated(still_life, Config())
    assert with_threads(1, calibrated, still_life, Config()) == found
    assert with_threads(3, calibrated, still_life, Config()) == found
    extra = {"label": np.full(still_life.count, np.nan, np.float32)}
    assert calibrated(replace(still_life, extra=extra), Config()) == found


@pytest.mark.parametrize("format", ["spz", "sog"])
def test_the_rounding_of_other_formats_is_known_before_encoding(format):  # noqa: A002
    loss = as_requested(generate(12_000, 3, 2), Config(format=format))[1].rendered
    assert loss.encodings == 1
    assert 0.6 * loss.aimed < loss.loss < 1.25 * loss.aimed


def test_steps_do_not_change_for_what_a_format_clips(still_life):
    """An `.spz` has no log-scales below -10."""
    small = np.float32(np.exp(-7))
    tiny = replace(
        still_life, positions=small * still_life.positions, log_scale=still_life.log_scale - 7
    )
    found = calibrated(tiny, Config()).coarseness
    assert calibrated(tiny, Config(format="spz")).coarseness > 0.7 * found


@pytest.mark.parametrize(
    "config",
    [
        Config("lossless"),
        Config("paper-m"),
        Config(format="compressed.ply"),
        Config(format="splat"),
        Config(format="glb"),
    ],
    ids=lambda config: f"{config.format} {config.profile}",
)
def test_profiles_without_step_sizes_are_not_calibrated(still_life, config):
    assert "calibrate" not in as_requested(still_life, config)[1].seconds


def test_scenes_with_few_gaussians_are_not_calibrated():
    few = random_scene(4999)
    assert calibrated(few, Config()) == Config()


@pytest.mark.thorough
@pytest.mark.parametrize("name", edge_scenes())
def test_scenes_at_the_limits(name):
    """Nothing is logged, and the coarseness stays within two octaves."""
    scene = edge_scenes()[name]
    many = scene.take(np.arange(6000) % max(scene.count, 1)) if scene.count else scene
    assert 0.25 <= calibrated(many, Config()).coarseness <= 4


@pytest.mark.thorough
@pytest.mark.parametrize("factor", [1e-38, 1e30])
@pytest.mark.parametrize("group", ["positions", "f_dc", "log_scale", "rot"])
def test_extreme_numbers(still_life, group, factor):
    planes = (getattr(still_life, group) * np.float32(factor)).astype(np.float32)
    extreme = replace(still_life, **{group: planes}).between(0, 6000)
    assert 0.25 <= calibrated(extreme, Config()).coarseness <= 4


def test_invisible_scenes_are_not_calibrated(still_life):
    clear = replace(still_life, opacity=np.full_like(still_life.opacity, -20))
    assert calibrated(clear, Config()) == Config()
    # Every window would show all Gaussians.
    fog = replace(still_life, log_scale=np.full_like(still_life.log_scale, 5))
    assert calibrated(fog, Config()) == Config()


@pytest.mark.thorough
def test_nonfinite_values_are_refused_or_dropped(still_life):
    broken = replace(still_life, f_rest=still_life.f_rest.copy(), opacity=still_life.opacity.copy())
    broken.f_rest[4, ::7] = np.nan
    broken.opacity[0, 1::7] = np.nan
    with pytest.raises(InvalidInput, match="not finite"):
        as_requested(broken, Config())
    _, report = as_requested(broken, Config(nonfinite="drop"))
    assert report.dropped == np.count_nonzero(np.arange(12_000) % 7 < 2)
    assert 0.25 <= report.coarseness <= 4
