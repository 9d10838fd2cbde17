"""Install a wheel or source distribution into a new environment, and use it there.

python .ci/try_install.py dist/gs_codec-1.1.0-py3-none-any.whl
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: Commands that make a scene; the sample needs Open3D.
SAMPLE = (
    "python {root}/samples/generate.py scene.ply --gaussians 5000 --sh-degree 3"
    " --cameras cameras.json"
)
CORE_SAMPLE = "gs-codec convert {root}/tests/golden/other.spz scene.ply"

COMMANDS = """
gs-codec --version
gs-codec encode scene.ply scene.egs
gs-codec inspect scene.egs
gs-codec decode scene.egs decoded.ply
gs-codec compare scene.ply scene.egs --cameras cameras.json --width 100
gs-codec share scene.ply scene.egs --cameras cameras.json --out page.html
gs-viewer --version
"""

#: Text that a page with two scenes must contain.
IN_PAGE = '<script type="application/octet-stream" id="scene-1">'


def main(distribution: str) -> None:
    """Raise `CalledProcessError` for the first step that fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "venv", with_pip=True)
        bin_folder = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        environment = {key: text for key, text in os.environ.items() if key != "PYTHONPATH"}
        environment["NUMBA_CACHE_DIR"] = str(folder / "kernels")

        def run(program: str, *arguments: str) -> None:
            print("+", program, *arguments, flush=True)
            command = [str(bin_folder / program), *arguments]
            subprocess.run(command, cwd=folder, env=environment, check=True)

        run("python", "-m", "pip", "install", "--quiet", str(Path(distribution).resolve()))
        lines = f"{SAMPLE}{COMMANDS}"
        if Path(distribution).name.startswith("gs_codec_core"):
            lines = f"{CORE_SAMPLE}{COMMANDS}".replace("cameras.json", "auto")
        for line in lines.strip().splitlines():
            program, *arguments = line.split()
            run(program, *(word.format(root=ROOT) for word in arguments))
        if IN_PAGE not in (folder / "page.html").read_text(encoding="utf-8"):
            raise SystemExit("page.html: the second scene is missing")
        print(f"{distribution}: installed, and its commands work")


if __name__ == "__main__":
    main(sys.argv[1])
