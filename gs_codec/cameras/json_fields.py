"""Validated access to fields of JSON files about cameras."""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import opened
from gs_codec.runtime.wording import counted

#: Maximum file size in bytes, about 80,000 cameras. A hostile JSON text takes 30 times that in
#: memory.
MAX_BYTES = 1 << 25

#: Entries of a rotation are at most 1; much larger ones would overflow when checked.
_MAX_ROTATION = 2.0


def load_json(path: Path) -> Any:
    """Parse a JSON file. Raises InvalidInput if it is not JSON, too large, or nested too deeply."""
    with opened(path) as data:
        if len(data) > MAX_BYTES:
            raise InvalidInput(
                f"{path}: {counted(len(data), 'byte')}, expected at most {MAX_BYTES:,}"
            )
        raw = bytes(data)
    try:
        return parse_json(raw.decode("utf-8-sig"), with_constants=True)
    except UnicodeDecodeError as error:
        raise InvalidInput(f"{path}: not UTF-8 text at byte {error.start}") from error
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{path}: not JSON ({error})") from error
    except RecursionError as error:
        raise InvalidInput(f"{path}: lists nested too deeply, expected cameras") from error


def get(where: str, entry: Mapping[str, Any], key: str) -> Any:
    """A required field."""
    if key not in entry:
        raise InvalidInput(f"{where}: no '{key}'")
    return entry[key]


def as_object(where: str, value: Any, expected: str) -> dict[str, Any]:
    """A JSON object; `expected` describes it in errors."""
    if not isinstance(value, dict):
        raise InvalidInput(f"{where}: {short(value)}, expected {expected}")
    return value


def as_list(where: str, key: str, value: Any) -> list[Any]:
    """A JSON list."""
    if not isinstance(value, list):
        raise InvalidInput(f"{where}: {key} {short(value)}, expected a list")
    return value


def as_text(where: str, key: str, value: Any) -> str:
    """A JSON string."""
    if not isinstance(value, str):
        raise InvalidInput(f"{where}: {key} {short(value)}, expected text")
    return value


def as_number(where: str, key: str, value: Any) -> float:
    """A finite number."""
    # True is an int in Python, but not a number in JSON.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidInput(f"{where}: {key} {short(value)}, expected a finite number")
    return float(value)


def as_pixels(where: str, key: str, value: Any) -> int:
    """A whole number of pixels, in any range; some programs write it as a float."""
    number = as_number(where, key, value)
    if not number.is_integer() or abs(number) > 1 << 53:
        raise InvalidInput(f"{where}: {key} {number}, expected a whole number of pixels")
    return int(number)


def as_angle(where: str, key: str, value: Any, half_turn: float) -> float:
    """A field of view, as half of it in radians; `half_turn` is 180 or pi."""
    angle = as_number(where, key, value)
    half = angle / half_turn * math.pi / 2
    if not 0 < half < math.pi / 2:
        raise InvalidInput(f"{where}: {key} {angle}, expected above 0 and below {half_turn:.6g}")
    return half


def as_numbers(where: str, key: str, value: Any, count: int) -> list[float]:
    """A list of `count` finite numbers."""
    if not isinstance(value, list) or len(value) != count:
        raise InvalidInput(f"{where}: {key} {short(value)}, expected {counted(count, 'number')}")
    return [as_number(where, key, number) for number in value]


def as_rotation(where: str, value: Any) -> NDArray[np.float64]:
    """Three rows of three numbers, none much too large for a rotation."""
    return check_rotation(where, _rows(where, "rotation", value, (3,), 3))


def as_pose(where: str, key: str, value: Any) -> NDArray[np.float64]:
    """Rotation and position ``(3, 4)``; a fourth row is 0 0 0 1."""
    pose = _rows(where, key, value, (3, 4), 4)
    if len(pose) == 4 and not np.allclose(pose[3], (0, 0, 0, 1), rtol=0, atol=1e-6):
        raise InvalidInput(f"{where}: {key} ends in {short(value[3])}, expected 0, 0, 0, 1")
    check_rotation(where, pose[:3, :3])
    return pose[:3]


def _rows(
    where: str, key: str, value: Any, counts: tuple[int, ...], width: int
) -> NDArray[np.float64]:
    if not isinstance(value, list) or len(value) not in counts:
        expected = f"{' or '.join(map(str, counts))} rows of {width} numbers"
        raise InvalidInput(f"{where}: {key} {short(value)}, expected {expected}")
    return np.array([as_numbers(where, f"{key} row", row, width) for row in value])


def check_rotation(where: str, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Check that entries are small enough for the test of whether the matrix is a rotation."""
    if np.abs(matrix).max() > _MAX_ROTATION:
        raise InvalidInput(f"{where}: rotation contains {np.abs(matrix).max()}, expected -1 to 1")
    return matrix


def short(value: Any) -> str:
    """A value, abbreviated to a few characters."""
    text = reprlib.repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
