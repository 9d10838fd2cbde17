"""Edits: each action against plain arithmetic, and sequences of actions."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from appearance import assert_seen_alike, matrix_of, some_turn
from scenes import DAMAGE, assert_same_bits, assert_same_floats, random_scene
from scipy.spatial.transform import Rotation

from gs_codec import edit
from gs_codec.cameras.camera import Camera
from gs_codec.edit.actions import KINDS, Action
from gs_codec.edit.apply import edit_scenes
from gs_codec.edit.join import merge_scenes
from gs_codec.edit.project_file import read_rows, rows_text
from gs_codec.encoding.combinations import check_actions
from gs_codec.errors import InvalidInput
from gs_codec.formats.cloud import from_cloud, to_cloud
from gs_codec.formats.coordinates import turn_axes
from gs_codec.metrics.image_quality import psnr
from gs_codec.plan import Plan
from gs_codec.preparation.prepare_report import centres_checksum
from gs_codec.rendering.renderer import render
from gs_codec.runtime.wording import as_typed
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene


def act(scene: Scene, *actions: str) -> Scene:
    """The scene after actions, typed as text."""
    typed = [action.split(" ", 1) for action in actions]
    return edit_scenes([scene], [Action(*each) for each in typed])[0]


def refused(*actions: str, scene: Scene | None = None) -> str:
    """The message that rejects actions."""
    with pytest.raises(InvalidInput) as error:
        act(random_scene(9, 1) if scene is None else scene, *actions)
    return as_typed(str(error.value))


def assert_chosen(scene: Scene, chosen: list[bool], edited: Scene) -> None:
    """An edited scene has the chosen Gaussians, in their order."""
    assert 0 < sum(chosen) < scene.count
    assert_same_bits(edited, scene.take(np.array(chosen)))


@pytest.fixture
def scene() -> Scene:
    extra = {"label": np.arange(500, dtype="<i4") % 7}
    return replace(random_scene(500, 2, seed=31), extra=extra, comments=("trained",))


def test_a_box_includes_its_faces(scene):
    low, high = scene.positions[:, 3].tolist(), (scene.positions[:, 3] + 0.5).tolist()
    inside = [
        all(low[k] <= point[k] <= high[k] for k in range(3)) for point in scene.positions.T.tolist()
    ]
    assert inside[3]
    assert_chosen(scene, inside, act(scene, f"crop-box {','.join(map(repr, low + high))}"))


def test_a_sphere_includes_its_surface(scene):
    scene.positions[:, :2] = [[0.0, 0.0], [0.75, 0.75], [1.0, 1.0000001]]
    inside = [math.dist(point, (0, 0, 0)) <= 1.25 for point in scene.positions.T.tolist()]
    assert inside[:2] == [True, False]
    assert_chosen(scene, inside, act(scene, "crop-sphere 0,0,0,1.25"))


def sigmoid(logit: float) -> float:
    return 1 / (1 + math.exp(-logit))


#: Conditions, and whether they hold for a Gaussian with these values.
CONDITIONS = {
    "opacity>0.05": lambda g: sigmoid(g["opacity"]) > 0.05,
    " opacity <= 5e-1 ": lambda g: sigmoid(g["opacity"]) <= 0.5,
    "scale_1<.006": lambda g: math.exp(g["scale_1"]) < 0.006,
    "longest_scale>=0.01": lambda g: math.exp(max(g[f"scale_{k}"] for k in range(3))) >= 0.01,
    "shortest_scale<1e-3": lambda g: math.exp(min(g[f"scale_{k}"] for k in range(3))) < 1e-3,
    "middle_scale>0.01": lambda g: math.exp(sorted(g[f"scale_{k}"] for k in range(3))[1]) > 0.01,
    "green>0.5": lambda g: 0.5 + g["f_dc_1"] / (2 * math.sqrt(math.pi)) > 0.5,
    "y>-0.25": lambda g: g["y"] > -0.25,
    "f_rest_11<0": lambda g: g["f_rest_11"] < 0,
    "f_dc_2>=0": lambda g: g["f_dc_2"] >= 0,
    "rot_3!=0": lambda g: g["rot_3"] != 0,
    "label==3": lambda g: g["label"] == 3,
    "label!=3": lambda g: g["label"] != 3,
}


@pytest.mark.parametrize("condition", CONDITIONS)
def test_conditions_are_in_natural_units(scene, condition):
    scene.rot[3, ::5] = 0
    names = ["x", "y", "z", *(f"f_dc_{k}" for k in range(3)), "opacity"]
    names += [f"scale_{k}" for k in range(3)] + [f"rot_{k}" for k in range(4)]
    names += [f"f_rest_{k}" for k in range(24)]
    planes = [scene.positions, scene.f_dc, scene.opacity, scene.log_scale, scene.rot, scene.f_rest]
    rows = np.concatenate(planes).T.tolist()
    gaussians = [dict(zip(names, row, strict=True)) for row in rows]
    for gaussian, label in zip(gaussians, scene.extra["label"].tolist(), strict=True):
        gaussian["label"] = label
    chosen = [CONDITIONS[condition](gaussian) for gaussian in gaussians]
    assert_chosen(scene, chosen, act(scene, f"filter {condition}"))


@pytest.mark.parametrize("compared", ["<", "<=", ">", ">=", "==", "!="])
def test_nan_satisfies_no_condition(scene, compared):
    scene.opacity[0, :3] = np.nan
    scene.opacity[0, 3] = 0.0
    left = act(scene, f"filter opacity{compared}0.5", "filter opacity<2")
    assert not np.isnan(left.opacity).any()
    # The opacity of logits this large is 0 or 1 in float64.
    scene.opacity[0, :2] = [np.inf, -np.inf]
    assert act(scene, "filter opacity>=1").count == act(scene, "filter opacity<=0").count == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("opacity", "expected an attribute, one of < <= > >= == !=, and a number"),
        ("opacity=0.5", "expected an attribute"),
        ("opacity>0.5<1", "expected an attribute"),
        ("opacity>half", "expected an attribute"),
        ("opacity!=nan", "expected an attribute"),
        (">1", "expected an attribute"),
        ("", "expected an attribute"),
        ("opacty>0.5", "no attribute 'opacty', expected one of x, y, z, f_dc_0"),
        ("f_rest_9>0", "no attribute 'f_rest_9'"),
        ("z>1e9", "no Gaussian is left of 9, bounds "),
    ],
)
def test_invalid_conditions_are_refused(text, said):
    assert refused(f"filter {text}").startswith(f"--filter {text}".rstrip() + f": {said}")


def test_nonfinite_gaussians_are_removed(scene):
    for i, (group, value) in enumerate(DAMAGE):
        getattr(scene, group)[-1, 20 * i] = value
    flat = replace(scene, opacity=scene.opacity.copy(), log_scale=scene.log_scale.copy())
    flat.opacity[0, 1::2] = np.inf
    flat.log_scale[2, 1::2] = -np.inf
    left = act(flat, "remove-nan")
    assert left.count == scene.count - len(DAMAGE)
    rows = np.concatenate([getattr(scene, group) for group in GROUPS]).T.tolist()
    finite = [all(map(math.isfinite, row)) for row in rows]
    assert_chosen(scene, finite, act(scene, "remove-nan"))


@pytest.mark.parametrize("degree", range(4))
def test_sh_above_a_degree_are_dropped(degree):
    scene = random_scene(20, 3, seed=4)
    left = act(scene, f"sh-degree {degree}")
    assert left.sh_degree == degree
    colours = scene.f_rest.reshape(3, 15, 20)[:, : SH_COEFFICIENTS[degree]]
    np.testing.assert_array_equal(left.f_rest.reshape(colours.shape), colours)
    assert act(left, "sh-degree 3").sh_degree == degree


def test_morton_order_interleaves_bits(scene):
    wide = scene.positions.T.astype(np.float64)
    cells = (wide - wide.min(axis=0)) / (wide - wide.min(axis=0)).max() * (2**21 - 1)
    codes = []
    for cell in cells.astype(int).tolist():
        bits = [f"{axis:021b}" for axis in cell]
        codes.append(int("".join(x + y + z for x, y, z in zip(*bits, strict=True)), 2))
    order = np.argsort(codes, kind="stable")
    assert_same_bits(act(scene, "sort morton"), scene.take(order))


@pytest.mark.parametrize("typed", ["30,-40,250", "0.3,-0.1,2,0.5"])
def test_rotation_is_that_of_scipy(scene, typed):
    numbers = [float(number) for number in typed.split(",")]
    known = Rotation.from_euler("xyz", numbers, degrees=True) if len(numbers) == 3 else None
    turn = (known or Rotation.from_quat([*numbers[1:], numbers[0]])).as_matrix()
    turned = act(scene, f"rotate {typed}")
    np.testing.assert_allclose(turned.positions, turn @ scene.positions, atol=1e-6)
    assert_seen_alike(scene, turned, turn)
    assert turned.extra["label"].tobytes() == scene.extra["label"].tobytes()


def test_normals_turn_with_the_scene(scene):
    normals = np.random.default_rng(1).normal(size=(3, 500)).astype(np.float32)
    kept = dict(zip(("nx", "ny", "nz"), normals, strict=True)) | {"ny": normals[1].astype("<f8")}
    moved = act(replace(scene, extra=kept | dict(scene.extra)), "rotate 30,-40,250", "scale 3")
    turn = Rotation.from_euler("xyz", [30, -40, 250], degrees=True).as_matrix()
    found = np.stack([moved.extra[name] for name in ("nx", "ny", "nz")])
    np.testing.assert_allclose(found, turn @ normals, atol=1e-6)
    assert moved.extra["ny"].dtype == np.float64
    assert moved.extra["label"] is scene.extra["label"]


@pytest.mark.parametrize("degree", range(4))
def test_a_rotation_and_its_inverse_restore_the_scene(degree):
    scene = random_scene(300, degree, seed=degree)
    quaternion = np.array([0.4, 0.3, -0.7, 0.2])
    there = ",".join(map(repr, quaternion.tolist()))
    back = ",".join(map(repr, (quaternion * [1, -1, -1, -1]).tolist()))
    again = act(scene, f"rotate {there}", f"rotate {back}")
    np.testing.assert_allclose(again.f_rest, scene.f_rest, atol=1e-6)
    np.testing.assert_allclose(again.positions, scene.positions, atol=1e-6)
    assert_seen_alike(scene, again, np.eye(3))


def test_a_rotated_scene_looks_the_same_to_rotated_cameras():
    scene = random_scene(2000, 3, seed=8)
    turn = Rotation.from_euler("xyz", [70, 20, -130], degrees=True).as_matrix()
    here = Camera("here", 90, 60, 70.0, 70.0, 45.0, 30.0, np.eye(3), np.array([0.1, 0.2, -5.0]))
    there = replace(here, rotation=here.rotation @ turn.T, position=turn @ here.position)
    images = render(scene, here).colour, render(act(scene, "rotate 70,20,-130"), there).colour
    assert images[0].std() > 0.05
    assert psnr(*images) > 60
    assert psnr(images[0], render(scene, there).colour) < 30


def test_quarter_turns_are_exact(scene):
    turned = act(scene, "rotate 0,0,90")
    np.testing.assert_array_equal(turned.positions[0], -scene.positions[1])
    np.testing.assert_array_equal(turned.positions[1], scene.positions[0])


def test_shift_and_scale(scene):
    moved = act(scene, "translate 1,-2,0.5", "scale 4")
    expected = 4 * (scene.positions + np.array([[1], [-2], [0.5]], np.float32))
    np.testing.assert_allclose(moved.positions, expected, atol=2e-6)
    np.testing.assert_allclose(np.exp(moved.log_scale), 4 * np.exp(scene.log_scale), rtol=1e-5)
    for group in ("f_dc", "f_rest", "opacity", "rot"):
        assert getattr(moved, group) is getattr(scene, group)


@pytest.mark.parametrize("form", ["rows", "three rows", "nerfstudio"])
def test_matrices_in_files(scene, tmp_path, form):
    matrix = matrix_of(some_turn(3), 0.5, [1.0, 2.0, 3.0])
    rows = matrix.tolist()
    if form == "three rows":
        rows = rows[:3]
    elif form == "nerfstudio":
        rows = {"transform": [[2 * x for x in row] for row in rows[:3]], "scale": 0.5}
    (tmp_path / "m.json").write_text(json.dumps(rows))
    moved = act(scene, f"transform {tmp_path / 'm.json'}")
    expected = matrix[:3, :3] @ scene.positions + matrix[:3, 3:]
    np.testing.assert_allclose(moved.positions, expected, atol=1e-6)


def test_matrices_are_typed_as_numbers(scene, tmp_path):
    matrix = matrix_of(some_turn(3), 0.5, [1.0, 2.0, 3.0])
    (tmp_path / "m.json").write_text(json.dumps(matrix.tolist()))
    typed = act(scene, f"transform {','.join(map(repr, matrix[:3].ravel().tolist()))}")
    assert_same_floats(typed, act(scene, f"transform {tmp_path / 'm.json'}"))
    assert "expected 12 numbers" in refused(f"transform {','.join('nan' for _ in range(12))}")


PROJECT = {
    "project": 1,
    "scenes": [{"path": "a.ply", "name": "a", "gaussians": 500}],
    "moves": [
        {"rows": "0-9,30", "matrix": [[0, 2, 0, 1], [-2, 0, 0, 0], [0, 0, 2, 0]]},
        {"rows": "30,40-499", "matrix": [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]]},
    ],
    "removed": "7,300-310",
    "hidden": "8",
}


def test_edits_of_a_project_move_and_remove_rows(scene, tmp_path):
    (tmp_path / "p.gsproj").write_text(json.dumps(PROJECT))
    done = act(scene, f"edits {tmp_path / 'p.gsproj'}")
    first = act(scene, "transform 0,2,0,1,-2,0,0,0,0,0,2,0")
    kept = np.setdiff1d(np.arange(500), [7, *range(300, 311)])
    for row, source in enumerate(kept.tolist()):
        some = first if source in (*range(10), 30) else scene
        some = some.take(np.array([source]))
        if source == 30 or source >= 40:
            some = act(some, "translate 5,0,0")
        assert_same_floats(done.take(np.array([row])), some)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"project": 2}, "version 2, expected 1"),
        ({"scenes": []}, "number of Gaussians"),
        ({"removed": "500"}, "rows 500, expected 0 to 499"),
        ({"removed": "9-3"}, "rows 9-3, expected"),
        ({"removed": "x"}, "not a project of gs-viewer"),
        ({"moves": [{"rows": "1", "matrix": [[1, 0], [0, 1]]}]}, "not a project of gs-viewer"),
        ({"moves": 5}, r"not a project of gs-viewer \(a field is missing or wrong\)"),
        ({"scenes": [{"path": "a", "name": "", "gaussians": 1e300}]}, "not a project|number"),
        ({"scenes": [{"path": "a", "name": "", "gaussians": 9}], "moves": [], "removed": "",
          "hidden": ""}, "edits of 9 Gaussians, the scene has 500"),
        ({"moves": [{"rows": "1", "matrix": [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0]]}]},
         "stretches or shears"),
    ],
)  # fmt: skip
def test_damaged_projects_are_refused(scene, tmp_path, change, said):
    (tmp_path / "p.gsproj").write_text(json.dumps({**PROJECT, **change}))
    assert re.search(said, refused(f"edits {tmp_path / 'p.gsproj'}", scene=scene))


def test_edits_of_changed_scenes_are_refused_unless_actions_came_before(scene, tmp_path):
    source = {**PROJECT["scenes"][0], "centres": centres_checksum(scene.positions)}
    (tmp_path / "p.gsproj").write_text(json.dumps({**PROJECT, "scenes": [source]}))
    edits = f"edits {tmp_path / 'p.gsproj'}"
    assert act(scene, edits).count == act(scene, "translate 1,0,0", edits).count == 488
    said = refused(edits, scene=act(scene, "translate 1,0,0"))
    assert said.endswith("a.ply: has changed since the project was saved")


def test_rows_are_written_as_runs():
    rng = np.random.default_rng(4)
    for count in (0, 1, 2, 50, 1000):
        for share in (0.0, 0.1, 0.9, 1.0):
            rows = rng.random(count) < share
            np.testing.assert_array_equal(read_rows(rows_text(rows), count), rows)
    assert rows_text(np.array([1, 1, 0, 1, 0, 0, 1], bool)) == "0-1,3,6"


@pytest.mark.parametrize(
    "text",
    ["[1, 2]", "[[1,0,0,0],[0,1,0,0]]", "{}", "nonsense", "[[1,0,0],[0,1,0],[0,0,1]]", "3",
     '[["a",0,0,0],[0,1,0,0],[0,0,1,0]]', "[" * 5000, '{"transform": 1, "scale": 1}', ""],
)  # fmt: skip
def test_files_without_a_matrix_are_refused(tmp_path, text):
    (tmp_path / "m.json").write_text(text)
    assert "expected three or four rows of four numbers" in refused(f"transform {tmp_path}/m.json")


@pytest.mark.parametrize("number", ["NaN", "1e999", f"1{'0' * 5000}", "0"])
def test_matrices_that_are_not_similarities_are_refused(tmp_path, number):
    (tmp_path / "m.json").write_text(f"[[{number},0,0,0],[0,1,0,0],[0,0,1,0]]")
    assert "stretches or shears" in refused(f"transform {tmp_path}/m.json")


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("crop-box 1,2,3", "expected 6 numbers separated by commas"),
        ("crop-box 1,1,1,0,2,2", "high: below low on an axis"),
        ("crop-box 0,0,0,nan,1,1", "expected 6 numbers"),
        ("crop-sphere 0,0,0,0", "radius 0.0: expected a number above 0"),
        ("crop-sphere 9,9,9,1", "no Gaussian is left of 9, bounds "),
        ("translate 1 2 3", "expected 3 numbers"),
        ("rotate 1,2", "expected 3 or 4 numbers"),
        ("rotate 0,0,0,0", "quaternion of norm 0"),
        ("scale 0", "factor 0: expected 1e-30 to 1e+30"),
        ("scale 1e300", "factor 1e+300: expected 1e-30 to 1e+30"),
        ("scale -1", "factor -1: expected"),
        ("scale 1,2,3", "expected 1 number"),
        ("transform none.json", "No such file"),
        ("sh-degree 4", "expected an integer from 0 to 3"),
        (f"sh-degree {'0' * 5000}", "expected an integer from 0 to 3"),
        ("sh-degree 1.5", "expected an integer from 0 to 3"),
        ("gaussians 0", "expected an integer from 1"),
        ("keep 0%", "expected a percentage above 0"),
        ("keep 101%", "expected a percentage above 0"),
        ("keep 0.5", "expected percent, for example 50% or 0.5%"),
        ("sort size", "expected morton"),
        ("remove-nan 3", "takes no value"),
    ],
)
def test_invalid_values_are_refused(typed, said):
    shown = typed.replace(" -", "=-")
    assert refused(typed).startswith(f"--{shown}: {said}")


def test_unknown_actions_are_refused():
    with pytest.raises(InvalidInput, match="action 'crop': expected one of crop-box, crop-sphere"):
        Action("crop", "1")


def test_nonfinite_centres_cannot_be_sorted(scene):
    scene.positions[0, 7] = np.nan
    assert "--remove-nan" in refused("sort morton", scene=scene)


def test_actions_are_applied_in_order(scene):
    first = act(scene, "translate 10,0,0", "crop-box 9,-9,-9,11,9,9", "translate -10,0,0")
    inside = np.abs(scene.positions[0]) <= 1
    np.testing.assert_array_equal(first.extra["label"], scene.extra["label"][inside])
    assert "no Gaussian is left" in refused(
        "crop-box 9,-9,-9,11,9,9", "translate 10,0,0", scene=scene
    )


@pytest.mark.parametrize("name", sorted(KINDS))
def test_empty_scenes_are_unchanged(name, tmp_path):
    (tmp_path / "m.json").write_text(json.dumps(matrix_of(np.eye(3), 2.0).tolist()))
    nothing = {"project": 1, "scenes": [{"path": "a.ply", "name": "", "gaussians": 0}]}
    (tmp_path / "p.gsproj").write_text(
        json.dumps({**nothing, "moves": [], "removed": "", "hidden": ""})
    )
    texts = {
        "crop-box": "0,0,0,1,1,1", "crop-sphere": "0,0,0,1", "filter": "z>0",
        "translate": "1,2,3", "rotate": "1,2,3", "scale": "2", "transform": f"{tmp_path}/m.json",
        "edits": f"{tmp_path}/p.gsproj", "sh-degree": "1", "gaussians": "5", "keep": "50%",
        "sort": "morton",
    }  # fmt: skip
    with np.errstate(all="raise"):
        assert act(random_scene(0, 2), f"{name} {texts.get(name, '')}".rstrip()).count == 0


def test_reports_count_removed_gaussians(scene):
    actions = [Action("filter", "label!=3"), Action("scale", "2")]
    _, reports = edit_scenes([scene], actions)
    kept = int(np.count_nonzero(scene.extra["label"] != 3))
    assert [(r.action, r.before, r.after, r.details) for r in reports] == [
        ("filter label!=3", 500, kept, {}),
        ("scale 2", kept, kept, {}),
    ]


def test_actions_are_applied_in_rdf():
    scene = random_scene(60, 1, seed=6)
    up = turn_axes(scene, "RUB")
    assert up.coordinates == "RUB"
    assert_same_bits(
        replace(act(up, "crop-box -9,0,-9,9,9,9"), comments=()),
        act(scene, "crop-box -9,0,-9,9,9,9"),
    )


def test_edited_scenes_state_no_order(scene):
    ordered = replace(scene, comments=("gs_codec order floats", "other"))
    assert act(ordered, "filter label!=3").comments == ("other",)
    assert act(ordered, "scale 2").comments == ("other",)


def test_scenes_are_merged(caplog):
    one = replace(random_scene(40, 1, seed=1), comments=("one", "both"), has_normals=True)
    two = replace(random_scene(30, 3, seed=2), comments=("both", "two"))
    both = merge_scenes([one, two])
    assert (both.count, both.sh_degree) == (70, 3)
    assert both.comments == ("one", "both", "two")
    assert not both.has_normals
    for group in ("positions", "f_dc", "opacity", "log_scale", "rot"):
        parts = [getattr(each, group) for each in (one, two)]
        np.testing.assert_array_equal(getattr(both, group), np.concatenate(parts, axis=1))
    rest = both.f_rest.reshape(3, 15, 70)
    np.testing.assert_array_equal(rest[:, :3, :40], one.f_rest.reshape(3, 3, 40))
    assert not rest[:, 3:, :40].any()
    np.testing.assert_array_equal(rest[:, :, 40:], two.f_rest.reshape(3, 15, 30))
    assert not caplog.messages
    merge_scenes([one, replace(two, comments=("SplatRenderMode: mip",))])
    assert "merged scenes differ in antialiasing; all are rendered without" in caplog.messages[0]


def test_merged_scenes_are_flat_or_have_an_offset_if_all_do(caplog):
    flat, near, far = "SplatRenderMode: 2dgs", "CoordinateOffset: 1 2 3", "CoordinateOffset: 4 5 6"

    def comments(*each: tuple[str, ...]) -> tuple[str, ...]:
        return merge_scenes([replace(random_scene(9, 0), comments=own) for own in each]).comments

    assert comments((flat, near), (near, flat), (flat,)) == (near, flat)
    assert comments((flat,), ()) == ()
    assert not caplog.messages
    assert comments((near, "one"), (far,)) == ("one",)
    assert caplog.messages == [
        "merged scenes differ in CoordinateOffset, so it is dropped; none is moved"
    ]


def test_scenes_of_two_systems_are_merged_in_rdf():
    one, two = random_scene(4, 2, seed=1), random_scene(5, 2, seed=2)
    both, _ = edit_scenes([turn_axes(one, "RUB"), two], [])
    assert both.coordinates == "RDF"
    assert_same_bits(replace(both, comments=()), merge_scenes([one, two]))


def test_properties_missing_in_a_merged_scene_are_dropped(scene, caplog):
    other = replace(scene, extra={})
    wide = replace(scene, extra={"label": scene.extra["label"].astype("<f4")})
    for scenes in ([scene, other], [other, scene], [scene, wide]):
        assert merge_scenes(scenes).extra == {}
    assert {line.rpartition(": ")[2] for line in caplog.messages} == {"properties label"}
    caplog.clear()
    both = merge_scenes([scene, scene])
    np.testing.assert_array_equal(both.extra["label"], np.tile(scene.extra["label"], 2))
    assert caplog.messages == []


@pytest.mark.parametrize(
    ("actions", "plan", "limited", "coded", "said"),
    [
        ([], Plan(cameras="c.json"), True, True, None),
        (["scale 2"], Plan(), False, True, None),
        (["scale 2"], None, True, True, None),
        (["scale 2"], Plan(cameras="c.json"), False, False, None),
        (["keep 9%", "scale 2"], Plan(cameras="c.json"), False, False, None),
        (
            ["scale 2"],
            Plan(cameras="c.json"),
            False,
            True,
            "--scale 2: the given cameras do not fit the moved scene",
        ),
        (
            ["scale 2", "keep 9%"],
            Plan(cameras="c.json"),
            False,
            False,
            "no longer fit after --scale 2",
        ),
        (["scale 2", "keep 9%"], Plan(), False, False, None),
        (["keep 9%"], None, True, False, "--keep 9%: needs the whole scene in memory"),
    ],
)
def test_actions_are_refused_in_some_combinations(actions, plan, limited, coded, said):
    typed = [Action(*action.split(" ")) for action in actions]
    if said is None:
        check_actions(typed, plan, limited, coded)
        return
    with pytest.raises(InvalidInput) as error:
        check_actions(typed, plan, limited, coded)
    assert said in as_typed(str(error.value))


#: Functions on clouds, and the equivalent actions.
FUNCTIONS = {
    "crop-box -1,-1,-1,1,1,1": lambda cloud: edit.crop_box(cloud, (-1, -1, -1), (1, 1, 1)),
    "crop-sphere 0,0,0,1": lambda cloud: edit.crop_sphere(cloud, (0, 0, 0), 1),
    "filter opacity>0.5": lambda cloud: edit.select(cloud, "opacity>0.5"),
    "remove-nan": edit.remove_nonfinite,
    "sh-degree 1": lambda cloud: edit.limit_sh_degree(cloud, 1),
    "sort morton": edit.sort_morton,
    "translate 1,2,3": lambda cloud: edit.translate(cloud, (1, 2, 3)),
    "rotate 30,40,50": lambda cloud: edit.rotate(cloud, (30, 40, 50)),
    "rotate 1,2,3,4": lambda cloud: edit.rotate(cloud, (1, 2, 3, 4)),
    "scale 3": lambda cloud: edit.scale(cloud, 3),
}


@pytest.mark.parametrize("action", FUNCTIONS)
def test_functions_on_clouds_do_the_same(scene, action):
    scene = replace(scene, comments=())
    cloud = to_cloud(scene)
    before = {name: cloud.point[name].numpy().copy() for name in cloud.point}
    edited = FUNCTIONS[action](cloud)
    expected = replace(act(scene, action), comments=())
    assert_same_bits(from_cloud(edited, "keep"), expected)
    for name in edited.point:
        edited.point[name] *= 0
    for name, values in before.items():
        np.testing.assert_array_equal(cloud.point[name].numpy(), values)


def test_clouds_are_merged(scene):
    clouds = [to_cloud(scene), to_cloud(scene.take(np.arange(3)))]
    expected = merge_scenes([scene, scene.take(np.arange(3))])
    assert_same_bits(from_cloud(edit.merge(clouds), "keep"), replace(expected, comments=()))
    edit.merge(clouds[:1]).translate([1, 2, 3])
    np.testing.assert_array_equal(clouds[0].point.positions.numpy().T, scene.positions)
    with pytest.raises(InvalidInput, match="no scenes, expected at least one"):
        edit.merge([])


@pytest.mark.parametrize(
    "call",
    [
        lambda cloud: edit.translate(cloud, (1, 2)),
        lambda cloud: edit.rotate(cloud, (1, 2)),
        lambda cloud: edit.scale(cloud, math.inf),
        lambda cloud: edit.crop_box(cloud, (0, 0, 0), (1, 1, math.nan)),
        lambda cloud: edit.select(cloud, "opacity"),
        lambda cloud: edit.limit_sh_degree(cloud, 4),
    ],
)
def test_functions_on_clouds_refuse(scene, call):
    with pytest.raises(InvalidInput, match="expected"):
        call(to_cloud(scene))


def test_no_module_hides_a_public_name():
    modules = {path.stem for path in Path(edit.__file__).parent.glob("*.py")}
    assert not modules & set(edit.__all__)
