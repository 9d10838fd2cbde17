"""The picture of levels of detail: each level close up, and the blocks for small pictures.

    python samples/levels_picture.py gs_codec/bench/levels.jpg

Needs matplotlib (extra ``test``).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.codecs import decode_part, encode_parts
from gs_codec.codecs.part import Part
from gs_codec.config import Config
from gs_codec.levels.adding import add_levels
from gs_codec.metrics.image_quality import compare_images
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene
from samples.generate import generate, orbit_cameras

_COUNT = 400_000
_WIDTH = 420
_HEIGHT = 300
_LEVELS = (0, 1, 2)
_TIMES = (2, 4, 8)


def main(target: str) -> None:
    """Draw the scene and its levels."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    scene, near = generate(_COUNT, 2, 1), _view()
    config = Config("m", block_size=1024, lod=True)
    data = b"".join(add_levels(*encode_parts(scene, config), config)[0])
    figure, axes = plt.subplots(2, len(_LEVELS), figsize=(13.5, 7.4), dpi=60)
    for axis, level in zip(axes[0], _LEVELS, strict=True):
        coarser = decode_part(data, Part(level=level))[0]
        name = f"level {level}" if level else "the scene"
        _show(axis, _drawn(coarser, near), f"{name}: {coarser.count:,} splats", "nearest")
    for axis, times in zip(axes[1], _TIMES, strict=True):
        small = near.resized(near.width // times, near.height // times)
        chosen = decode_part(data, Part(view=small))[0]
        before, after = _drawn(scene, small), _drawn(chosen, small)
        psnr = compare_images(before, after).psnr
        size = f"{small.width} x {small.height} pixels"
        _show(axis, after, f"{size}: {chosen.count:,} splats, {psnr:.1f} dB", "nearest")
    figure.tight_layout(pad=0.4)
    figure.savefig(target)


def _view() -> Camera:
    """The camera of the picture."""
    entry = orbit_cameras(24, _WIDTH, _HEIGHT)[2]
    entry["fx"] = entry["fy"] = 1.2 * entry["fx"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cameras.json"
        path.write_text(json.dumps([entry]))
        return read_cameras(path)[0]


def _show(axis, image: NDArray, title: str, interpolation: str | None = None) -> None:
    """Show an image below its title."""
    axis.imshow(image, interpolation=interpolation)
    axis.set_title(title, fontsize=15)
    axis.axis("off")


def _drawn(scene: Scene, camera: Camera) -> NDArray:
    """Render of a scene, 0-1."""
    return np.clip(render(scene, camera, device="cpu").colour, 0, 1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("target", help="picture to write")
    main(parser.parse_args().target)
