"""Encoding with cameras, or to a rate target."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import (
    Encoded,
    encode_clean,
    encode_parts,
    encode_shaped,
    shape_scene,
)
from gs_codec.codecs.memory_limit import check_encoding
from gs_codec.coding.clean import clean_scene
from gs_codec.config import (
    ADAPTIVE_PROFILES,
    EGS,
    LOSSLESS,
    Config,
    RateTarget,
    as_rate_target,
)
from gs_codec.errors import InvalidInput
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.codecs.adaptive.watched import Watched
    from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
    from gs_codec.preparation.steps import Plan


log = logging.getLogger(__name__)

#: Minimum share of the Gaussians that a scene's cameras see: with other cameras, unseen Gaussians
#: would be very coarse.
_LEAST_SEEN = 0.1


def encode_by_plan(
    scene: Scene,
    ply_bytes: int,
    config: Config,
    plan: Plan | None = None,
    rate: RateTarget | Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene, of `ply_bytes` uncompressed, for `encode` and `encode_file`.

    Raises
    ------
    InvalidInput
        If there are no cameras, no Gaussian would remain, the profile has no adjustable step sizes
        for a rate target, or the target cannot be reached.
    """
    target = None if rate is None else as_rate_target(rate)
    if target is not None:
        _check_target(scene, config, target, plan)
    elif plan is None or not plan.steps.wanted:
        return encode_planned(scene, config, plan, progress)
    data, report = _prepared_or_to_target(scene, ply_bytes, config, plan, target, progress)
    return data, _measured(scene, config, plan, target, data, report)


def _measured(
    scene: Scene,
    config: Config,
    plan: Plan | None,
    target: RateTarget | None,
    data: bytes,
    report: EncodeReport,
) -> EncodeReport:
    """Add the loss in views, relative to the scene before preparation, to a report."""
    from gs_codec.encoding.loss import Check
    from gs_codec.encoding.retry import tell

    times = StageTimes()
    with times.stage("measure"), using_threads(config.threads):
        clean, _ = clean_scene(scene, config)
        loss = Check.by_plan(clean, plan).measure(decode_as(config, data))
    if loss is not None:
        aimed = None if target is None else target.psnr_drop
        loss = replace(loss, aimed=aimed)
        if (coded := report.rendered) is not None:
            loss = replace(loss, encodings=coded.encodings, remedy=coded.remedy)
        tell(loss, config)
    taken = times.seconds["measure"] + report.seconds.get("measure", 0.0)
    return replace(report, rendered=loss, seconds=report.seconds | {"measure": taken})


def _prepared_or_to_target(
    scene: Scene,
    ply_bytes: int,
    config: Config,
    plan: Plan | None,
    target: RateTarget | None,
    progress: Progress | None,
) -> tuple[bytes, EncodeReport]:
    if target is not None and config.scene_format.writes != "steps":
        from gs_codec.rate.fixed_rate import meet_target

        def encode(plan: Plan | None) -> tuple[bytes, EncodeReport]:
            return encode_by_plan(scene, ply_bytes, config, plan, None, progress)

        return meet_target(encode, scene, ply_bytes, config, target, plan, progress)
    if plan is None or not plan.steps.wanted:
        return _encode(scene, scene, ply_bytes, config, plan, target, progress)
    times, original = StageTimes(), scene
    with times.stage("prepare"):
        from gs_codec.preparation.balance import profile_steps
        from gs_codec.preparation.pipeline import prepare_scene
        from gs_codec.rate.allocate import step_error_for

        steps_of = profile_steps(config)
        if target is not None:
            known = original, ply_bytes, config, target
            steps_of = partial(step_error_for, *known, progress=progress)
        scene, prepared = prepare_scene(scene, plan, progress, steps_of)
    views = prepared.views
    data, report = _encode(scene, original, ply_bytes, config, plan, target, progress, views)
    times.seconds |= report.seconds
    with times.stage("measure"):
        told = prepared.coded(scene, config, data, report).as_dict()
    return data, replace(report, seconds=times.seconds, prepared=told)


def _encode(
    scene: Scene,
    original: Scene,
    ply_bytes: int,
    config: Config,
    plan: Plan | None,
    target: RateTarget | None,
    progress: Progress | None,
    views: ViewSplit | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene made from the original; ratios are relative to the original's bytes."""
    if target is None:
        references = None if views is None else views.renders
        return encode_planned(scene, config, plan, progress, references)
    from gs_codec.rate.allocate import encode_to_target

    return encode_to_target(scene, original, ply_bytes, config, target, plan, progress, views)


def _check_target(scene: Scene, config: Config, target: RateTarget, plan: Plan | None) -> None:
    """Reject targets without adjustable step sizes, before any work."""
    if config.profile not in ADAPTIVE_PROFILES:
        known = ", ".join(ADAPTIVE_PROFILES)
        raise InvalidInput(f"target: profile '{config.profile}' has fixed steps, expected {known}")
    if not scene.count:
        raise InvalidInput("target: the scene has no Gaussians")
    if target.allow_prune and plan is not None and plan.steps.balanced:
        raise InvalidInput("allow_prune: not needed with refine, which prunes to meet a target")


def encode_planned(
    scene: Scene,
    config: Config,
    plan: Plan | None,
    progress: Progress | None = None,
    references: ReferenceViews | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene; a plan's views guide it if the profile has step sizes.

    `references` are these views, if already known.
    """
    fixed = config.profile not in ADAPTIVE_PROFILES or config.scene_format.is_exact
    if plan is None or fixed or not scene.count:
        return _camera_free(scene, config, progress)
    from gs_codec.preparation.pipeline import guiding_views

    references = guiding_views(scene, plan, references, progress)
    if references is None:
        return _camera_free(scene, config, progress)
    with using_threads(config.threads):
        guided = _guided(scene, config, plan, references, progress)
    if guided is None:
        return _camera_free(scene, config, progress)
    loss = guided[1].rendered
    if references.origin == "estimated" and loss is not None and loss.encodings > 1:
        # If estimated cameras need much finer steps, they may save nothing.
        free = _camera_free(scene, config, progress)
        if len(free[0]) <= len(guided[0]):
            log.warning(
                "cameras 'auto': estimated cameras save nothing for this scene; encoded camera-free"
            )
            return free
    return guided


def _guided(
    scene: Scene,
    config: Config,
    plan: Plan,
    references: ReferenceViews,
    progress: Progress | None,
) -> tuple[bytes, EncodeReport] | None:
    """Encode a scene guided by these views; None if they do not fit it."""
    from gs_codec.encoding.loss import Check
    from gs_codec.encoding.retry import encode_checked, measuring, warn_misfit
    from gs_codec.guidance.guide import guide

    times = StageTimes()
    with times.stage("check"):
        clean, changed = clean_scene(scene, config)
    if not clean.count:
        return None
    with times.stage("views"):
        guidance = guide(clean, references, progress)
    seen = float(np.mean(guidance.weights.max(axis=0) > 0))
    if seen < _LEAST_SEEN:
        warn_misfit(f"they see {seen:.0%} of the Gaussians", config)
        return None
    with times.stage("measure"):
        check = Check.by_plan(clean, plan)

    def encode(config: Config, watched: Watched | None) -> Encoded:
        profile = config.adaptive_profile()
        steps = guidance.steps(profile)
        shaped = shape_scene(clean, config, steps, times, progress, watched)
        with times.stage("recolour"):
            shaped = shaped.with_colours(guidance.recolour(shaped, profile))
        return encode_shaped(shaped, times, progress)

    attempt = measuring(encode, config, check, times, keeps=config.format == EGS)
    found = encode_checked(attempt, config, config, check, references.origin)
    if found is None:
        return None
    (parts, report), loss = found
    report = replace(report, **changed, rendered=loss, seconds=times.seconds)
    return b"".join(parts), report


def _camera_free(
    scene: Scene, config: Config, progress: Progress | None
) -> tuple[bytes, EncodeReport]:
    parts, report = encode_camera_free(scene, config, progress)
    return b"".join(parts), report


def encode_camera_free(
    scene: Scene, config: Config, progress: Progress | None = None
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene to the consecutive pieces of a file, with calibrated step sizes.

    Raises
    ------
    InvalidInput, MissingTool, ToolFailed
        As in `encode_scene`; or if views lose too much and the configuration is strict.
    """
    if config.profile == LOSSLESS or not scene.count:
        return encode_parts(scene, config, progress)
    from gs_codec.encoding.loss import Check
    from gs_codec.encoding.retry import encode_checked, measuring
    from gs_codec.guidance.calibrate import calibrated
    from gs_codec.guidance.windows import choose_windows, sample_of

    times = StageTimes()
    with using_threads(config.threads, scene.count):
        check_encoding(scene.count, config)
        chosen = config
        with times.stage("calibrate" if config.has_steps else "measure"):
            windows = choose_windows(sample_of(scene), scene.count)
            if config.has_steps:
                chosen = calibrated(scene, config, progress, windows)
        with times.stage("check"):
            clean, changed = clean_scene(scene, config)
        with times.stage("measure"):
            check = Check.of(clean, windows.checking)

        def encode(config: Config, watched: Watched | None) -> Encoded:
            return encode_clean(clean, config, times, progress, watched=watched)

        keeps = config.profile in ADAPTIVE_PROFILES and config.format == EGS
        attempt = measuring(encode, config, check, times, keeps)
        found = encode_checked(attempt, config, chosen, check)
        assert found is not None
        (parts, report), loss = found
    return parts, replace(report, **changed, rendered=loss, seconds=times.seconds)
