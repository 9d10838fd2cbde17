"""Memory needed for coding under a limit, when arrays of whole scenes are on disk."""

from __future__ import annotations

from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS, Config
from gs_codec.egs.egs_file import EgsFile
from gs_codec.egs.header import Feature
from gs_codec.errors import InvalidInput
from gs_codec.format_table import SOG
from gs_codec.runtime.arrays import current
from gs_codec.runtime.threads import available_threads
from gs_codec.runtime.wording import counted
from gs_codec.scene import float_bytes

#: Bytes of Python, packages and compiled kernels. Like the next two, measured and rounded up.
_FIXED = 280_000_000

#: Bytes of torch.
_TORCH = 300_000_000

#: Bytes per thread.
_THREAD = 45_000_000

#: Bytes per Gaussian for sorting a scene with profiles `l`, `m` and `s`.
_ADAPTIVE = 40

#: Bytes per Gaussian for sorting a scene with other profiles.
_OTHERS = 55

#: Bytes per Gaussian for the palette of a `.sog`, whose search maps all SH at once.
_PALETTE = 200


def least_memory(count: int, config: Config, most: int | None = None) -> int:
    """Lowest memory limit, in bytes, for encoding a scene of `count` Gaussians.

    `most` is the maximum number of Gaussians of a file, if there are several.
    """
    adaptive = config.profile in ADAPTIVE_PROFILES
    growing = count * (_ADAPTIVE if adaptive else _OTHERS)
    if not adaptive and config.profile != LOSSLESS:  # decoded to measure the loss in views
        growing = max(growing, config.block_size * _decoding(3))
    if config.format == SOG.name:
        growing = max(growing, min(count, most or count) * _PALETTE)
    return _working(config.coder == "torchac") + growing


def check_encoding(count: int, config: Config, most: int | None = None) -> None:
    """Check that the memory limit is high enough to encode `count` Gaussians.

    `most` is as in `least_memory`. Raises InvalidInput.
    """
    what = f"{counted(count, 'Gaussian')} by profile {config.profile}"
    _check(least_memory(count, config, most), what)


def slab_within(file: EgsFile, degree: int, wanted: int) -> int:
    """Number of Gaussians to decode at once: `wanted`, or fewer if the memory limit is lower.

    Raises InvalidInput if one block does not fit.
    """
    each = _decoding(degree)
    working = _working(Feature.TORCHAC in file.header.features)
    _check(working + file.header.block_size * each, "decoding")
    limit = current().limit
    return wanted if limit is None else min(wanted, (limit - working) // each)


def _decoding(degree: int) -> int:
    """Bytes per Gaussian of a slab, and of a copy of it that is being written."""
    return 2 * float_bytes(1, degree)


def _working(torchac: bool) -> int:
    return _FIXED + torchac * _TORCH + available_threads() * _THREAD


def _check(least: int, what: str) -> None:
    limit = current().limit
    if limit is not None and limit < least:
        raise InvalidInput(
            f"max-memory: {counted(limit, 'byte')}, expected at least {least:,} for {what}"
        )
