"""A giant scene encoded by many workers, none of which holds it.

The file is that of `encode_file`, byte for byte, whatever the workers. Stages: the bounds of spans,
and what windows show; spans sorted (`sorting`); chunks of blocks quantised, then, with tables from
the counts of all, coded (`chunks`); the file put together.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec import __version__
from gs_codec.codecs.adaptive.arrange import blind_lattice
from gs_codec.codecs.adaptive.arrange import sample_stride as lattice_stride
from gs_codec.codecs.adaptive.contexts import passes
from gs_codec.codecs.adaptive.encode import choose_models
from gs_codec.codecs.adaptive.lattice import Lattice
from gs_codec.codecs.adaptive.section import write_lattice
from gs_codec.codecs.encode import encode_parts
from gs_codec.coding.clean import clean_scene, finite_gaussians
from gs_codec.config import ADAPTIVE_PROFILES, EGS, Config
from gs_codec.distributed.chunks import coded_bytes, coded_table, save_coded, save_quantised
from gs_codec.distributed.folder import Folder, work_folder
from gs_codec.distributed.sorting import find_cuts, load_chunk, save_run
from gs_codec.distributed.sources import Sources, Span, open_sources
from gs_codec.distributed.workers import Workers, do_all, size_within, workers_at
from gs_codec.egs.file import Listed, Section, SectionId, file_head, padded_parts, section_sizes
from gs_codec.egs.header import Header
from gs_codec.egs.index import index_section
from gs_codec.egs.sections import carried_sections
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import check_target, write_parts
from gs_codec.guidance import calibrate
from gs_codec.rendering.camera import Camera
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import GROUPS, Scene, join_scenes


def encode_distributed(
    source: str | Path | Sequence[str | Path],
    target: str | Path,
    config: Config | None = None,
    *,
    dask: str = "local",
    progress: Progress | None = None,
    max_memory: int | None = None,
    overwrite: bool = True,
) -> EncodeReport:
    """Encode one scene by the workers of a Dask scheduler; it is never in memory as a whole.

    The file is that of `encode_file`, or of `convert_file` for several sources, byte for byte. What
    is done is kept in the folder ``TARGET.parts`` until the target is whole: the same call goes on
    with what a run before it left. Workers read the sources and use that folder, so they need a
    storage that all machines share.

    Parameters
    ----------
    source : path, or sequence of paths
        Binary PLY files of floats, or `.egs` files; several are merged, see `gs_codec.edit.merge`.
    target : str or Path
        An ``.egs``.
    config : Config, optional
        Of profile ``l``, ``m`` or ``s``, without depths and extra properties; its threads are the
        processes of a local cluster, by default one for each processor.
    dask : str
        Address of a scheduler, or ``local``.
    progress, overwrite
        As for `encode_file`.
    max_memory : int, optional
        Maximum memory of each worker, bytes: fewer Gaussians are then held at once.

    Returns
    -------
    EncodeReport
        As that of `encode_file`, but for its stages.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool
        As for `encode_file`; or if there is no scheduler, or workers are lost again and again.

    Examples
    --------
    >>> report = gs_codec.encode_distributed("scene.ply", "scene.egs")
    >>> report.count
    2000
    """
    config = config or Config()
    paths = [Path(source)] if isinstance(source, str | Path) else [Path(each) for each in source]
    check_target(paths, target, (".egs",), overwrite)
    _check(config)
    sources = open_sources([path.absolute() for path in paths], config.extra)
    least = max(config.block_size, *(each.block_size for each in sources.listed))
    with using_threads(config.threads), workers_at(dask, progress) as workers:
        size = size_within(max_memory, workers.at_once, sources.head.sh_degree, least)
        return encode_with(workers, sources, Path(target).absolute(), config, size)


def _check(config: Config) -> None:
    """Refuse what looks at all Gaussians at once."""
    if config.profile not in ADAPTIVE_PROFILES or config.format != EGS:
        known = ", ".join(ADAPTIVE_PROFILES)
        raise InvalidInput(f"dask: profile '{config.profile}', expected {known} of an .egs")
    if config.depths:
        raise InvalidInput("dask: not with depths, which need the whole scene")
    if config.extra == "keep":
        raise InvalidInput("dask: extra properties are not kept, expected --extra drop")


@dataclass(frozen=True)
class _Job:
    """What all tasks of a run know."""

    folder: Folder
    sources: Sources
    spans: Sequence[Span]
    config: Config

    def clean(self, number: int) -> tuple[Scene, Scene, dict[str, Any]]:
        """A span as it is, cleaned, and what was changed."""
        scene = self.sources.read(self.spans[number])
        with located(self.spans[number].source.path):
            return scene, *clean_scene(scene, self.config)

    def save_scene(self, name: str, scene: Scene, **others: NDArray) -> None:
        """Keep the floats of a scene, and more, as a result."""
        self.folder.save(name, {group: getattr(scene, group) for group in GROUPS} | others)

    def load_scene(self, name: str) -> Scene:
        """The scene of a result."""
        planes: dict[str, Any] = self.folder.load(name, *GROUPS)
        return replace(self.sources.head, **planes)


def encode_with(
    workers: Workers, sources: Sources, target: Path, config: Config, size: int
) -> EncodeReport:
    """Encode a scene in tasks of about `size` Gaussians; see `encode_distributed`."""
    times = StageTimes()
    if not sources.count:
        return _encode_nothing(sources, target, config, 0)
    with work_folder(target, _identity(sources, config, size)) as folder:
        job = _Job(folder, sources, sources.spans(size), config)
        with times.stage("scan"):
            config, dropped, zeros, bounds = _scan(workers, job)
        count = sources.count - len(dropped)
        if not count:
            return _encode_nothing(sources, target, config, len(dropped))
        with times.stage("sort"):
            lattice, header = _sort(workers, job, config, dropped, count, bounds)
        chunks = _Chunks(header, max(size // header.block_size, 1))
        with times.stage("quantise"):
            _quantise(workers, job, lattice, chunks)
        with times.stage("model"):
            listed = passes(len(sources.head.f_rest) // 3)
            quantised = [folder.load(f"quantise-{k}") for k in range(chunks.number)]
            names = [name for name in quantised[0] if name.startswith("count")]
            counted = [np.sum([each[name] for each in quantised], axis=0) for name in names]
            models, _, costs = choose_models(listed, counted)
            sections = index_section([row for each in quantised for row in each["extents"]])
            described = write_lattice(lattice, models)
            sections.append(Section(SectionId.LATTICE, 0, described))
            sections += carried_sections(sources.head, np.empty(0, np.int64))
        with times.stage("code"):
            task = partial(_code, job, described, chunks)
            do_all(workers, job.folder, "code", task, chunks.number)
        with times.stage("write"):
            sized = _write(target, folder, header, sections, chunks.number)
    report = EncodeReport(
        count=count,
        raw_bytes=header.float_bytes,
        section_bytes=section_sizes(sized),
        costs=costs,
        rectified=int(sum(each["clamped"] for each in quantised)),
        zero_quaternions=zeros,
        dropped=len(dropped),
        seconds=times.seconds,
        coarseness=config.coarseness,
    )
    ratio = sources.ratio_bytes / report.file_bytes
    return replace(report, input_bytes=sources.stored_bytes, ratio=ratio)


def _identity(sources: Sources, config: Config, size: int) -> dict[str, Any]:
    """What two runs have to agree in for one to go on with the results of the other."""
    stamps = [
        (s.path, os.stat(s.path).st_size, os.stat(s.path).st_mtime_ns) for s in sources.listed
    ]
    return {"version": __version__, "files": stamps, "config": asdict(config), "size": size}


def _scan(
    workers: Workers, job: _Job
) -> tuple[Config, NDArray[np.int64], int, tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """The coarseness a scene needs, numbers of dropped Gaussians, zero quaternions, and bounds."""
    number = len(job.spans)
    do_all(workers, job.folder, "sample", partial(_sample, job), number)
    sample = join_scenes([job.load_scene(f"sample-{k}") for k in range(number)])
    windows = calibrate.choose_windows(sample, job.sources.count)
    do_all(workers, job.folder, "scan", partial(_look, job, windows), number)
    names = ("dropped", "zeros", "bounds")
    seen = [job.folder.load(f"scan-{k}", *names) for k in range(number)]
    dropped = np.concatenate([np.empty(0, np.int64), *(each["dropped"] for each in seen)])
    zeros = int(sum(each["zeros"] for each in seen))
    config = job.config
    if windows:
        shown = _shown(job, number, len(windows))
        config = calibrate.calibrated_by(sample, windows, shown, config)
    bounds = np.stack([each["bounds"] for each in seen])
    return config, dropped, zeros, (bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0))


def _numbers(span: Span, stride: int, dropped: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers, in all files, of every `stride`-th Gaussian that is not dropped, in a span."""
    stop = span.first + span.stop - span.start
    gone = np.searchsorted(dropped, [span.first, stop])
    first, end = span.first - gone[0], stop - gone[1]
    kept = np.arange(-(-first // stride) * stride, end, stride)
    # So many of those before it were dropped.
    return kept + np.searchsorted(dropped - np.arange(len(dropped)), kept, "right")


def _sample(job: _Job, number: int) -> None:
    stride = calibrate.sample_stride(job.sources.count)
    index = _numbers(job.spans[number], stride, np.empty(0, np.int64))
    job.save_scene(f"sample-{number}", job.sources.pick(job.spans[number], index))


def _look(job: _Job, windows: Sequence[Camera], number: int) -> None:
    """Bounds of a span, what is changed in it, and what of it windows show."""
    scene, clean, changed = job.clean(number)
    gone = np.empty(0, np.int64)
    if changed["dropped"]:
        gone = job.spans[number].first + np.flatnonzero(~finite_gaussians(scene))
    low = clean.positions.min(axis=1, initial=np.inf)
    high = clean.positions.max(axis=1, initial=-np.inf)
    found = calibrate.find_shown(scene, windows)
    job.save_scene(
        f"scan-{number}",
        scene.take(np.concatenate([np.empty(0, np.int64), *found])),
        sizes=np.array([len(each) for each in found], np.int64),
        bounds=np.stack([low, high]),
        dropped=gone,
        zeros=np.array(changed["zero_quaternions"]),
    )


def _shown(job: _Job, spans: int, windows: int) -> list[Scene]:
    """What each window shows of all spans."""
    parts: list[list[Scene]] = [[] for _ in range(windows)]
    for number in range(spans):
        scene = job.load_scene(f"scan-{number}")
        ends = np.cumsum(job.folder.load(f"scan-{number}", "sizes")["sizes"]).tolist()
        for part, start, stop in zip(parts, [0, *ends], ends, strict=False):
            part.append(scene.between(start, stop))
    return [join_scenes(part) for part in parts]


def _sort(
    workers: Workers,
    job: _Job,
    config: Config,
    dropped: NDArray[np.int64],
    count: int,
    bounds: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> tuple[Lattice, Header]:
    """Choose the lattices, and sort spans by their grid."""
    number = len(job.spans)
    do_all(workers, job.folder, "pick", partial(_pick, job, lattice_stride(count), dropped), number)
    sample = join_scenes([job.load_scene(f"pick-{k}") for k in range(number)])
    lattice = blind_lattice(sample, bounds, config)
    do_all(workers, job.folder, "sort", partial(_sort_span, job, lattice), number)
    return lattice, Header.of(job.sources.head, config, count)


def _pick(job: _Job, stride: int, dropped: NDArray[np.int64], number: int) -> None:
    index = _numbers(job.spans[number], stride, dropped)
    scene, _ = clean_scene(job.sources.pick(job.spans[number], index), job.config)
    job.save_scene(f"pick-{number}", scene)


def _sort_span(job: _Job, lattice: Lattice, number: int) -> None:
    _, clean, _ = job.clean(number)
    save_run(job.folder, number, clean, lattice.grid)


@dataclass(frozen=True)
class _Chunks:
    """Blocks of a file in chunks of `each`."""

    header: Header
    each: int

    @property
    def number(self) -> int:
        """How many there are."""
        return -(-self.header.block_count // self.each)

    @property
    def ranks(self) -> list[int]:
        """The Gaussian that each chunk begins with, and where the last ends."""
        step = self.each * self.header.block_size
        return [*range(0, self.header.count, step), self.header.count]


def _quantise(workers: Workers, job: _Job, lattice: Lattice, chunks: _Chunks) -> None:
    """Quantise chunks; sorted spans are removed then."""
    folder, runs = job.folder, len(job.spans)
    if not folder.has("cuts"):
        folder.save(
            "cuts", {"cuts": find_cuts(folder, runs, chunks.ranks, lattice.grid.total_bits)}
        )
    (cuts,) = folder.load("cuts").values()
    task = partial(_quantise_chunk, job, lattice, chunks, cuts)
    do_all(workers, job.folder, "quantise", task, chunks.number)
    folder.remove_mapped()


def _quantise_chunk(
    job: _Job, lattice: Lattice, chunks: _Chunks, cuts: NDArray[np.int64], number: int
) -> None:
    begins, ends = cuts[:, number], cuts[:, number + 1]
    scene, codes = load_chunk(job.folder, begins, ends, job.sources.head)
    save_quantised(job.folder, number, scene, codes, lattice, chunks.header.block_size)


def _code(job: _Job, described: bytes, chunks: _Chunks, number: int) -> None:
    coefficients = len(job.sources.head.f_rest) // 3
    save_coded(job.folder, number, number * chunks.each, described, coefficients)


def _write(
    target: Path, folder: Folder, header: Header, sections: list[Section], chunks: int
) -> list[tuple[int, int]]:
    """Put the file together; returns the id and size of each section."""
    coded = [(place, k) for place in range(1 + header.sh_degree) for k in range(chunks)]
    table = [Listed.of(section) for section in sections]
    for place, k in coded:
        table += coded_table(folder, place, k)
    with atomic_writer(target) as file:
        file.write(file_head(header, table))
        for section in sections:
            file.writelines(padded_parts(section))
        for place, k in coded:
            file.write(coded_bytes(folder, place, k))
    return [(entry.id, entry.size) for entry in table]


def _encode_nothing(sources: Sources, target: Path, config: Config, dropped: int) -> EncodeReport:
    """Encode a scene without Gaussians."""
    parts, report = encode_parts(sources.head, config)
    write_parts(target, parts)
    ratio = sources.ratio_bytes / report.file_bytes
    return replace(report, dropped=dropped, input_bytes=sources.stored_bytes, ratio=ratio)
