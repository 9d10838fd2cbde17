"""Stream to scene."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.decode import adaptive_sections, decode_adaptive
from gs_codec.codecs.entropygs.decode import channel_sections, decode_channels, sections_beside
from gs_codec.codecs.entropygs.gpcc import tool_for
from gs_codec.codecs.entropygs.tmc3 import Tmc3
from gs_codec.codecs.entropygs.torchac_coder import require_coder
from gs_codec.codecs.interchange import decode_interchange
from gs_codec.codecs.lossless.lossless import decode_lossless, lossless_sections
from gs_codec.codecs.memory import slab_within
from gs_codec.codecs.part import Part
from gs_codec.config import ADAPTIVE_PROFILES, EGS, LOSSLESS, Config, check_threads
from gs_codec.egs.file import DESCRIPTIONS, SCENE_SECTIONS, EgsFile, SectionId, read_file
from gs_codec.egs.index import index_of
from gs_codec.egs.sections import extra_bytes, read_comments, read_extra
from gs_codec.errors import CorruptStream
from gs_codec.formats.limits import most_bytes
from gs_codec.report import Progress
from gs_codec.runtime.arrays import current
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import GROUPS, Scene, join_scenes, stated_comments

#: Gaussians decoded at once below a memory limit.
_SLAB = 1 << 18


def decode_scene(
    data: bytes | memoryview,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
) -> Scene:
    """Decode an `.egs` stream; see `decode_part`."""
    return decode_part(data, Part(), threads, max_bytes, progress)[0]


def decode_as(config: Config, data: bytes, progress: Progress | None = None) -> Scene:
    """Decode what was encoded by a configuration, which names its format."""
    if config.format == EGS:
        return decode_scene(data, config.threads, progress=progress)
    return decode_interchange(data, config)


def decode_part(
    data: bytes | memoryview,
    part: Part,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    tmc3: str | Path | None = None,
) -> tuple[Scene, EgsFile]:
    """Decode a part of an `.egs` stream.

    SH above the part's degree is not read, nor are blocks whose centres the index has apart from
    the part's box.

    Parameters
    ----------
    data : bytes
    part : Part
    threads : int, optional
        Worker threads, 1-256; by default one for each available processor, but a single one for
        fewer than 4096 Gaussians.
    max_bytes : int, optional
        Largest decoded size that is accepted; `most_bytes` gives the default.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.
    tmc3 : path, optional
        The program for streams that use G-PCC; by default from ``GS_CODEC_TMC3`` or PATH.

    Returns
    -------
    scene : Scene
        In the order of the stream.
    file : EgsFile
        The header, and the sections that were read.

    Raises
    ------
    InvalidInput
        If the number of threads is out of range.
    CorruptStream, TruncatedStream, UnsupportedVersion
    MissingTool, ToolFailed
        If the stream uses G-PCC or torchac, and the program is missing or fails.
    """
    check_threads(threads)
    with using_threads(threads):
        chosen = choose_part(data, part, max_bytes, tmc3)
        if current().limit is None:
            (scene,) = chosen.slabs(chosen.file.header.count, progress)
        else:
            size = slab_within(chosen.file, chosen.degree, _SLAB)
            scene = join_scenes([_kept(slab) for slab in chosen.slabs(size, progress)])
    return scene, chosen.file


def _kept(scene: Scene) -> Scene:
    """A scene whose planes are kept for long; see `Memory.keep`."""
    planes: dict[str, Any] = {group: current().keep(getattr(scene, group)) for group in GROUPS}
    return replace(scene, **planes)


def choose_part(
    data: bytes | memoryview,
    part: Part,
    max_bytes: int | None = None,
    tmc3: str | Path | None = None,
    among: Container[int] | None = None,
) -> ChosenPart:
    """Read and check the sections that a part needs, of the blocks `among`; see `decode_part`."""
    file = read_file(data, lambda section, _: section in DESCRIPTIONS)
    header = file.header
    limit = most_bytes(len(data), max_bytes)
    if header.float_bytes > limit:
        raise CorruptStream(
            f"header: {header.count} Gaussians are {header.float_bytes} bytes, the limit is {limit}"
        )
    _check_sections(file)
    index = index_of(file)
    tool = tool_for(file, tmc3)
    require_coder(file)
    degree = part.degree_of(header.sh_degree)
    blocks = np.flatnonzero(part.meets(index[:, :3], index[:, 3:6])).tolist()
    if among is not None:
        blocks = [block for block in blocks if block in among]
    chosen = frozenset(blocks)
    unread = {SectionId.of_stream(f"sh{band}") for band in range(degree + 1, 4)}
    file = file.read(
        lambda section, block: (
            section not in unread and (section in SCENE_SECTIONS or block in chosen)
        ),
    )
    _check_extra(file, limit)
    return ChosenPart(file, part, degree, blocks, tool)


@dataclass(frozen=True)
class ChosenPart:
    """A file whose needed sections are read and checked, and the blocks to decode."""

    file: EgsFile
    part: Part
    degree: int
    blocks: Sequence[int]
    tool: Tmc3 | None

    def slabs(self, size: int, progress: Progress | None = None) -> Iterator[Scene]:
        """Decode to consecutive scenes of whole blocks, at most `size` Gaussians each.

        A larger block is a scene of its own. If there are no blocks, one empty scene is given.
        """
        header = self.file.header
        decode, (comments, extra) = _decoder(header.profile, self.tool), carried(self.file)
        runs = list(self._runs(size))
        total, done = sum(run.count for run in runs), 0
        for run in runs:
            advance = progress if len(runs) == 1 else _part_of(progress, done, run.count, total)
            with using_threads(None, run.count):
                groups = decode(self.file, run.spans, self.degree, advance)
            normals, own = header.has_normals, run.of(extra)
            scene = Scene(**groups, has_normals=normals, comments=comments, extra=own)
            if self.part.box is not None:
                scene = scene.take(self.part.contains(scene.positions))
            yield scene
            done += run.count

    def _runs(self, size: int) -> Iterator[_Run]:
        header = self.file.header
        run = _Run({}, [])
        for block in self.blocks:
            start, stop = header.block_range(block)
            if run.spans and run.count + stop - start > size:
                yield run
                run = _Run({}, [])
            run.spans[block] = slice(run.count, run.count + stop - start)
            run.ranges.append(slice(start, stop))
        yield run


@dataclass(frozen=True)
class _Run:
    """Blocks that are decoded together: their ranges in the result and in the stream."""

    spans: dict[int, slice]
    ranges: list[slice]

    @property
    def count(self) -> int:
        return max((span.stop for span in self.spans.values()), default=0)

    def of(self, columns: dict[str, NDArray]) -> dict[str, NDArray]:
        """The rows of these Gaussians in columns of the whole scene."""
        return {
            name: np.concatenate([column[:0], *(column[where] for where in self.ranges)])
            for name, column in columns.items()
        }


def _part_of(progress: Progress | None, first: int, count: int, total: int) -> Progress | None:
    """Progress of all Gaussians, from that of a slab of `count` after `first`."""
    if progress is None:
        return None
    return lambda stage, done, steps: progress(stage, first + count * done // steps, total)


def _decoder(profile: str, tool: Tmc3 | None) -> Callable[..., dict[str, NDArray[np.float32]]]:
    if profile == LOSSLESS:
        return decode_lossless
    return decode_adaptive if profile in ADAPTIVE_PROFILES else partial(decode_channels, tool=tool)


def _check_extra(file: EgsFile, limit: int) -> None:
    """Refuse extra properties that, with the floats, would exceed the limit."""
    extra = file.sections.get((SectionId.EXTRA, 0))
    size = 0 if extra is None else extra_bytes(extra, file.header.count)
    if size > limit - file.header.float_bytes:
        raise CorruptStream(
            f"section 'extra': {size} bytes beside {file.header.float_bytes}, the limit is {limit}"
        )


def _check_sections(file: EgsFile) -> None:
    """Check that a file has exactly its profile's sections."""
    header = file.header
    own: set[SectionId] = set()
    if header.profile == LOSSLESS:
        expected = set(lossless_sections(header.sh_degree))
    elif header.profile in ADAPTIVE_PROFILES:
        own, expected = {SectionId.LATTICE}, adaptive_sections(header.sh_degree)
    else:
        expected = channel_sections(file)
        own = sections_beside(file, expected)
    if header.count:
        own = own | {SectionId.INDEX}
    others = set(SectionId) - own - expected - {SectionId.COMMENTS, SectionId.EXTRA}
    for section_id, block in file.table:
        if section_id in others:
            label = SectionId(section_id).label
            raise CorruptStream(f"section '{label}' of block {block}: nothing is coded there")
    found = sum(section_id in expected for section_id, _ in file.table)
    if found != len(expected) * header.block_count:
        needed = len(expected) * header.block_count
        raise CorruptStream(f"header: {found} sections of blocks, expected {needed}")


def carried(file: EgsFile) -> tuple[tuple[str, ...], dict[str, NDArray]]:
    """Comments with what the header states, and extra properties of all Gaussians."""
    header = file.header
    stored = file.sections.get((SectionId.COMMENTS, 0))
    extra = file.sections.get((SectionId.EXTRA, 0))
    comments = () if stored is None else read_comments(stored)
    comments += stated_comments(header.coordinates, header.antialiased)
    return comments, {} if extra is None else read_extra(extra, header.count)
