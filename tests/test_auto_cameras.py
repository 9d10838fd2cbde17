"""Estimated cameras are near those that a scene was trained with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_renderer import sh_basis
from requested import as_requested
from scenes import edge_scenes, random_scene

from gs_codec.codecs.encode import encode_scene
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.plan import Plan, Steps
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene
from gs_codec.views import estimate as module
from gs_codec.views.estimate import (
    HEIGHT,
    WIDTH,
    auto_cameras,
    estimate_views,
    guiding_cameras,
)
from gs_codec.views.evidence import gather_evidence
from samples.generate import generate

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def still_life():
    return generate(5000, 1, 3)


@pytest.fixture
def few_tried(monkeypatch):
    """Try fewer views than good cameras need, in tests that do not depend on their quality."""
    monkeypatch.setattr(module, "_OVERVIEWS", 8)
    monkeypatch.setattr(module, "_LEAST_TRIED", 24)


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
def test_auto_cameras_are_the_same_every_time(still_life):
    first, second = auto_cameras(still_life, 6), auto_cameras(still_life, 6)
    assert [view.name for view in first] == [f"auto_{i:02d}" for i in range(6)]
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.position, b.position)
        assert (a.width, a.height) == (WIDTH, HEIGHT)


def trained(count: int, positions: np.ndarray, places: np.ndarray, seed: int) -> Scene:
    """Gaussians with SH-AC only in the directions from which `places` see them."""
    rng = np.random.default_rng(seed)
    f_rest = np.zeros((3, 15, count))
    for place in places:
        towards = positions - place[:, None]
        towards /= np.linalg.norm(towards, axis=0)
        basis = np.array([sh_basis(direction)[1:] for direction in towards.T])
        f_rest += rng.normal(0.0, 0.1, (3, 1, count)) * basis.T
    return replace(
        random_scene(count, 3, seed=seed),
        positions=positions.astype(np.float32),
        log_scale=np.full((3, count), -3.0, np.float32),
        opacity=np.full((1, count), 4.0, np.float32),
        f_rest=f_rest.reshape(45, count).astype(np.float32),
    )


def table_upwards(sign: int) -> Scene:
    """A ball on a floor, with x pointing up or down, seen from above and only from the y side."""
    rng = np.random.default_rng(51)
    ball = rng.standard_normal((3, 2500))
    ball = ball / np.linalg.norm(ball, axis=0) + np.array([[sign], [0.0], [0.0]])
    floor = np.stack([np.zeros(1500), *rng.uniform(-3, 3, (2, 1500))])
    angle = rng.uniform(-0.6, 0.6, 40)
    places = np.stack([sign * rng.uniform(2, 3, 40), 5 * np.cos(angle), 5 * np.sin(angle)], axis=1)
    scene = trained(4000, np.concatenate([ball, floor], axis=1), places, 52)
    flat = np.arange(4000) >= 2500
    scene.log_scale[0, flat] = -6.0
    scene.rot[:, flat] = np.array([[1.0], [0.0], [0.0], [0.0]])
    scene.log_scale[:, ~flat] = -3.2
    return scene


@pytest.fixture(scope="module")
def table():
    return table_upwards(1)


@pytest.fixture(scope="module")
def around(table):
    """Cameras for the table."""
    return auto_cameras(table, 24)


def test_auto_cameras_are_where_gaussians_were_seen_from(table, around):
    assert gather_evidence(table).telling
    positions = np.array([view.position for view in around])
    sides = positions / np.linalg.norm(positions, axis=1)[:, None]
    assert (sides[:, 1] > 0.3).mean() > 0.8
    assert (positions[:, 0] > 0).mean() > 0.8


def test_auto_cameras_are_upright(around):
    ups = np.array([-view.rotation[1] for view in around])
    assert np.median(ups[:, 0]) > 0.7
    rights = np.array([view.rotation[0] for view in around])
    assert np.abs(rights[:, 0]).max() < 0.2


def test_one_solid_gaussian_does_not_stand_for_a_transparent_scene(table):
    scene = replace(table, opacity=np.full_like(table.opacity, -2.0))
    scene.opacity[0, 7] = 3.0
    found = gather_evidence(scene, quick=True)
    assert found.telling
    assert found.thumb.count >= scene.count // 10


@pytest.mark.thorough
@pytest.mark.parametrize("sign", [1, -1])
def test_up_follows_the_cameras_if_there_is_no_floor(sign):
    scene = table_upwards(sign)
    scene.f_rest[:, 2500:] = 0
    scene.log_scale[1, :2500] = -3.4  # the normals of the ball are horizontal
    scene.rot[:, :2500] = np.array([[1.0], [0.0], [0.0], [0.0]])
    found = gather_evidence(scene)
    assert found.telling
    assert sign * found.up[0] > 0.9


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
def test_auto_cameras_are_upright_for_a_given_axis(table):
    up = np.array([0.0, 0.6, 0.8])
    found = estimate_views(table, 12, up)
    for view in found.cameras:
        assert view.rotation[0] @ up == pytest.approx(0, abs=1e-9)
        assert view.rotation[1] @ up < 0
    np.testing.assert_array_equal(found.up, gather_evidence(table).up)


def flat_scene(planes: dict[int, int], places: np.ndarray) -> Scene:
    """Planes through 0, with a number of Gaussians across each axis, and a small ball at 0."""
    rng = np.random.default_rng(56)
    across = np.repeat(list(planes), list(planes.values()))
    count = len(across) + 500
    positions = rng.uniform(-3, 3, (3, count))
    positions[:, len(across) :] = 0.1 * rng.standard_normal((3, 500))
    positions[across, np.arange(len(across))] = 0
    scene = trained(count, positions, places, 57)
    scene.rot[:] = np.array([[1.0], [0.0], [0.0], [0.0]])
    scene.log_scale[across, np.arange(len(across))] = -6.0
    scene.log_scale[:, len(across) :] = -3.5
    return scene


def directions_near(axis: list[float], spread: float) -> np.ndarray:
    """40 positions at distance 4 from 0, around an axis."""
    rng = np.random.default_rng(58)
    places = np.array(axis) + spread * rng.standard_normal((40, 3))
    return 4 * places / np.linalg.norm(places, axis=1)[:, None]


@pytest.mark.thorough
@pytest.mark.parametrize("sign", [1, -1])
def test_up_is_uncertain_if_the_floor_may_be_a_wall(sign, table):
    assert gather_evidence(table).up_certain
    found = gather_evidence(flat_scene({0: 3000}, directions_near([sign, 0.0, 0.0], 0.3)))
    assert found.telling
    assert sign * found.up[0] > 0.95
    assert not found.up_certain


@pytest.mark.thorough
@pytest.mark.parametrize(("flat", "up"), [(3000, [0, -1, 0]), (4000, [1, 0, 0])])
def test_of_two_equally_likely_up_axes_the_usual_one_is_chosen(flat, up):
    """With 3,000 Gaussians across x, that axis is slightly likelier than y; with more, clearly."""
    places = directions_near([1.0, -1.0, 0.0], 0.2)
    found = gather_evidence(flat_scene({0: flat, 1: 2000}, places))
    assert found.telling
    np.testing.assert_array_equal(found.up, up)
    assert not found.up_certain


def slab(normal: np.ndarray, share: float) -> Scene:
    """Gaussians without SH-AC: a share flat on a floor, the others with random rotations."""
    rng = np.random.default_rng(54)
    count = 4000
    axes = np.linalg.svd(normal[None])[2]
    positions = rng.uniform(-1, 1, (count, 3)) * [0.05, 1, 1] @ axes
    scene = random_scene(count, 0, seed=55)
    log_scale = np.full((3, count), -3.0, np.float32)
    log_scale[2] = -6.0
    rot = rng.standard_normal((4, count))
    flat = rng.random(count) < share
    half = np.cross([0.0, 0.0, 1.0], normal)
    turn = np.array([1 + normal[2], *half])
    rot[:, flat] = (turn / np.linalg.norm(turn))[:, None]
    return replace(
        scene,
        positions=positions.T.astype(np.float32),
        log_scale=log_scale,
        rot=rot.astype(np.float32),
        opacity=np.full((1, count), 4.0, np.float32),
    )


@pytest.mark.parametrize(
    ("normal", "share", "up"),
    [
        ([0.0, 0.0, 1.0], 0.3, [0.0, 0.0, 1.0]),
        ([0.0, 0.1, -0.995], 0.3, [0.0, -0.1, 0.995]),
        ([0.1, 0.995, 0.0], 0.3, [-0.1, -0.995, 0.0]),
        ([0.0, 0.0, 1.0], 0.01, [0.0, -1.0, 0.0]),
    ],
)
def test_without_evidence_up_is_from_the_floor_or_the_trainers_axis(normal, share, up):
    found = gather_evidence(slab(np.array(normal), share))
    assert not found.telling
    np.testing.assert_allclose(found.up, up, atol=0.05)
    assert found.up_certain == (share > 0.1)


@pytest.mark.thorough
def test_the_best_overviews_are_compared_with_all_gaussians(still_life, monkeypatch):
    full = auto_cameras(still_life, 2)
    monkeypatch.setattr(module, "_ROUGH", 1000)
    judged, rate = [], module._rate_overviews
    monkeypatch.setattr(
        module,
        "_rate_overviews",
        lambda seen, views, progress: judged.append(views) or rate(seen, views, progress),
    )
    quick = auto_cameras(still_life, 2)
    assert len(judged[1]) == module._FINALISTS < len(judged[0])
    for a, b in zip(full, quick, strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.position, b.position)


@pytest.mark.thorough
def test_the_overview_shows_a_whole_object_without_surroundings():
    rng = np.random.default_rng(95)
    tower = replace(
        random_scene(5000, 0, seed=96),
        positions=(rng.uniform(-1, 1, (3, 5000)) * [[0.3], [2.0], [0.3]]).astype(np.float32),
        log_scale=np.full((3, 5000), -4.0, np.float32),
        opacity=np.full((1, 5000), 4.0, np.float32),
    )
    [view] = auto_cameras(tower, 1)
    x, y, z = view.rotation @ (tower.positions - view.position[:, None])
    inside = np.maximum(np.abs(view.fx * x) / view.cx, np.abs(view.fy * y) / view.cy) < z
    assert inside.mean() > 0.98
    assert np.ptp(view.fy * y / z) > 0.6 * view.height


@pytest.mark.thorough
def test_the_first_auto_camera_shows_the_whole_detailed_subject(table):
    [view] = auto_cameras(table, 1)
    x, y, z = view.rotation @ (table.positions[:, :2500] - view.position[:, None])
    assert (z > 0).all()
    inside = (np.abs(view.fx * x / z) < view.cx) & (np.abs(view.fy * y / z) < view.cy)
    assert inside.mean() > 0.9


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
@pytest.mark.parametrize("degree", [0, 3])
def test_camera_positions_are_not_estimated_from_noise(degree, caplog):
    scene = random_scene(3000, degree, seed=9)
    assert not estimate_views(scene, 1).telling
    plan = Plan(Steps(), "auto")
    assert as_requested(scene, Config("m"), plan)[0] == encode_scene(scene, Config("m"))[0]
    assert [record.getMessage() for record in caplog.records] == [
        "cameras 'auto': no cameras can be estimated from this scene; encoded camera-free"
    ]


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
def test_guiding_views_are_many_and_small(table):
    found = guiding_cameras(table, 5)
    assert [(view.width, view.height) for view in found.cameras] == [(WIDTH // 2, HEIGHT // 2)] * 20
    assert len({view.name for view in found.cameras}) == 20
    assert found.telling


@pytest.mark.thorough
def test_guiding_views_are_larger_in_scenes_with_many_gaussians():
    found = guiding_cameras(generate(30_000, 1, 0), 3)
    [size] = {(view.width, view.height) for view in found.cameras}
    assert WIDTH // 2 < size[0] < WIDTH / np.sqrt(2) - 1
    assert size[1] == round(size[0] * HEIGHT / WIDTH)
    pixels = size[0] * size[1]
    assert pixels == pytest.approx(3 * 30_000 * found.shown, rel=0.01)
    assert len(found.cameras) == int(np.ceil(12 * (WIDTH / 2 / size[0]) ** 2))


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
@pytest.mark.parametrize(("width", "number"), [(60, 12), (WIDTH, 6), (900, 6)])
def test_guiding_views_have_the_requested_width(still_life, width, number):
    found = guiding_cameras(still_life, 3, width)
    assert [view.width for view in found.cameras] == [width] * number


def test_cameras_that_see_most_are_selected_greedily():
    rng = np.random.default_rng(97)
    weights = (rng.random((40, 300)) ** 8).astype(np.float32)
    views = list(rng.permutation(40))
    expected: list[int] = []
    left, total = views.copy(), np.zeros(300)
    for _ in range(12):
        gains = [np.sqrt(total + weights[view]).sum() for view in left]
        expected.append(left.pop(int(np.argmax(gains))))
        total += weights[expected[-1]]
    assert module._see_most(weights, views, 12) == expected
    assert sorted(module._see_most(weights, views, 99)) == sorted(views)


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
def test_evidence_of_cameras_is_gathered_once(table, monkeypatch):
    gathered = []
    monkeypatch.setattr(
        module,
        "gather_evidence",
        lambda scene, **rest: gathered.append(scene) or gather_evidence(scene, **rest),
    )
    plan = Plan(Steps(prune=10), "auto", width=24, views=2)
    as_requested(table, Config("m"), plan)
    assert len(gathered) == 1


@pytest.mark.thorough
def test_auto_cameras_go_around_an_object():
    rng = np.random.default_rng(93)
    normal = rng.standard_normal((3, 5000))
    normal /= np.linalg.norm(normal, axis=0)
    depth = rng.random(5000) ** 0.3
    ball = replace(
        random_scene(5000, 0, seed=94),
        positions=(normal * depth + np.array([[7.0], [0.0], [0.0]])).astype(np.float32),
        log_scale=np.full((3, 5000), -3.5, np.float32),
        opacity=np.full((1, 5000), 4.0, np.float32),
    )
    views = auto_cameras(ball, 12)
    offsets = np.array([view.position for view in views]) - [7, 0, 0]
    outside = np.linalg.norm(offsets, axis=1) > 1.2
    assert outside.sum() >= 8
    directions = offsets[outside] / np.linalg.norm(offsets[outside], axis=1)[:, None]
    assert np.linalg.norm(directions.mean(axis=0)) < 0.6  # not all from one side


def test_auto_cameras_are_at_the_same_places_in_any_unit():
    """In tiny units they were outside rooms: profile m lost 0.13 dB and reported 0.04."""
    scene, unit = generate(5000, 3, seed=0), 0.5**12
    tiny = replace(
        scene,
        positions=scene.positions * np.float32(unit),
        log_scale=scene.log_scale + np.float32(np.log(unit)),
    )
    distances = [
        np.median([np.linalg.norm(view.position) for view in auto_cameras(one, 8)])
        for one in (scene, tiny)
    ]
    assert distances[1] == pytest.approx(unit * distances[0], rel=0.3)


@pytest.mark.thorough
def test_auto_cameras_fill_the_image_with_a_tiny_scene():
    rng = np.random.default_rng(99)
    normal = rng.standard_normal((3, 3000))
    normal /= np.linalg.norm(normal, axis=0)
    speck = replace(
        random_scene(3000, 0, seed=99),
        positions=(0.01 * normal).astype(np.float32),
        log_scale=np.full((3, 3000), np.log(0.0003), np.float32),
        opacity=np.full((1, 3000), 4.0, np.float32),
    )
    for view in auto_cameras(speck, 4):
        assert (render(speck, view.resized(120, 80)).alpha > 0.5).mean() > 0.1


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
@pytest.mark.parametrize("name", [name for name in edge_scenes() if name != "empty"])
def test_auto_cameras_see_something_of_edge_scenes(name):
    scene = edge_scenes()[name]
    views = auto_cameras(scene, 4)
    assert len(views) == 4
    assert render(scene, views[0].resized(60, 40)).alpha.max() > 0


def test_an_empty_scene_has_no_auto_cameras():
    with pytest.raises(InvalidInput, match="cameras 'auto': no view shows anything of the scene"):
        auto_cameras(random_scene(0))


@pytest.mark.thorough
@pytest.mark.usefixtures("few_tried")
def test_auto_cameras_ignore_nonfinite_gaussians(still_life):
    positions = still_life.positions.copy()
    positions[:, ::3] = np.nan
    views = auto_cameras(replace(still_life, positions=positions), 4)
    assert len(views) == 4
