"""Names and modules that are loaded when they are first used."""

from __future__ import annotations

from importlib import import_module

from gs_codec.errors import MissingTool

#: Not from `typing`: it takes long to load, and Ctrl-C before `start` shows a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from types import ModuleType
    from typing import Any


def lazy_names(
    package: str, public: Mapping[str, Sequence[str]], packages: Sequence[str] = ()
) -> tuple[list[str], Callable[[str], Any]]:
    """The ``__all__`` and the ``__getattr__`` of a package.

    Parameters
    ----------
    package : str
    public : mapping of str to sequence of str
        Modules, and names that they have for everybody.
    packages : sequence of str
        Packages in it that are found by their names, too.
    """
    homes = {name: module for module, names in public.items() for name in names}

    def find(name: str) -> Any:
        if name in packages:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(homes[name]), name)

    return list(homes), find


def from_extra(module: str, extra: str, what: str) -> ModuleType:
    """A module of ours that needs packages of an extra.

    Raises
    ------
    MissingTool
        If they are not installed; `what` says who needs them.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingTool(f"{what}: needs {error.name}; {pip_install(extra)}") from error


def pip_install(extra: str) -> str:
    """The command that installs what an extra is for, beside the distribution that is there."""
    from importlib.metadata import PackageNotFoundError, version

    name = "gs-codec-core"
    try:
        version(name)
    except PackageNotFoundError:
        name = "gs-codec"
    return f"pip install '{name}[{extra}]'"


def needed(module: str, what: str) -> ModuleType:
    """A module of Open3D, scipy or matplotlib, which gs-codec-core goes without.

    Raises
    ------
    MissingTool
        If the package is not installed; `what` says who needs it.
    """
    check_installed(module.partition(".")[0], what)
    return import_module(module)


def check_installed(package: str, what: str) -> None:
    """Refuse a call that needs a package which is not installed, as `needed` does."""
    from importlib.util import find_spec

    if find_spec(package) is None:
        import platform

        small = platform.system() == "Linux" and platform.machine() == "x86_64"
        name = "open3d-cpu" if small and package == "open3d" else package
        raise MissingTool(f"{what}: needs {package}; pip install {name}")
