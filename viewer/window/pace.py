"""When to draw pictures, and how fine: drafts during motion, full pictures at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Time without motion after which the scene is at rest, unless reported earlier, seconds.
REST = 0.25

#: Target time for a draft, seconds.
_BUDGET = 0.1

#: Drafts become coarser after this many in a row over the target time.
_SLOW = 2

#: Drafts become finer after this many in a row under a third of the target time.
_QUICK = 3

#: If a full picture takes less time than this, it is drawn without a draft first, seconds.
_AT_ONCE = 0.4

#: Draft levels: divisor of the picture's sides, and one Gaussian in how many; each halves the work
#: of the previous one, roughly.
_STEPS = ((1, 1), (2, 1), (2, 2), (2, 4), (2, 8), (3, 8), (3, 16), (4, 16), (6, 32))

#: Minimum number of Gaussians in a draft; with fewer, the pixels dominate the time.
_FEWEST = 50_000

#: Maximum number of Gaussians in the first draft.
_FIRST = 300_000


@dataclass(frozen=True)
class Step:
    """Fineness of a picture.

    Attributes
    ----------
    shrink : int
        Divisor of the picture's sides.
    every : int
        One in this many Gaussians is drawn.
    full : bool
        Whether it is the full picture, not a draft.
    """

    shrink: int
    every: int
    full: bool = False


FULL = Step(1, 1, full=True)


class Pace:
    """Decides what to draw next. Times are in seconds, from any monotonic clock.

    One picture is drawn at a time. A draft is always finished; otherwise a long move would show
    none. The next picture uses the pose at that time.
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
        """Start with scenes of `count` Gaussians in total."""
        most = max(count // _FEWEST, 1)
        steps = [Step(shrink, min(every, most)) for shrink, every in _STEPS]
        self._steps = list(dict.fromkeys(steps))
        few = [k for k, step in enumerate(self._steps) if k and count <= _FIRST * step.every]
        self._at = few[0] if few else len(self._steps) - 1
        self._slow = self._quick = 0
        self._full_seconds, self._drawing = math.inf, None

    def move(self, now: float) -> None:
        """Record motion: the pictures are out of date, and more motion may follow."""
        self._moved_at, self._drafted, self._filled = now, False, False

    def rest(self) -> None:
        """Record that the motion has ended."""
        self._moved_at = None

    @property
    def resting(self) -> bool:
        """Whether the full picture is done, or there is nothing to draw."""
        return self._filled and self._drawing is None

    @property
    def drafted(self) -> bool:
        """Whether a picture of the last motion is done."""
        return self._drafted and (self._drawing is None or self._drawing.full)

    def next(self, now: float) -> Step | None:
        """The step to start drawing now; None if there is none."""
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
        """Record that a picture is done, and the time it took."""
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
        """Record that the picture in progress is abandoned."""
        self._drawing = None
