"""Parse JSON of other programs."""

from __future__ import annotations

import json
from typing import Any


def parse_json(text: str | bytes, with_constants: bool = False) -> Any:
    """Parse a JSON text; integers of 16 digits or more become floats, infinite if too large.

    Raises ValueError or RecursionError if it is not valid JSON; NaN and Infinity are valid only
    `with_constants`.
    """
    constant = None if with_constants else _refuse_constant
    return json.loads(text, parse_int=_number, parse_constant=constant)


def _number(text: str) -> int | float:
    # Python refuses to parse or print very long integers, and to convert them to floats.
    return int(text) if len(text) < 16 else float(text)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number of JSON")
