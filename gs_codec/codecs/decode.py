"""Stream to scene."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.decode import adaptive_sections, decode_adaptive
from gs_codec.codecs.blocks_for_view import select_blocks
from gs_codec.codecs.memory_limit import slab_within
from gs_codec.codecs.part import Part
from gs_codec.config import ADAPTIVE_PROFILES, EGS, LOSSLESS, Config, check_threads
from gs_codec.egs.egs_file import (
    SCENE_SECTIONS,
    EgsFile,
    Readable,
    SectionId,
)
from gs_codec.egs.frame_sections import read_described
from gs_codec.egs.header import Feature
from gs_codec.egs.index import index_of, levels_of, open_level, within
from gs_codec.egs.sections import extra_bytes, read_comments, read_extra
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.formats.limits import most_bytes
from gs_codec.report import Progress
from gs_codec.runtime.arrays import current
from gs_codec.runtime.threads import using_threads
from gs_codec.runtime.wording import counted
from gs_codec.scene import GROUPS, Scene, join_scenes, stated_comments

if TYPE_CHECKING:
    from gs_codec.codecs.entropygs.gpcc import Tmc3

#: Maximum number of Gaussians decoded at once if there is a memory limit.
_SLAB = 1 << 18


def decode_scene(
    data: bytes | Readable,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
) -> Scene:
    """Decode an `.egs` stream; see `decode_part` for the arguments."""
    return decode_part(data, Part(), threads, max_bytes, progress)[0]


def decode_as(config: Config, data: bytes | Readable, progress: Progress | None = None) -> Scene:
    """Decode data that was just encoded with a configuration, which names the format."""
    if config.format == EGS:
        return decode_part(data, Part(), config.threads, sys.maxsize, progress, config.tmc3)[0]
    from gs_codec.codecs.interchange import decode_interchange

    return decode_interchange(data[:], config)


def decode_part(
    data: bytes | Readable | EgsFile,
    part: Part,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    tmc3: str | Path | None = None,
) -> tuple[Scene, EgsFile]:
    """Decode a part of an `.egs` stream.

    Skips SH above the part's degree, blocks with no centres in the part's box (according to the
    index), and blocks that its view does not need. Raises InvalidInput if the number of threads is
    out of range. Raises CorruptStream, TruncatedStream or UnsupportedVersion. Raises MissingTool or
    ToolFailed if the stream uses G-PCC or torchac, and the program is missing or fails.

    Parameters
    ----------
    data : bytes, or EgsFile whose descriptions were read
    part : Part
    threads : int, optional
        Worker threads, 1-256; by default one per available processor, or a single one for fewer
        than 4096 Gaussians.
    max_bytes : int, optional
        Maximum decoded size; the default comes from `most_bytes`.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.
    tmc3 : path, optional
        The program for streams that use G-PCC; by default from ``GS_CODEC_TMC3`` or PATH.

    Returns
    -------
    scene : Scene
        The Gaussians in stream order; with a view, the coarsest level first.
    file : EgsFile
        The header and the sections that were read; with a level, those of the level.
    """
    check_threads(threads)
    with using_threads(threads):
        chosen = choose_part(data, part, max_bytes, tmc3)
        if current().limit is None:
            scene = join_scenes(list(chosen.slabs(chosen.file.header.count, progress)))
        else:
            size = slab_within(chosen.file, chosen.degree, _SLAB)
            scene = join_scenes([_kept(slab) for slab in chosen.slabs(size, progress)])
    return scene, chosen.file


def _kept(scene: Scene) -> Scene:
    """Move a scene's planes to long-term storage; see `Memory.keep`."""
    planes: dict[str, Any] = {group: current().keep(getattr(scene, group)) for group in GROUPS}
    return replace(scene, **planes)


def choose_part(
    data: bytes | Readable | EgsFile,
    part: Part,
    max_bytes: int | None = None,
    tmc3: str | Path | None = None,
    among: Container[int] | None = None,
) -> ChosenPart:
    """Read and check the sections for a part, within the blocks `among`; see `decode_part`."""
    file = data if isinstance(data, EgsFile) else read_described(data)
    header, limit = file.header, most_bytes(len(file.data), max_bytes)
    if header.float_bytes > limit:
        raise CorruptStream(
            f"header: {counted(header.count, 'Gaussian')}, "
            f"{counted(header.float_bytes, 'byte')}, the limit is {limit:,}"
        )
    _check_sections(file)
    tool = _require_programs(file, tmc3)
    if part.view is not None:
        levels = [file, *(_opened(file, level) for level in levels_of(file))]
        if part.tolerance is not None and len(levels) == 1:
            raise InvalidInput(
                f"tolerance {part.tolerance:g}: has no effect without levels of detail in the file"
            )
        selected = select_blocks(levels, part.view, part.budget, part.chosen_tolerance)
        if not any(selected) and part.budget is not None and header.count:
            raise InvalidInput(f"budget {part.budget}: the nearest block has more Gaussians")
        finest, *coarser = (
            _chosen(own, part, blocks, limit, tool)
            for own, blocks in zip(levels, selected, strict=True)
        )
        return replace(finest, coarser=tuple(coarser))
    if part.level:
        if part.level not in levels_of(file):
            known = len(levels_of(file))
            raise InvalidInput(f"level {part.level}: the file has levels 0 to {known}")
        own = _opened(file, part.level)
        with within(part.level):
            blocks = _in_box(own, part, among)
            chosen = _chosen(own, part, blocks, limit, tool)
        return replace(chosen, bytes_before=file.bytes_read)
    return _chosen(file, part, _in_box(file, part, among), limit, tool)


def _opened(file: EgsFile, level: int) -> EgsFile:
    """Open a level of a file, and check that it has exactly its sections."""
    found = open_level(file, level)
    with within(level):
        _check_sections(found, is_level=True)
    return found


def _require_programs(file: EgsFile, tmc3: str | Path | None) -> Tmc3 | None:
    """Check that the external programs for a file are available; return that for points."""
    if not (Feature.GPCC | Feature.TORCHAC) & file.header.features:
        return None
    from gs_codec.codecs.entropygs.gpcc import tool_for
    from gs_codec.codecs.entropygs.torchac_coder import require_coder

    tool = tool_for(file, tmc3)
    require_coder(file)
    return tool


def _in_box(file: EgsFile, part: Part, among: Container[int] | None) -> list[int]:
    """Blocks, out of those `among`, that may have Gaussians of a part."""
    index = index_of(file)
    blocks = np.flatnonzero(part.meets(index[:, :3], index[:, 3:6])).tolist()
    return blocks if among is None else [block for block in blocks if block in among]


def _chosen(
    file: EgsFile, part: Part, blocks: Sequence[int], limit: int, tool: Tmc3 | None
) -> ChosenPart:
    """Read and check the sections of some blocks of a file."""
    degree = part.degree_of(file.header.sh_degree)
    chosen = frozenset(blocks)
    # In a local basis, each coefficient depends on all components.
    in_basis = degree > 0 and Feature.LOCAL_BASIS in file.header.features
    highest = file.header.sh_degree if in_basis else degree
    unread = {SectionId.of_stream(f"sh{band}") for band in range(highest + 1, 4)}
    if not degree:
        unread.add(SectionId.BASIS)
    unread.add(SectionId.LEVEL)
    file = file.read(
        lambda section, block: (
            section not in unread and (section in SCENE_SECTIONS or block in chosen)
        ),
    )
    _check_extra(file, limit)
    return ChosenPart(file, part, degree, blocks, tool)


@dataclass(frozen=True)
class ChosenPart:
    """A file with all needed sections read and checked, and the blocks to decode.

    `coarser` has the same for coarser levels, the finest first. `bytes_before` is the number of
    bytes read from the enclosing file of a level.
    """

    file: EgsFile
    part: Part
    degree: int
    blocks: Sequence[int]
    tool: Tmc3 | None
    coarser: tuple[ChosenPart, ...] = ()
    bytes_before: int = 0

    @property
    def count(self) -> int:
        """Number of Gaussians in the blocks."""
        spans = [self.file.header.block_range(block) for block in self.blocks]
        return sum(stop - start for start, stop in spans) + sum(p.count for p in self.coarser)

    @property
    def bytes_read(self) -> int:
        """Bytes of the file that were read."""
        return self.bytes_before + self.file.bytes_read + sum(p.bytes_read for p in self.coarser)

    def slabs(self, size: int, progress: Progress | None = None) -> Iterator[Scene]:
        """Decode to consecutive scenes of whole blocks, at most `size` Gaussians each.

        A larger block is yielded as a single scene. Without blocks, one empty scene is yielded.
        Coarser levels come first; if there are any, no slab has extra properties.
        """
        comments, extra = carried(self.file)
        if self.coarser:
            extra = {}
        listed = [
            (number, self._of(number), run)
            for number in range(len(self.coarser), -1, -1)
            for run in self._of(number)._runs(size)
        ]
        if any(run.spans for _, _, run in listed):
            listed = [one for one in listed if one[2].spans]
        else:
            listed = listed[-1:]
        total, done = sum(run.count for _, _, run in listed), 0
        for number, own, run in listed:
            advance = progress if len(listed) == 1 else _part_of(progress, done, run.count, total)
            with within(number or self.part.level), using_threads(None, run.count):
                decode = _decoder(own.file.header.profile, own.tool)
                groups = decode(own.file, run.spans, own.degree, advance)
            normals = self.file.header.has_normals
            scene = Scene(**groups, has_normals=normals, comments=comments, extra=run.of(extra))
            if self.part.box is not None:
                scene = scene.take(self.part.contains(scene.positions))
            yield scene
            done += run.count

    def _of(self, number: int) -> ChosenPart:
        """The blocks of a level: 0 for this object, higher numbers for coarser levels."""
        return self.coarser[number - 1] if number else self

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
    """Blocks decoded together: their ranges in the result and in the stream."""

    spans: dict[int, slice]
    ranges: list[slice]

    @property
    def count(self) -> int:
        return max((span.stop for span in self.spans.values()), default=0)

    def of(self, columns: dict[str, NDArray]) -> dict[str, NDArray]:
        """Rows of these Gaussians, from columns of the whole scene."""
        return {
            name: np.concatenate([column[:0], *(column[where] for where in self.ranges)])
            for name, column in columns.items()
        }


def _part_of(progress: Progress | None, first: int, count: int, total: int) -> Progress | None:
    """Overall progress, from the progress of a slab of `count` Gaussians after `first`."""
    if progress is None:
        return None
    return lambda stage, done, steps: progress(stage, first + count * done // steps, total)


def _decoder(profile: str, tool: Tmc3 | None) -> Callable[..., dict[str, NDArray[np.float32]]]:
    if profile in ADAPTIVE_PROFILES:
        return decode_adaptive
    if profile == LOSSLESS:
        from gs_codec.codecs.lossless.lossless import decode_lossless

        return decode_lossless
    from gs_codec.codecs.entropygs.decode import decode_channels

    return partial(decode_channels, tool=tool)


def _check_extra(file: EgsFile, limit: int) -> None:
    """Reject extra properties that, together with the floats, would exceed the limit."""
    extra = file.sections.get((SectionId.EXTRA, 0))
    size = 0 if extra is None else extra_bytes(extra, file.header.count)
    if size > limit - file.header.float_bytes:
        raise CorruptStream(
            f"section 'extra': {counted(size, 'byte')} in addition to "
            f"{file.header.float_bytes:,}, the limit is {limit:,}"
        )


def _check_sections(file: EgsFile, is_level: bool = False) -> None:
    """Check that a file, or a level of one, has exactly its profile's sections."""
    header = file.header
    own: set[SectionId] = set()
    if header.profile == LOSSLESS:
        from gs_codec.codecs.lossless.lossless import lossless_sections

        expected = set(lossless_sections(header.sh_degree))
    elif header.profile in ADAPTIVE_PROFILES:
        own, expected = {SectionId.LATTICE}, adaptive_sections(header.sh_degree)
    else:
        from gs_codec.codecs.entropygs.decode import channel_sections, scene_sections

        expected = channel_sections(file)
        own = scene_sections(file, expected)
    if header.count:
        own = own | {SectionId.INDEX}
    if is_level:
        own = own | {SectionId.ERRORS}
    else:
        own = own | {SectionId.COMMENTS, SectionId.EXTRA}
        if header.profile in ADAPTIVE_PROFILES:
            own = own | {SectionId.LEVEL}
    if header.profile in ADAPTIVE_PROFILES:
        own = own | {SectionId.FAR, SectionId.BASIS}
    others = set(SectionId) - own - expected
    for section_id, block in file.table:
        if section_id in others:
            label = SectionId(section_id).label
            raise CorruptStream(f"section '{label}' of block {block}: empty")
    found = sum(section_id in expected for section_id, _ in file.table)
    if found != len(expected) * header.block_count:
        needed = len(expected) * header.block_count
        raise CorruptStream(f"header: {counted(found, 'section')} of blocks, expected {needed:,}")


def carried(file: EgsFile) -> tuple[tuple[str, ...], dict[str, NDArray]]:
    """Comments, including what the header states, and extra properties of all Gaussians."""
    header = file.header
    stored = file.sections.get((SectionId.COMMENTS, 0))
    extra = file.sections.get((SectionId.EXTRA, 0))
    comments = () if stored is None else read_comments(stored)
    comments += stated_comments(header.coordinates, header.antialiased)
    return comments, {} if extra is None else read_extra(extra, header.count)
