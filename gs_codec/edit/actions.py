"""Actions that commands apply to a scene: their names and typed arguments.

The commands make options from these. Their implementation, in `apply`, is not loaded here.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from gs_codec.config import Option
from gs_codec.errors import InvalidInput
from gs_codec.runtime.arguments import check_fields
from gs_codec.runtime.json_text import parse_json

if TYPE_CHECKING:
    from gs_codec.edit.project_file import Project

#: Comparison operators of conditions; an operator precedes its own prefixes.
COMPARED: Mapping[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
}
_CONDITION = re.compile(rf"\s*([^\s<>=!]+)\s*({'|'.join(COMPARED)})\s*([^\s<>=!]+)\s*")

#: Maximum bytes of a matrix file.
_LONGEST = 1 << 16


@dataclass(frozen=True)
class Kind:
    """A kind of action.

    Parameters
    ----------
    help, metavar : str
        Help and metavar of its option; without a metavar it is a switch.
    read : callable
        Parses the typed text into arguments; raises `InvalidInput`.
    does : {"choose", "move", "change"}
        Whether it selects Gaussians, moves the scene relative to its cameras, or does something
        else.
    local : bool
        Whether it treats each Gaussian separately, or sorts them.
    guided : bool
        Whether it uses cameras.
    """

    help: str
    metavar: str
    read: Callable[[str], tuple[Any, ...]]
    does: Literal["choose", "move", "change"] = "choose"
    local: bool = True
    guided: bool = False


def _numbers(*counts: int) -> Callable[[str], tuple[float, ...]]:
    """Parse comma-separated numbers; `counts` are the accepted lengths."""

    def read(text: str) -> tuple[float, ...]:
        try:
            numbers = tuple(float(number) for number in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
            expected = " or ".join(map(str, counts))
            expected += " numbers separated by commas" if max(counts) > 1 else " number"
            raise InvalidInput(f"expected {expected}")
        return numbers

    return read


def _whole(low: int, high: int) -> Callable[[str], tuple[int]]:
    """Parse an integer within a range."""

    def read(text: str) -> tuple[int]:
        if not re.fullmatch("[0-9]{1,30}", text) or not low <= int(text) <= high:
            raise InvalidInput(f"expected an integer from {low} to {high}")
        return (int(text),)

    return read


def _share(text: str) -> tuple[float]:
    """Parse a percentage, with or without a percent sign."""
    try:
        percent = float(text.removesuffix("%"))
    except ValueError:
        percent = math.nan
    if not 0 < percent <= 100:
        raise InvalidInput("expected a percentage above 0, for example 40%")
    if percent < 1 and not text.endswith("%"):
        raise InvalidInput(f"expected percent, for example {100 * percent:g}% or {percent:g}%")
    return (percent,)


def read_condition(text: str) -> tuple[str, str, float]:
    """Parse a condition: attribute, comparison, number."""
    if found := _CONDITION.fullmatch(text):
        with suppress(ValueError):
            if not math.isnan(number := float(found[3])):
                return found[1], found[2], number
    raise InvalidInput("expected an attribute, one of < <= > >= == !=, and a number")


def _order(text: str) -> tuple[()]:
    """Parse the name of an order of Gaussians."""
    if text != "morton":
        raise InvalidInput("expected morton")
    return ()


def _nothing(text: str) -> tuple[()]:
    """Parse the empty text of a switch."""
    if text:
        raise InvalidInput("takes no value")
    return ()


def _matrix(path: str) -> tuple[list[list[float]]]:
    """Read a JSON file of three or four rows of four numbers, or three rows as typed numbers.

    In nerfstudio's ``dataparser_transforms.json``, they are the ``transform`` of an object, and its
    ``scale`` multiplies the result.
    """
    if path.count(",") == 11:
        numbers = _numbers(12)(path)
        return ([[*numbers[k : k + 4]] for k in (0, 4, 8)] + [[0.0, 0.0, 0.0, 1.0]],)
    try:
        with open(path, "rb") as file:
            found = parse_json(file.read(_LONGEST), with_constants=True)
        factor = 1.0
        if isinstance(found, dict):
            factor, found = float(found.get("scale", 1.0)), found["transform"]
        rows = [[float(number) for number in row] for row in found]
    except OSError as error:
        raise InvalidInput(f"{error.strerror}") from error
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
        rows = []
    if len(rows) not in (3, 4) or any(len(row) != 4 for row in rows):
        raise InvalidInput("expected three or four rows of four numbers, in JSON")
    scaled = [[factor * number for number in row] for row in rows[:3]]
    return ([*scaled, *(rows[3:] or [[0.0, 0.0, 0.0, 1.0]])],)


def _project(path: str) -> tuple[Project]:
    """Read a project of gs-viewer."""
    from gs_codec.edit.project_file import read_project

    return (read_project(path),)


#: Kinds of actions by name, in the order of the help.
KINDS: Mapping[str, Kind] = {
    "crop-box": Kind(
        "Keep Gaussians with centres in this box: lowest, then highest corner.",
        "X,Y,Z,X,Y,Z", _numbers(6),
    ),
    "crop-sphere": Kind(
        "Keep Gaussians with centres in this sphere: centre and radius.", "X,Y,Z,R", _numbers(4)
    ),
    "filter": Kind(
        "Keep Gaussians that meet a condition: 'opacity>0.05', 'longest_scale<2', 'z<=1.5'.",
        "CONDITION", read_condition,
    ),
    "remove-nan": Kind("Remove Gaussians with NaN or infinity.", "", _nothing),
    "remove-floaters": Kind(
        "Remove Gaussians that are isolated, far outside or, with cameras, hardly seen.",
        "", _nothing, local=False, guided=True,
    ),
    "keep-largest-cluster": Kind(
        "Keep the largest cluster of neighbouring Gaussians.", "", _nothing, local=False
    ),
    "translate": Kind("Translate the scene.", "X,Y,Z", _numbers(3), does="move"),
    "rotate": Kind(
        "Rotate the scene: degrees about x, then y, then z; or a quaternion.",
        "X,Y,Z|W,X,Y,Z", _numbers(3, 4), does="move",
    ),
    "scale": Kind("Scale the scene by this factor.", "F", _numbers(1), does="move"),
    "transform": Kind(
        "Transform the scene by a 4x4 matrix (JSON rows, or the 12 numbers of its first three) "
        "that scales all axes equally.",
        "FILE|NUMBERS", _matrix, does="move",
    ),
    "edits": Kind(
        "Apply the edits of a project that gs-viewer saved; IN must be its scenes, in its order.",
        "FILE", _project, does="move", local=False,
    ),
    "sh-degree": Kind("Remove SH above this degree, 0-3.", "D", _whole(0, 3), "change"),
    "gaussians": Kind(
        "Reduce to this number: drop the least visible, merge neighbours; with --cameras, measure "
        "visibility in views and refit colours.",
        "N", _whole(1, 1 << 40), local=False, guided=True,
    ),
    "keep": Kind(
        "Reduce to this percentage: drop the least visible, merge neighbours.",
        "PERCENT", _share, local=False, guided=True,
    ),
    "sort": Kind("Sort the Gaussians along a Morton curve.", "morton", _order, "change"),
}  # fmt: skip


@dataclass(frozen=True)
class Action:
    """An edit of a scene, as typed for ``gs-codec convert``.

    Parameters
    ----------
    name : str
        The option without dashes: ``crop-box``.
    text : str
        Its value: ``0,0,0,1,1,1``; empty if it has none.

    Raises
    ------
    InvalidInput
        If there is no such action, or the value is invalid for it.

    Examples
    --------
    >>> turned = gs_codec.edit.Action("rotate", "90,0,0")
    >>> report = gs_codec.convert_file("scene.ply", "turned.ply", actions=[turned])
    """

    name: str
    text: str = ""
    arguments: tuple[Any, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields(self)
        Option("", values=tuple(KINDS)).check("action", self.name)
        try:
            object.__setattr__(self, "arguments", KINDS[self.name].read(self.text))
        except InvalidInput as error:
            raise InvalidInput(f"{self.typed}: {error}") from error

    def __str__(self) -> str:
        return f"{self.name} {self.text}".rstrip()

    @property
    def typed(self) -> str:
        """The action as Python code: ``Action("rotate", "90,0,0")``."""
        return f'Action("{self.name}", "{self.text}")' if self.text else f'Action("{self.name}")'
