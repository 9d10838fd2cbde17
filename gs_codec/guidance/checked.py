"""Encode, measure what views lose, and encode again with finer steps if that is too much."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import Encoded
from gs_codec.config import EGS, Config
from gs_codec.errors import InvalidInput
from gs_codec.guidance.calibrate import finer, wanted_error
from gs_codec.guidance.check import Check, error_of
from gs_codec.report import RenderedLoss, StageTimes, psnr_loss
from gs_codec.runtime.arrays import current
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.preparation.reference_views import Origin

log = logging.getLogger(__name__)

#: Most times that a scene is encoded.
_MOST_ENCODINGS = 3

#: Views may lose this many times the error aimed at; guided by estimated cameras, less, as windows
#: may show less than true views lose: by a third on fox, by half on village.
_ALLOWED, _ALLOWED_ESTIMATED = 2.0, 1.25

#: Finer steps that leave more than this share of the error are not worth their bits.
_HELPS = 0.8

#: Given cameras are those of another scene, scale or system if likely views, or their own held-out
#: ones, lose so many times the error aimed at. Right ones lose up to 42 times as much in likely
#: views, wrong ones 118 times and more (fox, bonsai, village and nine generated captures).
_MISFIT = 70.0

#: They also are if more than this share of their windows shows nothing. Right ones see the scene in
#: nearly all of their views.
_BLANK = 0.75

#: Encodes with a configuration; keeps decoded values of the Gaussians that are given.
Encode = Callable[[Config, Watched | None], Encoded]

#: An encoded scene, or what becomes one.
Result = TypeVar("Result")

#: Encodes with a configuration, and measures what views lose; None if the scene shows too little.
Attempt = Callable[[Config], tuple[Result, RenderedLoss | None]]


def measuring(
    encode: Encode, config: Config, check: Check, times: StageTimes, keeps: bool = True
) -> Attempt[Encoded]:
    """Encode and measure; `keeps` says whether `encode` can keep decoded values."""

    def attempt(chosen: Config) -> tuple[Encoded, RenderedLoss | None]:
        watched = check.watch() if keeps else None
        encoded = encode(chosen, watched)
        with times.stage("measure"):
            return encoded, _measure(encoded, config, check, watched)

    return attempt


def encode_checked(
    attempt: Attempt[Result],
    config: Config,
    chosen: Config,
    check: Check,
    origin: Origin | None = None,
) -> tuple[Result, RenderedLoss | None] | None:
    """Encode a scene, again with finer steps if views lose too much.

    Parameters
    ----------
    attempt : callable
    config, chosen : Config
        As asked for, and with the coarseness that suits the scene.
    check : Check
    origin : str, optional
        Where the cameras come from that guide the steps.

    Returns
    -------
    result, loss
        Of the best attempt. None if the cameras do not fit the scene.

    Raises
    ------
    InvalidInput
        If views lose too much, and the configuration is strict.
    """
    aim = wanted_error(config) if config.has_steps and not config.depths else None
    allowed = _ALLOWED_ESTIMATED if origin == "estimated" else _ALLOWED
    best: tuple[Result, RenderedLoss] | None = None
    for encodings in range(1, _MOST_ENCODINGS + 1):
        result, loss = attempt(chosen)
        if origin is not None and (misfit := _misfit(check, loss, aim)):
            if config.strict:
                raise InvalidInput(f"cameras do not fit the scene: {misfit}")
            log.warning("cameras do not fit the scene: %s; encoded without them", misfit)
            return None
        if loss is None:
            return result, None
        error = error_of(loss.loss)
        loss = replace(loss, aimed=None if aim is None else psnr_loss(aim), encodings=encodings)
        if best is not None:
            if error > _HELPS * error_of(best[1].loss):
                break
            remedy = f"steps {chosen.coarseness / config.coarseness:.2f}x those of the profile"
            loss = replace(loss, remedy=remedy)
        best = result, loss
        if aim is None or error <= allowed * aim:
            break
        again = finer(chosen, aim / error)
        if again == chosen:
            break
        chosen = again
    assert best is not None
    tell(best[1], config)
    return best


def _misfit(check: Check, loss: RenderedLoss | None, aim: float | None) -> str | None:
    """Why cameras seem to be those of another scene, if so."""
    if check.blank > _BLANK:
        return f"{check.blank:.0%} of what they see is empty"
    most = 0.0 if loss is None else max(loss.loss, loss.away or 0.0)
    if aim is not None and error_of(most) > _MISFIT * aim:
        return f"guided by them, views lose {most:.1f} dB"
    return None


def _measure(
    encoded: Encoded, config: Config, check: Check, watched: Watched | None
) -> RenderedLoss | None:
    if watched is not None:
        return check.measure_watched(watched)
    if not check.windows:
        return None
    if current().limit is not None:
        return None  # The decoded scene would have to fit into memory.
    return check.measure(_decoded(encoded, config))


def _decoded(encoded: Encoded, config: Config) -> Scene:
    return decode_as(config, b"".join(encoded[0]))


def tell(loss: RenderedLoss, config: Config) -> None:
    """Warn if views lose too much, or refuse to go on."""
    if loss.aimed is None or loss.loss <= 2 * loss.aimed:
        return
    text = f"rendered views lose {loss.loss:.2f} dB, aimed at {loss.aimed:.2f} dB"
    if config.format != EGS:
        text += f": more than steps can change, as .{config.format} has its own limits"
    if config.strict:
        raise InvalidInput(text)
    log.warning(text)
