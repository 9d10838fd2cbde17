"""Prepare scenes from file to file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.matching import without_order
from gs_codec.config import Config, as_config
from gs_codec.encoding.order import encode_prepared
from gs_codec.encoding.request import Request
from gs_codec.files.scenes import read_scene
from gs_codec.files.suffixes import PLAIN, check_target, config_for
from gs_codec.files.writing import tell_lost, write_parts, write_scene
from gs_codec.levels.adding import add_levels
from gs_codec.report import Progress
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.atomic import check_folder
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads

if TYPE_CHECKING:
    from gs_codec.plan import Plan
    from gs_codec.preparation.prepare_report import PrepareReport


@checked
def prepare_file(
    source: str | Path,
    target: str | Path,
    plan: Plan,
    config: Config | str | None = None,
    *,
    progress: Progress | None = None,
    report_folder: str | Path | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
) -> PrepareReport:
    """Prepare the scene of a file, and write it like `write` or encoded.

    Extra properties are kept.

    Parameters
    ----------
    source, target : str or Path
        Scenes; the suffix of the target selects its format.
    plan, progress
        As in `prepare`.
    config : Config or str, optional
        As in `prepare`; an encoded target equals the output of `encode_file`.
    report_folder : str or Path, optional
        Output folder for the report on preparation, and on the loss that coding adds.
    max_bytes : int, optional
        As in `read`.
    overwrite : bool
        As in `encode_file`; also applies to files in `report_folder`.

    Returns
    -------
    PrepareReport
        As from `prepare`, with the steps of coding.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
        As in `prepare`; or if the target or the report cannot be written.

    Examples
    --------
    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=30), "cameras.json", width=48)
    >>> report = gs_codec.prepare_file("scene.ply", "pruned.ply", plan)
    >>> report.removed["leave-one-out"]
    600
    """
    suffix = check_target([source], target, overwrite=overwrite)
    if report_folder is not None:
        check_folder(report_folder, overwrite)
    config = replace(as_config(config), extra="keep")
    coded = suffix not in PLAIN
    if coded:
        config = config_for(target, config)
    # Loaded here, because encoding alone needs no rendering.
    from gs_codec.encoding.retry import loss_by_plan
    from gs_codec.guidance.windows import cleaned
    from gs_codec.preparation.balance import profile_steps
    from gs_codec.preparation.pipeline import prepare_scene, without_refinement
    from gs_codec.preparation.prepare_report import save_report

    with using_threads(config.threads):
        scene = without_order(read_scene(source, "keep", max_bytes=max_bytes))
        with located(source):
            original = scene
            scene, prepared = prepare_scene(scene, plan, progress, profile_steps(config))
            views = prepared.views
            if prepared.rejected:
                plan = without_refinement(plan)
            request = Request(config, plan if coded else None)
            parts, report = encode_prepared(scene, request, progress, views.renders)
            data = b"".join(parts)
            prepared = prepared.coded(scene, config, data, report)
            result = decode_as(config, data) if coded else scene
            loss = loss_by_plan(cleaned(original), result, plan, config)
            prepared = replace(prepared, rendered=loss)
            if report_folder is not None:
                save_report(report_folder, prepared)
        if coded:
            parts, report = add_levels(parts, report, config, progress)
            write_parts(target, parts)
            tell_lost(target, report.lost)
        else:
            write_scene(target, scene, config)
    return prepared
