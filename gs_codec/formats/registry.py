"""Recognise scene formats by content, then by suffix; read scenes of any format but `.egs`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from gs_codec.egs.file import MAGIC as EGS
from gs_codec.errors import InvalidInput
from gs_codec.formats import packed_ply, sog, spz
from gs_codec.formats.packed_ply import is_packed
from gs_codec.formats.ply import scene_of
from gs_codec.formats.ply_body import Ply, ply_of
from gs_codec.formats.sog import read_sog, sog_bytes
from gs_codec.formats.sog_files import ZIP
from gs_codec.formats.splat import RECORD, read_splat
from gs_codec.formats.spz import GZIP, MAGIC, read_spz
from gs_codec.runtime.mapped import opened
from gs_codec.scene import Scene, float_bytes

Format = Literal["egs", "ply", "splat", "spz", "sog"]

_BY_SUFFIX: dict[str, Format] = {
    ".egs": "egs",
    ".ply": "ply",
    ".splat": "splat",
    ".spz": "spz",
    ".sog": "sog",
    ".json": "sog",
}

_BY_CONTENT: tuple[tuple[bytes, Format], ...] = (
    (EGS, "egs"),
    (b"ply\n", "ply"),
    (b"ply\r", "ply"),
    (MAGIC, "spz"),
    (ZIP, "sog"),
)

#: Signatures so short that a `.splat`, which begins with a number, may begin with them by chance.
_BY_LITTLE: tuple[tuple[bytes, Format], ...] = ((GZIP, "spz"), (b"{", "sog"))


@dataclass(frozen=True)
class SceneFile:
    """An open file of a scene: its format, header and scene.

    Attributes
    ----------
    path : Path
    data : memoryview
        All bytes of the file, mapped.
    """

    path: Path
    data: memoryview

    @cached_property
    def format(self) -> Format:
        """The format, recognised by content, then by suffix.

        Raises
        ------
        InvalidInput
            If the format is not supported.
        """
        head, suffix = bytes(self.data[:16]), self.path.suffix.lower()
        known = _BY_CONTENT if suffix == ".splat" else _BY_CONTENT + _BY_LITTLE
        for begin, name in known:
            if head.startswith(begin):
                return name
        if suffix not in _BY_SUFFIX:
            listed = ", ".join(_BY_SUFFIX)
            raise InvalidInput(
                f"{self.path}: begins with {head[:4]!a}, expected {listed} of a scene"
            )
        return _BY_SUFFIX[suffix]

    @property
    def is_egs(self) -> bool:
        """Whether it is an `.egs` file by content or suffix; it may be damaged."""
        return self.data[: len(EGS)] == EGS or self.path.suffix.lower() == ".egs"

    @cached_property
    def ply(self) -> Ply:
        """The file as a PLY, with its header read."""
        return ply_of(self.path, self.data)

    @property
    def is_compressed(self) -> bool:
        """Whether the file is in a compressed format, which is any but plain PLY."""
        return self.is_egs or self.format != "ply" or is_packed(self.ply.header)

    @property
    def is_read_in_parts(self) -> bool:
        """Whether it can be read part by part: a plain binary PLY."""
        return not self.is_compressed and bool(self.ply.header.byte_order)

    @property
    def stored_bytes(self) -> int:
        """Size of the scene, bytes: of this file, or of all files of a SOG scene."""
        return sog_bytes(self.path) if self.format == "sog" else len(self.data)

    def ratio_bytes(self, raw_bytes: int) -> int:
        """Bytes that a ratio counts from: of a PLY, or the floats' `raw_bytes` if compressed."""
        return raw_bytes if self.is_compressed else self.stored_bytes

    def stated_bytes(self) -> int:
        """Bytes of floats that the header states (not for `.egs`); reads only the header.

        Raises
        ------
        InvalidInput
            If the header cannot be read.
        """
        sizes = {"spz": spz.stated_size, "sog": sog.stated_size}
        if self.format in sizes:
            return float_bytes(*sizes[self.format](self.path))
        if self.format == "splat":
            return float_bytes(len(self.data) // RECORD, 0)
        header = self.ply.header
        if is_packed(header):
            return float_bytes(*packed_ply.stated_size(header))
        return sum(4 * e.count * len(e.types) for e in header.elements if e.name == "vertex")

    def scene(
        self, extra: Literal["error", "keep", "drop"] = "error", max_bytes: int | None = None
    ) -> Scene:
        """Read a scene of any format but `.egs`; `extra` and `max_bytes` are as in `read_ply`.

        Raises
        ------
        InvalidInput
            If it is not a valid file of a supported format.
        """
        if self.format == "ply":
            return scene_of(self.ply, extra, max_bytes)
        readers = {"splat": read_splat, "spz": read_spz, "sog": read_sog}
        return readers[self.format](self.path, max_bytes)


@contextmanager
def open_scene(path: str | Path) -> Iterator[SceneFile]:
    """Open the file of a scene, in any format.

    Raises
    ------
    InvalidInput
        If it is missing, empty, a directory, or not readable.
    """
    with opened(path) as data:
        yield SceneFile(Path(path), data)
