"""Coarser levels of detail, made and coded by many workers; see `gs_codec.levels`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import order_within
from gs_codec.codecs.adaptive.lattice import Lattice, grid_codes
from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import opened_slabs
from gs_codec.config import Config
from gs_codec.distributed.chunks import quantise, save_quantised
from gs_codec.distributed.coded_blocks import (
    Chunks,
    CodedBlocks,
    Quantised,
    code_blocks,
    write_blocks,
)
from gs_codec.distributed.folder import Folder
from gs_codec.distributed.sorting import planes_of, scene_of_rows
from gs_codec.distributed.sources import Source, Span
from gs_codec.distributed.survey import Job, choose_lattice, look
from gs_codec.distributed.tasks import Crew
from gs_codec.egs.header import FANOUT, Feature, Header
from gs_codec.egs.index import errors_section, level_header
from gs_codec.formats.ply.writer import to_rows
from gs_codec.levels.adding import config_of_levels
from gs_codec.levels.building import Level, coarser
from gs_codec.report import StageTimes
from gs_codec.scene import Scene, join_scenes


@dataclass(frozen=True)
class Merged:
    """The Gaussians of a level, in pieces of `piece`, the last one smaller; see `Gaussians`."""

    folder: Folder
    head: Scene
    count: int
    piece: int

    def spans(self, size: int) -> list[Span]:
        """All Gaussians, in spans of at most `size`."""
        source = Source(self.folder.path, self.count)
        starts = range(0, self.count, size)
        return [Span(source, start, min(start + size, self.count), start) for start in starts]

    def read(self, span: Span) -> Scene:
        """The Gaussians of a span."""
        return self.between(span.start, span.stop)

    def between(self, start: int, stop: int) -> Scene:
        """Gaussians `start` to `stop`, the latter excluded."""
        parts = []
        for number in range(start // self.piece, -(-stop // self.piece)):
            first = number * self.piece
            inside = slice(max(start - first, 0), stop - first)
            parts.append(self.folder.mapped(f"rows-{number}")[inside])
        return scene_of_rows(np.concatenate(parts), self.head)

    def pick(self, span: Span, index: NDArray[np.int64]) -> Scene:
        """The Gaussians of a span with these numbers."""
        return self.read(span).take(index - span.first)


#: Reads blocks of a level, from a first one up to another, the latter excluded.
_Read = Callable[[int, int], Level]


def code_levels(
    crew: Crew, coded: CodedBlocks, head: Scene, config: Config, size: int
) -> list[Path]:
    """Files of the coarser levels of coded blocks, the finest first; see `add_levels`.

    `config` is the configuration requested for the scene, before calibration.
    """
    chunks, head = coded.chunks, replace(head, comments=(), has_normals=False)
    paths = list[Path]()
    if chunks.header.level_counts:
        write_blocks(coded.folder.path / "level-0.egs", coded)
    read: _Read = partial(_decoded, coded.folder.path / "level-0.egs")
    for number in range(1, len(chunks.header.level_counts) + 1):
        header = level_header(chunks.header, number)
        folder = coded.folder.within(f"level-{number}")
        each = chunks.each // FANOUT
        errors = _merge(crew, folder, header, each, read)
        merged = Merged(folder, head, header.count, each * header.block_size)
        job = Job(folder, merged, merged.spans(size), config)
        looked = look(crew, job, calibrates=number == 1)
        if number == 1:
            config = config_of_levels(looked.config)
        may_have_far = Feature.FAR in header.features
        lattice = choose_lattice(crew, job, looked._replace(config=config), may_have_far)
        own = Chunks(header.having(Feature.FAR, lattice.grid.has_far), chunks.each)
        task = partial(_quantise, merged, lattice, own)
        crew.do_all(folder, "quantise", task, own.number)
        level = code_blocks(crew, Quantised(folder, own, lattice), StageTimes())
        paths.append(folder.path / "level.egs")
        write_blocks(paths[-1], level, [errors_section(errors)])
        read = partial(_kept, merged, errors, header.block_size)
    return paths


def _decoded(path: Path, first: int, stop: int) -> Level:
    """Blocks decoded from the file of the finest level."""
    with opened_slabs(path, Part(), among=range(first, stop)) as slabs:
        scene = join_scenes(list(slabs.scenes()))
    return Level(replace(scene, extra={}, has_normals=False), np.zeros(stop - first, np.float32))


def _kept(
    merged: Merged, errors: NDArray[np.float32], block_size: int, first: int, stop: int
) -> Level:
    """Blocks of a level that has been made."""
    end = min(stop * block_size, merged.count)
    return Level(merged.between(first * block_size, end), errors[first:stop])


def _merge(
    crew: Crew, folder: Folder, header: Header, each: int, read: _Read
) -> NDArray[np.float32]:
    """Make a level from the finer one, `each` blocks at a time; return the errors of its blocks."""
    number = -(-header.block_count // each)
    crew.do_all(folder, "merge", partial(_merge_some, folder, header, each, read), number)
    return np.concatenate([folder.load(f"merge-{k}")["errors"] for k in range(number)])


def _merge_some(folder: Folder, header: Header, each: int, read: _Read, number: int) -> None:
    first, stop = number * each, min((number + 1) * each, header.block_count)
    below = read(FANOUT * first, FANOUT * stop)
    made = coarser(below, header.block_size, header.antialiased)
    folder.save_mapped(f"rows-{number}", to_rows(planes_of(made.scene)))
    folder.save(f"merge-{number}", {"errors": made.errors})


def _quantise(merged: Merged, lattice: Lattice, chunks: Chunks, number: int) -> None:
    """Quantise a chunk without rearranging its blocks."""
    scene = merged.between(*chunks.ranks[number : number + 2])
    codes = grid_codes(scene.positions, lattice.grid)
    size = chunks.header.block_size
    order = order_within(codes, size)
    may_have_basis = Feature.LOCAL_BASIS in chunks.header.features
    blocks = quantise(scene.take(order), codes[order], lattice, size, None, may_have_basis)
    save_quantised(merged.folder, number, blocks, chunks.coefficients)
