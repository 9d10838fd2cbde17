"""At a size, a refined scene must be better than the same scene without refinement."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import Encoded
from gs_codec.encoding.request import Request
from gs_codec.rate.allocate import OutOfReach
from gs_codec.report import Progress
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.preparation.prepare_report import PrepareReport

log = logging.getLogger(__name__)

#: A refined scene is better without a comparison if it loses less than this share of what coarser
#: steps are predicted to lose at the same size. On fox, village and mouse they lose 1.0 to 2.2
#: times the prediction.
_CLEAR = 0.5


def better_of(
    encoded: Encoded,
    encode_unrefined: Callable[[], Encoded],
    scene: Scene,
    request: Request,
    done: PrepareReport,
    progress: Progress | None = None,
) -> Encoded:
    """A refined and encoded scene or, if it loses less, the scene encoded without refinement.

    Losses are those of held-out views. The scene is encoded without refinement only in case of
    doubt, and if refinement alone made pruning pay.

    Parameters
    ----------
    encoded : (parts, EncodeReport)
        The refined scene, or the one pruned for a refinement that was rejected.
    encode_unrefined : callable
        Encodes to the same size.
    scene : Scene
        Before preparation.
    request : Request
    done : PrepareReport
    progress : callable, optional
    """
    plan, held_out = request.plan, done.views.held_out
    if plan is None or not plan.steps.balanced or plan.steps.keep_refined:
        return encoded
    before = held_out.errors(scene, progress)

    def loss(other: Encoded) -> float:
        decoded = decode_as(request.config, b"".join(other[0]))
        return held_out.drop(held_out.errors(decoded, progress), before)

    lost = loss(encoded)
    pruning = next(step for step in done.steps if "unpruned" in step.details)
    coarser = held_out.drop(before + pruning.details["unpruned"], before)
    if not done.rejected and lost < _CLEAR * coarser:
        return encoded
    try:
        unrefined = encode_unrefined()
    except OutOfReach:
        return encoded
    other = loss(unrefined)
    if other > lost:
        return encoded
    log.warning(
        "refine: skipped, because held-out views lose %.3f dB at this size, and %.3f dB without it",
        lost,
        other,
    )
    return unrefined
