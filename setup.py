"""What pyproject.toml cannot say: where the project is, and a readme with links that lead there."""

import re
from pathlib import Path

from setuptools import setup

#: Where the project is published. Nothing else names the place: set it here, and `make release`
#: writes it into metadata and recipes.
URL = "https://example.org/gs_codec"

HERE = Path(__file__).parent


def version() -> str:
    """The version that the package states."""
    text = (HERE / "gs_codec" / "__init__.py").read_text(encoding="utf-8")
    return re.findall('^__version__ = "(.*)"$', text, re.MULTILINE)[0]


def readme() -> str:
    """README.md as package indexes show it: its links and pictures are those of this version."""

    def absolute(link: re.Match) -> str:
        kind = "raw" if link["image"] else "blob"
        return f"{link['image']}[{link['text']}]({URL}/{kind}/v{version()}/{link['path']})"

    text = (HERE / "README.md").read_text(encoding="utf-8")
    relative = r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<path>(?!https?:|#)[^)]+)\)"
    return re.sub(relative, absolute, text)


setup(
    long_description=readme(),
    long_description_content_type="text/markdown",
    project_urls={
        "Homepage": URL,
        "Documentation": f"{URL}/blob/v{version()}/gs_codec/cli/COMMANDS.md",
        "Source": URL,
        "Issues": f"{URL}/issues",
        "Changelog": f"{URL}/blob/v{version()}/CHANGELOG.md",
    },
)
