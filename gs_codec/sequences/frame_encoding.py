"""Encode the frames of a sequence to one file. FORMAT.md, section "Sequences"."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from gs_codec.codecs.encode import encode_parts
from gs_codec.codecs.moving import FrameEncoder
from gs_codec.coding.clean import clean_scene
from gs_codec.config import Config
from gs_codec.distributed.folder import Folder, identity_of, work_folder
from gs_codec.egs.egs_file import (
    EgsFile,
    Listed,
    Section,
    SectionId,
    file_head,
    file_parts,
    head_size,
    padded_parts,
    read_file,
)
from gs_codec.egs.frame_sections import sequence_header, timeline_section
from gs_codec.egs.header import Header
from gs_codec.egs.sections import read_extra
from gs_codec.encoding.order import encode_prepared
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.report import Progress, StageTimes, step_counter
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene
from gs_codec.sequences.frame_sources import Frames

#: Frames of a group, by default; a reader decodes at most one group to show a frame.
GROUP = 30

#: Frames per second of sources that do not state them.
FPS = 30.0

#: Sections of frames by what is coded.
_KINDS = {"key": SectionId.KEY_FRAME, "motion": SectionId.MOTION}

#: Name of the property that remembers the order of a key frame's Gaussians while it is encoded.
_ORDER = "order"

#: Largest denominator of a number of frames per second: 30000/1001 is exact.
_RATE_LIMIT = 1001


@dataclass(frozen=True)
class SequenceReport:
    """Result of encoding a sequence.

    Attributes
    ----------
    frames, key_frames : int
        Number of frames, and of those that are complete scenes.
    count : int
        Number of Gaussians of the first frame.
    sh_degree : int
        SH degree of all frames.
    fps : float
        Frames per second.
    file_bytes, key_bytes, input_bytes : int
        Size of the file, of its key frames, and of the source.
    float_bytes : int
        Size of the floats of all frames.
    ratio : float
        Compression ratio relative to PLY frames, or to the floats of others.
    coarseness : float
        Factor on the step sizes of the profile.
    seconds : dict of str to float
        Wall time of each stage.
    encodings : int
        Number of times the sequence was encoded to meet a target.
    psnr_drop : float or None
        PSNR loss in dB if that is the target: mean over the views of the first, the last, and up to
        three other frames.
    worst_frame, worst_drop
        Name of the frame that loses most of these, and its loss in dB.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> report = gs_codec.encode_sequence([cloud] * 5, "still.egs", fps=25)
    >>> report.frames, report.key_bytes < report.file_bytes
    (5, True)
    """

    frames: int
    key_frames: int
    count: int
    sh_degree: int
    fps: float
    file_bytes: int
    key_bytes: int
    input_bytes: int
    float_bytes: int
    ratio: float
    coarseness: float
    seconds: dict[str, float]
    encodings: int = 1
    psnr_drop: float | None = None
    worst_frame: str | None = None
    worst_drop: float | None = None

    @property
    def bits_per_second(self) -> float:
        """Bits of a second of the sequence."""
        return 8 * self.file_bytes * self.fps / self.frames


def encode_frames(
    source: Frames,
    target: str | Path,
    request: Request,
    group: int = GROUP,
    progress: Progress | None = None,
    *,
    calibrates: bool = True,
) -> SequenceReport:
    """Encode a sequence; if it is interrupted, the next run with the same request resumes.

    Raises InvalidInput as `encode` does, or if frames differ in what all must share.

    Parameters
    ----------
    source : Frames
    target : path
        The `.egs` to write.
    request : Request
        Of profile ``l``, ``m`` or ``s``, with cameras or without, but without other steps. With a
        target, its step sizes are a trial.
    group : int
        Maximum number of frames in the group of a key frame.
    progress : callable, optional
    calibrates : bool
        Whether step sizes are chosen for the scene, if no cameras guide them.
    """
    rate_of(source)  # raises before frames are encoded
    times, config = StageTimes(), request.config
    settings = {"group": group, "names": source.names, "request": repr(request)}
    if not source.paths:
        # Nothing tells whether frames in memory are those of an earlier run.
        settings["run"] = secrets.token_hex(8)
    files, plan = list(source.paths), request.plan
    if plan is not None and isinstance(plan.cameras, str | Path):
        files += filter(Path.exists, [Path(plan.cameras)])
    with (
        using_threads(config.threads),
        work_folder(Path(target), identity_of(files, **settings)) as folder,
    ):
        if calibrates and request.plan is None:
            if not folder.has("steps"):
                with times.stage("calibrate"):
                    coarseness = np.float64(_calibrated(source, config, progress))
                folder.save("steps", {"coarseness": coarseness})
            config = replace(config, coarseness=float(folder.load("steps")["coarseness"]))
        with times.stage("encode"):
            _Groups(source, replace(request, config=config), group, folder).encode(progress)
        with times.stage("write"):
            return _assemble(source, Path(target), folder, config.coarseness, times)


def _calibrated(source: Frames, config: Config, progress: Progress | None) -> float:
    """The coarseness for the frame, of the first, middle and last one, that needs finest steps.

    All frames have the same, so that what does not move does not flicker.
    """
    from gs_codec.guidance.calibrate import calibrated

    last = len(source) - 1
    return min(
        calibrated(clean_scene(source.read(number), config)[0], config, progress).coarseness
        for number in sorted({0, last // 2, last})
    )


class _Groups:
    """Encodes frames to files of a folder: key frames, and changes after them."""

    def __init__(self, source: Frames, request: Request, group: int, folder: Folder) -> None:
        self._source, self._request, self._group = source, request, group
        self._folder = folder
        self._encoder: FrameEncoder | None = None
        self._headers: list[Header] = []
        self._key = self._key_bytes = 0
        #: Frames that stay key frames because changes of one before were larger.
        self._wait = self._misses = 0

    def encode(self, progress: Progress | None) -> None:
        """Encode the frames that are not in the folder yet."""
        total, first = len(self._source), self._first_missing()
        advance = step_counter(progress, "frames", total)
        for _ in range(first):
            advance()
        for number, scene in _read_ahead(self._source, first):
            kind, data = self._encode(number, scene)
            row = np.frombuffer(data, np.uint8)
            floats = np.int64(scene.float_bytes)
            self._folder.save(f"{number:08d}", {kind: row, "float_bytes": floats})
            advance()

    def _first_missing(self) -> int:
        """The frame to go on with: the first missing, or the key frame that it needs."""
        total, first = len(self._source), 0
        while first < total and self._folder.has(f"{first:08d}"):
            first += 1
        if first in (0, total):
            return first
        while "key" not in self._folder.load(f"{first - 1:08d}"):
            first -= 1
        return first - 1

    def _encode(self, number: int, scene: Scene) -> tuple[str, bytes]:
        encoder = self._encoder
        if encoder is not None and number - self._key < self._group and not self._wait:
            if (ordered := encoder.ordered(scene)) is None:
                return "key", self._encode_key(number, scene)
            data = encoder.encode(ordered)
            if len(data) < self._key_bytes:
                self._misses = 0
                return "motion", data
            self._misses += 1
            self._wait = 1 << self._misses
        self._wait = max(self._wait - 1, 0)
        return "key", self._encode_key(number, scene)

    def _encode_key(self, number: int, scene: Scene) -> bytes:
        order = {_ORDER: np.arange(scene.count, dtype=np.int32)}
        ordered = replace(scene, extra=order)
        if self._request.plan is None:
            parts, _ = encode_parts(ordered, self._request.config)
        else:
            parts, _ = encode_prepared(ordered, self._request)
        file = read_file(b"".join(parts))
        if not (number or file.header.count):
            raise InvalidInput("the first frame has no Gaussians, expected at least one")
        found = np.zeros(0, np.int32)
        if file.header.count:
            extra = file.section(SectionId.EXTRA)
            found = read_extra(extra, file.header.count)[_ORDER]
        self._headers = [*self._headers[:1], file.header]
        with located(self._source.names[number]):
            sequence_header(self._headers)
        key = _without_extra(file)
        self._encoder = FrameEncoder(file, found, scene)
        self._key, self._key_bytes = number, len(key)
        return key


def _without_extra(file: EgsFile) -> bytes:
    """A file without its section `extra`."""
    sections = [
        Section(SectionId(section), block, file.section(SectionId(section), block))
        for section, block in file.table
        if section != SectionId.EXTRA
    ]
    return b"".join(file_parts(file.header, sections))


def _read_ahead(source: Frames, first: int) -> Iterator[tuple[int, Scene]]:
    """Frames from `first` on, each read while the one before is encoded."""
    with ThreadPoolExecutor(1) as pool:
        following = pool.submit(source.read, first) if first < len(source) else None
        for number in range(first, len(source)):
            assert following is not None
            scene = following.result()
            if number + 1 < len(source):
                following = pool.submit(source.read, number + 1)
            yield number, scene


def rate_of(source: Frames) -> Fraction:
    """Frames per second."""
    fps = FPS if source.fps is None else source.fps
    rate = Fraction(fps).limit_denominator(_RATE_LIMIT)
    if not 0 < rate < _RATE_LIMIT * _RATE_LIMIT:
        raise InvalidInput(f"{fps:g} frames per second, expected 0.001 to a million")
    return rate


def _assemble(
    source: Frames, target: Path, folder: Folder, coarseness: float, times: StageTimes
) -> SequenceReport:
    """Write the file of all frames in a folder."""
    count, rate = len(source), rate_of(source)
    timeline = timeline_section((rate.numerator, rate.denominator), source.names, count)
    listed, keys, key_bytes, floats = [Listed.of(timeline)], list[Header](), 0, 0
    with atomic_writer(target) as file:
        file.seek(head_size(1 + count))
        file.writelines(padded_parts(timeline))
        for number in range(count):
            found = folder.load(f"{number:08d}")
            floats += int(found.pop("float_bytes"))
            [(kind, data)] = found.items()
            section = Section(_KINDS[kind], number, data.tobytes())
            if kind == "key":
                keys.append(read_file(section.data, lambda *_: False).header)
                key_bytes += len(section.data)
            listed.append(Listed.of(section))
            file.writelines(padded_parts(section))
        header, size = sequence_header(keys), file.tell()
        file.seek(0)
        file.write(file_head(header, listed))
    return SequenceReport(
        frames=count,
        key_frames=len(keys),
        count=header.count,
        sh_degree=header.sh_degree,
        fps=float(rate),
        file_bytes=size,
        key_bytes=key_bytes,
        input_bytes=source.stored_bytes,
        float_bytes=floats,
        ratio=source.ratio_bytes(floats) / size,
        coarseness=coarseness,
        seconds=times.seconds,
    )
