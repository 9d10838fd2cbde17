"""Load names and modules on first use."""

from __future__ import annotations

from importlib import import_module

#: Not from `typing`, which loads slowly: Ctrl-C before `start` would show a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
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
