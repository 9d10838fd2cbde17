"""The commands and code in the documents work, and their links are valid."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from scenes import thorough
from typer.main import get_command
from typer.testing import CliRunner

from gs_codec.analysis import plots
from gs_codec.bench.suite.answers import answers
from gs_codec.bench.suite.points import CAMERA_GUIDED, FREE, PAPER
from gs_codec.bench.suite.results import Results, bd_rate
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.cli.main import NAMES, app
from gs_codec.formats.ply.writer import write_ply
from gs_codec.views.estimate import auto_cameras
from samples.generate import generate

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
RESULTS = (ROOT / "gs_codec" / "bench" / "RESULTS.md").read_text()
COMMANDS = (ROOT / "gs_codec" / "cli" / "COMMANDS.md").read_text()
FOLDERS = ("gs_codec", "samples", "tests", "viewer")
DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for path in [*ROOT.glob("*.md"), *(p for f in FOLDERS for p in (ROOT / f).rglob("*.md"))]
    if "node_modules" not in path.parts
)
SHOWN = re.compile(r"```.*?^```|`[^`\n]*`", re.DOTALL | re.MULTILINE)


@pytest.fixture
def folder(tmp_path, monkeypatch, few_cameras):
    """A folder with the files that the documents assume."""
    scene = generate(1100, 1, 80)
    write_ply(tmp_path / "scene.ply", scene)
    (tmp_path / "frames").mkdir()
    for number in range(3):
        write_ply(tmp_path / "frames" / f"{number}.ply", scene)
    (tmp_path / "notes.json").write_text('[{"position": [0, 0, 0], "title": "middle"}]')
    for name in ("cameras.json", "path.json"):
        write_cameras(tmp_path / name, auto_cameras(scene, 2))
    monkeypatch.chdir(tmp_path)
    # SOG takes minutes if its program is installed.
    monkeypatch.setenv("GS_CODEC_SPLAT_TRANSFORM", "no-such-program")
    # Plots without pixels; other tests render them.
    monkeypatch.setattr(plots, "png_of", lambda plot, *args: plot(*args) and b"")
    return tmp_path


def commands_of(text: str) -> list[str]:
    return re.findall(r"^    gs-codec ([^#\n]*)", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("text", "least"), [(README, 4), thorough(COMMANDS, 18)], ids=["README", "COMMANDS"]
)
def test_commands_run_in_the_order_given(folder, text, least):
    lines = commands_of(text)
    assert len(lines) >= least
    for line in lines:
        result = CliRunner().invoke(app, shlex.split(line))
        assert result.exit_code == 0, (line, result.output)
    assert (folder / "scene.egs").exists()
    assert (folder / "decoded.ply").exists()


def measured() -> Results:
    """The committed run of the suite."""
    lines = (ROOT / "gs_codec" / "bench" / "suite.jsonl").read_text().splitlines()
    return Results([json.loads(line) for line in lines])


def rows_of(text: str) -> list[list[str]]:
    """Cells of the tables of a document."""
    lines = [line.removesuffix(" |") for line in text.splitlines() if line[:1] == "|"]
    return [line.split(" | ") for line in lines]


def test_the_tables_are_those_of_the_committed_run():
    found = dict(part.split("\n", 1) for part in RESULTS.split("\n## ")[1:])
    for question, table in answers(measured()).items():
        assert table.markdown() in found.pop(question)
    # The other tables are from the lab notebook.
    notebook = (ROOT / "gs_codec" / "bench" / "LAB_NOTEBOOK.md").read_text()
    assert len(found) == 2
    for text in found.values():
        for number in re.findall(r"\d+\.\d+", text):
            assert number in notebook


def test_the_table_of_the_first_screen_is_the_first_of_the_results():
    shown = rows_of(README.partition("## Install")[0])
    table = answers(measured())["How small?"]
    assert len(shown) == 2 + len(table.rows)
    assert shown == [row[:5] for row in rows_of(table.markdown())]


def test_the_other_figures_are_those_of_the_committed_run():
    results, first_screen = measured(), " ".join(README.partition("## Install")[0].split())
    lines = results.of("beside")

    def span(numbers, unit=""):
        low, high = f"{min(numbers):.0f}{unit}", f"{max(numbers):.0f}{unit}"
        return low if low == high else f"{low} to {high}"

    for codec, how in (("m", "in a second"), ("m, camera-guided", "in half a minute")):
        ratios = [line["ratio"] for line in lines if line["codec"] == codec]
        assert f"{span(ratios, 'x')} {how}" in first_screen
    # The targets in the table.
    targets = {int(x["codec"][3:].split("x")[0]) for x in lines if "x refined" in x["codec"]} - {35}
    assert f"{span(targets, 'x')} in minutes of refinement" in first_screen
    for line in lines:
        if line.get("truth"):
            assert f"{line['truth']['psnr']:.2f} dB" in first_screen
    for curve, text in (
        (FREE, "{} % fewer bits than EntropyGS"),
        (CAMERA_GUIDED, "cameras {} % fewer"),
    ):
        pairs = [(results.curve(x, PAPER), results.curve(x, curve)) for x in results.scenes]
        rates = [-bd_rate(*pair).percent for pair in pairs]
        assert text.format(span(rates)) in first_screen


HOW_TO = sorted((ROOT / "samples" / "docs").glob("*.md"))
#: Pages whose commands take seconds.
LONG = {"batches", "clean", "small_for_the_web", "tiles_for_cesium"}


@pytest.mark.parametrize(
    "path", [thorough(x) if x.stem in LONG else x for x in HOW_TO], ids=lambda path: path.stem
)
def test_how_to_pages_run_from_top_to_bottom(folder, path):
    text = re.sub(r"^```sh\n.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
    names: dict = {}
    if "import torch" in text:
        pytest.importorskip("torch", reason="torch is not installed")
    if "--dask" in text:
        pytest.importorskip("distributed", reason="distributed is not installed")
    step = r"^    gs-codec ([^#\n]*)|^```python\n(.*?)^```"
    steps = re.findall(step, text, re.DOTALL | re.MULTILINE)
    assert steps or path.stem == "how_it_works"
    for line, code in steps:
        if code:
            exec(compile(code, path.name, "exec"), names)
            continue
        result = CliRunner().invoke(app, shlex.split(line))
        assert result.exit_code == 0, (line, result.output)


def test_every_command_has_an_example():
    shown = {line.split()[0] for line in commands_of(COMMANDS)}
    assert shown == set(NAMES)


def test_python_example_runs(folder, capsys):
    example = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(example[1], "README.md", "exec"), {})
    assert "[1100, 3]" in capsys.readouterr().out
    assert (folder / "decoded.ply").exists()


def heading_anchors(path: Path) -> set[str]:
    """The anchors that GitHub gives to the headings of a document."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_no_conflict_markers_are_left(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    assert not re.search("^(<{7} |={7}$|>{7} )", text, re.MULTILINE)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_links_are_valid(name):
    path = ROOT / name
    for link in re.findall(r"\]\(([^)\s]+)\)", SHOWN.sub("", path.read_text())):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file).resolve() if file else path
        assert target.exists(), link
        assert target == ROOT or ROOT in target.parents, f"{link} leaves the repository"
        assert not anchor or anchor in heading_anchors(target), link


@pytest.mark.parametrize("name", DOCUMENTS)
def test_make_targets_exist(name):
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^    make (\w+)", (ROOT / name).read_text(), re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize(("target", "wanted"), [("test", False), ("test-all", True)])
def test_packages_of_few_tests_are_installed_where_required(tmp_path, target, wanted):
    command = ["make", "--dry-run", "--no-print-directory", f"VENV={tmp_path}", target]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    for what in ("torch", "cluster", "system-packages all", "openssh-server"):
        assert any(what in line for line in lines) == wanted, what
    for number, line in enumerate(lines):
        if "pip" in line and "install" in line:
            before = [other for other in lines[:number] if other.startswith("echo")]
            assert "Installing" in "".join(before[-2:]), "installs, and has not said what"


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_ci_runs_all_but_thorough_tests(tmp_path):
    assert re.search("^make .*test", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)
    of_all, of_ci = (
        subprocess.run(
            ["make", "--dry-run", "--no-print-directory", f"VENV={tmp_path}", target],
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout.splitlines()[-1]
        for target in ("test-all", "test")
    )  # fmt: skip
    assert of_ci == of_all.replace("--cov --cov-report=term", '-m "not thorough"')


def test_documents_are_linked():
    linked = {
        (ROOT / name).parent.joinpath(link).resolve()
        for name in DOCUMENTS
        for link in re.findall(r"\]\(([^)#\s]+)", (ROOT / name).read_text())
    }
    assert [name for name in DOCUMENTS if name != "README.md" and ROOT / name not in linked] == []


def test_commands_have_options_that_exist():
    """The commands of the results take hours, so only their option names are checked."""
    typed = re.compile(r"^    [^`\n]*?gs-codec ((?:'[^'\n]*'|[^';#\n])*)", re.MULTILINE)
    lines = [line for name in DOCUMENTS for line in typed.findall((ROOT / name).read_text())]
    assert len(lines) > 100
    for line in lines:
        command, words = get_command(app), shlex.split(line)
        while hasattr(command, "commands"):
            command = command.get_command(None, words.pop(0))
            assert command is not None, line
        known = {option for parameter in command.params for option in parameter.opts}
        options = {word.split("=")[0] for word in words if re.match(r"-+[a-z]", word)}
        assert options <= known, line
