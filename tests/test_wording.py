"""Numbers in messages agree with their nouns, in all modules."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gs_codec.runtime.wording import as_typed, counted, size_text

ROOT = Path(__file__).parents[1]

#: Nouns counted in messages.
NOUNS = (
    "Gaussians|views|cameras|images|frames|scenes|files|blocks|levels|sections|bytes|bits|"
    "values|entries|elements|properties|iterations|encodings|poses|tables|streams"
)


@pytest.mark.parametrize(
    ("number", "noun", "expected"),
    [
        (0, "Gaussian", "0 Gaussians"),
        (1, "Gaussian", "1 Gaussian"),
        (2, "Gaussian", "2 Gaussians"),
        (1234567, "view", "1,234,567 views"),
        (np.int64(1), "property", "1 property"),
        (2, "property", "2 properties"),
        (2, "class", "2 classes"),
        (3, "coarser level", "3 coarser levels"),
    ],
)
def test_counted(number: int, noun: str, expected: str) -> None:
    assert counted(number, noun) == expected


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (0, "0 bytes"),
        (1, "1 byte"),
        (999, "999 bytes"),
        (1000, "1.00 kB"),
        (999_994, "999.99 kB"),
        (999_999, "1.00 MB"),
        (1_500_000, "1.50 MB"),
        (999_994_999, "999.99 MB"),
        (999_999_999, "1.00 GB"),
        (2.5e12, "2500.00 GB"),
    ],
)
def test_size_text(size: float, expected: str) -> None:
    assert size_text(size) == expected


def uncounted(path: Path) -> Iterator[str]:
    """Texts of a module that combine a number that could be 1 with a plural."""
    for text in ast.walk(ast.parse(path.read_text())):
        if isinstance(text, ast.Constant) and re.search(f"%d ({NOUNS})", str(text.value)):
            yield f"{path.name}:{text.lineno}: {text.value}"
        values = text.values if isinstance(text, ast.JoinedStr) else []
        for number, after in zip(values[:-1], values[1:], strict=True):
            if not isinstance(number, ast.FormattedValue) or not isinstance(after, ast.Constant):
                continue
            shown = ast.unparse(number.value)
            whole = number.format_spec is None or ast.unparse(number.format_spec) == "f','"
            if whole and re.match(f" ({NOUNS})\\b(?! per)", after.value) and not shown.isupper():
                yield f"{path.name}:{text.lineno}: {{{shown}}}{after.value}"


def test_numbers_agree_with_their_nouns() -> None:
    found = [
        line
        for package in ("gs_codec", "viewer")
        for path in sorted((ROOT / package).rglob("*.py"))
        for line in uncounted(path)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.egs: exists, expected overwrite=True", "a.egs: exists, expected --overwrite"),
        (
            '3 in opacity; nonfinite="drop" removes them',
            "3 in opacity; --nonfinite drop removes them",
        ),
        ('choose extra="keep" or extra="drop"', "choose --extra keep or --extra drop"),
        ('Action("filter", "x>2"): no', "--filter x>2: no"),
        ('first Action("translate", "-1,0,0")', "first --translate=-1,0,0"),
        ('Action("remove-nan") before', "--remove-nan before"),
        ('no_overwrite=True, size="drop"', 'no_overwrite=True, size="drop"'),
    ],
)
def test_commands_name_options_where_python_names_arguments(text: str, expected: str) -> None:
    assert as_typed(text) == expected


def options_in_messages(path: Path) -> Iterator[str]:
    """Errors and log messages of a module that mention a command's option."""
    for node in ast.walk(ast.parse(path.read_text())):
        is_log = isinstance(node, ast.Call) and ast.unparse(node.func).startswith("log.")
        if isinstance(node, ast.Raise) or is_log:
            for text in ast.walk(node):
                if isinstance(text, ast.Constant) and re.search(r"--[a-z]", str(text.value)):
                    yield f"{path.name}:{node.lineno}: {text.value}"


def test_the_library_names_no_options() -> None:
    of_commands = ("cli", "batch", "bench", "__main__.py")
    found = [
        line
        for path in sorted((ROOT / "gs_codec").rglob("*.py"))
        if path.relative_to(ROOT).parts[1] not in of_commands
        for line in options_in_messages(path)
    ]
    assert found == []
