"""Read the pixels of untrusted images, and write WebP; the only user of Pillow for this."""

from __future__ import annotations

import io
import struct
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import GsCodecError, InvalidInput, one_line

#: Checks width and height of an image; raises a `GsCodecError` to reject it.
CheckSize = Callable[[int, int], None]


def read_pixels(
    source: str | Path | BinaryIO, formats: Sequence[str], check_size: CheckSize
) -> NDArray[np.uint8]:
    """Pixels ``(H, W, 4)``, RGBA, of an image, or of the first image of a file with several.

    Of channels of 16 bits, the upper 8 are kept. Raises InvalidInput if it cannot be opened, is not
    a valid image of these formats, or has channels of 32 bits. Errors of `check_size` are passed
    on.

    Parameters
    ----------
    source : str, Path or binary file
    formats : sequence of str
        Pillow's names of the formats to accept. Pillow's readers of other formats never see the
        file; its PostScript reader would run the file as a program.
    check_size : callable
        Called as ``check_size(width, height)`` before pixels are decoded.
    """
    with _opened(source, formats, check_size) as image:
        if image.mode == "F" or (image.mode == "I" and image.format != "PNG"):
            raise InvalidInput("32 bits per channel, expected 8 or 16")
        if image.mode.startswith("I"):  # "I;16", or "I" of PNG in Pillow 10; it would clip to 255
            grey = (np.asarray(image) >> 8).astype(np.uint8)[..., None]
            return np.concatenate([grey, grey, grey, np.full_like(grey, 255)], axis=2)
        return np.asarray(image if image.mode == "RGBA" else image.convert("RGBA"))


def read_size(
    source: str | Path | BinaryIO, formats: Sequence[str], check_size: CheckSize
) -> tuple[int, int]:
    """Width and height of an image, without decoding its pixels; arguments as in `read_pixels`.

    Raises InvalidInput, as for `read_pixels`.
    """
    with _opened(source, formats, check_size) as image:
        return image.size


def write_webp(pixels: NDArray[np.uint8], quality: int = 80) -> bytes:
    """A lossless WebP image of RGBA pixels ``(H, W, 4)``, including those of alpha 0.

    `quality` is how hard to compress, 0 to 100; 20 takes half as long as 80.
    """
    from PIL import Image

    stream = io.BytesIO()
    # Slower methods gain nothing, because neighbouring pixels are unrelated.
    Image.fromarray(pixels).save(
        stream, "WEBP", lossless=True, exact=True, method=4, quality=quality
    )
    return stream.getvalue()


@contextmanager
def _opened(
    source: str | Path | BinaryIO, formats: Sequence[str], check_size: CheckSize
) -> Iterator[Any]:
    """Open an image with Pillow; errors of the block become errors of the image."""
    from PIL import Image, UnidentifiedImageError

    try:
        # Pillow's WebP reader allocates all pixels when it opens a file.
        _check_webp(source, check_size)
        with _warnings_ignored(), Image.open(source, formats=tuple(formats)) as image:
            check_size(*image.size)
            yield image
    except GsCodecError:
        raise
    except UnidentifiedImageError:
        raise InvalidInput(f"not an image ({', '.join(formats)})") from None
    except Exception as error:
        # Pillow's readers may raise any exception on unexpected bytes.
        reason = one_line(error)[:200] or type(error).__name__
        raise InvalidInput(reason) from error


def _check_webp(source: str | Path | BinaryIO, check_size: CheckSize) -> None:
    """Check the size stated in the header of a WebP file; other files are not checked."""
    if isinstance(source, str | Path):
        with open(source, "rb") as file:
            _check_webp(file, check_size)
        return
    head = source.read(30)
    source.seek(0)
    if len(head) < 30 or head[:4] != b"RIFF" or head[8:12] != b"WEBP":
        return
    kind = head[12:16]
    if kind == b"VP8L" and head[20] == 0x2F:
        (bits,) = struct.unpack_from("<I", head, 21)
        check_size((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    elif kind == b"VP8X":
        width, height = (int.from_bytes(head[i : i + 3], "little") + 1 for i in (24, 27))
        check_size(width, height)
    elif kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", head, 26)
        check_size(width & 0x3FFF, height & 0x3FFF)
    else:
        raise InvalidInput(f"WebP of kind {kind!a}, expected an image")


_lock = threading.Lock()
_inside: list[warnings.catch_warnings] = []


@contextmanager
def _warnings_ignored() -> Iterator[None]:
    """Ignore Pillow's warnings about odd but readable files.

    Warning filters are global to the process: the first thread in sets them, the last one out
    restores them.
    """
    with _lock:
        context = _inside[0] if _inside else warnings.catch_warnings()
        if not _inside:
            context.__enter__()
            warnings.simplefilter("ignore")
        _inside.append(context)
    try:
        yield
    finally:
        with _lock:
            _inside.pop()
            if not _inside:
                context.__exit__(None, None, None)
