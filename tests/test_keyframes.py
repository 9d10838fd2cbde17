"""Keyframes of nerfstudio's and SuperSplat's files: times, and invalid files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_files import MATRIX, camera_path, pose, project, step

from gs_codec.cameras.keyframes import Keyframes, read_keyframes
from gs_codec.errors import InvalidInput


def read(tmp_path: Path, value: Any) -> Keyframes:
    (tmp_path / "a.json").write_text(json.dumps(value))
    return read_keyframes(tmp_path / "a.json")


def key(seconds: float | None = None) -> dict[str, Any]:
    given = {"override_transition_enabled": True, "override_transition_sec": seconds}
    return {"matrix": MATRIX, "fov": 50.0, "aspect": 4 / 3} | ({} if seconds is None else given)


def track(*times: float, **changes: Any) -> dict[str, Any]:
    count = len(times)
    values = {"position": [0, 0, 5] * count, "target": [0, 0, 0] * count, "fov": [60] * count}
    whole = {"keyframes": {"times": list(times), "values": values}, "frameRate": 10}
    return {"animTracks": [whole | changes], "cameras": [{"initial": pose()}]}


def test_times_of_keyframes(tmp_path):
    found = read(tmp_path, camera_path(keyframes=[key(9), key(1.5), key()]))
    assert (found.times, found.fps) == ([0, 1.5, 3.5], 24)
    assert len(found.cameras) == 3
    np.testing.assert_array_equal(found.cameras[2].position, np.reshape(MATRIX, (4, 4))[:3, 3])
    cycle = read(tmp_path, camera_path(keyframes=[key(3), key(1)], is_cycle=True))
    assert cycle.times == [0, 1, 4]
    old = camera_path(step(), step(), step(), keyframes=[{"matrix": str(MATRIX)}], fps=4)
    assert read(tmp_path, old).times == [0, 0.25, 0.5]
    found = read(tmp_path, track(5, 15, 30))
    assert (found.times, found.fps, len(found.cameras)) == ([0, 1, 2.5], 10, 3)
    found = read(tmp_path, project(pose(), pose(), timeline={"frameRate": 15}))
    assert (found.times, found.fps) == ([0, 2], 15)
    assert read(tmp_path, project({"frame": None} | pose())).times is None
    first = {"animTracks": [], "cameras": [{"initial": pose()}]}  # of a viewer without animation
    assert read(tmp_path, first).times is None


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (camera_path(keyframes=[key(1), key(-1)]), "times of keyframes decrease"),
        (camera_path(keyframes=[key(1), key("2")]), "override_transition_sec '2'"),
        (camera_path(fps=0), "fps 0.0, expected 1 to 120"),
        (track(5, 3), "times of keyframes decrease"),
        (track(5, "7"), "times '7'"),
        (track(5, frameRate="7"), "frameRate '7'"),
        (track(5) | {"animTracks": "a"}, "animTracks 'a', expected a list"),
        (project(pose(frame="a")), "times 'a'"),
    ],
)
def test_bad_times_are_refused(tmp_path, value, message):
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, value)
