"""Random sections `motion`: valid ones that no encoder writes."""

from __future__ import annotations

import struct
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np
from reference_lattice import floats_of
from reference_sequence import BASES, CONTEXTS, Moving, move_block
from reference_tools import BinaryCoder

#: Contexts of an integer, of which the first quarter are of its bit length.
INTEGER = 128


@dataclass
class RandomCoder(BinaryCoder):
    """Takes random decisions, and codes them; `longer` is the share of 1 in lengths of integers."""

    rng: np.random.Generator = field(default_factory=np.random.default_rng)
    flags: float = 0.5
    longer: float = 0.5
    coded: bytearray = field(default_factory=bytearray)

    def bit(self, context: int) -> int:
        first = max((base for base in BASES.values() if base <= context), default=None)
        share = self.flags
        if first is not None:
            place = context - first - (3 if first < BASES[4] else 0)
            share = self.longer if place >= 0 and place % INTEGER < INTEGER // 4 else 0.5
        self.code = self.low if self.rng.random() < share else self.high
        return super().bit(context)

    def shift(self) -> None:
        self.coded.append(self.high >> 24)
        super().shift()

    def end(self) -> bytes:
        """The bytes of all decisions."""
        size = 0
        while (self.high >> (32 - 8 * size)) << (32 - 8 * size) < self.low:
            size += 1
        return bytes(self.coded) + self.high.to_bytes(4, "big")[:size]


def random_motion(moving: list[Moving], rng: np.random.Generator) -> tuple[bytes, bool]:
    """Move the blocks at random; the section, and whether it is valid: nearly always."""
    streams, valid = [], True
    flags, longer = rng.choice([0.02, 0.3, 0.6, 0.95]), rng.choice([0.3, 0.6, 0.8, 0.9])
    for number in range(len(moving)):
        tries = 1 if rng.random() < 0.02 else 6
        for k in range(tries):
            moved = deepcopy(moving[number])
            coder = RandomCoder(b"", CONTEXTS, rng=rng, flags=flags, longer=longer / (1 + k))
            coder.chances, coder.seen = moved.contexts.chances, moved.contexts.seen
            try:
                move_block(moved, coder)
                floats_of(moved.lattice, moved.block)
                break
            except ValueError:
                valid = valid and k + 1 < tries
        moved.contexts = coder
        moving[number] = moved
        streams.append(coder.end())
    sizes = struct.pack(f"<{len(streams)}I", *map(len, streams))
    return sizes + b"".join(streams), valid
