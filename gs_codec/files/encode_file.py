"""Encode scenes from file to file, without Open3D."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gs_codec.config import EGS, LOSSLESS, Config, RateTarget, as_config, as_rate_target
from gs_codec.edit.actions import Action
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.files.scenes import early_shifts, scene_in
from gs_codec.files.suffixes import ENCODED, check_target, config_for
from gs_codec.files.writing import is_rounded, keeps_rounding, tell_lost, write_parts
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.formats.registry import open_scene
from gs_codec.plan import Plan
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.arrays import bounded
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene, Shift

log = logging.getLogger(__name__)


@checked
def encode_file(
    source: str | Path,
    target: str | Path,
    config: Config | str | None = None,
    plan: Plan | None = None,
    rate: RateTarget | Mapping[str, float] | None = None,
    *,
    actions: Sequence[Action] = (),
    progress: Progress | None = None,
    max_memory: int | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
    by_profile: bool = False,
) -> EncodeReport:
    """Encode a scene in any supported format to a file, atomically.

    Does not load Open3D. Comments of a PLY are kept.

    Parameters
    ----------
    source : str or Path
        A file in a format supported by `read`.
    target : str or Path
        Its suffix selects the format; ``gs-codec encode --help`` lists them.
    config, plan, rate, progress
        As in `encode`; for a compressed source, or with actions, ratios are relative to the floats.
    actions : sequence of gs_codec.edit.Action
        Edits to apply first, in this order; as in `convert_file`.
    max_memory : int, optional
        As in `convert_file`; only for `.egs`, `.spz` and `.sog`, without `plan` and `rate`.
    max_bytes : int, optional
        As in `read`.
    overwrite : bool
        As in `write`; an existing target is rejected before the work begins.
    by_profile : bool
        As in `convert_file`; with `plan` or `rate`, values are always rounded to the profile's
        steps.

    Returns
    -------
    EncodeReport
        Sizes, entropies, changes and losses, and seconds by stage.

    Raises
    ------
    InvalidInput
        As in `read` and `encode`; or if the target cannot be written, or `max_memory` is too low.
    CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool, ToolFailed
        As in `read` and `encode`.

    Examples
    --------
    >>> report = gs_codec.encode_file("scene.ply", "coded.egs", gs_codec.Config("l"))
    >>> report.count, report.raw_bytes // report.file_bytes >= 5
    (2000, True)

    After pruning the Gaussians whose removal changes the views least:

    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=20), "cameras.json", width=48)
    >>> gs_codec.encode_file("scene.ply", "pruned.egs", plan=plan).count
    1600
    """
    by_profile |= isinstance(config, str)
    config = config_for(target, as_config(config))
    request = Request(
        config, plan, as_rate_target(rate), tuple(actions), by_profile, max_memory, max_bytes
    )
    return encode_requested(source, target, request, progress, overwrite)


def encode_requested(
    source: str | Path,
    target: str | Path,
    request: Request,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> EncodeReport:
    """Encode a file as requested, with the format of the request; see `encode_file`."""
    config, actions, times = request.config, request.actions, StageTimes()
    suffix = check_target([source], target, ENCODED, overwrite)
    by_profile = request.by_profile or request.plan is not None or request.rate is not None
    finest = keeps_rounding([source], suffix, config, by_profile)
    with using_threads(config.threads), bounded(request.max_memory):
        with times.stage("read"):
            exact = config.profile == LOSSLESS and request.plan is None and not actions
            shifts = early_shifts([source], actions)
            shift = None if shifts is None else shifts[0]
            scene, input_bytes, ply_bytes = read_source(
                source, config, request.max_bytes, exact, shift
            )
        with located(source):
            parts, report = encode(
                scene, request, progress, ply_bytes, translated=shift is not None, finest=finest
            )
        times.seconds |= report.seconds
        with times.stage("write"):
            write_parts(target, parts)
    lossy = config.format == EGS and config.profile != LOSSLESS
    if lossy and report.file_bytes >= input_bytes and is_rounded(source):
        log.warning("%s: not smaller than its source, whose values are already rounded", target)
    tell_lost(target, report.lost)
    return replace(report, seconds=times.seconds, input_bytes=input_bytes)


def read_source(
    source: str | Path,
    config: Config,
    max_bytes: int | None,
    exact: bool,
    shift: Shift | None = None,
) -> tuple[Scene, int, int]:
    """The scene of a file, its size, and the bytes that ratios are relative to."""
    with open_scene(source, shift) as file:
        # PLY and .egs keep their bits, and the comment on their coordinate system, which other
        # formats do not have.
        stays = config.format == EGS and file.format in ("egs", "ply")
        system = None if stays else CONVENTION
        scene = scene_in(file, config.chosen_extra(), None, system, max_bytes, exact)
        return scene, file.stored_bytes, file.ratio_bytes(scene.float_bytes)
