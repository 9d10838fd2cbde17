"""Colours of centres: quantities, scales, one range for all scenes, unknown values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import encode_by, made_up_guide, random_scene

import gs_codec
from gs_codec.codecs import encode_scene
from gs_codec.codecs.adaptive.costs import gaussian_classes
from gs_codec.config import Config
from gs_codec.egs.egs_file import read_file
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from gs_codec.views import estimate as auto_cameras
from viewer.pictures.centres import KINDS, centres
from viewer.pictures.layers import UNKNOWN, block_colour, heat, reason_colour
from viewer.pictures.picture import Shown
from viewer.pictures.screenshot import draw_request
from viewer.pictures.ticks import scale_marks
from viewer.scenes.choice import COLOURINGS, SCALED, Choice
from viewer.scenes.opened import Opened, open_scene
from viewer.scenes.view_request import Request

COUNT = 2500


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene, its encodings, and one without SH-AC."""
    folder = tmp_path_factory.mktemp("centres")
    scene = random_scene(COUNT, 2, seed=60)
    write_ply(folder / "a.ply", scene)
    write_ply(folder / "flat.ply", random_scene(40, 0, seed=61))
    configs = {
        "blocks": Config("m", block_size=1024),
        "paper": Config("paper-m"),
        "ordered": Config("lossless", keep_order=True),
    }
    for name, config in configs.items():
        (folder / f"{name}.egs").write_bytes(encode_scene(scene, config)[0])
    (folder / "guided.egs").write_bytes(encode_by(scene, Config("m"), made_up_guide()))
    return folder


def values_of(scene: Opened, colouring: str) -> np.ndarray:
    """A quantity computed directly from the cloud and the file."""
    point = scene.cloud.point
    if colouring == "opacity":
        return 1 / (1 + np.exp(-point["opacity"].numpy()[:, 0].astype(float)))
    if colouring == "scale":
        return np.exp(point["log_scale"].numpy().astype(float)).max(axis=1)
    if colouring == "sh":
        return np.sum(point["f_rest"].numpy().astype(float) ** 2, axis=(1, 2))
    return scene.bits


RANGES = {"scale": (0.01, 0.99), "bits": (0.02, 0.98), "sh": (0.02, 0.98)}


@pytest.mark.parametrize("scale", ["linear", "log"])
@pytest.mark.parametrize("colouring", ["opacity", "scale", "bits", "sh"])
def test_magnitudes_are_heat_on_the_scale_chosen(files, colouring, scale):
    scenes = [open_scene(files / name) for name in ("guided.egs", "blocks.egs")]
    every = [values_of(scene, colouring) for scene in scenes]
    low, high = (0.0, 1.0) if scale == "linear" else (1e-4, 1.0)
    if colouring in RANGES:
        both = np.concatenate(every)
        both = both[both > 0] if scale == "log" else both
        low, high = np.quantile(both, RANGES[colouring])
    marks = scale_marks(low, high, scale)
    low, high = marks[0], marks[-1]
    found = [centres(scene, colouring, scenes, scale=scale) for scene in scenes]
    for points, values in zip(found, every, strict=True):
        if scale == "log":
            values, ends = np.log(np.maximum(values, 1e-30)), np.log([low, high])
        else:
            ends = low, high
        np.testing.assert_allclose(points.colours, heat(values, *ends), atol=1e-4)
    assert found[0].legend == found[1].legend
    told = [float(mark.replace(",", "")) for mark in found[0].legend.marks]
    np.testing.assert_allclose(told, marks, rtol=6e-3, atol=1e-3 * (low == 0))
    assert len(np.unique(found[0].colours, axis=0)) > 100


@pytest.mark.parametrize("colouring", SCALED)
def test_the_default_scale_is_documented(files, colouring):
    scenes = [open_scene(files / name) for name in ("guided.egs", "blocks.egs")]
    default = centres(scenes[0], colouring, scenes)
    asked = centres(scenes[0], colouring, scenes, scale=SCALED[colouring])
    np.testing.assert_array_equal(default.colours, asked.colours)
    [other] = {"linear", "log"} - {SCALED[colouring]}
    differs = centres(scenes[0], colouring, scenes, scale=other)
    assert np.abs(differs.colours - default.colours).max() > 0.1
    assert differs.legend != default.legend
    assert Choice({"centres"}, colouring, "side").scale == SCALED[colouring]


def test_linear_errors_end_at_64_levels(files):
    scene = open_scene(files / "a.ply")
    f_dc = scene.cloud.point["f_dc"].numpy().copy()
    cloud = scene.cloud.clone()
    shift = np.float32(16 / 255 / 0.28209479)
    cloud.point["f_dc"] = type(cloud.point["f_dc"])(np.where(f_dc > 0, f_dc - shift, f_dc + shift))
    other = Opened("other", cloud)
    points = centres(other, "error", [scene, other], scale="linear")
    assert points.legend.marks == ("0", "16", "32", "48", "64")
    unclipped = ((scene.colours > 0.1) & (scene.colours < 0.9)).all(axis=1)
    assert unclipped.sum() > 100
    np.testing.assert_allclose(
        points.colours[unclipped], np.tile(heat(16.0, 0, 64), (unclipped.sum(), 1)), atol=1e-3
    )


def test_classes_are_those_of_the_file(files):
    scene = open_scene(files / "guided.egs")
    points = centres(scene, "class", [scene])
    shape = gaussian_classes(read_file((files / "guided.egs").read_bytes()))[0]
    assert len(np.unique(shape)) > 4
    last = float(points.legend.marks[-1])
    assert last >= shape.max()
    assert last % 4 == 0
    np.testing.assert_allclose(points.colours, heat(shape, 0, last), atol=1e-6)


def test_blocks_have_colours_of_their_own_and_those_of_their_boxes(files):
    scene = open_scene(files / "blocks.egs")
    points = centres(scene, "block", [scene])
    size = scene.info.block_size
    for k in range(3):
        block = points.colours[k * size : (k + 1) * size]
        assert (block == np.float32(block_colour(k))).all()
    assert points.legend.marks == ("0", "1", "2")
    assert points.legend.kinds == tuple(map(block_colour, range(3)))
    np.testing.assert_allclose(points.legend.bar(300, 2)[1, ::100], points.legend.kinds, atol=1e-6)
    assert points.legend.places.tolist() == pytest.approx([1 / 6, 0.5, 5 / 6])


def test_many_blocks_are_not_all_listed(files):
    scene = open_scene(files / "blocks.egs")
    many = replace(scene, info=replace(scene.info, block_size=100))
    legend = centres(many, "block", [many]).legend
    assert legend.title == "block, of 25: the first 8"
    assert len(legend.marks) == len(legend.kinds) == KINDS == 8


def luminances(colour) -> np.ndarray:
    """A colour as seen without long, middle and short cones (Machado 2009), linear."""
    matrices = [
        [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
        [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
        [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
    ]
    return np.array(matrices) @ np.power(colour, 2.2)


def test_kinds_differ_for_the_colour_blind():
    """The colours of reasons, and of the first seven blocks."""
    assert reason_colour(0) == block_colour(0)
    seen = np.array([luminances(block_colour(k)) for k in range(7)])
    for blindness in range(3):
        apart = np.linalg.norm(seen[:, None, blindness] - seen[None, :, blindness], axis=-1)
        assert apart[~np.eye(7, dtype=bool)].min() > 0.06
    assert len({block_colour(k) for k in range(21)}) == 21


@pytest.mark.parametrize(
    ("name", "colouring", "reason"),
    [
        ("a.ply", "bits", "not an .egs file"),
        ("a.ply", "block", "not an .egs file"),
        ("a.ply", "class", "not an .egs file"),
        ("paper.egs", "class", "of profile paper-m"),
        ("ordered.egs", "bits", "stored in the original order"),
        ("flat.ply", "sh", "of SH degree 0"),
    ],
)
def test_unknown_values_are_grey_and_the_caption_says_why(files, name, colouring, reason):
    scene, other = open_scene(files / name), open_scene(files / "guided.egs")
    scenes = (scene, other)
    points = centres(scene, colouring, scenes)
    assert points.legend is None
    assert (points.colours == np.float32(UNKNOWN)).all()
    assert centres(other, colouring, scenes).legend is not None
    shown = Shown(("centres",), colouring, scenes)
    assert shown.captions == [f"A: {name}, {colouring} unknown: {reason}", "B: guided.egs"]
    assert replace(shown, layers=("splats",)).captions == [f"A: {name}", "B: guided.egs"]
    with pytest.raises(gs_codec.GsCodecError, match=f"colour {colouring}: {name} is {reason}"):
        draw_request(Request(files / name, layers=("centres",), colouring=colouring))


def test_a_file_that_has_changed_is_refused(files, tmp_path):
    path = tmp_path / "scene.egs"
    path.write_bytes((files / "guided.egs").read_bytes())
    scene = open_scene(path)
    path.write_bytes(gs_codec.encode(to_cloud(random_scene(9))))
    with pytest.raises(gs_codec.GsCodecError, match="changed after it was opened"):
        centres(scene, "class", [scene])


@pytest.mark.thorough
@pytest.mark.parametrize("colouring", COLOURINGS)
def test_screenshots_are_coloured_by_each(files, colouring, monkeypatch):
    # The camera position does not matter here.
    monkeypatch.setattr(auto_cameras, "_OVERVIEWS", 8)
    monkeypatch.setattr(auto_cameras, "_LEAST_TRIED", 24)
    request = Request(
        files / "guided.egs", files / "blocks.egs", layers=("centres",), colouring=colouring,
        size=(240, 120),
    )  # fmt: skip
    request.check()
    image = np.asarray(draw_request(request)[0])
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 10
    if colouring in SCALED:
        [other] = {"linear", "log"} - {SCALED[colouring]}
        changed = np.asarray(draw_request(replace(request, scale=other))[0])
        assert (image != changed).any(axis=2).sum() > 100


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"scale": "cubic", "colouring": "bits"}, "colour-scale 'cubic': expected linear, log"),
        ({"scale": "log", "colouring": "block"}, "colour-scale: expected colour opacity, scale"),
        ({"scale": "linear"}, "colour-scale: expected colour"),
        ({"colouring": "error"}, "colour error: expected two scenes"),
    ],
)
def test_invalid_options_are_refused(wrong, said):
    with pytest.raises(gs_codec.GsCodecError, match=said):
        Request(**({"a": Path("a.ply")} | wrong)).check()
