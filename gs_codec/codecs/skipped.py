"""Sentences on what takes no bits in a file, derived from its header and tables."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from gs_codec.codecs.adaptive.contexts import ContextList, passes
from gs_codec.codecs.adaptive.lattice import Lattice
from gs_codec.codecs.adaptive.rotation import rules_of
from gs_codec.codecs.adaptive.section import PassModels
from gs_codec.codecs.adaptive.step_sizes import SHAPE_RULES
from gs_codec.coding.frequency_table import SentModel
from gs_codec.config import SH_STREAMS
from gs_codec.egs.header import Header

if TYPE_CHECKING:
    from gs_codec.codecs.entropygs.section import Channel

#: Longer lists of names are replaced by their number.
_NAMED = 4

_BANDS = {stream: band for band, stream in enumerate(SH_STREAMS, 1)}

#: Meaning of a pass with only zero levels, if not that the values are zero.
_ZEROS = {
    "opacity": "constant",
    "scale_0": "constant",
    "scale_1": "the same as scale_0",
    "scale_2": "the same as scale_1",
}


def skipped_by_header(header: Header) -> list[str]:
    """Sentences that follow from the header alone."""
    lines = []
    if header.sh_degree < 3:
        absent = _bands(range(header.sh_degree + 1, 4))
        lines.append(f"{absent}: absent (degree {header.sh_degree})")
    if header.has_normals:
        lines.append("normals: all zero, not stored")
    return lines


def skipped_by_channels(channels: list[Channel]) -> list[str]:
    """Channels of a `paper` profile without symbols, and those coded by a table, not a model."""
    constant: list[str] = []
    zero_bands: list[int] = []
    tables: dict[str, list[str]] = {"mixture": [], "Laplace": []}
    for stream, group in groupby(channels, lambda channel: channel.stream):
        members = list(group)
        flat = [c for c in members if not c.quantiser.depth]
        sent = [c.name for c in members if isinstance(c.model, SentModel)]
        if stream in _BANDS and flat == members and not any(c.quantiser.origin for c in flat):
            zero_bands.append(_BANDS[stream])
        else:
            constant += _named([c.name for c in flat], stream, len(members))
        model = "Laplace" if stream in _BANDS else "mixture"
        tables[model] += _named(sent, stream, len(members))
    lines = [f"{_bands(zero_bands)}: all zero"] if zero_bands else []
    if constant:
        lines.append(f"{', '.join(constant)}: constant")
    for model, names in tables.items():
        if names:
            lines.append(f"{', '.join(names)}: a table in place of a {model} model")
    return lines


def skipped_by_passes(lattice: Lattice, models: PassModels, coefficients: int) -> list[str]:
    """Symbols of profiles `l`, `m` and `s` without bits, and contexts that share one table."""
    listed = [own for one in passes(coefficients) for own in one.lists]
    zeros = set()
    for item in listed:
        # If no table has a symbol other than token 0, all levels are 0.
        if not any(models.weights[row][1:].any() for row in np.unique(models.listed[item.name])):
            zeros.add(item.name)
    lines = []
    if flat := [axis for axis, bits in zip("xyz", lattice.grid.bits, strict=True) if not bits]:
        lines.append(f"{', '.join(flat)}: constant")
    kinds = [k for k, n in zip(("shape", "colour"), lattice.classes, strict=True) if n == 1]
    if kinds:
        lines.append(f"{'classes' if len(kinds) == 2 else f'{kinds[0]} classes'}: one for all")
    lines += _zero_passes(listed, zeros)
    return lines + _shared(lattice, listed, models, zeros)


def _zero_passes(listed: list[ContextList], zeros: set[str]) -> list[str]:
    lines = []
    zero_bands, zero = [], []
    for stream, group in groupby(listed, lambda item: item.stream):
        names = [item.name for item in group if not item.name.startswith("SH sum")]
        found = [name for name in names if name in zeros and stream != "classes"]
        if stream in _BANDS and found == names:
            zero_bands.append(_BANDS[stream])
        elif stream in ("opacity", "scaling"):
            lines += [f"{name}: {_ZEROS[name]}" for name in found]
        else:
            zero += _named(found, stream, len(names))
    if zero:
        lines.append(f"{', '.join(zero)}: all zero after rounding")
    if zero_bands:
        lines.append(f"{_bands(zero_bands)}: all zero after rounding")
    return lines


def _shared(
    lattice: Lattice, listed: list[ContextList], models: PassModels, zeros: set[str]
) -> list[str]:
    """Symbols whose contexts all share one table."""
    shared: list[str] = []
    for stream, group in groupby(listed, lambda item: item.stream):
        coded = [p for p in group if p.name not in zeros and _has_contexts(lattice, p)]
        names = [p.name for p in coded if len(np.unique(models.listed[p.name])) == 1]
        shared += _named(names, stream, len(coded))
    return [f"{', '.join(shared)}: one table for all contexts"] if shared else []


def _has_contexts(lattice: Lattice, item: ContextList) -> bool:
    """Whether a pass has several contexts; for opacity, scales and rotation, by their steps."""
    if item.stream not in SHAPE_RULES:
        return item.contexts > 1
    used = [lattice.rules[name] for name in rules_of(item.name)]
    # Step sizes of turns also depend on how similar the axes are.
    varies = lattice.classes[0] > 1 or item.stream == "rotation" or any(used[0].numbers[1:])
    return bool(varies and any(rule.limit for rule in used))


def _bands(numbers: Iterable[int]) -> str:
    listed = list(map(str, numbers))
    return f"SH band{'s' * (len(listed) > 1)} {', '.join(listed)}"


def _named(names: list[str], stream: str, number: int) -> list[str]:
    """Names of some of a stream's `number` members; the stream if all, a number if many."""
    if len(names) == number > 1:
        return [stream]
    return names if len(names) <= _NAMED else [f"{len(names)} of {number} in {stream}"]
