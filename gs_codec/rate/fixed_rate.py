"""Rate targets for formats with the same number of bits for every Gaussian: met by pruning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import Encoded, encode_scene
from gs_codec.config import Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.plan import Plan
from gs_codec.rate.search import Seen
from gs_codec.report import EncodeReport, RateReport
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

#: Encodes a scene according to a plan.
Encode = Callable[[Plan | None], Encoded]

#: Maximum number of times a scene is pruned, as views may lose more than those that guide pruning.
_ATTEMPTS = 4

#: The next attempt aims at this share of the loss that pruning may cause. It grows about with the
#: square root of what the guiding views are allowed to lose, if these are few.
_CAUTION = 0.9

#: Maximum difference between the headers of two scenes, in bytes.
_HEADER = 256


def meet_by_count(
    encode: Encode,
    scene: Scene,
    ply_bytes: int,
    config: Config,
    target: RateTarget,
    plan: Plan | None,
    see: Callable[[Plan], Seen],
) -> Encoded:
    """Meet a target by pruning: keep as many Gaussians as it allows, the most visible ones.

    `see` returns how a loss is measured.

    Raises InvalidInput if the target is unreachable.
    """
    limit = target.limit(scene.count, ply_bytes)
    if limit is None:
        return _meet_drop(encode, scene, config, target, plan or Plan(), see)
    count = _most(scene, config, limit)
    if count < scene.count:
        chosen = plan or Plan()
        plan = replace(chosen, steps=replace(chosen.steps, gaussians=count))
    parts, report = encode(plan)
    return parts, _with_rate(report, scene, target, 1)


def _most(scene: Scene, config: Config, limit: int) -> int:
    """Maximum number of Gaussians in a file of at most `limit` bytes."""
    one, all_of_them = (
        len(encode_scene(scene.between(0, stop), config)[0]) for stop in (1, scene.count)
    )
    if all_of_them <= limit:
        return scene.count
    each = (all_of_them - one) / max(scene.count - 1, 1)
    count = 1 + math.floor((limit - one - _HEADER) / max(each, 1))
    if count < 1:
        raise InvalidInput(f"target {counted(limit, 'byte')}: one Gaussian alone takes {one:,}")
    return count


def _meet_drop(
    encode: Encode,
    scene: Scene,
    config: Config,
    target: RateTarget,
    plan: Plan,
    see: Callable[[Plan], Seen],
) -> Encoded:
    """Prune as far as a loss allows, in addition to the loss of the format itself."""
    seen, limit = see(plan), float(target.psnr_drop or 0)

    def loss(parts: list[bytes | memoryview]) -> float:
        return seen.loss(decode_as(config, b"".join(parts), seen.progress))

    parts, report = encode(plan)
    own = loss(parts)
    if own > limit:
        raise InvalidInput(f"target {limit:g} dB: the format itself loses {own:.4f} dB")
    allowed = limit - own
    for attempt in range(2, 2 + _ATTEMPTS):
        steps = replace(plan.steps, prune_max_psnr_drop=allowed)
        pruned, fewer = encode(replace(plan, steps=steps))
        lost = loss(pruned)
        if lost <= limit:
            return pruned, _with_rate(fewer, scene, target, attempt, lost)
        allowed *= (_CAUTION * (limit - own) / (lost - own)) ** 2
    return parts, _with_rate(report, scene, target, 1 + _ATTEMPTS, own)


def _with_rate(
    report: EncodeReport,
    scene: Scene,
    target: RateTarget,
    encodings: int,
    lost: float | None = None,
) -> EncodeReport:
    pruned = scene.count - report.count
    at_end = lost is None and not pruned
    rate = RateReport(
        target, 1.0, {}, report.file_bytes, None, lost, None, encodings, pruned, at_end
    )
    return replace(report, rate=rate)
