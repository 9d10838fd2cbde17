"""When pictures are drawn, and how fine: drafts while something moves, in full when it rests."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Seconds without a move after which it rests, if nobody says so before.
REST = 0.25

#: Maximum time of a draft, seconds.
_BUDGET = 0.1

#: Drafts become coarser after this many slower ones in a row.
_SLOW = 2

#: Drafts become finer after this many in a row that take less than a third of it.
_QUICK = 3

#: A full picture that takes less is drawn without a draft before it, seconds.
_AT_ONCE = 0.4

#: Sizes of drafts and the Gaussians they are of, each step about half the work of the one before.
_STEPS = ((1, 1), (2, 1), (2, 2), (2, 4), (2, 8), (3, 8), (3, 16), (4, 16), (6, 32))

#: Minimum number of Gaussians in a draft: with fewer, the pixels take the time.
_FEWEST = 50_000

#: Maximum number of Gaussians in the first draft.
_FIRST = 300_000


@dataclass(frozen=True)
class Step:
    """How fine a picture is.

    Attributes
    ----------
    shrink : int
        Its sides are divided by this.
    every : int
        It is of one Gaussian in so many.
    full : bool
        Whether it is the picture that stays.
    """

    shrink: int
    every: int
    full: bool = False


FULL = Step(1, 1, full=True)


class Pace:
    """Decides what is drawn next. Times are in seconds, of any clock that does not go back.

    It draws one picture after another: a draft is always finished, since otherwise none would be
    seen during a long move, and the next one is of the pose at that time.
    """

    def __init__(self) -> None:
        self._steps = [FULL]
        self._at = 0
        self._slow = self._quick = 0
        self._full_seconds = math.inf
        self._moved_at: float | None = None
        self._drafted = self._filled = True
        self._drawing: Step | None = None

    def put(self, count: int) -> None:
        """Draw scenes of so many Gaussians from now on."""
        most = max(count // _FEWEST, 1)
        steps = [Step(shrink, min(every, most)) for shrink, every in _STEPS]
        self._steps = list(dict.fromkeys(steps))
        few = [k for k, step in enumerate(self._steps) if k and count <= _FIRST * step.every]
        self._at = few[0] if few else len(self._steps) - 1
        self._slow = self._quick = 0
        self._full_seconds, self._drawing = math.inf, None

    def move(self, now: float) -> None:
        """Something moves: the pictures are out of date, and more moves may follow."""
        self._moved_at, self._drafted, self._filled = now, False, False

    def rest(self) -> None:
        """Nothing moves any more."""
        self._moved_at = None

    @property
    def resting(self) -> bool:
        """Whether the full picture is drawn, or nothing is to be drawn."""
        return self._filled and self._drawing is None

    def next(self, now: float) -> Step | None:
        """What to begin to draw now; None if nothing is."""
        if self._drawing is not None and (not self._drawing.full or self._filled):
            return None
        if self._filled:
            return None
        rested = self._moved_at is None or now - self._moved_at > REST
        if not self._drafted and not (rested and self._full_seconds < _AT_ONCE):
            self._drawing, self._drafted = self._steps[self._at], True
        elif rested:
            self._drawing, self._drafted, self._filled = FULL, True, True
        else:
            return None
        return self._drawing

    def done(self, step: Step, seconds: float) -> None:
        """A picture took so long."""
        self._drawing = None
        if step.full:
            self._full_seconds = seconds
            return
        self._slow = self._slow + 1 if seconds > _BUDGET else 0
        self._quick = self._quick + 1 if seconds < _BUDGET / 3 else 0
        change = (self._slow >= _SLOW) - (self._quick >= _QUICK)
        if change:
            self._at = min(max(self._at + change, 0), len(self._steps) - 1)
            self._slow = self._quick = 0

    def drop(self) -> None:
        """The picture that was begun is not drawn, or not shown."""
        self._drawing = None
