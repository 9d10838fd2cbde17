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
        text = f"{what}: needs {error.name}; pip install 'gs-codec[{extra}]'"
        raise MissingTool(text) from error
