"""A picture of notes on what is shown: what it is, its legend, a photograph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFont

from viewer.pictures.layers import Legend
from viewer.pictures.picture import (
    BACKGROUND,
    TEXT,
    labelled,
    reasons_text,
    to_pillow,
    write_reasons,
)
from viewer.scenes.opened import Pruned

#: Least width, pixels; heights of the caption, of a reason, and of a legend.
_WIDTH, _CAPTION, _REASON, _LEGEND = 400, 30, 18, 56


def draw_notes(
    caption: str,
    legends: Sequence[Legend] = (),
    pruned: Pruned | None = None,
    photograph: NDArray[np.float32] | None = None,
) -> Image.Image:
    """Notes as wide as their caption needs.

    Parameters
    ----------
    caption : str
        A line.
    legends : sequence of Legend
    pruned : Pruned, optional
        Its reasons are listed.
    photograph : ndarray, shape (H, W, 3), float32, 0-1, optional
    """
    reasons = len(reasons_text(pruned)) if pruned is not None else 0
    high = _CAPTION + _REASON * reasons + _LEGEND * len(legends)
    wide = max(_WIDTH, 16 + round(ImageFont.load_default(TEXT).getlength(caption)))
    canvas = np.empty((high, wide, 3), np.float32)
    canvas[:] = BACKGROUND
    notes = labelled(canvas, [(0, caption)], legends)
    if pruned is not None:
        write_reasons(notes, pruned)
    if photograph is None:
        return notes
    size = wide, max(1, round(wide * photograph.shape[0] / photograph.shape[1]))
    whole = Image.new("RGB", (wide, high + size[1]))
    whole.paste(notes, (0, 0))
    whole.paste(to_pillow(photograph).resize(size, Image.Resampling.LANCZOS), (0, high))
    return whole
