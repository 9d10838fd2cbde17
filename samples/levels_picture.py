"""The picture of levels of detail: each level close up, and the blocks for small pictures.

    python samples/levels_picture.py gs_codec/bench/levels.jpg

Needs matplotlib (extra ``test``).
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl

sys.path.insert(0, str(Path(__file__).parents[1]))

from gs_codec.codecs import decode_part, encode_parts
from gs_codec.codecs.part import Part
from gs_codec.config import Config
from gs_codec.levels.adding import add_levels
from gs_codec.metrics.image_quality import compare_images
from samples.generate import generate
from samples.picture import drawn, show, view

_COUNT = 400_000
_LEVELS = (0, 1, 2)
_TIMES = (2, 4, 8)


def main(target: str) -> None:
    """Draw the scene and its levels."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    scene, near = generate(_COUNT, 2, 1), view()
    config = Config("m", block_size=1024, lod=True)
    data = b"".join(add_levels(*encode_parts(scene, config), config)[0])
    figure, axes = plt.subplots(2, len(_LEVELS), figsize=(13.5, 7.4), dpi=60)
    for axis, level in zip(axes[0], _LEVELS, strict=True):
        coarser = decode_part(data, Part(level=level))[0]
        name = f"level {level}" if level else "the scene"
        show(axis, drawn(coarser, near), f"{name}: {coarser.count:,} splats", "nearest")
    for axis, times in zip(axes[1], _TIMES, strict=True):
        small = near.resized(near.width // times, near.height // times)
        chosen = decode_part(data, Part(view=small))[0]
        before, after = drawn(scene, small), drawn(chosen, small)
        psnr = compare_images(before, after).psnr
        size = f"{small.width} x {small.height} pixels"
        show(axis, after, f"{size}: {chosen.count:,} splats, {psnr:.1f} dB", "nearest")
    figure.tight_layout(pad=0.4)
    figure.savefig(target)


if __name__ == "__main__":
    main(sys.argv[1])
