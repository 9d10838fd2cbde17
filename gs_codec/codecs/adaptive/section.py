"""The `lattice` section: units, rules and tables of a scene. FORMAT.md, section "Lattices"."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import MAX_CLASSES, MAX_TABLES, Pass, passes
from gs_codec.codecs.adaptive.lattice import (
    FRACTION_BITS,
    LARGEST,
    MAX_SHIFT,
    MOST_AXIS_BITS,
    MOST_FAR_BITS,
    Lattice,
    PositionGrid,
    StepRule,
)
from gs_codec.codecs.adaptive.rotation import TURN_RULES
from gs_codec.codecs.adaptive.step_sizes import MAX_SLOPE, SHAPE_RULES
from gs_codec.codecs.adaptive.tokens import ALPHABET
from gs_codec.coding.binary import code_bit, decode_binary, encode_binary, new_contexts
from gs_codec.coding.context_rans import PRECISION
from gs_codec.coding.fields import ByteReader
from gs_codec.coding.frequency_table import FrequencyTable, SentModel, decode_tables, encode_tables
from gs_codec.config import SH_STREAMS
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.egs.header import Feature
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS


@kernel
def _walk(marks, state, data, contexts):
    """Code the marks of a list; the context of each is the one before."""
    before = 0
    for i in range(len(marks)):
        before = 1 if code_bit(state, data, contexts, before, marks[i] != 0) else 0
        marks[i] = before


def encode_marks(lists: Sequence[NDArray[np.int64]]) -> bytes:
    """Code lists of zeros and ones."""

    def model(state: NDArray, data: NDArray) -> None:
        contexts = new_contexts(2)
        for marks in lists:
            _walk(marks.copy(), state, data, contexts)

    return encode_binary(model, 0)


def decode_marks(data: memoryview, sizes: Sequence[int], where: str) -> list[NDArray[np.int64]]:
    """Invert `encode_marks`, for lists of these sizes.

    Raises CorruptStream if the size of the stream does not match the lists.
    """
    lists = [np.zeros(size, np.int64) for size in sizes]

    def model(state: NDArray, stream: NDArray) -> None:
        contexts = new_contexts(2)
        for marks in lists:
            _walk(marks, state, stream, contexts)

    decode_binary(model, data, where)
    return lists


_WHERE = "section 'lattice'"

#: Mantissa bits of the weights of a transmitted table.
MANTISSA = 3

#: Step sizes are below 2 to this power, in units of 1 / 2**20.
_STEP_BITS = 31

#: Bytes of the centre of a far Gaussian.
FAR_BYTES = 12

#: Struct layout of a rule: intercept; coefficients of opacity and of three scales; limit.
_RULE = "5iB"

#: The rules of a scene, in the order of the section.
RULES = ("opacity", "scale_0", "scale_1", "scale_2", *TURN_RULES, "position", "colour")

#: The units of a scene, in the order of the section.
UNITS = ("opacity", "scaling", "rotation", "sh-dc", *SH_STREAMS)


@dataclass(frozen=True)
class PassModels:
    """Tables of a scene's passes.

    ``listed[name]`` has the table number of each context of a list; ``weights`` has the weights of
    each table.
    """

    listed: dict[str, NDArray[np.int64]]
    weights: list[NDArray[np.int64]]

    def rows(self, item: Pass) -> NDArray[np.uint16]:
        """Table number of each context of a pass."""
        return np.concatenate([self.listed[own.name] for own in item.lists]).astype(np.uint16)

    def tables(self) -> list[FrequencyTable]:
        """Frequency tables of precision `PRECISION`."""
        return [SentModel(w, MANTISSA, PRECISION).frequencies(len(w)) for w in self.weights]


def write_lattice(lattice: Lattice, models: PassModels) -> bytes:
    """Serialise the lattices and tables of a scene."""
    grid = lattice.grid
    out = bytearray(struct.pack("<4f3B", *grid.origin, grid.step, *grid.bits))
    out += struct.pack("<2B2i", *lattice.classes, *lattice.centres)
    out += struct.pack(f"<{len(UNITS)}I", *(lattice.units[name] for name in UNITS))
    for name in RULES:
        rule = lattice.rules[name]
        out += struct.pack("<" + _RULE, *rule.numbers, rule.limit)
    # Neighbouring contexts may share a table: a mark of 1 starts the next table.
    marks = encode_marks([np.diff(rows).astype(np.int64) for rows in models.listed.values()])
    out += struct.pack("<2H", len(marks), len(models.weights)) + marks
    out += struct.pack(f"<{len(models.weights)}B", *(len(w) for w in models.weights))
    return bytes(out) + encode_tables(models.weights, [MANTISSA] * len(models.weights))


def lattice_of(file: EgsFile) -> tuple[Lattice, PassModels]:
    """Lattices and tables of a file; see `read_lattice`."""
    coefficients = SH_COEFFICIENTS[file.header.sh_degree]
    features = file.header.features
    return file.parsed(SectionId.LATTICE, lambda data: read_lattice(data, coefficients, features))


def read_lattice(
    data: memoryview, coefficients: int, features: Feature = Feature.NONE
) -> tuple[Lattice, PassModels]:
    """Invert `write_lattice`. Raises TruncatedStream or CorruptStream."""
    has_far = Feature.FAR in features
    reader = ByteReader(data, _WHERE)
    *origin, step = reader.unpack("4f")
    bits = reader.unpack("3B")
    grid = PositionGrid((origin[0], origin[1], origin[2]), step, bits, has_far)
    sound = all(map(math.isfinite, origin)) and 0 < step < math.inf
    if not sound or max(bits) > MOST_AXIS_BITS or (has_far and grid.total_bits > MOST_FAR_BITS):
        raise CorruptStream(f"{_WHERE}: bits {bits} of the grid, step {step}")
    classes = reader.unpack("2B")
    if not all(1 <= number <= MAX_CLASSES for number in classes):
        raise CorruptStream(f"{_WHERE}: {classes} classes, expected 1-{MAX_CLASSES}")
    centres = reader.unpack("2i")
    if max(map(abs, centres)) > LARGEST * (1 << FRACTION_BITS):
        raise CorruptStream(f"{_WHERE}: a centre out of range")
    units = dict(zip(UNITS, reader.unpack(f"{len(UNITS)}I"), strict=True))
    rules = {name: _read_rule(reader) for name in RULES}
    if Feature.LOCAL_BASIS in features and len({units[stream] for stream in SH_STREAMS}) > 1:
        raise CorruptStream(f"{_WHERE}: units of SH-AC differ, with a local basis")
    lattice = Lattice(grid, classes, centres, units, rules)
    _check_steps(lattice)
    return lattice, _read_models(reader, coefficients)


def _read_rule(reader: ByteReader) -> StepRule:
    intercept, opacity, *scales, limit = reader.unpack(_RULE)
    if max(map(abs, (opacity, *scales))) > MAX_SLOPE:
        raise CorruptStream(f"{_WHERE}: a rule's factor is beyond {MAX_SLOPE}")
    return StepRule(intercept, opacity, (scales[0], scales[1], scales[2]), limit)


def _check_steps(lattice: Lattice) -> None:
    """Reject units and limits that allow step sizes to overflow."""
    limits = {name: rule.limit for name, rule in lattice.rules.items()}
    for name, unit in lattice.units.items():
        limit = max(limits[rule] for rule in SHAPE_RULES.get(name, ("colour",)))
        if unit == 0 or unit.bit_length() + limit > _STEP_BITS:
            raise CorruptStream(f"{_WHERE}: unit {unit} of '{name}' with shifts to {limit}")
    if limits["position"] > 3 * MAX_SHIFT:
        raise CorruptStream(f"{_WHERE}: positions shifted by {limits['position']}")


def _read_models(reader: ByteReader, coefficients: int) -> PassModels:
    lists = [item for one in passes(coefficients) for item in one.lists]
    size, number = reader.unpack("2H")
    sizes = [item.contexts - 1 for item in lists]
    marks = decode_marks(reader.take(size), sizes, f"{_WHERE}: marks")
    listed, total = {}, 0
    for item, begins in zip(lists, marks, strict=True):
        listed[item.name] = total + np.cumsum([0, *begins])
        total = int(listed[item.name][-1]) + 1
        if begins.sum() >= MAX_TABLES:
            raise CorruptStream(f"{_WHERE}: more than {MAX_TABLES} tables of '{item.name}'")
    if number != total:
        raise CorruptStream(f"{_WHERE}: {counted(number, 'table')}, expected {total:,}")
    alphabets = list(reader.take(number))
    if not all(1 <= size <= ALPHABET for size in alphabets):
        raise CorruptStream(f"{_WHERE}: an alphabet out of range")
    weights = decode_tables(reader.rest(), alphabets, [MANTISSA] * number, _WHERE)
    return PassModels(listed, weights)


def write_far(positions: NDArray[np.float32]) -> bytes:
    """Serialise the centres ``(3, f)`` of the far Gaussians of a block."""
    return positions.T.astype("<f4").tobytes()


def read_far(file: EgsFile, block: int) -> NDArray[np.float32]:
    """Centres ``(3, f)`` of the far Gaussians of a block, which come last in it.

    Raises CorruptStream.
    """
    data = file.sections.get((SectionId.FAR, block))
    if data is None:
        return np.empty((3, 0), np.float32)
    start, stop = file.header.block_range(block)
    where, most = f"section 'far' of block {block}", FAR_BYTES * (stop - start)
    if len(data) % FAR_BYTES or not 0 < len(data) <= most:
        raise CorruptStream(
            f"{where}: {counted(len(data), 'byte')}, expected a multiple of {FAR_BYTES} "
            f"up to {most:,}"
        )
    found = np.frombuffer(data, "<f4").astype(np.float32).reshape(-1, 3).T
    if not np.isfinite(found).all():
        raise CorruptStream(f"{where}: a centre is not finite")
    return found


def far_count(file: EgsFile) -> int:
    """Number of far Gaussians of a file, from the sizes of its sections."""
    return sum(
        entry.size // FAR_BYTES
        for (section, _), entry in file.table.items()
        if section == SectionId.FAR
    )
