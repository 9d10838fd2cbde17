"""Frames of small scenes that move, for tests of sequences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scenes import SmallBlocks, random_scene

from gs_codec.egs.egs_file import Section, SectionId, described, read_file, write_file
from gs_codec.egs.frame_sections import timeline_of
from gs_codec.encoding.request import Request
from gs_codec.scene import GROUPS, Scene
from gs_codec.sequences.frame_decoding import Sequence as OpenSequence
from gs_codec.sequences.frame_encoding import SequenceReport, encode_frames
from gs_codec.sequences.frame_sources import Frames


def given(scenes: Sequence[Scene], read: Callable[[int], Scene] | None = None) -> Frames:
    """Frames in memory, or as `read`."""
    names = [f"frame_{number}" for number in range(len(scenes))]
    return Frames(names, 0, 25.0, read or scenes.__getitem__, is_compressed=True)


def moving(count: int = 1200, frames: int = 5, sh_degree: int = 3, seed: int = 0) -> list[Scene]:
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
    path: Path, scenes: Sequence[Scene], profile: str = "m", group: int = 30, block: int = 600
) -> SequenceReport:
    """Encode frames in small blocks."""
    request = Request(SmallBlocks(profile, block_size=block))
    return encode_frames(given(scenes), path, request, group)


#: What changes in `varied` from one frame to the next: a standard deviation.
MOTION = {
    "positions": 0.02,
    "f_dc": 0.1,
    "f_rest": 0.05,
    "opacity": 0.5,
    "log_scale": 0.3,
    "rot": 0.2,
}

#: Centres stay finite.
LARGEST = float(np.finfo(np.float32).max)


def varied(
    first: Scene, frames: int, groups: Sequence[str] = GROUPS, share: float = 0.3
) -> list[Scene]:
    """Frames of a scene in which a share of the Gaussians changes, others in each group.

    Each has a velocity of its own, and is a little irregular.
    """
    rng = np.random.default_rng(0)
    changes = {}
    for group in groups:
        values = getattr(first, group)
        changed = rng.random(first.count) < share
        changes[group] = changed * rng.normal(scale=MOTION[group], size=values.shape)
    found = [first]
    for _ in range(frames - 1):
        planes = {}
        for group, change in changes.items():
            before = getattr(found[-1], group)
            step = change * rng.normal(1, 0.3, change.shape)
            away = np.maximum(1, 0.01 * np.abs(before)) if group == "positions" else 1
            moved = np.clip(before + step * away, -LARGEST, LARGEST)
            planes[group] = moved.astype(np.float32)
        found.append(replace(found[-1], **planes))
    return found


def encoded(
    frames: Sequence[Scene], block: int = 100, profile: str = "m", group: int = 30
) -> bytes:
    """The file of these frames."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sequence.egs"
        coded(path, frames, profile, group, block)
        return path.read_bytes()


def opened(data: bytes) -> OpenSequence:
    """A sequence in memory."""
    file = read_file(data, described)
    return OpenSequence(file, timeline_of(file))


def decode(data: bytes) -> list[Scene]:
    """All frames of a sequence in memory."""
    return list(opened(data).frames())


def sections_of(data: bytes) -> list[Section]:
    """The sections of a file, in its order."""
    file = read_file(data)
    return [Section(SectionId(i), b, bytes(file.section(SectionId(i), b))) for i, b in file.table]


def rewritten(data: bytes, sections: Sequence[Section]) -> bytes:
    """The file with other sections."""
    return write_file(read_file(data).header, sections)
