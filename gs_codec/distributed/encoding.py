"""Encode a giant scene with many workers, none of which holds all of it in memory.

The output equals that of `encode_file`, byte for byte, whatever the workers. First, all Gaussians
are surveyed (`survey`) and sorted (`sorting`). Blocks are quantised, and again with finer steps if
views lose too much. They are coded with tables from the counts of all blocks (`blocks`). Coarser
levels are made from the decoded blocks (`levels`).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.lattice import Lattice
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.codecs.encode import encode_parts
from gs_codec.coding.clean import nothing_left
from gs_codec.config import Config, as_config
from gs_codec.distributed.chunks import quantise, save_quantised
from gs_codec.distributed.coded_blocks import Chunks, Quantised, code_blocks, write_blocks
from gs_codec.distributed.folder import identity_of, work_folder
from gs_codec.distributed.levels import code_levels
from gs_codec.distributed.sorting import find_cuts, load_chunk, save_run
from gs_codec.distributed.sources import Sources, open_sources
from gs_codec.distributed.survey import Job, Looked, choose_lattice, look
from gs_codec.distributed.tasks import Crew, crew_at, size_within
from gs_codec.egs.egs_file import Section, SectionId, section_sizes
from gs_codec.egs.header import FANOUT, Feature, Header
from gs_codec.egs.sections import carried_sections
from gs_codec.encoding.loss import Check
from gs_codec.encoding.request import Request
from gs_codec.encoding.retry import encode_within_loss
from gs_codec.files.suffixes import check_target
from gs_codec.files.writing import write_parts
from gs_codec.guidance.windows import find_shown
from gs_codec.report import EncodeReport, Progress, RenderedLoss, StageTimes
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.mapped import located, opened
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import float_bytes


@checked
def encode_distributed(
    source: str | Path | Sequence[str | Path],
    target: str | Path,
    config: Config | str | None = None,
    *,
    dask: str | None = "local",
    progress: Progress | None = None,
    max_memory: int | None = None,
    overwrite: bool = False,
) -> EncodeReport:
    """Encode one scene with the workers of a Dask scheduler; it is never in memory as a whole.

    The output equals that of `encode_file`, or of `convert_file` for several sources, byte for
    byte. Intermediate results are kept in the folder ``TARGET.parts`` until the target is complete;
    the same call resumes an interrupted run. Workers read the sources and use that folder, so they
    need storage that all machines share.

    Parameters
    ----------
    source : path, or sequence of paths
        Binary PLY files of floats, or `.egs` files; several are merged; see `gs_codec.edit.merge`.
    target : str or Path
        An ``.egs``.
    config : Config or str, optional
        Profile ``l``, ``m`` or ``s``, without depths and extra properties; its threads are the
        processes of a local cluster, by default one per processor.
    dask : str, optional
        Address of a scheduler, or ``local``. None: this process does one task after another, each
        in one thread; it does not need Dask.
    progress, overwrite
        As in `encode_file`.
    max_memory : int, optional
        Maximum memory of each worker, bytes; limits the Gaussians per task.

    Returns
    -------
    EncodeReport
        As from `encode_file`, except for the stages.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool
        As in `encode_file`; or if there is no scheduler, or workers are lost repeatedly.

    Examples
    --------
    >>> report = gs_codec.encode_distributed("scene.ply", "whole.egs")
    >>> report.count
    2000
    """
    request = Request(as_config(config), max_memory=max_memory, dask=dask or "local")
    return encode_divided(source, target, request, dask, progress, overwrite)


def encode_divided(
    source: str | Path | Sequence[str | Path],
    target: str | Path,
    request: Request,
    dask: str | None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> EncodeReport:
    """Encode one scene as requested, by workers at an address; see `encode_distributed`."""
    config = request.config
    paths = [Path(source)] if isinstance(source, str | Path) else [Path(each) for each in source]
    check_target(paths, target, (".egs",), overwrite)
    sources = open_sources([path.absolute() for path in paths], config.chosen_extra())
    least = max(FANOUT * config.block_size, *(each.block_size for each in sources.listed))
    with using_threads(config.threads), crew_at(dask, progress) as crew:
        at_once = crew.workers.at_once
        size = size_within(request.max_memory, at_once, sources.head.sh_degree, least)
        return encode_in_tasks(crew, sources, Path(target).absolute(), config, size)


def encode_in_tasks(
    crew: Crew, sources: Sources, target: Path, config: Config, size: int
) -> EncodeReport:
    """Encode a scene in tasks of about `size` Gaussians; see `encode_distributed`."""
    times = StageTimes()
    if not sources.count:
        return _encode_nothing(sources, target, config)
    paths = [source.path for source in sources.listed]
    identity = identity_of(paths, config=asdict(config), size=size)
    with work_folder(target, identity) as folder, ExitStack() as stack:
        job = Job(folder, sources, sources.spans(size), config)
        with times.stage("look"):
            looked = look(crew, job)
        count = sources.count - len(looked.dropped)
        if not count:
            others = f" and {len(paths) - 1} more" if paths[1:] else ""
            with located(f"{paths[0]}{others}"):
                raise nothing_left(sources.count)
        quantised, chosen, loss = _quantise_all(crew, job, looked, size, times)
        coded = code_blocks(crew, quantised, times)
        further = carried_sections(sources.head, np.empty(0, np.int64))
        if config.lod:
            with times.stage("levels"):
                levels = code_levels(crew, coded, sources.head, config, size)
            for number, path in enumerate(levels, 1):
                data = stack.enter_context(opened(path))[:]
                further.append(Section(SectionId.LEVEL, number, data, optional=True))
        with times.stage("write"):
            sized = write_blocks(target, coded, further)
    report = EncodeReport(
        count=count,
        raw_bytes=coded.chunks.header.float_bytes,
        section_bytes=section_sizes(sized),
        costs=coded.costs,
        rectified=coded.clamped,
        zero_quaternions=looked.zero_quaternions,
        dropped=len(looked.dropped),
        seconds=times.seconds,
        coarseness=chosen.coarseness,
        rendered=loss,
        sh_degree=coded.chunks.header.sh_degree,
    )
    return _counted(report, sources)


def _quantise_all(
    crew: Crew, job: Job, looked: Looked, size: int, times: StageTimes
) -> tuple[Quantised, Config, RenderedLoss | None]:
    """Quantise all Gaussians; also return the final configuration, and the loss in views."""
    with times.stage("measure"):
        scene, shown = job.load_shown("check", len(job.spans))
        check = Check.by_shown(scene, looked.windows.checking, shown)
    count = job.gaussians.count - len(looked.dropped)

    def attempt(config: Config) -> tuple[tuple[Quantised, Config], RenderedLoss | None]:
        own = job
        if config != looked.config:
            own = replace(job, folder=job.folder.within(f"coarseness-{config.coarseness}"))
        with times.stage("sort"):
            lattice = choose_lattice(crew, job, looked._replace(config=config))
            header = Header.of(job.gaussians.head, config, count)
            chunks = Chunks.of(header.having(Feature.FAR, lattice.grid.has_far), size)
            cuts = _sort(crew, own, lattice, chunks)
        with times.stage("quantise"):
            task = partial(_quantise, own, lattice, chunks, cuts, check.windows)
            crew.do_all(own.folder, "quantise", task, chunks.number)
            own.folder.remove_mapped()
        with times.stage("measure"):
            loss = check.measure_shown(*own.load_shown("decoded", chunks.number))
        return (Quantised(own.folder, chunks, lattice), config), loss

    found = encode_within_loss(attempt, job.config, looked.config, check)
    assert found is not None
    (quantised, chosen), loss = found
    return quantised, chosen, loss


def _sort(crew: Crew, job: Job, lattice: Lattice, chunks: Chunks) -> NDArray[np.int64]:
    """Sort spans, and find the cuts between chunks; see `find_cuts`."""
    folder, number = job.folder, len(job.spans)
    crew.do_all(folder, "sort", partial(_sort_span, job, lattice), number)
    if not folder.has("cuts"):
        cuts = find_cuts(folder, number, chunks.ranks, lattice.grid.key_bits)
        folder.save("cuts", {"cuts": cuts})
    return folder.load("cuts")["cuts"]


def _sort_span(job: Job, lattice: Lattice, number: int) -> None:
    _, clean, _ = job.clean(number)
    save_run(job.folder, number, clean, lattice.grid)


def _quantise(
    job: Job,
    lattice: Lattice,
    chunks: Chunks,
    cuts: NDArray[np.int64],
    windows: Sequence[Camera],
    number: int,
) -> None:
    begins, ends = cuts[:, number], cuts[:, number + 1]
    scene, codes = load_chunk(job.folder, begins, ends, job.gaussians.head)
    shown = find_shown(scene, windows)
    watched = Watched.shown(scene, shown)
    may_have_basis = job.config.effort != "fast"
    blocks = quantise(scene, codes, lattice, chunks.header.block_size, watched, may_have_basis)
    found = [watched.find(own) for own in shown]
    job.save_shown(f"decoded-{number}", watched.decoded(), found)
    save_quantised(job.folder, number, blocks, chunks.coefficients)


def _encode_nothing(sources: Sources, target: Path, config: Config) -> EncodeReport:
    """Encode a scene without Gaussians."""
    parts, report = encode_parts(sources.head, config)
    write_parts(target, parts)
    return _counted(report, sources)


def _counted(report: EncodeReport, sources: Sources) -> EncodeReport:
    """The report with the sizes of the sources, and the ratio to them."""
    return replace(
        report,
        input_bytes=sources.stored_bytes,
        ratio=sources.ratio_bytes / report.file_bytes,
        float_bytes=float_bytes(sources.count, sources.head.sh_degree),
    )
