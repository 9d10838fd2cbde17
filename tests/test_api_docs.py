"""The public API is documented: pages render, all parameters are described, examples run."""

from __future__ import annotations

import dataclasses
import doctest
import inspect
import json
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from unittest.mock import Mock

import pytest
from scenes import thorough

import gs_codec
import viewer
from gs_codec.cli.main import NAMES as COMMANDS
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply
from samples import documentation
from samples.generate import generate, orbit_cameras

ROOT = Path(__file__).parents[1]
FOLDERS = ("gs_codec", "samples", "tests", "viewer")
NAMES = [(module, name) for module, names in documentation.public_names().items() for name in names]


def object_of(module: str, name: str):
    return getattr(import_module(module), name)


def sections(docstring: str) -> dict[str, str]:
    """Text of each section of a numpydoc docstring, by its title."""
    parts = re.split(r"^(\w[\w ]+)\n(-+)\n", docstring, flags=re.MULTILINE)
    titles, underlines, bodies = parts[1::3], parts[2::3], parts[3::3]
    for title, underline in zip(titles, underlines, strict=True):
        assert len(title) == len(underline), title
    return dict(zip(titles, bodies, strict=True))


def described(body: str) -> list[str]:
    """Names listed in a section; there may be several on one line."""
    heads = re.findall(r"^(\S.*?)(?: : .+)?$", body, re.MULTILINE)
    return [name.lstrip("*") for head in heads for name in head.split(", ")]


@pytest.mark.parametrize(("module", "name"), NAMES)
def test_docstring_is_complete(module, name):
    each = object_of(module, name)
    told = sections(inspect.getdoc(each))
    if inspect.isfunction(each):
        signature = inspect.signature(each)
        assert sorted(described(told.get("Parameters", ""))) == sorted(signature.parameters)
        assert ("Returns" in told) == (signature.return_annotation != "None")
    elif dataclasses.is_dataclass(each):
        fields = [field.name for field in dataclasses.fields(each) if field.init]
        assert described(told.get("Parameters", told.get("Attributes", ""))) == fields
        assert ("Raises" in told) == hasattr(each, "__post_init__")
    for title in ("Parameters", "Attributes", "Returns", "Raises"):
        bare = re.findall(r"^(\S.*)\n(?!    )", told.get(title, "").strip() + "\n", re.MULTILINE)
        assert not bare, f"{title} says nothing about them"
    for error in described(told.get("Raises", "")):
        assert issubclass(object_of("gs_codec.errors", error.split(".")[-1]), Exception)
    if inspect.isclass(each):
        for member, value in vars(each).items():
            if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                assert inspect.getdoc(value), f"{name}.{member} has no docstring"


@pytest.mark.parametrize(("module", "name"), NAMES)
def test_public_name_has_an_example_and_its_errors(module, name):
    each = object_of(module, name)
    told = sections(inspect.getdoc(each))
    assert ">>> " in told["Examples"]
    assert "Raises" in told or not inspect.isfunction(each) or name == "attach"


@pytest.mark.parametrize("name", viewer.__all__)
def test_what_the_viewer_returns_is_public(name):
    returned = inspect.signature(getattr(viewer, name)).return_annotation
    assert returned in {"None", *(name for _, name in NAMES)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Files for the examples, in the folder where they run."""
    folder = tmp_path_factory.mktemp("examples")
    write_ply(folder / "scene.ply", generate(2000, 3, seed=1))
    encode_file(folder / "scene.ply", folder / "scene.egs")
    (folder / "cameras.json").write_text(json.dumps(orbit_cameras(2, 64, 43)))
    return folder


#: Packages of extras, by the examples that need them; those of `distributed` start clusters.
NEEDED = {
    "gs_codec.decode_distributed": "distributed",
    "gs_codec.Compression": "torch",
    "gs_codec.Splats": "torch",
    "gs_codec.decode_tensors": "torch",
    "gs_codec.encode_distributed": "distributed",
    "gs_codec.encode_tensors": "torch",
    "gs_codec.from_tensors": "torch",
}


def examples() -> list:
    finder = doctest.DocTestFinder(exclude_empty=True)
    found = [
        test
        for module, name in NAMES
        for test in finder.find(object_of(module, name), f"{module}.{name}", globs={})
        if test.examples
    ]
    return [
        thorough(test) if NEEDED.get(test.name) == "distributed" else test
        for test in sorted(found, key=lambda test: test.name)
    ]


@pytest.mark.parametrize("example", examples(), ids=lambda test: test.name)
def test_examples_run(example, folder, monkeypatch):
    from open3d.visualization import O3DVisualizer

    if package := NEEDED.get(example.name):
        pytest.importorskip(package, reason=f"{package} is not installed")
    monkeypatch.chdir(folder)
    shown = []
    monkeypatch.setattr("viewer.plugin.find_device", lambda: None)
    monkeypatch.setattr("viewer.window.notes_window.NotesWindow", Mock())
    monkeypatch.setattr(
        "viewer.window.main_window.run", lambda request, device: shown.append(request)
    )
    example.globs |= {
        "gs_codec": gs_codec,
        "viewer": viewer,
        "visualizer": Mock(spec=O3DVisualizer, os_frame=Mock(height=400)),
    }
    said: list[str] = []
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=said.append)
    assert result.attempted
    assert not result.failed, "".join(said)
    assert bool(shown) == (example.name == "viewer.draw")


def test_every_document_is_a_page():
    listed = [page for pages in documentation.PAGES.values() for page in pages.values()]
    documents = [
        path.relative_to(ROOT).with_suffix("").as_posix()
        for path in [*ROOT.glob("*.md"), *(p for f in FOLDERS for p in (ROOT / f).rglob("*.md"))]
        if "node_modules" not in path.parts
    ]
    assert sorted(listed) == sorted([*documents, *documentation.WRITTEN])


def test_references_have_every_name_and_option():
    python = documentation.python_reference()
    for module, name in NAMES:
        assert re.search(rf"^\.\. auto\w+:: {module}\.{name}$", python, re.MULTILINE)
    commands = documentation.command_reference()
    for name in ("gs-viewer", "gs-codec bench suite", *(f"gs-codec {name}" for name in COMMANDS)):
        assert f"\n{name}\n===" in commands
    for option in (
        "--profile NAME, -p NAME", "--no-verify", "--antialiased, --plain", "--dask ADDRESS",
        "--screenshot PNG",
    ):  # fmt: skip
        assert f".. option:: {option}\n" in commands


@pytest.mark.thorough
def test_site_is_built_without_warnings_and_needs_no_network(tmp_path):
    pytest.importorskip("furo", reason="Sphinx and furo, of the extra docs, are not installed")
    command = [sys.executable, str(ROOT / "samples" / "documentation.py"), str(tmp_path / "site")]
    done = subprocess.run(
        command,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    reference = (tmp_path / "site" / "reference" / "python.html").read_text()
    for module, name in NAMES:
        assert f'id="{module}.{name}"' in reference
    pages = list((tmp_path / "site").rglob("*.html"))
    assert tmp_path / "site" / "index.html" in pages
    loaded = (
        r"<(?:script|img|iframe)[^>]* src=\"http|<link[^>]* rel=\"(?!canonical)[^>]* href=\"http"
    )
    for path in pages:
        assert not re.search(loaded, path.read_text()), path.name


@pytest.mark.parametrize("name", ["encode", "decode", "prepare"])
def test_in_memory_and_file_to_file_arguments_are_the_same(name):
    """Same names and order; the functions on files have a few more, keyword-only."""
    both = [gs_codec.__getattr__(each) for each in (name, f"{name}_file")]
    memory, files = (dict(inspect.signature(each).parameters) for each in both)
    assert next(iter(memory)) == next(iter(files)) == "source"
    assert list(files)[1] == "target"
    del files["target"]
    shared = [each for each in files if each in memory]
    assert shared == list(memory)
    for each in shared:
        assert files[each].kind == memory[each].kind
        assert files[each].default == memory[each].default
    assert all(p.kind == p.KEYWORD_ONLY for each, p in files.items() if each not in memory)
