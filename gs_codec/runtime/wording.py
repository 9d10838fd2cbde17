"""Numbers in messages, with their nouns and units."""

from __future__ import annotations

from typing import SupportsIndex


def counted(number: SupportsIndex, noun: str) -> str:
    """A number and its noun: "1 Gaussian", "1,234 Gaussians", "2 properties"."""
    return f"{number:,} {noun if number == 1 else _plural(noun)}"


def _plural(noun: str) -> str:
    if noun.endswith("y"):
        return f"{noun[:-1]}ies"
    return f"{noun}es" if noun.endswith(("ss", "x")) else f"{noun}s"


def size_text(size: float) -> str:
    """A number of bytes with its unit, decimal."""
    if size < 1000:
        return counted(round(size), "byte")
    kilobytes = size / 1000
    return f"{kilobytes:.2f} kB" if kilobytes < 999.995 else f"{kilobytes / 1000:.2f} MB"
