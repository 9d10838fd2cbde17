"""Chunks of consecutive blocks: quantised, then coded; intermediate results are in the folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged
from gs_codec.codecs.adaptive.blocks import Block, PassData, colour_block, shape_block
from gs_codec.codecs.adaptive.contexts import passes
from gs_codec.codecs.adaptive.encode import block_sections, count_tokens
from gs_codec.codecs.adaptive.lattice import Lattice
from gs_codec.codecs.adaptive.section import read_lattice
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.coding.context_rans import PassTables
from gs_codec.distributed.folder import Arrays, Folder
from gs_codec.egs.egs_file import Listed, Section, padded_parts, place_in_file
from gs_codec.scene import Scene

#: Arrays of a pass, by name.
_PASS = tuple(field.name for field in fields(PassData))

#: Parts of blocks that are bytes, by name.
_BYTES = ("tree", "low_bits", "far", "basis")


def quantise(
    scene: Scene,
    codes: NDArray[np.int64],
    lattice: Lattice,
    block_size: int,
    watched: Watched | None = None,
    may_have_basis: bool = True,
) -> list[Block]:
    """Quantise the Gaussians of a chunk, in stream order, camera-free."""
    order = np.arange(scene.count, dtype=np.uint32)
    classes = np.zeros((2, scene.count), np.uint8)
    if watched is not None:
        watched.settle(order)
    arranged = Arranged(scene, order, lattice, codes, classes, watched, may_have_basis)
    blocks = []
    for start in range(0, scene.count, block_size):
        shaped = shape_block(arranged, start, min(start + block_size, scene.count))
        blocks.append(colour_block(arranged, shaped, diffusing=True))
    return blocks


def save_quantised(folder: Folder, number: int, blocks: list[Block], coefficients: int) -> None:
    """Save the quantised blocks of a chunk."""
    counted = count_tokens(passes(coefficients), blocks)
    folder.save(f"blocks-{number}", _packed(blocks))
    extents = np.stack([block.extent for block in blocks])
    clamped = np.array(sum(block.clamped for block in blocks))
    has_basis = np.array(any(block.basis for block in blocks))
    counts = {f"count-{k}": counts for k, counts in enumerate(counted)}
    folder.save(
        f"quantise-{number}",
        {"extents": extents, "clamped": clamped, "has_basis": has_basis, **counts},
    )


def _packed(blocks: Sequence[Block]) -> Arrays:
    """The concatenated arrays of blocks, and the length of each."""
    columns: dict[str, list[NDArray[Any]]] = {
        name: [np.frombuffer(getattr(block, name), np.uint8) for block in blocks] for name in _BYTES
    }
    for k in range(len(blocks[0].passes)):
        for name in _PASS:
            columns[f"{k} {name}"] = [getattr(block.passes[k], name) for block in blocks]
    packed = {name: np.concatenate(column) for name, column in columns.items()}
    # No symbol's number or level has more than 31 bits; this saves a sixth of all bytes.
    packed |= {n: a.astype(np.int32) for n, a in packed.items() if a.dtype == np.int64}
    lengths = {f"{name} lengths": np.array([len(a) for a in c]) for name, c in columns.items()}
    return packed | lengths


def _unpacked(packed: Arrays, extents: NDArray[np.float32]) -> Iterator[Block]:
    """The inverse of `_packed`."""
    names = [name for name in packed if not name.endswith("lengths")]
    columns = {}
    for name in names:
        wide = packed[name].astype(np.int64) if packed[name].dtype == np.int32 else packed[name]
        columns[name] = np.split(wide, np.cumsum(packed[f"{name} lengths"])[:-1])
    number = (len(names) - len(_BYTES)) // len(_PASS)
    for k, extent in enumerate(extents):
        own = [PassData(*(columns[f"{p} {name}"][k] for name in _PASS)) for p in range(number)]
        sections = {name: columns[name][k].tobytes() for name in _BYTES}
        yield Block(**sections, extent=extent, passes=own, clamped=0)


def save_coded(
    folder: Folder, number: int, first_block: int, lattice_section: bytes, coefficients: int
) -> None:
    """Code the quantised blocks of a chunk, starting with block `first_block` of the file."""
    _, models = read_lattice(memoryview(lattice_section), coefficients)
    listed = passes(coefficients)
    tables, rows = PassTables.pack(models.tables()), [models.rows(item) for item in listed]
    (extents,) = folder.load(f"quantise-{number}", "extents").values()
    blocks = _unpacked(folder.load(f"blocks-{number}"), extents)
    placed: dict[int, list[Section]] = {}
    for block, data in enumerate(blocks, first_block):
        for section in block_sections(block, data, listed, rows, tables):
            placed.setdefault(place_in_file(section.id, block)[0], []).append(section)
    arrays = {}
    for place, sections in placed.items():
        content = b"".join(part for section in sections for part in padded_parts(section))
        arrays[f"{place}"] = np.frombuffer(content, np.uint8)
        arrays[f"{place} table"] = np.array([Listed.of(each) for each in sections], np.int64)
    folder.save(f"code-{number}", arrays)


def coded_table(folder: Folder, place: int, number: int) -> list[Listed]:
    """Section table entries of a chunk's sections at a place of the file."""
    (rows,) = folder.load(f"code-{number}", f"{place} table").values()
    return [Listed(*row) for row in rows.tolist()]


def coded_bytes(folder: Folder, place: int, number: int) -> memoryview:
    """The concatenated sections of a chunk at a place of the file."""
    (data,) = folder.load(f"code-{number}", f"{place}").values()
    return data.data
