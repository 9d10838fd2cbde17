"""The tutorial, typed from its first line to its last, prints what it shows."""

from __future__ import annotations

import contextlib
import io
import math
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gs_codec.cli.main import app
from samples.generate import main as generate
from viewer.main import app as viewer

TUTORIAL = (Path(__file__).parents[1] / "samples" / "TUTORIAL.md").read_text()

#: How far a shown number may be from what comes out: releases of numpy differ in last digits.
TOLERANCE = 0.03

_STEP = re.compile(
    r"^    (?P<command>(?:gs-codec|gs-viewer|python) [^\n]*)$"
    r"|^```python\n(?P<code>.*?)^```$"
    r"|^```text\n(?P<shown>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)


def type_all(folder: Path) -> tuple[list[tuple[str, str, str]], set[str]]:
    """Commands and code of the tutorial in order, with what is printed and shown; all files."""
    done = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for step in _STEP.finditer(TUTORIAL):
            if step["shown"] is not None:
                what, printed, _ = done[-1]
                done[-1] = (what, printed, step["shown"])
            elif step["code"]:
                done.append(("python", _run_code(step["code"]), ""))
            else:
                done.append((step["command"], _type(step["command"]), ""))
        files = {path.name for path in Path().iterdir()}
    return done, files


def _type(line: str) -> str:
    program, *arguments = shlex.split(line)
    if program == "python":
        assert arguments.pop(0) == "samples/generate.py"
        generate(arguments)
        return ""
    result = CliRunner().invoke({"gs-codec": app, "gs-viewer": viewer}[program], arguments)
    assert result.exit_code == 0, (line, result.output)
    return result.stdout


def _run_code(code: str) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(code, "TUTORIAL.md", "exec"), {})
    return printed.getvalue()


def _agrees(shown: str, printed: str) -> bool:
    """Whether a line is as shown, up to where that is cut short, numbers nearly."""
    cut = shown.endswith("...")
    wanted, found = shown.removesuffix("...").split(), printed.split()
    if len(found) < len(wanted) or (not cut and len(found) > len(wanted)):
        return False
    return all(_is_near(*pair) for pair in zip(wanted, found, strict=False))


def _is_near(wanted: str, found: str) -> bool:
    try:
        a, b = (float(word.replace(",", "").rstrip("%")) for word in (wanted, found))
    except ValueError:
        return wanted == found
    return a == b or math.isclose(a, b, rel_tol=TOLERANCE)


@pytest.mark.thorough
def test_every_command_runs_and_prints_what_is_shown(tmp_path):
    done, files = type_all(tmp_path)
    assert len(done) >= 12
    for what, printed, shown in done:
        lines = iter(printed.splitlines())
        for line in shown.splitlines():
            if line.strip() != "...":
                assert any(_agrees(line, found) for found in lines), (what, line, printed)
    for name in ("decoded.ply", "error.png", "pruned.png", "report", "analysis", "views"):
        assert name in files
    named = set(re.findall(r"^    gs-codec (?:encode|decode) \S+ (\S+)", TUTORIAL, re.MULTILINE))
    assert named <= files
