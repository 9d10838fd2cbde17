"""The paper's entropy coder, the package torchac. FORMAT.md, section "Torchac".

It uses the tables of our models, and codes one channel of a block at a time.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import importlib.util
import os
import struct
import sys
import sysconfig
import warnings
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from crc32c import crc32c
from numpy.typing import NDArray

from gs_codec.coding.fields import ByteReader
from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.config import Config
from gs_codec.egs.egs_file import EgsFile, Section, SectionId
from gs_codec.egs.header import Feature
from gs_codec.egs.sections import read_line, write_line
from gs_codec.errors import CorruptStream, MissingTool, one_line
from gs_codec.runtime.atomic import alone
from gs_codec.runtime.optional import check_installed, needed

#: Symbols coded together, times the alphabet: torchac needs a CDF row for each symbol.
_VALUES = 1 << 22


def require_torchac() -> None:
    """Import torch and torchac; the first import compiles torchac.

    Raises MissingTool if they are not installed, or torchac cannot be compiled.
    """
    _load()


@cache
def _load():
    """Import torch and torchac."""
    check_installed("torchac", "coder 'torchac'")
    torch = needed("torch", "coder 'torchac'")
    try:
        with _without_output(), _compiling(torch.__version__), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a docstring, when first compiled
            import torchac
    except (RuntimeError, OSError) as error:
        reason = one_line(error)[:200]
        raise MissingTool(f"torchac cannot be compiled here: {reason}") from error
    return torch, torchac


@contextlib.contextmanager
def _compiling(torch_version: str) -> Iterator[None]:
    """Let torch compile with this environment's ninja, activated or not, in our own folder.

    Only one process compiles at a time, and a killed process blocks no other: torch's own lock file
    would remain, and later processes would wait for it for ever.
    """
    from torch.utils.cpp_extension import get_default_build_root

    root = os.environ.get("TORCH_EXTENSIONS_DIR") or get_default_build_root()
    folder = Path(root, f"gs_codec-{sys.implementation.cache_tag}-torch-{torch_version}")
    folder.mkdir(parents=True, exist_ok=True)
    path = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    changed = {"PATH": path, "TORCH_EXTENSIONS_DIR": str(folder)}
    before = {name: os.environ.get(name) for name in changed}
    os.environ |= changed
    try:
        with alone(folder):
            (folder / "torchac_backend" / "lock").unlink(missing_ok=True)
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _without_output() -> Iterator[None]:
    """Discard what this process and its compilers write to stdout: torchac prints its build."""
    sys.stdout.flush()
    saved = os.dup(1)
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        try:
            with contextlib.redirect_stdout(nowhere):
                yield
        finally:
            os.dup2(saved, 1)
            os.close(saved)


def is_torchac(file: EgsFile) -> bool:
    """Whether torchac codes the attributes of a file."""
    return Feature.TORCHAC in file.header.features


def require_coder(file: EgsFile) -> None:
    """Check that the coder of a file's attributes is installed.

    Raises CorruptStream or MissingTool.
    """
    if is_torchac(file):
        read_line(file, SectionId.CODER)
        require_torchac()


def coder_section(config: Config) -> list[Section]:
    """The section `coder`, if torchac codes the attributes."""
    if config.coder == "rans":
        return []
    version = importlib.metadata.version("torchac")
    return [Section(SectionId.CODER, 0, write_line(f"torchac {version}"))]


def encode_stream(symbols: Sequence[NDArray[np.uint16]], tables: Sequence[FrequencyTable]) -> bytes:
    """Code a stream's channels of a block, ``(n,)`` each."""
    parts = [struct.pack("<I", _checksum(symbols))]
    for row, table in zip(symbols, tables, strict=True):
        for data in _encode(row, table):
            parts += [struct.pack("<I", len(data)), data]
    return b"".join(parts)


def decode_stream(
    data: memoryview, count: int, tables: Sequence[FrequencyTable], where: str
) -> list[NDArray[np.uint16]]:
    """The inverse of `encode_stream` for `count` symbols of each channel.

    Raises TruncatedStream or CorruptStream.
    """
    reader = ByteReader(data, where)
    expected = reader.unpack("I")[0]
    channels = [_decode(reader, count, table) for table in tables]
    if _checksum(channels) != expected or len(reader.rest()):
        raise CorruptStream(f"{where}: torchac decodes other symbols than were encoded")
    return channels


def _checksum(symbols: Sequence[NDArray[np.uint16]]) -> int:
    """CRC-32C of symbols, channel by channel."""
    checksum = 0
    for row in symbols:
        checksum = crc32c(row.astype("<u2").tobytes(), checksum)
    return checksum


def _encode(symbols: NDArray[np.uint16], table: FrequencyTable) -> Iterator[bytes]:
    torch, torchac = _load()
    ranks = np.searchsorted(_present(table), symbols).astype(np.int16)
    for start, stop in _runs(symbols.size, table):
        part = torch.from_numpy(ranks[start:stop])
        yield torchac.encode_int16_normalized_cdf(_cdf(table, stop - start), part)


def _decode(reader: ByteReader, count: int, table: FrequencyTable) -> NDArray[np.uint16]:
    _, torchac = _load()
    ranks = np.empty(count, np.int16)
    for start, stop in _runs(count, table):
        data = bytes(reader.take(reader.unpack("I")[0]))
        cdf = _cdf(table, stop - start)
        ranks[start:stop] = torchac.decode_int16_normalized_cdf(cdf, data).numpy()
    return _present(table)[ranks].astype(np.uint16)


def _runs(count: int, table: FrequencyTable) -> Iterator[tuple[int, int]]:
    """Bounds of runs of symbols."""
    size = _VALUES // table.frequencies.size
    return ((start, min(start + size, count)) for start in range(0, count, size))


def _cdf(table: FrequencyTable, count: int):
    """The table as an int16 CDF for torchac, with one row for each symbol to code."""
    torch, _ = _load()
    starts = np.append(table.starts[_present(table)], 1 << table.precision).astype(np.int64)
    wrapped = (starts << (16 - table.precision)).astype(np.uint16).view(np.int16)
    return torch.from_numpy(np.tile(wrapped, (count, 1)))  # copying with torch would start threads


def _present(table: FrequencyTable) -> NDArray[np.intp]:
    """Symbols that can occur; torchac fails if two values of a CDF are equal."""
    return np.flatnonzero(table.frequencies)
