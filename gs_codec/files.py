"""Scenes from and to files; the way of the command line, which never loads Open3D."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gs_codec.codec import decode_part, encode_parts, encode_scene
from gs_codec.codec.part import Part
from gs_codec.config import Config, Target
from gs_codec.errors import InvalidInput
from gs_codec.inspection import Info, describe, inspect_bytes
from gs_codec.io.atomic import atomic_writer, check_folder, check_writable, make_folder
from gs_codec.io.formats import SceneFile, open_scene
from gs_codec.io.mapped import located, opened
from gs_codec.io.ply import write_ply, write_vertices
from gs_codec.io.splat import pack_splat
from gs_codec.matching import (
    order_of,
    order_of_file,
    put_side_by_side,
    with_order,
    without_order,
)
from gs_codec.metrics.attributes import Comparison, compare_scenes
from gs_codec.planned import encode_goal, encode_planned
from gs_codec.report import EncodeReport, Progress
from gs_codec.scene import Scene, float_bytes
from gs_codec.slabs import opened_slabs
from gs_codec.storage import bounded, current
from gs_codec.transform.coordinates import CONVENTION, system_of, turn_axes
from gs_codec.workers import using_threads

log = logging.getLogger(__name__)

#: Suffixes of scenes that are written.
_WRITTEN = (".ply", ".egs", ".splat")

if TYPE_CHECKING:
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.report import PrepareReport


@dataclass(frozen=True)
class DecodeReport:
    """What decoding a file gave.

    Attributes
    ----------
    count : int
        Gaussians written.
    sh_degree : int
        0-3.
    bytes_read : int
        How much of the file a part of the scene took.
    file_bytes : int
        Size of the file.
    seconds : dict of str to float
        Wall time of each stage.
    """

    count: int
    sh_degree: int
    bytes_read: int
    file_bytes: int
    seconds: dict[str, float]


def encode_file(
    source: str | Path,
    target: str | Path,
    config: Config | None = None,
    progress: Progress | None = None,
    plan: Plan | None = None,
    report_folder: str | Path | None = None,
    goal: Target | None = None,
    max_memory: int | None = None,
    overwrite: bool = True,
    max_bytes: int | None = None,
) -> EncodeReport:
    """Encode a scene of any format to an `.egs` file, which appears whole or not at all.

    Does not load Open3D; comments of a PLY, which clouds do not have, are kept.

    Parameters
    ----------
    source : str or Path
        PLY, `.egs`, `.splat`, `.spz` or SOG.
    target : str or Path
        The file to write, an `.egs`.
    config : Config, optional
        By default profile ``m``.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    plan : Plan, optional
        How to prepare the scene first, if it has steps; profiles ``l``, ``m`` and ``s`` go by what
        its views see.
    report_folder : str or Path, optional
        Receives what preparation did, and what each stage of coding adds to it.
    goal : Target, optional
        A size or quality that profiles ``l``, ``m`` and ``s`` are to come to.
    max_memory : int, optional
        Bytes; a scene that takes more is worked on in temporary files, with the same result. Not
        with `plan` nor `goal`, and of a binary PLY of floats alone.
    overwrite : bool
        Whether a `target` that exists is replaced, once the new one is whole, and files in
        `report_folder` are; else both are refused before the work. Default True, as for other
        functions of Python that write files; the command line has ``--overwrite`` for it.
    max_bytes : int, optional
        Largest size of the source's floats; by default 1 GiB or 1000 times the file.

    Returns
    -------
    EncodeReport
        Sizes, entropies, what was moved or left out, and seconds by stage.

    Raises
    ------
    InvalidInput
        If the source cannot be used, the goal is out of reach, the target cannot be written, or
        `max_memory` or `max_bytes` is too little.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the source is an `.egs` file that cannot be decoded.
    MissingTool, ToolFailed
        If `config` asks for G-PCC, and its program is not there or fails.

    Examples
    --------
    >>> report = gs_codec.encode_file("scene.ply", "coded.egs", gs_codec.Config("l"))
    >>> report.count, report.raw_bytes // report.file_bytes >= 5
    (2000, True)

    Without what views hardly miss:

    >>> from gs_codec.preparation.pipeline import Plan
    >>> from gs_codec.preparation.steps import Steps
    >>> plan = Plan(Steps(prune_loo=20), "cameras.json", width=48)
    >>> gs_codec.encode_file("scene.ply", "pruned.egs", plan=plan).count
    1600
    """
    config = config or Config()
    check_target(source, target, (".egs",), overwrite)
    if report_folder is not None:
        check_folder(report_folder, overwrite)
    if max_memory is not None and (plan is not None or goal is not None):
        raise InvalidInput("max-memory: not with views, preparation, or a target to meet")
    with using_threads(config.threads), bounded(max_memory):
        return _encode_file(source, target, config, progress, plan, report_folder, goal, max_bytes)


def _encode_file(
    source: str | Path,
    target: str | Path,
    config: Config,
    progress: Progress | None,
    plan: Plan | None,
    report_folder: str | Path | None,
    goal: Target | None,
    max_bytes: int | None,
) -> EncodeReport:
    start = time.perf_counter()
    scene, size = _read_source(source, config.extra, max_bytes)
    read = time.perf_counter() - start
    with located(source):
        if plan is None and goal is None:
            parts, report = encode_parts(scene, config, progress)
        else:
            data, report = _encode_by_plan(scene, size, config, plan, goal, report_folder, progress)
            parts = [data]
    start = time.perf_counter()
    with atomic_writer(target) as file:
        file.writelines(parts)
    seconds = {"read": read, **report.seconds, "write": time.perf_counter() - start}
    return replace(report, seconds=seconds)


def _read_source(
    source: str | Path, extra: Literal["error", "keep", "drop"], max_bytes: int | None
) -> tuple[Scene, int]:
    """The scene of a file, and the bytes that a ratio counts from: of a PLY, or of its floats."""
    with open_scene(source) as file:
        if current().limit is not None and (file.is_egs or not file.is_read_in_parts):
            raise InvalidInput(
                f"{source}: max-memory: only a binary PLY of floats is read in parts"
            )
        # Bits of a PLY or .egs stay as they are, and the comment that names another system.
        stays = file.is_egs or file.format == "ply"
        scene = _scene_of(file, extra, None, None if stays else CONVENTION, max_bytes)
        counts = file.is_egs or file.is_compressed
        return scene, scene.float_bytes if counts else file.stored_bytes


def _encode_by_plan(
    scene: Scene,
    size: int,
    config: Config,
    plan: Plan | None,
    goal: Target | None,
    report_folder: str | Path | None,
    progress: Progress | None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene, of `size` bytes uncompressed, by a plan, to a goal, or both."""
    prepared, views, original = None, None, scene
    if plan is not None and plan.steps.wanted:
        scene, prepared = _prepare(scene, plan, config, report_folder, progress)
        views = prepared.views
    if goal is not None:
        data, report = encode_goal(scene, original, size, config, goal, plan, progress, views)
    else:
        targets = None if views is None else views.renders
        data, report = encode_planned(scene, config, plan, progress, targets)
    if prepared is not None and report_folder is not None:
        _finish_report(prepared, scene, config, data, report, report_folder)
    return data, report


def prepare_file(
    source: str | Path,
    target: str | Path,
    plan: Plan,
    report_folder: str | Path | None = None,
    progress: Progress | None = None,
    overwrite: bool = True,
    max_bytes: int | None = None,
    config: Config | None = None,
) -> PrepareReport:
    """Prepare the scene of a file and write it as ``.ply``, ``.egs`` or ``.splat``.

    `config` is how an ``.egs`` is coded, with the bytes that `encode_file` writes, and what the
    report's last steps are of; extra properties are kept. `overwrite` is as for `encode_file`.

    Raises
    ------
    InvalidInput
        If the source cannot be used, or the target or the report cannot be written.
    """
    suffix = check_target(source, target, overwrite=overwrite)
    if report_folder is not None:
        check_folder(report_folder, overwrite)
    scene = without_order(read_scene(source, "keep", max_bytes=max_bytes))
    config = replace(config or Config(), extra="keep")
    with located(source):
        scene, prepared = _prepare(scene, plan, config, report_folder, progress)
        views = prepared.views.renders
        coded_by = plan if suffix == ".egs" else None
        data, report = encode_planned(scene, config, coded_by, progress, views)
        prepared = _finish_report(prepared, scene, config, data, report, report_folder)
    if suffix == ".egs":
        with atomic_writer(target) as file:
            file.write(data)
    else:
        write_scene(target, scene, config)
    return prepared


def write_scene(
    path: str | Path, scene: Scene, config: Config, overwrite: bool = True
) -> tuple[str, ...]:
    """Write a scene as ``.ply``, ``.splat`` or, encoded, as ``.egs``.

    Returns
    -------
    tuple of str
        What the format cannot hold, in words; warnings say it, too.

    Raises
    ------
    InvalidInput
        If the suffix is another, or the file cannot be written or, without `overwrite`, exists.
    """
    suffix = suffix_of(path)
    check_writable(path, overwrite)
    if suffix == ".ply":
        write_ply(path, scene)
        return ()
    data: bytes
    lost: tuple[str, ...] = ()
    with located(path):
        if suffix == ".splat":
            data, lost = pack_splat(scene)
        else:
            data = encode_scene(scene, config)[0]
    with atomic_writer(path) as file:
        file.write(data)
    for line in lost:
        log.warning("%s: %s", path, line)
    return lost


def suffix_of(path: str | Path, known: tuple[str, ...] = _WRITTEN) -> str:
    """The suffix of a scene to be written, which tells its format.

    Raises
    ------
    InvalidInput
        If it is none of `known`.
    """
    name = Path(path).name.lower()
    suffix = ".compressed.ply" if name.endswith(".compressed.ply") else Path(name).suffix
    if suffix not in known:
        expected = " or ".join(filter(None, [", ".join(known[:-1]), known[-1]]))
        other = "; `convert` writes that" if suffix in _WRITTEN else ""
        raise InvalidInput(f"{path}: suffix '{suffix}', expected {expected}{other}")
    return suffix


def _prepare(
    scene: Scene,
    plan: Plan,
    config: Config,
    folder: str | Path | None,
    progress: Progress | None,
) -> tuple[Scene, PrepareReport]:
    """Prepare a scene; a folder for the report that cannot be written to is refused before."""
    # Loaded here: encoding alone does without all that draws.
    from gs_codec.preparation.pipeline import prepare_scene

    if folder is not None:
        check_writable(make_folder(folder) / "report.json")
    return prepare_scene(scene, plan, progress, config=config)


def _finish_report(
    prepared: PrepareReport,
    scene: Scene,
    config: Config,
    data: bytes,
    report: EncodeReport,
    folder: str | Path | None,
) -> PrepareReport:
    """Add the stages of coding to a report and, if there is a folder, write it there."""
    from gs_codec.ablation import coding_steps
    from gs_codec.preparation.save import save_report

    coding = coding_steps(scene, config, data, report, prepared.views.held_out)
    prepared = replace(prepared, steps=(*prepared.steps, *coding))
    if folder is not None:
        save_report(folder, prepared)
    return prepared


def decode_file(
    source: str | Path,
    target: str | Path,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    part: Part | None = None,
    tmc3: str | Path | None = None,
    max_memory: int | None = None,
    overwrite: bool = True,
) -> DecodeReport:
    """Decode an `.egs` file, or a part of it, to a PLY file, which appears whole or not at all.

    A comment line in the PLY says in which order the Gaussians are, unless it is the
    original's, so that `compare` can match them. Does not load Open3D.

    Parameters
    ----------
    source : str or Path
        An `.egs` file.
    target : str or Path
        The PLY to write, in the INRIA trainer's layout.
    threads : int, optional
        Worker threads, 1-256; by default one for each available processor.
    max_bytes : int, optional
        Largest size of the decoded floats; by default 1 GiB or 1000 times the file.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    part : Part, optional
        A box, a lower SH degree, or both; no more of the file is read than that needs.
    tmc3 : str or Path, optional
        MPEG's program, for files that use G-PCC; by default what the environment variable
        ``GS_CODEC_TMC3`` or PATH say.
    max_memory : int, optional
        Bytes that are enough for a part of the scene at a time.
    overwrite : bool
        As for `encode_file`.

    Returns
    -------
    DecodeReport
        What came out, how much was read for it, and seconds by stage.

    Raises
    ------
    InvalidInput
        If the source cannot be read, the target cannot be written, a box has no Gaussians, or
        `max_memory` is not enough for one block.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the source is not a sound `.egs` file.
    MissingTool, ToolFailed
        If it uses G-PCC, and the program is not there or does not decode it.

    Examples
    --------
    >>> from gs_codec.codec.part import Part
    >>> report = gs_codec.decode_file("scene.egs", "decoded.ply", part=Part(sh_degree=1))
    >>> report.sh_degree, report.bytes_read < report.file_bytes
    (1, True)
    """
    check_target(source, target, (".ply",), overwrite)
    start = time.perf_counter()
    part = part or Part()
    with opened_slabs(source, part, threads, max_bytes, progress, tmc3, max_memory) as slabs:
        count, scenes = slabs.counted()
        with atomic_writer(target) as file:
            write_vertices(file, count, scenes)
        seconds = {"decode": slabs.seconds, "write": time.perf_counter() - start - slabs.seconds}
        size = os.path.getsize(source)
        return DecodeReport(count, slabs.sh_degree, slabs.bytes_read, size, seconds)


def read_scene(
    path: str | Path,
    extra: Literal["error", "keep", "drop"] = "error",
    progress: Progress | None = None,
    coordinates: str | None = CONVENTION,
    max_bytes: int | None = None,
) -> Scene:
    """The scene of a file, its format told by content; see `read_ply` for the options.

    It is turned to the system `coordinates`; None leaves it in the file's, which
    `Scene.coordinates` names if that is not the convention's.
    """
    with open_scene(path) as file:
        return _scene_of(file, extra, progress, coordinates, max_bytes)


def _scene_of(
    file: SceneFile,
    extra: Literal["error", "keep", "drop"],
    progress: Progress | None,
    coordinates: str | None,
    max_bytes: int | None,
) -> Scene:
    if file.is_egs:
        scene = _decode_ordered(file, progress, max_bytes)
    else:
        scene = file.scene(extra, max_bytes)
    with located(file.path):
        return scene if coordinates is None else turn_scene(scene, coordinates)


def turn_scene(scene: Scene, coordinates: str) -> Scene:
    """See `turn_axes`; comments that tell an order by places go with the places."""
    if system_of(scene) == coordinates:
        return scene
    return turn_axes(without_order(scene), coordinates)


def source_bytes(path: str | Path) -> int:
    """Size of a scene in files."""
    with open_scene(path) as file:
        return len(file.data) if file.is_egs else file.stored_bytes


def stated_bytes(path: str | Path) -> int:
    """Bytes of floats that the header of a scene's file says it holds."""
    with open_scene(path) as file:
        if not file.is_egs:
            return file.stated_bytes()
        with located(path):
            info = inspect_bytes(file.data)
        return float_bytes(info.count, info.sh_degree)


def comes_compressed(path: str | Path) -> bool:
    """Whether a file has anything but plain numbers of a PLY."""
    with open_scene(path) as file:
        return file.is_egs or file.is_compressed


def is_egs(path: str | Path) -> bool:
    """Whether a file is an `.egs` file, sound or not."""
    with open_scene(path) as file:
        return file.is_egs


def inspect_file(path: str | Path) -> Info:
    """See `inspect_bytes`; of the blocks, which come before the comments, nothing is read."""
    with opened(path) as data, located(path):
        return inspect_bytes(data)


def compare_files(
    first: str | Path, second: str | Path, max_bytes: int | None = None
) -> Comparison:
    """Compare two scenes; one decoded from `.egs` is matched with its original.

    Of different coordinate systems, one is turned to the other's.
    """
    scenes, orders = [], []
    for path in (first, second):
        scenes.append(read_scene(path, "drop", coordinates=None, max_bytes=max_bytes))
        with located(path):
            orders.append(order_of(scenes[-1]))
    systems = system_of(scenes[0]), system_of(scenes[1])
    # An order is that of the places it was made of, so that its scene is not turned.
    kept = 0 if orders[1] is None else 1
    scenes[1 - kept] = turn_axes(scenes[1 - kept], systems[kept])
    return replace(compare_scenes(*put_side_by_side(scenes[0], scenes[1])), systems=systems)


def check_target(
    source: str | Path,
    target: str | Path,
    known: tuple[str, ...] = _WRITTEN,
    overwrite: bool = True,
) -> str:
    """Refuse a target that could not be written, before the work is done; else its suffix."""
    if os.path.exists(source) and os.path.exists(target) and os.path.samefile(source, target):
        raise InvalidInput(f"{target}: the source itself")
    check_writable(target, overwrite)
    return suffix_of(target, known)


def _decode_ordered(file: SceneFile, progress: Progress | None, max_bytes: int | None) -> Scene:
    """A scene that tells its order."""
    with located(file.path):
        scene, read = decode_part(file.data, Part(), max_bytes=max_bytes, progress=progress)
        order = order_of_file(describe(read))
        return scene if order is None else with_order(scene, order)
