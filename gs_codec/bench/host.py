"""The machine that results come from, the code, and the packages they were measured with."""

from __future__ import annotations

import os
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gs_codec import __version__
from gs_codec.runtime.threads import available_threads

#: Packages that measured codecs use, ours and others'.
_PACKAGES = (
    "numpy", "numba", "scipy", "plyfile", "pcodec", "crc32c", "zstandard", "spz",
)  # fmt: skip


def machine() -> dict[str, Any]:
    """The result line of what the numbers were measured on and with."""
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
    """The processor's model, or its architecture if the system does not tell."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def commit() -> str | None:
    """The commit of the checkout this package is in, with "-dirty" if it has changes; else None."""
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
