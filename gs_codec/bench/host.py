"""The machine that results come from, the code, and the packages they were measured with."""

from __future__ import annotations

import os
import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

#: Packages that what is measured uses, ours and others'.
_PACKAGES = (
    "numpy", "numba", "scipy", "scikit-image", "plyfile", "pcodec", "crc32c", "zstandard",
    "constriction", "torch", "torchac", "spz",
)  # fmt: skip


def processor_name() -> str:
    """The processor's model, or what architecture it is of where the system does not tell."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name" and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


def memory_bytes() -> int | None:
    """Memory of the machine, where the system tells."""
    with suppress(OSError, ValueError, AttributeError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return None


def commit() -> str | None:
    """The commit of the checkout this package is in, with "+changes" if it has any; else None."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    head, changes = _git(root, "rev-parse", "HEAD"), _git(root, "status", "--porcelain")
    if head is None or changes is None:
        return None
    return f"{head}+changes" if changes else head


def _git(root: Path, *arguments: str) -> str | None:
    """What git says of a checkout, or None where it cannot."""
    with suppress(OSError):
        command = ["git", "-C", str(root), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            return done.stdout.strip()
    return None


def package_versions() -> dict[str, str]:
    """Versions of those packages that are there."""
    found = {}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
