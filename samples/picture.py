"""The README's pictures: a view before and after coding, and a wipe from one to the other.

    python samples/picture.py scene.ply cameras.json 0015 samples    # picture.jpg and wipe.webp

The scene is encoded with profile `m`, guided by all cameras.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

sys.path.insert(0, str(Path(__file__).parents[1]))

import gs_codec
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.runtime.wording import size_text

_WIDTH = 600
_FRAMES = 30
_FRAME_MS = 70
_MARGIN = 10


def main(scene: str, cameras: str, name: str, folder: str) -> None:
    """Encode the scene, and draw one of its cameras before and after."""
    camera = next(x for x in read_cameras(Path(cameras)) if x.name == name)
    camera = camera.resized(_WIDTH, round(_WIDTH * camera.height / camera.width))
    with tempfile.TemporaryDirectory() as work:
        small = Path(work) / "small.egs"
        gs_codec.encode_file(scene, small, "m", gs_codec.Plan(cameras=cameras))
        before, after = (_drawn(path, camera) for path in (scene, small))
        texts = [size_text(Path(path).stat().st_size) for path in (scene, small)]
    picture = Image.new("RGB", (2 * before.width + _MARGIN, before.height), "white")
    picture.paste(_labelled(before, f"before: {texts[0]}", "left"), (0, 0))
    picture.paste(_labelled(after, f"after: {texts[1]}", "right"), (before.width + _MARGIN, 0))
    picture.save(Path(folder) / "picture.jpg", quality=90)
    both = [_labelled(before, texts[0], "left"), _labelled(after, texts[1], "right")]
    there = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, _FRAMES))
    frames = [_wiped(*both, round(_WIDTH * (0.02 + 0.96 * x))) for x in (*there, *there[-2:0:-1])]
    frames[0].save(
        Path(folder) / "wipe.webp", save_all=True, append_images=frames[1:], duration=_FRAME_MS,
        loop=0, quality=80, method=6,
    )  # fmt: skip


def _drawn(path: Path | str, camera: Camera) -> Image.Image:
    ((_, rendering),) = gs_codec.render(path, [camera])
    return Image.fromarray(np.rint(255 * np.clip(rendering.colour, 0, 1)).astype(np.uint8))


def _labelled(image: Image.Image, text: str, side: str) -> Image.Image:
    """White text on a dark field in an upper corner."""
    image = image.copy()
    draw, font = ImageDraw.Draw(image, "RGBA"), ImageFont.load_default(22)
    width = draw.textlength(text, font) + 2 * _MARGIN
    left = 0 if side == "left" else image.width - width
    draw.rectangle((left, 0, left + width, 40), fill=(0, 0, 0, 150))
    draw.text((left + _MARGIN, 6), text, "white", font)
    return image


def _wiped(before: Image.Image, after: Image.Image, column: int) -> Image.Image:
    """The scene before coding left of a line, and after coding right of it."""
    image = after.copy()
    image.paste(before.crop((0, 0, column, before.height)), (0, 0))
    ImageDraw.Draw(image).line((column, 0, column, image.height), "white", 2)
    return image


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for argument in ("scene", "cameras", "name", "folder"):
        parser.add_argument(argument)
    main(**vars(parser.parse_args()))
