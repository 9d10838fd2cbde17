"""Load names and modules on first use."""

from __future__ import annotations

from importlib import import_module

from gs_codec.errors import MissingTool

#: Not from `typing`, which loads slowly: Ctrl-C before `start` would show a traceback.
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
        Modules and their public names.
    packages : sequence of str
        Subpackages that can also be accessed by name.
    """
    homes = {name: module for module, names in public.items() for name in names}

    def find(name: str) -> Any:
        if name in packages:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(homes[name]), name)

    return list(homes), find


class Lazy:
    """A function of a module that is imported when the function is first called.

    Parameters
    ----------
    module, name : str
    """

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = module, name

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the function."""
        return getattr(import_module(self.module), self.name)(*arguments, **options)


def from_extra(module: str, extra: str, what: str) -> ModuleType:
    """Import a module of ours that needs packages of an extra.

    Raises
    ------
    MissingTool
        If they are not installed; `what` names the feature that needs them.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingTool(f"{what}: needs {error.name}; {pip_install(extra)}") from error


def pip_install(extra: str) -> str:
    """The command that installs the packages of an extra, for the installed distribution."""
    from importlib.metadata import PackageNotFoundError, version

    name = "gs-codec-core"
    try:
        version(name)
    except PackageNotFoundError:
        name = "gs-codec"
    return f"pip install '{name}[{extra}]'"


def needed(module: str, what: str) -> ModuleType:
    """Import a module of Open3D, scipy or matplotlib, which gs-codec-core does not require.

    Raises
    ------
    MissingTool
        If the package is not installed; `what` names the feature that needs it.
    """
    check_installed(module.partition(".")[0], what)
    return import_module(module)


def check_installed(package: str, what: str) -> None:
    """Reject a call that needs a package which is not installed, like `needed`."""
    from importlib.util import find_spec

    if find_spec(package) is None:
        import platform

        small = platform.system() == "Linux" and platform.machine() == "x86_64"
        name = "open3d-cpu" if small and package == "open3d" else package
        raise MissingTool(f"{what}: needs {package}; pip install {name}")
