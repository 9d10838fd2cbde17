"""How codecs look: the same colour and mark in every plot, and short names."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from typing import Any

from gs_codec.bench.suite.results import CURVES, Results
from gs_codec.config import LATTICE_PROFILES, LOSSLESS

#: Colours that stay apart for the colour-blind and in print, by kind of codec.
PAPER, ATTRIBUTES, VIEWS, EXACT = "#5b5b5b", "#0a6ebd", "#d1580b", "#12858a"
_PEER_COLOURS = ("#a3468f", "#8a6d00", "#b3203a", "#5a4fb0", "#7a4a2b", "#3d7a1f", "#c0619b")
#: One mark more than colours, so that a pair comes again only after all others.
_PEER_MARKS = ("P", "X", "v", "D", "<", ">", "h", "p")

#: What every figure has in common.
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.parse_math": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#777777",
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#e2e2e2",
    "grid.linewidth": 0.7,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.frameon": False,
}


@dataclass(frozen=True)
class Look:
    """Kind of a codec, what it is called in plots, its colour and mark, filled or hollow."""

    kind: str
    name: str
    colour: str
    mark: str
    filled: bool = True

    @property
    def face(self) -> str:
        """Colour inside the mark."""
        return self.colour if self.filled else "white"


#: Curves, as their profiles look.
CURVE_LOOKS = {
    "paper": Look("paper", "paper", PAPER, "^"),
    CURVES[0]: Look(CURVES[0], CURVES[0], ATTRIBUTES, "o"),
    CURVES[1]: Look(CURVES[1], CURVES[1], VIEWS, "s"),
}


def looks_of(results: Results) -> dict[str, Look]:
    """The look of each codec by its name; of peers in the order they come in."""
    codecs = [line["codec"] for line in results.of("beside") + results.of("pruned")]
    names = dict.fromkeys([*codecs, *(line["codec"] for line in results.of("equal"))])
    looks = {name: _own(name) for name in names}
    peers = [name for name, look in looks.items() if look is None]
    colours, marks = cycle(_PEER_COLOURS), cycle(_PEER_MARKS)
    others = {name: Look("peer", plain(name), next(colours), next(marks)) for name in peers}
    return {name: look or others[name] for name, look in looks.items()}


def _own(name: str) -> Look | None:
    """The look of one of our profiles, by attributes, by views or pruned; None of a peer."""
    if name.startswith("paper-"):
        return Look("paper", name, PAPER, "^")
    if name in LATTICE_PROFILES:
        return Look("by attributes", name, ATTRIBUTES, "o")
    if name == LOSSLESS:
        return Look("lossless", name, EXACT, "*")
    profile = name.partition(",")[0]
    if profile in LATTICE_PROFILES and name.endswith("by views"):
        return Look("by views", name, VIEWS, "s")
    if profile in LATTICE_PROFILES and name.endswith("pruned"):
        return Look("pruned", name, VIEWS, "s", filled=False)
    return None


def point_name(name: str) -> str:
    """The name of a point of a curve, short: ``paper-l + 1 bits`` is ``l + 1``."""
    short = name.removeprefix("paper-").removesuffix(" bits")
    return short.replace(", steps x ", " x ").replace(", steps / ", " / ")


def plain(text: str, longest: int = 44) -> str:
    """Text from elsewhere as a plot can show it: one line, no letters its font lacks."""
    known = _known_letters()
    shown = "".join(
        letter if ord(letter) in known and unicodedata.category(letter)[0] != "C" else "?"
        for letter in " ".join(text.split())
    )
    return shown if len(shown) <= longest else shown[: longest - 1] + "…"


@cache
def _known_letters() -> frozenset[int]:
    from matplotlib.font_manager import findfont
    from matplotlib.ft2font import FT2Font

    return frozenset(FT2Font(findfont("DejaVu Sans")).get_charmap())


def in_order(names: Iterable[str], looks: dict[str, Look]) -> list[str]:
    """Names by kind: ours first, then the paper's, then peers."""
    kinds = ("by attributes", "by views", "pruned", "lossless", "paper", "peer")
    return sorted(names, key=lambda name: kinds.index(looks[name].kind))
