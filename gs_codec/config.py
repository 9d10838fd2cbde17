"""Encoder configuration: profiles and quantisation depths (paper, Table 2)."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args

from gs_codec.errors import InvalidInput
from gs_codec.format_table import FORMATS, SceneFormat, format_of
from gs_codec.runtime.arguments import check_fields
from gs_codec.runtime.wording import listed

#: Handling of properties beyond the INRIA layout.
Extra = Literal["keep", "drop", "error"]

#: Source of the symbol probabilities of a paper profile.
Models = Literal["parametric", "table", "best"]
Coder = Literal["rans", "torchac"]

#: Depth groups in stream order. ``sh-ac`` is accepted as shorthand for the three SH bands.
DEPTH_GROUPS = ("geometry", "sh-dc", "opacity", "scaling", "rotation", "sh1", "sh2", "sh3")

#: Depth groups of SH-AC, one for each band.
SH_STREAMS = DEPTH_GROUPS[5:]

#: Maximum bits of a group: three 21-bit axes fill a Morton code, 12 bits fill a table.
MAX_DEPTH = {group: 21 if group == "geometry" else 12 for group in DEPTH_GROUPS}


@dataclass(frozen=True)
class Option:
    """A command-line option defined by a dataclass field: its values and help text.

    The commands build their options from these, so each option is defined once.

    Parameters
    ----------
    help : str
        One sentence of help text; for a switch that is on by default, the effect of switching it
        off.
    kind : type
        ``bool``, ``int``, ``float``, ``str`` or ``Path``.
    name : str, optional
        The option's name if it differs from the field's.
    metavar : str, optional
        Placeholder of the value in the help.
    shown : str, optional
        The default as the help shows it.
    low, high : float, optional
        Range of the values, both included.
    expected : str, optional
        The range in words.
    alone : int, optional
        Value of the option when typed without one.
    values : mapping or tuple, optional
        Accepted words; a mapping gives the value of each.
    keys : tuple of str
        Accepted keys, if the field is a mapping.
    unit : {"bytes", "bit/s"}, optional
        Values are typed with units: ``5MB``, ``20Mbit/s``.
    expert : bool
        Whether it is an expert option, which the help of most commands lists at its end.
    percent : bool
        Whether a number may be typed with a percent sign.
    """

    help: str
    kind: type = str
    name: str | None = None
    metavar: str | None = None
    shown: str | None = None
    low: float = -math.inf
    high: float = math.inf
    expected: str | None = None
    alone: int | None = None
    values: Mapping[str, Any] | tuple[str, ...] = ()
    keys: tuple[str, ...] = ()
    unit: Literal["bytes", "bit/s"] | None = None
    expert: bool = True
    percent: bool = False

    def check(self, name: str, value: Any) -> None:
        """Reject a value of field `name` that is not in `values`, or out of range."""
        if isinstance(self.values, tuple) and self.values and value not in self.values:
            raise InvalidInput(f"{name} '{value}': expected one of {', '.join(self.values)}")
        if self.kind not in (int, float) or self.keys:
            return
        whole = self.kind is float or isinstance(value, int)
        if not whole or not self.low <= value <= self.high:
            expected = self.expected or f"an integer from {self.low} to {self.high}"
            raise InvalidInput(f"{name} {value}: expected {expected}")


def option(default: Any, help: str, **rest: Any) -> Any:  # noqa: A002
    """A dataclass field with its `Option`; a `default` of ``dict`` means an empty mapping."""
    metadata = {"option": Option(help, **rest)}
    if default is dict:
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


def options_of(settings: Any) -> dict[str, Option]:
    """The options of a dataclass by field name."""
    return {f.name: f.metadata["option"] for f in fields(settings) if "option" in f.metadata}


def changed_options(settings: Any) -> dict[str, Any]:
    """The values of a dataclass that differ from the defaults, by option name."""
    default = type(settings)()
    return {
        described.name or field: value
        for field, described in options_of(settings).items()
        if (value := getattr(settings, field)) != getattr(default, field)
    }


def check_options(settings: Any) -> None:
    """Reject field values of a dataclass that their options do not allow; None is allowed."""
    for name, described in options_of(settings).items():
        if (value := getattr(settings, name)) is not None:
            described.check(name, value)


def _depths(*bits: int) -> Mapping[str, int]:
    return dict(zip(DEPTH_GROUPS, bits, strict=True))


#: Bits per group. The paper's Table 2 gives a range for SH-AC (4-5 / 3-4 / 2-4) and for the
#: geometry of S (15-16); these values were chosen by comparing rendered views
#: (bench/LAB_NOTEBOOK.md).
PROFILES: Mapping[str, Mapping[str, int]] = {
    "paper-l": _depths(17, 8, 8, 8, 8, 5, 5, 5),
    "paper-m": _depths(16, 8, 8, 8, 8, 4, 4, 4),
    "paper-s": _depths(15, 8, 7, 7, 7, 4, 3, 3),
}

#: Options that apply only to paper profiles, in addition to those of G-PCC.
PAPER_OPTIONS = ("models", "laplace_scales", "coder")

#: Maximum depths that G-PCC can code.
GPCC_DEPTHS: Mapping[str, int] = {"geometry": 18, "sh-dc": 8}

#: The bit-exact profile, which has no depths.
LOSSLESS = "lossless"


@dataclass(frozen=True)
class AdaptiveProfile:
    """A profile with a step size for each attribute of each Gaussian, based on visibility.

    Parameters
    ----------
    error : float
        With cameras: mean squared error of an image value (0-1) that quantisation may add,
        assuming that errors add up.
    compaction : float
        With cameras: strength of SH compaction, see `compact_sh`.
    fineness : float
        Without cameras: factor on all step sizes, see `blind_coefficients`.
    of_loss : float
        With cameras: quantisation may also add this share of the error that the (pruned) scene
        already has before coding.
    looks : float
        With cameras: number of views that joint rounding renders per guiding view.
    left : float
        Share of the error that joint rounding leaves; coarser steps make up for it.
    """

    error: float
    compaction: float
    fineness: float
    of_loss: float
    looks: float = 0.0
    left: float = 1.0

    def scaled(self, factor: float) -> AdaptiveProfile:
        """The profile with step sizes multiplied by `factor`; errors scale with its square."""
        square = factor**2
        return replace(
            self,
            error=self.error * square,
            compaction=self.compaction * square,
            fineness=self.fineness * factor,
            of_loss=self.of_loss * square,
        )


#: How long an encode may take.
Effort = Literal["fast", "normal", "high"]

#: Looks of joint rounding, and the share of the error that it leaves; see `AdaptiveProfile`.
_ROUNDING: Mapping[Effort, tuple[float, float]] = {
    "fast": (0.0, 1.0),
    "normal": (1.4, 0.9),
    "high": (4.0, 0.82),
}


_M = AdaptiveProfile(error=2.6e-5, compaction=1.5e-5, fineness=0.0063, of_loss=0.3)

#: Step sizes are 0.5, 1 and 2.25 times those of `m`.
ADAPTIVE_PROFILES: Mapping[str, AdaptiveProfile] = {
    "l": _M.scaled(0.5),
    "m": _M,
    "s": _M.scaled(2.25),
}

PROFILE_CHOICES = (*ADAPTIVE_PROFILES, *PROFILES, LOSSLESS)

#: Long names of the profiles.
PROFILE_WORDS: Mapping[str, str] = {"high": "l", "medium": "m", "low": "s"}

#: Axes that may point up; the first is the default, as in trainers.
UP_AXES = ("-y", "y", "-z", "z", "-x", "x")

#: The profiles as help lists them.
PROFILES_SHOWN = ", ".join(
    [f"{short} ({word})" for word, short in PROFILE_WORDS.items()] + [*PROFILES, LOSSLESS]
)


@dataclass(frozen=True)
class RateTarget:
    """A rate target: a file size, ratio, bits per Gaussian or second, or PSNR loss to meet.

    Files never exceed a size target, and are at most 2 % smaller unless the finest step sizes
    already fit.

    Parameters
    ----------
    size : int, optional
        Maximum file size, in bytes.
    ratio : float, optional
        Minimum compression ratio, relative to the PLY, or to the float32 attributes if the scene
        comes from a compressed file.
    bits : float, optional
        Maximum bits per Gaussian of the input.
    psnr_drop : float, optional
        Maximum PSNR loss in dB, averaged over the views; at most 100.
    allow_prune : bool
        Whether Gaussians may be pruned, which leaves more bits for the others. Default False.
    bit_rate : int, optional
        Maximum bits per second, for a sequence.

    Raises
    ------
    InvalidInput
        If not exactly one is given, or it is not a finite number above 0.

    Examples
    --------
    >>> gs_codec.RateTarget(ratio=20)
    RateTarget(size=None, ratio=20, bits=None, psnr_drop=None, allow_prune=False, bit_rate=None)
    >>> gs_codec.RateTarget()
    Traceback (most recent call last):
        ...
    gs_codec.errors.InvalidInput: target: none given, expected exactly one
    """

    size: int | None = option(
        None,
        "Maximum file size (5MB, 800kB, 3MiB).",
        kind=int, name="target_size", metavar="SIZE", unit="bytes",
    )  # fmt: skip
    ratio: float | None = option(
        None,
        "Minimum compression ratio, relative to the PLY (of a compressed input: to its floats).",
        kind=float, name="target_ratio", metavar="R",
    )  # fmt: skip
    bits: float | None = option(
        None, "Maximum bits per Gaussian.", kind=float, name="target_bpg", metavar="BITS"
    )
    psnr_drop: float | None = option(
        None,
        "Maximum PSNR loss of views, dB; finds the smallest such file.",
        kind=float, name="max_psnr_drop", metavar="DB",
    )  # fmt: skip
    allow_prune: bool = option(
        False, "Allow a target to prune Gaussians that hardly affect views.", kind=bool
    )
    bit_rate: int | None = option(
        None,
        "Maximum bits per second of a sequence (20Mbit/s, 800kbit/s).",
        kind=int, name="target_bitrate", metavar="RATE", unit="bit/s",
    )  # fmt: skip

    def __post_init__(self) -> None:
        check_fields(self)
        wishes = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "allow_prune"}
        given = {name: value for name, value in wishes.items() if value is not None}
        if len(given) != 1:
            what = " and ".join(given) or "none"
            raise InvalidInput(f"target: {what} given, expected exactly one")
        for name, value in given.items():
            if not 0 < value < math.inf:
                raise InvalidInput(f"target {name} {value}: expected a number above 0")
        if self.psnr_drop is not None and self.psnr_drop > 100:
            raise InvalidInput(f"target psnr_drop {self.psnr_drop}: expected at most 100 dB")

    @property
    def measures(self) -> bool:
        """Whether the loss of views is measured to meet it."""
        return self.psnr_drop is not None or self.allow_prune

    def limit(self, count: int, ply_bytes: int, seconds: float | None = None) -> int | None:
        """Maximum file size in bytes of a scene, or of a sequence that takes some seconds.

        None if the target is a PSNR loss. Raises InvalidInput if it is a bit rate, and `seconds` is
        None; or if it is less than a byte.
        """
        limit = self._limit(count, ply_bytes, seconds)
        if limit == 0:
            raise InvalidInput("target: less than 1 byte, expected more")
        return limit

    def _limit(self, count: int, ply_bytes: int, seconds: float | None) -> int | None:
        if self.size is not None:
            return int(self.size)
        if self.ratio is not None:
            return int(min(ply_bytes / self.ratio, sys.maxsize))
        if self.bits is not None:
            return int(min(self.bits * count / 8, sys.maxsize))
        if self.bit_rate is not None and seconds is None:
            raise InvalidInput("target bit_rate: one scene, expected a sequence")
        return None if self.bit_rate is None else int(self.bit_rate * (seconds or 0) / 8)


def as_rate_target(target: RateTarget | Mapping[str, float] | None) -> RateTarget | None:
    """Make a target from a mapping of its parameters; return a target, or None, unchanged.

    Raises InvalidInput if the mapping is not a valid target.
    """
    if target is None or isinstance(target, RateTarget):
        return target
    known = [f.name for f in fields(RateTarget)]
    for name in target:
        Option("", values=tuple(known)).check("target", name)
    return RateTarget(**target)  # type: ignore[arg-type]


#: Our own format, and all formats that scenes can be encoded to.
EGS = "egs"
CODED_FORMATS = tuple(
    dict.fromkeys(
        known.code(suffix)
        for known in FORMATS
        if known.writes in ("steps", "fixed")
        for suffix in known.written
    )
)


@dataclass(frozen=True)
class Config:
    """How to encode. Nothing here is needed to decode.

    Parameters
    ----------
    profile : {"l", "m", "s", "paper-l", "paper-m", "paper-s", "lossless"}
        ``l``, ``m``, ``s``: step sizes based on the visibility of each Gaussian; ``high``,
        ``medium`` and ``low`` are aliases. ``paper-*``: quantisation depths of the paper's Table 2.
        ``lossless``: bit-exact. Default ``m``.
    depths : mapping of str to int
        Bits per group, overriding those of a paper profile (its rate control, Section 4.4). With
        ``l``, ``m``, ``s``, the geometric mean of a group's step sizes becomes that of a paper
        profile with these bits; visible Gaussians still get finer steps. Neither `coarseness` nor a
        target changes them. Groups: ``geometry`` 1-21; ``sh-dc``, ``opacity``, ``scaling``,
        ``rotation``, ``sh1``, ``sh2``, ``sh3`` 1-12; ``sh-ac`` sets all three bands.
    nonfinite : {"error", "drop"}
        Handling of Gaussians with NaN or infinity. Default ``error``; ``lossless`` then keeps them.
    extra : {"auto", "keep", "drop", "error"}
        Handling of properties beyond the INRIA layout and of normals that are not all zero.
        ``keep`` stores them bit-exactly, ``drop`` warns, ``error`` refuses them. Default ``auto``:
        kept with ``lossless`` and in files of floats, otherwise dropped.
    threads : int or None
        Worker threads, 1-256; None means one per available processor, or a single one for fewer
        than 4096 Gaussians. The number never changes the bytes.
    block_size : int
        Maximum Gaussians per independent block, 1024-65536; in streamed SOG, of the parts that
        viewers draw at a level of their own. Default 16384.
    keep_order : bool
        With ``lossless``, also keep the order of the Gaussians, for a larger file. Default False.
    coarseness : float
        With ``l``, ``m``, ``s``: factor on all step sizes except those of `depths` (the rate
        control of these profiles), 1/64-64. Without cameras, it multiplies the calibrated step
        sizes of the scene. Default 1.
    geometry : {"octree", "gpcc", "auto"}
        With a paper profile, the coder of positions and SH-DC: ours (``octree``) or MPEG's
        reference software ``tmc3`` (``gpcc``), for depths up to 18 and 8. ``auto`` selects ``gpcc``
        if the depths allow it and the program is found, else ``octree``. Default ``octree``.
    tmc3 : str or None
        Path of the program, for ``gpcc`` and ``auto``; None searches the environment variable
        ``GS_CODEC_TMC3``, then PATH.
    verify : bool
        Whether to decode the output of ``tmc3`` and compare it with the input. Default True.
    models : {"parametric", "table", "best"}
        With a paper profile, the source of symbol probabilities. ``parametric``, as published:
        Laplace distributions for SH-AC and Gaussian mixtures for the rest. ``table``: tables in the
        file. ``best``, our extension: the cheapest model for each channel. Default ``parametric``.
    laplace_scales : float or None
        With a paper profile, SH-AC are rectified to this many Laplace scales (mean absolute
        deviations) on either side of their median, 0.1-1000; None means 3 per bit of depth.
    coder : {"rans", "torchac"}
        With a paper profile, the entropy coder: ours (``rans``), or the paper's (``torchac``), a
        Python package (extra ``paper``) that decoding needs too. Default ``rans``.
    format : str
        Format of the file, named after its suffix, such as ``spz``; a file name must agree. Formats
        other than ``egs`` support profiles ``l``, ``m`` and ``s``, but no `depths`. Default
        ``egs``.
    lod : bool
        With ``l``, ``m``, ``s``: add coarser levels with a quarter, a sixteenth ... of the
        Gaussians, for distant views and a quick first view; about a third more bytes. Default
        False.
    lod_levels : int or None
        In streamed SOG: number of levels of detail, 1-9, the scene itself included; each has a
        quarter of the Gaussians of the one before. Default None: until all would fit into a block.
    effort : {"fast", "normal", "high"}
        With ``l``, ``m``, ``s``: how long encoding may take. In an `.egs` with cameras, the time
        goes into joint rounding (see `round_jointly`), which ``fast`` omits. Without cameras,
        ``fast`` omits the local basis of SH-AC, and ``high`` is not allowed. It sets how well an
        `.spz` or `.rad` is compressed, and how long rows of the palette of a `.sog` are searched.
        Other formats have only ``normal``. Default ``normal``.
    strict : bool
        With ``l``, ``m``, ``s``: fail if rendered views lose more than twice the profile's target.
        Default False: only warn.
    spz_version : {3, 4}
        With format ``spz``: 4 is smaller, 3 is read by more programs. Default 3.
    gltf_compression : {"none", "spz"}
        With format ``glb`` or ``gltf``: ``spz`` stores attributes as an `.spz` (the extension
        KHR_gaussian_splatting_compression_spz_2), which CesiumJS displays. Default ``none``.

    Raises
    ------
    InvalidInput
        If a value is outside its range.

    Examples
    --------
    >>> config = gs_codec.Config("paper-s", depths={"rotation": 8})
    >>> config.resolved_depths()["rotation"]
    8
    >>> gs_codec.Config(coarseness=100)
    Traceback (most recent call last):
        ...
    gs_codec.errors.InvalidInput: coarseness 100: expected 1/64 to 64
    """

    profile: str = option(
        "m",
        f"Profile: {PROFILES_SHOWN}.",
        metavar="NAME",
        values=(*PROFILE_CHOICES, *PROFILE_WORDS),
    )
    depths: Mapping[str, int] = option(
        dict,
        f"Bits of a group ({', '.join((*DEPTH_GROUPS, 'sh-ac'))}); may be repeated.",
        kind=int, name="depth", metavar="GROUP=BITS", keys=(*DEPTH_GROUPS, "sh-ac"),
    )  # fmt: skip
    nonfinite: Literal["error", "drop"] = option(
        "error", "Refuse or drop Gaussians with NaN or infinity.", values=("error", "drop")
    )
    extra: Literal["auto"] | Extra = option(
        "auto",
        "Properties beyond the 3DGS layout: keep, drop with a warning, or refuse; auto keeps them "
        "with profile lossless and drops them otherwise.",
        values=("auto", *get_args(Extra)),
    )
    threads: int | None = option(
        None, "Worker threads, 1-256.", kind=int, low=1, high=256, shown="all processors"
    )
    block_size: int = option(
        1 << 14,
        "Maximum Gaussians per independent block, or part of streamed SOG, 1024-65536.",
        kind=int, low=1 << 10, high=1 << 16,
    )  # fmt: skip
    keep_order: bool = option(
        False, "With profile lossless: keep the order of the Gaussians.", kind=bool
    )
    coarseness: float = option(
        1.0,
        "With profiles l, m, s: factor on all step sizes, 1/64-64.",
        kind=float, low=1 / 64, high=64, expected="1/64 to 64",
    )  # fmt: skip
    geometry: Literal["octree", "gpcc", "auto"] = option(
        "octree",
        "With paper-*: coder of geometry and SH-DC; gpcc is MPEG's tmc3, auto uses it if found.",
        values=("octree", "gpcc", "auto"),
    )
    tmc3: str | None = option(
        None, "Path of the G-PCC program.", metavar="PATH", shown="GS_CODEC_TMC3, or tmc3 in PATH"
    )
    verify: bool = option(True, "Do not check the output of tmc3 by decoding it.", kind=bool)
    models: Models = option(
        "parametric",
        "With paper-*: models as published (Laplace and mixtures), tables, or the cheapest (best).",
        values=get_args(Models),
    )
    laplace_scales: float | None = option(
        None,
        "With paper-*: range of SH-AC on either side of their median, in Laplace scales.",
        kind=float, metavar="N", low=0.1, high=1000, expected="0.1 to 1000",
        shown="3 per bit",
    )  # fmt: skip
    coder: Coder = option(
        "rans",
        "With paper-*: entropy coder; torchac is the paper's, and also needed for decoding.",
        values=get_args(Coder),
    )
    format: str = option(
        EGS,
        "Format of stdout or of the files of a batch; otherwise, OUT's suffix sets it.",
        metavar="NAME", values=CODED_FORMATS,
    )  # fmt: skip
    lod: bool = option(
        False, "With profiles l, m, s: add coarser levels of detail; a third more bytes.", kind=bool
    )
    lod_levels: int | None = option(
        None,
        "Levels of detail in streamed SOG, 1-9; each has a quarter of the one before.",
        kind=int, low=1, high=9, expert=False, shown="until all Gaussians would fit into a block",
    )  # fmt: skip
    effort: Effort = option(
        "normal",
        "How long profiles l, m, s may take to make an .egs, .spz, .rad or .sog smaller; high "
        "needs cameras for an .egs.",
        values=get_args(Effort),
    )
    strict: bool = option(
        False,
        "Fail if rendered views lose more than twice the profile's aim.",
        kind=bool,
    )
    spz_version: Literal[3, 4] = option(
        3, "With format spz: version; 4 is smaller, more programs read 3.", kind=int, low=3, high=4
    )
    gltf_compression: Literal["none", "spz"] = option(
        "none",
        "With format glb or gltf: compress the attributes, for CesiumJS.",
        values=("none", "spz"),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "profile", PROFILE_WORDS.get(self.profile, self.profile))
        check_options(self)
        self._check_format()
        if self.asked_depths() and self.profile == LOSSLESS:
            raise InvalidInput(f"depths: profile '{self.profile}' has none, all others do")
        if self.coarseness != 1 and self.profile not in ADAPTIVE_PROFILES:
            known = ", ".join(ADAPTIVE_PROFILES)
            raise InvalidInput(f"coarseness: profile '{self.profile}' has none, {known} do")
        if self.keep_order and self.profile != LOSSLESS:
            raise InvalidInput(f"keep_order: profile '{self.profile}', expected 'lossless'")
        if self.lod and (self.profile not in ADAPTIVE_PROFILES or self.format != EGS):
            known = ", ".join(ADAPTIVE_PROFILES)
            raise InvalidInput(
                f"lod: profile '{self.profile}', format '{self.format}', expected {known} as .egs"
            )
        if self.effort != "normal" and self.profile not in ADAPTIVE_PROFILES:
            known = ", ".join(ADAPTIVE_PROFILES)
            raise InvalidInput(f"effort: profile '{self.profile}' has none, {known} do")
        if self.strict and not (self.has_steps and not self.depths):
            raise InvalidInput(
                f"strict: profile '{self.profile}' as '{self.format}' does not aim at a loss"
            )
        for name in PAPER_OPTIONS:
            value = getattr(self, name)
            if value != getattr(Config, name) and self.profile not in PROFILES:
                known = ", ".join(PROFILES)
                raise InvalidInput(f"{name} '{value}': profile '{self.profile}', expected {known}")
        self._check_geometry()

    def chosen_extra(self, keeps: bool = False) -> Extra:
        """Resolve `extra`: ``auto`` keeps properties if `keeps`, or with profile ``lossless``."""
        if self.extra != "auto":
            return self.extra
        return "keep" if keeps or self.profile == LOSSLESS else "drop"

    def _check_format(self) -> None:
        """Reject options that only other formats support."""
        alike = (each for each in FORMATS if each.coded_as == self.format)
        self.check_options_of(self.scene_format, *alike)
        if self.format == EGS:
            return
        where = f"format '{self.format}'"
        if self.profile not in ADAPTIVE_PROFILES:
            known = ", ".join(ADAPTIVE_PROFILES)
            raise InvalidInput(f"{where}: profile '{self.profile}', expected {known}")
        if self.depths:
            raise InvalidInput(f"depths: {where} has none")
        if self.coarseness != 1 and not self.has_steps:
            raise InvalidInput(f"coarseness: {where} has none")

    def check_options_of(self, *formats: SceneFormat) -> None:
        """Reject options that none of these formats has. Raises InvalidInput."""
        used = {name for each in formats for name in each.options}
        for name in {name: None for each in FORMATS for name in each.options}:
            if name not in used and getattr(self, name) != getattr(Config, name):
                known = listed(
                    [s for each in FORMATS if name in each.options for s in each.written]
                )
                raise InvalidInput(f"{name}: format '{self.format}', expected {known}")

    def _check_geometry(self) -> None:
        if self.geometry == "octree" and (self.tmc3 is not None or not self.verify):
            what = "verify" if self.tmc3 is None else "tmc3"
            raise InvalidInput(f"{what}: only geometry gpcc and auto use it")
        if self.geometry != "gpcc":
            return
        if self.profile not in PROFILES:
            known = ", ".join(PROFILES)
            raise InvalidInput(
                f"geometry 'gpcc': profile '{self.profile}' has no uniformly quantised positions, "
                f"{known} have"
            )
        for group, most in GPCC_DEPTHS.items():
            if (bits := self.resolved_depths()[group]) > most:
                raise InvalidInput(f"geometry 'gpcc': depth of {group} {bits}, at most {most}")

    @property
    def may_use_gpcc(self) -> bool:
        """Whether G-PCC is selected, or allowed if its program is found."""
        if self.geometry == "octree" or self.profile not in PROFILES:
            return False
        depths = self.resolved_depths()
        return all(depths[group] <= most for group, most in GPCC_DEPTHS.items())

    def asked_depths(self) -> dict[str, int]:
        """Bits of the groups in `DEPTH_GROUPS` that `depths` sets."""
        given = {}
        for group, bits in self.depths.items():
            members = SH_STREAMS if group == "sh-ac" else (group,)
            for member in members:
                if member not in DEPTH_GROUPS:
                    known = ", ".join((*DEPTH_GROUPS, "sh-ac"))
                    raise InvalidInput(f"depth group '{group}': expected one of {known}")
                Option("", int, low=1, high=MAX_DEPTH[member]).check(f"depth of {group}", bits)
                given[member] = bits
        return given

    def resolved_depths(self) -> dict[str, int]:
        """Bits of every group in `DEPTH_GROUPS` of a paper profile, with overrides applied."""
        if self.profile not in PROFILES:
            raise InvalidInput(f"profile '{self.profile}': has no depths, expected a paper profile")
        return {**PROFILES[self.profile], **self.asked_depths()}

    @property
    def has_steps(self) -> bool:
        """Whether the output follows the step sizes of profile ``l``, ``m`` or ``s``."""
        return self.profile in ADAPTIVE_PROFILES and self.scene_format.writes == "steps"

    @property
    def scene_format(self) -> SceneFormat:
        """The declaration of `format`."""
        known = format_of(f".{self.format}")
        return known.variants.get(self.gltf_compression, known)

    def adaptive_profile(self) -> AdaptiveProfile:
        """The parameters of profile ``l``, ``m`` or ``s``, with the coarseness applied."""
        if self.profile not in ADAPTIVE_PROFILES:
            raise InvalidInput(f"profile '{self.profile}': expected l, m or s")
        scaled = ADAPTIVE_PROFILES[self.profile].scaled(self.coarseness)
        looks, left = _ROUNDING[self.effort]
        return replace(scaled, looks=looks, left=left) if self.format == EGS else scaled


def as_config(config: Config | str | None) -> Config:
    """Make a configuration from a profile name; None means profile ``m``."""
    return Config(config) if isinstance(config, str) else config or Config()


def check_threads(threads: int | None) -> None:
    """Check that a number of worker threads is 1-256, or None for all processors."""
    if threads is not None:
        options_of(Config)["threads"].check("threads", threads)
