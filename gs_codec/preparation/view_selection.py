"""The views of a plan: those that guide its steps, are fitted by refinement, or measure quality."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import NamedTuple

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import warn_of_masks
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.likely_views import cameras_between
from gs_codec.preparation.reference_views import (
    MOST_PIXELS,
    Origin,
    ReferenceViews,
    ViewSplit,
    draw_reference_views,
    draw_targets,
    evenly,
    photographed,
    read_photographs,
)
from gs_codec.report import Progress
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene
from gs_codec.views.estimate import guiding_cameras
from gs_codec.views.find import find_cameras

log = logging.getLogger(__name__)

#: Refinement fits this many times as many views as other steps use; its time does not depend on
#: their number. If there are fewer cameras than these steps use, pruning sees as many, too: what
#: no view shows would be removed (bench/LAB_NOTEBOOK.md).
_TARGETS = 4

#: Approximate maximum bytes of the images of these extra views.
_TARGET_BYTES = 1 << 30

#: Maximum number of views between cameras for each missing camera.
_BETWEEN = 4

#: Number of photographs for each view between cameras that refinement fits too. Such a view shows
#: the faults of the scene itself.
_PHOTOGRAPHS = 3

#: If no cameras are marked, every n-th one is held out, as in 3DGS; see `_split`.
_EVERY = 8


def choose_views(scene: Scene, plan: Plan, progress: Progress | None = None) -> ViewSplit:
    """Render or read the views that guide a plan's steps, and those that measure quality.

    Without steps, the views that guide have no images, because the encoder renders them itself.
    Raises InvalidInput if there are no cameras, none has a photograph, or a photograph is damaged.
    """
    known = _split(scene, plan, progress)
    rest, test, _ = known
    taken = max(12 * camera.width * camera.height for camera in rest)
    many = max(plan.views, min(_TARGETS * plan.views, _TARGET_BYTES // taken))
    most = many if plan.steps.refine else plan.views
    prunes = plan.steps.refine or plan.steps.by_leave_one_out
    cameras = _enough(known, many if prunes and len(rest) < plan.views else plan.views)
    photographs = targets = None
    drawable = tuple(_drawable(cameras, plan))
    renders = ReferenceViews(drawable, (), False, plan.background, scene, known.origin)
    if plan.steps.wanted:
        renders = renders.drawn(progress)
    if plan.gt_images is not None:
        found = photographed(rest, plan.gt_images)
        warn_of_masks(plan.gt_images)
        if len(found) < len(rest):
            total = counted(len(rest), "camera")
            log.warning("%s: photographs of %d of %s", plan.gt_images, len(found), total)
        photographs = read_photographs(evenly(found, most), plan.background)
    if plan.steps.refine:
        targets = _targets(scene, known, most, photographs, plan, progress)
    if test == rest:
        held_out = photographs or renders.first(len(rest))
    elif plan.gt_images is not None:
        held_out = read_photographs(photographed(test, plan.gt_images), plan.background)
    else:
        held_out = draw_reference_views(scene, test, plan.background, progress)
    return ViewSplit(renders, photographs, held_out, targets)


def _targets(
    scene: Scene,
    known: _Split,
    most: int,
    photographs: ReferenceViews | None,
    plan: Plan,
    progress: Progress | None,
) -> ReferenceViews:
    """Photographs, renders of the scene from cameras without one, and some from between cameras.

    With few photographs, a scene would overfit to them; on bonsai, renders from the other cameras
    avoid a third of that loss.
    """
    between = None if photographs is None else len(photographs.cameras) // _PHOTOGRAPHS
    cameras = _enough(known, most, between)
    if photographs is None:
        return draw_targets(scene, cameras, plan.background, plan.device, progress)
    taken = {camera.name: camera for camera in photographs.cameras}
    # If there are few photographs, none of these cameras may have one.
    shown = [c for c in cameras if c.name in taken] or [c for c in known.rest if c.name in taken]
    scale = max(taken[c.name].width / c.width for c in shown)
    others = [
        c.resized(max(1, round(scale * c.width)), max(1, round(scale * c.height)))
        for c in cameras
        if c.name not in taken
    ]
    others = _drawable(others, plan)
    renders = draw_targets(scene, others, plan.background, plan.device, progress)
    return replace(
        photographs,
        cameras=photographs.cameras + renders.cameras,
        images=photographs.images + renders.images,
    )


def guiding_views(
    scene: Scene,
    plan: Plan,
    references: ReferenceViews | None = None,
    progress: Progress | None = None,
) -> ReferenceViews | None:
    """The reference views of a plan that guide the encoder.

    If the scene was optimised or not prepared, they have no images, and `guide` renders the scene
    itself. Otherwise they are `references`, by default the renders of `choose_views`. Returns None
    if no cameras are given and they cannot be estimated: guessed ones would mislead.
    """
    known = references or _split(scene, plan, progress)
    if known.origin == "anywhere":
        log.warning(
            "cameras 'auto': no cameras can be estimated from this scene; encoded camera-free"
        )
        return None
    given = known.cameras if isinstance(known, ReferenceViews) else known.rest
    if known.origin == "given" and len(given) == 1:
        log.warning("cameras: only one guides step sizes; views from elsewhere may lose far more")
    if isinstance(known, ReferenceViews):
        own = plan.steps.refine or known.source is scene
        return replace(known, images=(), source=scene) if own else known
    cameras = tuple(_enough(known, plan.views))
    return ReferenceViews(cameras, (), False, plan.background, scene, known.origin)


def checking_cameras(scene: Scene, plan: Plan) -> list[Camera]:
    """Given cameras that do not guide the encoder, or views between those that do."""
    known = _split(scene, replace(plan, steps=Steps()), None)
    if known.test != known.rest:
        return known.test
    return cameras_between(known.rest) or known.rest


def _enough(known: _Split, most: int, between: int | None = None) -> list[Camera]:
    """At most this many given cameras; if there are fewer, views between them are added.

    At most four are added for each missing one, even if cameras are few, and at most `between`.
    """
    cameras = known.rest
    if known.origin != "given":
        return cameras
    if len(cameras) >= most:
        return evenly(cameras, most)
    added = _BETWEEN * (most - len(cameras))
    if between is not None:
        added = min(added, between)
    return [*cameras, *evenly(cameras_between(cameras), added)]


def _drawable(cameras: list[Camera], plan: Plan) -> list[Camera]:
    """The cameras, with images of at most `MOST_PIXELS` unless the plan sets their width."""
    if plan.width is not None:
        return cameras
    shares = [math.sqrt(min(1.0, MOST_PIXELS / (c.width * c.height))) for c in cameras]
    return [
        c.resized(max(1, int(share * c.width)), max(1, int(share * c.height))) if share < 1 else c
        for c, share in zip(cameras, shares, strict=True)
    ]


class _Split(NamedTuple):
    """Cameras that guide the steps, held-out cameras, and their origin."""

    rest: list[Camera]
    test: list[Camera]
    origin: Origin


def _split(scene: Scene, plan: Plan, progress: Progress | None) -> _Split:
    """Find the cameras of a plan.

    If none or all are marked, the same cameras guide and measure. Refinement, which would fit the
    views it is measured by, then holds out every 8th, as does a target that is measured.
    """
    origin: Origin = "given"
    if plan.estimates:
        found = guiding_cameras(scene, plan.views, plan.width, progress)
        cameras, origin = found.cameras, "estimated" if found.telling else "anywhere"
    else:
        cameras = find_cameras(plan.cameras, scene, "all", plan.width)
        if plan.gt_images is None:  # photographs must have the shape of whole cameras
            cameras = _drawable(cameras, plan)
    known = cameras
    if plan.gt_images is not None:
        known = [camera for camera, _ in photographed(cameras, plan.gt_images)]
    test = [camera for camera in cameras if camera.split == "test"]
    rest = [camera for camera in cameras if camera.split != "test"]
    if rest and test:
        return _Split(rest, test, origin)
    if (plan.steps.refine or plan.holds_out) and len(known) > 1:
        if plan.steps.refine and origin == "given":
            log.warning(
                "cameras: none or all are marked 'test', so every 8th is held out from refinement"
            )
        test = known[::_EVERY]
        rest = [camera for camera in cameras if all(camera is not out for out in test)]
        return _Split(rest, test, origin)
    return _Split(cameras, cameras, origin)
