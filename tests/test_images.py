"""Untrusted images: format and size are checked before pixels, and one module reads them."""

from __future__ import annotations

import ast
import io
import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import EpsImagePlugin, Image
from refusals import assert_one_line

import gs_codec
from gs_codec.cameras.image_files import read_image
from gs_codec.errors import InvalidInput
from gs_codec.formats.images import _warnings_ignored, read_pixels
from gs_codec.formats.sog.files import read_pixels as read_sog_pixels

#: Packages, and the module that opens images in each.
PACKAGES = ("gs_codec", "viewer")
READER = "gs_codec/formats/images.py"


def any_size(width: int, height: int) -> None:
    """Accept every image."""


def png(width: int, height: int, *chunks: bytes, rows: int | None = None) -> bytes:
    """A grey PNG with some of its rows."""
    pixels = zlib.compress(bytes((width + 1) * (height if rows is None else rows)))
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = [chunk(b"IHDR", header), *chunks, chunk(b"IDAT", pixels), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def test_one_module_opens_images():
    root = Path(gs_codec.__file__).parents[1]
    found = set()
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                opens = isinstance(node, ast.Attribute) and node.attr in ("open", "imread")
                if opens and ast.unparse(node.value) in ("Image", "PIL.Image", "plt", "io"):
                    found.add(path.relative_to(root).as_posix())
    assert found == {READER}


def test_postscript_is_not_executed(tmp_path, monkeypatch):
    """An EPS file opens as an image of any name; its pixels are rendered by Ghostscript."""
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("was run"))
    path = tmp_path / "view.png"
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n")
    with pytest.raises(InvalidInput, match="not an image") as caught:
        read_image(path)
    assert_one_line(caught.value, path)


@pytest.mark.parametrize(("width", "height"), [(16385, 1), (1, 16385), (12000, 12000)])
def test_large_images_are_refused_before_their_pixels(width, height, tmp_path):
    path = tmp_path / "view.png"
    path.write_bytes(png(width, height, rows=0))
    with pytest.raises(InvalidInput, match=f"{width}x{height} pixels, expected at most") as caught:
        read_image(path)
    assert_one_line(caught.value, path)


def test_webp_is_refused_before_its_reader_takes_memory():
    data = b"RIFF" + struct.pack("<I", 22) + b"WEBPVP8X" + struct.pack("<I", 10)
    data += bytes(4) + (16382).to_bytes(3, "little") * 2
    with pytest.raises(InvalidInput, match="16383x16383 pixels, expected at most"):
        read_sog_pixels(data, "a.webp", 1000)


@pytest.mark.parametrize(
    "data",
    [
        png(60_000, 60_000, rows=0),
        png(8, 8, chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1 << 25)))),
        png(8, 8, *[chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1 << 20)))] * 80),
    ],
    ids=["pixels", "text", "texts"],
)
def test_bombs_are_refused_in_one_line(data, tmp_path):
    path = tmp_path / "view.png"
    path.write_bytes(data)
    with pytest.raises(InvalidInput) as caught:
        read_image(path)
    assert_one_line(caught.value, path)


@pytest.mark.parametrize("kind", [AttributeError, AssertionError, KeyError, RecursionError])
def test_any_exception_of_a_reader_is_one_line(kind, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise kind("odd\nbytes")

    monkeypatch.setattr(Image, "open", fail)
    path = tmp_path / "view.png"
    path.write_bytes(png(8, 8))
    with pytest.raises(InvalidInput, match="odd") as caught:
        read_image(path)
    assert_one_line(caught.value, path)


def test_only_requested_formats_are_read():
    data = io.BytesIO(png(3, 2))
    assert read_pixels(data, ("PNG",), any_size).shape == (2, 3, 4)
    with pytest.raises(InvalidInput, match=r"not an image \(JPEG\)"):
        read_pixels(data, ("JPEG",), any_size)


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_grey_of_16_bits_is_not_clipped(tmp_path, suffix, order):
    levels = np.array([[0, 255, 256], [25_700, 32_768, 65_535]], f"{order}u2")
    Image.fromarray(levels).save(tmp_path / f"a.{suffix}")
    found = read_image(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(found, np.repeat(levels[..., None] / 65_535, 3, 2), atol=1 / 255)


@pytest.mark.parametrize("kind", ["i4", "f4"])
def test_channels_of_32_bits_are_refused(tmp_path, kind):
    Image.fromarray(np.ones((2, 3), kind)).save(tmp_path / "a.tif")
    with pytest.raises(InvalidInput, match=r"a\.tif: 32 bits per channel, expected 8 or 16"):
        read_image(tmp_path / "a.tif")


def test_grey_and_transparency_become_rgba(tmp_path):
    Image.fromarray(np.full((2, 2), 51, np.uint8)).save(tmp_path / "a.png")
    assert np.array_equal(read_image(tmp_path / "a.png"), np.full((2, 2, 3), np.float32(0.2)))
    rgba = np.full((2, 2, 4), [255, 255, 255, 102], np.uint8)
    Image.fromarray(rgba).save(tmp_path / "b.png")
    assert np.array_equal(read_image(tmp_path / "b.png"), np.full((2, 2, 3), np.float32(0.4)))
    found = read_image(tmp_path / "b.png", (1.0, 0.5, 0.0))
    np.testing.assert_allclose(found, np.full((2, 2, 3), [1.0, 0.7, 0.4]), rtol=1e-6)


def test_warnings_are_restored_by_the_last_thread():
    before = list(warnings.filters)
    first, second = _warnings_ignored(), _warnings_ignored()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    warnings.warn("is not heard", stacklevel=1)
    second.__exit__(None, None, None)
    assert warnings.filters == before
