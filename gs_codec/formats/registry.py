"""Recognise scene formats by content, then by suffix; read scenes of any format but `.egs`."""

from __future__ import annotations

from codecs import BOM_UTF8
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from gs_codec.coding.clean import with_finite_ends
from gs_codec.coding.extent import centre_bounds
from gs_codec.config import SSOG, Extra
from gs_codec.egs.egs_file import MAGIC as EGS
from gs_codec.egs.index import Box
from gs_codec.errors import InvalidInput
from gs_codec.formats import checkpoint, ksplat, splat
from gs_codec.formats.gltf import file as gltf_file
from gs_codec.formats.gltf import scene as gltf
from gs_codec.formats.ply import packed as packed_ply
from gs_codec.formats.ply.body import Ply, ply_of
from gs_codec.formats.ply.file import scene_of
from gs_codec.formats.sog import scene as sog
from gs_codec.formats.sog import streamed as streamed_sog
from gs_codec.formats.spz import file as spz_file
from gs_codec.formats.spz import scene as spz
from gs_codec.formats.usd import scene as usd
from gs_codec.formats.zip_file import ZIP
from gs_codec.runtime.guess import LOOKED_AT, looks_like, text_kind
from gs_codec.runtime.mapped import FileBytes, opened
from gs_codec.scene import Scene, Shift, float_bytes

Format = Literal["egs", "ply", "splat", "spz", "sog", "gltf", "usd", "ksplat", "pt", "streamed sog"]

_BY_SUFFIX: dict[str, Format] = {
    f".{name}": name for name in get_args(Format) if name != "streamed sog"
} | {
    ".json": "sog",
    SSOG: "streamed sog",
    ".glb": "gltf",
    ".ckpt": "pt",
    **dict.fromkeys(usd.SUFFIXES, "usd"),
}

#: Suffixes of the files that are read.
SUFFIXES = tuple(_BY_SUFFIX)

_BY_CONTENT: tuple[tuple[bytes, Format], ...] = (
    (EGS, "egs"),
    (b"ply\n", "ply"),
    (b"ply\r", "ply"),
    (BOM_UTF8 + b"ply", "ply"),
    (spz_file.MAGIC, "spz"),
    (ZIP, "sog"),
    (gltf_file.MAGIC, "gltf"),
    (usd.TEXT, "usd"),
    (usd.CRATE, "usd"),
)

#: Signatures so short that a `.splat`, which begins with a number, may begin with them by chance.
_BY_LITTLE: tuple[tuple[bytes, Format], ...] = ((spz_file.GZIP, "spz"), (b"{", "sog"))


def _in_zip(path: Path, data: FileBytes) -> Format:
    """The format of a zip file, by its first entry, or if it has a `lod-meta.json`."""
    if checkpoint.is_checkpoint(data):
        return "pt"
    if usd.is_usdz(data):
        return "usd"
    return "streamed sog" if streamed_sog.is_streamed(path, data) else "sog"


@dataclass(frozen=True)
class SceneFile:
    """An open file of a scene: its format, header and scene.

    Attributes
    ----------
    path : Path
    data : FileBytes
        The bytes of the file.
    shift : tuple of three float, optional
        Translation of centres before they are rounded; see `has_doubles`.
    """

    path: Path
    data: FileBytes
    shift: Shift | None = None

    @cached_property
    def format(self) -> Format:
        """The format, recognised by content, then by suffix; `InvalidInput` if by neither."""
        head, suffix = bytes(self.data[:LOOKED_AT]), self.path.suffix.lower()
        if found := looks_like(head):
            raise InvalidInput(f"{self.path}: {found}")
        if head.startswith(b"{") and streamed_sog.is_streamed(self.path, self.data):
            return "streamed sog"
        # Both .gltf and the meta.json of SOG are JSON.
        plain = suffix in (".splat", ".ksplat", ".gltf")
        known = _BY_CONTENT if plain else _BY_CONTENT + _BY_LITTLE
        for begin, name in known:
            if head.startswith(begin):
                return _in_zip(self.path, self.data) if begin == ZIP else name
        if suffix not in _BY_SUFFIX:
            listed = ", ".join(SUFFIXES)
            hint = "" if suffix else "; stdin needs --input-format for splat, ksplat and gltf"
            raise InvalidInput(
                f"{self.path}: begins with {head[:4]!a}, expected {listed} of a scene{hint}"
            )
        if suffix in (".splat", ".ksplat") and (kind := text_kind(head)):
            raise InvalidInput(f"{self.path}: {kind}, not a {suffix} scene")
        return _BY_SUFFIX[suffix]

    @cached_property
    def _whole(self) -> Any:
        """All bytes; a checkpoint, which may have much else, is read from its file instead."""
        return self.data if self.format == "pt" else self.data[:]

    @cached_property
    def ply(self) -> Ply:
        """The file as a PLY, with its header read."""
        return ply_of(self.path, self.data)

    @property
    def is_compressed(self) -> bool:
        """Whether the file is in a compressed format, which is any but plain PLY."""
        return self.format != "ply" or packed_ply.is_packed(self.ply.header)

    @property
    def is_rounded(self) -> bool:
        """Whether it is in a format of other programs that rounds all values but a few."""
        rounded = ("splat", "ksplat", "spz", "sog", "streamed sog")
        return self.format in rounded or (self.format == "ply" and self.is_compressed)

    @property
    def has_doubles(self) -> bool:
        """Whether it is a PLY of float64 centres."""
        if self.is_compressed:
            return False
        vertex = self.ply.header.elements.get("vertex")
        return vertex is not None and any(vertex.types.get(axis) == "f8" for axis in "xyz")

    @property
    def is_read_in_parts(self) -> bool:
        """Whether it can be read part by part: a plain binary PLY."""
        return not self.is_compressed and bool(self.ply.header.byte_order)

    @property
    def stored_bytes(self) -> int:
        """Size of the scene, bytes: of this file, or of all files of a SOG scene."""
        if self.format == "streamed sog":
            return streamed_sog.streamed_bytes(self.path, self._whole)
        return sog.sog_bytes(self.path, self._whole) if self.format == "sog" else len(self.data)

    def ratio_bytes(self, raw_bytes: int) -> int:
        """Bytes that a ratio counts from: of a PLY, or the floats' `raw_bytes` if compressed."""
        return raw_bytes if self.is_compressed else self.stored_bytes

    def stated_bytes(self) -> int:
        """Bytes of floats that the header states (not for `.egs`); reads only the header."""
        sizes = {
            "spz": spz_file.stated_size,
            "sog": sog.stated_size,
            "streamed sog": streamed_sog.stated_size,
            "gltf": gltf.stated_size,
            "usd": usd.stated_size,
            "ksplat": ksplat.stated_size,
            "pt": checkpoint.stated_size,
        }
        if self.format in sizes:
            return float_bytes(*sizes[self.format](self.path, self._whole))
        if self.format == "splat":
            return float_bytes(len(self.data) // splat.RECORD, 0)
        header = self.ply.header
        if packed_ply.is_packed(header):
            return float_bytes(*packed_ply.stated_size(header))
        vertex = header.elements.get("vertex")
        return 0 if vertex is None else 4 * vertex.count * len(vertex.types)

    def scene(
        self, extra: Extra = "keep", max_bytes: int | None = None, exact: bool = False
    ) -> Scene:
        """Read a scene of any format but `.egs`; `extra` and `max_bytes` are as in `read_ply`.

        Infinities that are values become finite, see `finite_ends`, unless `exact`.

        Raises
        ------
        InvalidInput
            If it is not a valid file of its format, or is larger than `max_bytes`.
        """
        scene = self._scene(extra, max_bytes)
        return scene if exact else with_finite_ends(scene, self.path)

    def _scene(self, extra: Extra, max_bytes: int | None) -> Scene:
        if self.format == "ply":
            scene = scene_of(self.ply, extra, max_bytes, shift=self.shift)
        else:
            scene = self._read_whole(max_bytes)
        self.data.check_unchanged()
        return scene

    def _read_whole(self, max_bytes: int | None) -> Scene:
        readers = {
            "splat": splat.read_splat,
            "spz": spz.read_spz,
            "sog": sog.read_sog,
            "streamed sog": streamed_sog.read_streamed,
            "gltf": gltf.read_gltf,
            "usd": usd.read_usd,
            "ksplat": ksplat.read_ksplat,
            "pt": checkpoint.read_checkpoint,
        }
        return readers[self.format](self.path, self._whole, max_bytes)


@contextmanager
def open_scene(path: str | Path, shift: Shift | None = None) -> Iterator[SceneFile]:
    """Open the file of a scene, in any format; raises as `opened` does."""
    with opened(path) as data:
        yield SceneFile(Path(path), data, shift)


@dataclass(frozen=True)
class Overview:
    """Summary of a scene.

    Attributes
    ----------
    format : str
        ``ply``, ``compressed ply``, ``splat``, ``spz``, ``sog``, ``streamed sog``, ``gltf``,
        ``usd``, ``ksplat`` or ``pt``.
    count, sh_degree : int
        Number of Gaussians, and their SH degree.
    bounds : tuple of two tuples of float, or None
        Lowest and highest x, y, z of the finite centres; None if there are none.
    coordinates : str or None
        Directions of x, y and z as three letters (such as ``RUB``), if the file or its format
        states them.
    antialiased : bool
        Whether it asks for opacity compensation.
    extra : tuple of str
        Names of extra properties.
    file_bytes, raw_bytes : int
        Bytes of all its files, and of the attributes as float32.
    """

    format: str
    count: int
    sh_degree: int
    bounds: Box | None
    coordinates: str | None
    antialiased: bool
    extra: tuple[str, ...]
    file_bytes: int
    raw_bytes: int

    def as_dict(self) -> dict:
        """The same as plain types, for JSON."""
        return asdict(self)


def overview_of(path: str | Path, max_bytes: int | None = None) -> Overview:
    """Read a scene of any format but `.egs`, and summarise it; raises as `SceneFile.scene` does."""
    return read_with_overview(path, max_bytes)[1]


def check_file(path: str | Path, max_bytes: int | None = None) -> None:
    """Read what `SceneFile.scene` leaves out, coarser levels; raises as it does."""
    with open_scene(path) as file:
        if file.format == "streamed sog":
            streamed_sog.check_coarser(file.path, file.data[:], max_bytes)


def read_with_overview(path: str | Path, max_bytes: int | None = None) -> tuple[Scene, Overview]:
    """A scene of any format but `.egs`, in its own coordinate system, and its summary."""
    with open_scene(path) as file:
        scene, file_bytes = file.scene("keep", max_bytes), file.stored_bytes
        name = "compressed ply" if file.format == "ply" and file.is_compressed else file.format
    return scene, Overview(
        name,
        scene.count,
        scene.sh_degree,
        centre_bounds(scene.positions),
        scene.coordinates,
        scene.antialiased,
        tuple(scene.extra),
        file_bytes,
        scene.float_bytes,
    )
