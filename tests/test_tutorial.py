"""The tutorial, typed line by line in a clean clone, prints what it shows."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TUTORIAL = (ROOT / "samples" / "TUTORIAL.md").read_text()

#: Relative tolerance of shown numbers: numpy releases differ in the last digits.
TOLERANCE = 0.03

_STEP = re.compile(
    r"^    (?P<command>\S[^\n]*)$"
    r"|^```python\n(?P<code>.*?)^```$"
    r"|^```text\n(?P<shown>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)

#: Other installation commands of the documents, typed after the tutorial.
AFTER = [
    "gs-codec share scene.ply scene.egs --cameras cameras.json --out page.html",
    "make docs",
    "gs-codec share scene.ply scene.egs --cameras cameras.json --out page.html --overwrite",
    "pip install .",
    "cd views",
    "gs-codec share ../scene.ply --cameras ../cameras.json --out ../page.html --overwrite",
    "cd ..",
]

_MARK = "@@ the next step"


def clone(folder: Path) -> Path:
    """The result of `git clone` for the work tree."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


def without_network(folder: Path) -> dict[str, str]:
    """An environment where pip installs only this project; everything else is already installed."""
    folder.mkdir()
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if not re.match(r"gs_codec|__editable__|pip\b|.*\.pth$", path.name):
            (folder / path.name).symlink_to(path)
    kept = {name: text for name, text in os.environ.items() if not name.startswith("PIP_")}
    return kept | {
        "PYTHONPATH": str(folder),
        "PIP_CONFIG_FILE": os.devnull,
        "PIP_NO_INDEX": "1",
        "PIP_NO_DEPS": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # pip inverts the value of a "no" option
    }


def type_all(folder: Path, environment: dict[str, str]) -> list[tuple[str, str, str]]:
    """Run the commands and code of the tutorial in one shell; return what is printed and shown."""
    steps: list[tuple[str, str]] = []
    for step in _STEP.finditer(TUTORIAL):
        if step["shown"] is not None:
            steps[-1] = (steps[-1][0], step["shown"])
        else:
            code = f"python - <<'END'\n{step['code']}END"
            steps.append((code if step["code"] else step["command"], ""))
    steps += [(line, "") for line in AFTER]
    script = "".join(f"echo '{_MARK}'\n{line}\n" for line, _ in steps)
    done = subprocess.run(
        ["bash", "-e", "-c", script],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    printed = done.stdout.split(f"{_MARK}\n")[1:]
    assert done.returncode == 0, (steps[len(printed) - 1][0], done.stderr[-5000:])
    return [(line, text, shown) for (line, shown), text in zip(steps, printed, strict=True)]


def _agrees(shown: str, printed: str) -> bool:
    """Whether a printed line matches, up to a cut in the shown line, numbers approximately."""
    cut = shown.endswith("...")
    wanted, found = shown.removesuffix("...").split(), printed.split()
    if len(found) < len(wanted) or (not cut and len(found) > len(wanted)):
        return False
    return all(_is_near(*pair) for pair in zip(wanted, found, strict=False))


def _is_near(wanted: str, found: str) -> bool:
    try:
        a, b = (float(word.replace(",", "").rstrip("%x")) for word in (wanted, found))
    except ValueError:
        return wanted == found
    return a == b or math.isclose(a, b, rel_tol=TOLERANCE)


@pytest.mark.thorough
@pytest.mark.skipif(
    not (shutil.which("git") and shutil.which("make") and (ROOT / ".git").exists()),
    reason="needs git, make, and a clone",
)
def test_commands_print_the_shown_output(tmp_path):
    folder = clone(tmp_path / "clone")
    done = type_all(folder, without_network(tmp_path / "packages"))
    assert len(done) >= 15
    for what, printed, shown in done:
        lines = iter(printed.splitlines())
        for line in shown.splitlines():
            if line.strip() != "...":
                assert any(_agrees(line, found) for found in lines), (what, line, printed)
    files = {path.name for path in folder.iterdir()}
    for name in ("decoded.ply", "error.png", "pruned.png", "report", "analysis", "views"):
        assert name in files
    named = set(re.findall(r"^    gs-codec (?:encode|decode) \S+ (\S+)", TUTORIAL, re.MULTILINE))
    assert named <= files
    assert (folder / "demo" / "picture.png").exists()
    assert (folder / "page.html").read_text().count('type="application/octet-stream"') == 1
