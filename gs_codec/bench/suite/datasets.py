"""Standard datasets: models of the INRIA trainer, measured as in its paper, and published results.

The columns, the folders and the published results are those of the survey 3DGS.zip.
"""

from __future__ import annotations

import csv
import logging
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from gs_codec.bench.measured_scenes import MeasuredScene, open_scene, scene_folder
from gs_codec.bench.side_by_side import OURS_AS, is_ours
from gs_codec.bench.suite.results import Results
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.errors import InvalidInput
from gs_codec.pages.tables import Table, escaped, number
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)


class Dataset(NamedTuple):
    """The survey's name of a dataset, and its scenes."""

    title: str
    scenes: tuple[str, ...]


DATASETS = {
    "mipnerf360": Dataset(
        "MipNeRF360",
        (
            "bicycle", "bonsai", "counter", "flowers", "garden", "kitchen", "room", "stump",
            "treehill",
        ),
    ),
    "tanksandtemples": Dataset("TanksAndTemples", ("train", "truck")),
    "deepblending": Dataset("DeepBlending", ("drjohnson", "playroom")),
}  # fmt: skip

#: Published results, by the survey's columns and the dataset; its head states their origin.
_PUBLISHED = Path(__file__).with_name("published.csv")

_MODEL = "point_cloud/iteration_30000/point_cloud.ply"

#: Maximum width of the trainer's photographs, pixels.
_WIDEST = 1600

#: Every n-th photograph, by name, is a test photograph.
_HELD_OUT = 8

#: The survey's columns: of a scene, and before and after these of means over a dataset.
_COLUMNS = ("Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians")
_MEAN_COLUMNS = ("Method", *_COLUMNS, "Data Source", "Comment")

#: Keys of result lines by these columns, and the number of digits; MPEG's PSNR is in tables only.
_METRICS = {"PSNR": ("psnr", 3), "SSIM": ("ssim", 4), "LPIPS": ("lpips", 4), "YUV": ("psnr_yuv", 3)}

#: Our method in the survey's files, and the scenes before coding.
_OURS = "gs_codec"
_UNCODED = "uncompressed"

Row = dict[str, float | None]


def models_of(name: str, folder: Path) -> list[Path]:
    """The models of a dataset's scenes in a folder; a log message names missing ones.

    Raises InvalidInput if the dataset is unknown, or there is no model.
    """
    if name not in DATASETS:
        raise InvalidInput(f"dataset '{name}': expected one of {', '.join(DATASETS)}")
    paths = [folder / scene / _MODEL for scene in DATASETS[name].scenes]
    found = [path for path in paths if path.is_file()]
    if not found:
        raise InvalidInput(f"{folder}: no models of {name}, expected {paths[0]} and others")
    missing = [scene_folder(path).name for path in paths if path not in found]
    if missing:
        log.warning("%s: means exclude %s", folder, ", ".join(missing))
    return found


def open_model(path: Path, photographs: Path | None, width: int | None) -> MeasuredScene:
    """A scene of the INRIA trainer, with the views of its paper.

    Every eighth photograph, by name, measures; the cameras of the others guide encoders.
    ``cfg_args`` names the folder of the photographs; those in ``images_4`` are four times smaller.
    It is in `photographs`/SCENE, by default in the folder of the model, where it may be absent.
    `width` is that of views without photographs. Raises InvalidInput if a file cannot be used, or
    if photographs are wider than the trainer makes them.
    """
    folder = scene_folder(path)
    settings = folder / "cfg_args"
    text = settings.read_text("utf-8", "replace") if settings.is_file() else ""
    stated = re.search(r"\bimages='(\w+)'", text)
    images = stated[1] if stated else "images"
    if re.search(r"\beval=False\b", text):
        log.warning("%s: eval=False, so test photographs were used for training", settings)
    truth = (folder if photographs is None else photographs / folder.name) / images
    found = truth if photographs is not None or truth.is_dir() else None
    ordered = sorted(read_cameras(folder / "cameras.json"), key=lambda camera: camera.name)
    cameras = [
        replace(camera, split="train" if i % _HELD_OUT else "test")
        for i, camera in enumerate(ordered)
    ]
    measured = open_scene(path, cameras, found, width)
    widest = max(camera.width for camera in measured.cameras)
    if found is not None and widest > _WIDEST:
        raise InvalidInput(
            f"{found}: photographs {widest} pixels wide, expected at most {_WIDEST}, as in the "
            "trainer's paper (images_2 or images_4)"
        )
    if width is not None:
        return measured
    smaller = re.search(r"_([1-9]\d?)$", images)
    by = int(smaller[1]) if smaller else 1
    guides = [_resized(camera, by) for camera in measured.guides]
    views = measured.cameras if found else [_resized(camera, by) for camera in measured.cameras]
    return replace(measured, guides=guides, cameras=views)


def _resized(camera: Camera, by: int) -> Camera:
    """A camera with the size of the photographs that the trainer used."""
    width = min(max(1, round(camera.width / by)), _WIDEST)
    return camera.resized(width, max(1, round(camera.height * width / camera.width)))


def survey_files(results: Results, dataset: Dataset) -> dict[str, bytes]:
    """Files as the survey asks authors for: a CSV of each scene, and one of our and other means."""
    scenes = {scene: _rows(results, scene) for scene in results.scenes}
    found = {
        f"results/{dataset.title}/{scene}.csv": _csv(_COLUMNS, map(_written, rows, rows.values()))
        for scene, rows in scenes.items()
    }
    means = _means(list(scenes.values()))
    ours = [
        _written(codec, row) | _method(codec) | {"Comment": _scenes(results, dataset)}
        for codec, row in means.items()
    ]
    found[f"results/{dataset.title}.csv"] = _csv(_MEAN_COLUMNS, [*ours, *published(dataset)])
    return found


def dataset_table(results: Results, dataset: Dataset) -> Table:
    """Means of our codecs over a dataset, and published ones of other methods, by size."""
    rows = []
    for codec, row in _means([_rows(results, scene) for scene in results.scenes]).items():
        cells = [number(row[name], f".{digits}f") for name, (_, digits) in _METRICS.items()]
        size, count = row["Size [Bytes]"], number(row["#Gaussians"], ",.0f")
        name = f"**{escaped(''.join(_method(codec).values()))}**"
        rows.append((size, [name, *cells, _megabytes(size), count, "measured here"]))
    for line in published(dataset):
        size = float(line["Size [Bytes]"]) if line["Size [Bytes]"] else None
        count = f"{int(line['#Gaussians']):,}" if line["#Gaussians"] else ""
        cells = [line["PSNR"], line["SSIM"], line["LPIPS"], "", _megabytes(size), count]
        name, comment = f"{line['Method']}{line['Submethod']}", line["Comment"]
        source = line["Data Source"] + (f" ({comment})" if comment else "")
        rows.append((size, [escaped(name), *cells, source]))
    rows.sort(key=lambda row: (row[0] is None, row[0]))
    columns = ["method", "PSNR dB", "SSIM", "LPIPS", "PSNR YUV", "MB", "Gaussians", "source"]
    return Table(columns, [row for _, row in rows], left=(0, -1))


def _method(codec: str) -> dict[str, str]:
    """The survey's two columns of a codec's name, whether it is ours or not."""
    ours = is_ours(codec) or codec.startswith(OURS_AS)
    return {"Method": _OURS if ours else codec, "Submethod": f" {codec}" if ours else ""}


def introduction(results: Results, dataset: Dataset) -> str:
    """What the table of a dataset shows."""
    return (
        f"{_scenes(results, dataset).capitalize()}. PSNR, SSIM and LPIPS are those of test "
        "photographs (every eighth), PSNR YUV is MPEG's (BT.709, weights 6:1:1). Published rows "
        "are those of the survey 3DGS.zip, with its sources: other renderers, other trained models "
        "and other implementations of SSIM and LPIPS. Compare the row "
        f'"{_UNCODED}" with 3DGS first.'
    )


def _scenes(results: Results, dataset: Dataset) -> str:
    return f"mean of {len(results.scenes)} of {counted(len(dataset.scenes), 'scene')}"


def published(dataset: Dataset) -> list[dict[str, str]]:
    """Rows of `published.csv` on a dataset."""
    lines = _PUBLISHED.read_text("utf-8").splitlines()
    rows = csv.DictReader(line for line in lines if line[0] != "#")
    return [row for row in rows if row.pop("Dataset") == dataset.title]


def _rows(results: Results, scene: str) -> dict[str, Row]:
    """Results of a scene by codec: before coding, then coded."""
    rows: dict[str, Row] = {}
    for line in results.of("beside", scene):
        before, change = line.get("truth", {}), line.get("delta", {})
        first = {name: before.get(key) for name, (key, _) in _METRICS.items()}
        coded = {
            name: None if value is None or change.get(key) is None else value + change[key]
            for (name, value), (key, _) in zip(first.items(), _METRICS.values(), strict=True)
        }
        whole = {"Size [Bytes]": line["input_bytes"], "#Gaussians": line["gaussians"]}
        rows.setdefault(_UNCODED, first | whole)
        size = {"Size [Bytes]": line["output_bytes"], "#Gaussians": line.get("decoded_gaussians")}
        rows[line["codec"]] = coded | size
    return rows


def _means(scenes: Sequence[dict[str, Row]]) -> dict[str, Row]:
    """Means of the codecs that were measured in every scene."""
    common = [codec for codec in (scenes or [{}])[0] if all(codec in rows for rows in scenes)]
    return {codec: _mean([rows[codec] for rows in scenes]) for codec in common}


def _mean(rows: Sequence[Row]) -> Row:
    def mean(column: str) -> float | None:
        values = [value for row in rows if (value := row[column]) is not None]
        return sum(values) / len(values) if len(values) == len(rows) else None

    return {column: mean(column) for column in rows[0]}


def _written(codec: str, row: Row) -> dict[str, str]:
    """A row of the survey's CSV."""
    cells = {name: number(row[name], f".{_METRICS[name][1]}f") for name in _COLUMNS[1:4]}
    whole = {name: number(row[name], ".0f") for name in _COLUMNS[4:]}
    return {"Submethod": f" {codec}", **cells, **whole}


def _csv(columns: Sequence[str], rows: Iterable[dict[str, str]]) -> bytes:
    text = StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _megabytes(size: float | None) -> str:
    return number(size and size / 1e6, ".2f")
