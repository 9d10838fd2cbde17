"""A picture of notes: a caption, legends, reasons for pruning, a photograph."""

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

#: Minimum width, pixels.
_WIDTH = 400

#: Height of the caption, pixels.
_CAPTION = 30

#: Height of a reason, pixels.
_REASON = 18

#: Height of a legend, pixels.
_LEGEND = 56


def draw_notes(
    caption: str,
    legends: Sequence[Legend] = (),
    pruned: Pruned | None = None,
    photograph: NDArray[np.float32] | None = None,
    most: int = 300,
) -> Image.Image:
    """Draw notes, as wide as the caption needs.

    Parameters
    ----------
    caption : str
        One line.
    legends : sequence of Legend
    pruned : Pruned, optional
        Its reasons are listed.
    photograph : ndarray, shape (H, W, 3), float32, 0-1, optional
    most : int
        Maximum height of the photograph, pixels.
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
    shape = photograph.shape
    scale = min(wide / shape[1], most / shape[0])
    size = max(1, round(scale * shape[1])), max(1, round(scale * shape[0]))
    whole = Image.new("RGB", (wide, high + size[1]))
    whole.paste(notes, (0, 0))
    shown = to_pillow(photograph).resize(size, Image.Resampling.LANCZOS)
    whole.paste(shown, ((wide - size[0]) // 2, high))
    return whole
