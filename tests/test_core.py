"""Files are processed without Open3D, scipy and other packages that gs-codec-core lacks."""

from __future__ import annotations

import json
from fnmatch import fnmatch
from importlib.metadata import version

import pytest
from command_line import python

from gs_codec.cli.main import NAMES, _Commands

pytestmark = pytest.mark.slow

#: Packages that other distributions of gs-codec, or Open3D, install.
ABSENT = ("open3d", "plotly", "dash", "scipy", "skimage", "sklearn", "matplotlib", "pandas")

WITHOUT = """
import json
import sys
from importlib.abc import MetaPathFinder

class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent}:
            raise ModuleNotFoundError(f"No module named '{{name}}'", name=name.partition(".")[0])

def run(main, *words):
    sys.argv = list(words)
    try:
        main()
    except SystemExit as stop:
        return stop.code or 0
    return 0

sys.meta_path.insert(0, Absent())
for name in {absent}:
    sys.modules[name] = None
"""

COMMANDS = """
from gs_codec.cli.main import main
print(json.dumps([run(main, "gs-codec", *line.split()) for line in {lines}]), file=sys.stderr)
"""


def without(script: str, folder, **values) -> tuple[str, list[str]]:
    """Output of a script in a process without these packages, and its lines on stderr."""
    text = WITHOUT.format(absent=ABSENT) + script.format(**values)
    status, out, err = python("-c", text, cwd=folder.path)
    assert status == 0, err
    return out, err.splitlines()


def test_file_commands_need_no_optional_packages(folder):
    lines = [
        "encode scene.ply small.egs",
        "encode scene.ply guided.egs --cameras cameras.json --target-ratio 12",
        "decode small.egs small.ply",
        "convert scene.ply scene.spz --remove-floaters --keep 90% --keep-largest-cluster",
        "compare scene.ply small.egs",
        "compare scene.ply small.egs --cameras cameras.json --images views",
        "inspect small.egs",
        "inspect scene.spz",
        "verify small.egs",
        "render scene.ply --cameras cameras.json --out drawn",
        "share scene.ply small.egs --out page.html",
    ]
    _, err = without(COMMANDS, folder, lines=lines)
    assert json.loads(err[-1]) == [0] * len(lines), "\n".join(err)
    assert (folder.path / "page.html").stat().st_size > 100_000


@pytest.mark.thorough
def test_cameras_are_estimated_without_optional_packages(folder):
    lines = ["compare scene.ply scene.egs --cameras auto --width 40"]
    assert json.loads(without(COMMANDS, folder, lines=lines)[1][-1]) == [0]


def test_missing_packages_are_named_with_their_install_command(folder):
    lines = [
        "convert scene.ply a.spz --remove-floaters --cameras cameras.json",
        "analyze scene.ply --out report",
    ]
    _, err = without(COMMANDS, folder, lines=lines)
    assert err == [
        "gs-codec: error: scene.ply: remove-floaters with cameras: needs scipy; pip install scipy",
        "gs-codec: error: analyze: needs scipy; pip install scipy",
        "[2, 2]",
    ]


CALLS = """
import gs_codec
import viewer
import viewer.main

for call in (
    lambda: gs_codec.read("scene.ply"),
    lambda: gs_codec.decode("scene.egs"),
    lambda: gs_codec.to_octree(None, 3),
    lambda: viewer.draw("scene.ply"),
):
    try:
        call()
    except gs_codec.MissingTool as error:
        print(error)
print(gs_codec.compare("scene.ply", "scene.egs", "cameras.json").mean.between.psnr > 20)
print(run(viewer.main.main, "gs-viewer", "scene.ply"))
print(run(viewer.main.main, "gs-viewer", "scene.ply", "--screenshot", "a.png", "--height", "100"))
"""


def test_clouds_and_windows_need_open3d(folder):
    out, err = without(CALLS, folder)
    assert len(err) == 2
    for line in err:
        assert line.startswith("gs-viewer: error: all but --web: needs open3d; pip install open3d")
    *errors, compared, window, picture = out.splitlines()
    assert (compared, window, picture) == ("True", "2", "2")
    what = ["a scene as a point cloud", "a scene as a point cloud", "to_octree", "draw"]
    for error, needing in zip(errors, what, strict=True):
        assert f"{needing}: needs open3d; pip install open3d" in error


LOADED = """
from gs_codec.cli.main import main
status = run(main, "gs-codec", *{line!r}.split())
print(status, *sorted(sys.modules), file=sys.stderr)
"""

#: Modules that start a command, and that define its options.
STARTED = {
    "cli", "cli.*", "config", "edit", "edit.actions", "errors", "files", "files.suffixes",
    "format_table",
    "plan", "presets", "report", "runtime", "runtime.*",
}  # fmt: skip

DECODED = {
    "codecs", "codecs.*", "coding", "coding.*", "egs", "egs.*", "files.decode_file", "formats",
    "formats.*", "scene",
}  # fmt: skip

INSPECTED = {
    "batch", "batch.needed_memory", "files.scenes", "metrics", "metrics.*", "pages", "pages.tables",
    "rendering", "rendering.image_loss",
}  # fmt: skip

#: Modules of these packages needed only for encoding, or for other profiles and formats.
NOT_DECODED = {
    "codecs.entropygs", "codecs.lossless", "codecs.interchange", "codecs.encode", "codecs.pairing",
    "codecs.adaptive.encode", "formats.registry", "formats.gltf", "formats.sog", "formats.usd",
}  # fmt: skip


@pytest.mark.parametrize(
    ("line", "ours", "absent"),
    [
        ("--version", STARTED, {"numpy", "numba", "rich"}),
        ("--help", STARTED, {"numpy", "numba"}),
        ("decode scene.egs out.ply", STARTED | DECODED, {"rich", "skimage"}),
        ("inspect scene.egs", STARTED | DECODED | INSPECTED, {"rich", "skimage"}),
    ],
    ids=["version", "help", "decode", "inspect"],
)
def test_a_command_loads_what_it_needs(folder, line, ours, absent):
    folder.run("encode", "scene.ply", "scene.egs", "--overwrite")
    script = "import sys\n" + WITHOUT[WITHOUT.index("def run") : WITHOUT.index("sys.meta")]
    for _ in range(2):  # the first run compiles
        status, _, err = python("-c", script + LOADED.format(line=line), cwd=folder.path)
        assert status == 0, err
        (folder.path / "out.ply").unlink(missing_ok=True)
    ended, *modules = err.splitlines()[-1].split()  # after lines of progress, if it took long
    assert ended == "0"
    names = {name.removeprefix("gs_codec.") for name in modules if name.startswith("gs_codec.")}
    assert [name for name in names if not any(fnmatch(name, each) for each in ours)] == []
    assert line.startswith("inspect") or (names.isdisjoint(NOT_DECODED) and len(names) <= 90)
    packages = {name.partition(".")[0] for name in modules}
    assert packages.isdisjoint(absent | {"open3d", "sklearn", "pandas", "matplotlib", "plotly"})
    # numba imports scipy itself, but none of its submodules.
    assert not {"scipy.linalg", "scipy.special", "scipy.sparse", "scipy.spatial"} & set(modules)
    if tuple(map(int, version("typer").split(".")[:2])) < (0, 28):  # pyproject.toml requires it
        assert "pydantic" not in packages


def test_the_help_lists_the_summary_of_each_command():
    commands = _Commands()
    for name, line in NAMES.items():
        assert commands.get_command(None, name).help.split("\n\n")[0].replace("\n", " ") == line
