"""The content of installed packages: modules and documents, nothing else."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import pytest

import gs_codec

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
SOURCES = (
    ".ci", ".github", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "MANIFEST.in",
    "Makefile", "README.md", "gs_codec", "pyproject.toml", "samples", "setup.py", "tests", "viewer",
)  # fmt: skip


def run(*arguments: str | Path, cwd: Path, path: Path | None = None) -> str:
    """The output of Python outside the repository; a failure shows stderr."""
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    environment = kept if path is None else {**kept, "PYTHONPATH": str(path)}
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(
        command, check=False, cwd=cwd, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def sdist(tmp_path_factory) -> Path:
    """The source distribution of a copy of the sources, because builds leave files behind."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "sources"
    copy.mkdir()
    for name in SOURCES:
        source = ROOT / name
        if source.is_file():
            shutil.copy(source, copy)
        else:
            left = shutil.ignore_patterns("__pycache__", "node_modules")
            shutil.copytree(source, copy / name, ignore=left)
    code = f"from setuptools import build_meta; build_meta.build_sdist({str(folder)!r})"
    run("-W", "ignore", "-c", code, cwd=copy)
    return next(folder.glob("*.tar.gz"))


@pytest.fixture(scope="module")
def wheel(sdist) -> Path:
    """A wheel of the source distribution."""
    folder = sdist.parent
    pip = "-m", "pip", "--disable-pip-version-check", "wheel", "--no-index", "--no-deps"
    run(*pip, "--no-build-isolation", "--wheel-dir", folder, sdist, cwd=folder)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def sources(wheel) -> Path:
    return wheel.parent / "sources"


@pytest.fixture(scope="module")
def unpacked(wheel) -> Path:
    folder = wheel.parent / "unpacked"
    zipfile.ZipFile(wheel).extractall(folder)
    return folder


def test_source_distribution_holds_the_sources(sdist):
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names >= {
        path.relative_to(ROOT).as_posix()
        for source in map(ROOT.joinpath, SOURCES)
        for path in ([source] if source.is_file() else source.rglob("*"))
        if path.is_file() and not {"__pycache__", "node_modules"} & set(path.parts)
    }
    assert not any("node_modules" in name or "__pycache__" in name for name in names)


def test_wheel_holds_the_packages_and_their_documents_alone(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    metadata = f"gs_codec-{gs_codec.__version__}.dist-info/"
    expected = {
        path.relative_to(ROOT).as_posix()
        for package in (ROOT / "gs_codec", ROOT / "viewer")
        for suffix in ("py", "pyi", "md")
        for path in package.rglob(f"*.{suffix}")
        if ROOT / "viewer" / "web" not in path.parents  # JavaScript, for pages
    }
    expected |= {
        path.relative_to(ROOT).as_posix()
        for pattern in (
            "gs_codec/bench/*.jpg",
            "gs_codec/bench/*.jsonl",
            "gs_codec/bench/*.png",
            "gs_codec/bench/suite/*.csv",
            "gs_codec/runtime/kernels.txt",
            "*/py.typed",
            "viewer/*.png",
            "viewer/web/embed.js",
            "viewer/web/inspect.js",
            "viewer/web/page.html",
        )
        for path in ROOT.glob(pattern)
    }
    assert {name for name in names if not name.startswith(metadata)} == expected
    assert names >= {"gs_codec/py.typed", "viewer/py.typed"}
    documents = "egs/FORMAT.md", "TRUST.md", "cli/COMMANDS.md", "bench/RESULTS.md"
    assert names >= {f"gs_codec/{name}" for name in documents}
    assert metadata + "licenses/LICENSE" in names
    assert not any(name.split("/")[0] in ("tests", "samples") for name in names)


def test_wheel_has_correct_metadata(wheel):
    archive = zipfile.ZipFile(wheel)
    folder = f"gs_codec-{gs_codec.__version__}.dist-info"
    scripts = archive.read(f"{folder}/entry_points.txt").decode()
    assert "gs-codec = gs_codec.__main__:main" in scripts
    assert "gs-viewer = viewer.__main__:main" in scripts
    metadata = archive.read(f"{folder}/METADATA").decode()
    assert "License-Expression: GPL-3.0-or-later" in metadata
    assert "Author: gs_codec developers\n" in metadata
    assert "# gs_codec" in metadata
    urls = dict(re.findall(r"^Project-URL: (\w+), (.*)$", metadata, re.MULTILINE))
    assert set(urls) == {"Homepage", "Documentation", "Source", "Issues", "Changelog"}
    assert all(url.startswith(urls["Homepage"]) for url in urls.values())


def test_the_readme_in_metadata_shows_its_pictures_anywhere(wheel):
    folder = f"gs_codec-{gs_codec.__version__}.dist-info"
    shown = zipfile.ZipFile(wheel).read(f"{folder}/METADATA").decode().partition("\n\n")[2]
    (url,) = re.findall('^URL = "(.*)"$', (ROOT / "setup.py").read_text(), re.MULTILINE)
    links = r"\]\(([^)\s]+)\)"
    for there, here in zip(
        re.findall(links, shown), re.findall(links, (ROOT / "README.md").read_text()), strict=True
    ):
        kind = "raw" if here.endswith((".png", ".jpg", ".webp")) else "blob"
        whole = f"{url}/{kind}/v{gs_codec.__version__}/{here}"
        assert there == (here if here.startswith("http") else whole)


def test_core_is_the_same_code_with_fewer_dependencies(wheel, sources, tmp_path):
    run(sources / ".ci/core", tmp_path / "core", cwd=tmp_path)
    code = f"from setuptools import build_meta; build_meta.build_wheel({str(tmp_path)!r})"
    run("-W", "ignore", "-c", code, cwd=tmp_path / "core")
    (core,) = tmp_path.glob("*.whl")
    assert core.name.startswith(f"gs_codec_core-{gs_codec.__version__}-")
    contents, needs = [], []
    for each in (wheel, core):
        archive = zipfile.ZipFile(each)
        (metadata,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
        files = {i.filename: i.CRC for i in archive.infolist() if ".dist-info" not in i.filename}
        contents.append(files)
        needs.append(
            re.findall("^Requires-Dist: (.*)$", archive.read(metadata).decode(), re.MULTILINE)
        )
    assert contents[0] == contents[1]
    same = [need.replace("gs-codec-core[", "gs-codec[") for need in needs[1]]
    gone = {re.split("[=><]", need)[0] for need in needs[0] if need not in same}
    assert gone == {"open3d", "open3d-cpu", "scipy"}
    assert "gs-codec-core[docs]" in " ".join(needs[1])


def test_open3d_is_required_where_it_has_wheels(wheel):
    """Elsewhere, as for a later Python, pip installs everything else."""
    packaging = pytest.importorskip("packaging.requirements")
    archive = zipfile.ZipFile(wheel)
    metadata = archive.read(f"gs_codec-{gs_codec.__version__}.dist-info/METADATA").decode()
    wanted = [
        packaging.Requirement(need)
        for need in re.findall("^Requires-Dist: (open3d.*)$", metadata, re.MULTILINE)
    ]
    for system, machine, newest in (
        ("linux", "x86_64", 14), ("linux", "aarch64", 14), ("win32", "AMD64", 14),
        ("darwin", "arm64", 14), ("darwin", "x86_64", 12), ("linux", "riscv64", 0),
    ):  # fmt: skip
        for minor in range(10, 17):
            here = {
                "sys_platform": system,
                "platform_machine": machine,
                "python_version": f"3.{minor}",
                "extra": "",
            }
            asked = [each.name for each in wanted if each.marker.evaluate(here)]
            name = "open3d-cpu" if (system, machine) == ("linux", "x86_64") else "open3d"
            assert asked == [name] * (minor <= newest)


@pytest.mark.thorough
def test_unpacked_wheel_runs_elsewhere(unpacked, tmp_path):
    code = "import gs_codec, viewer; print(gs_codec.__file__, viewer.__file__, sep='\\n')"
    places = run("-c", code, cwd=tmp_path, path=unpacked).splitlines()
    assert places == [str(unpacked / package / "__init__.py") for package in ("gs_codec", "viewer")]
    version = f"gs-codec {gs_codec.__version__}\n"
    assert run("-m", "gs_codec", "--version", cwd=tmp_path, path=unpacked) == version
    code = "import sys, viewer.main; sys.argv[1:] = ['--version']; viewer.main.main()"
    version = f"gs-viewer {gs_codec.__version__}\n"
    assert run("-c", code, cwd=tmp_path, path=unpacked) == version


@pytest.mark.thorough
def test_the_viewer_has_a_second_name_and_is_loaded_once(unpacked, tmp_path):
    code = (
        "import sys, gs_codec\n"
        "print('viewer' in sys.modules)\n"
        "first = gs_codec.viewer\n"
        "import gs_codec.viewer, viewer\n"
        "print(first is gs_codec.viewer is viewer, 'open3d' in sys.modules)\n"
        "from gs_codec.viewer import attach\n"
        "print(attach is viewer.attach)\n"
    )
    found = run("-c", code, cwd=tmp_path, path=unpacked).split()
    assert found == ["False", "True", "False", "True"]


def test_unpacked_wheel_loads_every_command(unpacked, tmp_path):
    """Commands import their modules lazily, so a missing package would show late."""
    code = (
        "import importlib, pkgutil, gs_codec.cli as cli\n"
        "for module in pkgutil.iter_modules(cli.__path__):\n"
        "    print(importlib.import_module(f'gs_codec.cli.{module.name}').__name__)\n"
    )
    loaded = run("-c", code, cwd=tmp_path, path=unpacked).split()
    assert "gs_codec.cli.bench" in loaded


PIP = "-m", "pip", "--disable-pip-version-check", "--quiet"
OFFLINE = "--no-index", "--no-deps", "--no-build-isolation"

#: Runs a kernel, and names the package and the folder of compiled kernels.
COMPILING = """
import numpy as np
import gs_codec
from gs_codec.coding.quantise import _range_of, fit_range
assert fit_range(np.array([1, 3], np.float32), 2).step == 2 / 3
print(gs_codec.__file__, _range_of.stats.cache_path, *_range_of.stats.cache_hits.values())
"""


@pytest.fixture
def venv(tmp_path, monkeypatch) -> Path:
    """An environment for `run`, with the packages of this one except gs_codec."""
    folder = tmp_path / "venv"
    run("-m", "venv", "--without-pip", folder, cwd=tmp_path)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "rest.pth").write_text(sysconfig.get_path("purelib"))
    monkeypatch.setattr(sys, "executable", str(folder / "bin/python"))
    return folder


@pytest.fixture
def few_kernels(sources) -> Iterator[Path]:
    """The sources with a short list of kernels."""
    path = sources / "gs_codec/runtime/kernels.txt"
    whole = path.read_text()
    path.write_text("".join(line for line in whole.splitlines(True) if " _range_of " in line))
    yield sources
    path.write_text(whole)


@pytest.mark.thorough
def test_a_used_installation_can_be_replaced(wheel, sources, venv, tmp_path, monkeypatch):
    """Unknown files in the package would make pip leave its folder, which hides another copy."""
    (site,) = venv.glob("lib/python*/site-packages")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    hits = []
    for what, place in [((wheel,), site), (("-e", sources), sources)] * 2:
        run(*PIP, "install", *OFFLINE, "--force-reinstall", *what, cwd=tmp_path)
        package, cache, *found = run("-c", COMPILING, cwd=tmp_path).split()
        assert Path(package) == place / "gs_codec/__init__.py"
        assert Path(cache).parent == tmp_path / "gs-codec"
        hits.append(found)
        assert (site / "gs_codec").exists() == (place == site)
        assert not [*place.glob("gs_codec/**/*.nb*")]
    assert hits == [[], ["1"], ["1"], ["1"]], "each place has compiled again"


@pytest.mark.thorough
@pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="for Linux on x86-64 alone"
)
def test_a_wheel_with_compiled_kernels_compiles_nothing(few_kernels, tmp_path, monkeypatch):
    monkeypatch.setenv("GS_CODEC_KERNELS", "1")
    run(*PIP, "wheel", *OFFLINE, "--wheel-dir", tmp_path, few_kernels, cwd=tmp_path)
    (built,) = tmp_path.glob("*.whl")
    python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
    assert built.name.endswith(f"-{python}-{python}-manylinux_2_17_x86_64.whl")
    archive = zipfile.ZipFile(built)
    metadata = archive.read(f"gs_codec-{gs_codec.__version__}.dist-info/METADATA").decode()
    required = re.findall(r"^Requires-Dist: (numba[^-]*)$", metadata, re.MULTILINE)
    assert required == [f"numba=={version('numba')}"]
    archive.extractall(tmp_path / "unpacked")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(built))  # no folder
    package, _, hits = run("-c", COMPILING, cwd=tmp_path, path=tmp_path / "unpacked").split()
    assert (package, hits) == (str(tmp_path / "unpacked/gs_codec/__init__.py"), "1")


@pytest.mark.thorough
def test_an_image_by_the_dockerfile_has_nothing_to_compile(
    few_kernels, venv, tmp_path, monkeypatch
):
    """Runs its steps without Docker, in an environment that has the packages."""
    text = (ROOT / "gs_codec/cli/COMMANDS.md").read_text()
    (steps,) = re.findall("```dockerfile\n(.*?)```", text, re.DOTALL)
    (setting,) = re.findall(r"^ENV NUMBA_CACHE_DIR=(\S+)$", steps, re.MULTILINE)
    _, install, warm = re.findall(r"^RUN (.*)$", steps, re.MULTILINE)
    pip = venv / "bin/pip"
    pip.write_text(f'#!/bin/sh\n"{venv}/bin/python" {" ".join(PIP)} "$@" {" ".join(OFFLINE)}\n')
    pip.chmod(0o755)
    cache = tmp_path / "image" / setting.lstrip("/")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    monkeypatch.setenv("PATH", f"{venv / 'bin'}:{os.environ['PATH']}")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    for command in (install.replace("/src", str(few_kernels)), warm):
        subprocess.run(["sh", "-ec", command], check=True, cwd=tmp_path)
    kept = {path: path.stat().st_mode & 0o444 for path in cache.rglob("*.nb*")}
    assert len(kept) == 3, "one index, and the code for two types"
    assert set(kept.values()) == {0o444}, "for another user"
    assert run("-c", COMPILING, cwd=tmp_path).split()[2:] == ["1"]
    assert set(cache.rglob("*.nb*")) == set(kept)
