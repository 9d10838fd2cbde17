"""Scenes prepared from file to file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.codecs.matching import without_order
from gs_codec.config import Config
from gs_codec.files.scenes import check_target, read_scene, write_scene
from gs_codec.guidance.planned import encode_planned
from gs_codec.report import Progress
from gs_codec.runtime.atomic import atomic_writer, check_folder, check_writable, make_folder
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads

if TYPE_CHECKING:
    from gs_codec.preparation.report import PrepareReport
    from gs_codec.preparation.steps import Plan


def prepare_file(
    source: str | Path,
    target: str | Path,
    plan: Plan,
    config: Config | None = None,
    *,
    progress: Progress | None = None,
    report_folder: str | Path | None = None,
    max_bytes: int | None = None,
    overwrite: bool = True,
) -> PrepareReport:
    """Prepare the scene of a file and write it as ``.ply``, ``.egs`` or ``.splat``.

    The arguments after `target` are those of `prepare`. Extra properties are kept.

    Parameters
    ----------
    source, target : str or Path
        Scenes; the target is ``.ply``, ``.egs`` or ``.splat``.
    plan : Plan
        Steps of preparation, and the views that guide them.
    config : Config, optional
        How an ``.egs`` is coded, with the bytes that `encode_file` writes, and what the report's
        last steps are of; by default profile ``m``.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    report_folder : str or Path, optional
        Receives what preparation did, and what each stage of coding adds to it.
    max_bytes : int, optional
        Largest size of the source's floats; by default 1 GiB or 1000 times the file.
    overwrite : bool
        As for `encode_file`; also of files in `report_folder`.

    Returns
    -------
    PrepareReport
        A label for each input Gaussian, and size and quality after each step.

    Raises
    ------
    InvalidInput
        If the source cannot be used, or the target or the report cannot be written.

    Examples
    --------
    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=30), "cameras.json", width=48)
    >>> report = gs_codec.prepare_file("scene.ply", "pruned.ply", plan)
    >>> report.removed["leave-one-out"]
    600
    """
    suffix = check_target(source, target, overwrite=overwrite)
    if report_folder is not None:
        check_folder(report_folder, overwrite)
    config = replace(config or Config(), extra="keep")
    # Loaded here: encoding alone does without all that draws.
    from gs_codec.preparation.pipeline import prepare_scene
    from gs_codec.preparation.report import coding_steps, save_report

    with using_threads(config.threads):
        scene = without_order(read_scene(source, "keep", max_bytes=max_bytes))
        with located(source):
            if report_folder is not None:
                check_writable(make_folder(report_folder) / "report.json")
            scene, prepared = prepare_scene(scene, plan, progress, config=config)
            coded, views = suffix == ".egs", prepared.views
            coded_by = plan if coded else None
            data, report = encode_planned(scene, config, coded_by, progress, views.renders)
            coding = coding_steps(scene, config, data, report, views.held_out)
            prepared = replace(prepared, steps=(*prepared.steps, *coding))
            if report_folder is not None:
                save_report(report_folder, prepared)
        if coded:
            with atomic_writer(target) as file:
                file.write(data)
        else:
            write_scene(target, scene, config)
    return prepared
