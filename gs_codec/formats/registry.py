"""Recognise scene formats by content, then by suffix; read scenes in any format except `.egs`."""

from __future__ import annotations

import logging
import sys
from codecs import BOM_UTF8
from collections.abc import Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from gs_codec.coding.clean import finite_ends, with_finite_ends
from gs_codec.coding.extent import centre_bounds
from gs_codec.config import Extra
from gs_codec.egs.index import Box
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.format_table import (
    COMPRESSED_PLY,
    FORMATS,
    PLY,
    TILES,
    TILESET,
    SceneFormat,
    read,
    unmarked_names,
)
from gs_codec.formats.ply.body import Ply, ply_of
from gs_codec.formats.ply.file import scene_of
from gs_codec.formats.ply.packed import is_packed
from gs_codec.formats.ply.packed import stated_size as packed_size
from gs_codec.formats.several_scenes import refuse_several
from gs_codec.runtime.guess import LOOKED_AT, looks_like, text_kind
from gs_codec.runtime.kept_logs import keeping_logs, keeping_new
from gs_codec.runtime.mapped import FileBytes, opened, total_bytes
from gs_codec.runtime.wording import listed
from gs_codec.scene import Scene, Shift, float_bytes

#: Suffixes of readable files.
SUFFIXES = read()

#: First character of JSON, maybe after a byte order mark and blank lines.
_JSON = b"{"

#: Loggers of readers that warn of what files written here may have, too: flat Gaussians, or a place
#: on the earth.
_WARNING = ("gs_codec.formats.ply.dialects", "gs_codec.formats.tiles.tileset")

#: Loggers of readers that warn of what many files of a scene or sequence may have.
_OF_CONTENT = (
    "gs_codec.formats.extra_properties",
    "gs_codec.formats.gltf.scene",
    "gs_codec.formats.ply.dialects",
)

#: Formats with a `recognises` function are tried first.
_BY_CONTENT = sorted(FORMATS, key=lambda known: known.recognises is None)
_BY_SUFFIX = {suffix: known for known in FORMATS for suffix in known.read}


@dataclass(frozen=True)
class SceneFile:
    """An open file of a scene: its format, header and scene.

    Attributes
    ----------
    path : Path
    data : FileBytes
        The bytes of the file.
    shift : tuple of three float, optional
        Translation of centres before rounding; see `has_doubles`.
    level : int
        Level of detail to read; only `.egs` and 3D Tiles have coarser ones than 0.
    """

    path: Path
    data: FileBytes
    shift: Shift | None = None
    level: int = 0

    @cached_property
    def format(self) -> str:
        """The format, recognised by content, then by suffix; `InvalidInput` if neither succeeds."""
        return self._recognised.name

    @cached_property
    def _recognised(self) -> SceneFormat:
        head, suffix = bytes(self.data[:LOOKED_AT]), self.path.suffix.lower()
        if found := looks_like(head):
            raise InvalidInput(f"{self.path}: {found}")
        by_suffix = _BY_SUFFIX.get(suffix)
        unmarked = {} if by_suffix is None else by_suffix.unmarked
        text = head.removeprefix(BOM_UTF8).lstrip()
        for known in _BY_CONTENT:
            begins = known.signatures
            if suffix not in unmarked:
                begins += known.short_signatures
            marked = head.startswith(begins) or (_JSON in begins and text.startswith(_JSON))
            if marked and (known.recognises is None or known.recognises(self.path, self.data)):
                return known
        if by_suffix is None:
            needing = listed(unmarked_names(), "and")
            hint = "" if suffix else f"; stdin needs --input-format for {needing}"
            raise InvalidInput(
                f"{self.path}: begins with {head[:4]!a}, expected {', '.join(SUFFIXES)} of a "
                f"scene{hint}"
            )
        kind = text_kind(head) if suffix in unmarked else ""
        if kind and kind != unmarked[suffix]:
            raise InvalidInput(f"{self.path}: {kind}, not a {suffix} scene")
        return by_suffix

    @cached_property
    def scene_format(self) -> SceneFormat:
        """The format's description; compressed PLY and glTF have their own."""
        known = self._recognised
        if known.variant_of is not None:
            return known.variants.get(known.variant_of(self.path, self._whole), known)
        packed = known is PLY and is_packed(self.ply.header)
        return COMPRESSED_PLY if packed else known

    @cached_property
    def _whole(self) -> Any:
        """All bytes, unless the reader reads from the file itself."""
        return self.data if self._recognised.opens_file else self.data[:]

    @cached_property
    def ply(self) -> Ply:
        """The file as a PLY, with its header read."""
        return ply_of(self.path, self.data)

    @property
    def is_compressed(self) -> bool:
        """Whether the file is in a compressed format, which is any except plain PLY."""
        return self.scene_format is not PLY

    @property
    def has_doubles(self) -> bool:
        """Whether it is a PLY file with float64 centres."""
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
        """Size of the scene in bytes: of all its files."""
        return len(self.data) + total_bytes(self.files_beside)

    @property
    def files_beside(self) -> list[Path]:
        """The other files of the scene, whether they exist or not."""
        beside = self._recognised.files_beside
        return [] if beside is None else beside(self.path, self.data)

    @property
    def parts(self) -> list[Path]:
        """`files_beside`, and the files of coarser levels that are never read."""
        coarser = self._recognised.coarser_files
        return self.files_beside + ([] if coarser is None else coarser(self.path, self.data))

    def ratio_bytes(self, raw_bytes: int) -> int:
        """Reference size for ratios: of a PLY, or of the floats (`raw_bytes`) if compressed."""
        return raw_bytes if self.is_compressed else self.stored_bytes

    def stated_size(self) -> tuple[int, int]:
        """Number of Gaussians and SH degree from the header, except of `.egs` and PLY."""
        assert self._recognised.stated_size is not None
        return self._recognised.stated_size(self.path, self._whole)

    def stated_bytes(self) -> int:
        """Bytes of floats stated in the header (not for `.egs`); reads only the header."""
        if self._recognised.stated_size is not None:
            return float_bytes(*self.stated_size())
        header = self.ply.header
        if is_packed(header):
            return float_bytes(*packed_size(header))
        vertex = header.elements.get("vertex")
        return 0 if vertex is None else 4 * vertex.count * len(vertex.types)

    def scene(
        self, extra: Extra = "keep", max_bytes: int | None = None, exact: bool = False
    ) -> Scene:
        """Read a scene in any format except `.egs`; `extra` and `max_bytes` are as in `read_ply`.

        Valid infinities become finite (see `finite_ends`), unless `exact`. Raises InvalidInput if
        it is not a valid file of its format, or decodes to more than `max_bytes`.
        """
        with saying_once(set()):
            scene = self._scene(extra, max_bytes)
        return scene if exact else with_finite_ends(scene, self.path)

    def _scene(self, extra: Extra, max_bytes: int | None) -> Scene:
        if self.level and self._recognised is not TILES:
            raise InvalidInput(f"{self.path}: level: expected an .egs or a {TILESET}")
        if (reader := self._recognised.reader) is not None:
            coarser = (self.level,) if self.level else ()
            scene = reader(self.path, self._whole, max_bytes, *coarser)
        else:
            scene = scene_of(self.ply, extra, max_bytes, shift=self.shift)
        self.data.check_unchanged()
        return scene


@contextmanager
def open_scene(path: str | Path, shift: Shift | None = None, level: int = 0) -> Iterator[SceneFile]:
    """Open the file of a scene, in any format; raises like `opened`, and if it holds several."""
    refuse_several(path)
    with opened(path) as data:
        yield SceneFile(Path(path), data, shift, level)


def read_written(path: Path) -> Scene:
    """Read a file that was just written, of any size; this thread logs no warnings of its content.

    Valid infinities become finite, also without a warning.
    """
    with keeping_logs(_WARNING, lambda record: False), open_scene(path) as file:
        return finite_ends(file.scene(max_bytes=sys.maxsize, exact=True))[0]


def saying_once(said: set[Hashable]) -> AbstractContextManager[None]:
    """Log warnings that begin with the name of a file only if they are not `said` of another."""

    def content(record: logging.LogRecord) -> Hashable:
        _, *rest = record.args or ("",)
        return record.msg, *rest

    return keeping_new(_OF_CONTENT, said, content)


def scene_files(path: str | Path) -> list[Path]:
    """All files of a scene in any format: this one, and those that it refers to, if it is valid."""
    with suppress(GsCodecError), open_scene(path) as file:
        return [file.path, *file.files_beside]
    return [Path(path)]


@dataclass(frozen=True)
class Overview:
    """Summary of a scene.

    Attributes
    ----------
    format : str
        Such as ``compressed ply`` or ``spz``.
    count, sh_degree : int
        Number of Gaussians, and their SH degree.
    bounds : tuple of two tuples of float, or None
        Lowest and highest x, y, z of the finite centres; None if there are none.
    coordinates : str or None
        Directions of x, y and z as three letters (such as ``RUB``), if the file or its format
        states them.
    antialiased : bool
        Whether it uses opacity compensation.
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
    """Read a scene in any format except `.egs`, and summarise it; raises like `SceneFile.scene`."""
    return read_with_overview(path, max_bytes)[1]


def check_file(path: str | Path, max_bytes: int | None = None) -> None:
    """Read the coarser levels, which `SceneFile.scene` skips; raises like it."""
    with open_scene(path) as file:
        if (checker := file.scene_format.checker) is not None:
            with saying_once(set()):
                checker(file.path, file.data[:], max_bytes)


def read_with_overview(path: str | Path, max_bytes: int | None = None) -> tuple[Scene, Overview]:
    """A scene in any format except `.egs`, in its own coordinate system, and its summary."""
    with open_scene(path) as file:
        scene, file_bytes = file.scene("keep", max_bytes), file.stored_bytes
        name = file.scene_format.name
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
