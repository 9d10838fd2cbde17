"""Optional packages: whether they are installed, and one message that says how to install them."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from gs_codec.errors import MissingTool
from gs_codec.runtime import optional
from gs_codec.runtime.optional import check_installed, is_available, needed

ROOT = Path(__file__).parents[1]


def test_missing_packages_are_not_available(monkeypatch):
    assert is_available("json", "numpy")
    assert not is_available("json", "no_such_module")
    monkeypatch.setitem(sys.modules, "numpy", None)
    assert not is_available("numpy")


@pytest.mark.parametrize(
    ("module", "text"),
    [
        ("scipy.spatial", "films: needs scipy; pip install scipy"),
        ("pxr.Usd", "films: needs usd-core; pip install 'gs-codec[usd]'"),
        ("cv2", "films: needs OpenCV; pip install 'gs-codec[undistort]'"),
        ("no_such_module", "films: needs no_such_module; pip install no_such_module"),
    ],
)
def test_a_missing_package_is_named_with_its_install_command(monkeypatch, module, text):
    monkeypatch.setitem(sys.modules, module.partition(".")[0], None)
    for call in (needed, lambda name, what: check_installed(name.partition(".")[0], what)):
        with pytest.raises(MissingTool) as caught:
            call(module, "films")
        assert str(caught.value) == text


def test_a_broken_package_is_reported_with_the_reason(tmp_path, monkeypatch):
    (tmp_path / "broken_package.py").write_text("raise OSError('libGL.so.1: no such file')")
    monkeypatch.syspath_prepend(tmp_path)
    assert is_available("broken_package")
    with pytest.raises(MissingTool) as caught:
        needed("broken_package", "films")
    assert str(caught.value) == (
        "films: needs broken_package (libGL.so.1: no such file); pip install broken_package"
    )


def test_every_extra_is_one_of_the_project():
    text = (ROOT / "pyproject.toml").read_text()
    assert all(f"\n{extra} = [" in text for _, extra in optional._EXTRAS.values())


def test_packages_are_looked_for_in_one_place():
    """No other module calls `find_spec`, except for our own page, or catches a failed import."""
    found = set()
    for path in [*(ROOT / "gs_codec").rglob("*.py"), *(ROOT / "viewer").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            caught = isinstance(node, ast.ExceptHandler) and "ImportError" in ast.dump(node)
            if caught or (isinstance(node, ast.ImportFrom) and node.module == "importlib.util"):
                found.add(path.relative_to(ROOT).as_posix())
    assert found == {
        "gs_codec/batch/remote.py",  # packages needed by fsspec protocols
        "gs_codec/runtime/atomic.py",  # Windows
        "gs_codec/runtime/optional.py",
        "gs_codec/runtime/programs.py",  # limits that Windows lacks
        "gs_codec/workers/dask.py",  # packages needed by Dask addresses
    }
