"""Every format of scenes: suffixes, signatures, readers and writers, what it holds.

A format is added by a module that reads and writes it, and by its `SceneFormat` here. Commands,
suffixes, recognition, conversion, batches and help ask these. They are in a module of their own
because `--help` and options ask them, too: no reader is imported before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from gs_codec.runtime.lazy import Lazy

#: File name of a SOG scene that is a folder of files, not a zip.
UNBUNDLED = "meta.json"

#: File name of a streamed SOG scene, which has coarser levels.
STREAMED = "lod-meta.json"

#: Suffix of a zip of a streamed SOG scene.
SSOG = ".ssog"

#: First bytes of a zip.
ZIP = b"PK\x03\x04"

#: What a format may hold beside the floats of its Gaussians.
PROPERTIES = "extra properties"
COMMENTS = "comments"
FLAG = "antialias flag"


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneFormat:
    """A format of scenes.

    Attributes
    ----------
    name : str
        In reports, and for ``--input-format``.
    read : tuple of str
        Suffixes of the files that are read.
    signatures, short_signatures : tuple of bytes
        First bytes of its files. Short ones may begin a file of another format by chance: they do
        not count for files with a suffix of `unmarked`.
    unmarked : mapping of str to str
        Suffixes of files without signature, and which text they are (``JSON``, or none: "").
    recognises : callable, optional
        Whether a file is of this format, if others begin with the same bytes: ``(path, data)``.
    reader : callable, optional
        ``(path, data, max_bytes) -> Scene``; `.egs` and PLY are read otherwise.
    stated_size : callable, optional
        Number of Gaussians and SH degree by the header: ``(path, data)``.
    stored_bytes : callable, optional
        Bytes of all files of a scene, if there are several: ``(path, data)``.
    checker : callable, optional
        Reads what `reader` leaves out: ``(path, data, max_bytes)``.
    opens_file : bool
        Whether its reader reads from the file itself, so that not all bytes are read before.
    written : mapping of str to mapping
        Suffixes, or names, of the files that are written, and what of `writer`'s arguments they
        stand for.
    writes : {"steps", "fixed", "floats", "levels"}
        What is written: values rounded to step sizes, which profiles choose; values at the format's
        own precision; uncompressed floats; or, by `convert` alone, coarser levels, too.
    writer : callable, optional
        Of ``floats``: ``(path, scene)``, returns in words what the format cannot hold. Of ``fixed``
        and ``steps``: ``(scene)``, and ``steps=`` an `AttributeSteps` or None; returns the bytes of
        a file, and the same. `.egs` and streamed SOG are written otherwise.
    options : mapping of str to str
        Fields of `Config` that only this format has, and which of `writer`'s arguments they are.
    coded_as : str, optional
        The format in `Config`, if that is not the suffix without its dot.
    rounding : str
        In words, what writing rounds.
    is_rounded : bool
        Whether all values but a few are rounded.
    keeps : tuple of str
        Which of `PROPERTIES`, `COMMENTS` and `FLAG` it holds.
    sh_degrees : mapping of str to int
        SH degree of what is written, by suffix, where there is but one.
    system : str
        Its coordinate system, as three letters; empty if files may have any.
    sorts : bool
        Whether Gaussians are written in Morton order.
    sh_grid : callable, optional
        The `ShGrid` of so many Gaussians, if rounding SH-AC to the nearest is not best.
    in_parts : bool
        Whether it is written part by part, below a memory limit.
    in_folders : tuple of str, optional
        Suffixes of the files in a folder that are scenes of a batch; by default, all that are read.
    floats_per_byte : int
        Bytes of raw floats for each byte of a file, about.
    require : callable, optional
        Raises `MissingTool` if a package that it needs is not installed.
    """

    name: str
    read: tuple[str, ...] = ()
    signatures: tuple[bytes, ...] = ()
    short_signatures: tuple[bytes, ...] = ()
    unmarked: Mapping[str, str] = field(default_factory=dict)
    recognises: Callable[..., bool] | None = None
    reader: Callable[..., Any] | None = None
    stated_size: Callable[..., tuple[int, int]] | None = None
    stored_bytes: Callable[..., int] | None = None
    checker: Callable[..., None] | None = None
    opens_file: bool = False
    written: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    writes: Literal["steps", "fixed", "floats", "levels"] = "fixed"
    writer: Callable[..., Any] | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    coded_as: str | None = None
    rounding: str = ""
    is_rounded: bool = False
    keeps: tuple[str, ...] = ()
    sh_degrees: Mapping[str, int] = field(default_factory=dict)
    system: str = ""
    sorts: bool = False
    sh_grid: Callable[..., Any] | None = None
    in_parts: bool = False
    in_folders: tuple[str, ...] | None = None
    floats_per_byte: int = 1
    require: Callable[[], None] | None = None

    @property
    def is_exact(self) -> bool:
        """Whether it is encoded to, and yet holds all floats."""
        return self.writes == "fixed" and not self.is_rounded

    @property
    def batched(self) -> tuple[str, ...]:
        """Suffixes of the files in a folder that are scenes of a batch."""
        return self.read if self.in_folders is None else self.in_folders

    def check_installed(self) -> None:
        """Raise `MissingTool` if a package that it needs is not installed."""
        if self.require is not None:
            self.require()

    def code(self, suffix: str) -> str:
        """The format in `Config` of a suffix that is written."""
        return self.coded_as or suffix.removeprefix(".")


def _ours(module: str, name: str) -> Lazy:
    return Lazy(f"gs_codec.formats.{module}", name)


PLY = SceneFormat(
    name="ply",
    read=(".ply",),
    signatures=(b"ply\n", b"ply\r", b"\xef\xbb\xbfply"),
    written={".ply": {}},
    writes="floats",
    writer=_ours("ply.writer", "write_ply"),
    keeps=(PROPERTIES, COMMENTS, FLAG),
    in_parts=True,
)

EGS = SceneFormat(
    name="egs",
    read=(".egs",),
    signatures=(b"\x89EGS\r\n\x1a\n",),
    written={".egs": {}},
    writes="steps",
    keeps=(PROPERTIES, COMMENTS, FLAG),
    in_parts=True,
    floats_per_byte=30,
)

SPZ = SceneFormat(
    name="spz",
    read=(".spz",),
    signatures=(b"NGSP",),
    short_signatures=(b"\x1f\x8b\x08",),  # gzip
    reader=_ours("spz.scene", "read_spz"),
    stated_size=_ours("spz.file", "stated_size"),
    written={".spz": {}},
    writes="steps",
    writer=_ours("spz.scene", "pack_spz"),
    options={"spz_version": "version"},
    rounding="opacity, colours, scales and SH rounded to 8 bits, rotations to 10",
    is_rounded=True,
    keeps=(FLAG,),
    system="RUB",
    sorts=True,
    floats_per_byte=20,
)

SOG = SceneFormat(
    name="sog",
    read=(".sog", ".json"),
    signatures=(ZIP,),
    short_signatures=(b"{",),
    reader=_ours("sog.scene", "read_sog"),
    stated_size=_ours("sog.scene", "stated_size"),
    stored_bytes=_ours("sog.scene", "sog_bytes"),
    written={".sog": {}, UNBUNDLED: {}},
    writes="steps",
    writer=_ours("sog.writer", "pack_sog"),
    coded_as="sog",
    rounding="centres rounded to 16 bits, other values to 8, SH to rows of a palette",
    is_rounded=True,
    keeps=(FLAG,),
    sorts=True,
    in_folders=(".sog",),
    floats_per_byte=20,
)

#: PlayCanvas' PLY of packed properties, which the header of a PLY tells from others.
COMPRESSED_PLY = SceneFormat(
    name="compressed ply",
    written={".compressed.ply": {}},
    writer=_ours("ply.packed", "pack_ply"),
    rounding="centres and scales rounded to 10 or 11 bits of a chunk's range, other values to 8 "
    "or 10",
    is_rounded=True,
    keeps=(FLAG,),
    sorts=True,
    sh_grid=_ours("ply.packed", "sh_grid"),
    floats_per_byte=5,
)

SPLAT = SceneFormat(
    name="splat",
    read=(".splat",),
    unmarked={".splat": ""},
    reader=_ours("splat", "read_splat"),
    stated_size=_ours("splat", "stated_size"),
    written={".splat": {}},
    writer=_ours("splat", "pack_splat"),
    rounding="opacity, colour and rotation rounded to 8 bits",
    is_rounded=True,
    sh_degrees={".splat": 0},
    floats_per_byte=2,
)

KSPLAT = SceneFormat(
    name="ksplat",
    read=(".ksplat",),
    unmarked={".ksplat": ""},
    reader=_ours("ksplat", "read_ksplat"),
    stated_size=_ours("ksplat", "stated_size"),
    is_rounded=True,
    floats_per_byte=4,
)

GLTF = SceneFormat(
    name="gltf",
    read=(".glb", ".gltf"),
    signatures=(b"glTF",),
    unmarked={".gltf": "JSON"},
    reader=_ours("gltf.scene", "read_gltf"),
    stated_size=_ours("gltf.scene", "stated_size"),
    written={".glb": {}, ".gltf": {"as_text": True}},
    writer=_ours("gltf.scene", "pack_gltf"),
    rounding="opacity and scales in linear form, rotations of unit length, each rounded once",
    system="LUF",
    in_folders=(".glb",),
)

USD = SceneFormat(
    name="usd",
    read=(".usd", ".usda", ".usdc", ".usdz"),
    signatures=(b"#usda", b"PXR-USDC", ZIP),
    recognises=_ours("usd.scene", "is_usd"),
    reader=_ours("usd.scene", "read_usd"),
    stated_size=_ours("usd.scene", "stated_size"),
    written={suffix: {"suffix": suffix} for suffix in (".usd", ".usda", ".usdc", ".usdz")},
    writer=_ours("usd.scene", "pack_usd"),
    rounding=GLTF.rounding,
    system="RUB",
    require=_ours("usd.scene", "require_usd_core"),
)

#: Checkpoints of gsplat (`.pt`) and splatfacto (`.ckpt`). Those in folders may be anything.
CHECKPOINT = SceneFormat(
    name="pt",
    read=(".pt", ".ckpt"),
    signatures=(ZIP,),
    recognises=_ours("checkpoint", "is_checkpoint"),
    reader=_ours("checkpoint", "read_checkpoint"),
    stated_size=_ours("checkpoint", "stated_size"),
    opens_file=True,
    written={".pt": {}, ".ckpt": {}},
    writes="floats",
    writer=_ours("checkpoint", "write_checkpoint"),
    sh_degrees={".ckpt": 3},
    in_folders=(),
)

CSV = SceneFormat(
    name="csv",
    written={".csv": {}},
    writes="floats",
    writer=_ours("csv_table", "write_csv"),
    keeps=(PROPERTIES,),
    in_parts=True,
)

STREAMED_SOG = SceneFormat(
    name="streamed sog",
    read=(SSOG,),
    signatures=(ZIP,),
    short_signatures=(b"{",),
    recognises=_ours("sog.streamed", "is_streamed"),
    reader=_ours("sog.streamed", "read_streamed"),
    stated_size=_ours("sog.streamed", "stated_size"),
    stored_bytes=_ours("sog.streamed", "streamed_bytes"),
    checker=_ours("sog.streamed", "check_coarser"),
    written={SSOG: {}, STREAMED: {}},
    writes="levels",
    coded_as="sog",
    is_rounded=True,
    keeps=(FLAG,),
    floats_per_byte=20,
)

#: All of them, in the order in which commands list them.
FORMATS = (
    PLY,
    EGS,
    SPZ,
    SOG,
    COMPRESSED_PLY,
    SPLAT,
    KSPLAT,
    GLTF,
    USD,
    CHECKPOINT,
    CSV,
    STREAMED_SOG,
)


def written(*writes: str) -> tuple[str, ...]:
    """Suffixes, or names, of the files that are written so; see `SceneFormat.writes`."""
    return tuple(s for each in FORMATS if each.writes in writes for s in each.written)


def read() -> tuple[str, ...]:
    """Suffixes of the files that are read."""
    return tuple(suffix for each in FORMATS for suffix in each.read)


def read_names() -> tuple[str, ...]:
    """Suffixes and names of the files that are read, as help lists them."""
    return tuple(
        name
        for each in FORMATS
        if each.read
        for name in dict.fromkeys((*each.written, *each.read))
        if name != ".json"
    )


def unmarked_names() -> tuple[str, ...]:
    """Names of formats whose files may be without signature."""
    return tuple(each.name for each in FORMATS if each.unmarked)


def format_of_file(name: str) -> SceneFormat | None:
    """The format of the longest suffix of a file's name; None if that is of no format."""
    known = (suffix for each in FORMATS for suffix in (*each.written, *each.read))
    suffix = max((s for s in known if name.lower().endswith(s)), key=len, default="")
    return format_of(suffix) if suffix else None


def format_of(suffix: str) -> SceneFormat:
    """The format that is written to files of a suffix, or else is read from them."""
    found = [each for each in FORMATS if suffix in each.written]
    found += [each for each in FORMATS if suffix in each.read]
    return found[0]
