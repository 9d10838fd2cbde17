"""Read the files of a SOG scene, from a zip or a folder, and the pixels of its images."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.io import images
from gs_codec.io.limits import refusing
from gs_codec.io.mapped import located

ZIP = b"PK\x03\x04"

#: Reads a file, given its name and the most bytes it may have.
Files = Callable[[str, int], bytes]

_ENTRIES = 1000

#: Animation flag of an extended WebP file.
_ANIMATION = 2


@contextmanager
def sog_files(path: Path, is_zip: bool) -> Iterator[Files]:
    """A function that reads the files of a scene, from a zip or beside its `meta.json`.

    Raises
    ------
    InvalidInput
        If the zip is not valid; when reading, if a file is missing, encrypted, or too large.
    """
    if not is_zip:
        yield lambda name, limit: _read_beside(path, name, limit)
        return
    with refusing("zip", zipfile.BadZipFile):
        archive = zipfile.ZipFile(path)
    with archive:
        entries = archive.infolist()
        if len(entries) > _ENTRIES:
            raise InvalidInput(f"zip of {len(entries)} entries, expected at most {_ENTRIES}")
        # Some bundles have all files in one folder.
        folder = _folder_of({e.filename for e in entries})
        yield lambda name, limit: _read_entry(archive, folder + name, limit)


def stored_bytes(meta: Path, files: Mapping[str, Iterable[str]]) -> int:
    """Total size of a `meta.json` and the existing files of its scene."""
    paths = [meta, *(meta.parent / name for names in files.values() for name in names)]
    return sum(path.stat().st_size for path in paths if path.is_file())


def _folder_of(names: Iterable[str]) -> str:
    """The folder of the scene in a zip."""
    by_base: dict[str, list[str]] = {}
    for name in names:
        by_base.setdefault(name.rpartition("/")[2], []).append(name)
    if "data.pkl" in by_base:
        raise InvalidInput("a checkpoint of PyTorch, expected a scene: export it as .ply")
    if "meta.json" not in by_base:
        raise InvalidInput("a zip without meta.json, expected a SOG scene")
    return min(by_base["meta.json"], key=len).removesuffix("meta.json")


def _read_beside(meta: Path, name: str, limit: int) -> bytes:
    path = meta if name == "meta.json" else meta.parent / name
    with refusing(f"file '{name}'"):
        if not path.is_file() or path.stat().st_size > limit:
            raise InvalidInput(f"file '{name}': no file, or of more than {limit} bytes")
        return path.read_bytes()


def _read_entry(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    with refusing(f"zip entry '{name[:60]}'", zipfile.BadZipFile):
        entry = archive.getinfo(name)
        if entry.flag_bits & 1:
            raise InvalidInput(f"zip entry '{name[:60]}': encrypted")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InvalidInput(f"zip entry '{name[:60]}': compressed otherwise than by deflate")
        if entry.file_size > limit:
            raise InvalidInput(
                f"zip entry '{name[:60]}': {entry.file_size} bytes, expected at most {limit}"
            )
        with archive.open(entry) as file:
            data = file.read(entry.file_size + 1)
    if len(data) != entry.file_size:
        raise InvalidInput(f"zip entry '{name[:60]}': {len(data)} bytes of {entry.file_size}")
    return data


def read_pixels(data: bytes, name: str, most: int) -> NDArray[np.uint8]:
    """Pixels ``(height, width, 4)`` of a WebP image, RGBA.

    Raises
    ------
    InvalidInput
        If it is not a still WebP image, or has more than `most` pixels.
    """

    def check_size(width: int, height: int) -> None:
        if width * height > most:
            raise InvalidInput(f"{width}x{height} pixels, expected at most {most}")

    # Lossy images are accepted: some files of version 1 have them.
    with located(f"image '{name}'"):
        if data[12:16] == b"VP8X" and data[20:21] and data[20] & _ANIMATION:
            raise InvalidInput("an animation, expected a still image")
        return images.read_pixels(io.BytesIO(data), ("WEBP",), check_size)
