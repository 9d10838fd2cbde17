"""The stages of an encode, in order.

- edit: the actions of the request, in their order
- prepare: prune, refine, ... according to its plan
- guide: measure the visibility of each Gaussian in the plan's views; or, without a plan,
- calibrate: choose the coarseness of the scene
- shape: quantise everything except colours
- colour: compact colours and refit them to the views, given the quantised shapes
- round: move values to levels whose errors cancel in the views
- code: write the stream
- check: measure the loss of rendered views; if it is too high, repeat from shape with finer steps

To meet a rate target, `gs_codec.rate` repeats shape, colour and code with different step sizes.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import Encoded, code_shaped, encode_cleaned, encode_parts, shape_scene
from gs_codec.codecs.interchange import pack_finest
from gs_codec.codecs.memory_limit import check_encoding
from gs_codec.coding.clean import clean_scene
from gs_codec.config import ADAPTIVE_PROFILES, EGS, LOSSLESS, Config
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.levels.adding import add_levels
from gs_codec.report import ActionReport, EncodeReport, Progress, StageTimes
from gs_codec.runtime.kept_logs import keeping_new
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.codecs.adaptive.watched import Watched
    from gs_codec.guidance.guide import Guidance
    from gs_codec.guidance.windows import Windows
    from gs_codec.plan import Plan
    from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
    from gs_codec.rate.search import Seen


log = logging.getLogger(__name__)

#: Loggers that warn about views, in each encoding of several.
_OF_VIEWS = ("gs_codec.encoding.retry", "gs_codec.preparation.view_selection")

#: Minimum share of the Gaussians visible to the cameras; otherwise the many unseen ones would be
#: very coarse.
_LEAST_SEEN = 0.1


def encode(
    scene: Scene,
    request: Request,
    progress: Progress | None = None,
    ply_bytes: int = 0,
    *,
    translated: bool = False,
    finest: bool = False,
) -> Encoded:
    """Encode a scene to the consecutive pieces of a file.

    Raises InvalidInput if values are not finite, there are no cameras, no Gaussian would be left,
    the rate cannot be reached, or views lose too much and the configuration is strict. Raises
    MissingTool or ToolFailed if a program that the configuration asks for is missing or fails.

    Parameters
    ----------
    scene : Scene
    request : Request
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.
    ply_bytes : int
        Reference size for compression ratios; after actions, the floats are used instead.
    translated : bool
        Whether the first action, a translation, was already applied when the scene was read.
    finest : bool
        Whether to write a format other than `.egs` as finely as possible, whatever the profile.

    Returns
    -------
    parts : list of bytes
    report : EncodeReport
    """
    config, times = request.config, StageTimes()
    plan, rate = request.plan, request.rate
    if rate is not None and rate.measures and plan is not None and not plan.estimates:
        request = replace(request, plan=replace(plan, holds_out=True))
    with using_threads(config.threads):
        scene, actions = _edit(scene, request, times, progress, translated)
        ply_bytes = scene.float_bytes if actions else ply_bytes
        if finest:
            parts, report = _encode_finest(scene, config)
        else:
            parts, report = _encode_edited(scene, request, progress, ply_bytes)
        parts, report = add_levels(parts, report, config, progress)
        if config.format == EGS:
            report = replace(report, lost=(*report.lost, *left_out_of(scene, config.scene_format)))
    return parts, replace(
        report,
        seconds=times.seconds | report.seconds,
        ratio=ply_bytes / report.file_bytes,
        actions=actions,
        float_bytes=scene.float_bytes,
    )


def _edit(
    scene: Scene,
    request: Request,
    times: StageTimes,
    progress: Progress | None,
    translated: bool,
) -> tuple[Scene, tuple[ActionReport, ...]]:
    if not request.actions:
        return scene, ()
    from gs_codec.edit.apply import edit_scenes

    plan, actions = request.plan, request.actions
    with times.stage("edit"):
        return edit_scenes([scene], actions, plan, progress, translated, check_by(plan))


def check_by(plan: Plan | None) -> Callable[[Scene, Scene], None] | None:
    """Warns if given cameras, which guided an action, do not fit the scene; None without them."""
    if plan is None or plan.estimates:
        return None

    def check(before: Scene, after: Scene) -> None:
        from gs_codec.encoding.retry import loss_by_plan
        from gs_codec.guidance.windows import cleaned

        loss_by_plan(cleaned(before), cleaned(after), plan, Config())

    return check


def _encode_finest(scene: Scene, config: Config) -> Encoded:
    """Encode a scene as finely as its format allows, and measure the loss."""
    from gs_codec.encoding.loss import Check

    times = StageTimes()
    parts, report = pack_finest(scene, config)
    with times.stage("measure"):
        clean = turn_axes(clean_scene(scene, config)[0])
        loss = Check.by_plan(clean, None).measure(turn_axes(decode_as(config, b"".join(parts))))
    return parts, replace(report, rendered=loss, seconds=report.seconds | times.seconds)


def _encode_edited(
    scene: Scene, request: Request, progress: Progress | None, ply_bytes: int
) -> Encoded:
    """Prepare a scene and encode it, to a rate target if there is one."""
    config, rate = request.config, request.rate
    if rate is None and not request.prepares:
        return encode_prepared(scene, request, progress)
    if rate is not None and not scene.count:
        raise InvalidInput("target: the scene has no Gaussians")
    if rate is not None and not config.has_steps:
        from gs_codec.rate.fixed_rate import meet_by_count

        def encode_as_planned(plan: Plan | None) -> Encoded:
            planned = replace(request, plan=plan, rate=None)
            return _encode_edited(scene, planned, progress, ply_bytes)

        def see(plan: Plan) -> Seen:
            return _see(scene, config, plan, None, progress)

        with keeping_new(_OF_VIEWS, set()):
            encoded = meet_by_count(
                encode_as_planned, scene, ply_bytes, config, rate, request.plan, see
            )
            return _check_whole(scene, request, *encoded)
    return _check_whole(scene, request, *_encode_planned(scene, request, progress, ply_bytes))


def _prepare(scene: Scene, request: Request, progress: Progress | None, ply_bytes: int) -> Encoded:
    """Prepare a scene according to its plan, and encode the result."""
    from gs_codec.encoding.unrefined import better_of
    from gs_codec.preparation.balance import profile_steps
    from gs_codec.preparation.pipeline import prepare_scene, without_refinement
    from gs_codec.rate.allocate import OutOfReach, step_error_for

    config, plan, rate, times = request.config, request.plan, request.rate, StageTimes()
    assert plan is not None
    clean_scene(scene, config)  # raises before the steps, which may take hours
    steps_of, at_size = profile_steps(config), False
    if rate is not None:
        steps_of = partial(step_error_for, scene, ply_bytes, config, rate, progress=progress)
        at_size = rate.psnr_drop is None
    with times.stage("prepare"):
        prepared, done = prepare_scene(scene, plan, progress, steps_of, keep_pruned=at_size)
    unrefined = replace(request, plan=without_refinement(plan))
    encode_unrefined = partial(_encode_planned, scene, unrefined, progress, ply_bytes)
    chosen = unrefined if done.rejected else request
    if rate is None:
        parts, report = encode_prepared(prepared, chosen, progress, done.views.renders)
    else:
        try:
            parts, report = encode_to_rate(prepared, scene, chosen, progress, ply_bytes, done.views)
        except OutOfReach as error:
            if at_size or not plan.steps.balanced:
                raise
            log.warning("refine: skipped; with it, %s", error)
            return encode_unrefined()
    times.seconds |= report.seconds
    with times.stage("measure"):
        done = done.coded(prepared, config, b"".join(parts), report)
    encoded = parts, replace(report, seconds=times.seconds, prepared=done.as_dict())
    return (
        better_of(encoded, encode_unrefined, scene, request, done, progress) if at_size else encoded
    )


def _encode_planned(
    scene: Scene, request: Request, progress: Progress | None, ply_bytes: int
) -> Encoded:
    """Encode a scene to a target, after the steps of its plan if there are any."""
    if request.prepares:
        return _prepare(scene, request, progress, ply_bytes)
    return encode_to_rate(scene, scene, request, progress, ply_bytes)


def encode_to_rate(
    scene: Scene,
    original: Scene,
    request: Request,
    progress: Progress | None = None,
    ply_bytes: int = 0,
    views: ViewSplit | None = None,
) -> Encoded:
    """Encode a prepared scene at the step sizes that meet a target, relative to the original.

    With a plan, its views guide the step sizes. A loss in dB is measured in the held-out views,
    against ground-truth images if there are any. Without a plan, a loss in dB or pruning uses views
    that are estimated from the scene. `views` are the plan's, if already known. Raises InvalidInput
    if the target is unreachable; the error gives the range.
    """
    from gs_codec.plan import Plan
    from gs_codec.preparation.view_selection import guiding_views
    from gs_codec.rate.allocate import meet_rate
    from gs_codec.rate.search import RateSearch

    config, plan, rate = request.config, request.plan, request.rate
    assert rate is not None
    limit, seen, references = rate.limit(original.count, ply_bytes), None, None
    if rate.measures:
        plan = plan or Plan()
        seen = _see(original, config, plan, views, progress)
        views = seen.views
    if plan is not None:
        known = None if views is None else views.renders
        references = guiding_views(scene, plan, known, progress)
    clean, changed = clean_scene(scene, config)
    data, report = meet_rate(clean, RateSearch(config, rate, limit, references, seen, progress))
    return [data], replace(report, **changed)


def _see(
    original: Scene,
    config: Config,
    plan: Plan,
    views: ViewSplit | None,
    progress: Progress | None,
) -> Seen:
    """The views of a plan, and how a loss is measured with a target.

    In estimated cameras, which guide the encoder, the loss would seem too small: fox, asked for 0.1
    dB, lost 0.23 dB in its own views. So it is measured as it is reported.
    """
    from gs_codec.encoding.loss import Check
    from gs_codec.preparation.view_selection import choose_views
    from gs_codec.rate.search import Seen

    views = views or choose_views(original, plan, progress)
    seen = Seen(views, views.held_out.errors(original, progress), progress)
    if not plan.estimates:
        return seen
    return replace(seen, check=Check.by_plan(clean_scene(original, config)[0], plan).measure)


def encode_prepared(
    scene: Scene,
    request: Request,
    progress: Progress | None = None,
    references: ReferenceViews | None = None,
) -> Encoded:
    """Encode a prepared scene guided by its plan's views; camera-free if no views fit.

    `references` are these views, if already known. With a target, the loss is not measured, and
    step sizes stay as they are.
    """
    views = _guiding_views(scene, request, progress, references)
    with using_threads(request.config.threads):
        guided = None if views is None else _encode_by(views, scene, request, progress)
    if views is None or guided is None:
        return _encode_camera_free(scene, request, progress)
    loss = guided[1].rendered
    if views.origin == "estimated" and loss is not None and loss.encodings > 1:
        # If estimated cameras need much finer steps, they may save nothing.
        free = _encode_camera_free(scene, request, progress)
        if free[1].file_bytes <= guided[1].file_bytes:
            log.warning(
                "cameras 'auto': estimated cameras save nothing for this scene; encoded camera-free"
            )
            return free
    return guided


def _guiding_views(
    scene: Scene,
    request: Request,
    progress: Progress | None,
    references: ReferenceViews | None,
) -> ReferenceViews | None:
    """The plan's views, if they can guide the encoder."""
    config, plan = request.config, request.plan
    fixed = config.profile not in ADAPTIVE_PROFILES or config.scene_format.is_exact
    if plan is None or fixed or not scene.count:
        return None
    from gs_codec.preparation.view_selection import guiding_views

    return guiding_views(scene, plan, references, progress)


def _encode_camera_free(scene: Scene, request: Request, progress: Progress | None) -> Encoded:
    if request.config.profile == LOSSLESS or not scene.count:
        return encode_parts(scene, request.config, progress)
    with using_threads(request.config.threads, scene.count):
        encoded = _encode_by(None, scene, request, progress)
    assert encoded is not None
    return encoded


def _encode_by(
    views: ReferenceViews | None, scene: Scene, request: Request, progress: Progress | None
) -> Encoded | None:
    """Guide or calibrate, shape, colour, code and check; None if the views do not fit the scene."""
    from gs_codec.encoding.loss import Check
    from gs_codec.encoding.retry import encode_within_loss, measuring
    from gs_codec.guidance.windows import cleaned

    config, guidance, times = request.config, None, StageTimes()
    check_encoding(scene.count, config)
    chosen, windows = config, None
    with times.stage("check"):
        clean, changed = clean_scene(scene, config)
    if views is None:
        # As on several workers, which clean later; writers of other formats need a clean scene.
        source = scene if config.format == EGS else clean
        chosen, windows = _calibrate(source, config, times, progress)
    if views is not None:
        guidance = _guide(clean, config, views, times, progress)
        if guidance is None:
            return None
    code = partial(_code, clean, guidance, times, progress)
    if request.rate is not None:  # a trial, measured by its caller
        parts, report = code(chosen, None)
        return parts, replace(report, **changed, seconds=times.seconds)
    with times.stage("measure"):
        if windows is not None:
            check = Check.of(clean, windows.checking)
        elif views is not None and views.images and views.source is not None:
            # Colours are fitted to the scene before pruning.
            check = Check.by_plan(cleaned(views.source), request.plan).of_pruned(clean)
        else:
            check = Check.by_plan(clean, request.plan)
    attempt = measuring(code, config, check, times)
    origin = None if views is None else views.origin
    found = encode_within_loss(attempt, config, chosen, check, origin)
    if found is None:
        return None
    (parts, report), loss = found
    return parts, replace(report, **changed, rendered=loss, seconds=times.seconds)


def _guide(
    clean: Scene,
    config: Config,
    views: ReferenceViews,
    times: StageTimes,
    progress: Progress | None,
) -> Guidance | None:
    """Visibility of each Gaussian in the views; None if too few are visible."""
    from gs_codec.encoding.retry import warn_misfit
    from gs_codec.guidance.guide import guide

    with times.stage("views"):
        guidance = guide(clean, views, progress)
    seen = float(np.mean(guidance.weights.max(axis=0) > 0))
    if seen >= _LEAST_SEEN:
        return guidance
    warn_misfit(f"they see {seen:.0%} of the Gaussians", config)
    return None


def _calibrate(
    scene: Scene, config: Config, times: StageTimes, progress: Progress | None
) -> tuple[Config, Windows]:
    """The configuration with the calibrated coarseness, and windows of the scene."""
    from gs_codec.guidance.calibrate import calibrated
    from gs_codec.guidance.windows import choose_windows, sample_of

    with times.stage("calibrate" if config.has_steps else "measure"):
        windows = choose_windows(sample_of(scene), scene.count)
        if config.has_steps:
            config = calibrated(scene, config, progress, windows)
    return config, windows


def _code(
    clean: Scene,
    guidance: Guidance | None,
    times: StageTimes,
    progress: Progress | None,
    config: Config,
    watched: Watched | None,
) -> Encoded:
    """Shape, colour and code a scene; camera-free, all three block by block."""
    if guidance is None:
        return encode_cleaned(clean, config, times, progress, watched=watched)
    profile = config.adaptive_profile()
    shaped = shape_scene(clean, config, guidance.steps(profile), times, progress, watched)
    with times.stage("recolour"):
        shaped = shaped.with_colours(guidance.recolour(shaped, profile))
    with times.stage("round"):
        shaped = guidance.round(shaped, profile)
    return code_shaped(shaped, times, progress)


def _check_whole(
    scene: Scene, request: Request, parts: list[bytes | memoryview], report: EncodeReport
) -> Encoded:
    """Measure the loss of views relative to the scene before preparation."""
    from gs_codec.encoding.retry import loss_by_plan, warn_of_loss

    config, times = request.config, StageTimes()
    with times.stage("measure"):
        clean, _ = clean_scene(scene, config)
        loss = loss_by_plan(clean, decode_as(config, b"".join(parts)), request.plan, config)
    if loss is not None:
        loss = replace(loss, aimed=None if request.rate is None else request.rate.psnr_drop)
        if (coded := report.rendered) is not None:
            loss = replace(loss, encodings=coded.encodings, remedy=coded.remedy)
        warn_of_loss(loss, config)
    taken = times.seconds["measure"] + report.seconds.get("measure", 0.0)
    return parts, replace(report, rendered=loss, seconds=report.seconds | {"measure": taken})
