"""The viewer's window on a separate display, driven by mouse and keys."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from open3d.visualization import gui
from PIL import Image
from windows import check_drags, drive, make_folder, needs_display

import gs_codec
from viewer.scenes.numbers import quality_text
from viewer.window.panel import divided

pytestmark = [needs_display, pytest.mark.slow]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return make_folder(tmp_path_factory)


@pytest.fixture(scope="module")
def found(display, folder) -> dict:
    return drive("drive_viewer.py", display, folder)


def test_the_window_draws_both_scenes(found):
    assert found["drawn"] > 10
    assert "dB, SSIM" in found["quality"]
    assert re.fullmatch(r"at rest after \d+\.\d\d s", found["speed"])


def test_the_quality_is_of_the_frame_whatever_the_layout(found, folder):
    scenes = folder / "a.ply", folder / "b.egs"
    expected = gs_codec.compare(*scenes, str(folder / "cameras.json")).views[0].between
    assert found["quality"] == found["wiped_quality"] == quality_text(expected)


def test_a_dialog_leaves_no_trace_between_panes(found):
    assert found["ghosts"] == 0


def test_panes_are_named_and_the_panel_shows_the_viewpoint(found):
    assert found["captions"] == [" A: a.ply", " B: b.egs"]
    assert found["flipped"] == [" A: a.ply", " B: b.egs, error against A"]
    assert found["where"] == [
        "view0, 1 of 2 (--view 0)",
        "moved away from view0, 1 of 2 (--view 0) (R returns)",
        "view0, 1 of 2 (--view 0)",
        "overview; 2 views",
    ]


def test_the_frame_is_outlined_in_every_pane_whatever_the_layout(found):
    assert len(found["outlined"]) == 5  # side by side, flipped twice, wiped
    assert min(found["outlined"]) > 0.95


def test_the_wipe_line_is_visible_and_can_be_dragged(found):
    assert found["line"] > 200
    assert found["dragged"] == pytest.approx(0.5 + 60 / found["wide"], abs=0.02)


def test_both_cameras_move_together(found):
    before, after = (np.array(found[key]) for key in ("at_first", "after_drag"))
    np.testing.assert_allclose(before[0], before[1], atol=1e-5)
    assert np.abs(after[0] - before[0]).max() > 0.05
    np.testing.assert_allclose(after[0], after[1], atol=1e-5)
    assert found["drag_changed"] > 1000


def test_a_drag_does_not_depend_on_events_and_is_reversible(found):
    check_drags(found["drags"])


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


@pytest.mark.thorough
def test_a_missing_driver_is_reported(display, folder):
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


@pytest.fixture(scope="module")
def files(display, folder) -> dict:
    (folder / "folder").mkdir()
    (folder / "empty.ply").touch()
    (folder / "damaged.ply").write_bytes((folder / "a.ply").read_bytes()[:5000])
    os.mkfifo(folder / "pipe.ply")
    shutil.copy(folder / "a.ply", folder / os.fsdecode(b"\xff.ply"))
    return drive("drive_files.py", display, folder)


def ends(path: Path, shown: str) -> bool:
    """Whether a path is shown, or for a long one its end."""
    return str(path).endswith(shown.removeprefix("..."))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("none.ply", "no such file"),
        ("folder/none.ply", "no such file"),
        ("empty.ply", "an empty file"),
        ("pipe.ply", "not a file"),
    ],
)
def test_a_dialog_reports_errors_of_a_path(files, folder, name, said):
    wrong = f"{folder / name}: {said}"
    typed, title, listed, *told = files[name]
    assert (typed, title) == (name, "Open a scene")
    assert ends(folder, listed)
    assert "".join("".join(told).split()) == f"{wrong}Open".replace(" ", "")  # lines are wrapped


def test_a_typed_folder_is_listed(files, folder):
    title, listed, button = files["folder"][1:]
    assert (title, button) == ("Open a scene", "Open")
    assert ends(folder / "folder", listed)


def test_a_damaged_file_is_reported_after_the_dialog(files, folder):
    title, text = files["message"]
    assert title == "Not possible"
    assert text.startswith(f"{folder / 'damaged.ply'}: element 'vertex'")


def test_the_address_of_a_file_is_pasted_and_opened(files):
    assert files["pasted"] == []
    assert files["scenes"][0] == "a.ply"


def test_names_that_are_not_unicode_are_shown_escaped(files):
    assert files["scenes"][1] == "\\udcff.ply"
    assert files["captions"][1] == " B: \\udcff.ply"
    assert files["recent"][-1].endswith("\\udcff.ply")
    assert "udcff.ply" in files["odd"][1]


def test_a_name_is_suggested_and_a_file_is_replaced_only_at_the_second_enter(files, folder):
    name, title, listed, button = files["suggested"]
    assert (name, title, button) == ("a.png", "Save a picture", "Save")
    assert ends(folder, listed)
    assert files["saved"] == []
    assert files["again"][0] == "a-2.png"
    assert files["exists"][-2:] == [
        "a.png already exists. Press Enter or Replace to overwrite it.",
        "Replace",
    ]
    assert files["kept"]
    assert files["replaced"] == []
    assert files["written"]
    assert files["a.jpg"][-2:] == ["a.jpg: suffix '.jpg', expected .png", "Save"]
    told = "".join(files["none/a.png"][-2].split())  # lines are wrapped
    assert told.endswith(f"nodirectory'{folder / 'none'}'")


def test_notices_of_empty_and_compiling_windows(files):
    empty, compiles = files["notices"]
    assert empty == "Press O to open a scene, H for a list of keys."
    assert compiles.startswith("Compiling, once only: ")


def test_an_empty_window_offers_a_dialog_and_recent_files(files, folder):
    (first, recent, *_), dialog = files["starts"]
    assert first == "Open a scene ..."
    assert ends(folder / "b.egs", recent)
    assert dialog[1] == "Open a scene"


@pytest.fixture(scope="module")
def switched(display, folder) -> dict:
    return drive("drive_exact.py", display, folder)


def test_exact_splats_are_those_of_render_whatever_draws_the_window(switched):
    mean, largest = switched["exact"]
    assert largest <= 1
    assert mean < 0.2
    assert switched["shader"][1] > 5
    assert switched["again"] == pytest.approx(switched["shader"], rel=0.01)
    shader, exact = (text.splitlines()[0] for text in switched["told"])
    assert shader == "splats: Open3D's shader"
    assert exact == "splats: our rasteriser, on the CPU"


def test_panes_are_redrawn_after_a_resize(files):
    assert files["resized"] < 0.05  # the outline of the frame


def test_a_narrow_window_has_the_panel_below_the_panes_and_cuts_nothing_off(files):
    narrow = files["narrow"]
    assert narrow["buttons"] > 50
    assert narrow["cut"] == []
    assert narrow["panes"] == [199, 200]
    assert len(narrow["parts"]) == 7
    assert min(narrow["parts"]) >= 48


@pytest.mark.parametrize(
    ("window", "em", "panel"),
    [
        ((1280, 800), 16, (928, 0, 352, 800)),
        ((528, 800), 16, (176, 0, 352, 800)),
        ((527, 800), 16, (0, 352, 527, 448)),
        ((400, 480), 16, (0, 96, 400, 384)),
        ((800, 960), 32, (0, 192, 800, 768)),  # a screen with a scale of 2
    ],
)
def test_the_panel_is_below_the_panes_if_beside_it_they_would_be_narrow(window, em, panel):
    side, panes = divided(gui.Rect(0, 0, *window), em)
    assert (side.x, side.y, side.width, side.height) == panel
    assert (panes.width, panes.height) == (panel[0] or window[0], panel[1] or window[1])


def test_a_dialog_leaves_no_trace_in_an_empty_window(files):
    assert files["ghosts"] == 0
