"""Check that a wheel with compiled kernels compiles nothing: `check_kernels.py WHEEL [PYTHON]`.

It installs the wheel into a clean venv of PYTHON, makes it read-only, and runs the commands of
README.md and COMMANDS.md without a home folder. Root runs them as user `nobody`, if that user can
run PYTHON. It lists all kernels that were compiled, from numba's events, and the commands that
compiled them.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = "README.md", "gs_codec/cli/COMMANDS.md"

#: Runs in every process of the venv.
WATCH = """
import os
import sys
import numba.core.event as event

class Compiled(event.Listener):
    def on_start(self, event):
        kernel = event.data["dispatcher"].py_func
        with open(os.environ["COMPILED"], "a") as file:
            print(kernel.__module__, kernel.__qualname__, *event.data["args"], file=file)
    def on_end(self, event):
        pass

event.register("numba:compile", Compiled())
"""


def main() -> int:
    """Run all commands; return 1 if one failed or compiled a kernel."""
    wheel, python = sys.argv[1], [*sys.argv[2:], sys.executable][0]
    with tempfile.TemporaryDirectory(prefix="check-kernels-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        venv = _installed(folder / "venv", wheel, python)
        work = folder / "work"
        work.mkdir()
        user = {}
        # Other users cannot run a Python in a folder that only root can enter.
        if os.geteuid() == 0 and all(p.stat().st_mode & 1 for p in Path(python).resolve().parents):
            shutil.chown(work, "nobody")
            user = {"user": "nobody", "extra_groups": []}
        compiled = work / "compiled.txt"
        environment = {
            "PATH": f"{venv / 'bin'}:/usr/bin:/bin", "HOME": "/nonexistent", "LANG": "C.UTF-8",
            "COMPILED": str(compiled), "PYTHONDONTWRITEBYTECODE": "1", "TMPDIR": str(work),
            "GS_CODEC_SPLAT_TRANSFORM": "no-such-program",
        }  # fmt: skip
        compiled.touch(0o666)
        compiled.chmod(0o666)
        bad = 0
        for line in _commands():
            start = time.perf_counter()
            done = subprocess.run(
                shlex.split(line), cwd=work, env=environment, capture_output=True, text=True,
                check=False, **user,
            )  # fmt: skip
            found = compiled.read_text().splitlines()
            compiled.write_text("")
            bad += bool(done.returncode or found)
            seconds = time.perf_counter() - start
            print(f"{len(found)} compiled, {seconds:.1f} s: {line}", *found, sep="\n    ")
            if done.returncode:
                print(done.stdout + done.stderr)
        return min(bad, 1)


def _installed(venv: Path, wheel: str, python: str) -> Path:
    subprocess.run([python, "-m", "venv", venv], check=True)
    pip = [venv / "bin/python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    subprocess.run([*pip, wheel, "matplotlib"], check=True)
    (site,) = venv.glob("lib/python*/site-packages")
    (site / "watch_kernels.py").write_text(WATCH)
    (site / "watch.pth").write_text("import watch_kernels")
    subprocess.run(["chmod", "-R", "a+rX,a-w", venv], check=True)
    return venv


def _commands() -> list[str]:
    """Commands in the documents after the one that makes the scene."""
    sample = f"python {ROOT / 'samples/generate.py'} scene.ply --gaussians 1100 --sh-degree 1"
    lines = []
    for name in DOCUMENTS:
        lines += ["find . -mindepth 1 ! -name compiled.txt -delete", f"{sample} --seed 80"]
        lines += re.findall(r"^    (gs-codec [^#\n]*)", (ROOT / name).read_text(), re.MULTILINE)
    return [line.strip() for line in lines]


if __name__ == "__main__":
    sys.exit(main())
