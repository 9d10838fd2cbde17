"""The page in a headset, for which `web/headset.js` stands in."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import random_scene
from web_pages import HERE, POSITIONS, Job, decibels, drawn, in_browser, open_pages, small_page

from gs_codec.cameras.camera import Camera

HEADSET = (HERE / "headset.js").read_text()

#: Enter, and show pictures until the order for the last one has arrived.
ENTER = [("drawn",), ("click", "#headset"), ("until", "headset.session?.renderState.baseLayer")]
LOOK = [("value", "headset.step()"), ("until", "new Promise((r) => setTimeout(r, 300, true))")] * 3

#: Eyes and their lenses, from the stand-in: offset in metres, and the middle in pixels.
EYES = ((-0.03, 80.0), (0.03, 70.0))

#: Width, height and focal lengths of an eye, pixels.
LENS = (150, 200, 120.0, 130.0)

#: Metres from the head to the point straight ahead of the page's camera.
REACH = 2


def both(values: list) -> list[np.ndarray]:
    """What the two eyes see."""
    picture = np.reshape(np.array(values, np.float64) / 255, (200, 300, 4))[::-1, :, :3]
    return [picture[:, :150], picture[:, 150:]]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("headset")
    return small_page(folder), random_scene(500, 0, seed=2)


def expected(head: np.ndarray, rotation: np.ndarray, metre: float) -> list[Camera]:
    return [
        Camera(
            "", 150, 200, 120.0, 130.0, middle, 90.0, rotation, head + aside * metre * rotation[0]
        )
        for aside, middle in EYES
    ]


@in_browser
def test_each_eye_sees_the_scene_and_sticks_fly(page):
    url, scene = page
    job = Job(url, [*ENTER, *LOOK, ("value", "headset.pixels()")], before=HEADSET, panel=True)
    # Half a metre to the right, and a quarter turn to the left about up.
    turn = "headset.matrix = [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0.5, 0, 0, 1]"
    job.steps += [("value", turn), *LOOK, ("value", "headset.pixels()")]
    stick = "[{ handedness: 'left', gamepad: { axes: [0, 0, 0.1, -1] } }]"
    job.steps += [("value", f"headset.session.inputSources = {stick}"), ("value", "headset.step()")]
    job.steps += [("value", "headset.session.inputSources = []"), *LOOK]
    job.steps += [("value", "headset.session.end()"), ("drawn",)]
    job.steps += [("until", "location.hash.includes('camera')"), ("value", "location.hash")]
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    pixels = [value for value in told.values if isinstance(value, list) and len(value) > 16]
    metre = (np.median(scene.positions[2]) - POSITIONS[0][2]) / REACH
    start, aside = np.array(POSITIONS[0], float), np.array([metre, 0, 0])
    straight = expected(start, np.eye(3), metre)
    left = expected(start + 0.5 * aside, np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]), metre)
    for values, cameras in zip(pixels, (straight, left), strict=True):
        ours = [drawn(scene, camera) for camera in cameras]
        for k, picture in enumerate(both(values)):
            assert decibels(picture, ours[k]) > 45
            assert decibels(picture, ours[1 - k]) < 40
    assert np.ptp(both(pixels[0])[0]) > 0.3
    # Forward for a tenth of a second, at 1.5 metres per second, as the head looks.
    camera = told.values[-1].split("camera=")[1].split("&")[0].split(",")
    np.testing.assert_allclose(np.array(camera[:3], float), start + 0.35 * aside, atol=1e-4)


@in_browser
def test_without_a_headset_there_is_no_button_and_a_failure_is_told(page):
    hidden = ("value", "document.getElementById('headset').hidden")
    without = Job(page[0], [("drawn",), hidden])
    fails = Job(page[0], [("drawn",), ("value", "headset.fails = true"), hidden], before=HEADSET)
    fails.panel = True
    told = "document.getElementById('status').textContent"
    fails.steps += [
        ("click", "#headset"),
        ("until", told),
        ("value", told),
        ("key", "n"),
        ("drawn",),
    ]
    without, failed = open_pages(without, fails)
    assert without.values[-1] is True
    assert (failed.values[2], failed.values[5]) == (False, "no space: local")
    assert (failed.state, failed.errors) == ("ready", [])
