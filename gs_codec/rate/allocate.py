"""Rate control: one number, the price of an error in bits, decides all steps of a scene.

Profiles `l`, `m` and `s` give each parameter of each Gaussian the step at which it adds the same
error, so that a bit saves as much wherever it is spent. What is left to choose is that error:
the coarseness of all steps together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.codec.clean import drop_nonfinite, identity_for_zero
from gs_codec.codec.guidance import Guidance
from gs_codec.codec.lattice_encode import model_lattice
from gs_codec.config import LATTICE_PROFILES, Config, Target
from gs_codec.errors import InvalidInput
from gs_codec.inspection import inspect_bytes
from gs_codec.preparation.targets import Targets
from gs_codec.rate.search import COARSEST, FINEST, expected, search
from gs_codec.report import EncodeReport, RateReport, StageTimes
from gs_codec.scene import Scene

Guide = Callable[[Scene], Guidance]

#: A size is met from below by at most this share.
_SIZE_TOLERANCE = 0.02

#: A loss is met from below by at most this, dB.
_DROP_TOLERANCE = 0.02

#: Log2 of a size, and of a loss, for each doubling of the steps; about.
_SIZE_SLOPE, _DROP_SLOPE = -0.45, 1.7

#: What SH compaction and refit save of a file, about, for the first guess.
_COMPACTION_SAVES = 0.1

#: Colours are refitted again if the steps have moved by more than this, log2.
_REFIT_AGAIN = 0.2
_MOST_REFITS = 5


def encode_to_target(
    scene: Scene,
    config: Config,
    target: Target,
    ply_bytes: int,
    guide: Guide | None = None,
    measured: Targets | None = None,
    before: float = 0.0,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene with steps as coarse or fine as a target asks.

    Parameters
    ----------
    scene : Scene
    config : Config
        Of profile ``l``, ``m`` or ``s``; where the search begins.
    target : Target
    ply_bytes : int
        Size of the scene as PLY.
    guide : callable, optional
        As for `encode_scene`; a quality needs it.
    measured : Targets, optional
        What losses are measured by; a quality needs them.
    before : float
        Mean squared error against them that nothing is lost at.

    Raises
    ------
    InvalidInput
        If the profile has no steps to choose, or the target is out of reach: with what is in.
    """
    if config.profile not in LATTICE_PROFILES:
        known = ", ".join(LATTICE_PROFILES)
        raise InvalidInput(f"target: profile '{config.profile}' has fixed steps, {known} have not")
    if not scene.count:
        raise InvalidInput("target: the scene has no Gaussians")
    clean, dropped = drop_nonfinite(scene, config)
    clean, zero_quaternions = identity_for_zero(clean)
    times = StageTimes()
    with times.stage("views"):
        guidance = guide(clean) if guide is not None else None
    trials = _Trials(clean, config, guidance, times)
    limit = target.limit(scene.count, ply_bytes)
    found: dict[str, Any]
    if limit is not None:
        found = _meet_size(trials, limit)
    elif trials.guidance is None or measured is None:
        raise InvalidInput("target psnr_drop: needs views")
    else:
        found = _meet_drop(trials, float(target.psnr_drop or 0), measured, before)
    data, report = trials.last
    steps = {i.name: (i.finest_step, i.coarsest_step) for i in inspect_bytes(data).passes}
    rate = RateReport(target, 2.0**trials.place, steps, len(data), encodings=trials.number, **found)
    return data, replace(
        report, dropped=dropped, zero_quaternions=zero_quaternions, seconds=times.seconds, rate=rate
    )


@dataclass
class _Trials:
    """Encodings of a scene, whose colours are those refitted last.

    Attributes
    ----------
    scene : Scene
        As given.
    config : Config
    guidance : Guidance or None
    times : StageTimes
    coloured : Scene
        With colours that were refitted.
    place : float
        Log2 of the coarseness of `last`.
    last : tuple
        File and report of the last encoding.
    number : int
        How many there were, those for refitting included.
    """

    scene: Scene
    config: Config
    guidance: Guidance | None
    times: StageTimes
    coloured: Scene = field(init=False)
    place: float = 0.0
    last: tuple[bytes, EncodeReport] = field(init=False)
    number: int = 0

    def __post_init__(self) -> None:
        self.coloured = self.scene

    def config_at(self, place: float) -> Config:
        return replace(self.config, coarseness=2.0**place)

    def size(self, place: float) -> int:
        """Encode, colours as they are; the bytes of the file."""
        guide = None
        if self.guidance is not None:
            kept = replace(self.guidance, recolour=lambda decoded, *_: decoded)
            guide = lambda _: kept  # noqa: E731
        with self.times.stage("search"):
            self.last = encode_scene(self.coloured, self.config_at(place), guide=guide)
        self.place = place
        self.number += 1
        return len(self.last[0])

    def refit(self, place: float) -> None:
        """Let views choose colours for steps as coarse."""
        if self.guidance is None:
            return
        guidance = self.guidance
        with self.times.stage("recolour"):
            modelled = model_lattice(
                self.scene, self.config_at(place), lambda _: guidance, StageTimes()
            )
        self.coloured = modelled.arranged.source
        self.number += 1


def _meet_size(trials: _Trials, limit: int) -> dict[str, Any]:
    """Search for steps at which the file is as large as it may be."""
    interval = ((1 - _SIZE_TOLERANCE) * limit, float(limit))
    predicted, start = None, 0.0
    if trials.guidance is not None:
        room = 1 + _COMPACTION_SAVES
        search(trials.size, room * interval[0], room * interval[1], start, _SIZE_SLOPE)
        predicted, start = round(len(trials.last[0]) / room), trials.place
    if _search_refitting(trials, trials.size, interval, start, _SIZE_SLOPE) is None:
        least, most = (trials.size(end) for end in (COARSEST, FINEST))
        raise InvalidInput(f"target {limit:,} bytes: {least:,} to {most:,} bytes are in reach")
    return {"predicted_bytes": predicted, "psnr_drop": None, "predicted_drop": None}


def _meet_drop(trials: _Trials, wanted: float, measured: Targets, before: float) -> dict[str, Any]:
    """Search for steps at which views lose as much as they may."""
    drops: dict[float, float] = {}

    def drop(place: float) -> float:
        trials.size(place)
        drops[place] = measured.drop(measured.error(decode_scene(trials.last[0])), before)
        return drops[place]

    allowed = measured.error_for(wanted, before) - before
    at_once = trials.config_at(0.0).resolved_lattice().error
    start = min(max(0.5 * math.log2(allowed / at_once), FINEST), COARSEST)
    interval = (wanted - _DROP_TOLERANCE, wanted)
    if _search_refitting(trials, drop, interval, start, _DROP_SLOPE) is None:
        least, most = (drop(end) for end in (FINEST, COARSEST))
        raise InvalidInput(f"target {wanted:g} dB: {least:.4f} to {most:.4f} dB are in reach")
    predicted = measured.drop(before + at_once * 4.0**trials.place, before)
    return {
        "predicted_bytes": None,
        "psnr_drop": drops[trials.place],
        "predicted_drop": predicted,
    }


def _search_refitting(
    trials: _Trials,
    measure: Callable[[float], float],
    interval: tuple[float, float],
    start: float,
    slope: float,
) -> float | None:
    """`search`, with colours refitted for steps about as coarse as are found."""
    place = start
    for _ in range(_MOST_REFITS if trials.guidance is not None else 0):
        trials.refit(place)
        value = measure(place)
        if interval[0] <= value <= interval[1]:
            return place
        following = expected(value, *interval, place, slope)
        if following == place:
            return None
        moved, place = abs(following - place), following
        if moved <= _REFIT_AGAIN:
            break
    return search(measure, *interval, place, slope)
