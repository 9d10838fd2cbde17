"""The README's picture: a render before and after coding, their difference, and the bits.

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
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.metrics.image_quality import compare_images
from gs_codec.metrics.views import DIFFERENCE_GAIN
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene
from samples.generate import generate, orbit_cameras

_COUNT = 600_000
_WIDTH = 420
_HEIGHT = 300
_PROFILE = "s"

#: Streams of each bar segment; colours of Okabe and Ito, also distinct for the colour-blind.
_PARTS = {
    "positions": (("geometry", "low-bits"), "#000000"),
    "SH-DC": (("sh-dc",), "#e69f00"),
    "opacity": (("opacity",), "#56b4e9"),
    "scaling": (("scaling",), "#009e73"),
    "rotation": (("rotation",), "#f0e442"),
    "SH-AC": (("sh1", "sh2", "sh3"), "#d55e00"),
}
_SHOWN = ("paper-s", "s", "paper-m", "m")


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
    data, _ = encode_scene(scene, Config(_PROFILE))
    before, after = _draw(scene), _draw(decode_scene(data))
    quality = compare_images(before, after)
    panels = {
        f"before: {scene.float_bytes / 1e6:.0f} MB ({_COUNT:,} splats)": before,
        f"after: {len(data) / 1e6:.1f} MB (profile {_PROFILE})": after,
        f"difference, {DIFFERENCE_GAIN} times as strong: {quality.psnr:.1f} dB": (
            DIFFERENCE_GAIN * np.abs(before - after)
        ),
    }
    figure = plt.figure(figsize=(18, 4.0), dpi=80)
    for place, (title, image) in enumerate(panels.items()):
        axis = figure.add_axes((0.25 * place, 0.0, 0.247, 0.92))
        show(axis, np.clip(image, 0, 1), title)
    _draw_bits(figure.add_axes((0.805, 0.16, 0.19, 0.56)), scene, before)
    figure.savefig(target)


def show(axis, image: NDArray, title: str, interpolation: str | None = None) -> None:
    """Show an image below its title."""
    axis.imshow(image, interpolation=interpolation)
    axis.set_title(title, fontsize=15)
    axis.axis("off")


def drawn(scene: Scene, camera: Camera) -> NDArray:
    """Render of a scene, 0-1."""
    return np.clip(render(scene, camera, device="cpu").colour, 0, 1)


def _draw(scene: Scene) -> NDArray:
    return drawn(scene, view())


def _draw_bits(axis, scene: Scene, before: NDArray) -> None:
    """Draw stacked bits per Gaussian by attribute for each profile, and the loss of the view."""
    for row, profile in enumerate(_SHOWN):
        data, report = encode_scene(scene, Config(profile))
        sizes = report.section_bytes
        quality = compare_images(before, _draw(decode_scene(data)))
        left = 0.0
        for part, (streams, colour) in _PARTS.items():
            bits = 8 * sum(sizes.get(stream, 0) for stream in streams) / scene.count
            label = None if row else part
            axis.barh(row, bits, left=left, color=colour, label=label, edgecolor="white")
            left += bits
        axis.text(left + 3, row, f"{left:.0f}: {quality.psnr:.1f} dB", va="center", fontsize=12)
    axis.set_yticks(range(len(_SHOWN)), _SHOWN, fontsize=12)
    axis.invert_yaxis()
    axis.set_xlim(0, 245)
    axis.set_xlabel("bits per Gaussian (1888 as floats)", fontsize=12)
    axis.legend(
        ncols=3, fontsize=11, loc="lower center", bbox_to_anchor=(0.42, 1.0), frameon=False,
        columnspacing=1.0, handlelength=1.2,
    )  # fmt: skip
    axis.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main(sys.argv[1])
