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
from gs_codec.preparation.view_selection import choose_views
from gs_codec.report import EncodeReport, Progress, RateReport
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

#: Encodes a scene according to a plan.
Encode = Callable[[Plan | None], Encoded]

#: Maximum number of times pruning is repeated because held-out views lose more than predicted.
_ATTEMPTS = 4

#: Maximum difference between the headers of two scenes, in bytes.
_HEADER = 256


def meet_by_count(
    encode: Encode,
    scene: Scene,
    ply_bytes: int,
    config: Config,
    target: RateTarget,
    plan: Plan | None,
    progress: Progress | None,
) -> Encoded:
    """Meet a target by pruning: keep as many Gaussians as it allows, the most visible ones.

    Raises InvalidInput if the target is unreachable.
    """
    limit = target.limit(scene.count, ply_bytes)
    if limit is None:
        return _meet_drop(encode, scene, config, target, plan or Plan(), progress)
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
    progress: Progress | None,
) -> Encoded:
    """Prune as far as a loss allows, in addition to the loss of the format itself."""
    views, limit = choose_views(scene, plan, progress).held_out, float(target.psnr_drop or 0)
    before = views.errors(scene, progress)

    def loss(data: bytes) -> float:
        return views.drop(views.errors(decode_as(config, data, progress), progress), before)

    allowed = limit - loss(encode_scene(scene, config)[0])
    for attempt in range(1, _ATTEMPTS + 1):
        steps = plan.steps
        if allowed > 0:
            steps = replace(steps, prune_max_psnr_drop=allowed)
        parts, report = encode(replace(plan, steps=steps))
        lost = loss(b"".join(parts))
        if lost <= limit:
            return parts, _with_rate(report, scene, target, attempt, lost)
        if allowed <= 0:
            break
        allowed -= max(lost - limit, 0.1 * limit)
    raise InvalidInput(f"target {limit:g} dB: the format itself loses {lost:.4f} dB")


def _with_rate(
    report: EncodeReport,
    scene: Scene,
    target: RateTarget,
    encodings: int,
    lost: float | None = None,
) -> EncodeReport:
    pruned = scene.count - report.count
    rate = RateReport(
        target, 1.0, {}, report.file_bytes, None, lost, None, encodings, pruned, at_end=not pruned
    )
    return replace(report, rate=rate)
