"""The README's picture: a rendered view before and after coding, their difference, and the bits.

    python samples/picture.py samples/picture.png

Needs matplotlib (extra ``test``).
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import PROFILES, Config
from gs_codec.metrics.images import compare_images
from gs_codec.metrics.views import DIFFERENCE_GAIN
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.camera_files import read_cameras
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene
from samples.generate import generate, orbit_cameras

_COUNT = 600_000
_WIDTH, _HEIGHT = 420, 300


def view() -> Camera:
    """The camera of the picture."""
    entry = orbit_cameras(24, _WIDTH, _HEIGHT)[2]
    entry["fx"] = entry["fy"] = 1.2 * entry["fx"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cameras.json"
        path.write_text(json.dumps([entry]))
        return read_cameras(path)[0]


def main(target: str) -> None:
    """Draw before, after, difference, and the bits of each profile."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    scene = generate(_COUNT, 3, 1)
    data, _ = encode_scene(scene, Config("paper-m"))
    before, after = (
        np.clip(render(s, view(), device="cpu").colour, 0, 1) for s in (scene, decode_scene(data))
    )
    quality = compare_images(before, after)
    panels = {
        f"before: {_COUNT:,} splats, {scene.float_bytes / 1e6:.0f} MB of floats": before,
        f"after: {len(data) / 1e6:.1f} MB (paper-m)": after,
        f"difference x {DIFFERENCE_GAIN}: {quality.psnr:.1f} dB": (
            DIFFERENCE_GAIN * np.abs(before - after)
        ),
    }
    figure = plt.figure(figsize=(18, 3.95), dpi=80)
    for place, (title, image) in enumerate(panels.items()):
        axis = figure.add_axes((0.25 * place, 0.0, 0.247, 0.93))
        axis.imshow(np.clip(image, 0, 1))
        axis.set_title(title, fontsize=11)
        axis.axis("off")
    _draw_bits(figure.add_axes((0.795, 0.14, 0.2, 0.62)), scene)
    figure.savefig(target)


def _draw_bits(axis, scene: Scene) -> None:
    """Bits per Gaussian of each stream, stacked, for each profile."""
    names = ("geometry", "sh-dc", "opacity", "scaling", "rotation", "sh1", "sh2", "sh3")
    # Okabe and Ito's colours, told apart by the colour-blind.
    colours = ("#000000", "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00")
    for row, profile in enumerate(PROFILES):
        sizes = encode_scene(scene, Config(profile))[1].section_bytes
        left = 0.0
        for name, colour in zip(names, (*colours, "#cc79a7"), strict=True):
            bits = 8 * sizes[name] / scene.count
            label = name if row == 0 else None
            axis.barh(row, bits, left=left, color=colour, label=label, edgecolor="white")
            left += bits
        axis.text(left + 3, row, f"{left:.0f}", va="center", fontsize=9)
    axis.set_yticks(range(len(PROFILES)), PROFILES)
    axis.invert_yaxis()
    axis.set_xlim(0, 260)
    axis.set_xlabel("bits per Gaussian (1888 as floats)", fontsize=9)
    axis.legend(ncols=4, fontsize=8, loc="upper center", bbox_to_anchor=(0.42, 1.3), frameon=False)
    axis.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main(sys.argv[1])
