"""Sequences on disk, whose frames are read one at a time."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import gs_codec
from gs_codec.egs.frame_sections import is_sequence
from gs_codec.errors import printable
from gs_codec.report import Progress
from gs_codec.scene import Scene
from gs_codec.sequences.frame_decoding import opened_sequence
from gs_codec.sequences.frame_encoding import FPS
from gs_codec.sequences.frame_sources import open_frames

#: Number of groups of frames that are kept.
_KEPT = 2

#: Share of a frame by which times may be off, because they are rounded.
_OFF = 1e-6


class Clip:
    """A sequence: an `.egs`, or frames as `open_frames` finds them. Not thread-safe.

    Keeps the last two groups of frames used, each decoded only as far as needed. A group is a key
    frame and those after it; a frame that is a file is a group of its own.

    Parameters
    ----------
    source : str or Path
    max_bytes : int, optional
        As in `gs_codec.read`, of a frame.

    Attributes
    ----------
    path : Path
    name : str
    count : int
        Number of frames.
    fps : float or None
        Frames per second; None if the source does not state them.
    stored_bytes : int
    """

    fps: float | None

    def __init__(self, source: str | Path, max_bytes: int | None = None) -> None:
        self.path, self._max_bytes = Path(source), max_bytes
        shown = self.path.name if self.path.exists() else "/".join(self.path.parts[-2:])
        self.name = printable(shown)
        self._groups: dict[int, tuple[Iterator[Scene] | None, list[Scene]]] = {}
        if is_sequence(source):
            with opened_sequence(source) as sequence:
                self.count, self.fps = sequence.timeline.count, sequence.timeline.fps
            self._files, self._keys = None, sequence.timeline.keys
            self.stored_bytes = self.path.stat().st_size
        else:
            self._files = files = open_frames(source, None, "drop", max_bytes)
            self.count, self.fps, self._keys = len(files), files.fps, tuple(range(len(files)))
            self.stored_bytes = files.stored_bytes

    @property
    def seconds(self) -> float:
        """Duration of a frame."""
        return 1 / (self.fps or FPS)

    def number_at(self, number: int, clip: Clip) -> int:
        """The frame shown at the same time as frame `number` of another clip.

        If one of them has no frames per second, they are taken to have the same.
        """
        if self.fps and clip.fps:
            number = int(number * clip.seconds / self.seconds + _OFF)
        return min(number, self.count - 1)

    def read(self, number: int, progress: Progress | None = None) -> Scene:
        """The scene of a frame.

        Raises
        ------
        gs_codec.GsCodecError
            If there is no such frame, or it cannot be read.
        """
        if not 0 <= number < self.count:
            raise gs_codec.GsCodecError(f"frame {number}: expected 0 to {self.count - 1}")
        place = bisect(self._keys, number) - 1
        key, end = self._keys[place], [*self._keys[1:], self.count][place]
        frames, decoded = self._groups.pop(key, (None, []))
        frames = frames or self._decode(key, end)
        self._groups[key] = frames, decoded
        while len(self._groups) > _KEPT:
            del self._groups[next(iter(self._groups))]
        while len(decoded) <= number - key:
            # Ends the job if the frame is no longer wanted; what is decoded is kept.
            if progress is not None:
                progress("frames", len(decoded), number - key + 1)
            try:
                decoded.append(next(frames))
            except Exception:
                del self._groups[key]  # the iterator has ended
                raise
        return decoded[number - key]

    def _decode(self, key: int, end: int) -> Iterator[Scene]:
        if self._files is not None:
            yield self._files.read(key)
            return
        with opened_sequence(self.path) as sequence:
            yield from sequence.frames(key, end, self._max_bytes)


class Moment(NamedTuple):
    """A frame of a sequence, by its number from 0."""

    clip: Clip
    number: int

    def after(self, step: int, loop: bool) -> int | None:
        """Number of the frame to play next, `step` frames on; None if none is left.

        Another frame than this one, also if drawing takes as long as the whole sequence.
        """
        last = self.clip.count - 1
        if loop and last:
            return (self.number + min(step, last)) % (last + 1)
        return min(self.number + step, last) if self.number < last else None
