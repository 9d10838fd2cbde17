"""The suite's report, from made lines: every section, any subset of lines, names that try it."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gs_codec.analysis.figure import new_figure
from gs_codec.bench.suite.headline import headline
from gs_codec.bench.suite.labels import Label, place_labels
from gs_codec.bench.suite.looks import looks_of, plain
from gs_codec.bench.suite.quality import QualityAxis, on_front
from gs_codec.bench.suite.report import write_report
from gs_codec.bench.suite.results import Results
from gs_codec.bench.suite.sections import SECTIONS
from gs_codec.errors import InvalidInput, MissingTool

Line = dict[str, Any]

#: Codec, bits a Gaussian, PSNR, delta-PSNR, seconds to encode and to decode.
CODECS = [
    ("l", 149.9, 54.94, -0.014, 0.39, 0.17),
    ("m", 113.5, 49.71, -0.052, 0.36, 0.16),
    ("s", 79.6, 43.84, -0.192, 0.33, 0.15),
    ("paper-l", 197.9, 50.73, -0.033, 0.31, 0.12),
    ("paper-m", 162.7, 46.99, -0.089, 0.30, 0.11),
    ("lossless", 1252.5, None, 0.0, 0.96, 0.12),
    ("m, by views", 80.5, 51.70, -0.044, 55.0, 0.12),
    ("spz v4", 161.3, 38.05, -0.755, 0.43, 0.05),
    ("pcodec, columns", 1333.1, None, 0.0, 0.22, 0.03),
    ("slow", 170.0, 38.0, -0.8, 2.0, 1.0),
]
POINTS = {
    "paper": [("paper-l", 197.9, 50.73), ("paper-m", 162.7, 46.99), ("paper-s", 131.4, 42.37)],
    "by attributes": [("l", 149.9, 54.94), ("m", 113.5, 49.71), ("s, steps x 2", 58.0, 39.16)],
    "by views": [("m", 80.5, 51.7), ("s", 58.5, 45.79)],
}


def beside(scene: str, photographs: bool, codec: tuple, kind: str = "beside") -> Line:
    name, bits, psnr, delta, encode, decode = codec
    line = {
        "kind": kind, "scene": scene, "codec": name, "version": "1", "own_process": name == "slow",
        "gaussians": 1000,
        "ply_bytes": 248000, "ratio": 1984 / bits, "bits_per_gaussian": bits,
        "mean": {"psnr": psnr, "ssim": 0.99}, "worst_psnr": psnr,
        "encode_seconds": {"median": encode, "min": 0.9 * encode, "max": 1.2 * encode},
        "decode_seconds": {"median": decode, "min": 0.9 * decode, "max": 1.2 * decode},
    }  # fmt: skip
    return line | ({"delta": {"psnr": delta, "ssim": 0.0}} if photographs else {})


def lines_of(scene: str, photographs: bool) -> list[Line]:
    """Lines of every kind that a scene has."""
    entropy = {"bits_per_symbol": 6.5, "parametric_overhead_percent": 0.06}
    groups = [{"name": "opacity", "unit": "logit", "max": 0.045, "rms": 0.011}]
    spread = {"median": 0.4, "min": 0.3, "max": 0.5}
    named = {"scene": scene, "gaussians": 1000}
    lines: list[Line] = [
        {
            "kind": "scene", **named, "sh_degree": 3, "ply_bytes": 248000, "cameras": "auto",
            "measured_views": 24, "encoded_by_views": 64, "width": 300, "height": 200,
            "photographs": photographs,
        },
    ]  # fmt: skip
    for profile in ("m", "paper-m"):
        stages = {"read": 0.1, "model": 0.2} if profile == "m" else {"read": 0.1, "fit": 0.1}
        lines += [
            {
                "kind": "codec", **named, "profile": profile, "encode_seconds": spread,
                "decode_seconds": spread, "stages": stages | {"decode": 0.1, "rows": 0.05},
                "entropy": {"rotation": entropy | {"coded_overhead_percent": 0.065}},
            },
            {"kind": "error", **named, "profile": profile, "groups": groups},
            {
                "kind": "memory", **named, "profile": profile, "encode_peak_bytes": 3e8,
                "decode_peak_bytes": 2e8, "float_bytes": 236000,
            },
        ]  # fmt: skip
    lines += [beside(scene, photographs, codec) for codec in CODECS]
    lines.append({"kind": "beside", "scene": scene, "codec": "SOG", "absent": "SOG: no <node>"})
    if photographs:
        pruned = ("m, 39 % pruned", 56.0, 46.1, -0.084, 222.0, 0.09)
        lines.append(beside(scene, True, pruned, "pruned"))
    for curve, points in POINTS.items():
        for name, bits, psnr in points:
            known = {"point": name, "bits_per_gaussian": bits, "mean": {"psnr": psnr}}
            lines.append({"kind": "point", "scene": scene, "curve": curve, **known})
    for curve, bits, lower in (("by attributes", 96.8, None), ("by views", 62.4, 44.0)):
        at = {"at": "paper-m", "psnr": 46.99, "paper_bits_per_gaussian": 162.7}
        saving = {"bits_per_gaussian": bits, "saving_percent": 100 - bits / 1.627}
        rate = {"range": [42.4, 54.9], "percent": -40.3}
        theirs = {"codec": "spz v4", "psnr": 38.05, "bits_per_gaussian": 161.3}
        ours = {"curve_bits_per_gaussian": lower, "saving_percent": None}
        lines += [
            {"kind": "gain", "scene": scene, "curve": curve, **at, **saving},
            {"kind": "bd-rate", "scene": scene, "curve": curve, **rate},
            {"kind": "equal", "scene": scene, "curve": curve, **theirs, **ours},
        ]
    for part, bits in (("nothing", 0.0), ("steps as fine", 0.0), ("Y, Co, Cg", 16.3)):
        known = {"without": part, "profile": "m", "by_views": False, "psnr": 49.7}
        known |= {"bits_per_gaussian": 113.5, "saved_bits": bits}
        lines.append({"kind": "part", "scene": scene, **known})
    for step, psnr in (("original", 29.7), ("colour refit", 29.1), ("geometry coding", 28.9)):
        quality = {"quality": {"psnr": psnr}, "delta": {"psnr": psnr - 29.7}}
        lines.append({"kind": "ablation", **named, "step": step, "file_bytes": 9e5, **quality})
    return lines


def lines_of_all() -> list[Line]:
    """Lines of a whole run: two scenes, with photographs and without."""
    lines: list[Line] = [
        {
            "kind": "machine", "processor": "EPYC", "threads": 2, "memory_bytes": 8e9,
            "commit": "abc", "packages": {"numpy": "2"}, "seed": 0, "command": "gs-codec bench",
        },
        {"kind": "skipped", "group": "curves"},
        *lines_of("sample", photographs=False),
        *lines_of("bonsai", photographs=True),
    ]  # fmt: skip
    coder = {"kind": "coder", "scene": "bonsai", "profile": "paper-m", "coder": "rans"}
    coder |= {"symbols": 10, "bytes": 9, "overhead_percent": 0.03}
    lines.append(coder | {"encode_seconds": 0.1, "decode_seconds": 0.2})
    points = {"kind": "points", "scene": "bonsai", "coder": "octree", "encode_peak_bytes": 3e8}
    points |= {"geometry_bits_per_gaussian": 24.6, "colour_bits_per_gaussian": 14.8}
    times = {f"{way}_cpu_seconds": {"median": 0.4} for way in ("encode", "decode")}
    lines.append(points | times | {"decode_peak_bytes": 2e8})
    for count in (100_000, 1_000_000):
        used = {"seconds": count / 1e6, "cpu_seconds": count / 5e5, "peak_bytes": 400 * count}
        known = {"scene": str(count), "profile": "m", "gaussians": count}
        known |= {"float_bytes": 236 * count, "encode": used, "decode": used}
        lines.append({"kind": "scaling", **known})
    times = {"median": 0.5, "min": 0.4, "max": 0.75}
    start = {"kind": "start", "scene": "bonsai", "command": "decode", "gaussians": 1000}
    lines.append(start | {"seconds": times, "cpu_seconds": times})
    growth = {"seconds_per_million": 2.0}
    lines.append({"kind": "growth", "profile": "m", "encode": growth, "decode": growth})
    return lines


KINDS = sorted({line["kind"] for line in lines_of_all()})


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite") / "report"
    write_report(lines_of_all(), folder)
    return folder


def test_every_section_is_there_in_order(written: Path) -> None:
    page = (written / "report.html").read_text()
    titles = re.findall(r"<h2[^>]*>([^<]*)</h2>", page)
    assert [title.replace("&#x27;", "'") for title in titles] == list(SECTIONS)
    assert "Without results" not in page


def test_page_needs_nothing_else(written: Path) -> None:
    page = (written / "report.html").read_text()
    assert not re.search(r'(src|href)="(?!data:image/png;base64,|#)', page)
    assert all(anchor in page for anchor in re.findall(r'href="#([^"]*)"', page))
    for image in re.findall(r"<img [^>]*>", page):
        assert re.search(r'alt="[^"]{20,}"', image)


def test_pictures_lie_beside_the_page(written: Path) -> None:
    names = sorted(path.name for path in written.iterdir())
    plots = ("equal", "memory", "parts", "rate", "stages", "time")
    pictures = [f"{plot}-{scene}.png" for plot in plots for scene in ("bonsai", "sample")]
    assert names == sorted([*pictures, "scaling.png", "headline.md", "report.html"])
    for path in written.glob("*.png"):
        with Image.open(path) as image:
            assert image.width == 1260
            # More than paper: something is drawn.
            assert np.asarray(image.convert("L")).std() > 5
    assert (written / "report.html").read_text().count("<img ") == len(pictures) + 1


@pytest.mark.parametrize(
    "text",
    [
        "62.4, 62\N{NO-BREAK SPACE}%\N{NO-BREAK SPACE}fewer",  # by views, at paper-m
        "≤\N{NO-BREAK SPACE}58.0, at\N{NO-BREAK SPACE}least",  # spz, below our curve
        "lossless:\N{NO-BREAK SPACE}1252.5",  # beside pcodec
        "-40.3\N{NO-BREAK SPACE}%",
        "slow (by l)",  # beaten in everything
        "0.39\N{NO-BREAK SPACE}(0.35\N{WORD JOINER}–\N{WORD JOINER}0.47)",
        "27.42",  # the paper's ablation
        "EPYC",
        "Left out with --skip: curves.",
        "SOG: no &lt;node&gt;",
        "<td>slow\N{NO-BREAK SPACE}*</td>",
    ],
)
def test_page_says(written: Path, text: str) -> None:
    page = (written / "report.html").read_text()
    assert text.replace(", ", ",\N{NO-BREAK SPACE}") in page or text in page


@pytest.mark.parametrize("kind", KINDS)
def test_lines_of_one_kind_will_do(kind: str, tmp_path: Path) -> None:
    others = [line for line in lines_of_all() if line.get("scene") != "sample"]
    write_report([line for line in others if line["kind"] == kind], tmp_path)
    assert (tmp_path / "report.html").read_text().endswith("</html>\n")


@pytest.mark.parametrize("kind", ["beside", "scene", "point"])
def test_lines_without_one_kind_will_do(kind: str, tmp_path: Path) -> None:
    kinds = {"scene", "beside", "pruned", "point", "gain", "equal"} - {kind}
    write_report([line for line in lines_of("bonsai", True) if line["kind"] in kinds], tmp_path)
    assert (tmp_path / "headline.md").read_text().startswith("| scene")


def test_no_lines_make_an_empty_report(tmp_path: Path) -> None:
    write_report([], tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "<h2" not in page
    assert f"Without results: {next(iter(SECTIONS))}" in page


def test_lines_survive_json(tmp_path: Path) -> None:
    lines = [x for x in lines_of("bonsai", True) if x["kind"] in ("gain", "point", "memory")]
    write_report(lines, tmp_path / "a")
    write_report(json.loads(json.dumps(lines)), tmp_path / "b")
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


@pytest.mark.parametrize("name", ["<b>&\"'", "../../up | `x` [a](b)", "$x_{$\n\t\x00", "森" * 60])
def test_names_are_but_text(name: str, tmp_path: Path) -> None:
    lines = [beside(name, False, (name, *codec[1:])) for codec in CODECS[:2]]
    lines += [line for line in lines_of(name, photographs=False) if line["kind"] != "part"]
    write_report(lines, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<b>" not in page
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    rows = (tmp_path / "out" / "headline.md").read_text().splitlines()
    assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1
    assert not any("<" in row for row in rows)


def test_two_scenes_of_one_file_name_keep_their_pictures(tmp_path: Path) -> None:
    lines = [line for name in ("a b", "a-b") for line in lines_of(name, photographs=False)]
    write_report([line for line in lines if line["kind"] == "memory"], tmp_path)
    assert (tmp_path / "memory-a-b.png").exists()
    assert (tmp_path / "memory-a-b-2.png").exists()


@pytest.mark.parametrize("psnr", [None, float("nan"), float("inf")])
def test_equal_views_have_no_psnr(psnr: float | None, tmp_path: Path) -> None:
    codecs = [*CODECS[:2], ("exact", 1300.0, psnr, psnr, 0.2, 0.1)]
    lines = [beside("bonsai", True, codec) for codec in codecs]
    write_report(lines, tmp_path)
    page = (tmp_path / "report.html").read_text()
    row = re.search(r"<tr[^>]*><td>exact</td>.*?</tr>", page, re.DOTALL)
    assert row
    assert "<td>equal</td>" in row[0]
    assert "nan" not in page.lower().replace("data:image", "")[:20000]
    assert "| exact | 1.53x | 1300.0 | 0 |" in (tmp_path / "headline.md").read_text()


def test_a_clock_too_coarse_is_no_error(tmp_path: Path) -> None:
    lines = [beside("bonsai", True, codec) for codec in CODECS[:3]]
    lines[0]["decode_seconds"] |= {"min": 0.0}
    lines[1]["decode_seconds"] = {"median": 0.0, "min": 0.0, "max": 0.0}
    write_report(lines, tmp_path)
    assert (tmp_path / "time-bonsai.png").exists()


def test_headline_is_the_table_of_the_readme() -> None:
    assert headline(lines_of_all()) == [
        "| scene (Gaussians, SH degree) | codec | times smaller | bits / Gaussian | delta-PSNR | "
        "encode | decode | ours at that PSNR, by attributes | by views |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        "| bonsai (1,000, 3) | `m` | 17.5x | 113.5 | -0.05 dB | 0.36 s | 0.16 s |  |  |",
        "|  | `m`, by views | 24.6x | 80.5 | -0.04 dB | 55 s | 0.12 s |  |  |",
        "|  | `m`, 39 % pruned | 35.4x | 56.0 | -0.08 dB | 3.7 min | 0.09 s |  |  |",
        "|  | `lossless` | 1.58x | 1252.5 | 0 | 0.96 s | 0.12 s |  |  |",
        "|  | `paper-m`: EntropyGS | 12.2x | 162.7 | -0.09 dB | 0.30 s | 0.11 s | 96.8 | 62.4 |",
        "|  | spz v4 | 12.3x | 161.3 | -0.76 dB | 0.43 s | 0.05 s | ≤ 58.0 | 44.0 |",
        "|  | pcodec, columns | 1.49x | 1333.1 | 0 | 0.22 s | 0.03 s | 1252.5 (`lossless`) |  |",
        r"|  | slow \* | 11.7x | 170.0 | -0.80 dB | 2.00 s | 1.00 s |  |  |",
        "| sample (1,000, 3) | `m` | 17.5x | 113.5 | 49.7 dB PSNR | 0.36 s | 0.16 s |  |  |",
        "|  | `m`, by views | 24.6x | 80.5 | 51.7 dB PSNR | 55 s | 0.12 s |  |  |",
        "| *the paper, its mean scene (1.12 M), CPU* |  |  |  | *-0.18 dB* | *16.4 s* | *13.8 s* |"
        "  |  |",
    ]


def test_headline_without_photographs_has_psnr() -> None:
    rows = headline(lines_of("sample", photographs=False))
    assert "| PSNR |" in rows[0]
    assert "| 49.7 dB |" in rows[2]
    assert not any("delta" in row for row in rows)


def test_without_matplotlib_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingTool, match="pip install matplotlib"):
        write_report(lines_of_all(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    target = tmp_path / "file"
    target.write_text("mine")
    with pytest.raises(InvalidInput):
        write_report([], target)
    assert target.read_text() == "mine"


def test_labels_do_not_overlap() -> None:
    figure = new_figure(6, 4)
    axis = figure.add_subplot()
    axis.set_xlim(0, 4)
    axis.set_ylim(0, 4)
    places = [(2 + 0.08 * i, 2 + 0.1 * (i % 3)) for i in range(9)]
    place_labels(axis, [Label(x, y, f"codec {x:.2f}", "black") for x, y in places], [])
    boxes = [text.get_window_extent() for text in axis.texts]
    frame = axis.get_window_extent()
    for i, box in enumerate(boxes):
        assert frame.x0 <= box.x0
        assert box.x1 <= frame.x1
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert not any(box.contains(*axis.transData.transform(place)) for place in places)


def test_front_is_what_none_beats() -> None:
    assert on_front([(1, 5), (2, 3), (2, 4), (3, 3), (4, 1)]) == [True, True, False, False, True]
    assert on_front([(1, 1), (1, 1)]) == [True, True]
    assert on_front([]) == []


def test_losses_keep_their_order() -> None:
    axis = QualityAxis(by_photographs=True)
    places = [axis.place(loss) for loss in (-5.0, -0.5, -0.05, -0.01, 0.0, 0.01)]
    assert places == sorted(places)
    assert places[4] == 0


def test_codecs_look_the_same_in_every_plot() -> None:
    looks = looks_of(Results(lines_of_all()))
    assert looks["m"].colour == looks["l"].colour != looks["m, by views"].colour
    assert not looks["m, 39 % pruned"].filled
    peers = [looks[name] for name in ("spz v4", "pcodec, columns", "slow")]
    assert len({(look.colour, look.mark) for look in peers}) == 3


def test_plain_text_is_short_and_drawable() -> None:
    assert plain("a\n b\x00") == "a b?"
    assert plain("森") == "?"
    assert len(plain("x" * 99)) == 44
