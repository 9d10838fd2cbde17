"""What pyproject.toml cannot say: where the project is, links that lead there, compiled kernels.

With GS_CODEC_KERNELS=1, `pip wheel --no-build-isolation .` compiles kernels into the wheel, which
is then for this Python, for Linux on x86-64 and for this release of numba: `make wheel`.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.egg_info import egg_info

#: Where the project is published. Nothing else names the place: set it here, and `make release`
#: writes it into metadata and recipes.
URL = "https://example.org/gs_codec"

HERE = Path(__file__).parent

#: Whether kernels are compiled.
COMPILED = os.environ.get("GS_CODEC_KERNELS") == "1"


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


class Package(Distribution):
    """What is built."""

    def has_ext_modules(self) -> bool:
        """Whether it has machine code."""
        return COMPILED


class BuildKernels(build_py):
    """Compile kernels beside the modules."""

    def run(self) -> None:
        """Copy modules, then compile."""
        super().run()
        if COMPILED and not self.editable_mode:
            folder = Path(self.build_lib, "gs_codec", "runtime", "compiled").resolve()
            command = [sys.executable, "-m", "gs_codec.runtime.kernel_build", str(folder)]
            subprocess.run(command, cwd=HERE, check=True)


class PinNumba(egg_info):
    """Require the release of numba that has compiled the kernels."""

    def run(self) -> None:
        """Change the requirement, then write all."""
        if COMPILED:
            import numba

            package = self.distribution
            others = [each for each in package.install_requires if not each.startswith("numba>")]
            package.install_requires = [*others, f"numba=={numba.__version__}"]
            package.metadata.install_requires = package.install_requires
        super().run()


class TagWheel(bdist_wheel):
    """Name the Python and the system that kernels are compiled for, with any usual glibc."""

    def get_tag(self) -> tuple[str, str, str]:
        """Python, ABI and system."""
        if not COMPILED:
            return super().get_tag()
        python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
        return python, python, "manylinux_2_17_x86_64"


setup(
    distclass=Package,
    cmdclass={"build_py": BuildKernels, "egg_info": PinNumba, "bdist_wheel": TagWheel},
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
