"""A local basis for SH-AC: the principal components of the colours of a run of Gaussians.

Training adds multiples of the SH basis functions in the directions of cameras, so the coefficients
of neighbouring Gaussians lie near a space of few dimensions. In a basis of that space, most
components are 0. FORMAT.md, section "Local basis".
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.tokens import ALPHABET, RAW_WIDTHS, token_of
from gs_codec.coding.exact_math import eigenvectors, exact_log, inverses
from gs_codec.coding.fields import BitReader, BitWriter
from gs_codec.coding.ycocg import red_green_blue
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS

#: Bits of an entry of a direction; an entry is a multiple of 1 / 16.
_ENTRY_BITS = 5

#: Largest magnitude of an entry, in 1 / 16.
_MOST = 15

#: Bits of the number of a factor.
_FACTOR_BITS = 4

#: Factors of the step sizes of components by their numbers, in 1 / 4: from 1 to 8.
FACTORS = np.array([(4 + (number & 3)) << (number >> 2) for number in range(13)])

#: Fraction bits of the matrix that turns components into coefficients.
MATRIX_BITS = 6

#: Approximate number of Gaussians of the longest runs that an encoder tries.
_LONGEST = 4096

#: Numbers of equal parts that it divides the longest runs into.
_DIVISIONS = (1, 2, 4)

#: Added to the squared length of a Gaussian's colours, in step sizes, which weighs it: so those
#: that are all noise weigh little.
_NOISE = 5.0

#: Gaussians that are turned at once, so that planes are read a few cache lines at a time.
_AT_ONCE = 64

#: Approximate number of Gaussians in the sample of a block that a basis is judged by.
_JUDGED = 2048


class Bases(NamedTuple):
    """Bases of the runs of a block.

    Attributes
    ----------
    entries : ndarray, shape (R, K, K), int64
        Directions, one a column, in 1 / 16.
    numbers : ndarray, shape (R, K), int64
        Numbers of the factors of the components' step sizes.
    """

    entries: NDArray[np.int64]
    numbers: NDArray[np.int64]

    @property
    def matrices(self) -> NDArray[np.float64]:
        """What turns components into coefficients, ``(R, K, K)``, in 1 / 64."""
        return np.float64(self.entries * FACTORS[self.numbers][:, None, :])

    @property
    def backwards(self) -> NDArray[np.float32]:
        """What turns coefficients into components, ``(R, K, K)``; not finite if nothing does."""
        return inverses(self.matrices / (1 << MATRIX_BITS)).astype(np.float32)

    def components(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Components, in their own step sizes, of SH-AC ``(3, K, n)``, in step sizes."""
        count = values.shape[2]
        return self.components_of(values, np.arange(count), count)

    def components_of(
        self, values: NDArray[np.float32], some: NDArray[np.integer], count: int
    ) -> NDArray[np.float32]:
        """The same of values ``(3, K, m)`` of some Gaussians ``(m,)``, ascending, of `count`."""
        found = np.empty_like(values)
        ends = np.searchsorted(some, bounds(len(self.entries), count))
        _turn(np.ascontiguousarray(values), ends, self.backwards, found)
        return found

    def fill(
        self,
        levels: NDArray[np.int32],
        ends: NDArray[np.int64],
        unit: int,
        shifts: NDArray[np.int64],
        limit: float,
        out: NDArray[np.float32],
        first: int = 0,
    ) -> bool:
        """Write R, G, B of SH-AC to ``out (3, M, N)``, from Gaussian `first` on.

        Parameters
        ----------
        levels : ndarray, shape (3, K, n), int32
            Of components of Y, Co, Cg.
        ends : ndarray, shape (R + 1,), int64
            The Gaussian that each run begins with, and the end of the last.
        unit : int
            Step size for a shift of 0, in 1 / 2**20.
        shifts : ndarray, shape (n,), int64
        limit : float
        out : ndarray, float32
            M may be less than K: then the first coefficients are written.
        first : int

        Returns
        -------
        bool
            Whether all values are below `limit`.
        """
        steps = np.ldexp(np.float64(unit), shifts - (20 + MATRIX_BITS))
        return _fill(levels, self.matrices, ends, steps, limit, out, first)


def bounds(runs: int, count: int) -> NDArray[np.int64]:
    """First Gaussian of each run of a block of `count` Gaussians, and the end, ``(runs + 1,)``."""
    return np.arange(runs + 1) * count // runs


def write_bases(bases: Bases) -> bytes:
    """Serialise the bases of a block."""
    writer = BitWriter()
    for values, bits in ((bases.entries + _MOST, _ENTRY_BITS), (bases.numbers, _FACTOR_BITS)):
        writer.add(values.ravel(), np.full(values.size, bits, np.uint8))
    return bytes([len(bases.entries)]) + writer.finish()


def _section_size(runs: int, coefficients: int) -> int:
    """Bytes of the section with the bases of a block."""
    bits = runs * coefficients * (_ENTRY_BITS * coefficients + _FACTOR_BITS)
    return 1 + (bits + 7) // 8


def read_bases(file: EgsFile, block: int) -> Bases | None:
    """Bases of the runs of a block; None if its levels are those of coefficients.

    Raises
    ------
    CorruptStream
    """
    data = file.sections.get((SectionId.BASIS, block))
    if data is None:
        return None
    (start, stop), where = file.header.block_range(block), f"section 'basis' of block {block}"
    count, coefficients = stop - start, SH_COEFFICIENTS[file.header.sh_degree]
    runs = data[0] if len(data) else 0
    if not 1 <= runs <= count:
        raise CorruptStream(f"{where}: {counted(runs, 'run')}, expected 1-{min(count, 255)}")
    if len(data) != (expected := _section_size(runs, coefficients)):
        raise CorruptStream(f"{where}: {counted(len(data), 'byte')}, expected {expected:,}")
    reader = BitReader(data[1:], where)
    entries = reader.fields(np.full(runs * coefficients * coefficients, _ENTRY_BITS)) - _MOST
    numbers = reader.fields(np.full(runs * coefficients, _FACTOR_BITS))
    reader.close()
    if entries.max() > _MOST or numbers.max() >= len(FACTORS):
        raise CorruptStream(f"{where}: an entry or a factor out of range")
    return Bases(
        entries.reshape(runs, coefficients, coefficients), numbers.reshape(runs, coefficients)
    )


def choose_bases(values: NDArray[np.float32]) -> Bases | None:
    """Bases for SH-AC ``(3, K, n)``, in step sizes; None where they would not save bits.

    Candidates differ in the length of runs. They are judged by the entropy of levels of a sample at
    equal step sizes, before the directions are rounded: so a basis cannot win by coarser steps.
    """
    count = values.shape[2]
    best, most = None, 0.0
    longest = max(round(count / _LONGEST), 1)
    covariances = _covariances(values, longest * _DIVISIONS[-1])
    for runs in (longest * division for division in _DIVISIONS):
        if runs > count:
            break
        whole = covariances.reshape(runs, -1, *covariances.shape[1:]).sum(axis=1)
        energies, directions = _principal_components(whole)
        bases = _rounded(energies, directions)
        # The same sample for both, which depends on the runs.
        saved = _bits(values, np.broadcast_to(np.eye(values.shape[1]), directions.shape))
        saved -= _bits(values, directions) + 8 * _section_size(runs, values.shape[1])
        if saved > most and np.isfinite(bases.backwards).all():
            best, most = bases, saved
    return best


def _covariances(values: NDArray[np.float32], runs: int) -> NDArray[np.float64]:
    """Weighted covariances ``(R, K, K)`` of the colours of runs."""
    found = np.zeros((runs, values.shape[1], values.shape[1]))
    _add_covariances(values, bounds(runs, values.shape[2]), found)
    return found


def _principal_components(
    covariances: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Energies ``(R, K)`` and directions, one a row, ``(R, K, K)`` of runs, the largest first."""
    energies, directions = eigenvectors(covariances)
    order = np.argsort(-energies, axis=1, kind="stable")
    return (
        np.take_along_axis(energies, order, axis=1),
        np.take_along_axis(directions, order[..., None], axis=1),
    )


def _rounded(energies: NDArray[np.float64], directions: NDArray[np.float64]) -> Bases:
    """Bases from `_principal_components`, as they are coded."""
    largest = np.abs(directions).argmax(axis=2)[..., None]
    signs = np.sign(np.take_along_axis(directions, largest, axis=2))
    entries = np.rint(16 * signs * directions).clip(-_MOST, _MOST).astype(np.int64)
    # Amplitudes to the power of -3/8, by roots, which are the same on every machine.
    dimmer = energies[:, :1] / np.maximum(energies, 1e-12)
    root = np.sqrt(np.sqrt(np.sqrt(dimmer)))
    wanted = 4 * root * np.sqrt(root)
    numbers = np.abs(FACTORS - wanted[..., None]).argmin(axis=2)
    return Bases(np.ascontiguousarray(entries.transpose(0, 2, 1)), numbers)


def _bits(values: NDArray[np.float32], matrices: NDArray[np.floating]) -> float:
    """Approximate bits of values, turned by the matrix ``(K, K)`` of their run."""
    counts = np.zeros((values.shape[1], ALPHABET), np.int64)
    count = values.shape[2]
    ends, stride = bounds(len(matrices), count), max(count // _JUDGED, 1) * _AT_ONCE
    turning = np.ascontiguousarray(matrices, np.float32)
    sampled = _count_levels(values, ends, stride, turning, counts)
    return _entropy(counts) * count / max(sampled, 1)


@kernel
def _add_covariances(values, ends, covariances):
    coefficients = values.shape[1]
    row = np.empty(coefficients)
    for run in range(len(covariances)):
        covariance = covariances[run]
        for i in range(ends[run], ends[run + 1]):
            length = _NOISE
            for channel in range(3):
                for k in range(coefficients):
                    length += np.float64(values[channel, k, i]) * np.float64(values[channel, k, i])
            for channel in range(3):
                for k in range(coefficients):
                    row[k] = values[channel, k, i]
                for k in range(coefficients):
                    weighted = row[k] / length
                    for j in range(k + 1):
                        covariance[k, j] += weighted * row[j]
        for k in range(coefficients):
            for j in range(k):
                covariance[j, k] = covariance[k, j]


@inlined
def _add_turned(planes, begin, size, matrix, total):
    """Add a matrix times values or levels ``planes (K, n)`` of a few Gaussians to their total."""
    for j in range(planes.shape[0]):
        plane = planes[j, begin : begin + size]
        # Half of the components are 0 in all of the few Gaussians.
        some = False
        for i in range(size):
            some |= plane[i] != 0
        if not some:
            continue
        for k in range(len(total)):
            factor = matrix[k, j]
            for i in range(size):
                total[k, i] += factor * plane[i]


@kernel
def _turn(values, ends, matrices, turned):
    total = np.empty((values.shape[1], _AT_ONCE), np.float32)
    for run in range(len(matrices)):
        for begin in range(ends[run], ends[run + 1], _AT_ONCE):
            size = min(_AT_ONCE, ends[run + 1] - begin)
            for channel in range(3):
                total[:] = 0.0
                _add_turned(values[channel], begin, size, matrices[run], total)
                for k in range(len(total)):
                    for i in range(size):
                        turned[channel, k, begin + i] = total[k, i]


@kernel
def _count_levels(values, ends, stride, matrices, counts):
    """Count tokens ``(K, tokens)`` of components of a sample; return its size.

    The sample has the first few Gaussians of each `stride`.
    """
    coefficients, sampled = values.shape[1], 0
    total = np.empty((coefficients, _AT_ONCE), np.float32)
    for run in range(len(matrices)):
        matrix = matrices[run]
        for begin in range(ends[run], ends[run + 1], stride):
            size = min(_AT_ONCE, ends[run + 1] - begin)
            sampled += size
            for channel in range(3):
                total[:] = 0.0
                _add_turned(values[channel], begin, size, matrix, total)
                for k in range(coefficients):
                    for i in range(size):
                        level = np.int64(np.floor(total[k, i] + np.float32(0.5)))
                        counts[k, token_of(level)] += 1
    return sampled


@kernel
def _entropy(counts):
    """Bits of tokens, by the frequencies of their row, with the raw bits that follow them."""
    bits = 0.0
    for k in range(len(counts)):
        total = np.int64(0)
        for token in range(counts.shape[1]):
            total += counts[k, token]
        for token in range(counts.shape[1]):
            count = np.float64(counts[k, token])
            if count > 0.0:
                own = (exact_log(np.float64(total)) - exact_log(count)) / exact_log(2.0)
                bits += count * (own + RAW_WIDTHS[token])
    return bits


@kernel
def _fill(levels, matrices, ends, steps, limit, out, first):
    rows, beyond = out.shape[1], 0
    total = np.empty((3, rows, _AT_ONCE))
    for run in range(len(matrices)):
        for begin in range(ends[run], ends[run + 1], _AT_ONCE):
            size = min(_AT_ONCE, ends[run + 1] - begin)
            total[:] = 0.0
            for channel in range(3):
                _add_turned(levels[channel], begin, size, matrices[run], total[channel])
            place = first + begin
            for k in range(rows):
                luma, orange, other = total[0, k], total[1, k], total[2, k]
                red, green, blue = (
                    out[0, k, place : place + size],
                    out[1, k, place : place + size],
                    out[2, k, place : place + size],
                )
                for i in range(size):
                    step = steps[begin + i]
                    y, o, g = luma[i] * step, orange[i] * step, other[i] * step
                    beyond |= np.int64(abs(y) >= limit) | np.int64(abs(o) >= limit)
                    beyond |= np.int64(abs(g) >= limit)
                    red[i], green[i], blue[i] = red_green_blue(y, o, g)
    return beyond == 0
