"""Files that publish the project are valid, and consistent with pyproject.toml."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import gs_codec

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = (ROOT / "pyproject.toml").read_text()


def recipes():
    """The script that fills in the recipes."""
    spec = importlib.util.spec_from_file_location("recipes", ROOT / ".ci" / "recipes.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    """A folder of published files, with a stand-in for the source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    (folder / f"gs_codec-{gs_codec.__version__}.tar.gz").write_bytes(b"sources")
    recipes().main(folder)
    return folder


def load(path: Path):
    yaml = pytest.importorskip("ruamel.yaml", reason="check-jsonschema is not installed")
    return yaml.YAML(typ="safe").load(path)


def test_the_citation_agrees_with_the_package_and_the_paper():
    cited = load(ROOT / "CITATION.cff")
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    assert cited["version"] == gs_codec.__version__
    assert (
        f"\n## {cited['version']} ({cited['date-released']})\n"
        in (ROOT / "CHANGELOG.md").read_text()
    )
    assert f'license = "{cited["license"]}"' in PROJECT
    assert f"keywords = {json.dumps(cited['keywords'])}" in PROJECT
    assert all(
        f'authors = [{{ name = "{author["name"]}" }}]' in PROJECT for author in cited["authors"]
    )
    [paper] = cited["references"]
    assert f"({paper['url']})" in (ROOT / "gs_codec" / "PAPER.md").read_text()
    assert paper["doi"].removeprefix("10.48550/arXiv.") in paper["url"]


def test_checksums_are_of_all_files(written):
    lines = (written / "SHA256SUMS").read_text().splitlines()
    assert [line.split()[1] for line in lines] == [
        "gs-codec.rb", f"gs_codec-{gs_codec.__version__}.tar.gz", "recipe.yaml",
    ]  # fmt: skip
    for line in lines:
        digest, name = line.split()
        assert digest == hashlib.sha256((written / name).read_bytes()).hexdigest()


def test_the_conda_recipe_needs_what_the_package_needs(written):
    recipe = load(written / "recipe.yaml")
    assert recipe["context"]["version"] == gs_codec.__version__
    assert recipe["source"]["sha256"] == hashlib.sha256(b"sources").hexdigest()
    assert recipe["about"]["homepage"] == recipes().project_url()
    listed = re.search(r"^dependencies = \[(.*?)^\]", PROJECT, re.MULTILINE | re.DOTALL)[1]
    needs = set(re.findall(r'^    "([\w-]+)([^";]*)', listed, re.MULTILINE))
    needed = {tuple(line.partition(" ")[::2]) for line in recipe["requirements"]["run"]}
    others = {"open3d", "open3d-cpu", "pcodec", "python"}
    assert {each for each in needed if each[0] not in others} == {
        each for each in needs if each[0] not in others
    }
    assert {("pcodec", "1.1.*"), ("open3d", ">=0.20")} < needed
    assert {("pcodec", "==1.1.*"), ("open3d", ">=0.20")} < needs
    scripts = re.findall(r'^(gs-\w+) = "(.*)"$', PROJECT, re.MULTILINE)
    assert recipe["build"]["python"]["entry_points"] == [f"{a} = {b}" for a, b in scripts]


def test_the_formula_is_ruby(written):
    text = (written / "gs-codec.rb").read_text()
    assert f"gs_codec-{gs_codec.__version__}.tar.gz" in text
    assert "@" not in text.replace("python@3.13", "")
    if not shutil.which("ruby"):
        pytest.skip("ruby is not installed")
    subprocess.run(["ruby", "-c", written / "gs-codec.rb"], check=True)


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_are_valid(path):
    pytest.importorskip("check_jsonschema", reason="check-jsonschema is not installed")
    check = [sys.executable, "-m", "check_jsonschema", "--builtin-schema"]
    command = [*check, "vendor.github-workflows", path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    makefile = (ROOT / "Makefile").read_text()
    for job in load(path)["jobs"].values():
        for step in job["steps"]:
            for target in re.findall(r"^make ([\w-]+)", step.get("run", ""), re.MULTILINE):
                assert re.search(rf"^{target}\b.*:", makefile, re.MULTILINE), target
            for script in re.findall(r"\.ci/\w+\.py", step.get("run", "")):
                assert (ROOT / script).is_file()


def test_every_python_that_is_supported_is_tested():
    (path,) = [path for path in WORKFLOWS if path.stem == "tests"]
    tested = load(path)["jobs"]["pythons"]["strategy"]["matrix"]["python"]
    release = load(path.with_name("release.yml"))["jobs"]
    assert release["kernels"]["strategy"]["matrix"]["python"] == tested
    assert tested == re.findall(r"Python :: (3\.\d+)", PROJECT)
    assert f'requires-python = ">={tested[0]}"' in PROJECT


def test_one_variable_has_the_projects_url():
    url = recipes().project_url()
    files = [ROOT / "README.md", ROOT / "pyproject.toml", ROOT / "setup.py", *WORKFLOWS]
    files += (path for path in (ROOT / ".ci").rglob("*") if path.is_file())
    assert [p.name for p in files if url in p.read_bytes().decode(errors="ignore")] == ["setup.py"]
