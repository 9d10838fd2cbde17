"""Fixtures shared by several test files."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
from collections import Counter
from functools import partial
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest

from gs_codec.cli import output
from gs_codec.config import Config
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply

# Assertions in shared modules report values too.
pytest.register_assert_rewrite(*(path.stem for path in Path(__file__).parent.glob("*.py")))

from command_line import Folder, run_here  # noqa: E402
from scenes import estimate_few_cameras, random_scene  # noqa: E402

# A shell that starts tests in the background makes them, and their child processes, ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Output of other processes does not depend on how long kernels take to compile.
os.environ["GS_CODEC_PROGRESS"] = "0"

#: Number of examples per property test.
EXAMPLES = 25

#: Start the slowest files first, so that no worker ends long after the others; among these, files
#: with kernels of their own, because workers that need the same kernels wait for one to compile
#: them. Tests that wait for windows and browsers leave the processors to others.
FIRST = (
    "test_viewer_more.py", "test_viewer_window.py", "test_optimise.py", "test_interchange.py",
    "test_web_page.py", "test_rate.py", "test_tutorial.py", "test_readme.py", "test_distributed.py",
    "test_batch_processes.py", "test_damage.py", "test_analysis.py", "test_cli.py",
    "test_web_decoder.py", "test_web_detail.py", "test_web_levels.py", "test_levels.py",
    "test_gpcc.py", "test_format.py", "test_suite.py", "test_calibrate.py", "test_auto_cameras.py",
    "test_usd.py", "test_torchac.py", "test_lossless.py", "test_storage.py",
)  # fmt: skip


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rounds", type=int, default=1, metavar="N", help="N times as many random examples"
    )
    parser.addoption(
        "--quick", action="store_true", help="of each file, the first test that is not slow"
    )


def pytest_configure(config: pytest.Config) -> None:
    rounds = config.getoption("rounds")
    config.addinivalue_line("markers", "rounds(n): `seed` goes from 0 to n times --rounds")
    config.addinivalue_line("markers", "thorough: takes seconds; for `make test-all`, not for CI")
    config.addinivalue_line("markers", "slow: takes a second or more; not for `make quick`")
    config.addinivalue_line("markers", "one_in(n): all but one case in n are thorough")
    # The same examples on every run, however slow the machine.
    hypothesis.settings.register_profile(
        "same",
        derandomize=True,
        deadline=None,
        database=None,
        print_blob=True,
        max_examples=EXAMPLES * rounds,
        suppress_health_check=[hypothesis.HealthCheck.too_slow],
    )
    hypothesis.settings.load_profile("same")


@pytest.hookimpl(tryfirst=True)  # before any are deselected
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    order = {name: place for place, name in enumerate(FIRST)}
    items.sort(key=lambda item: order.get(item.path.name, len(FIRST)))
    numbers: Counter[tuple[Path, str]] = Counter()
    for item in items:
        for mark in item.iter_markers("one_in"):
            if item.get_closest_marker("thorough"):
                continue
            (n,), test = mark.args, (item.path, item.originalname)
            # By the digit sum to base n, so that every row of a table begins with another case.
            number, digits = numbers[test], 0
            while number:
                number, digit = divmod(number, n)
                digits += digit
            if digits % n:
                item.add_marker("thorough")
            numbers[test] += 1
    if config.getoption("quick"):
        left = (item for item in reversed(items) if not {"thorough", "slow"} & marks_of(item))
        firsts = {item.path: item for item in left}
        config.hook.pytest_deselected(items=[x for x in items if firsts.get(x.path) is not x])
        items[:] = [x for x in items if firsts.get(x.path) is x]


def marks_of(item: pytest.Item) -> set[str]:
    """Names of a test's marks, and of those of its file."""
    return {mark.name for mark in item.iter_markers()}


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests were skipped for each reason."""
    reports = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in reports)
    if reasons:
        terminalreporter.section("skipped, and why")
    for reason, number in reasons.most_common():
        terminalreporter.line(f"{number:5}  {reason}")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give tests marked `rounds` their seeds."""
    for mark in metafunc.definition.iter_markers("rounds"):
        seeds = mark.args[0] * metafunc.config.getoption("rounds")
        metafunc.parametrize("seed", range(seeds))


@pytest.fixture(autouse=True)
def _no_progress_by_the_clock(monkeypatch):
    """stderr has the same lines, however slow the machine or the compilation of kernels."""
    monkeypatch.setattr(output, "SECONDS_A_LINE", math.inf)


@pytest.fixture
def few_cameras(monkeypatch):
    """See `estimate_few_cameras`."""
    estimate_few_cameras(monkeypatch)


@pytest.fixture(scope="session")
def display():
    """A virtual display."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait()


class Trio(NamedTuple):
    """A scene as PLY, encoded, and decoded."""

    ply: Path
    egs: Path
    decoded: Path


@pytest.fixture(scope="session")
def trio(tmp_path_factory: pytest.TempPathFactory) -> Trio:
    """Files of ``random_scene(1500, 3, seed=100)``; tests only read them."""
    folder = tmp_path_factory.mktemp("trio")
    paths = Trio(folder / "scene.ply", folder / "scene.egs", folder / "decoded.ply")
    write_ply(paths.ply, random_scene(1500, 3, seed=100))
    encode_file(paths.ply, paths.egs, Config("paper-m"))
    decode_file(paths.egs, paths.decoded)
    return paths


@pytest.fixture
def run_codec(monkeypatch, capsys):
    """Run `gs-codec` in this process; return status, stdout and stderr."""
    return partial(run_here, monkeypatch, capsys, "gs-codec")


@pytest.fixture
def run_viewer(monkeypatch, capsys):
    """Run `gs-viewer` in this process; return status, stdout and stderr."""
    return partial(run_here, monkeypatch, capsys, "gs-viewer")


@pytest.fixture
def folder(trio, tmp_path, monkeypatch, capsys):
    """A folder with `scene.ply`, `scene.egs`, `decoded.ply`, and a camera."""
    from camera_files import inria_entry, write_json

    for path in trio:
        shutil.copy(path, tmp_path)
    write_json(tmp_path / "cameras.json", inria_entry(width=40, height=30, fx=40.0, fy=40.0))
    monkeypatch.chdir(tmp_path)
    return Folder(tmp_path, monkeypatch, capsys)
