"""Charts below the panes: quality per view, thumbnails of views, attribute histograms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gs_codec.runtime.wording import counted
from viewer.pictures.picture import BACKGROUND, from_pillow, to_pillow
from viewer.pictures.ticks import axis_ticks, texts_of

if TYPE_CHECKING:
    from gs_codec.edit import AttributeStatistics

#: Height of text, pixels.
_TEXT = 13

#: Margins around a chart: left, top, right, bottom; pixels.
_MARGINS = (64, 26, 16, 22)

#: Colours of scenes A and B, which colour-blind people can distinguish.
SCENES = ((86, 180, 233), (230, 159, 0))

#: Colour of text.
WHITE = (235, 235, 235)

#: Colour of lines.
GREY = (120, 120, 125)

#: Colour of a selected range.
_RANGE = (75, 75, 60)

#: Maximum number of values below a histogram.
_TICKS = 8

#: Maximum number of values to the left of bars.
_LINES = 4

#: Height of the view names below thumbnails, pixels.
_LINE = 22


class Chart(Protocol):
    """A picture that can be drawn at any size."""

    def draw(self, width: int, height: int) -> NDArray[np.float32]:
        """The picture ``(height, width, 3)``, 0-1; width and height in pixels."""


@dataclass(frozen=True)
class Message:
    """A line of text in place of a chart."""

    text: str

    def draw(self, width: int, height: int) -> NDArray[np.float32]:
        """See `Chart`."""
        canvas, pen = blank(width, height)
        pen.text((_MARGINS[0], height // 2), self.text, WHITE, font(), "lm")
        return from_pillow(canvas)


@dataclass(frozen=True)
class QualityChart:
    """Bar chart of the PSNR of views, worst first.

    Attributes
    ----------
    names : sequence of str
        Names of all views.
    decibels : mapping of int to float
        PSNR of measured views by index; infinite if the renders are equal, NaN if they are too
        small.
    here : int or None
        Index of the view shown.
    """

    names: Sequence[str]
    decibels: Mapping[int, float]
    here: int | None = None

    @property
    def order(self) -> list[int]:
        """Measured views, worst first, without those that are too small."""
        known = [index for index, value in self.decibels.items() if not np.isnan(value)]
        return sorted(known, key=lambda index: (self.decibels[index], index))

    def draw(self, width: int, height: int) -> NDArray[np.float32]:
        """See `Chart`."""
        canvas, pen = blank(width, height)
        left, top, right, bottom = box(width, height)
        finite = np.array([value for value in self.decibels.values() if np.isfinite(value)])
        low, high = (np.floor(finite.min()), np.ceil(finite.max() + 0.5)) if len(finite) else (0, 1)
        low = min(low, high - 2)

        def row(value: float) -> int:
            return round(bottom - (min(value, high) - low) / (high - low) * (bottom - top))

        _rule(pen, row, axis_ticks(low, high, _LINES), left, right)
        step = (right - left) / max(len(self.order), 1)
        for place, index in enumerate(self.order):
            first = round(left + place * step)
            last = max(round(left + (place + 0.85) * step) - 1, first)
            colour = WHITE if index == self.here else SCENES[1]
            pen.rectangle((first, row(self.decibels[index]) - 1, last, bottom), fill=colour)
        pen.text((left, 5), self._caption(), WHITE, font())
        if len(finite):
            mean = row(float(finite.mean()))
            pen.line((left, mean, right, mean), SCENES[0], 2)
        return from_pillow(canvas)

    def _caption(self) -> str:
        """Text of the chart."""
        done, count = len(self.decibels), len(self.names)
        if not done:
            return f"PSNR of {counted(count, 'view')}, B against A: measuring ..."
        if not self.order:
            return f"PSNR of {counted(count, 'view')}, B against A: their frames are too small."
        worst = self.order[0]
        finite = [value for value in self.decibels.values() if np.isfinite(value)]
        said = f"worst {decibels(self.decibels[worst])} ({self.names[worst]})"
        said += f", mean {decibels(float(np.mean(finite)))} (line)" if finite else ""
        same = sum(np.isinf(value) for value in self.decibels.values())
        said += f", {same} the same" if same and finite else ""
        measured = "" if done == count else f" {done} of"
        views = f"{measured} {counted(count, 'view')}"
        return f"PSNR of{views}, B against A: {said}. Click a bar to show its view."

    def view_at(self, x: float, width: int) -> int | None:
        """The view whose bar covers a column."""
        left, _, right, _ = box(width, 1)
        place = int((x - left) / (right - left) * len(self.order) // 1)
        return self.order[place] if left <= x < right and self.order else None


@dataclass(frozen=True)
class ContactSheet:
    """Thumbnails of views, side by side.

    Attributes
    ----------
    names : sequence of str
        Names of the views, in display order.
    pictures : mapping of int to ndarray, shape (h, w, 3), float32, 0-1
        Finished thumbnails, by position of the view.
    here : int or None
        Position of the view shown.
    first : float
        Position of the view at the left edge; changed by scrolling.
    """

    names: Sequence[str]
    pictures: Mapping[int, NDArray[np.float32]]
    here: int | None = None
    first: float = 0.0

    def draw(self, width: int, height: int) -> NDArray[np.float32]:
        """See `Chart`."""
        canvas, pen = blank(width, height)
        wide, high = self.cell(height)
        for place in range(
            int(self.first), min(int(self.first + width / wide) + 1, len(self.names))
        ):
            left = round((place - self.first) * wide)
            image = self.pictures.get(place)
            if image is not None:
                small = to_pillow(image)
                small.thumbnail((wide - 4, high - 4))
                canvas.paste(small, (left + (wide - small.width) // 2, (high - small.height) // 2))
            name = _fitted(self.names[place], wide - 6)
            pen.text((left + wide // 2, high + 1), name, WHITE, font(), "ma")
            if place == self.here:
                pen.rectangle(
                    (left + 1, 1, left + wide - 2, height - 2), outline=SCENES[1], width=2
                )
        return from_pillow(canvas)

    @staticmethod
    def cell(height: int) -> tuple[int, int]:
        """Width and height of a view's cell, without its name, pixels."""
        high = max(height - _LINE, 8)
        return max(high * 3 // 2, 12), high

    def view_at(self, x: float, height: int) -> int | None:
        """Position of the view at a column."""
        place = int(self.first + x / self.cell(height)[0])
        return place if 0 <= place < len(self.names) else None

    def scrolled(self, steps: float, width: int, height: int) -> float:
        """`first` after scrolling by a number of steps."""
        last = len(self.names) - width / self.cell(height)[0]
        return float(np.clip(self.first + steps, 0, max(last, 0)))


@dataclass(frozen=True)
class HistogramChart:
    """Histograms of one attribute in one or two scenes, on a common scale.

    Attributes
    ----------
    scenes : sequence of AttributeStatistics
        Statistics from `gs_codec.edit` of one or two scenes.
    chosen : tuple of two float, or None
        The marked range of values.
    """

    scenes: Sequence[AttributeStatistics]
    chosen: tuple[float, float] | None = None

    @property
    def _log(self) -> bool:
        return self.scenes[0].name.endswith(" scale")

    @property
    def selects(self) -> bool:
        """Whether each Gaussian has a single value, so that a range can select Gaussians."""
        return not self.scenes[0].name.startswith("SH band")

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest value on the axis; logarithms for scales."""
        ends = [self._on_axis(np.array([s.edges[0], s.edges[-1]])) for s in self.scenes if s.edges]
        if not ends:
            return 0.0, 1.0
        low, high = min(e[0] for e in ends), max(e[1] for e in ends)
        return float(low), float(high if high > low else low + 1)

    def _on_axis(self, values: NDArray) -> NDArray[np.float64]:
        values = np.asarray(values, np.float64)
        return np.log10(np.maximum(values, np.finfo(float).tiny)) if self._log else values

    def draw(self, width: int, height: int) -> NDArray[np.float32]:
        """See `Chart`."""
        canvas, pen = blank(width, height)
        left, top, right, bottom = box(width, height)
        if self.chosen is not None:
            columns = [self._column(value, width) for value in self.chosen]
            pen.rectangle((columns[0], top, columns[1], bottom), fill=_RANGE)
        most = max((max(s.counts, default=0) for s in self.scenes), default=0) or 1
        for number, scene in enumerate(self.scenes):
            thick = 2 if number else 5  # keeps both visible if they coincide
            self._outline(pen, scene, (SCENES[number], thick), most, width, height)
        for value, text in self._ticks(right - left):
            column = round(
                left + (value - self.span[0]) / (self.span[1] - self.span[0]) * (right - left)
            )
            pen.line((column, bottom, column, bottom + 3), GREY)
            pen.text((column, bottom + 4), text, WHITE, font(), "ma")
        pen.text((left - 6, top), f"{most:,}", WHITE, font(), "ra")
        first = self.scenes[0]
        caption = f"{first.name}, {first.unit}"
        caption += ": A blue, B orange" if len(self.scenes) > 1 else ""
        if self.chosen is not None:
            step = np.inf if self._log else (self.span[1] - self.span[0]) / 10
            caption += f"; {' to '.join(texts_of(self.chosen, step))}"
        hint = " Drag to select a range." if self.selects else ""
        pen.text((left, 5), f"{caption}.{hint}", WHITE, font())
        return from_pillow(canvas)

    def _ticks(self, width: int) -> list[tuple[float, str]]:
        """Values on the axis, with texts that have room beside each other."""
        for most in range(_TICKS, 1, -1):
            values = axis_ticks(*self.span, most, self._log)
            shown = 10.0**values if self._log else values
            texts = texts_of(shown.tolist(), float(np.diff(shown).min(initial=np.inf)))
            if sum(font().getlength(f"{text}  ") for text in texts) <= width:
                break
        return list(zip(values.tolist(), texts, strict=True))

    def _outline(
        self,
        pen: ImageDraw.ImageDraw,
        scene: AttributeStatistics,
        pencil: tuple[tuple[int, int, int], int],
        most: int,
        width: int,
        height: int,
    ) -> None:
        """Draw the histogram outline of one scene, in a colour and width."""
        colour, thick = pencil
        _, top, _, bottom = box(width, height)
        points: list[tuple[int, int]] = []
        for k, count in enumerate(scene.counts):
            row = round(bottom - count / most * (bottom - top))
            points += [(self._column(edge, width), row) for edge in scene.edges[k : k + 2]]
        if points:
            pen.line([(points[0][0], bottom), *points, (points[-1][0], bottom)], colour, thick)

    def _column(self, value: float, width: int) -> int:
        left, _, right, _ = box(width, 1)
        low, high = self.span
        share = (float(self._on_axis(np.array(value))) - low) / (high - low)
        return round(left + min(max(share, 0.0), 1.0) * (right - left))

    def value_at(self, x: float, width: int) -> float:
        """The value at a column; clamped to the axis."""
        left, _, right, _ = box(width, 1)
        share = min(max((x - left) / (right - left), 0.0), 1.0)
        low, high = self.span
        value = low + share * (high - low)
        return float(10.0**value if self._log else value)

    def between(self, first: float, last: float, width: int) -> tuple[float, float]:
        """The range of values between two columns; without an end where it leaves the axis.

        The axis ends at percentiles, beyond which there are values.
        """
        left, _, right, _ = box(width, 1)
        low, high = sorted((first, last))
        return (
            self.value_at(low, width) if low > left else -np.inf,
            self.value_at(high, width) if high < right else np.inf,
        )


def decibels(value: float) -> str:
    """A PSNR as text."""
    if np.isnan(value):
        return "too small"
    return f"{value:.2f} dB" if np.isfinite(value) else "the same"


def blank(width: int, height: int) -> tuple[Image.Image, ImageDraw.ImageDraw]:
    """An empty chart, and a pen."""
    colour = tuple(round(255 * c) for c in BACKGROUND)
    canvas = Image.new("RGB", (width, height), colour)
    pen = ImageDraw.Draw(canvas)
    pen.line((0, 0, width, 0), GREY)
    return canvas, pen


def box(width: int, height: int) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a chart inside its margins."""
    left, top, right, bottom = _MARGINS
    return left, top, max(width - right, left + 1), max(height - bottom, top + 1)


def _rule(
    pen: ImageDraw.ImageDraw, row: Callable[[float], int], values: NDArray, left: int, right: int
) -> None:
    """Draw horizontal lines at values of an axis, with labels at their left."""
    for value in values:
        pen.line((left, row(value), right, row(value)), GREY)
        pen.text((left - 6, row(value)), f"{value:g}", WHITE, font(), "rm")


def _fitted(text: str, width: int) -> str:
    """The end of a text, cut to fit a width in pixels."""
    while text and font().getlength(text) > width:
        text = text[1:]
    return text


def font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font of charts."""
    return ImageFont.load_default(_TEXT)
