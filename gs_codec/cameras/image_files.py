"""Image files: photographs of cameras, found by name; writing PNG."""

from __future__ import annotations

import logging
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.lens import MAX_SIDE
from gs_codec.errors import InvalidInput
from gs_codec.formats.images import read_pixels, read_size
from gs_codec.runtime.atomic import atomic_writer, possible_name
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")

#: Names of folders of masks; copies of smaller images end in a number.
_MASKS = re.compile(r"(.*[_-])?masks?(_\d+)?", re.IGNORECASE)

#: Maximum number of pixels of a photograph.
_MOST = 1 << 27


def read_image(
    path: str | Path, background: Sequence[float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float32]:
    """Read an image as ``(H, W, 3)`` float32, 0-1; transparent parts show the background.

    Raises InvalidInput if it is missing, damaged, or larger than the maximum camera size.
    """
    with located(path):
        pixels = read_pixels(path, _FORMATS, _check_size)
    image = pixels[..., :3].astype(np.float32)
    image /= 255
    if (pixels[..., 3] < 255).any():
        alpha = pixels[..., 3:].astype(np.float32) / np.float32(255)
        image = alpha * image + (1 - alpha) * np.array(background, np.float32)
    return image


def image_size(path: str | Path) -> tuple[int, int]:
    """Width and height of an image, pixels, from its header.

    Raises InvalidInput, as in `read_image`, but only the header is read.
    """
    with located(path):
        return read_size(path, _FORMATS, _check_size)


def _check_size(width: int, height: int) -> None:
    if max(width, height) > MAX_SIDE or width * height > _MOST:
        raise InvalidInput(
            f"{width}x{height} pixels, expected at most {MAX_SIDE} each way and {_MOST} in all"
        )


def write_png(path: str | Path, image: NDArray) -> None:
    """Write ``(H, W, 3)``, clipped to 0-1, with 8 bits, atomically.

    Raises InvalidInput if it cannot be written.
    """
    from PIL import Image

    levels = np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)
    with atomic_writer(path) as file:
        Image.fromarray(levels).save(file, "PNG")


def output_names(cameras: Sequence[Camera]) -> list[str]:
    """A file name, without suffix, for each camera's image.

    Path separators, characters that are not printable, and on Windows those that it reserves,
    become underscores. Repeated names are numbered from 1, and a log message says so.
    """
    stems = [_output_stem(camera.name) for camera in cameras]
    counts = Counter(stems)
    taken, numbers = set(counts), Counter[str]()

    def name_of(stem: str) -> str:
        name = stem
        while counts[stem] > 1 and name in taken:
            numbers[stem] += 1
            name = f"{stem}_{numbers[stem]}"
        taken.add(name)
        return name

    names = [name_of(stem) for stem in stems]
    shared = [name for name, stem in zip(names, stems, strict=True) if counts[stem] > 1]
    if shared:
        many = counted(len(shared), "camera")
        log.warning(
            "%s with equal names: their files are numbered, for example %s", many, shared[0]
        )
    return names


def _output_stem(name: str) -> str:
    stem = possible_name(_stem(name))
    letters = (c if c.isprintable() and c not in "/\\" else "_" for c in stem)
    return "".join(letters).lstrip(".") or "_"


def seek_images(folder: str | Path, cameras: Sequence[Camera]) -> list[Path | None]:
    """The image of each camera in a folder, found by `seek_image`.

    Raises InvalidInput, as in `seek_image`, or if two cameras would share an image.
    """
    paths = [seek_image(folder, camera.name) for camera in cameras]
    owners: dict[Path, int] = {}
    for i, path in enumerate(paths):
        if path is not None and owners.setdefault(path, i) != i:
            names = " and ".join(f"'{cameras[k].name}'" for k in (owners[path], i))
            raise InvalidInput(
                f"{path}: image of cameras {owners[path]} and {i}, named {names}; "
                "expected a different photograph for each camera"
            )
    return paths


def find_image(folder: str | Path, name: str) -> Path:
    """Find a camera's image in a folder, by name, with its own or another suffix.

    Raises InvalidInput if there is none, or the name is outside the folder.
    """
    path = seek_image(folder, name)
    if path is None:
        raise InvalidInput(f"{folder}: no image '{_stem(name)}' ({', '.join(_SUFFIXES)})")
    return path


def seek_image(folder: str | Path, name: str) -> Path | None:
    """Like `find_image`, but return None if the folder exists and has no such image."""
    path = PurePath(name.replace("\\", "/"))
    names = list(_names_after(folder, path))
    if not path.anchor and ".." not in path.parts:
        names = [name, str(path), *names]
    if not names:
        raise InvalidInput(f"{folder}: image '{name}', expected a name inside the folder")
    for inside in names:
        stem = _stem(inside)
        others = [f"{stem}{suffix}" for suffix in (*_SUFFIXES, *map(str.upper, _SUFFIXES))]
        for image in [Path(folder) / other for other in (inside, *others)]:
            if os.path.isfile(image):
                return image
    if not os.path.isdir(folder):
        raise InvalidInput(f"{folder}: no such folder, expected images")
    return None


def _names_after(folder: str | Path, path: PurePath) -> Iterator[str]:
    """Yield the rest of a path after each part that is the name of `folder`.

    Names in transforms.json lead through ``images``, which may be `folder`, or have smaller copies
    in ``images_2``; some begin outside the dataset or, on another computer, at its root.
    """
    own = os.path.basename(os.path.abspath(folder))
    for index, part in enumerate(path.parts[:-1], 1):
        rest = PurePath(*path.parts[index:])
        inside = not rest.anchor and ".." not in rest.parts
        if inside and re.fullmatch(rf"{re.escape(part)}(_\d+)?", own):
            yield str(rest)


def _stem(name: str) -> str:
    stem, suffix = os.path.splitext(name)
    return stem if suffix.lower() in _SUFFIXES else name


def find_images(folder: str | Path, cameras: Sequence[Camera]) -> list[Path]:
    """Like `seek_images`, but a missing image is an error."""
    paths = seek_images(folder, cameras)
    return [
        path or find_image(folder, camera.name) for path, camera in zip(paths, cameras, strict=True)
    ]


def warn_of_masks(folder: str | Path) -> None:
    """Warn if there are masks beside a folder of photographs, whose pixels all count."""
    beside = sorted(Path(os.path.abspath(folder)).parent.glob("*"))
    masks = [each for each in beside if _MASKS.fullmatch(each.name) and each.is_dir()]
    if masks:
        log.warning("%s: left out: masks; all pixels of the photographs count", masks[0])
