"""The paper's coder: torchac, under the same integer tables (optional extra ``paper``).

A reference for sizes and times; streams are never written with it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
import sysconfig
import warnings
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.errors import MissingTool, one_line

_CHUNK = 1 << 16


def is_available() -> bool:
    """Whether torch and torchac are installed."""
    return all(importlib.util.find_spec(name) for name in ("torch", "torchac"))


def _load():
    """Import torch and torchac, which compiles itself the first time and reports it on stdout.

    Raises
    ------
    MissingTool
        If they are not installed, or torchac cannot be compiled.
    """
    if not is_available():
        raise MissingTool("torchac is not installed: pip install 'gs-codec[paper]'")
    import torch

    try:
        with _output_on_stderr(), _own_programs_first(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a docstring, where it was not compiled before
            import torchac
    except (RuntimeError, OSError) as error:
        reason = one_line(error)[:200]
        raise MissingTool(f"torchac cannot be compiled here: {reason}") from error
    return torch, torchac


@contextlib.contextmanager
def _own_programs_first() -> Iterator[None]:
    """Let torch find the ninja of this environment even when the shell has not activated it."""
    path = os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), path])
    try:
        yield
    finally:
        os.environ["PATH"] = path


@contextlib.contextmanager
def _output_on_stderr() -> Iterator[None]:
    """Send what this process and its compilers write to stdout to stderr."""
    sys.stdout.flush()
    saved = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)


def _cdf(table: FrequencyTable, count: int):
    """The table as the int16 CDF torchac wants, one row for each symbol to code."""
    torch, _ = _load()
    starts = np.append(table.starts[_present(table)], 1 << table.precision).astype(np.int64)
    wrapped = (starts << (16 - table.precision)).astype(np.uint16).view(np.int16)
    return torch.from_numpy(wrapped).expand(count, -1)


def _present(table: FrequencyTable) -> NDArray[np.intp]:
    """Symbols that can occur; torchac fails if two values of a CDF are equal."""
    return np.flatnonzero(table.frequencies)


def encode_symbols(symbols: NDArray[np.uint16], table: FrequencyTable) -> list[bytes]:
    """Code one channel ``(N,)``, in chunks that bound the size of torchac's CDF tensor."""
    torch, torchac = _load()
    chunks = []
    ranks = np.searchsorted(_present(table), symbols).astype(np.int16)
    for start in range(0, symbols.size, _CHUNK):
        part = torch.from_numpy(ranks[start : start + _CHUNK])
        cdf = _cdf(table, len(part)).contiguous()
        chunks.append(torchac.encode_int16_normalized_cdf(cdf, part))
    return chunks


def decode_symbols(chunks: list[bytes], count: int, table: FrequencyTable) -> NDArray[np.uint16]:
    """The inverse of `encode_symbols`."""
    _, torchac = _load()
    parts = [np.zeros(0, np.int16)]
    for start, chunk in zip(range(0, count, _CHUNK), chunks, strict=True):
        cdf = _cdf(table, min(_CHUNK, count - start)).contiguous()
        parts.append(torchac.decode_int16_normalized_cdf(cdf, chunk).numpy())
    return _present(table)[np.concatenate(parts)].astype(np.uint16)
