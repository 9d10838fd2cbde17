"""Untrusted text and names in messages cannot control the terminal."""

from __future__ import annotations

import ast
import logging
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from batch_work import in_this_process
from command_line import Folder, assert_one_error_line
from scenes import random_scene

import gs_codec
from gs_codec.batch import run
from gs_codec.cli.output import log_to_stderr
from gs_codec.config import Config
from gs_codec.errors import CorruptStream, InvalidInput, one_line, printable
from gs_codec.files.writing import write_scene
from gs_codec.scene import GROUPS, Scene
from viewer.main import main as viewer_main

#: Title, clear screen, bell, an 8-bit escape, text direction, and line ends.
HOSTILE = "a\x1b]0;b\x07\x1b[2J\x9b1m\u202ec\u2066\u200f\u2028d\n\re"


@pytest.fixture
def folder(tmp_path, monkeypatch, capsys) -> Folder:
    """A scene with a hostile name, and commands that run in this process."""
    write_scene(tmp_path / f"{HOSTILE}.ply", random_scene(60, 0), Config())
    monkeypatch.setattr(run, "Pool", in_this_process)
    monkeypatch.chdir(tmp_path)
    return Folder(tmp_path, monkeypatch, capsys)


def assert_printable(*texts: str) -> None:
    for text in texts:
        assert all(line.isprintable() for line in text.split("\n"))
        assert HOSTILE[:4] not in text


def test_terminal_controls_are_escaped():
    assert printable("né 中 'x' \\") == "né 中 'x' \\"
    assert printable("\x1b[2J\x07\u202e\udc80\n") == r"\x1b[2J\x07\u202e\udc80\n"
    assert printable(printable(HOSTILE)) == printable(HOSTILE)
    assert printable(HOSTILE).isprintable()


@pytest.mark.parametrize("kind", [gs_codec.GsCodecError, InvalidInput, CorruptStream])
def test_errors_are_printable(kind):
    assert str(kind(f"{HOSTILE}: no such file")).endswith("e: no such file")
    assert_printable(str(kind(HOSTILE)), one_line(ValueError(HOSTILE)))
    assert one_line(OSError(2, HOSTILE)).isprintable()


def test_messages_that_are_logged_are_printable(capsys):
    root = logging.getLogger()
    before = root.handlers[:]
    root.handlers.clear()
    try:
        log_to_stderr("gs-codec")
        logging.getLogger("gs_codec.formats.ply.file").warning("%s: not kept", HOSTILE)
    finally:
        root.handlers[:] = before
    err = capsys.readouterr().err
    assert err.startswith("gs-codec: warning: a\\x1b]0;b\\x07")
    assert err.count("\n") == 1
    assert_printable(err)


def test_warnings_of_other_packages_are_lines(capsys):
    root, before = logging.getLogger(), warnings.showwarning
    handlers = root.handlers[:]
    root.handlers.clear()
    try:
        log_to_stderr("gs-codec")
        warnings.showwarning(RuntimeWarning("over\nflow\x07"), RuntimeWarning, "/a/there.py", 7)
    finally:
        root.handlers[:], warnings.showwarning = handlers, before
    assert capsys.readouterr().err == "gs-codec: warning: over flow\\x07 (there.py, line 7)\n"


def with_huge_values() -> Scene:
    """A scene with values near the limits of float32 in each attribute."""
    scene = random_scene(300, 1, seed=9)
    huge = np.float32(3.4e38)
    for group in GROUPS:
        plane = getattr(scene, group)
        for value in (huge, -huge) if group != "log_scale" else (np.float32(80), -huge):
            plane[:, np.random.default_rng(len(group)).integers(300, size=40)] = value
    return scene


@pytest.mark.parametrize(
    "command",
    [
        "inspect huge.ply --json",
        "encode huge.ply out.egs",
        "encode huge.ply out.egs -p paper-m",
        "convert huge.ply out.spz",
        "convert huge.ply out.sog",
        "prepare huge.ply out.ply --prune-geometry 0.01 --prune-importance 1 --views 2",
        "compare huge.ply scene.ply",
    ],
)
def test_huge_values_give_no_warnings_of_numpy(command, tmp_path, monkeypatch, capsys):
    """In tests, such a warning is an exception, not a SystemExit."""
    monkeypatch.chdir(tmp_path)
    write_scene("huge.ply", with_huge_values(), Config())
    write_scene("scene.ply", random_scene(300, 1), Config())
    done = Folder(tmp_path, monkeypatch, capsys).run(*command.split())
    assert done.status in (0, 2)
    assert "RuntimeWarning" not in done.err


@pytest.mark.parametrize(
    "command",
    [
        "encode {}.ply {}.egs",
        "convert {}.ply {}.splat",
        "encode {}.none {}.egs",
        "inspect {}.ply",
        "compare {}.ply {}.ply",
        "render {}.ply --cameras {}.json --out out",
        "--{}",
    ],
)
def test_names_of_files_are_printed_escaped(command, folder):
    done = folder.run(*[part.format(HOSTILE) for part in command.split()])
    assert_printable(done.out, done.err)


def test_decoding_prints_names_escaped(folder):
    assert folder.run("encode", f"{HOSTILE}.ply", f"{HOSTILE}.egs").status == 0
    for command in (["inspect"], ["verify"], ["inspect", "--channels"]):
        done = folder.run(*command, f"{HOSTILE}.egs")
        assert done.status == 0
        assert printable(HOSTILE) in done.out
        assert_printable(done.out, done.err)
    done = folder.run("decode", f"{HOSTILE}.egs", f"{HOSTILE}2.ply")
    assert printable(HOSTILE) in done.out
    assert_printable(done.out, done.err)


def test_a_batch_prints_names_escaped(folder):
    Path(f"{HOSTILE}.spz").write_bytes(b"no scene")
    done = folder.run("batch", f"{HOSTILE}.ply", "out")
    assert done.status == 0
    assert printable(HOSTILE) in done.err
    assert_printable(done.out, done.err)
    done = folder.run("batch", f"{HOSTILE}.spz", "out2")
    assert done.status == 1
    assert_printable(done.out, done.err)
    assert "\x1b" not in Path("out2/report.jsonl").read_text()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("property int label", "property int l\x1b[2J\x07"),
        ("property int label", "property list uchar int l\x1b[2J\x07"),
        ("element vertex", "element v\x1b[2J\x07"),
        ("element vertex", "\x1b[2J\x07"),
        ("property float opacity", "property double l\x1b[2J\x07"),
    ],
)
@pytest.mark.parametrize("extra", ["error", "keep"])
def test_names_in_headers_are_printed_escaped(old, new, extra, folder):
    scene = replace(random_scene(5, 0), extra={"label": np.zeros(5, "<i4")})
    write_scene("x.ply", scene, Config(extra="keep"))
    header = Path("x.ply").read_bytes()
    Path("x.ply").write_bytes(header.replace(old.encode(), new.encode()))
    done = folder.run("convert", "x.ply", "y.egs", "--extra", extra)
    assert_printable(done.out, done.err)
    if done.status:
        assert_one_error_line(done.err)


def test_the_viewer_prints_names_escaped(folder, capsys):
    folder.monkeypatch.setattr(
        "sys.argv", ["gs-viewer", f"{HOSTILE}.none", "--screenshot", "x.png"]
    )
    with pytest.raises(SystemExit):
        viewer_main()
    err = capsys.readouterr().err
    assert printable(HOSTILE) in err
    assert_printable(err)


def test_commands_print_through_one_module():
    root = Path(gs_codec.__file__).parents[1]
    for path in [*(root / "gs_codec/cli").glob("*.py"), *(root / "viewer").rglob("*.py")]:
        if path.name == "output.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "print":
                files = [ast.unparse(k.value) for k in node.keywords if k.arg == "file"]
                assert files == ["file"], f"{path}:{node.lineno}"
