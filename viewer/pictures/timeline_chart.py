"""A camera path as a timeline: keyframes at their times, and the time shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewer.pictures.charts import GREY, SCENES, WHITE, blank, box, font
from viewer.pictures.picture import from_pillow
from viewer.pictures.ticks import axis_ticks

#: Half the size of a keyframe, pixels.
_HALF = 8

#: Maximum number of values below the line.
_TICKS = 10

#: Seconds of an empty timeline, and the room left after the last keyframe, relative to the time.
_EMPTY, _ROOM = 5.0, 1.15

_HINT = "Drag keyframes to change their times, click to look from the path."


@dataclass(frozen=True)
class TimelineChart:
    """Keyframes by their `times`, the time shown (`now`), and a `span` of seconds, edge to edge."""

    times: Sequence[float]
    fps: int
    now: float
    chosen: int | None
    span: float

    def draw(self, width: int, height: int) -> NDArray[np.float32]:
        """See `Chart`."""
        canvas, pen = blank(width, height)
        left, top, right, bottom = box(width, height)
        middle = (top + bottom) // 2
        pen.line((left, middle, right, middle), GREY, 2)
        for value in axis_ticks(0, self.span, _TICKS):
            column = self.column(value, width)
            pen.line((column, bottom, column, bottom + 3), GREY)
            pen.text((column, bottom + 4), f"{value:g} s", WHITE, font(), "ma")
        for k, time in enumerate(self.times):
            x, colour = self.column(time, width), SCENES[1] if k == self.chosen else WHITE
            corners = [(x, middle - _HALF), (x + _HALF, middle), (x, middle + _HALF)]
            pen.polygon([*corners, (x - _HALF, middle)], fill=colour, outline=(0, 0, 0))
            pen.text((x, middle - _HALF - 2), str(k + 1), colour, font(), "md")
        now = self.column(self.now, width)
        pen.line((now, top, now, bottom), SCENES[0], 2)
        seconds = self.times[-1] if self.times else 0.0
        said = f"camera path, {seconds:.4g} s at {self.fps} fps; at {self.now:.2f} s. "
        pen.text((left, 5), said + _HINT, WHITE, font())
        return from_pillow(canvas)

    def column(self, time: float, width: int) -> int:
        """The column of a time."""
        left, _, right, _ = box(width, 1)
        return round(left + time / self.span * (right - left))

    def time_at(self, x: float, width: int) -> float:
        """The time at a column, at least 0."""
        left, _, right, _ = box(width, 1)
        return min(max((x - left) / (right - left), 0.0), 1.0) * self.span

    def key_at(self, x: float, width: int) -> int | None:
        """The keyframe nearest to a column, if it is near."""
        away = [abs(self.column(time, width) - x) for time in self.times]
        nearest = int(np.argmin(away)) if away else None
        return nearest if nearest is not None and away[nearest] <= _HALF else None


def span_of(times: Sequence[float]) -> float:
    """Seconds that a timeline of these times covers."""
    return _ROOM * times[-1] if len(times) > 1 else _EMPTY
