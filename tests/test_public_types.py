"""Type checkers find the types of public names, which are loaded on first use."""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
import venv
from importlib import import_module
from pathlib import Path

import pytest

from samples.documentation import PACKAGES

ROOT = Path(__file__).parents[1]

IMPORTS = """\
from pathlib import Path

import gs_codec
import viewer
from gs_codec import edit
"""

CLOUD = "open3d.pybind.t.geometry.PointCloud"

#: Lines of user code, with the beginning of each result's type.
LINES = [
    ('cloud = gs_codec.read(Path("scene.ply"))', CLOUD),
    ('colours = cloud.point["f_dc"]', "open3d.pybind.core.Tensor"),
    ("turned = edit.rotate(cloud, (90, 0, 0))", CLOUD),
    ("both = edit.merge([cloud, turned])", CLOUD),
    ('config = gs_codec.Config("m", depths={"sh-ac": 4})', "gs_codec.config.Config"),
    ("data = gs_codec.encode(both, config)", "bytes"),
    ("decoded = gs_codec.decode(data)", CLOUD),
    ("info = gs_codec.inspect(data)", "gs_codec.codecs.inspection.Info"),
    ("ratio = info.ratio", "float"),
    ("largest = max(info.streams, key=lambda stream: stream.bytes).name", "str"),
    ('cameras = gs_codec.read_cameras("c.json")', "list[gs_codec.cameras.camera.Camera]"),
    ("quality = gs_codec.compare(cloud, decoded, cameras)", "gs_codec.metrics.comparison.Compari"),
    ("count = edit.statistics(cloud).count", "int"),
    ("drawn = [each for _, each in gs_codec.render(cloud)]", "list[gs_codec.rendering.renderer.R"),
    ("colour = drawn[0].colour", "numpy.ndarray["),
    ('means = gs_codec.to_tensors(cloud)["means"]', "numpy.ndarray["),
    ('report = gs_codec.encode_file("a.ply", "a.egs")', "gs_codec.report.EncodeReport"),
    ('seconds = gs_codec.decode_file("a.egs", "b.ply").seconds', "dict[str, float]"),
    ("attach = viewer.attach", "def (visualizer: open3d.pybind.visualization.O3DVisualizer) -> "),
    ("draw = gs_codec.viewer.draw", f"def (*scenes: {CLOUD} | str | pathlib.Path, cameras: "),
]


@pytest.mark.thorough
def test_strict_checks_of_users_find_types(tmp_path):
    """In an environment where gs_codec is installed."""
    venv.create(tmp_path / "venv", symlinks=True)
    python = tmp_path / "venv" / "bin" / "python"
    paths = {"base": str(tmp_path / "venv"), "platbase": str(tmp_path / "venv")}
    installed = Path(sysconfig.get_path("purelib", "venv", paths))
    (installed / "all.pth").write_text(f"{ROOT}\n{sysconfig.get_path('purelib')}\n")
    code = [IMPORTS]
    for line, _ in LINES:
        code += [line, f"reveal_type({line.partition(' = ')[0]})"]
    (tmp_path / "user.py").write_text("\n".join([*code, "gs_codec.raed(cloud)", ""]))
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--python-executable", python, "user.py"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    found = re.findall(r'Revealed type is "(.*)"', done.stdout)
    assert len(found) == len(LINES), done.stdout + done.stderr
    for (line, expected), kind in zip(LINES, found, strict=True):
        assert kind.startswith(expected), (line, kind)
    errors = re.findall(r"error: (.*)  \[", done.stdout)
    assert errors == ['Module has no attribute "raed"']


@pytest.mark.parametrize("name", PACKAGES)
def test_stubs_name_what_packages_have(name):
    module = import_module(name)
    text = Path(str(module.__file__)).with_suffix(".pyi").read_text()
    typed = {
        each: home for home, each in re.findall(r"^from (\S+) import (\w+) as \2$", text, re.M)
    }
    packages = {"edit", "viewer"} if name == "gs_codec" else set()
    assert set(typed) == {*module.__all__, *packages}
    for each, home in typed.items():
        assert getattr(import_module(home), each) is getattr(module, each), each


def test_a_second_name_of_the_viewer_has_its_types():
    first, second = ROOT / "viewer" / "__init__.pyi", ROOT / "gs_codec" / "viewer.pyi"
    names = [re.findall(r"import (\w+) as", path.read_text()) for path in (first, second)]
    assert sorted(names[0]) == sorted(names[1])
