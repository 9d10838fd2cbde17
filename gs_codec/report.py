"""What encoding did: sizes, models, entropy, times."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from gs_codec.config import RateTarget

log = logging.getLogger(__name__)

#: Mean squared error against photographs that is assumed where there are none: 30 dB.
NOMINAL_ERROR = 1e-3

#: Version of the keys of JSON documents and of lines in reports of batches; it rises when one is
#: removed or changes its meaning.
SCHEMA = 1

#: Sections that all entropy-coded channels have together.
_SHARED = ("states", "channels", "lattice")

#: Called with a stage's name, steps done, and steps in all.
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
        Kind of model that its table was made from.
    coded_bits : float
        Code length of the symbols under the table in use.
    parametric_bits : float
        Code length under the cheapest fitted distribution; where tables alone are sent, as with
        profiles ``l``, ``m`` and ``s``, the same as `coded_bits`.
    shannon_bits : float
        Their entropy times their number: the least that any static table can take.
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
        What was asked for.
    coarseness : float
        Factor on the profile's step sizes.
    steps : dict of str to tuple of float
        Finest and coarsest step size of each pass, as `inspect` reports them.
    file_bytes : int
        Size of the file.
    predicted_bytes : int or None
        With cameras: size expected before colours were refitted.
    psnr_drop : float or None
        PSNR loss of the views in dB, if the target is one.
    predicted_drop : float or None
        The same, expected from sensitivities.
    encodings : int
        Number of times the scene was encoded, including attempts with more Gaussians.
    pruned : int
        Gaussians pruned to meet the target.
    at_end : bool
        Whether no step sizes come nearer to the target: they are the finest possible, or for a
        PSNR loss the coarsest.
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
    """What the views of a coded scene lose, measured in windows that did not choose its steps.

    Attributes
    ----------
    psnr : float
        PSNR of the coded scene against the original, dB.
    loss : float
        PSNR against photographs that a scene of 30 dB loses by that, dB.
    worst : float
        The same of the 95th percentile of the windows.
    windows : int
        Number of windows.
    views : str
        ``given``: parts of held-out cameras, or of views between given ones; ``likely``: of places
        where cameras may have been.
    away : float, optional
        With given cameras: the loss in likely views, which other cameras may have.
    aimed : float, optional
        The loss that the step sizes aim at; None for a fixed size or fixed bits.
    encodings : int
        Number of times the scene was encoded to get there.
    remedy : str, optional
        What was done because the first result was worse than aimed at.
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
    """PSNR that views of 30 dB lose by an added mean squared error, dB."""
    return 10 * math.log10(1 + error / NOMINAL_ERROR)


@dataclass(frozen=True)
class ActionReport:
    """What an action did.

    Attributes
    ----------
    action : str
        As it was typed, without dashes.
    before, after : int
        Number of Gaussians before and after it.
    details : dict of str to int
        With ``remove-floaters``, how many were removed for each reason.
    seconds : float
        Wall time.
    """

    action: str
    before: int
    after: int
    details: dict[str, int]
    seconds: float


@dataclass(frozen=True)
class EncodeReport:
    """What `encode` did to a scene.

    Attributes
    ----------
    count : int
        Gaussians coded.
    raw_bytes : int
        Size of their float32 attributes.
    section_bytes : dict of str to int
        Bytes of the file by section, header and section table included.
    costs : list of ChannelCost
        Code lengths and entropies of the rANS-coded channels.
    rectified : int
        SH-AC values moved to the edge of their Laplace range; with profiles `l`, `m` and `s`,
        values of any attribute clamped to the largest of the lattice.
    zero_quaternions : int
        Quaternions of norm 0, coded as the identity.
    dropped : int
        Gaussians left out because they held NaN or infinity.
    seconds : dict of str to float
        Wall time of each stage.
    coarseness : float
        Factor on the step sizes of profile ``l``, ``m`` or ``s``: what was asked for, times what
        the scene needs without cameras, or what met a target.
    lost : tuple of str
        What a format other than `.egs` cannot hold, in words; with profiles ``paper-*``, how many
        Gaussians were moved nearer.
    rate : RateReport, optional
        How the target was met, if one was given.
    rendered : RenderedLoss, optional
        What rendered views lose; None if that was not measured, as with profile ``lossless``.
    prepared : dict, optional
        What preparation did, if there was any: `PrepareReport.as_dict`, with the steps of coding.
    input_bytes : int
        Size of the file that was encoded; 0 if the scene was in memory.
    ratio : float
        Compression ratio against that file, or against its floats if it is compressed or was
        edited; 0 if the scene was in memory.
    actions : tuple of ActionReport
        What each action did.
    sh_degree : int
        SH degree coded.
    float_bytes : int
        Size of the floats of the scene that was encoded, before pruning; 0 if it was in memory.
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
        """Size of words, states, models and quantisers over Shannon entropy, less 1."""
        entropy = sum(cost.shannon_bits for cost in self.costs)
        return self.coded_bits(self.costs) / entropy - 1 if entropy else 0.0

    def coded_bits(self, channels: Sequence[ChannelCost]) -> float:
        """Bits of all channels of some streams, with an equal share for each of what all use.

        Parameters
        ----------
        channels : sequence of ChannelCost
            All channels of one or several streams.

        Returns
        -------
        float
            Words, and a share of states, models and quantisers.
        """
        names = {cost.stream for cost in channels}
        shared = sum(self.section_bytes.get(name, 0) for name in _SHARED)
        words = sum(self.section_bytes.get(name, 0) for name in names)
        return 8 * (words + shared * len(channels) / max(len(self.costs), 1))


def bits_per_gaussian(size: int, count: int) -> float | None:
    """Bits of a file for each Gaussian in it; None without Gaussians."""
    return 8 * size / count if count else None


def finite(value: Any) -> Any:
    """A value for JSON, which has neither NaN nor infinity: they become None."""
    if isinstance(value, dict):
        return {name: finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def step_counter(progress: Progress | None, stage: str, total: int) -> Callable[[], None]:
    """A callback that counts the steps of a stage for `progress`, if there is one."""
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(stage, done, total)

    return advance
