"""Rendered comparisons: image metrics, selected views, and written files."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scenes import random_scene, shared_scene_path
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras import image_files
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import find_image, output_names, read_image, write_png
from gs_codec.cli.main import app
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import read_scene
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.comparison import Comparison, table_of
from gs_codec.metrics.image_quality import Quality, compare_images, mean_quality
from gs_codec.metrics.views import DIFFERENCE_GAIN, View, compare_views
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.reference_views import photographed
from gs_codec.preparation.view_selection import choose_views
from gs_codec.rendering.renderer import render, write_views
from gs_codec.views.find import find_cameras


def camera(name="view", width=40, height=30, position=(0.0, 0.0, -5.0), split=None) -> Camera:
    return Camera(
        name, width, height, 40.0, 40.0, width / 2, height / 2, np.eye(3), np.array(position), split
    )


@pytest.fixture(scope="module")
def pair():
    """A scene, and the same with other colours."""
    scene = random_scene(300, 1, seed=90)
    return scene, replace(scene, f_dc=scene.f_dc + np.float32(0.1))


# Image metrics


def test_psnr_of_a_known_difference():
    image = np.full((20, 30, 3), 0.25)
    assert compare_images(image, image + 0.1).psnr == pytest.approx(20)
    assert compare_images(image, image + 0.01).psnr == pytest.approx(40)


def test_equal_images_are_equal_whatever_lies_beyond_white():
    image = np.random.default_rng(91).random((16, 16, 3))
    assert compare_images(image, image) == Quality(math.inf, pytest.approx(1.0))
    assert compare_images(image + 1.5, image + 1).psnr == math.inf


@pytest.mark.parametrize("kind", ["u1", "u2", "i8", "?"])
def test_images_of_other_numbers_than_floats_are_refused(kind):
    image = np.zeros((20, 30, 3))
    with pytest.raises(InvalidInput, match=rf"image of {np.dtype(kind)}, expected floats"):
        compare_images(image, image.astype(kind))


@pytest.mark.parametrize("background", [(1.0,), (1.0,) * 4, (0.0, 0.0, math.nan), np.eye(3)])
def test_a_background_is_three_finite_numbers(background):
    scene = random_scene(20, 0, seed=94)
    for start in (
        lambda: list(gs_codec.render(to_cloud(scene), [camera()], background=background)),
        lambda: gs_codec.Plan(background=background),
    ):
        with pytest.raises(InvalidInput, match="background: expected 3 finite numbers"):
            start()


def test_psnr_of_yuv_is_that_of_its_planes():
    """Known for one colour: a plane of constant error d has -20 log10 |d| dB."""
    image = np.full((20, 30, 3), 0.25)
    grey = compare_images(image, image + 0.1).psnr_yuv
    assert grey == pytest.approx((6 * 20 + 100 + 100) / 8)
    blue = compare_images(image, image + np.array([0, 0, 0.1])).psnr_yuv
    errors = 0.1 * np.array([0.0722, 0.5, 0.0722 / 1.5748])
    assert blue == pytest.approx(np.average(-20 * np.log10(errors), weights=[6, 1, 1]))


def test_only_pixels_of_a_mask_are_compared():
    rng = np.random.default_rng(93)
    image = rng.random((30, 40, 3))
    mask = np.zeros((30, 40), bool)
    mask[8:20, 10:30] = True
    other = np.where(mask[..., None], image + 0.1 * (image < 0.5), rng.random(image.shape))
    found = compare_images(image, other, mask=mask)
    inside = np.mean((image - other)[mask] ** 2)
    assert found.psnr == pytest.approx(-10 * np.log10(inside))
    other[~mask] = 0
    assert compare_images(image, other, mask=mask) == found
    same = compare_images(np.where(mask[..., None], image, 0), image, mask=mask)
    assert (same.psnr, same.ssim, same.psnr_yuv) == (math.inf, pytest.approx(1), math.inf)
    for bad, message in ((mask[1:], "mask of shape"), (mask & False, "mask has no pixel")):
        with pytest.raises(InvalidInput, match=message):
            compare_images(image, other, mask=bad)


@pytest.mark.parametrize(("height", "width"), [(11, 11), (11, 17), (29, 12)])
def test_ssim_follows_its_definition(height, width):
    rng = np.random.default_rng(92)
    a, b = rng.random((2, height, width, 3))
    offsets = np.arange(-5, 6)
    line = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(line, line)[..., None] / line.sum() ** 2
    values = []
    for y in range(5, height - 5):
        for x in range(5, width - 5):
            p, q = (i[y - 5 : y + 6, x - 5 : x + 6] for i in (a, b))
            mp, mq = ((window * i).sum((0, 1)) for i in (p, q))
            vp, vq = (window * p * p).sum((0, 1)) - mp**2, (window * q * q).sum((0, 1)) - mq**2
            cov = (window * p * q).sum((0, 1)) - mp * mq
            luminance = (2 * mp * mq + 1e-4) / (mp**2 + mq**2 + 1e-4)
            values.append(luminance * (2 * cov + 9e-4) / (vp + vq + 9e-4))
    assert compare_images(a, b).ssim == pytest.approx(np.mean(values), abs=1e-12)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [((20, 20), (20, 21), "20x20 and 21x20"), ((10, 30), (10, 30), "30x10 pixels, expected")],
)
def test_images_that_cannot_be_compared(first, second, message):
    with pytest.raises(InvalidInput, match=message):
        compare_images(np.zeros((*first, 3)), np.zeros((*second, 3)))


def test_means_and_differences_of_qualities():
    a, b = Quality(30.0, 0.9, 0.2), Quality(20.0, 0.7, 0.5)
    assert mean_quality([a, b]) == Quality(25.0, pytest.approx(0.8), pytest.approx(0.35))
    assert mean_quality([a, Quality(10.0, 0.5)]).lpips is None
    assert b.over(a) == Quality(-10.0, pytest.approx(-0.2), pytest.approx(0.3), 0.0)
    same = Quality(math.inf, 1.0)
    assert same.over(same) == Quality(0.0, 0.0, None, 0.0)
    yuv = [Quality(30.0, 0.9, None, psnr) for psnr in (31.0, 33.0)]
    assert mean_quality(yuv).psnr_yuv == 32
    assert yuv[1].over(yuv[0]).psnr_yuv == 2
    assert mean_quality([same, a]) == Quality(30.0, pytest.approx(0.95), None, math.inf)
    assert mean_quality([same, same]).psnr == math.inf
    assert math.isnan(mean_quality([same, Quality(math.nan, 0.0)]).psnr)
    views = tuple(View("x", each) for each in (same, Quality(30.0, 0.9), same))
    mean, _ = table_of(Comparison((1, 1), views=views)).rows[-2:]
    assert mean == ["mean (PSNR without 2 equal)", "30.000", "0.96667"]


# Comparing rendered views


def test_views_are_those_of_the_renderer(pair):
    views = compare_views(*pair, [camera("a"), camera("b", position=(1.0, 0.0, -4.0))]).views
    assert [view.name for view in views] == ["a", "b"]
    images = [render(scene, camera("a")).colour for scene in pair]
    assert views[0].between == compare_images(*images)
    assert views[0].between.psnr < 50


def test_a_scene_is_identical_to_itself(pair):
    result = compare_views(pair[0], pair[0], [camera()])
    assert result.mean.between.psnr == math.inf
    assert result.mean.between.ssim == pytest.approx(1.0)


def test_scenes_with_different_numbers_of_gaussians_are_compared(pair):
    result = compare_views(pair[0], pair[0].take(np.arange(200)), [camera()])
    assert result.counts == (300, 200)
    assert result.mean.between.psnr < 60


def test_worst_and_mean_view():
    views = [View(n, Quality(p, p / 100)) for n, p in (("a", 30.0), ("b", 20.0), ("c", 20.0))]
    result = compare_views(random_scene(1), random_scene(1), [camera()])
    result = replace(result, views=tuple(views))
    assert result.worst.name == "b"
    assert result.mean.between.psnr == pytest.approx(70 / 3)
    assert result.mean.delta is None


def test_ground_truth_gives_the_papers_deltas(pair, tmp_path):
    truth = render(pair[0], camera().resized(20, 15)).colour
    write_png(tmp_path / "view.png", truth)
    [view] = compare_views(*pair, [camera("view.jpg")], truth=tmp_path).views
    stored = read_image(tmp_path / "view.png")
    for scene, quality in zip(pair, (view.first, view.second), strict=True):
        image = render(scene, camera().resized(20, 15)).colour
        assert quality == compare_images(image, stored)
    assert view.first.psnr > 50  # the ground truth, up to 8 bits
    assert view.delta.psnr == view.second.psnr - view.first.psnr < 0
    assert view.delta.ssim == view.second.ssim - view.first.ssim


@pytest.mark.parametrize("background", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
def test_transparent_ground_truth_shows_the_background(pair, tmp_path, background):
    drawn = render(pair[0], camera())
    alpha = drawn.alpha[..., None]
    colour = np.clip(drawn.colour / np.maximum(alpha, 1e-6), 0, 1)
    levels = np.rint(255 * np.concatenate([colour, alpha], axis=2)).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "view.png")
    plan = Plan(cameras=[camera()], gt_images=tmp_path, background=background)
    [view] = compare_views(*pair, [camera()], truth=tmp_path, background=background).views
    assert view.first.psnr > 40
    assert choose_views(pair[0], plan).held_out.quality(pair[0]).psnr > 40


def test_ground_truth_of_another_shape_is_refused(pair, tmp_path):
    write_png(tmp_path / "view.png", np.zeros((40, 30, 3)))
    with pytest.raises(InvalidInput, match=r"view.png: 30x40 pixels, expected the shape of 40x30"):
        compare_views(*pair, [camera()], truth=tmp_path)


def test_images_of_a_comparison(pair, tmp_path):
    compare_views(*pair, [camera("left/one.jpg")], images=tmp_path / "new" / "folder")
    folder = tmp_path / "new" / "folder"
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["left_one_a.png", "left_one_b.png", "left_one_difference.png"]
    a, b, difference = (255 * read_image(folder / name).astype(np.float64) for name in names)
    np.testing.assert_allclose(difference, np.clip(DIFFERENCE_GAIN * abs(a - b), 0, 255), atol=11)
    assert difference.max() > 20
    expected = 255 * np.clip(render(pair[0], camera()).colour, 0, 1)
    np.testing.assert_allclose(a, expected, atol=0.501)


def test_metadata_switches_compensation_on(pair):
    small = replace(pair[0], log_scale=pair[0].log_scale - 2)
    marked = replace(small, comments=("SplatRenderMode: mip",))
    assert compare_views(small, marked, [camera()]).mean.between.psnr < 50
    plain = render(marked, camera(), antialiased=False).colour
    np.testing.assert_array_equal(plain, render(small, camera()).colour)


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ((), False),
        (("SplatRenderMode: mip",), True),
        (("Exported from Brush", "  splatrendermode:MIP "), True),
        (("SplatRenderMode: default",), False),
        (("antialiased 1",), True),
        (("antialiased 0",), False),
        (("antialiased 1", "SplatRenderMode: default"), False),
        (("SplatRenderMode: default", "antialiased 1"), True),
        (("not antialiased 1",), False),
    ],
)
def test_comments_on_the_training_of_a_scene(comments, expected):
    assert replace(random_scene(1), comments=comments).antialiased is expected


def test_compensation_survives_the_codec(tmp_path):
    scene = replace(random_scene(50), comments=("SplatRenderMode: mip",))
    write_ply(tmp_path / "scene.ply", scene)
    gs_codec.encode_file(tmp_path / "scene.ply", tmp_path / "scene.egs")
    assert read_scene(tmp_path / "scene.egs").antialiased


# Which cameras


def test_splits():
    views = [camera("a", split="train"), camera("b", split="test"), camera("c")]
    scene = random_scene(1)

    def names(split, cameras=views):
        return [view.name for view in find_cameras(cameras, scene, split)]

    assert names("all") == ["a", "b", "c"]
    assert names("test") == names("held-out") == ["b"]
    assert names("train") == ["a"]
    assert names("held-out", views[::2]) == ["a", "c"]
    with pytest.raises(InvalidInput, match="cameras: none, expected at least one"):
        find_cameras([], scene)
    with pytest.raises(InvalidInput, match="none of the 1 is marked 'test'"):
        names("test", views[2:])
    with pytest.raises(InvalidInput, match="split 'best': expected one of held-out"):
        names("best")


def test_width_scales_the_whole_camera():
    [view] = find_cameras([camera(width=400, height=266)], random_scene(1), width=200)
    assert (view.width, view.height) == (200, 133)
    assert (view.fx, view.cx, view.fy, view.cy) == (20.0, 100.0, 20.0, 66.5)
    for width in (0, -3, 1 << 20):
        with pytest.raises(InvalidInput, match="width"):
            find_cameras([camera()], random_scene(1), width=width)


# Images in files


def test_images_are_found_by_name_with_any_suffix(tmp_path):
    (tmp_path / "sub").mkdir()
    for name in ("a.png", "sub/b.JPG", "c.v1.png"):
        Image.new("RGB", (2, 2)).save(tmp_path / name)
    assert find_image(tmp_path, "a") == tmp_path / "a.png"
    assert find_image(tmp_path, "a.jpg") == tmp_path / "a.png"
    assert find_image(tmp_path, "sub/b.png") == tmp_path / "sub/b.JPG"
    assert find_image(tmp_path, "c.v1") == tmp_path / "c.v1.png"
    with pytest.raises(InvalidInput, match="no image 'd'"):
        find_image(tmp_path, "d")
    with pytest.raises(InvalidInput, match="no such folder, expected images"):
        find_image(tmp_path / "none", "a")


@pytest.mark.parametrize(
    ("name", "stem"),
    [("a.jpg", "a"), ("x/y.png", "x_y"), ("../../etc/p.png", "_.._etc_p"), ("/root/a", "_root_a"),
     ("..", "_"), ("c:\\d.png", "c:_d"), ("v1.5", "v1.5"), ("a\0\x1b\n\u202eb", "a____b")],
)  # fmt: skip
def test_output_names_stay_in_the_folder(name, stem):
    assert output_names([camera(name)]) == [stem]
    assert "/" not in stem


def test_output_names_of_windows_lead_to_no_drive_or_stream(monkeypatch):
    monkeypatch.setattr(image_files.os, "sep", "\\")
    names = output_names([camera("c:\\d.png"), camera("photo:stream")])
    assert names == ["c__d", "photo_stream"]


NAMES_OUTSIDE = ("../secret", "../secret.png", "sub/../../secret.jpg", "..\\secret", "..")


@pytest.mark.parametrize("name", [*NAMES_OUTSIDE, "{}", "{}.png"])
def test_names_outside_the_image_folder_are_refused(name, tmp_path):
    folder = tmp_path / "images"
    (folder / "sub").mkdir(parents=True)
    Image.new("RGB", (40, 30)).save(tmp_path / "secret.png")
    Image.new("RGB", (40, 30)).save(folder / "view.png")
    name = name.format(tmp_path / "secret")
    with pytest.raises(InvalidInput, match="expected a name inside the folder") as caught:
        find_image(folder, name)
    assert "\n" not in str(caught.value)
    with pytest.raises(InvalidInput, match="expected a name inside the folder"):
        photographed([camera("view"), camera(name)], folder)


def test_images_may_be_links(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    Image.new("RGB", (40, 30)).save(tmp_path / "elsewhere.png")
    (folder / "view..1.png").symlink_to(tmp_path / "elsewhere.png")
    assert find_image(folder, "view..1") == folder / "view..1.png"


def test_output_names_that_cameras_share_are_numbered(caplog):
    assert output_names([camera("a/b.jpg"), camera("c"), camera("a_b")]) == ["a_b_1", "c", "a_b_2"]
    assert caplog.messages == [
        "2 cameras with equal names: their files are numbered, for example a_b_1"
    ]
    names = ["a", "a_1", "a", "b", "a", "b"]
    assert output_names(list(map(camera, names))) == ["a_2", "a_1", "a_3", "b_1", "a_4", "b_2"]


def test_transparent_pixels_are_black(tmp_path):
    Image.fromarray(np.full((4, 4, 4), [200, 100, 50, 0], np.uint8), "RGBA").save(
        tmp_path / "a.png"
    )
    assert not read_image(tmp_path / "a.png").any()


@pytest.mark.parametrize("content", [b"", b"no image", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_broken_images_are_refused_in_one_line(tmp_path, content):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(InvalidInput, match=r"a\.png: ") as caught:
        read_image(tmp_path / "a.png")
    assert "\n" not in str(caught.value)


def test_truncated_image_is_refused(tmp_path):
    noise = np.random.default_rng(95).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    for suffix in ("png", "jpg"):
        Image.fromarray(noise).save(tmp_path / f"a.{suffix}")
        data = (tmp_path / f"a.{suffix}").read_bytes()
        (tmp_path / f"a.{suffix}").write_bytes(data[: len(data) // 2])
        with pytest.raises(InvalidInput, match=rf"a\.{suffix}: "):
            read_image(tmp_path / f"a.{suffix}")


def test_views_are_written_once_each(pair, tmp_path):
    paths = write_views(pair[0], [camera("a.jpg"), camera("b.jpg")], tmp_path)
    assert [path.name for path in paths] == ["a.png", "b.png"]
    assert read_image(paths[0]).shape == (30, 40, 3)


# Cameras of one name


def test_cameras_of_one_name_are_drawn_and_compared(pair, tmp_path):
    views = [camera("frame"), camera("frame", position=(1.0, 0.0, -4.0))]
    paths = write_views(pair[0], views, tmp_path)
    assert [path.name for path in paths] == ["frame_1.png", "frame_2.png"]
    assert (read_image(paths[0]) != read_image(paths[1])).any()
    result = compare_views(*pair, views, images=tmp_path / "both")
    assert [view.name for view in result.views] == ["frame", "frame"]
    assert result.views[0].between != result.views[1].between
    assert len(list((tmp_path / "both").iterdir())) == 6


def test_photographs_of_cameras_of_one_name_are_refused(pair, tmp_path):
    views = [camera("a"), camera("frame"), camera("frame", position=(1.0, 0.0, -4.0))]
    for name in ("a", "frame"):
        Image.new("RGB", (40, 30)).save(tmp_path / f"{name}.png")
    message = r"frame.png: image of cameras 1 and 2, named 'frame' and 'frame'; expected a"
    with pytest.raises(InvalidInput, match=message):
        compare_views(*pair, views, tmp_path)
    with pytest.raises(InvalidInput, match=message):
        photographed(views, tmp_path)
    # One is held out, the other is not.
    plan = Plan(
        Steps(),
        [
            replace(view, split=split)
            for view, split in zip(views[1:], ("train", "test"), strict=True)
        ],
        tmp_path,
    )
    with pytest.raises(InvalidInput, match="image of cameras 0 and 1"):
        choose_views(pair[0], plan)
    (tmp_path / "frame.png").unlink()
    assert photographed(views, tmp_path) == [(views[0], tmp_path / "a.png")]


# The real scene


@pytest.mark.thorough
def test_held_out_views_of_a_real_scene_have_the_known_psnr():
    path = shared_scene_path("bonsai/point_cloud.ply")
    result = gs_codec.compare(
        path, path, path.parent / "cameras.json", gt_images=path.parent / "images"
    )
    assert len(result.views) == 37
    assert result.mean.between.psnr == math.inf
    assert result.mean.first.psnr == pytest.approx(29.7, abs=0.05)
    assert result.mean.delta == Quality(0.0, 0.0, None, 0.0)


# The command line


@pytest.fixture(scope="module")
def folder(tmp_path_factory, pair):
    path = tmp_path_factory.mktemp("views")
    for name, scene in zip(("a.ply", "b.ply"), pair, strict=True):
        write_ply(path / name, scene)
    entries = [
        {
            "id": i, "img_name": f"v{i}", "width": 40, "height": 30, "fx": 40.0, "fy": 40.0,
            "position": [0.2 * i, 0.0, -5.0], "rotation": np.eye(3).tolist(),
        }
        for i in range(3)
    ]  # fmt: skip
    (path / "cameras.json").write_text(json.dumps(entries))
    (path / "truth").mkdir()
    for i in range(3):
        write_png(path / "truth" / f"v{i}.png", np.full((30, 40, 3), 0.5))
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_compare_prints_each_view_the_mean_and_the_worst(folder):
    result = run("compare", folder / "a.ply", folder / "b.ply", "--cameras", folder)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0] == "Gaussians: 300 in A, 300 in B"
    assert [line.split()[0] for line in lines[1:]] == ["view", "v0", "v1", "v2", "mean", "worst:"]


def test_compare_against_ground_truth_as_json(folder):
    options = ["--cameras", folder / "cameras.json", "--gt-images", folder / "truth", "--json"]
    result = run("compare", folder / "a.ply", folder / "b.ply", *options)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["gaussians"] == [300, 300]
    assert [view["view"] for view in report["views"]] == ["v0", "v1", "v2"]
    mean = report["mean"]
    assert mean["delta"]["psnr"] == pytest.approx(mean["b"]["psnr"] - mean["a"]["psnr"])
    lowest = min(report["views"], key=lambda view: view["between"]["psnr"])
    assert report["worst"] == lowest


def test_untrusted_cameras_read_no_other_file(folder, tmp_path):
    write_png(tmp_path / "secret.png", np.full((30, 40, 3), 0.5))
    (entry, *_) = json.loads((folder / "cameras.json").read_text())
    entry["img_name"] = str(tmp_path / "secret.png")
    cameras = tmp_path / "cameras.json"
    cameras.write_text(json.dumps([entry]))
    options = ["--cameras", cameras, "--gt-images", folder / "truth"]
    for command in (
        ["compare", folder / "a.ply", folder / "b.ply", *options],
        ["prepare", folder / "a.ply", tmp_path / "a.ply", "--refit-colour", "1", *options],
    ):
        result = run(*command)
        assert isinstance(result.exception, InvalidInput)
        assert "expected a name inside the folder" in str(result.exception)


def test_json_has_no_infinity(folder):
    result = run("compare", folder / "a.ply", folder / "a.ply", "--cameras", folder, "--json")
    report = json.loads(result.stdout, parse_constant=pytest.fail)
    assert report["mean"]["between"]["psnr"] is None


def test_render_writes_an_image_for_each_camera(folder, tmp_path):
    target = tmp_path / "out"
    result = run(
        "render", folder / "a.ply", "--cameras", folder, "--out", target, "--width", 20,
        "--background", "white", "--device", "cpu",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(f"{target}: 3 images, ")
    assert sorted(path.name for path in target.iterdir()) == ["v0.png", "v1.png", "v2.png"]
    image = read_image(target / "v1.png")
    assert image.shape == (15, 20, 3)
    assert image[0, 0].tolist() == [1, 1, 1]


def test_scenes_of_two_coordinate_systems_are_compared_in_one(folder, pair, tmp_path):
    write_ply(tmp_path / "rub.ply", turn_axes(pair[0], "RUB"))
    options = ["--cameras", folder, "--json"]
    result = run("compare", folder / "a.ply", tmp_path / "rub.ply", *options)
    report = json.loads(result.stdout)
    assert report["coordinates"] == ["RDF", "RUB"]
    assert "coordinates RDF in A, RUB in B: converted to one system" in result.stderr
    assert {view["between"]["psnr"] for view in report["views"]} == {None}  # equal
    same = run("compare", folder / "a.ply", folder / "a.ply", *options)
    assert "turned" not in same.stderr
    for name in (folder / "a.ply", tmp_path / "rub.ply"):
        out = tmp_path / name.stem
        run("render", name, "--cameras", folder, "--out", out)
    for image in (tmp_path / "a").iterdir():
        assert image.read_bytes() == (tmp_path / "rub" / image.name).read_bytes()


def test_render_with_auto_cameras(folder, tmp_path):
    options = ["--cameras", "auto", "--width", 30, "--out", tmp_path]
    result = run("render", folder / "a.ply", *options)
    assert result.exit_code == 0, result.output
    assert len(list(tmp_path.glob("auto_*.png"))) == 24


REFUSALS = {
    "no cameras": ("--cameras none.json", "none.json: no such file or folder"),
    "images alone": ("--images out", "--images needs --cameras"),
    "two widths": (
        "--cameras cameras.json --gt-images truth --width 20", "width: cannot be combined",
    ),
    "no truth folder": ("--cameras cameras.json --gt-images none", "none: no such folder"),
    "no truth image": ("--cameras cameras.json --gt-images .", "no image 'v0'"),
    "split": ("--cameras cameras.json --split best", "split 'best'"),
    "empty split": ("--cameras cameras.json --split train", "none of the 3 is marked 'train'"),
    "background": ("--cameras cameras.json --background blue", "expected black or white"),
    "device": ("--cameras cameras.json --device tpu", "expected one of auto, cpu, cuda"),
    "images in a file": (
        "--cameras cameras.json --images a.ply",
        "a.ply: exists, expected a folder",
    ),
    "tiny": ("--cameras cameras.json --width 5", "5x4 pixels, expected at least 11"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals_are_one_line(folder, monkeypatch, name):
    monkeypatch.chdir(folder)
    options, message = REFUSALS[name]
    result = run("compare", "a.ply", "b.ply", *options.split())
    assert isinstance(result.exception, InvalidInput), result.output
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)


# The API


def test_views_are_rendered_on_demand(pair):
    scene = pair[0]
    entry = {
        "img_name": "front",
        "width": 40,
        "height": 30,
        "fx": 40.0,
        "fy": 40.0,
        "rotation": np.eye(3).tolist(),
        "position": [0.0, 0.0, -3.0],
    }
    told = []
    views = gs_codec.render(to_cloud(scene), [entry], progress=lambda *step: told.append(step))
    assert len(views) == 1
    assert [camera.name for camera in views.cameras] == ["front"]
    assert not told
    ((camera, drawn),) = views
    assert told == [("views", 1, 1)]
    np.testing.assert_array_equal(drawn.colour, render(scene, camera).colour)
    np.testing.assert_array_equal(views.draw(entry).colour, drawn.colour)
    other = views.draw(entry | {"position": [0.0, 0.5, -3.0]})
    assert np.abs(other.colour - drawn.colour).max() > 0.1
    with pytest.raises(InvalidInput, match=r"camera: no 'fx'"):
        views.draw({key: value for key, value in entry.items() if key != "fx"})
    with pytest.raises(InvalidInput, match="expected str or Path or Sequence"):
        gs_codec.render(to_cloud(scene), [3])


def test_images_are_compared():
    rng = np.random.default_rng(5)
    first = rng.random((20, 30, 3), np.float32)
    second = np.clip(first + 0.01, 0, 1)
    assert gs_codec.compare_images(first, second).psnr > 39
    with pytest.raises(InvalidInput, match="20x30"):
        gs_codec.compare_images(first, first.transpose(1, 0, 2))
