"""Further tests of the viewer's window, driven as in test_viewer_window.py."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from windows import check_drags, crossings, drive, make_folder, needs_display

import gs_codec
from gs_codec.edit import Action
from gs_codec.files.scenes import read_scene
from gs_codec.runtime.wording import size_text
from viewer.scenes.numbers import quality_text

pytestmark = [needs_display, pytest.mark.thorough]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return make_folder(tmp_path_factory)


@pytest.fixture(scope="module")
def found(display, folder) -> dict:
    return drive("drive_more.py", display, folder)


@pytest.mark.parametrize("layer", ["splats", "centres", "octree"])
def test_layers_are_switched_by_clicks_in_both_panes(found, layer):
    left, right, apart = found["layers"][layer]
    assert left > 100
    assert right > 100
    assert apart <= 4


@pytest.mark.parametrize(("layer", "owner"), [("pruned", 0), ("boxes", 1), ("error", 1)])
def test_layers_of_one_scene_show_only_there(found, layer, owner):
    *halves, apart = found["layers"][layer]
    assert halves[1 - owner] < halves[owner] / 10
    assert halves[owner] > 100
    assert apart <= 4


def test_appearances_and_hidden_gaussians_change_the_panes_but_no_numbers(found):
    changed = found["appearances"]
    assert min(changed[name] for name in ("background", "scale", "least opacity")) > 1000
    assert changed["teal"] > 1000
    hidden, whole = changed["hidden"]
    assert hidden < whole / 2
    assert changed["quality"] == found["quality"]
    assert changed["apart"] <= 4


def test_panes_share_no_pictures_and_leave_none_in_memory(found):
    first, second = np.array(found["pictures"]["shown"])
    assert first.argmax() == 1
    assert second.argmax() == 0
    assert found["pictures"]["left"] < 70  # of 144


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
    assert unknown.startswith(" A: a.ply, bits unk")  # as much as fits
    assert known == " B: b.egs"
    [legend] = found["octree"]["legends"]
    assert legend.startswith("bits / Gaussian, cells ")
    assert found["octree"]["after"] == 0


def test_edges_of_cells_have_the_colours_of_the_legend(found):
    assert found["octree"]["off"] <= 2


def test_a_third_scene_asks_which_to_replace(found):
    assert found["asked"] == [["a.ply", "b.egs"], ["a.ply", "b.egs"]]


@pytest.mark.parametrize("case", ["side 1 ctrl", "side 3 ", "wipe 1 ", "wipe 1 ctrl"])
def test_drags_of_all_kinds_do_not_depend_on_events_and_are_reversible(found, case):
    check_drags(found["drags"][case])


def test_scrolling_up_moves_nearer(found):
    first, nearer, again, farther = found["wheel"]
    assert nearer < again < farther
    assert again == pytest.approx(first)


def test_near_parts_are_drawn_after_a_layout(found):
    assert max(found["near"]) < 0.05


def test_a_damaged_file_is_reported_and_the_window_stays_open(found):
    title, text = found["message"]
    assert title == "Not possible"
    assert "report.json" in text


def test_loading_is_stopped(found):
    assert found["stopped"] == 2 * ["loading a.ply ...", "", "b.egs"]


@pytest.fixture(scope="module")
def edited(display, folder) -> dict:
    return drive("drive_edit.py", display, folder)


def rows_in(folder: Path, name: str, pose: list, *corners: tuple[int, int]) -> set[int]:
    """Gaussians of a file inside a polygon given by mouse pixels, computed one by one."""
    rotation, position, (fx, fy, cx, cy) = pose
    polygon = [(x + 0.5, y + 0.5) for x, y in corners]
    found = set()
    for row, point in enumerate(read_scene(folder / name).positions.T.astype(float)):
        x, y, depth = np.array(rotation) @ (point - position)
        if depth > 0.2 and crossings(fx * x / depth + cx, fy * y / depth + cy, polygon) % 2:
            found.add(row)
    return found


BOX = (60, 40), (150, 40), (150, 160), (60, 160)


def test_regions_select_their_gaussians(edited, folder):
    pose = edited["pose"]
    box = rows_in(folder, "a.ply", pose, *BOX)
    assert len(box) > 20
    assert set(edited["box"]) == box
    added = box | rows_in(folder, "a.ply", pose, (160, 60), (220, 80), (200, 200), (110, 210))
    assert len(added) > len(box)
    assert set(edited["added"]) == added
    removed = added - rows_in(folder, "a.ply", pose, (110, 100), edited["edge"], (120, 220))
    assert len(removed) < len(added)
    assert set(edited["removed"]) == removed
    number, other = edited["other"]
    assert number == 1
    assert set(other) == rows_in(folder, "b.egs", pose, *BOX)


def test_a_region_and_the_selection_are_seen(edited):
    light, dark = edited["stroke"]
    assert light > 200
    assert dark < 50
    assert edited["marked"] > 200
    assert edited["label"] == f"{len(edited['box'])} of 3,000 selected"


def test_edits_are_visible_undone_and_redone(edited):
    left = 3000 - len(edited["removed"])
    assert edited["counts"] == 3 * [3000, left]
    assert [changed > 1000 for changed in edited["changed"]] == [True, False, True, False, True]
    assert edited["changed"][1::2] == [0, 0]
    assert edited["same pose"]
    assert edited["back"]
    assert edited["quality"] == 3 * edited["quality"][:2]
    assert edited["quality"][0] != edited["quality"][1]
    assert edited["captions"] == [" A: a.ply, edited", " B: b.egs"]
    assert f"Gaussians               {left:,}\n  of the file           3,000\n" in edited["numbers"]
    assert edited["hidden"] == [len(edited["removed"]), 0]
    assert edited["hidden changed"] > 1000


@pytest.mark.parametrize(
    ("name", "action"),
    [
        ("filtered.egs", Action("filter", "opacity>=0.5")),
        ("cropped.ply", Action("crop-box", "-1.5,-1.25,-1,0.75,1,2")),
        ("cluster.ply", Action("keep-largest-cluster")),
    ],
)
def test_scenes_are_saved_like_convert(edited, folder, name, action, tmp_path):
    done = gs_codec.convert_file(folder / "a.ply", tmp_path / name, actions=[action])
    assert 100 < done.count < 3000
    assert (folder / name).read_bytes() == (tmp_path / name).read_bytes()


def test_saving_reports_and_asks(edited):
    assert edited["said"].startswith("filtered.egs saved: 2,174")
    assert edited["unsaved"] == [False, True]
    assert edited["asked"]


def test_unsaved_edits_are_asked_about(edited):
    assert edited["opened"] == [["a.ply", True], ["b.egs", False]]
    assert edited["kept"]
    assert edited["asks"]
    assert edited["closes"]


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


def test_a_window_opens_as_wide_as_its_panel(chosen):
    assert chosen["size"] == [352, 560]


def test_centres_are_shown_before_the_first_view_is_known(chosen):
    waits, drawn = chosen["preview"]
    assert waits
    assert drawn > 1


def test_estimated_views_are_visited_and_home_is_the_first_picture(chosen):
    assert chosen["where"][2] == "auto_01, 2 of 24 (--view 1)"
    assert np.abs(np.array(chosen["n"]) - chosen["at_first"]).max() > 0.05
    np.testing.assert_allclose(chosen["Home"], chosen["at_first"], atol=1e-5)
    [model] = np.array(chosen["u"])  # by -y, the axis after the cameras'
    assert model[1, 0] == pytest.approx(0, abs=1e-5)
    assert model[1, 1] < 0
    np.testing.assert_allclose(model[:3, 2], np.array(chosen["at_first"])[0, :3, 2], atol=1e-5)


def test_the_panel_reports_an_uncertain_up_axis(chosen):
    unsure, afterwards = chosen["unsure"]
    assert unsure.replace("\n", " ") == ("The up axis is uncertain: press U to choose another.")
    assert afterwards == ""


def test_a_replaced_scene_starts_at_its_own_overview(chosen):
    number, where, up = chosen["other"]
    assert (number, up) == (0, "cameras")
    assert where.startswith("overview; ")


@pytest.fixture(scope="module")
def keyed(display, folder) -> dict:
    return drive("drive_keys.py", display, folder)


def test_the_window_survives_many_sizes_and_keys(keyed):
    assert (keyed["resized"], keyed["pressed"]) == (20, 136)


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


def test_a_pick_is_described_and_marked_in_both_panes_until_escape(picked):
    assert picked["tab"] == "Pick"
    assert picked["text"].startswith("Gaussian of B\nrow, from 0")
    for heading in ("In this view, 200x150", "Error against A's", "Bits: ", "Step sizes (block "):
        assert heading in picked["text"]
    for states in ("marked", "moved"):
        first, second, elsewhere = picked[states]
        assert min(first, second) > 40
        assert elsewhere < 10
    assert picked["cleared"].startswith("Click a pixel")
    assert picked["closes"]


def test_centres_are_coloured_by_bits_on_the_scale_that_is_chosen(picked):
    found = picked["colours"]
    for colouring in ("bits", "block"):
        unknown, known = found[colouring]
        assert unknown.startswith(f" A: a.ply, {colouring} unknown: not an")  # as much as fits
        assert known == " B: b.egs"
    assert found["scales"] == [[True, "linear"], [False, None]]
    linear, blocks, log = found["legends"]
    assert blocks == ["0", "1", "2"]
    assert linear[1:-1] != log[1:-1]
    for end in (0, -1):  # round values around the same range
        assert 0.5 <= float(log[end]) / float(linear[end]) <= 2
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


def test_looking_around_does_not_move_the_camera(used):
    before, flying, after = used["looks"]
    assert flying
    np.testing.assert_allclose(after["position"], before["position"])
    assert np.abs(np.subtract(after["rotation"], before["rotation"])).max() > 0.05


def test_a_double_click_moves_its_point_to_the_middle(used):
    np.testing.assert_allclose(used["focuses"]["was"], used["focuses"]["at"], atol=1e-6)


def test_the_whole_scene_is_framed_and_the_panel_reports_the_move(used):
    assert used["focuses"]["framed"] > 0.9
    assert used["focuses"]["where"] == "moved away from view0, 1 of 2 (--view 0) (R returns)"


def test_the_slider_sets_the_field_of_view(used):
    before, after, where = used["angles"]
    assert before == pytest.approx(2 * np.degrees(np.arctan(0.5 / 0.7697777)), abs=1e-3)
    assert after > before + 5
    assert where.startswith("moved away from view0")


def test_the_chart_of_views_agrees_with_compare_and_selects_views(used, folder):
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
    assert found["afterwards"] is None  # another selection does not match that range


def test_views_are_listed_by_quality_and_visited_by_a_click(used):
    assert used["listed"] == {"order": ["view0", "view1", "overview"], "went": "view1"}


def test_cameras_photographs_reports_and_recent_files_are_opened(used):
    assert used["opens"] == {
        "where": "view1, 1 of 1 (--view 0)",
        "photographed": True,
        "layers": ["pruned", "splats"],
        "recent": ["b.egs", "a.ply", "Cancel"],
        "asked": ["Open", "Show b.egs instead of"],
    }


@pytest.fixture(scope="module")
def plugged(display, folder) -> dict:
    return drive("drive_plugin.py", display, folder)


def test_the_plugin_names_its_geometries_and_detaches(plugged):
    cameras, error = "cameras.json: cameras", "b.egs: error against a.ply"
    assert plugged["named"] == [
        ["a.ply: centres"],
        ["a.ply: kept", "a.ply: pruned"],
        [error],
        *[[error, cameras]] * 3,
        ["a.ply: centres", "a.ply: splats", cameras],
        [],
    ]
    _, opened, pruned, compared, lines, looked, nearest, splats, detached = plugged["changed"]
    assert min(opened, pruned, compared, looked, nearest, splats, detached) > 1000
    assert lines > 0  # a camera is small
    assert plugged["count"] == 3000


def test_the_plugin_shows_the_colours_of_its_legends(plugged):
    opened, pruned, compared, *_ = plugged["alike"]
    assert [matched for matched, _ in opened[:2]] == [0, 0]
    assert opened[2][0] == opened[2][1] > 1000  # every pixel has the colour of a centre
    reason, error = pruned[0][0], compared[1]
    assert 0.2 * pruned[0][1] < reason < 0.6 * pruned[0][1]  # a third of the Gaussians
    assert error[0] == error[1] > 1000


def test_the_plugin_shows_legends_and_photographs_beside(plugged, folder):
    opened, pruned, compared, *_, photograph = plugged["notes"]
    assert opened == 0
    assert min(pruned, compared) > 50  # a legend has many colours
    assert photograph > 1
    first = gs_codec.read_cameras(folder / "cameras.json")[0]
    np.testing.assert_allclose(plugged["here"], first.position, atol=1e-4)
    assert plugged["ended"]  # nothing is left open


def test_the_plugin_shows_the_background_in_transparent_parts_of_photographs(plugged):
    np.testing.assert_allclose(plugged["clear"], [0.2, 0.8, 0], atol=1e-6)


def test_the_plugin_reports_failures(plugged, folder):
    suffixes = ".png, .jpg, .jpeg, .webp, .tif, .tiff, .bmp"
    assert plugged["refused"] == {
        "compare": "no scene is open",
        "nearest": "no cameras are open",
        "photograph": f"{folder / 'images'}: no image 'view1' ({suffixes})",
        "detached": "detached from the visualizer",
    }


@pytest.fixture(scope="module")
def rated(display, folder) -> dict:
    return drive("drive_rate.py", display, folder)


def test_a_trial_becomes_b_with_the_numbers_of_the_commands(rated, folder):
    assert rated["empty"] == {"names": ["a.ply"], "lines": [], "told": ""}
    encoded, first = folder / "saved.egs", rated["m"]
    assert first["names"] == ["a.ply", "#1 m"]
    info = gs_codec.inspect(encoded)
    times = (folder / "a.ply").stat().st_size / info.file_bytes
    compared = gs_codec.compare(folder / "a.ply", encoded, str(folder / "cameras.json"))
    mean, worst = compared.mean.between, compared.worst.between
    told = first["told"].splitlines()
    assert told[0] == "#1 m"
    rows = {line[:20].strip(): line[20:].strip() for line in told[1:5]}
    assert rows["file"] == size_text(info.file_bytes)
    assert rows["source / file"] == f"{times:.1f}"
    bits = sum(stream.bits_per_gaussian for stream in info.streams)
    assert rows["bits / Gaussian"] == f"{bits:.1f}"
    assert f"  {quality_text(compared.views[0].between)}" in told
    assert "2 views against the source:" in told
    assert told[-3:] == [
        f"  mean {quality_text(mean)}",
        f"  worst {quality_text(worst)}",
        f"    in {compared.worst.name}",
    ]
    line = f"B  #1 m  {info.file_bytes / 1e3:.3g} kB  {times:.3g}x  {mean.psnr:.2f} dB"
    assert first["lines"] == [f"A  a.ply  {times * info.file_bytes / 1e3:.3g} kB", line]
    assert encoded.read_bytes() == gs_codec.encode(gs_codec.read(folder / "a.ply"))


def test_a_target_is_met_that_the_slider_chose(rated):
    shown, bits = rated["sized"], rated["bits"]
    assert 20 < bits < 80
    assert shown["names"] == ["a.ply", f"#2 s {bits:.4g} bits"]
    reached = next(line for line in shown["told"].splitlines() if line.startswith("bits"))
    assert 0.97 * bits < float(reached.split()[-1]) <= bits + 0.05
    assert f"  {rated['quality']}" in shown["told"].splitlines()


def test_panes_are_drawn_during_encoding_and_cancel_keeps_the_scenes(rated):
    assert rated["doing"].startswith("encoding: ")
    assert rated["meanwhile"] == [2, True]
    for what in ("names", "lines"):
        assert rated["stopped"][what] == rated["sized"][what]
    assert rated["files"] == ["1.egs", "2.egs"]


def test_step_sizes_are_those_that_can_be_encoded(rated):
    assert rated["coarsest"] == [[64, 64], [64, 64], [1 / 64, 1 / 64], [1, 1]]


def test_an_unreachable_target_reports_the_reachable_range(rated):
    title, text = rated["refused"]
    assert title == "Not possible"
    assert re.search(r"target 1,000 bytes: unreachable, expected [\d,]+ to [\d,]+ bytes$", text)


def test_any_two_trials_are_compared_from_the_current_pose(rated):
    both, bits = rated["both"], f"{rated['bits']:.4g}"
    assert both["names"] == ["#1 m", f"#2 s {bits} bits"]
    assert [line[0] for line in both["lines"]] == [" ", "B", "A"]
    assert both["at"] == 2
    assert both["quality"] not in rated["stopped"]["told"]
    assert rated["back"]["names"] == rated["sized"]["names"]


def test_files_of_trials_are_removed_with_the_window(rated):
    assert rated["closes"]
    assert rated["left"] == [True, False]
