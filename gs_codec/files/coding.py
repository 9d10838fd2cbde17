"""Encode scenes from file to file, without Open3D."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.codecs.interchange import encode_finest
from gs_codec.config import EGS, LOSSLESS, Config, RateTarget, as_config
from gs_codec.edit.actions import Action, check_actions
from gs_codec.encoding.order import encode_by_plan, encode_camera_free
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import keeps_rounding, measured, scene_in, tell_lost, write_parts
from gs_codec.files.shifted import early_shifts, edit_shifted
from gs_codec.files.suffixes import ENCODED, check_target, config_for
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.formats.registry import open_scene
from gs_codec.levels.adding import add_levels, check_levels
from gs_codec.report import ActionReport, EncodeReport, Progress, StageTimes
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.arrays import bounded
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene, Shift

if TYPE_CHECKING:
    from gs_codec.preparation.steps import Plan


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
        As in `convert_file`; only for `.egs`, without `plan` and `rate`.
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
        As for `read` and `encode`.

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
    suffix = check_target([source], target, ENCODED, overwrite)
    by_profile |= isinstance(config, str) or plan is not None or rate is not None
    config = config_for(target, as_config(config))
    finest = keeps_rounding([source], suffix, config, by_profile)
    if max_memory is not None and (plan is not None or rate is not None):
        raise InvalidInput("max-memory: cannot be combined with views, preparation or a target")
    check_levels(config, rate, max_memory)
    if max_memory is not None and config.format != EGS:
        raise InvalidInput(f"max-memory: format '{config.format}', expected 'egs'")
    check_actions(actions, plan, max_memory is not None, plan is not None)
    times = StageTimes()
    done: tuple[ActionReport, ...] = ()
    with using_threads(config.threads), bounded(max_memory):
        with times.stage("read"):
            exact = config.profile == LOSSLESS and plan is None and not actions
            shifts = early_shifts([source], actions)
            shift = None if shifts is None else shifts[0]
            scene, input_bytes, counted = read_source(source, config, max_bytes, exact, shift)
        with located(source):
            if actions:
                with times.stage("edit"):
                    scene, done = edit_shifted([scene], actions, shifts, plan, progress)
                counted = scene.float_bytes
            float_bytes = scene.float_bytes
            if finest:
                parts, report = encode_finest(scene, config)
            elif plan is None and rate is None:
                parts, report = encode_camera_free(scene, config, progress)
            else:
                data, report = encode_by_plan(scene, counted, config, plan, rate, progress)
                parts = [data]
            parts, report = add_levels(parts, report, config, progress)
        times.seconds |= report.seconds
        with times.stage("write"):
            write_parts(target, parts)
        if finest:
            with times.stage("measure"), located(source):
                report = replace(report, rendered=measured(target, scene, config))
    tell_lost(target, report.lost)
    ratio = counted / report.file_bytes
    return replace(
        report, seconds=times.seconds, input_bytes=input_bytes, ratio=ratio, actions=done,
        float_bytes=float_bytes,
    )  # fmt: skip


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
