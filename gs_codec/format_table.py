"""The table of scene formats: suffixes, signatures, readers, writers, and capabilities.

A format is added by a module that reads and writes it, and by its `SceneFormat` here. Commands,
suffixes, recognition, conversion, batches and help use this table. It is a separate module because
`--help` and options use it too; readers are imported only on use.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from gs_codec.runtime.lazy import Lazy

#: File name of a SOG scene that is a folder of files, not a zip.
UNBUNDLED = "meta.json"

#: File name of a streamed SOG scene, which has coarser levels.
STREAMED = "lod-meta.json"

#: Suffix of a zip of a streamed SOG scene.
SSOG = ".ssog"

#: File name of a scene as 3D Tiles.
TILESET = "tileset.json"

#: First bytes of a zip.
ZIP = b"PK\x03\x04"

#: Data other than the floats of Gaussians that a format may hold.
PROPERTIES = "extra properties"
COMMENTS = "comments"
FLAG = "antialias flag"
FLAT_FLAG = "2DGS flag"


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneFormat:
    """A format of scenes.

    Attributes
    ----------
    name : str
        Name in reports, and for ``--input-format``.
    read : tuple of str
        Suffixes of readable files.
    signatures, short_signatures : tuple of bytes
        First bytes of its files. Short ones may begin a file of another format by chance, so they
        do not count for files with a suffix in `unmarked`.
    unmarked : mapping of str to str
        Suffixes of files without signature, and the kind of text in them (``JSON``, or "" for
        none).
    recognises : callable, optional
        ``(path, data)`` -> whether a file has this format, if others begin with the same bytes.
    reader : callable, optional
        ``(path, data, max_bytes) -> Scene``; `.egs` and PLY are read differently.
    stated_size : callable, optional
        ``(path, data)`` -> number of Gaussians and SH degree from the header.
    files_beside : callable, optional
        ``(path, FileBytes)`` -> paths of the other files of a scene, if it may have several.
    coarser_files : callable, optional
        ``(path, FileBytes)`` -> paths of the files of coarser levels that are never read.
    checker : callable, optional
        ``(path, data, max_bytes)``: reads what `reader` skips.
    opens_file : bool
        Whether its reader reads from the open file, instead of getting all bytes.
    written : mapping of str to mapping
        Suffixes, or names, of output files, and the arguments of `writer` that they imply.
    writes : {"steps", "fixed", "floats", "levels"}
        Kind of output: values rounded to step sizes chosen by profiles; values at the format's own
        precision; uncompressed floats; or, only with `convert`, also coarser levels.
    writer : callable, optional
        For ``floats``: ``(path, scene)``, returns sentences on what the format cannot represent.
        For ``fixed`` and ``steps``: ``(scene)``, with ``steps=`` an `AttributeSteps` or None;
        returns the bytes of a file, and these sentences. `.egs` and streamed SOG are written
        differently.
    options : mapping of str to str
        Fields of `Config` that only some formats have, and the corresponding arguments of `writer`;
        "" if it needs none.
    coded_as : str, optional
        The format in `Config`, if that is not the suffix without its dot.
    rounding : str
        Description of what writing rounds.
    is_rounded : bool
        Whether nearly all values are rounded.
    keeps : tuple of str
        Which of `PROPERTIES`, `COMMENTS`, `FLAG` and `FLAT_FLAG` it can represent.
    sh_degrees : mapping of str to int
        The only SH degree that is written, by suffix, if there is only one.
    system : str
        Its coordinate system, as three letters; empty if files may have any.
    sorts : bool
        Whether Gaussians are written in Morton order.
    order : callable, optional
        The index in a scene of each Gaussian of its file, for any other order.
    sh_grid : callable, optional
        The `ShGrid` for a number of Gaussians, if rounding SH-AC to the nearest level is not best.
    in_parts : bool
        Whether it is written part by part, below a memory limit.
    in_folders : tuple of str, optional
        Suffixes of files in a folder that a batch treats as scenes; by default, all readable ones.
    floats_per_byte : int
        Approximate bytes of raw floats per byte of a file.
    require : callable, optional
        Raises `MissingTool` if a package that it needs is not installed.
    variants : mapping of str to SceneFormat
        The format by the value of ``Config.gltf_compression``, if that changes it.
    variant_of : callable, optional
        ``(path, data)`` -> key in `variants` of a file; "" if it has none.
    """

    name: str
    read: tuple[str, ...] = ()
    signatures: tuple[bytes, ...] = ()
    short_signatures: tuple[bytes, ...] = ()
    unmarked: Mapping[str, str] = field(default_factory=dict)
    recognises: Callable[..., bool] | None = None
    reader: Callable[..., Any] | None = None
    stated_size: Callable[..., tuple[int, int]] | None = None
    files_beside: Callable[..., list[Path]] | None = None
    coarser_files: Callable[..., list[Path]] | None = None
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
    order: Callable[..., Any] | None = None
    sh_grid: Callable[..., Any] | None = None
    in_parts: bool = False
    in_folders: tuple[str, ...] | None = None
    floats_per_byte: int = 1
    require: Callable[[], None] | None = None
    variants: Mapping[str, SceneFormat] = field(default_factory=dict)
    variant_of: Callable[..., str] | None = None

    @property
    def is_exact(self) -> bool:
        """Whether it is an encoded format that keeps all floats exactly."""
        return self.writes == "fixed" and not self.is_rounded

    @property
    def batched(self) -> tuple[str, ...]:
        """Suffixes of files in a folder that a batch treats as scenes."""
        return self.read if self.in_folders is None else self.in_folders

    def check_installed(self) -> None:
        """Raise `MissingTool` if a package that it needs is not installed."""
        if self.require is not None:
            self.require()

    def code(self, suffix: str) -> str:
        """The format in `Config` for an output suffix."""
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
    keeps=(PROPERTIES, COMMENTS, FLAG, FLAT_FLAG),
    in_parts=True,
)

EGS = SceneFormat(
    name="egs",
    read=(".egs",),
    signatures=(b"\x89EGS\r\n\x1a\n",),
    written={".egs": {}},
    writes="steps",
    options={"effort": "effort", "block_size": ""},
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
    options={"spz_version": "version", "effort": "effort"},
    rounding="opacity, colours, scales and SH rounded to 8 bits, rotations to 10",
    is_rounded=True,
    keeps=(FLAG,),
    system="RUB",
    sorts=True,
    floats_per_byte=20,
    in_parts=True,
)

SOG = SceneFormat(
    name="sog",
    read=(".sog", ".json"),
    signatures=(ZIP,),
    short_signatures=(b"{",),
    reader=_ours("sog.scene", "read_sog"),
    stated_size=_ours("sog.scene", "stated_size"),
    files_beside=_ours("sog.scene", "files_beside"),
    written={".sog": {}, UNBUNDLED: {}},
    writes="steps",
    writer=_ours("sog.writer", "pack_sog"),
    options={"effort": "effort"},
    coded_as="sog",
    rounding="centres rounded to 16 bits, other values to 8, SH to rows of a palette",
    is_rounded=True,
    keeps=(FLAG, FLAT_FLAG),
    sorts=True,
    in_folders=(".sog",),
    floats_per_byte=20,
    in_parts=True,
)

#: PlayCanvas's PLY of packed properties, recognised by the header of a PLY.
COMPRESSED_PLY = SceneFormat(
    name="compressed ply",
    read=(".compressed.ply",),
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

#: Spark's tree of levels of detail. A `.radc` is a part of one, next to its `.rad`.
RAD = SceneFormat(
    name="rad",
    read=(".rad", ".radc"),
    signatures=(b"RAD0", b"RADC"),
    reader=_ours("rad.scene", "read_rad"),
    stated_size=_ours("rad.scene", "stated_size"),
    files_beside=_ours("rad.scene", "files_beside"),
    opens_file=True,
    written={".rad": {}},
    writes="steps",
    writer=Lazy("gs_codec.levels.tree", "pack_rad"),
    options={"effort": "effort"},
    rounding="opacity, colours, scales, rotations and SH rounded to 8 bits",
    is_rounded=True,
    order=Lazy("gs_codec.levels.tree", "leaf_order"),
    in_folders=(".rad",),
    floats_per_byte=20,
)

#: glTF of which the attributes are in an `.spz`.
GLTF_SPZ = SceneFormat(
    name="gltf spz",
    written={".glb": {}, ".gltf": {"as_text": True}},
    writes="steps",
    writer=_ours("gltf.compressed", "pack_gltf_spz"),
    options={"gltf_compression": "", "effort": "effort"},
    rounding=SPZ.rounding,
    is_rounded=True,
    keeps=SPZ.keeps,
    system="LUF",
    sorts=True,
)

#: XGRIDS' scenes, described by JSON next to other files.
LCC = SceneFormat(
    name="lcc",
    read=(".lcc", ".lcc2"),
    short_signatures=(b"{",),
    recognises=_ours("lcc.scene", "is_lcc"),
    reader=_ours("lcc.scene", "read_lcc"),
    stated_size=_ours("lcc.scene", "stated_size"),
    files_beside=_ours("lcc.scene", "files_beside"),
    coarser_files=_ours("lcc.scene", "coarser_files"),
    is_rounded=True,
    system="RFU",
    floats_per_byte=20,
)

GLTF = SceneFormat(
    name="gltf",
    read=(".glb", ".gltf"),
    signatures=(b"glTF",),
    unmarked={".gltf": "JSON"},
    reader=_ours("gltf.scene", "read_gltf"),
    stated_size=_ours("gltf.scene", "stated_size"),
    files_beside=_ours("gltf.scene", "files_beside"),
    written={".glb": {}, ".gltf": {"as_text": True}},
    writer=_ours("gltf.scene", "pack_gltf"),
    options={"gltf_compression": ""},
    rounding="opacity and scales in linear form, rotations of unit length, each rounded once",
    system=GLTF_SPZ.system,
    in_folders=(".glb",),
    floats_per_byte=SPZ.floats_per_byte,
    variants={"spz": GLTF_SPZ},
    variant_of=_ours("gltf.scene", "variant_of"),
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

#: Checkpoints of gsplat (`.pt`), splatfacto (`.ckpt`) and INRIA's trainer (`.pth`). Files with
#: these suffixes in folders may be anything.
CHECKPOINT = SceneFormat(
    name="pt",
    read=(".pt", ".ckpt", ".pth"),
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

#: The `config.yml` of a run of nerfstudio stands for its newest checkpoint.
NERFSTUDIO_RUN = SceneFormat(
    name="nerfstudio run",
    read=(".yml",),
    signatures=(b"!!python/object:nerfstudio.",),
    reader=_ours("nerfstudio_run", "read_run"),
    stated_size=_ours("nerfstudio_run", "stated_size"),
    files_beside=_ours("nerfstudio_run", "files_beside"),
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

COLLISION_MESH = SceneFormat(
    name="collision mesh",
    written={".collision.glb": {}},
    writes="floats",
    writer=_ours("collision_mesh", "write_collision_mesh"),
    system=GLTF.system,
)

STREAMED_SOG = SceneFormat(
    name="streamed sog",
    read=(SSOG,),
    signatures=(ZIP,),
    short_signatures=(b"{",),
    recognises=_ours("sog.streamed", "is_streamed"),
    reader=_ours("sog.streamed", "read_streamed"),
    stated_size=_ours("sog.streamed", "stated_size"),
    files_beside=_ours("sog.streamed", "files_beside"),
    checker=_ours("sog.streamed", "check_coarser"),
    written={SSOG: {}, STREAMED: {}},
    writes="levels",
    options={"effort": "effort", "block_size": "", "lod_levels": ""},
    coded_as="sog",
    is_rounded=True,
    keeps=(FLAG,),
    floats_per_byte=20,
    in_parts=True,
)

TILES = SceneFormat(
    name="3d tiles",
    read=(".3tz", TILESET),
    signatures=(ZIP,),
    short_signatures=(b"{",),
    recognises=_ours("tiles.tileset", "is_tileset"),
    reader=_ours("tiles.tileset", "read_tiles"),
    stated_size=_ours("tiles.tileset", "stated_size"),
    files_beside=_ours("tiles.tileset", "files_beside"),
    checker=_ours("tiles.tileset", "check_all"),
    opens_file=True,
    written={TILESET: {}},
    writes="levels",
    options={"effort": "effort"},
    coded_as="spz",
    rounding=SPZ.rounding,
    is_rounded=True,
    keeps=SPZ.keeps,
    system="RUB",
    in_folders=(".3tz",),
    floats_per_byte=SPZ.floats_per_byte,
)

#: All formats, in the order in which commands list them.
FORMATS = (
    PLY,
    EGS,
    SPZ,
    SOG,
    COMPRESSED_PLY,
    SPLAT,
    KSPLAT,
    RAD,
    LCC,
    GLTF,
    USD,
    CHECKPOINT,
    NERFSTUDIO_RUN,
    CSV,
    COLLISION_MESH,
    STREAMED_SOG,
    TILES,
)

#: Suffixes of files in folders that are scenes, besides `.egs`.
BATCHED = tuple(suffix for known in FORMATS if known is not EGS for suffix in known.batched)


def written(*writes: str) -> tuple[str, ...]:
    """Suffixes, or names, of output files of these kinds; see `SceneFormat.writes`."""
    return tuple(s for each in FORMATS if each.writes in writes for s in each.written)


def read() -> tuple[str, ...]:
    """Suffixes of readable files."""
    return tuple(suffix for each in FORMATS for suffix in each.read)


def read_names() -> tuple[str, ...]:
    """Suffixes and names of readable files, as listed in help."""
    return tuple(
        name
        for each in FORMATS
        if each.read
        for name in dict.fromkeys((*each.written, *each.read))
        if name != ".json"
    )


def unmarked_names() -> tuple[str, ...]:
    """Names of formats whose files may have no signature."""
    return tuple(each.name for each in FORMATS if each.unmarked)


def format_of_file(name: str) -> SceneFormat | None:
    """The format of the longest matching suffix of a file name; None if there is none."""
    known = (suffix for each in FORMATS for suffix in (*each.written, *each.read))
    suffix = max((s for s in known if name.lower().endswith(s)), key=len, default="")
    return format_of(suffix) if suffix else None


def format_of(suffix: str) -> SceneFormat:
    """The format written to files with a suffix, or else read from them."""
    found = [each for each in FORMATS if suffix in each.written]
    found += [each for each in FORMATS if suffix in each.read]
    return found[0]
