"""Decode a giant `.egs` with many workers, none of which holds all of it in memory."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import opened_slabs
from gs_codec.coding.extent import box_text
from gs_codec.distributed.folder import Folder, identity_of, work_folder
from gs_codec.distributed.tasks import Crew, crew_at, size_within
from gs_codec.egs.index import bounds_of, index_of
from gs_codec.errors import InvalidInput
from gs_codec.files.decode_file import DecodeReport
from gs_codec.files.suffixes import check_target
from gs_codec.formats.ply.writer import ply_header, vertex_rows
from gs_codec.report import Progress, StageTimes
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.threads import using_threads


@checked
def decode_distributed(
    source: str | Path,
    target: str | Path,
    part: Part | None = None,
    *,
    dask: str | None = "local",
    threads: int | None = None,
    progress: Progress | None = None,
    max_memory: int | None = None,
    overwrite: bool = False,
) -> DecodeReport:
    """Decode an `.egs` file, or a part of it, with the workers of a Dask scheduler.

    The output equals that of `decode_file`, byte for byte. `encode_distributed` describes the
    folder that workers share.

    Parameters
    ----------
    source, target, part, progress, overwrite
        As in `decode_file`.
    dask : str, optional
        Address of a scheduler, or ``local``. None: this process does one task after another, each
        in one thread; it does not need Dask.
    threads : int, optional
        Processes of a local cluster; by default one per processor.
    max_memory : int, optional
        Maximum memory of each worker, bytes.

    Returns
    -------
    DecodeReport
        As from `decode_file`.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool
        As in `decode_file`; or if there is no scheduler, or workers are lost repeatedly.

    Examples
    --------
    >>> gs_codec.decode_distributed("scene.egs", "whole.ply").count
    2000
    """
    check_target([source], target, (".ply",), overwrite)
    part, paths = part or Part(), (Path(source).absolute(), Path(target).absolute())
    if part.level or part.view is not None:
        raise InvalidInput(
            "dask: cannot be combined with a level or a view, which one process decodes"
        )
    with opened_slabs(source, part, among=()) as slabs:
        degree, least = slabs.sh_degree, slabs.chosen.file.header.block_size
    with using_threads(threads), crew_at(dask, progress) as crew:
        size = size_within(max_memory, crew.workers.at_once, degree, least)
        return decode_with(crew, *paths, part, size)


def decode_with(crew: Crew, source: Path, target: Path, part: Part, size: int) -> DecodeReport:
    """Decode a file in tasks of about `size` Gaussians; see `decode_distributed`."""
    times = StageTimes()
    with opened_slabs(source, part, among=()) as slabs:
        (head,), file, described = slabs.scenes(), slabs.chosen.file, slabs.bytes_read
        degree, index = slabs.sh_degree, index_of(file)
        blocks = np.flatnonzero(part.meets(index[:, :3], index[:, 3:6])).tolist()
        bounds = bounds_of(file)
    each = max(size // file.header.block_size, 1)
    chunks = [blocks[start : start + each] for start in range(0, len(blocks), each)]
    with work_folder(target, identity_of([source], part=part, size=size)) as folder:
        with times.stage("decode"):
            task = partial(_decode, folder, source, part, chunks)
            crew.do_all(folder, "decode", task, len(chunks))
        names = [f"decode-{k}" for k in range(len(chunks))]
        found = [folder.load(name, "count", "bytes_read") for name in names]
        count = sum(int(each["count"]) for each in found)
        if count or bounds is None:
            with times.stage("write"), atomic_writer(target) as out:
                out.write(ply_header(head, count))
                for name in names:
                    out.write(folder.load(name, "rows")["rows"].data)
    if bounds is not None and not count:
        raise InvalidInput(f"{source}: no Gaussians in the box, {box_text(bounds)}")
    read = described + sum(int(each["bytes_read"]) - described for each in found)
    return DecodeReport(count, degree, read, os.path.getsize(source), times.seconds)


def _decode(
    folder: Folder, source: Path, part: Part, chunks: Sequence[Sequence[int]], number: int
) -> None:
    """Decode some blocks into rows of a PLY."""
    with opened_slabs(source, part, among=frozenset(chunks[number])) as slabs:
        rows = [vertex_rows(scene) for scene in slabs.scenes()]
        read = slabs.bytes_read
    content = np.concatenate(rows)
    found = {"count": np.array(len(content)), "bytes_read": np.array(read)}
    folder.save(f"decode-{number}", {"rows": content.view(np.uint8), **found})
