"""How much memory coding takes within a limit, where arrays of whole scenes are on disk."""

from __future__ import annotations

from gs_codec.config import LATTICE_PROFILES, LOSSLESS, Config
from gs_codec.container.file import Header
from gs_codec.errors import InvalidInput
from gs_codec.scene import float_bytes
from gs_codec.storage import current
from gs_codec.workers import available_threads

#: Python, its packages and compiled kernels; what a thread works on. Measured, and rounded up.
_FIXED, _THREAD = 280_000_000, 45_000_000

#: Bytes for each Gaussian, to put a scene in order, of lattices, `paper` profiles, `lossless`.
_LATTICES, _CHANNELS, _EXACT = 40, 55, 55


def least_memory(count: int, config: Config) -> int:
    """Bytes with which a scene of so many Gaussians can be encoded."""
    each = _CHANNELS
    if config.profile in LATTICE_PROFILES:
        each = _LATTICES
    elif config.profile == LOSSLESS:
        each = _EXACT
    return _working() + count * each


def check_encoding(count: int, config: Config) -> None:
    """Refuse to encode so many Gaussians within a limit that is too low.

    Raises
    ------
    InvalidInput
    """
    _check(least_memory(count, config), f"{count:,} Gaussians by profile {config.profile}")


def slab_within(header: Header, degree: int, wanted: int) -> int:
    """How many Gaussians to decode at once, if as many as wanted do not fit.

    Raises
    ------
    InvalidInput
        If one block does not.
    """
    # While one slab is written, the next is not there yet, but what it is written from may be.
    each = 2 * float_bytes(1, degree)
    working = _working()
    _check(working + header.block_size * each, "decoding")
    limit = current().limit
    return wanted if limit is None else min(wanted, (limit - working) // each)


def _working() -> int:
    return _FIXED + available_threads() * _THREAD


def _check(least: int, what: str) -> None:
    limit = current().limit
    if limit is not None and limit < least:
        raise InvalidInput(f"max-memory: {limit:,} bytes, expected at least {least:,} for {what}")
