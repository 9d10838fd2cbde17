"""A self-contained HTML page; its tables are from `Table.html`."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

_STYLE = """
body { font: 15px/1.45 system-ui, "DejaVu Sans", Arial, sans-serif; color: #111; background: #fff;
       max-width: 62rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem;
     border-bottom: 1px solid #999; }
table { border-collapse: collapse; margin: .8rem 0; font-size: .87rem; }
th, td { padding: .18rem .45rem; text-align: right; border-bottom: 1px solid #ddd; }
th { border-bottom: 1px solid #555; vertical-align: bottom; }
.left { text-align: left; }
caption { caption-side: top; text-align: left; font-weight: 600; padding: .2rem 0;
          white-space: nowrap; }
.wide { overflow-x: auto; }
tbody tr:nth-child(even) { background: #f7f8f9; }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; }
figcaption { font-size: .87rem; color: #333; }
@media print { body { font-size: 10pt; margin: 0; max-width: none; padding: 0; }
  h2 { break-after: avoid; }
  figure, table, tr { break-inside: avoid; } table { font-size: 8.5pt; }
  .wide { overflow: visible; } }
@page { margin: 14mm; }
"""


def page(title: str, parts: Sequence[str]) -> str:
    """An HTML document with a title; `parts` are already HTML."""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style></head>\n"
        f"<body>\n<h1>{escape(title)}</h1>\n" + "\n".join(parts) + "\n</body></html>\n"
    )


def heading(text: str) -> str:
    """The title of a section."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str) -> str:
    """A paragraph of text."""
    return f"<p>{escape(text)}</p>"


def listing(lines: Sequence[str]) -> str:
    """A bulleted list."""
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def picture(png: bytes, caption: str) -> str:
    """An embedded PNG; the caption is also its alternative text."""
    data, text = base64.b64encode(png).decode("ascii"), escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{data}">\n'
        f"<figcaption>{text}</figcaption></figure>"
    )
