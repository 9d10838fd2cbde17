"""Reports of an encode: sizes, models, entropy, times."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from gs_codec.config import LOSSLESS, RateTarget

log = logging.getLogger(__name__)

#: Mean squared error against photographs that is assumed if there are none; equals 30 dB.
NOMINAL_ERROR = 1e-3

#: Version of the keys of JSON documents and of lines in reports of batches; it increases when a key
#: is removed or changes its meaning.
SCHEMA = 1

#: Sections that all entropy-coded channels share.
_SHARED = ("states", "channels", "lattice")

#: Why there is no loss in rendered views; see `encoding.loss`.
NOT_MEASURED = (
    "rendered views: not measured, because nearly all crops are empty, almost transparent, "
    "or show too many Gaussians"
)


def lacks_loss(loss: object, profile: str | None, prepared: bool = False) -> bool:
    """Whether a loss in rendered views should be stated, but was not measured.

    Without a profile, or with ``lossless``, only that of a scene that was `prepared`.
    """
    return loss is None and (profile not in (None, LOSSLESS) or prepared)


#: Called with a stage's name, the steps done, and the total number of steps.
Progress = Callable[[str, int, int], None]


@dataclass
class StageTimes:
    """Seconds by stage, in the order the stages ran."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to stage `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            took = time.perf_counter() - start
            self.seconds[name] = self.seconds.get(name, 0.0) + took
            log.debug("%s: %.3f s", name, took)


@dataclass(frozen=True)
class ChannelCost:
    """Bits of one rANS-coded channel, all Gaussians together.

    Attributes
    ----------
    name : str
        The channel: its property in a PLY, or the kind of symbols.
    stream : str
        The stream that codes it, as `inspect` names it.
    model : str
        Kind of model that produced its table.
    coded_bits : float
        Code length of the symbols with the table in use.
    parametric_bits : float
        Code length with the cheapest fitted distribution; equal to `coded_bits` if only tables are
        sent, as with profiles ``l``, ``m`` and ``s``.
    shannon_bits : float
        Entropy of the symbols times their number: the lower bound for any static table.

    Examples
    --------
    >>> report = gs_codec.encode_file("scene.ply", "costs.egs")
    >>> cost = report.costs[-1]
    >>> cost.name, cost.stream, cost.coded_bits >= cost.shannon_bits
    ('sh3 Cg', 'sh3', True)
    """

    name: str
    stream: str
    model: str
    coded_bits: float
    parametric_bits: float
    shannon_bits: float


@dataclass(frozen=True)
class RateReport:
    """How a target was met.

    Attributes
    ----------
    target : RateTarget
        The target.
    coarseness : float
        Factor on the profile's step sizes.
    steps : dict of str to tuple of float
        Finest and coarsest step size of each pass, as `inspect` reports them.
    file_bytes : int
        Size of the file.
    predicted_bytes : int or None
        With cameras: the size predicted before colours were refitted.
    psnr_drop : float or None
        PSNR loss of the views in dB, if the target is a PSNR loss.
    predicted_drop : float or None
        The PSNR loss in dB that was predicted from sensitivities.
    encodings : int
        Number of times the scene was encoded, including attempts with more Gaussians.
    pruned : int
        Gaussians pruned to meet the target.
    at_end : bool
        Whether the target is out of reach: the step sizes are the finest possible, or for a PSNR
        loss the coarsest.

    Examples
    --------
    >>> data, report = gs_codec.encode("scene.ply", rate={"ratio": 12})
    >>> report.coarseness > 1, report.steps["opacity"][0] < report.steps["opacity"][1]
    (True, True)
    """

    target: RateTarget
    coarseness: float
    steps: dict[str, tuple[float, float]]
    file_bytes: int
    predicted_bytes: int | None
    psnr_drop: float | None
    predicted_drop: float | None
    encodings: int
    pruned: int = 0
    at_end: bool = False


@dataclass(frozen=True)
class RenderedLoss:
    """Loss in rendered views, measured in crops that were not used to choose step sizes.

    Attributes
    ----------
    psnr : float
        PSNR of the coded scene against the original, dB.
    loss : float
        Resulting PSNR loss against photographs, for a scene of 30 dB, in dB.
    worst : float
        The same for the 95th percentile of the crops, in dB.
    windows : int
        Number of crops.
    views : str
        ``given``: crops of held-out cameras, or of views between given ones; ``likely``: crops of
        views from estimated cameras.
    away : float, optional
        With given cameras: the loss in likely views, from other positions.
    aimed : float, optional
        Target loss of the step sizes, dB; None for a fixed size or fixed depths.
    encodings : int
        Number of times the scene was encoded.
    remedy : str, optional
        What was changed because the first result missed the target.

    Examples
    --------
    >>> seen = gs_codec.encode_file("scene.ply", "seen.egs", "s").rendered
    >>> seen.views, seen.loss < seen.worst
    ('likely', True)
    """

    psnr: float
    loss: float
    worst: float
    windows: int
    views: str
    away: float | None = None
    aimed: float | None = None
    encodings: int = 1
    remedy: str | None = None


def psnr_loss(error: float) -> float:
    """PSNR loss in dB of 30 dB views to which a mean squared error is added."""
    return 10 * math.log10(1 + error / NOMINAL_ERROR)


@dataclass(frozen=True)
class ActionReport:
    """Result of an action.

    Attributes
    ----------
    action : str
        The action as typed, without dashes.
    before, after : int
        Number of Gaussians before and after the action.
    details : dict of str to int
        With ``remove-floaters``, number of removed Gaussians by reason.
    seconds : float
        Wall time.

    Examples
    --------
    >>> near = gs_codec.edit.Action("crop-sphere", "0,0,0,3")
    >>> [done] = gs_codec.convert_file("scene.ply", "near.ply", actions=[near]).actions
    >>> done.action, done.before, done.after
    ('crop-sphere 0,0,0,3', 2000, 1428)
    """

    action: str
    before: int
    after: int
    details: dict[str, int]
    seconds: float


@dataclass(frozen=True)
class EncodeReport:
    """Result of `encode`.

    Attributes
    ----------
    count : int
        Number of coded Gaussians.
    raw_bytes : int
        Size of their float32 attributes.
    section_bytes : dict of str to int
        Bytes of the file by section, header and section table included.
    costs : list of ChannelCost
        Code lengths and entropies of the rANS-coded channels.
    rectified : int
        Number of SH-AC values clamped to their Laplace range; with profiles `l`, `m` and `s`, of
        values of any attribute clamped to the lattice.
    zero_quaternions : int
        Number of quaternions of norm 0, which are coded as the identity.
    dropped : int
        Number of Gaussians dropped because of NaN or infinity.
    seconds : dict of str to float
        Wall time of each stage.
    coarseness : float
        Factor on the step sizes of profile ``l``, ``m`` or ``s``: the configured one, times the
        calibrated one if camera-free; or the one that met a target.
    lost : tuple of str
        Sentences on what the format cannot represent; with profiles ``paper-*``, on Gaussians moved
        nearer.
    rate : RateReport, optional
        How the target was met, if one was given.
    rendered : RenderedLoss, optional
        Loss in rendered views; None if not measured, as with profile ``lossless``.
    prepared : dict, optional
        Report of preparation, if any: `PrepareReport.as_dict`, including the coding steps.
    input_bytes : int
        Size of the file that was encoded; 0 if the scene was in memory.
    ratio : float
        Compression ratio relative to that file, or to its floats if it is compressed or was edited;
        0 if the scene was in memory.
    actions : tuple of ActionReport
        Report of each action.
    sh_degree : int
        SH degree coded.
    float_bytes : int
        Size of the source scene's floats, before pruning; 0 if the scene was in memory.

    Examples
    --------
    >>> report = gs_codec.encode_file("scene.ply", "reported.egs")
    >>> report.file_bytes == sum(report.section_bytes.values())
    True
    >>> report.ratio == report.input_bytes / report.file_bytes
    True
    """

    count: int
    raw_bytes: int
    section_bytes: dict[str, int]
    costs: list[ChannelCost]
    rectified: int
    zero_quaternions: int = 0
    dropped: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    coarseness: float = 1.0
    lost: tuple[str, ...] = ()
    rate: RateReport | None = None
    rendered: RenderedLoss | None = None
    prepared: dict[str, Any] | None = None
    input_bytes: int = 0
    ratio: float = 0.0
    actions: tuple[ActionReport, ...] = ()
    sh_degree: int = 0
    float_bytes: int = 0

    @property
    def file_bytes(self) -> int:
        """Size of the file."""
        return sum(self.section_bytes.values())

    @property
    def entropy_overhead(self) -> float:
        """Relative excess of words, states, models and quantisers over the Shannon entropy."""
        entropy = sum(cost.shannon_bits for cost in self.costs)
        return self.coded_bits(self.costs) / entropy - 1 if entropy else 0.0

    def coded_bits(self, channels: Sequence[ChannelCost]) -> float:
        """Bits of all channels of some streams, with their share of the common sections.

        Parameters
        ----------
        channels : sequence of ChannelCost
            All channels of one or several streams.

        Returns
        -------
        float
            Bits of words, and a share of states, models and quantisers, equal for each stream.
        """
        names = {cost.stream for cost in channels}
        shared = sum(self.section_bytes.get(name, 0) for name in _SHARED)
        words = sum(self.section_bytes.get(name, 0) for name in names)
        return 8 * (words + shared * len(channels) / max(len(self.costs), 1))


def bits_per_gaussian(size: int, count: int) -> float | None:
    """Bits per Gaussian of a file; None without Gaussians."""
    return 8 * size / count if count else None


def finite(value: Any) -> Any:
    """Convert a float for JSON, which has neither NaN nor infinity: these become None."""
    if isinstance(value, dict):
        return {name: finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def step_counter(progress: Progress | None, stage: str, total: int) -> Callable[[], None]:
    """Make a callback that reports one more step of a stage to `progress`, if given."""
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(stage, done, total)

    return advance
