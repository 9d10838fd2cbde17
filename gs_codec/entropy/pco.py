"""Sequences of 32-bit integers coded by pcodec; the one place that knows it.

FORMAT.md, "Columns". Only pcodec's classic mode is used, without deltas or with consecutive ones:
then no stream can demand more memory than its values take.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pcodec import ChunkConfig, DeltaSpec, ModeSpec, PagingSpec
from pcodec.wrapped import FileCompressor, FileDecompressor

from gs_codec.errors import CorruptStream

_LEVEL = 10
_FORMAT = 4
_CONSECUTIVE = 1

#: Number of values that are coded both ways, to decide whether to code differences.
_SAMPLE = 8192
_DELTAS = (DeltaSpec.no_op(), DeltaSpec.try_consecutive(1))


def write_integers(values: NDArray[np.uint32]) -> bytes:
    """Code values ``(n,)``, n >= 1, or their differences, whichever is smaller."""
    middle = max(values.size - _SAMPLE, 0) // 2
    tries = [_write(values[middle : middle + _SAMPLE], delta) for delta in _DELTAS]
    smallest = tries.index(min(tries, key=len))
    return tries[smallest] if values.size <= _SAMPLE else _write(values, _DELTAS[smallest])


def _write(values: NDArray[np.uint32], delta: DeltaSpec) -> bytes:
    config = ChunkConfig(
        compression_level=_LEVEL,
        mode_spec=ModeSpec.classic(),
        delta_spec=delta,
        paging_spec=PagingSpec.exact_page_sizes([values.size]),
    )
    file = FileCompressor()
    chunk = file.chunk_compressor(np.ascontiguousarray(values), config)
    return file.write_header() + chunk.write_meta() + chunk.write_page(0)


def read_integers(data: memoryview, count: int, where: str) -> NDArray[np.uint32]:
    """The inverse of `write_integers` for `count` values, at least one.

    Raises
    ------
    CorruptStream
    """
    if len(data) < 3 or data[0] != _FORMAT or data[2] & 15 or data[2] >> 4 > _CONSECUTIVE:
        raise CorruptStream(f"{where}: not a pcodec stream of a kind that is used here")
    packed = bytes(data)
    values = np.empty(count, np.uint32)
    try:
        file, size = FileDecompressor.new(packed)
        chunk, used = file.chunk_decompressor(packed[size:], "u32")
        size += used
        progress, used = chunk.read_page_into(packed[size:], count, values)
    except RuntimeError as error:
        raise CorruptStream(f"{where}: {' '.join(str(error).split())}") from None
    if progress.n_processed != count or not progress.finished or size + used != len(packed):
        raise CorruptStream(f"{where}: {len(packed)} bytes do not hold exactly {count} values")
    return values
