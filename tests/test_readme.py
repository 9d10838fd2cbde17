"""What the README tells people to type works."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec.cli.main import app
from gs_codec.io.ply import write_ply

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder that holds a scene.ply, as the README assumes."""
    write_ply(tmp_path / "scene.ply", random_scene(1000, 3, seed=80))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_commands_run_in_the_order_given(folder):
    lines = re.findall(r"^    gs-codec ([^#\n]*)", README, re.MULTILINE)
    assert len(lines) >= 6
    for line in lines:
        result = CliRunner().invoke(app, shlex.split(line))
        assert result.exit_code == 0, (line, result.output)
    assert (folder / "scene.egs").exists()
    assert (folder / "decoded.ply").exists()


def test_python_example_runs(folder, capsys):
    example = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(example[1], "README.md", "exec"), {})
    assert "[1000, 3]" in capsys.readouterr().out
    assert (folder / "decoded.ply").exists()


def test_links_and_make_targets_exist():
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^    make (\w+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
