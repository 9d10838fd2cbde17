"""All blocks of a scene or level: coded in chunks, and assembled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import passes
from gs_codec.codecs.adaptive.encode import choose_models
from gs_codec.codecs.adaptive.lattice import Lattice
from gs_codec.codecs.adaptive.section import write_lattice
from gs_codec.distributed.chunks import coded_bytes, coded_table, save_coded
from gs_codec.distributed.folder import Folder
from gs_codec.distributed.tasks import Crew
from gs_codec.egs.egs_file import Listed, Section, SectionId, file_head, in_file_order, padded_parts
from gs_codec.egs.header import FANOUT, Feature, Header
from gs_codec.egs.index import index_section
from gs_codec.report import ChannelCost, StageTimes
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.scene import SH_COEFFICIENTS


@dataclass(frozen=True)
class Chunks:
    """Blocks of a file in chunks of `each`, which are also whole blocks of the next level."""

    header: Header
    each: int

    @classmethod
    def of(cls, header: Header, size: int) -> Chunks:
        """Chunks of about `size` Gaussians."""
        return cls(header, max(size // (FANOUT * header.block_size), 1) * FANOUT)

    @property
    def coefficients(self) -> int:
        """Number of SH-AC coefficients per colour."""
        return SH_COEFFICIENTS[self.header.sh_degree]

    @property
    def number(self) -> int:
        """Number of chunks."""
        return -(-self.header.block_count // self.each)

    @property
    def ranks(self) -> list[int]:
        """Index of the first Gaussian of each chunk, and the end of the last."""
        step = self.each * self.header.block_size
        return [*range(0, self.header.count, step), self.header.count]


class Quantised(NamedTuple):
    """Quantised chunks in a folder, from `save_quantised`."""

    folder: Folder
    chunks: Chunks
    lattice: Lattice


@dataclass(frozen=True)
class CodedBlocks:
    """The parts of a file other than its coded chunks, which are in the folder.

    Attributes
    ----------
    folder : Folder
    chunks : Chunks
    sections : list of Section
        Sections of the whole scene.
    costs : list of ChannelCost
        Result of `choose_models`.
    clamped : int
        Number of values clamped to the lattice.
    """

    folder: Folder
    chunks: Chunks
    sections: list[Section]
    costs: list[ChannelCost]
    clamped: int


def code_blocks(crew: Crew, quantised: Quantised, times: StageTimes) -> CodedBlocks:
    """Code all chunks."""
    folder, chunks, lattice = quantised
    with times.stage("model"):
        extents, clamped, has_basis, counted = _counted(folder, chunks)
        chunks = replace(chunks, header=chunks.header.having(Feature.LOCAL_BASIS, has_basis))
        models, _, costs = choose_models(passes(chunks.coefficients), counted)
        sections = index_section(extents)
        described = write_lattice(lattice, models)
        sections.append(Section(SectionId.LATTICE, 0, described))
    with times.stage("code"):
        task = partial(_code, folder, described, chunks)
        crew.do_all(folder, "code", task, chunks.number)
    return CodedBlocks(folder, chunks, sections, costs, clamped)


def _counted(
    folder: Folder, chunks: Chunks
) -> tuple[list[NDArray[np.float32]], int, bool, list[NDArray[np.int64]]]:
    """Extents of all blocks, number of clamped values, whether any has bases, and token counts."""
    extents, counted = list[NDArray[np.float32]](), list[NDArray[np.int64]]()
    clamped, has_basis = 0, False
    for number in range(chunks.number):
        found = folder.load(f"quantise-{number}")
        extents += list(found.pop("extents"))
        clamped += int(found.pop("clamped"))
        has_basis |= bool(found.pop("has_basis"))
        counted = counted or [np.zeros_like(counts) for counts in found.values()]
        for total, counts in zip(counted, found.values(), strict=True):
            total += counts
    return extents, clamped, has_basis, counted


def _code(folder: Folder, described: bytes, chunks: Chunks, number: int) -> None:
    first = number * chunks.each
    save_coded(folder, number, first, described, chunks.coefficients)


def write_blocks(
    target: Path, coded: CodedBlocks, further: Sequence[Section] = ()
) -> list[tuple[int, int]]:
    """Write a file of coded blocks and sections `further`; return id and size of each section."""
    header, sections = coded.chunks.header, in_file_order([*coded.sections, *further])
    pieces = [(p, k) for p in range(1 + header.sh_degree) for k in range(coded.chunks.number)]
    table = [Listed.of(section) for section in sections]
    for place, number in pieces:
        table += coded_table(coded.folder, place, number)
    with atomic_writer(target) as file:
        file.write(file_head(header, table))
        for section in sections:
            file.writelines(padded_parts(section))
        for place, number in pieces:
            file.write(coded_bytes(coded.folder, place, number))
    return [(entry.id, entry.size) for entry in table]
