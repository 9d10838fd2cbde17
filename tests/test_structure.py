"""The module map in CONTRIBUTING.md matches the tree, and imports follow it."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def modules() -> dict[str, Path]:
    """Every module of the packages, by its name."""
    found = {}
    for package in ("gs_codec", "viewer"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(source: str, known: set[str]) -> Iterator[str]:
    """The known modules that a module imports: at top level, in functions or for types."""
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.ImportFrom):
            assert not node.level, "an import by dots"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            while name not in known and "." in name:
                name = name.rpartition(".")[0]
            if name in known:
                yield name


def test_files_that_the_guide_names_exist():
    named = re.findall(r"[\w./]+\.(?:py|txt|cff|mjs)\b", (ROOT / "CONTRIBUTING.md").read_text())
    folders = (ROOT / name for name in ("gs_codec", "viewer", "tests", "samples", ".ci"))
    files = [path for folder in folders for path in folder.rglob("*.*")] + list(ROOT.glob("*.*"))
    there = [path.as_posix() for path in files]
    assert len(named) > 50
    for name in named:
        assert any(path.endswith(f"/{name}") for path in there), name


def test_no_test_imports_another():
    """Code shared by tests is in helper modules or fixtures."""
    for path in sorted((ROOT / "tests").rglob("*.py")):
        taken = re.findall(
            r"^ *(?:from|import) (?:tests\.)?(test_\w+)", path.read_text(), re.MULTILINE
        )
        assert not taken, path.name


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """The modules that each module imports, except itself."""
    found = modules()
    return {
        name: set(imported(path.read_text(), set(found))) - {name} for name, path in found.items()
    }


def rows() -> list[list[str]]:
    """The names in the table of CONTRIBUTING.md, row by row."""
    table = re.findall(r"^\| (`[^|]*) \|", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    return [re.findall(r"`([\w/]+)`", row) for row in table]


def unit_of(module: str) -> str:
    """The entry of the table that a gs_codec module belongs to."""
    parts = module.split(".")[1:]
    return "/".join(parts[:2]) if parts[0] == "codecs" and len(parts) > 2 else parts[0]


def test_no_modules_import_one_another(imports):
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_every_module_is_in_the_map_once():
    listed = [name for row in rows() for name in row]
    there = {unit_of(name) for name in modules() if name.startswith("gs_codec.")}
    assert sorted(listed) == sorted(there)


#: Names that several modules have, since they are the same part of parallel things, and where.
PARALLEL = {
    "encode": "codecs and the choice of one; the command",
    "decode": "codecs and the choice of one; the command",
    "section": "codecs",
    "file": "families of formats: the bytes of a file",
    "scene": "a scene; families of formats: a scene from and to their files",
    "writer": "families of formats",
    "main": "programs",
}


def test_modules_have_names_of_their_own():
    count = Counter(path.stem for path in modules().values() if not path.stem.startswith("__"))
    assert {name for name, number in count.items() if number > 1} == set(PARALLEL)


def test_imports_go_down_the_map(imports):
    place = {name: number for number, row in enumerate(rows()) for name in row}
    wrong = defaultdict(list)
    for module, names in imports.items():
        for name in names:
            if not name.startswith("gs_codec."):
                assert not module.startswith("gs_codec.") or name == "gs_codec", module
            elif module.startswith("gs_codec.") and place[unit_of(module)] > place[unit_of(name)]:
                wrong[module].append(name)
    assert not wrong


def test_imports_of_the_viewer_go_down(imports):
    packages = "viewer.scenes", "viewer.pictures", "viewer.window"
    for place, package in enumerate(packages):
        for module, names in imports.items():
            if module.startswith(package):
                assert not any(name.startswith(packages[place + 1 :]) for name in names), module


def test_the_viewer_has_types():
    # An attribute of type Any hides a cycle.
    for name, path in modules().items():
        if name.startswith("viewer"):
            assert not re.search(r"import .*\bAny\b", path.read_text()), name
