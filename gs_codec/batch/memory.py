"""How much memory a scene takes to encode, and how much there is."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

#: Python, its packages, and compiled kernels.
_FIXED = 400 << 20

#: Bytes at the peak for each byte of raw floats: 2.6 are measured (bench/RESULTS.md).
_ENCODING = 4

#: The same where views are drawn, 16 measured; and for each of their pixels, 280 measured.
_DRAWING = 20
_PIXEL = 320

#: Floats in memory for each byte of a file that is packed more tightly.
_PACKED = {".splat": 2, ".spz": 20, ".sog": 20, ".egs": 30}


#: Where a file's header was not read, its floats may be as many times what is expected of its
#: size, and as many bytes at least.
_MARGIN, _LEAST = 4, 64 << 20


def needed_bytes(floats: int, pixels: int = 0) -> int:
    """Memory that encoding a scene takes at most, about.

    Parameters
    ----------
    floats : int
        Bytes of its raw floats.
    pixels : int
        Of all views of it that are drawn.
    """
    return _FIXED + (_DRAWING if pixels else _ENCODING) * floats + _PIXEL * pixels


def expected_floats(size: int, name: str) -> int:
    """Bytes of raw floats of a file of `size` bytes; what is below 0 is taken for little."""
    packed = 5 if name.lower().endswith(".compressed.ply") else _PACKED.get(Path(name).suffix, 1)
    return packed * max(size, 0)


def most_floats(size: int, name: str) -> int:
    """Most bytes of floats to read from a file that a batch knew the size of, and no more."""
    return max(_MARGIN * expected_floats(size, name), _LEAST)


def available_bytes() -> int | None:
    """Memory that may be taken now, by this machine and its control groups; None if unknown."""
    rooms = [room for room in (_of_machine(), *_of_groups()) if room is not None]
    return min(rooms, default=None)


def _of_machine() -> int | None:
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    with suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return None


def _of_groups(root: Path = Path("/sys/fs/cgroup")) -> Iterator[int]:
    """Room in each control group that this process is in, of either version."""
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            number, controllers, path = line.split(":", 2)
            if number == "0":
                yield from _along(root, path, "memory.max", "memory.current")
            elif "memory" in controllers.split(","):
                names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
                yield from _along(root / "memory", path, *names)


def _along(root: Path, path: str, limit: str, used: str) -> Iterator[int]:
    """Room in a group and those around it; inside a container only the root may be seen."""
    group = root / path.strip("/")
    for folder in [group, *group.parents]:
        if not folder.is_relative_to(root):
            return
        with suppress(OSError, ValueError):  # no such file here, or no limit: "max"
            most = int((folder / limit).read_text())
            # Cached files go when memory is asked for.
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            cached = int(stat.get("inactive_file", 0))
            yield max(most - int((folder / used).read_text()) + cached, 0)
