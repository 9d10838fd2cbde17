"""Encoder configuration: profiles and quantisation depths (paper, Table 1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Literal

from gs_codec.errors import InvalidInput

#: Depth groups in stream order. ``sh-ac`` is accepted as shorthand for the three SH bands.
DEPTH_GROUPS = ("geometry", "sh-dc", "opacity", "scaling", "rotation", "sh1", "sh2", "sh3")

#: Those of SH-AC, one for each band.
SH_STREAMS = DEPTH_GROUPS[5:]

#: Most bits a group may have: three 21-bit axes fill a Morton code, 12 bits fill a table.
MAX_DEPTH = {group: 21 if group == "geometry" else 12 for group in DEPTH_GROUPS}


@dataclass(frozen=True)
class Option:
    """What a field of a dataclass is as an option: its values, and how help describes it.

    The commands build their options from these, so that an option is written down once.

    Parameters
    ----------
    help : str
        One sentence for the help of a command.
    kind : type
        ``bool``, ``int``, ``float``, ``str`` or ``Path``.
    name : str, optional
        The option's name where it is not the field's.
    metavar : str, optional
        What stands for the value in the help.
    shown : str, optional
        What the help shows as the default.
    low, high : float, optional
        Range of the values, both included.
    expected : str, optional
        The range in words.
    values : mapping or tuple, optional
        The words that are accepted; a mapping says what each stands for.
    keys : tuple of str
        The keys of a mapping, for a field that is one.
    unit : {"bytes"}, optional
        Sizes are typed with units: ``5MB``.
    expert : bool
        Whether commands take it by ``--set NAME=VALUE`` where they do not list it.
    """

    help: str
    kind: type = str
    name: str | None = None
    metavar: str | None = None
    shown: str | None = None
    low: float = -math.inf
    high: float = math.inf
    expected: str | None = None
    values: Mapping[str, Any] | tuple[str, ...] = ()
    keys: tuple[str, ...] = ()
    unit: Literal["bytes"] | None = None
    expert: bool = True

    def check(self, name: str, value: Any) -> None:
        """Refuse a value of field `name` that is none of `values`, or outside the range.

        Raises
        ------
        InvalidInput
        """
        if isinstance(self.values, tuple) and self.values and value not in self.values:
            raise InvalidInput(f"{name} '{value}': expected one of {', '.join(self.values)}")
        if self.kind not in (int, float) or self.keys:
            return
        whole = self.kind is float or isinstance(value, int)
        if not whole or not self.low <= value <= self.high:
            expected = self.expected or f"an integer from {self.low} to {self.high}"
            raise InvalidInput(f"{name} {value}: expected {expected}")


def option(default: Any, help: str, **rest: Any) -> Any:  # noqa: A002
    """A field of a dataclass with its `Option`; the default of a mapping is its type."""
    metadata = {"option": Option(help, **rest)}
    if default is dict:
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


def options_of(settings: Any) -> dict[str, Option]:
    """The options of a dataclass by its fields' names."""
    return {f.name: f.metadata["option"] for f in fields(settings) if "option" in f.metadata}


def check_options(settings: Any) -> None:
    """Refuse values of a dataclass's fields that their options do not allow; None is allowed.

    Raises
    ------
    InvalidInput
    """
    for name, described in options_of(settings).items():
        if (value := getattr(settings, name)) is not None:
            described.check(name, value)


def _depths(*bits: int) -> Mapping[str, int]:
    return MappingProxyType(dict(zip(DEPTH_GROUPS, bits, strict=True)))


#: Bits per group. The paper's Table 1 gives a range for SH-AC (4-5 / 3-4 / 2-4) and for the
#: geometry of S (15-16); which are taken was decided by rendered views (bench/RESULTS.md).
PROFILES: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {
        "paper-l": _depths(17, 8, 8, 8, 8, 5, 5, 5),
        "paper-m": _depths(16, 8, 8, 8, 8, 4, 4, 4),
        "paper-s": _depths(15, 8, 7, 7, 7, 4, 3, 3),
    }
)


#: Most bits of what G-PCC codes.
GPCC_DEPTHS: Mapping[str, int] = MappingProxyType({"geometry": 18, "sh-dc": 8})

#: The profile that keeps every bit, and so has no depths.
LOSSLESS = "lossless"


@dataclass(frozen=True)
class LatticeProfile:
    """A profile whose steps follow how much is seen of each Gaussian.

    Parameters
    ----------
    error : float
        With cameras: mean squared error of an image value (0-1) that quantisation may add, as
        far as errors add up.
    compaction : float
        With cameras: strength of SH compaction, see `compact_sh`.
    fineness : float
        Without cameras: unit of all steps, see `lattice.blind`.
    of_loss : float
        With cameras: share of the error that a scene has already, pruned as it may be, that
        quantisation may add too: neither is worth its bits if the other saves them at less.
    """

    error: float
    compaction: float
    fineness: float
    of_loss: float

    def scaled(self, factor: float) -> LatticeProfile:
        """The profile whose steps are `factor` times as large; errors go by their squares."""
        square = factor**2
        return LatticeProfile(
            self.error * square,
            self.compaction * square,
            self.fineness * factor,
            self.of_loss * square,
        )


_M = LatticeProfile(error=1.3e-5, compaction=1e-5, fineness=0.0063, of_loss=0.3)

#: Half, once and 2.25 times the steps of `m`.
LATTICE_PROFILES: Mapping[str, LatticeProfile] = MappingProxyType(
    {"l": _M.scaled(0.5), "m": _M, "s": _M.scaled(2.25)}
)

PROFILE_CHOICES = (*LATTICE_PROFILES, *PROFILES, LOSSLESS)

#: Words that are accepted for the short names.
PROFILE_WORDS: Mapping[str, str] = MappingProxyType({"high": "l", "medium": "m", "low": "s"})

#: The profiles as help lists them.
PROFILES_SHOWN = ", ".join(
    [f"{short} ({word})" for word, short in PROFILE_WORDS.items()] + [*PROFILES, LOSSLESS]
)


@dataclass(frozen=True)
class Target:
    """One size or quality to come to.

    Sizes are met from below, by 2 % or less unless the finest steps take less.

    Parameters
    ----------
    size : int, optional
        Most bytes of the file.
    ratio : float, optional
        Times that the file is at least smaller than the PLY, or than the float32 attributes of a
        scene that comes from a compressed file.
    bits : float, optional
        Most bits for each Gaussian of the input.
    psnr_drop : float, optional
        Decibels that views may lose, mean over the views.
    allow_prune : bool
        Whether Gaussians may go where that leaves more to the others. Default False.

    Raises
    ------
    InvalidInput
        If not exactly one is given, or it is not a finite number above 0.

    Examples
    --------
    >>> gs_codec.Target(ratio=20)
    Target(size=None, ratio=20, bits=None, psnr_drop=None, allow_prune=False)
    >>> gs_codec.Target()
    Traceback (most recent call last):
        ...
    gs_codec.errors.InvalidInput: target: none given, expected exactly one
    """

    size: int | None = option(
        None,
        "Largest file: 5MB, 800kB, 3MiB.",
        kind=int, name="target_size", metavar="SIZE", unit="bytes",
    )  # fmt: skip
    ratio: float | None = option(
        None,
        "Smallest compression ratio; counts from the PLY, or from the floats of a compressed file.",
        kind=float, name="target_ratio", metavar="R",
    )  # fmt: skip
    bits: float | None = option(
        None, "Most bits per Gaussian.", kind=float, name="target_bpg", metavar="BITS"
    )
    psnr_drop: float | None = option(
        None,
        "Smallest file whose views lose at most this PSNR (dB).",
        kind=float, name="max_psnr_drop", metavar="DB",
    )  # fmt: skip
    allow_prune: bool = option(
        False, "Prune Gaussians to meet a target, where views hardly need them.", kind=bool
    )

    def __post_init__(self) -> None:
        wishes = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "allow_prune"}
        given = {name: value for name, value in wishes.items() if value is not None}
        if len(given) != 1:
            what = " and ".join(given) or "none"
            raise InvalidInput(f"target: {what} given, expected exactly one")
        for name, value in given.items():
            if not 0 < value < math.inf:
                raise InvalidInput(f"target {name} {value}: expected a number above 0")

    def limit(self, count: int, ply_bytes: int) -> int | None:
        """Most bytes of the file of a scene; None if the wish is a quality."""
        if self.size is not None:
            return int(self.size)
        if self.ratio is not None:
            return int(ply_bytes / self.ratio)
        if self.bits is not None:
            return int(self.bits * count / 8)
        return None


def as_target(wish: Target | Mapping[str, float]) -> Target:
    """The target that a mapping of its parameters means.

    Raises
    ------
    InvalidInput
        If it is not one.
    """
    if isinstance(wish, Target):
        return wish
    known = [f.name for f in fields(Target)]
    for name in wish:
        Option("", values=tuple(known)).check("target", name)
    return Target(**wish)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Config:
    """How to encode. Nothing here is needed to decode.

    Parameters
    ----------
    profile : {"l", "m", "s", "paper-l", "paper-m", "paper-s", "lossless"}
        Steps that follow how much is seen of each Gaussian, quantisation depths of the paper's
        Table 1, or every bit as it is. ``high``, ``medium`` and ``low`` are accepted for ``l``,
        ``m`` and ``s``. Default ``m``.
    depths : mapping of str to int
        Bits per group that override a paper profile (its rate control, Section 4.4). With ``l``,
        ``m``, ``s`` a group's steps are then as coarse as those bits make them there, on average
        (geometric), and finer where more is seen; neither `coarseness` nor a target moves them.
        Groups: ``geometry`` 1-21; ``sh-dc``, ``opacity``, ``scaling``, ``rotation``,
        ``sh1``, ``sh2``, ``sh3`` 1-12; ``sh-ac`` sets all three bands.
    nonfinite : {"error", "drop"}
        What to do with Gaussians that hold NaN or infinity. Default ``error``, which
        ``lossless`` has no need of: it keeps them.
    extra : {"error", "keep", "drop"}
        What to do with properties beyond the INRIA layout and with normals that are not
        all zero. ``keep`` stores them bit-exactly. Default ``error``.
    threads : int or None
        Worker threads, 1-256; None is one for each available processor. Never changes the bytes.
    block_size : int
        Most Gaussians in an independently decodable block, 1024-65536. Default 65536.
    keep_order : bool
        With ``lossless``, keep the order of the Gaussians too, at some cost. Default False.
    coarseness : float
        With ``l``, ``m``, ``s``, what all steps are multiplied by (their rate control) but those
        of `depths`, 1/64-64. Default 1.
    geometry : {"octree", "gpcc", "auto"}
        With a paper profile, what codes positions and SH-DC: our own coders, or MPEG's reference
        software ``tmc3``, for depths up to 18 and 8. ``auto`` is ``gpcc`` for those where the
        program is found, else ``octree``. Default ``octree``.
    tmc3 : str or None
        The program, for ``gpcc`` and ``auto``; None is what the environment variable
        ``GS_CODEC_TMC3`` or PATH say.
    verify : bool
        Decode once what ``tmc3`` has coded, and compare. Default True.

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

    profile: str = option("m", f"One of {PROFILES_SHOWN}.", metavar="NAME", values=PROFILE_CHOICES)
    depths: Mapping[str, int] = option(
        dict,
        f"Bits of a group: {', '.join((*DEPTH_GROUPS, 'sh-ac'))}.",
        kind=int, name="depth", metavar="BITS", keys=(*DEPTH_GROUPS, "sh-ac"),
    )  # fmt: skip
    nonfinite: Literal["error", "drop"] = option(
        "error", "What to do with Gaussians that hold NaN or infinity.", values=("error", "drop")
    )
    extra: Literal["error", "keep", "drop"] = option(
        "error",
        "What to do with properties beyond the 3DGS layout.",
        values=("error", "keep", "drop"),
    )
    threads: int | None = option(
        None, "Worker threads, 1-256.", kind=int, low=1, high=256, shown="all processors"
    )
    block_size: int = option(
        1 << 16,
        "Most Gaussians in a block that is decoded alone, 1024-65536.",
        kind=int, low=1 << 10, high=1 << 16,
    )  # fmt: skip
    keep_order: bool = option(
        False, "With profile lossless: keep the order of the Gaussians.", kind=bool
    )
    coarseness: float = option(
        1.0,
        "With profiles l, m, s: multiplies all step sizes, 1/64-64.",
        kind=float, low=1 / 64, high=64, expected="1/64 to 64",
    )  # fmt: skip
    geometry: Literal["octree", "gpcc", "auto"] = option(
        "octree",
        "With paper-*: what codes geometry and SH-DC; gpcc is MPEG's tmc3, auto takes it if found.",
        values=("octree", "gpcc", "auto"),
    )
    tmc3: str | None = option(
        None, "The G-PCC program.", metavar="PATH", shown="GS_CODEC_TMC3, or tmc3 in PATH"
    )
    verify: bool = option(True, "Decode what tmc3 has coded, and compare.", kind=bool)

    def __post_init__(self) -> None:
        object.__setattr__(self, "profile", PROFILE_WORDS.get(self.profile, self.profile))
        check_options(self)
        if self.asked_depths() and self.profile == LOSSLESS:
            raise InvalidInput(f"depths: profile '{self.profile}' has none, all others do")
        if self.coarseness != 1 and self.profile not in LATTICE_PROFILES:
            known = ", ".join(LATTICE_PROFILES)
            raise InvalidInput(f"coarseness: profile '{self.profile}' has none, {known} do")
        if self.keep_order and self.profile != LOSSLESS:
            raise InvalidInput(f"keep_order: profile '{self.profile}', expected 'lossless'")
        self._check_geometry()

    def _check_geometry(self) -> None:
        if self.geometry == "octree" and (self.tmc3 is not None or not self.verify):
            what = "verify" if self.tmc3 is None else "tmc3"
            raise InvalidInput(f"{what}: geometry 'octree' has no use for it, gpcc and auto do")
        if self.geometry != "gpcc":
            return
        if self.profile not in PROFILES:
            known = ", ".join(PROFILES)
            raise InvalidInput(
                f"geometry 'gpcc': profile '{self.profile}' has no points of plain integers, "
                f"{known} have"
            )
        for group, most in GPCC_DEPTHS.items():
            if (bits := self.resolved_depths()[group]) > most:
                raise InvalidInput(f"geometry 'gpcc': depth of {group} {bits}, at most {most}")

    @property
    def may_use_gpcc(self) -> bool:
        """Whether G-PCC is asked for, or allowed where its program is found."""
        if self.geometry == "octree" or self.profile not in PROFILES:
            return False
        depths = self.resolved_depths()
        return all(depths[group] <= most for group, most in GPCC_DEPTHS.items())

    def asked_depths(self) -> dict[str, int]:
        """Bits of the groups of `DEPTH_GROUPS` that `depths` names."""
        asked = {}
        for group, bits in self.depths.items():
            members = SH_STREAMS if group == "sh-ac" else (group,)
            for member in members:
                if member not in DEPTH_GROUPS:
                    known = ", ".join((*DEPTH_GROUPS, "sh-ac"))
                    raise InvalidInput(f"depth group '{group}': expected one of {known}")
                _check_range(f"depth of {group}", bits, 1, MAX_DEPTH[member])
                asked[member] = bits
        return asked

    def resolved_depths(self) -> dict[str, int]:
        """Bits of every group in `DEPTH_GROUPS` of a paper profile, overrides applied."""
        if self.profile not in PROFILES:
            raise InvalidInput(f"profile '{self.profile}': has no depths, expected a paper profile")
        return {**PROFILES[self.profile], **self.asked_depths()}

    def resolved_lattice(self) -> LatticeProfile:
        """The numbers of profile ``l``, ``m`` or ``s``, its coarseness applied."""
        if self.profile not in LATTICE_PROFILES:
            raise InvalidInput(f"profile '{self.profile}': expected l, m or s")
        return LATTICE_PROFILES[self.profile].scaled(self.coarseness)


def check_threads(threads: int | None) -> None:
    """Refuse a number of worker threads that is not 1-256, or None for all processors."""
    if threads is not None:
        options_of(Config)["threads"].check("threads", threads)


def _check_range(name: str, value: int, low: int, high: int) -> None:
    """Refuse a value that is no integer in a range, both ends included."""
    Option("", int, low=low, high=high).check(name, value)
