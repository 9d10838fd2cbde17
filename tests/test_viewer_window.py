"""The viewer's window on a display of its own, driven by mouse and keys."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gs_codec
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.formats.ply import write_ply
from samples.generate import generate
from viewer.scenes.numbers import quality_text
from viewer.scenes.pose import look_at

pytestmark = pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool"
)


@pytest.fixture(scope="module")
def display():
    """A display, and no other."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two versions of a scene, places to look from, one photograph, and a report."""
    folder = tmp_path_factory.mktemp("window")
    scene = generate(3000, 1, 31)
    write_ply(folder / "a.ply", scene)
    (folder / "b.egs").write_bytes(encode_scene(scene, Config("s", block_size=1024))[0])
    centre = np.median(scene.positions, axis=1).astype(np.float64)
    size = float(np.quantile(np.abs(scene.positions.T - centre), 0.8))
    poses = [
        look_at(centre + 4 * size * np.array(p), centre) for p in ((0.3, -0.5, -1), (1, -0.5, 0))
    ]
    entries = [pose.camera(200, 150) | {"img_name": f"view{k}"} for k, pose in enumerate(poses)]
    (folder / "cameras.json").write_text(json.dumps(entries))
    (folder / "images").mkdir()
    Image.new("RGB", (40, 30), "red").save(folder / "images" / "view0.png")
    (folder / "report").mkdir()
    np.save(folder / "report" / "labels.npy", (np.arange(3000) % 3 == 0).astype(np.uint8))
    (folder / "report" / "report.json").write_text('{"removed": {"geometry": 1000}}')
    return folder


def drive(script: str, display: str, folder: Path) -> dict:
    """What came of driving a window by a script of this folder."""
    here = Path(__file__).parent
    environment = os.environ | {
        "DISPLAY": display,
        "PYTHONPATH": str(here.parent),
        "XDG_STATE_HOME": str(folder / "state"),
    }
    result = subprocess.run(
        [sys.executable, here / script, folder],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        timeout=600,
    )
    lines = [line for line in result.stdout.splitlines() if line.startswith("RESULT ")]
    assert lines, result.stdout + result.stderr
    return json.loads(lines[0].removeprefix("RESULT "))


@pytest.fixture(scope="module")
def found(display, folder) -> dict:
    return drive("drive_viewer.py", display, folder)


def test_it_draws_both_scenes(found):
    assert found["drawn"] > 10
    assert "dB, SSIM" in found["quality"]


@pytest.mark.parametrize("layer", ["splats", "centres", "octree"])
def test_layers_are_switched_by_clicks_in_both_panes(found, layer):
    left, right, apart = found["layers"][layer]
    assert left > 100
    assert right > 100
    assert apart <= 4


@pytest.mark.parametrize(("layer", "owner"), [("pruned", 0), ("boxes", 1), ("error", 1)])
def test_what_is_of_one_scene_alone_shows_there(found, layer, owner):
    *halves, apart = found["layers"][layer]
    assert halves[1 - owner] < halves[owner] / 10
    assert halves[owner] > 100
    assert apart <= 4


def test_the_depth_of_the_octree_follows_the_slider(found):
    depths = found["octree"]["depths"]
    assert min(depths) == 1
    assert max(depths) == 12
    top = depths.index(12)
    assert depths[:top] == sorted(depths[:top])
    assert depths[top:] == sorted(depths[top:], reverse=True)
    assert depths[-1] == 1
    assert found["octree"]["changed"] > 1000


def test_the_octree_says_whose_bits_are_unknown(found):
    unknown, known = found["octree"]["captions"]
    assert unknown.startswith(" A: a.ply, bits unk")  # as much as there is room for
    assert known == " B: b.egs"
    [legend] = found["octree"]["legends"]
    assert legend.startswith("bits / Gaussian, cells ")
    assert found["octree"]["after"] == 0


def test_the_quality_is_of_the_frame_whatever_the_layout(found, folder):
    scenes = folder / "a.ply", folder / "b.egs"
    expected = gs_codec.compare(*scenes, str(folder / "cameras.json")).views[0].between
    assert found["quality"] == found["wiped_quality"] == quality_text(expected)


def test_panes_are_named_and_the_panel_says_where_one_is(found):
    assert found["captions"] == [" A: a.ply", " B: b.egs"]
    assert found["flipped"] == [" A: a.ply", " B: b.egs, error against A"]
    assert found["where"] == [
        "view 0 of 2: view0",
        "moved away from view 0 of 2: view0 (R goes back)",
        "view 0 of 2: view0",
        "overview; 2 views",
    ]


def test_the_frame_is_outlined_in_every_pane_whatever_the_layout(found):
    assert len(found["outlined"]) == 5  # side by side, flipped twice, wiped
    assert min(found["outlined"]) > 0.95


def test_the_line_of_a_wipe_is_seen_and_dragged(found):
    assert found["line"] > 200
    assert found["dragged"] == pytest.approx(0.5 + 60 / found["wide"], abs=0.02)


def test_a_third_scene_replaces_neither_unasked(found):
    assert found["asked"] == [["a.ply", "b.egs"], ["a.ply", "b.egs"]]


def test_both_cameras_follow_one(found):
    before, after = (np.array(found[key]) for key in ("at_first", "after_drag"))
    np.testing.assert_allclose(before[0], before[1], atol=1e-5)
    assert np.abs(after[0] - before[0]).max() > 0.05
    np.testing.assert_allclose(after[0], after[1], atol=1e-5)
    assert found["drag_changed"] > 1000


@pytest.mark.parametrize("case", ["side 1 ", "side 1 ctrl", "side 3 ", "wipe 1 ", "wipe 1 ctrl"])
def test_a_drag_ends_where_it_would_in_one_event_and_back_at_its_start(found, case):
    (before,), *drags = found["drags"][case]
    there, back = np.array(drags).transpose(1, 0, 2, 3, 4)  # of drags, panes: matrices
    moved = np.abs(there[0, 0] - before[0]).max()
    assert moved > 0.5
    assert np.abs(there - there[0, 0]).max() < 0.01 * moved
    assert np.abs(back - before).max() < 0.01 * moved


def test_scrolling_up_comes_nearer(found):
    first, nearer, again, farther = found["wheel"]
    assert nearer < again < farther
    assert again == pytest.approx(first)


def test_what_is_near_is_drawn_after_a_layout(found):
    assert max(found["near"]) < 0.05


def test_keys_go_through_the_cameras(found):
    assert found["number"] == 2
    np.testing.assert_allclose(found["back"][0], found["at_first"][0], atol=1e-5)


def test_scenes_are_flipped_and_wiped(found):
    assert found["front_first"] == 0
    assert found["flip_changed"] > 1000
    low, high = found["wipe_changed"]
    assert 0.15 < low < 0.25
    assert 0.45 < high < 0.52
    assert found["mode"] == "flip"


def test_pictures_are_saved(found, folder):
    with Image.open(folder / "saved.png") as image:
        assert image.width > 300
        assert np.asarray(image).std() > 10


def test_a_broken_file_is_told_and_the_window_lives(found):
    title, text = found["message"]
    assert title == "Not possible"
    assert "report.json" in text


def test_loading_is_stopped(found):
    assert found["stopped"] == 2 * ["loading a.ply ...", "", "b.egs"]


@pytest.fixture(scope="module")
def chosen(display, folder) -> dict:
    return drive("drive_chosen.py", display, folder)


def test_without_cameras_the_first_picture_is_upright_and_stays(chosen, folder):
    steps = ["loading ...", "choosing the first view ...", "", "choosing views ...", ""]
    assert chosen["said"] == steps
    assert chosen["where"][0] == "overview; 0 views"
    assert chosen["where"][1] == "overview; 23 views"
    first = gs_codec.render(folder / "a.ply", "auto").cameras[0]
    [model] = np.array(chosen["at_first"])  # the axes of Open3D's cameras are right, up, back
    np.testing.assert_allclose(model[:3, 3], first.position, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(model[:3, :3].T, first.rotation * [[1], [-1], [-1]], atol=1e-4)
    np.testing.assert_array_equal(chosen["after"], chosen["at_first"])
    assert chosen["drawn"] > 10


def test_views_that_were_chosen_are_gone_through_and_home_is_the_first_picture(chosen):
    assert chosen["where"][2] == "view 1 of 24: auto_01"
    assert np.abs(np.array(chosen["n"]) - chosen["at_first"]).max() > 0.05
    np.testing.assert_allclose(chosen["Home"], chosen["at_first"], atol=1e-5)
    [model] = np.array(chosen["u"])  # by -y, the first axis after that of the cameras
    assert model[1, 0] == pytest.approx(0, abs=1e-5)
    assert model[1, 1] < 0
    np.testing.assert_allclose(model[:3, 2], np.array(chosen["at_first"])[0, :3, 2], atol=1e-5)


def test_another_scene_in_its_place_begins_with_its_own_overview(chosen):
    number, where, up = chosen["other"]
    assert (number, up) == (0, "cameras")
    assert where.startswith("overview; ")


@pytest.fixture(scope="module")
def keyed(display, folder) -> dict:
    return drive("drive_keys.py", display, folder)


def test_the_window_lives_through_many_keys(keyed):
    assert keyed["pressed"] == 136


def test_keys_are_for_the_dialog_alone(keyed):
    still = keyed["first"][1:]
    for end in ("Escape", "Return"):
        assert keyed[f"before {end}"] == [True, *still]
        assert keyed[end] == [False, *still]


def test_names_are_typed_and_enter_saves(keyed, folder):
    still = keyed["first"][1:]
    assert keyed["typed quiet mnn"] == [[True, *still], "quiet mnn"]
    assert keyed["Return after quiet mnn"] == [False, *still]
    with Image.open(folder / "quiet mnn.png") as image:
        assert image.width > 100
    assert keyed["typed q"] == [[True, *still], "q"]
    assert keyed["Escape after q"] == [False, *still]
    assert not (folder / "q.png").exists()


def test_without_a_dialog_escape_closes(keyed):
    assert keyed["closes"]


@pytest.fixture(scope="module")
def picked(display, folder) -> dict:
    return drive("drive_pick.py", display, folder)


@pytest.mark.parametrize("click", ["first", "again", "wiped"])
def test_a_click_picks_the_gaussian_that_the_pixel_shows(picked, click):
    found, expected = picked[click]
    assert found == expected
    assert found["weight"] > 0.01


def test_what_is_picked_is_told_and_marked_in_both_panes_until_escape(picked):
    assert picked["tab"] == 2
    assert picked["text"].startswith("Gaussian of B\nrow, from 0")
    for heading in ("In this view, 200x150", "Error against A's", "Bits: ", "Step sizes (block "):
        assert heading in picked["text"]
    for states in ("marked", "moved"):
        first, second, elsewhere = picked[states]
        assert min(first, second) > 40
        assert elsewhere < 10
    assert picked["cleared"].startswith("Click into a picture")
    assert picked["closes"]


def test_centres_are_coloured_by_bits_on_the_scale_that_is_chosen(picked):
    found = picked["colours"]
    for colouring in ("bits", "block"):
        unknown, known = found[colouring]
        assert unknown.startswith(f" A: a.ply, {colouring} unknown: not an")  # as there is room for
        assert known == " B: b.egs"
    assert found["scales"] == [[True, "linear"], [False, None]]
    linear, blocks, log = found["legends"]
    assert blocks == ["0", "1", "2"]
    assert linear[::4] == log[::4]
    assert linear[1:4] != log[1:4]
    assert found["changed"] > 1000


@pytest.fixture(scope="module")
def used(display, folder) -> dict:
    return drive("drive_panel.py", display, folder)


@pytest.mark.parametrize(
    ("key", "axis", "way"),
    [("w", 2, 1), ("s", 2, -1), ("a", 0, -1), ("d", 0, 1), ("q", 1, 1), ("e", 1, -1)],
)
def test_keys_fly_along_the_axes_of_the_camera_while_held(used, key, axis, way):
    before, after = used["flights"][key]
    moved = np.subtract(after["position"], before["position"]) @ np.transpose(before["rotation"])
    assert way * moved[axis] > 0.1
    np.testing.assert_allclose(np.delete(moved, axis), 0, atol=1e-9)
    np.testing.assert_array_equal(after["rotation"], before["rotation"])
    assert used["flights"]["stops"]


def test_while_looking_around_the_camera_stays_where_it_is(used):
    before, flying, after = used["looks"]
    assert flying
    np.testing.assert_allclose(after["position"], before["position"])
    assert np.abs(np.subtract(after["rotation"], before["rotation"])).max() > 0.05


def test_a_double_click_brings_what_is_there_to_the_middle(used):
    np.testing.assert_allclose(used["focuses"]["was"], used["focuses"]["at"], atol=1e-6)


def test_all_of_the_scene_is_framed_and_the_panel_says_that_one_has_moved(used):
    assert used["focuses"]["framed"] > 0.9
    assert used["focuses"]["where"] == "moved away from view 0 of 2: view0 (R goes back)"


def test_the_slider_sets_the_field_of_view(used):
    before, after, where = used["angles"]
    assert before == pytest.approx(2 * np.degrees(np.arctan(0.5 / 0.7697777)), abs=1e-3)
    assert after > before + 5
    assert where.startswith("moved away from view 0")


def test_the_chart_of_views_is_that_of_compare_and_leads_to_them(used, folder):
    charts = used["charts"]
    scenes = folder / "a.ply", folder / "b.egs"
    views = gs_codec.compare(*scenes, str(folder / "cameras.json"), split="all").views
    assert list(charts["decibels"].values()) == [view.between.psnr for view in views]
    assert charts["best"] == charts["went"] == 1
    assert min(charts["pictures"]) > 0.02
    assert charts["first"] == 0


def test_a_range_is_dragged_in_a_histogram(used):
    found = used["charts"]["histogram"]
    assert found["name"] == "opacity"
    assert found["chosen"] == found["ends"]
    assert 0 < found["chosen"][0] < found["chosen"][1] < 1


def test_views_are_listed_by_quality_and_visited_by_a_click(used):
    assert used["listed"] == {"order": ["view0", "view1", "overview"], "went": "view1"}


def test_cameras_photographs_reports_and_recent_files_are_opened(used):
    assert used["opens"] == {
        "where": "view 0 of 1: view1",
        "photographed": True,
        "layers": ["pruned", "splats"],
        "recent": ["b.egs", "a.ply", "Cancel"],
        "asked": ["Open", "Show b.egs in place of"],
    }


def test_the_plugin_opens_shows_what_was_pruned_and_compares(display, folder):
    found = drive("drive_plugin.py", display, folder)
    assert found["count"] == 3000
    assert found["refused"] == "no scene is open"
    opened, pruned, compared, detached = found["changed"]
    assert min(opened, pruned, compared, detached) > 1000
    assert found["left"] == ["centres", []]
    assert found["titles"] == ["plugin - colour error, of 255: 0.25 dark, 64 yellow", "plugin"]
    assert found["detached"] == "detached from the visualizer"


def test_without_a_driver_it_says_so(display, folder):
    code = "import sys; sys.argv[0] = 'gs-viewer'; from viewer.main import main; main()"
    result = subprocess.run(
        [sys.executable, "-c", code, folder / "a.ply"],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parent.parent,
        env=os.environ
        | {"DISPLAY": display, "VK_ICD_FILENAMES": "/none", "VK_DRIVER_FILES": "/none"},
    )
    assert result.returncode == 2
    assert result.stderr.startswith("gs-viewer: error: no Vulkan device")
    assert len(result.stderr.splitlines()) == 1
