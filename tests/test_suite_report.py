"""The suite's report from made-up lines: tables, plots, subsets of lines, difficult names."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gs_codec.bench.suite.answers import answers
from gs_codec.bench.suite.results import Results
from gs_codec.bench.suite.suite_plots import plot_rate
from gs_codec.bench.suite.suite_report import write_report
from gs_codec.errors import InvalidInput, MissingTool

pytestmark = pytest.mark.slow

Line = dict[str, Any]

#: Codec, bits per Gaussian, PSNR, delta-PSNR, seconds to encode and to decode.
CODECS = [
    ("l", 149.9, 54.94, -0.014, 0.39, 0.17),
    ("m", 113.5, 49.71, -0.052, 0.36, 0.16),
    ("s", 79.6, 43.84, -0.192, 0.33, 0.15),
    ("paper-l", 197.9, 50.73, -0.033, 0.31, 0.12),
    ("paper-m", 162.7, 46.99, -0.089, 0.30, 0.11),
    ("lossless", 1252.5, None, 0.0, 0.96, 0.12),
    ("m, camera-guided", 80.5, 51.70, -0.044, 55.0, 0.12),
    ("spz v4", 161.3, 38.05, -0.755, 0.43, 0.05),
    ("pcodec, columns", 1333.1, None, 0.0, 0.22, 0.03),
    ("slow", 170.0, 38.0, -0.8, 2.0, 1.0),
]
POINTS = {
    "paper": [("paper-l", 197.9, 50.73), ("paper-m", 162.7, 46.99), ("paper-s - 1 bit", 97.4, 37)],
    "camera-free": [("l", 149.9, 54.94), ("m", 113.5, 49.71), ("s, steps x 2", 58.0, 39.16)],
    "camera-guided": [("m", 80.5, 51.7), ("s", 58.5, 45.79)],
}


def beside(scene: str, photographs: bool, codec: tuple) -> Line:
    name, bits, psnr, delta, encode, decode = codec
    line = {
        "kind": "beside", "scene": scene, "codec": name, "version": "1",
        "own_process": name == "slow", "gaussians": 1000,
        "input_bytes": 248000, "output_bytes": 125 * bits, "ratio": 1984 / bits,
        "bits_per_gaussian": bits,
        "mean": {"psnr": psnr, "ssim": 0.99}, "worst_psnr": psnr,
        "encode_seconds": {"median": encode, "min": 0.9 * encode, "max": 1.2 * encode},
        "decode_seconds": {"median": decode, "min": 0.9 * decode, "max": 1.2 * decode},
    }  # fmt: skip
    return line | ({"delta": {"psnr": delta, "ssim": 0.0}} if photographs else {})


def lines_of(scene: str, photographs: bool) -> list[Line]:
    """Lines of every kind for a scene."""
    lines: list[Line] = [
        {
            "kind": "scene", "scene": scene, "gaussians": 1000, "sh_degree": 3,
            "input_bytes": 248000, "cameras": "auto", "measured_views": 24, "encoded_by_views": 64,
            "width": 300, "height": 200, "photographs": photographs,
        },
        {
            "kind": "memory", "scene": scene, "gaussians": 1000, "profile": "m",
            "encode_peak_bytes": 3.11e8, "decode_peak_bytes": 2.22e8, "float_bytes": 236000,
        },
    ]  # fmt: skip
    lines += [beside(scene, photographs, codec) for codec in CODECS]
    lines.append({"kind": "beside", "scene": scene, "codec": "SOG", "absent": "SOG: no <node>"})
    if photographs:
        lines.append(beside(scene, True, ("m, 39 % pruned", 56.0, 46.1, -0.084, 222.0, 0.09)))
        lines.append(beside(scene, True, ("m, 60x refined", 33.0, 41.1, 0.031, 240.0, 0.09)))
        lines.append(beside(scene, True, ("m, 60x refined, renders", 33.0, 42.0, -0.2, 230.0, 0.1)))
    for curve, points in POINTS.items():
        for name, bits, psnr in points:
            known = {"point": name, "bits_per_gaussian": bits, "mean": {"psnr": psnr}}
            lines.append({"kind": "point", "scene": scene, "curve": curve, **known})
    return lines


def lines_of_all() -> list[Line]:
    """Lines of a whole run: two scenes, with and without photographs."""
    lines: list[Line] = [
        {
            "kind": "machine", "processor": "EPYC", "threads": 2, "commit": "abc",
            "installed": {"gs-codec-core": {"packages": 16, "bytes": 353_800_000}},
            "packages": {"numpy": "2"}, "skipped": ["curves"], "command": "gs-codec bench",
        },
        *lines_of("sample", photographs=False),
        *lines_of("bonsai", photographs=True),
    ]  # fmt: skip
    known = {"kind": "geometry", "scene": "bonsai", "gaussians": 500_000}
    ours = {"coder": "count tree", "depth": 16, "bytes": 1_500_000, "decode_seconds": 0.04}
    ours |= {"build_seconds": 0.1, "walk_seconds": 0.05}
    theirs = {"coder": "Open3D's Octree", "depth": 10, "build_seconds": 1.0, "walk_seconds": 2.0}
    lines += [known | ours, known | theirs]
    for count in (100_000, 1_000_000):
        used = {"seconds": count / 1e6, "cpu_seconds": count / 5e5, "peak_bytes": 400 * count}
        known = {"scene": "bonsai", "profile": "m", "gaussians": count}
        known |= {"float_bytes": 236 * count, "output_bytes": 12 * count}
        known |= {"encode": used, "decode": used}
        lines.append({"kind": "scaling", **known})
    return lines


KINDS = sorted({line["kind"] for line in lines_of_all()})


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite") / "report"
    write_report(lines_of_all(), folder)
    return folder


def test_all_sections_exist_in_order(written: Path) -> None:
    page = (written / "report.md").read_text()
    titles = re.findall(r"^##? (.*)$", page, re.MULTILINE)
    scenes = ["bonsai (1,000, 3)", "sample (1,000, 3)"]
    assert titles == ["Benchmarks of gs_codec", *scenes, "Positions", "Scaling", "Circumstances"]


def test_pictures_are_next_to_the_page_and_shown(written: Path) -> None:
    pictures = ["rate", "time", "frontier"]
    pictures = [f"{name}-{scene}" for scene in ("bonsai", "sample") for name in pictures]
    files = [f"{name}.png" for name in [*pictures, "scaling"]]
    names = sorted(path.name for path in written.iterdir())
    assert names == sorted([*files, "answers.md", "report.md"])
    shown = re.findall(r"^!\[.+\]\((.*)\)$", (written / "report.md").read_text(), re.MULTILINE)
    assert shown == files
    for file in files:
        with Image.open(written / file) as image:
            assert image.width > 1200
            # Not blank paper: something is drawn.
            assert np.asarray(image.convert("L")).std() > 5


@pytest.mark.parametrize(
    "text",
    [
        "| `m` | 17.5x | 113.5 | 49.71 | 49.71 | -0.052 | 0.36 s | 0.16 s | 311 | 222 |  |  |",
        "| `paper-m`: EntropyGS | 12.2x | 162.7 | 46.99 | 46.99 | -0.089 | 0.30 s | 0.11 s |",
        " | 0.43 s | 0.05 s |  |  | ≤ 58.0 | ≤ 58.5 |",  # spz, below our curves
        "| 1333.1 | equal |  | +0.000 |",
        "| 1252.5 (`lossless`) |",
        r"| slow \* |",
        "camera-free -",
        "camera-guided -",
        "24 held-out views of 300 x 200 pixels measured against photographs, 64",
        "| bonsai | count tree | 16 | 0.20 | 0.10 | 0.08 | 24.0 |",
        "| bonsai | Open3D's Octree | 10 | 2.00 | 4.00 |  |  |",
        "EPYC",
        "- installed, gs-codec-core: 16 packages, 353.80 MB",
        "- skipped with --skip: curves",
        "SOG: no &lt;node>",
    ],
)
def test_content_of_the_page(written: Path, text: str) -> None:
    assert text in (written / "report.md").read_text()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("kind", KINDS)
def test_lines_of_one_kind_are_enough(kind: str, tmp_path: Path) -> None:
    others = [line for line in lines_of_all() if line.get("scene") != "sample"]
    write_report([line for line in others if line["kind"] == kind], tmp_path)
    assert (tmp_path / "report.md").read_text().startswith("# Benchmarks")


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("kind", "start"),
    [("beside", "## Against the paper?"), ("scene", "## How small?"), ("point", "## How small?")],
)
def test_lines_without_one_kind_are_enough(kind: str, start: str, tmp_path: Path) -> None:
    write_report([line for line in lines_of("bonsai", True) if line["kind"] != kind], tmp_path)
    assert (tmp_path / "answers.md").read_text().startswith(start)


def test_no_lines_make_an_empty_report(tmp_path: Path) -> None:
    write_report([], tmp_path)
    assert "##" not in (tmp_path / "report.md").read_text()


def test_points_have_short_names() -> None:
    [axis, *_] = plot_rate(Results(lines_of("a", False)), "a").axes
    assert {text.get_text() for text in axis.texts} >= {"l", "s - 1", "s x 2"}


def test_lines_survive_json(tmp_path: Path) -> None:
    lines = [x for x in lines_of("bonsai", True) if x["kind"] in ("scene", "point")]
    write_report(lines, tmp_path / "a")
    write_report(json.loads(json.dumps(lines)), tmp_path / "b")
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


@pytest.mark.one_in(4)
@pytest.mark.parametrize("name", ["<b>&\"'", "../../up | `x` [a](b)", "$x_{$\n\t\x00", "森" * 60])
def test_names_are_escaped(name: str, tmp_path: Path) -> None:
    lines = [beside(name, False, codec) for codec in CODECS[:2]]
    machine = {"kind": "machine", "command": f"gs-codec bench suite {name}"}
    write_report([machine, *lines, lines_of(name, photographs=False)[0]], tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    for file in ("report.md", "answers.md"):
        text = (tmp_path / "out" / file).read_text()
        assert "<b" not in text
        assert "[a](b)" not in text
    rows = re.findall(r"^\|.*$", (tmp_path / "out" / "answers.md").read_text(), re.MULTILINE)
    assert len(rows) > 3
    assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1


@pytest.mark.thorough
def test_two_scenes_of_one_file_name_keep_their_pictures(tmp_path: Path) -> None:
    write_report([beside(name, False, CODECS[0]) for name in ("a b", "a-b")], tmp_path)
    pictures = [path.name for path in tmp_path.glob("*.png")]
    assert len(pictures) == 6
    shown = re.findall(r"\((.*png)\)", (tmp_path / "report.md").read_text())
    assert sorted(shown) == sorted(pictures)


@pytest.mark.thorough
def test_equal_views_have_no_psnr(tmp_path: Path) -> None:
    codecs = [*CODECS[:2], ("lossless", 1300.0, None, 0.0, 0.2, 0.1)]
    write_report([beside("bonsai", True, codec) for codec in codecs], tmp_path)
    page = (tmp_path / "report.md").read_text()
    assert "| `lossless` | 1.53x | 1300.0 | equal |" in page
    assert "nan" not in page
    assert " MB, 1.53x, equal |" in (tmp_path / "answers.md").read_text()


def test_a_coarse_clock_is_not_an_error(tmp_path: Path) -> None:
    lines = [beside("bonsai", True, codec) for codec in CODECS[:3]]
    lines[0]["decode_seconds"] |= {"min": 0.0}
    lines[1]["decode_seconds"] = {"median": 0.0, "min": 0.0, "max": 0.0}
    write_report(lines, tmp_path)
    assert (tmp_path / "time-bonsai.png").exists()


def test_bits_at_equal_quality_end_with_the_curve() -> None:
    results = Results(lines_of("bonsai", True))
    assert results.bits_at_quality(beside("bonsai", True, CODECS[7]), "camera-free") == "≤ 58.0"
    better = ("other", 300.0, 60.0, 0.0, 1.0, 1.0)
    assert results.bits_at_quality(beside("bonsai", True, better), "camera-free") == ""
    assert results.bits_at_quality(beside("bonsai", True, CODECS[1]), "camera-free") == ""
    exactly = ("other", 300.0, 49.71, 0.0, 1.0, 1.0)
    assert results.bits_at_quality(beside("bonsai", True, exactly), "camera-free") == "113.5"


def test_questions_are_answered_by_tables() -> None:
    found = answers(Results(lines_of_all()))
    assert found["How small?"].markdown().splitlines()[:5] == [
        "|  | bonsai, 0.2 MB | sample, 0.2 MB |",
        "| --- | ---: | ---: |",
        "| from the PLY alone: `m` | 0.01 MB, 17.5x, -0.05 dB | 0.01 MB, 17.5x, 49.7 dB |",
        "| with its cameras: `m --cameras` | 0.01 MB, 24.6x, -0.04 dB | 0.01 MB, 24.6x, 51.7 dB |",
        # To photographs where there are any.
        "| refined: `--refine --target-ratio 60` | 0.00 MB, 60.1x, +0.03 dB |  |",
    ]
    assert found["How fast?"].rows[0] == ["from the PLY alone: `m`", *["0.36 s / 0.16 s"] * 2]
    against = [row[:2] for row in found["Against other programs?"].rows]
    assert ["spz v4", "161.3 / ≤ 58.0 / ≤ 58.5"] in against
    assert ["pcodec, columns", "1333.1 / 1252.5"] in against
    assert found["How large?"].rows[1][:4] == [
        "1,000,000", "236.0 MB", "12.0 MB", "2.0 s, 0.40 GB",
    ]  # fmt: skip
    assert {question for question, table in found.items() if table.rows} == set(found)


def test_without_matplotlib_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingTool, match="pip install matplotlib"):
        write_report(lines_of_all(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    target = tmp_path / "file"
    target.write_text("mine")
    with pytest.raises(InvalidInput):
        write_report([], target)
    assert target.read_text() == "mine"
