"""The README's picture: splat centres before and after coding, and where the bits go.

    python samples/picture.py samples/picture.png

Needs matplotlib (extra ``test``). Centres are points of their SH-DC colour, nearest on top.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import PROFILES, Config
from gs_codec.scene import Scene
from samples.generate import generate, orbit_cameras

_SH_C0 = 0.28209479177387814
_COUNT = 600_000


def paint_centres(scene: Scene, camera: dict) -> NDArray[np.float32]:
    """Image ``(H, W, 3)``, 0-1, of the centres of nearly opaque Gaussians."""
    solid = scene.opacity[0] > 1.0
    rotation, position = np.array(camera["rotation"]), np.array(camera["position"])
    x, y, z = rotation.T @ (scene.positions[:, solid] - position[:, None])
    column = np.round(camera["fx"] * x / z + camera["width"] / 2)
    row = np.round(camera["fy"] * y / z + camera["height"] / 2)
    seen = (z > 0.2) & (column >= 0) & (row >= 0)
    seen &= (column < camera["width"] - 1) & (row < camera["height"] - 1)
    colour = np.clip(0.5 + _SH_C0 * scene.f_dc[:, solid][:, seen], 0, 1).T
    far_first = np.argsort(-z[seen])
    colour = colour[far_first]
    row, column = (axis[seen][far_first].astype(int) for axis in (row, column))
    image = np.ones((camera["height"], camera["width"], 3), np.float32)
    for down, right in ((1, 1), (1, 0), (0, 1), (0, 0)):
        image[row + down, column + right] = colour
    return image


def main(target: str) -> None:
    """Draw before, after, and the bits of each profile."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    scene, camera = generate(_COUNT, 3, 1), orbit_cameras(24, 640, 426)[2]
    camera["fx"] = camera["fy"] = 1.3 * camera["fx"]
    figure = plt.figure(figsize=(15, 3.7), dpi=80)
    places = ((0.0, 0.0, 0.34, 0.92), (0.345, 0.0, 0.34, 0.92), (0.74, 0.14, 0.25, 0.66))
    axes = [figure.add_axes(place) for place in places]
    data, _ = encode_scene(scene, Config("paper-m"))
    sizes = (f"{scene.float_bytes / 1e6:.0f} MB of floats", f"{len(data) / 1e6:.1f} MB, paper-m")
    for axis, shown, size in zip(axes, (scene, decode_scene(data)), sizes, strict=False):
        axis.imshow(paint_centres(shown, camera))
        axis.set_title(f"{_COUNT:,} splat centres, {size}", fontsize=10)
        axis.axis("off")
    _draw_bits(axes[2], scene)
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
    axis.legend(ncols=4, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 1.25), frameon=False)
    axis.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    main(sys.argv[1])
