"""Optional packages: whether they are installed, and one message that says how to install them."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from gs_codec.errors import MissingTool, one_line

#: By module of an optional package: its name in messages, and the extra that installs it.
_EXTRAS = {
    "cv2": ("OpenCV", "undistort"),
    "distributed": ("distributed", "cluster"),
    "fsspec": ("fsspec", "cluster"),
    "gsplat": ("gsplat and a CUDA device that torch sees", "gpu"),
    "imageio_ffmpeg": ("imageio-ffmpeg", "video"),
    "lpips": ("lpips", "lpips"),
    "numba_cuda": ("numba-cuda and its CUDA toolkit", "cuda"),
    "pxr": ("usd-core", "usd"),
    "torchac": ("torchac", "paper"),
}


def is_available(*modules: str) -> bool:
    """Whether modules of optional packages are loaded or can be found; does not import them."""
    return all(
        (sys.modules[module] if module in sys.modules else find_spec(module)) is not None
        for module in modules
    )


def missing_package(module: str, what: str, why: str = "") -> MissingTool:
    """The error for a module that is not installed, or cannot be used.

    Parameters
    ----------
    module : str
        A top-level module of an optional package.
    what : str
        The feature that needs it.
    why : str
        Why it cannot be used; empty if it is not installed.
    """
    import platform

    package, extra = _EXTRAS.get(module, (module, ""))
    small = platform.system() == "Linux" and platform.machine() == "x86_64"
    name = "open3d-cpu" if small and module == "open3d" else package
    how = pip_install(extra) if extra else f"pip install {name}"
    return MissingTool(f"{what}: needs {package}{why and f' ({why})'}; {how}")


def check_installed(module: str, what: str) -> None:
    """Reject a call that needs a module which is not installed; see `missing_package`."""
    if not is_available(module):
        raise missing_package(module, what)


def needed(name: str, what: str) -> ModuleType:
    """Import a module of an optional package.

    Raises MissingTool if the package is not installed or cannot be loaded; `what` says what needs
    it.
    """
    module = name.partition(".")[0]
    check_installed(module, what)
    try:
        return import_module(name)
    except (ImportError, OSError, RuntimeError) as error:
        raise missing_package(module, what, one_line(error)) from error


def pip_install(extra: str) -> str:
    """The command that installs an extra for the installed distribution."""
    from importlib.metadata import PackageNotFoundError, version

    name = "gs-codec-core"
    try:
        version(name)
    except PackageNotFoundError:
        name = "gs-codec"
    return f"pip install '{name}[{extra}]'"
