"""Frames of small scenes that move, for tests of sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scenes import SmallBlocks, random_scene

from gs_codec.encoding.request import Request
from gs_codec.scene import Scene
from gs_codec.sequences.frame_encoding import SequenceReport, encode_frames


@dataclass(frozen=True)
class Given:
    """Frames in memory."""

    scenes: Sequence[Scene]
    fps: float | None = 25.0
    stored_bytes: int = 0

    @property
    def names(self) -> list[str]:
        return [f"frame_{number}" for number in range(len(self.scenes))]

    def __len__(self) -> int:
        return len(self.scenes)

    def read(self, number: int) -> Scene:
        return self.scenes[number]


def moving(count: int = 300, frames: int = 5, sh_degree: int = 3, seed: int = 0) -> list[Scene]:
    """Frames in which a third of the Gaussians move, turn, and change in every attribute."""
    rng = np.random.default_rng(seed)
    first = random_scene(count, sh_degree, seed)
    some = np.arange(count) % 3 == 0
    speeds = {
        group: rng.normal(scale=0.05, size=getattr(first, group).shape) * some
        for group in ("positions", "f_dc", "f_rest", "opacity", "log_scale", "rot")
    }
    found = []
    for number in range(frames):
        planes = {
            group: np.float32(getattr(first, group) + number * speed)
            for group, speed in speeds.items()
        }
        found.append(replace(first, **planes))
    return found


def coded(
    path: Path, scenes: Sequence[Scene], profile: str = "m", group: int = 30, block: int = 64
) -> SequenceReport:
    """Encode frames in small blocks."""
    request = Request(SmallBlocks(profile, block_size=block))
    return encode_frames(Given(scenes), path, request, group)
