"""Decode a sequence, from file to scenes or files."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from gs_codec.codecs.moving import decode_frames
from gs_codec.egs.egs_file import EgsFile, described, read_file
from gs_codec.egs.frame_sections import Timeline, timeline_of
from gs_codec.egs.header import Feature
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import check_target, known_suffix
from gs_codec.formats.ply.writer import write_vertices
from gs_codec.formats.several_scenes import refuse_several
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import atomic_writer, check_folder, make_folder
from gs_codec.runtime.mapped import located, opened
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Sequence:
    """An open sequence.

    Attributes
    ----------
    file : EgsFile
        Its header and timeline; frames are read when they are decoded.
    timeline : Timeline
        Number of frames, frames per second, names, and key frames.
    """

    file: EgsFile
    timeline: Timeline

    def frames(
        self, first: int = 0, stop: int | None = None, max_bytes: int | None = None
    ) -> Iterator[Scene]:
        """Decode frames `first` to `stop`; at most a group is decoded before the first.

        Raises InvalidInput if there is no such frame. Raises CorruptStream, TruncatedStream or
        UnsupportedVersion.
        """
        last = self.timeline.count if stop is None else stop
        if not 0 <= first < last <= self.timeline.count:
            count = self.timeline.count
            raise InvalidInput(f"frames {first} to {last - 1}: expected some of 0 to {count - 1}")
        return decode_frames(self.file, self.timeline, int(first), int(last), max_bytes=max_bytes)

    def at(self, start: float, end: float) -> range:
        """The frames that are shown from `start` until `end`, in seconds; at least one.

        Raises InvalidInput if `start` is after `end`, or the sequence is shorter.
        """
        timeline = self.timeline
        # As floats, 4.1 s of 30 frames a second are a little less than 123 frames.
        begin, stop = (round(each * timeline.fps, 6) for each in (start, end))
        first, last = int(begin), math.ceil(stop)
        if not 0 <= start <= end or first >= timeline.count:
            length = timeline.count / timeline.fps
            raise InvalidInput(f"time {start:g}-{end:g}: expected some of 0 to {length:g} seconds")
        return range(first, min(max(last, first + 1), timeline.count))


@contextmanager
def opened_sequence(path: str | Path) -> Iterator[Sequence]:
    """Open a sequence. Raises InvalidInput if the file is another scene."""
    refuse_several(path)
    with opened(path) as data, located(path):
        file = read_file(data, described)
        if Feature.SEQUENCE not in file.header.features:
            raise InvalidInput("one scene, expected a sequence")
        yield Sequence(file, timeline_of(file))


@dataclass(frozen=True)
class SequenceDecodeReport:
    """Result of decoding frames of a sequence to files.

    Attributes
    ----------
    frames : int
        Number of files written.
    count : int
        Number of Gaussians of all of them.
    file_bytes, output_bytes : int
        Size of the sequence, and of what was written.
    seconds : float
        Wall time.
    """

    frames: int
    count: int
    file_bytes: int
    output_bytes: int
    seconds: float


def decode_to_files(
    source: str | Path,
    target: str | Path,
    frame: int | None = None,
    time_range: tuple[float, float] | None = None,
    progress: Progress | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
) -> SequenceDecodeReport:
    """Decode frames of a sequence to PLY files in a folder, or a single frame to a file.

    Parameters
    ----------
    source : path
        An `.egs` that is a sequence.
    target : path
        A folder, made if missing; files get the names of their frames. With `frame`, a `.ply`.
    frame : int, optional
        The only frame to decode, from 0.
    time_range : tuple of two float, optional
        Seconds: decodes only the frames shown from the first to the second.
    progress, max_bytes, overwrite
        As in `decode_file`.

    Raises
    ------
    InvalidInput
        If there are no such frames, the target is a file for several, or cannot be written.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the file is damaged.
    """
    began = time.perf_counter()
    written = count = 0
    with opened_sequence(source) as sequence:
        timeline = sequence.timeline
        some = range(timeline.count)
        if frame is not None:
            check_target([source], target, (".ply",), overwrite)
            some = range(frame, frame + 1)
        elif known_suffix(target):
            raise InvalidInput(f"{target}: a file, expected a folder for the frames, or one frame")
        else:
            check_folder(target, overwrite)
        if time_range is not None:
            some = sequence.at(*time_range)
        frames = sequence.frames(some.start, some.stop, max_bytes)
        advance = step_counter(progress, "frames", len(some))
        for number, scene in zip(some, frames, strict=True):
            path = Path(target)
            if frame is None:
                path = make_folder(target) / f"{_file_name(timeline, number)}.ply"
            with atomic_writer(path) as file:
                write_vertices(file, scene.count, iter([scene]))
            written, count = written + path.stat().st_size, count + scene.count
            advance()
        size = Path(source).stat().st_size
    return SequenceDecodeReport(len(some), count, size, written, time.perf_counter() - began)


def _file_name(timeline: Timeline, number: int) -> str:
    """The name of a frame, if it can be that of a file in a folder; otherwise its number."""
    name = timeline.name_of(number)
    plain = replace(timeline, names=())
    unsafe = set(name) & set('/\\:*?"<>|') or name.startswith(".") or not name
    return plain.name_of(number) if unsafe or timeline.names.count(name) > 1 else name
