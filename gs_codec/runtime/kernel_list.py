"""The list of kernels and the types to compile them for: `kernels.txt`.

A line has a kernel's module and name, and the types of its arguments; ``float32[2C]`` is a
two-dimensional array in C order.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

LIST = Path(__file__).with_name("kernels.txt")

_ARRAY = re.compile(r"(\w+)\[(\d)([CFA])\]")


class Entry(NamedTuple):
    """A line of the list."""

    module: str
    name: str
    types: str

    def kernel(self) -> Any:
        """The kernel itself; imports its module."""
        return getattr(import_module(self.module), self.name)

    def signature(self) -> tuple[Any, ...]:
        """The types as numba types."""
        return tuple(map(_type_of, self.types.split()))


def entry_of(function: Any, types: Iterable[Any]) -> Entry:
    """The line of a kernel for some types."""
    return Entry(function.__module__, function.__qualname__, " ".join(map(_text_of, types)))


def read_list(path: Path = LIST) -> list[Entry]:
    """Read all lines."""
    return [Entry(*line.split(" ", 2)) for line in path.read_text().splitlines()]


def write_list(entries: Iterable[Entry], path: Path = LIST) -> None:
    """Write lines, sorted."""
    path.write_text("".join(" ".join(entry) + "\n" for entry in sorted(set(entries))))


def _text_of(kind: Any) -> str:
    text = repr(kind).replace(" ", "")
    plain = re.fullmatch(r"Array\((\w+),(\d),'([CFA])',False,aligned=True\)", text)
    return "{}[{}{}]".format(*plain.groups()) if plain else text


@functools.cache
def _type_of(text: str) -> Any:
    from numba import types

    known = vars(types) | {"bool": types.boolean}
    if array := _ARRAY.fullmatch(text):
        return types.Array(known[array[1]], int(array[2]), array[3])
    return eval(text, {"__builtins__": {}}, known)
