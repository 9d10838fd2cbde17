"""Available memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def available_bytes() -> int | None:
    """Free memory of this machine and its control groups in bytes; None if unknown."""
    known = [free for free in (_of_machine(), *_of_groups()) if free is not None]
    return min(known, default=None)


def _of_machine() -> int | None:
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    with suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return None


def _of_groups(root: Path = Path("/sys/fs/cgroup")) -> Iterator[int]:
    """Free memory in each control group (version 1 or 2) of this process."""
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            number, controllers, path = line.split(":", 2)
            if number == "0":
                yield from _along(root, path, "memory.max", "memory.current")
            elif "memory" in controllers.split(","):
                names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
                yield from _along(root / "memory", path, *names)


def _along(root: Path, path: str, limit: str, used: str) -> Iterator[int]:
    """Free memory in a group and its parents; inside a container only the root may be visible."""
    group = root / path.strip("/")
    for folder in [group, *group.parents]:
        if not folder.is_relative_to(root):
            return
        with suppress(OSError, ValueError):  # no such file here, or no limit: "max"
            most = int((folder / limit).read_text())
            # The system frees cached files when memory is needed.
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            cached = int(stat.get("inactive_file", 0))
            yield max(most - int((folder / used).read_text()) + cached, 0)
