"""The report of the suite: a page, its plots, and the table of the README."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.analysis.figure import new_figure
from gs_codec.analysis.page import contents, heading, page, paragraph, picture
from gs_codec.bench.suite.headline import headline
from gs_codec.bench.suite.looks import STYLE, Look, looks_of
from gs_codec.bench.suite.results import Results
from gs_codec.bench.suite.sections import SECTIONS
from gs_codec.io.atomic import write_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Pixels an inch of plots: sharp on paper, too.
_DPI = 150

_INTRODUCTION = (
    "Codecs beside each other on the same scenes, in one process, taking turns. Ratios alone say "
    "little, as codecs lose different things: sizes are compared at equal quality of rendered "
    "views that no codec has seen. PSNR is that against the scene's own views before coding; "
    "delta-PSNR is what is lost against photographs. Times are those of this machine."
)


@dataclass
class Drawing:
    """What sections are made of, and the pictures they have made.

    Attributes
    ----------
    results : Results
    looks : dict of str to Look
        Of codecs, by name.
    pictures : dict of str to bytes
        PNG files by name.
    """

    results: Results
    looks: dict[str, Look]
    pictures: dict[str, bytes] = field(default_factory=dict)

    def draw(self, name: str, figure: Figure, caption: str, instead: str) -> str:
        """Keep a figure under this name, and give what shows it in the page."""
        buffer = BytesIO()
        figure.savefig(buffer, format="png", dpi=_DPI)
        plain = re.sub(r"[^A-Za-z0-9]+", "-", name)[:60].strip("-")
        number, unique = 1, f"{plain}.png"
        while unique in self.pictures:
            number += 1
            unique = f"{plain}-{number}.png"
        self.pictures[unique] = buffer.getvalue()
        return picture(buffer.getvalue(), caption, instead)


def write_report(lines: Sequence[dict[str, Any]], folder: Path) -> None:
    """Write ``report.html``, its plots as PNG files, and ``headline.md`` into a folder.

    `lines` are result lines of the suite, all or some: what there are none of is left out.

    Raises
    ------
    MissingTool
        If matplotlib is not installed.
    InvalidInput
        If a file cannot be written.
    """
    new_figure(1, 1)  # without matplotlib nothing is begun
    text, pictures = _draw_page(Results(lines))
    files = pictures | {
        "headline.md": ("\n".join(headline(lines)) + "\n").encode(),
        "report.html": text.encode(),
    }
    write_files(folder, files)


def _draw_page(results: Results) -> tuple[str, dict[str, bytes]]:
    """The page, and PNG files by name."""
    from matplotlib import rc_context

    drawing = Drawing(results, looks_of(results))
    with rc_context(STYLE):
        made = {title: list(section(drawing)) for title, section in SECTIONS.items()}
    found = {title: parts for title, parts in made.items() if parts}
    missing = [title for title, parts in made.items() if not parts]
    body = [paragraph(_INTRODUCTION), contents(list(found))]
    for title, parts in found.items():
        body += [heading(title), *parts]
    if missing:
        body.append(paragraph(f"Without results: {', '.join(missing)}."))
    return page("Benchmarks of gs_codec", body), drawing.pictures
