"""Run the commands in this process or another, and capture their output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from gs_codec.cli import main as cli
from viewer import main as viewer

ROOT = Path(__file__).parents[1]


class Result(NamedTuple):
    status: int
    out: str
    err: str


def run_here(monkeypatch, capsys, program: str, *arguments: object) -> Result:
    """Run `gs-codec` or `gs-viewer` in this process."""
    monkeypatch.setattr(sys, "argv", [program, *map(str, arguments)])
    try:
        (cli.main if program == "gs-codec" else viewer.main)()
        status = 0
    except SystemExit as stop:
        status = stop.code or 0
    return Result(status, *capsys.readouterr())


class Folder:
    """A working folder with `scene.ply`, `scene.egs`, `decoded.ply`, and a way to run commands."""

    def __init__(self, path: Path, monkeypatch, capsys) -> None:
        self.path, self.monkeypatch, self.capsys = path, monkeypatch, capsys

    def run(self, *arguments: str) -> Result:
        """Run gs-codec in this process."""
        self.capsys.readouterr()
        return run_here(self.monkeypatch, self.capsys, "gs-codec", *arguments)

    def contents(self) -> dict[str, bytes | None]:
        """All files with their bytes, including hidden ones and folders."""
        return {
            str(path.relative_to(self.path)): path.read_bytes() if path.is_file() else None
            for path in self.path.rglob("*")
        }

    def refuse(self, *arguments: str) -> str:
        """Run a command that must fail; check its line, status and the folder; return the line."""
        before = self.contents()
        status, out, err = self.run(*arguments)
        if "--json" in arguments:
            out = "" if strict_json(out)["error"] else out
        assert (status, out) == (2, "")
        assert_one_error_line(err)
        assert self.contents() == before
        return err


def assert_one_error_line(err: str) -> None:
    assert err.startswith("gs-codec: error: ")
    assert err.endswith("\n")
    # A missing argument adds a usage line.
    assert len([line for line in err.splitlines() if not line.startswith("usage: ")]) == 1


def strict_json(text: str) -> dict:
    """The only JSON document on stdout, without NaN and Infinity, which are not JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def python(*arguments: str, cwd: Path = ROOT) -> Result:
    """Run Python in another process that can import gs_codec."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    return Result(done.returncode, done.stdout, done.stderr)
