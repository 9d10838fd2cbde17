"""Decode scenes from file to file, without Open3D and modules needed only for encoding."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import opened_slabs
from gs_codec.files.suffixes import check_target
from gs_codec.formats.ply.writer import write_vertices
from gs_codec.report import Progress
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.atomic import atomic_writer


@dataclass(frozen=True)
class DecodeReport:
    """Result of decoding a file.

    Attributes
    ----------
    count, sh_degree : int
        Number of Gaussians written, and their SH degree.
    bytes_read, file_bytes : int
        Bytes of the `.egs` file that were read, and its size.
    seconds : dict of str to float
        Wall time of each stage.

    Examples
    --------
    >>> report = gs_codec.decode_file("scene.egs", "all.ply")
    >>> report.count, report.bytes_read == report.file_bytes, list(report.seconds)
    (2000, True, ['decode', 'write'])
    """

    count: int
    sh_degree: int
    bytes_read: int
    file_bytes: int
    seconds: dict[str, float]


@checked
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
    overwrite: bool = False,
) -> DecodeReport:
    """Decode an `.egs` file, or a part of it, to a PLY file, atomically.

    Does not load Open3D. If the Gaussians are not in their original order, a comment in the PLY
    states the order, so that `compare` can match them.

    Parameters
    ----------
    source : str or Path
        An `.egs` file.
    target : str or Path
        The PLY to write, in the INRIA trainer's layout.
    part, threads, tmc3, progress, max_bytes
        As in `decode`; only the bytes needed for `part` are read.
    max_memory : int, optional
        Maximum memory, bytes; limits the number of blocks decoded at once.
    overwrite : bool
        As in `encode_file`.

    Returns
    -------
    DecodeReport
        Number of Gaussians, bytes read, and seconds by stage.

    Raises
    ------
    InvalidInput
        As in `decode`; or if the source cannot be read, the target cannot be written, or
        `max_memory` is not enough for one block.
    CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool, ToolFailed
        As in `decode`.

    Examples
    --------
    >>> part = gs_codec.Part(sh_degree=1)
    >>> report = gs_codec.decode_file("scene.egs", "decoded.ply", part)
    >>> report.sh_degree, report.bytes_read < report.file_bytes
    (1, True)
    """
    check_target([source], target, (".ply",), overwrite)
    start = time.perf_counter()
    part = part or Part()
    with opened_slabs(source, part, threads, max_bytes, progress, tmc3, max_memory) as slabs:
        count, scenes = slabs.counted()
        with atomic_writer(target) as file:
            write_vertices(file, count, scenes)
        seconds = {"decode": slabs.seconds, "write": time.perf_counter() - start - slabs.seconds}
        size = os.path.getsize(source)
        return DecodeReport(count, slabs.sh_degree, slabs.bytes_read, size, seconds)
