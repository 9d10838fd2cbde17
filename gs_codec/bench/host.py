"""Description of the machine, the code and its packages; size of an installation."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution, version
from pathlib import Path
from typing import Any

import gs_codec
from gs_codec import __version__
from gs_codec.runtime.mapped import total_bytes
from gs_codec.runtime.threads import available_threads

#: Packages used by the measured codecs, ours and others'.
_PACKAGES = (
    "numpy", "numba", "scipy", "plyfile", "pcodec", "crc32c", "zstandard", "spz",
)  # fmt: skip


def machine() -> dict[str, Any]:
    """The result line that describes machine and software."""
    return {
        "kind": "machine",
        "gs_codec": __version__,
        "python": platform.python_version(),
        "processor": processor_name(),
        "cores": os.cpu_count(),
        "threads": available_threads(),
        "system": platform.platform(),
        "commit": commit(),
        "packages": {name: found for name in _PACKAGES if (found := version_of(name))},
    }


def processor_name() -> str:
    """The processor's model, or its architecture if the model is unknown."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def commit() -> str | None:
    """Commit of the checkout with this package, with "-dirty" if modified; None outside one."""
    root = Path(__file__).resolve().parents[2]
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    with suppress(OSError):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0 and (root / ".git").exists():
            return done.stdout.strip()
    return None


def version_of(package: str) -> str | None:
    """Version of a package; None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


#: Requirements of gs-codec that gs-codec-core does not have.
_LEFT_OUT = {"open3d", "open3d-cpu", "scipy"}


def installed() -> dict[str, dict[str, int]]:
    """``packages`` and ``bytes`` of each distribution, without extras, as installed here.

    Packages that are not installed, such as Open3D with gs-codec-core, are not counted. The result
    is empty if gs_codec itself is not installed.
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
    """Names of a package's requirements, without extras."""
    needs = (need for need in package.requires or () if not re.search(r";.*\bextra\b", need))
    return {re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", need)[0]).lower() for need in needs}


def _with_needs(names: Iterable[str]) -> list[Distribution]:
    """Installed packages of these names, and everything they require."""
    packages: dict[str, Distribution] = {}
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in packages and (package := _found(name)) is not None:
            packages[name] = package
            waiting += _needs(package)
    return list(packages.values())


def _bytes_of(package: Distribution) -> int:
    """Total size of a package's existing files."""
    return total_bytes(Path(file.locate()) for file in package.files or ())


def _own_bytes() -> int:
    """Size of our packages, without bytecode and the build files of the viewer's page."""
    root = Path(gs_codec.__file__).parents[1]
    left = {"__pycache__", "node_modules"}
    return sum(
        path.stat().st_size
        for name in ("gs_codec", "viewer")
        for path in (root / name).rglob("*")
        if path.is_file() and not left & set(path.parts)
    )
