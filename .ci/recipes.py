"""Write recipes for package managers next to the source distribution, and all checksums.

python .ci/recipes.py dist
"""

from __future__ import annotations

import hashlib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

RECIPES = ("conda/recipe.yaml", "homebrew/gs-codec.rb")


def fill(recipe: str, **values: str) -> str:
    """Fill in a recipe: replace ``@NAME@`` by values."""
    text = (ROOT / ".ci" / recipe).read_text(encoding="utf-8")
    return re.sub("@([A-Z0-9]+)@", lambda name: values[name[1]], text)


def project_url() -> str:
    """The project's URL, the only variable of setup.py."""
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    return re.findall('^URL = "(.*)"$', text, re.MULTILINE)[0]


def digest(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main(folder: Path) -> None:
    """Write the files, and SHA256SUMS."""
    [sdist] = folder.glob("gs_codec-*.tar.gz")
    version = sdist.name.removeprefix("gs_codec-").removesuffix(".tar.gz")
    for recipe in RECIPES:
        text = fill(recipe, VERSION=version, SHA256=digest(sdist), URL=project_url())
        (folder / Path(recipe).name).write_text(text, encoding="utf-8")
    files = sorted(path for path in folder.iterdir() if path.name != "SHA256SUMS")
    sums = "".join(f"{digest(path)}  {path.name}\n" for path in files)
    (folder / "SHA256SUMS").write_text(sums, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
