"""How much an installation takes: packages and bytes of gs-codec, and of gs-codec-core."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import gs_codec

#: What gs-codec has, and gs-codec-core goes without.
_LEFT_OUT = {"open3d", "open3d-cpu", "scipy"}


def installed() -> dict[str, dict[str, int]]:
    """``packages`` and ``bytes`` of each distribution, without extras, as installed here.

    Those that are not here, such as Open3D beside gs-codec-core, are not counted; nothing is if
    gs_codec itself is not installed.
    """
    own = next(filter(None, map(_found, ("gs-codec", "gs-codec-core"))), None)
    if own is None:
        return {}
    needs = _needs(own) | _LEFT_OUT
    sizes = {}
    for name, names in (("gs-codec", needs), ("gs-codec-core", needs - _LEFT_OUT)):
        packages = _with_needs(names)
        size = sum(map(_bytes_of, packages)) + _own_bytes()
        sizes[name] = {"packages": 1 + len(packages), "bytes": size}
    return sizes


def _found(name: str) -> Distribution | None:
    with suppress(PackageNotFoundError):
        return distribution(name)
    return None


def _needs(package: Distribution) -> set[str]:
    """Names of what a package requires, apart from its extras."""
    needs = (need for need in package.requires or () if not re.search(r";.*\bextra\b", need))
    return {re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", need)[0]).lower() for need in needs}


def _with_needs(names: Iterable[str]) -> list[Distribution]:
    """Installed packages of these names, and all that they require."""
    packages: dict[str, Distribution] = {}
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in packages and (package := _found(name)) is not None:
            packages[name] = package
            waiting += _needs(package)
    return list(packages.values())


def _bytes_of(package: Distribution) -> int:
    """Bytes of a package's files that are there."""
    paths = (Path(file.locate()) for file in package.files or ())
    return sum(path.stat().st_size for path in paths if path.is_file())


def _own_bytes() -> int:
    """Bytes of our packages, without compiled bytecode and what builds the page of `viewer`."""
    root = Path(gs_codec.__file__).parents[1]
    left = {"__pycache__", "node_modules"}
    return sum(
        path.stat().st_size
        for name in ("gs_codec", "viewer")
        for path in (root / name).rglob("*")
        if path.is_file() and not left & set(path.parts)
    )
