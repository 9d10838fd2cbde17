"""What the suite is asked to measure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gs_codec.config import check_threads
from gs_codec.errors import InvalidInput

#: What can be left out: other codecs, all that goes by views, pruned scenes, rate-distortion
#: curves, entropy coders, coders of points, growing scenes, parts of profiles, the ablation.
GROUPS = (
    "peers", "views", "pruned", "curves", "coders", "points", "scaling", "parts", "ablation",
)  # fmt: skip


@dataclass(frozen=True)
class Options:
    """Scenes, and how they are measured.

    Parameters
    ----------
    scenes : tuple of Path
        PLY files; cameras are ``cameras.json`` beside one, else chosen for it, and photographs of
        these are in the folder ``images`` there, if it exists.
    repeats : int
        Timed runs, 1 and up.
    threads : int, optional
        Of encoding and decoding; all processors if None.
    width : int, optional
        Of the views, pixels; those compared with photographs have these' width.
    seed : int
        Of the jitter in tiled scenes.
    skip : frozenset of str
        `GROUPS` to leave out.

    Raises
    ------
    InvalidInput
        If there are no scenes, a group is none, or a number is out of range.
    """

    scenes: tuple[Path, ...]
    repeats: int = 3
    threads: int | None = None
    width: int | None = None
    seed: int = 0
    skip: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if not self.scenes:
            raise InvalidInput(
                "no scenes given, expected .ply files, each beside its cameras.json; "
                "`make suite` makes two and measures them"
            )
        check_threads(self.threads)
        for group in sorted(self.skip - set(GROUPS)):
            raise InvalidInput(f"--skip {group}: expected one of {', '.join(GROUPS)}")

    def wants(self, *groups: str) -> bool:
        """Whether none of these is left out."""
        return self.skip.isdisjoint(groups)
