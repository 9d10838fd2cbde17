"""The size of an installation."""

from __future__ import annotations

from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from gs_codec.bench import host as module
from gs_codec.bench.host import installed


@pytest.fixture
def install(tmp_path, monkeypatch):
    """A function that installs a package of some bytes with its requirements."""
    monkeypatch.setattr(module, "_own_bytes", lambda: 7)

    def found(name: str) -> PathDistribution | None:
        path = tmp_path / f"{name}.dist-info"
        return PathDistribution(path) if path.exists() else None

    monkeypatch.setattr(module, "_found", found)

    def install(name: str, size: int, *requires: str) -> None:
        folder: Path = tmp_path / f"{name}.dist-info"
        folder.mkdir()
        needs = "".join(f"Requires-Dist: {need}\n" for need in requires)
        (folder / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {name}\n{needs}")
        (tmp_path / f"{name}.py").write_bytes(bytes(size))
        (folder / "RECORD").write_text(f"{name}.py,,\n{name}.gone,,\n")

    return install


def test_required_packages_are_counted(install):
    needs = "numba>=0.60", "open3d-cpu==0.20.*; sys_platform == 'linux'", "scipy>=1.14"
    install("gs-codec", 1, *needs, "torch; extra == 'paper'", "absent>=1; sys_platform == 'x'")
    install("numba", 1000, "LLVM_lite<1")
    install("llvm-lite", 300)
    install("open3d-cpu", 20_000, "dash", "numba")
    install("dash", 4000)
    install("scipy", 50_000)
    install("torch", 10**6)
    assert installed() == {
        "gs-codec": {"packages": 6, "bytes": 75_307},
        "gs-codec-core": {"packages": 3, "bytes": 1307},
    }


def test_packages_of_core_are_counted(install):
    install("gs-codec-core", 1, "numba>=0.60")
    install("numba", 1000)
    core = {"packages": 2, "bytes": 1007}
    assert installed() == {"gs-codec": core, "gs-codec-core": core}


def test_missing_packages_are_not_counted(install):
    assert installed() == {}


def test_own_files_are_counted():
    assert 10**6 < module._own_bytes() < 10**8
