"""Tables as text, Markdown and HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from gs_codec.errors import printable


class Table(NamedTuple):
    """Rows of cells; an empty cell is an unknown value.

    Attributes
    ----------
    columns : sequence of str
        Titles.
    rows : sequence of sequence of str
        One cell for each column.
    left : tuple of int
        Left-aligned columns, negative ones counted from the end; others are right-aligned.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    left: tuple[int, ...] = (0,)

    def _to_the_left(self) -> list[bool]:
        return [
            i in self.left or i - len(self.columns) in self.left for i in range(len(self.columns))
        ]

    def text(self) -> str:
        """Aligned columns for a terminal."""
        rows = [self.columns, *([printable(cell) for cell in row] for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        signs = ["<" if left else ">" for left in self._to_the_left()]
        forms = list(zip(signs, widths, strict=True))
        lines = ("  ".join(map("{0:{1[0]}{1[1]}}".format, row, forms)) for row in rows)
        return "\n".join(line.rstrip() for line in lines)

    def markdown(self) -> str:
        """Markdown; cells already have markup; empty without rows."""
        line = ["---" if left else "---:" for left in self._to_the_left()]
        lines = [self.columns, line, *self.rows] if self.rows else []
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def html(self, caption: str) -> str:
        """HTML for `page`, with a dash in empty cells."""
        kinds = [' class="left"' if left else "" for left in self._to_the_left()]

        def row(tag: str, cells: Sequence[str]) -> str:
            each = zip(kinds, cells, strict=True)
            return "".join(f"<{tag}{kind}>{escape(cell) or '-'}</{tag}>" for kind, cell in each)

        body = "".join(f"<tr>{row('td', cells)}</tr>\n" for cells in self.rows)
        head = f"<caption>{escape(caption)}</caption>\n<thead><tr>{row('th', self.columns)}</tr>"
        return f'<div class="wide"><table>{head}</thead>\n<tbody>{body}</tbody></table></div>'


def escaped(text: str) -> str:
    """Escape foreign text for a Markdown cell."""
    plain = " ".join(text.split()).replace("&", "&amp;").replace("<", "&lt;")
    return "".join(f"\\{letter}" if letter in "\\|`*_[]" else letter for letter in plain)


def number(value: float | None, form: str = ".3f") -> str:
    """Format a number for a cell, such as ``+.2f``; empty for None."""
    return "" if value is None else format(value, form)
