"""Constriction's ANS coder, under the same integer tables (optional extra ``peers``).

A reference for sizes and times; streams are never written with it.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import MissingTool
from gs_codec.model.table import FrequencyTable


def is_available() -> bool:
    """Whether constriction is installed."""
    return importlib.util.find_spec("constriction") is not None


def _load():
    """Constriction's module of streams.

    Raises
    ------
    MissingTool
        If it is not installed.
    """
    if not is_available():
        raise MissingTool("constriction is not installed: pip install 'gs-codec[peers]'")
    from constriction import stream

    return stream


def _models(tables: Sequence[FrequencyTable]) -> list:
    """The tables as its distributions, whose 24 bits hold them.

    Symbols of frequency 0 get 2^-24, as it knows no others, at the cost of the rest.
    """
    categorical = _load().model.Categorical
    shares = [table.frequencies / (1 << table.precision) for table in tables]
    return [categorical(share.astype(np.float32), perfect=False) for share in shares]


def encode_symbols(
    symbols: NDArray[np.uint16], tables: Sequence[FrequencyTable]
) -> NDArray[np.uint32]:
    """Code channels ``(C, N)``, each under its table of two symbols or more, as one message."""
    coder = _load().stack.AnsCoder()
    for channel, model in zip(symbols[::-1], _models(tables)[::-1], strict=True):
        # Last in, first out.
        coder.encode_reverse(channel.astype(np.int32), model)
    return coder.get_compressed()


def decode_symbols(
    words: NDArray[np.uint32], count: int, tables: Sequence[FrequencyTable]
) -> NDArray[np.uint16]:
    """The inverse of `encode_symbols`."""
    coder = _load().stack.AnsCoder(words)
    symbols = np.zeros((len(tables), count), np.uint16)
    for channel, model in zip(symbols, _models(tables), strict=True):
        channel[:] = coder.decode(model, count)
    return symbols
