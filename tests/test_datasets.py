"""``bench suite --dataset``: the INRIA trainer's layout, its test views, and the survey's files."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gs_codec.bench.measured_scenes import open_with_cameras
from gs_codec.bench.suite.datasets import DATASETS, open_model, published
from gs_codec.bench.suite.measurements import GROUPS, STAGES, Options
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import write_png
from gs_codec.cli.main import app
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.image_quality import compare_images
from gs_codec.rendering.renderer import render
from samples.generate import generate, orbit_cameras

pytestmark = pytest.mark.slow

VIEWS = 9


def make_model(folder: Path, photographs: Path | None = None, settings: str = "eval=True") -> Path:
    """A model as the INRIA trainer writes it, with photographs of half the size."""
    path = folder / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    path.parent.mkdir(parents=True)
    scene = generate(150, 1, seed=5)
    write_ply(path, scene)
    cameras = orbit_cameras(VIEWS)
    for camera in cameras:
        camera |= {"width": 64, "height": 44, "fx": 60.0, "fy": 60.0}
        for key in ("cx", "cy", "split"):
            camera.pop(key, None)
    # The trainer lists its test cameras first.
    (folder / "cameras.json").write_text(json.dumps([cameras[i] for i in (8, 0, *range(1, 8))]))
    stated = f"Namespace({settings}, images='images_2', resolution=-1, sh_degree=1)"
    (folder / "cfg_args").write_text(stated)
    for camera in read_cameras(folder / "cameras.json") if photographs else []:
        view = camera.resized(32, 22)
        write_png(photographs / f"{camera.name}.png", 0.9 * render(scene, view).colour)
    return path


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> tuple[Path, str]:
    """Output of a run on two scenes, and stderr."""
    folder = tmp_path_factory.mktemp("datasets")
    for name in ("train", "truck"):
        images = folder / "photographs" / name / "images_2"
        images.mkdir(parents=True)
        make_model(folder / "models" / name, images)
    masks = folder / "photographs" / "truck" / "masks"
    masks.mkdir()
    for image in images.iterdir():
        half = np.zeros((22, 32, 3))
        half[:, 8:] = 1
        write_png(masks / image.name, half)
    out = folder / "out"
    options = ["--gt-images", str(folder / "photographs"), "--out", str(out), "--repeats", "1"]
    skipped = [text for group in GROUPS[len(STAGES) :] for text in ("--skip", group)]
    own = ["--codec", "packed: gzip -1c {in} >{out}; gzip -dc {in} >{out}"]
    arguments = ["bench", "suite", "--dataset", "tanksandtemples", str(folder / "models")]
    result = CliRunner().invoke(app, [*arguments, *options, *skipped, *own])
    assert result.exit_code == 0, result.output
    return out, result.stderr


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_files_are_those_of_the_survey(measured):
    out, _ = measured
    for scene in ("train", "truck"):
        rows = rows_of(out / "results" / "TanksAndTemples" / f"{scene}.csv")
        assert list(rows[0]) == ["Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians"]
        by_name = {row["Submethod"]: row for row in rows}
        assert list(by_name)[:3] == [" uncompressed", " l", " m"]
        exact = by_name[" packed"]
        assert exact["PSNR"] == by_name[" uncompressed"]["PSNR"] == by_name[" lossless"]["PSNR"]
        assert float(by_name[" s"]["PSNR"]) > 10
        sizes = [int(by_name[f" {name}"]["Size [Bytes]"]) for name in ("uncompressed", "l", "s")]
        assert sizes == sorted(sizes, reverse=True)
        assert {row["#Gaussians"] for row in rows} == {"150"}


def test_means_are_beside_published_rows(measured):
    out, told = measured
    rows = rows_of(out / "results" / "TanksAndTemples.csv")
    ours = {row["Submethod"] or row["Method"]: row for row in rows if row["Comment"][:5] == "mean "}
    assert {row["Method"] for row in ours.values()} == {"gs_codec", "packed", "uncompressed"}
    each = [rows_of(out / "results" / "TanksAndTemples" / f"{x}.csv") for x in ("train", "truck")]
    for column in ("PSNR", "Size [Bytes]"):
        both = [float(row[column]) for rows in each for row in rows if row["Submethod"] == " m"]
        assert float(ours[" m"][column]) == pytest.approx(np.mean(both), rel=1e-3)
    assert ours[" m"]["Comment"] == "mean of 2 of 2 scenes"
    assert len(rows) - len(ours) == len(published(DATASETS["tanksandtemples"])) > 40
    page = (out / "report.md").read_text()
    for name in (r"gs\_codec m", "packed", "uncompressed"):
        assert f"| **{name}** |" in page
    for text in ("| HAC++-lowrate | 24.22 | 0.849 | 0.190 |  | 5.43 | 511,289 |", "YUV"):
        assert text in page
        assert text.split(" | ")[0].strip("| ") in told


def test_quality_is_that_of_every_eighth_photograph_by_name(measured):
    out, _ = measured
    lines = [json.loads(line) for line in (out / "suite.jsonl").read_text().splitlines()]
    assert lines[0]["dataset"] == "tanksandtemples"
    assert {line["kind"] for line in lines} == {"machine", "scene", "beside"}
    models = out.parent / "models"
    scene = generate(150, 1, seed=5)
    views = sorted(read_cameras(models / "train" / "cameras.json"), key=lambda camera: camera.name)
    pairs = []
    for camera in (views[0], views[8]):
        image = render(scene, camera.resized(32, 22)).colour
        pairs.append((image, np.round(255 * np.clip(0.9 * image, 0, 1)) / 255))
    mask = np.zeros((22, 32), bool)
    mask[:, 8:] = True
    for name, used in (("train", None), ("truck", mask)):
        line = next(x for x in lines if x["kind"] == "beside" and x["scene"] == name)
        assert (line["views"], line["masked"]) == (2, used is not None)
        for metric in ("psnr", "ssim", "psnr_yuv"):
            values = [getattr(compare_images(*pair, mask=used), metric) for pair in pairs]
            assert line["truth"][metric] == pytest.approx(np.mean(values), abs=1e-3)


def test_views_without_photographs_have_the_size_of_training(tmp_path, caplog):
    path = make_model(tmp_path / "room", settings="eval=False")
    measured = open_model(path, None, None)
    assert measured.truth is None
    assert {(camera.width, camera.height) for camera in measured.cameras} == {(32, 22)}
    assert {(camera.width, camera.height) for camera in measured.guides} == {(32, 22)}
    assert (len(measured.cameras), len(measured.guides)) == (2, VIEWS - 2)
    assert "cfg_args: eval=False, so test photographs were used for training" in caplog.text
    assert {camera.width for camera in open_model(path, None, 20).guides} == {20}
    options = Options((tmp_path,), dataset="mipnerf360")
    assert options.paths == options.paths == [path]
    assert caplog.text.count("means exclude bicycle, bonsai, counter") == 1
    # Without a dataset, a model is found with its cameras and name all the same.
    assert (open_with_cameras(path, 20).name, measured.name) == ("room", "room")
    assert len(open_with_cameras(path, 20).cameras) == 3


def test_photographs_must_exist_and_be_small(tmp_path, monkeypatch):
    path = make_model(tmp_path / "room")
    with pytest.raises(InvalidInput, match=r"room.images_2"):
        open_model(path, tmp_path / "none", None)
    images = tmp_path / "room" / "images_2"
    images.mkdir()
    for camera in read_cameras(tmp_path / "room" / "cameras.json"):
        write_png(images / f"{camera.name}.png", np.zeros((22, 32, 3)))
    assert open_model(path, None, None).truth == images
    monkeypatch.setattr("gs_codec.bench.suite.datasets._WIDEST", 30)
    with pytest.raises(InvalidInput, match="photographs 32 pixels wide, expected at most 30"):
        open_model(path, None, None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dataset", "mipnerf"], "dataset 'mipnerf': expected one of mipnerf360, "),
        (
            ["--dataset", "deepblending"],
            "no models of deepblending, expected .*drjohnson/point_clo",
        ),
        (["--dataset", "deepblending", "more"], "expected one folder, that of its models"),
        (["--gt-images", "."], "--gt-images needs --dataset"),
        (["--dataset", "mipnerf360", "--skip", "curves"], "curves: expected one of peers, guided"),
    ],
)
def test_invalid_requests_are_refused(tmp_path, arguments, message):
    make_model(tmp_path / "models" / "room")
    options = [str(tmp_path / "models"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, ["bench", "suite", *options, *arguments])
    assert isinstance(result.exception, InvalidInput)
    assert re.search(message, str(result.exception))
    assert not (tmp_path / "out").exists()


def test_published_rows_have_sources():
    for dataset in DATASETS.values():
        rows = published(dataset)
        assert len(rows) > 30
        for row in rows:
            assert row["Data Source"].startswith("https://"), row
            assert 20 < float(row["PSNR"]) < 32
            assert row["Size [Bytes]"] or row["#Gaussians"], row
