"""Scenes from and to files; the way of the command line, which never loads Open3D."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Mapping
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
from gs_codec.planned import encode_by_plan, encode_planned
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
    from gs_codec.preparation.report import PrepareReport
    from gs_codec.preparation.steps import Plan


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
    plan: Plan | None = None,
    rate: Target | Mapping[str, float] | None = None,
    *,
    progress: Progress | None = None,
    max_memory: int | None = None,
    max_bytes: int | None = None,
    overwrite: bool = True,
) -> EncodeReport:
    """Encode a scene of any format to an `.egs` file, which appears whole or not at all.

    The arguments after `target` are those of `encode`. Does not load Open3D; comments of a PLY,
    which clouds do not have, are kept.

    Parameters
    ----------
    source : str or Path
        PLY, `.egs`, `.splat`, `.spz` or SOG.
    target : str or Path
        The file to write, an `.egs`.
    config : Config, optional
        By default profile ``m``.
    plan : Plan, optional
        How to prepare the scene first, if it has steps; profiles ``l``, ``m`` and ``s`` go by what
        its views see.
    rate : Target or mapping, optional
        A size or quality that profiles ``l``, ``m`` and ``s`` are to come to; a ratio counts from
        the PLY, or from the floats of a compressed file.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    max_memory : int, optional
        Bytes; a scene that takes more is worked on in temporary files, with the same result. Not
        with `plan` nor `rate`, and of a binary PLY of floats alone.
    max_bytes : int, optional
        Largest size of the source's floats; by default 1 GiB or 1000 times the file.
    overwrite : bool
        Whether a `target` that exists is replaced, once the new one is whole; else it is refused
        before the work. Default True, as for other functions of Python that write files; the
        command line has ``--overwrite`` for it.

    Returns
    -------
    EncodeReport
        Sizes, entropies, what was moved or left out, and seconds by stage.

    Raises
    ------
    InvalidInput
        If the source cannot be used, the rate cannot be reached, the target cannot be written, or
        `max_memory` or `max_bytes` is too little.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the source is an `.egs` file that cannot be decoded.
    MissingTool, ToolFailed
        If `config` asks for G-PCC, and the program is missing or fails.

    Examples
    --------
    >>> report = gs_codec.encode_file("scene.ply", "coded.egs", gs_codec.Config("l"))
    >>> report.count, report.raw_bytes // report.file_bytes >= 5
    (2000, True)

    Without the Gaussians whose removal changes the views least:

    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=20), "cameras.json", width=48)
    >>> gs_codec.encode_file("scene.ply", "pruned.egs", plan=plan).count
    1600
    """
    config = config or Config()
    check_target(source, target, (".egs",), overwrite)
    if max_memory is not None and (plan is not None or rate is not None):
        raise InvalidInput("max-memory: not with views, preparation, or a target to meet")
    with using_threads(config.threads), bounded(max_memory):
        start = time.perf_counter()
        scene, size = _read_source(source, config.extra, max_bytes)
        read = time.perf_counter() - start
        with located(source):
            if plan is None and rate is None:
                parts, report = encode_parts(scene, config, progress)
            else:
                data, report = encode_by_plan(scene, size, config, plan, rate, progress)
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
        if current().limit is not None and not file.is_read_in_parts:
            raise InvalidInput(
                f"{source}: max-memory: only a binary PLY of floats is read in parts"
            )
        # Bits of a PLY or .egs stay as they are, and the comment that names another system.
        stays = file.is_egs or file.format == "ply"
        scene = _scene_of(file, extra, None, None if stays else CONVENTION, max_bytes)
        counts = file.is_compressed
        return scene, scene.float_bytes if counts else file.stored_bytes


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
    from gs_codec.ablation import coding_steps
    from gs_codec.preparation.pipeline import prepare_scene
    from gs_codec.preparation.save import save_report

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


def decode_file(
    source: str | Path,
    target: str | Path,
    part: Part | None = None,
    *,
    threads: int | None = None,
    tmc3: str | Path | None = None,
    progress: Progress | None = None,
    max_memory: int | None = None,
    max_bytes: int | None = None,
    overwrite: bool = True,
) -> DecodeReport:
    """Decode an `.egs` file, or a part of it, to a PLY file, which appears whole or not at all.

    The arguments after `target` are those of `decode`. A comment line in the PLY says in which
    order the Gaussians are, unless it is the original's, so that `compare` can match them. Does
    not load Open3D.

    Parameters
    ----------
    source : str or Path
        An `.egs` file.
    target : str or Path
        The PLY to write, in the INRIA trainer's layout.
    part : Part, optional
        A box, a lower SH degree, or both; no more of the file is read than that needs.
    threads : int, optional
        Worker threads, 1-256; by default one for each available processor.
    tmc3 : str or Path, optional
        MPEG's program, for files that use G-PCC; by default what the environment variable
        ``GS_CODEC_TMC3`` or PATH say.
    progress : callable, optional
        Called as ``progress(stage, done, total)``.
    max_memory : int, optional
        Bytes that are enough for a part of the scene at a time.
    max_bytes : int, optional
        Largest size of the decoded floats; by default 1 GiB or 1000 times the file.
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
    >>> part = gs_codec.Part(sh_degree=1)
    >>> report = gs_codec.decode_file("scene.egs", "decoded.ply", part)
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


def stated_bytes(path: str | Path) -> int:
    """Bytes of floats that the header of a scene's file says it holds."""
    with open_scene(path) as file:
        if not file.is_egs:
            return file.stated_bytes()
        with located(path):
            info = inspect_bytes(file.data)
        return float_bytes(info.count, info.sh_degree)


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
