"""Frames read from disk, one at a time: files, a zip of files, an animation, or a sequence."""

from __future__ import annotations

import logging
import math
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path, PurePath

import numpy as np

from gs_codec.coding.clean import with_finite_ends
from gs_codec.config import Extra
from gs_codec.egs.frame_sections import is_sequence
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.format_table import EGS, FORMATS, PLY, STREAMED, TILESET, UNBUNDLED, USD
from gs_codec.formats.coordinates import CONVENTION, system_of, turn_axes
from gs_codec.formats.ply.animation import frame_names, read_frame
from gs_codec.formats.registry import SceneFile, open_scene, saying_once, scene_files
from gs_codec.formats.several_scenes import ZIP_SUFFIX, scenes_in
from gs_codec.formats.usd.scene import frame_times, read_usd
from gs_codec.formats.zip_file import opened_zip
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.scene import Scene
from gs_codec.sequences.frame_decoding import opened_sequence

log = logging.getLogger(__name__)

#: Suffixes of frames: of all formats but the one that sequences are encoded to.
_SUFFIXES = tuple(suffix for known in FORMATS if known is not EGS for suffix in known.read)


@dataclass(frozen=True)
class Frames:
    """The frames of a sequence on disk.

    Attributes
    ----------
    names : list of str
        Name of each frame, in their order: what a file is called, without its suffix.
    stored_bytes : int
        Bytes of all frames as they are stored.
    fps : float, optional
        Frames per second; None if unknown.
    open_frame : callable
        ``(number) -> Scene``, as it is stored; see `read`.
    paths : sequence of Path
        The files that hold them.
    is_compressed : bool
        Whether they are in a compressed format.
    """

    names: list[str]
    stored_bytes: int
    fps: float | None
    open_frame: Callable[[int], Scene]
    paths: Sequence[Path] = ()
    is_compressed: bool = False
    _said: set[Hashable] = field(default_factory=set)

    def __len__(self) -> int:
        return len(self.names)

    def read(self, number: int) -> Scene:
        """The scene of a frame, 0 being the first one, in the usual coordinate system (RDF).

        Raises InvalidInput if its file is damaged.
        """
        with saying_once(self._said):
            scene = self.open_frame(number)
        return scene if system_of(scene) == CONVENTION else turn_axes(scene)

    def ratio_bytes(self, float_bytes: int) -> int:
        """Reference size for ratios: of the files, or of the floats if they are compressed."""
        return float_bytes if self.is_compressed else self.stored_bytes

    def __iter__(self) -> Iterator[Scene]:
        return map(self.read, range(len(self)))


def has_frames(source: str | Path) -> bool:
    """Whether a source is a folder, a pattern, or a file with several frames."""
    path = Path(source)
    try:
        kind, found = scenes_in(source)
        if kind or not path.is_file():  # a pipe can be read only once
            return kind in ("folder", "pattern") or len(found) > 1
        return is_sequence(path) or len(_of_animation(path, "drop", None)) > 1
    except GsCodecError:
        return False


def open_frames(
    source: str | Path,
    fps: float | None = None,
    extra: Extra = "keep",
    max_bytes: int | None = None,
) -> Frames:
    """Find the frames of a sequence; they are read later, one at a time.

    Parameters
    ----------
    source : str or Path
        A folder; a pattern such as ``frames/*.ply``; a `.zip`; an animation in one file: of Brush
        (`.ply`), or time samples of USD; an `.egs` that is a sequence. Files are frames of one
        format, in natural order: ``frame2`` before ``frame10``.
    fps : float, optional
        Frames per second, above 0; by default, as stated in the source, if it is.
    extra : {"keep", "drop", "error"}
        Handling of extra properties, as in `read_ply`.
    max_bytes : int, optional
        Maximum bytes of a frame's floats; default: see `most_bytes`.

    Raises
    ------
    InvalidInput
        If there are no frames, files of several formats, or `fps` is out of range.
    """
    fps = checked_fps(fps)
    path, options = Path(source), (extra, max_bytes)
    kind, found = scenes_in(source)
    if kind:
        frames = (_of_zip if kind == "zip" else _of_files)(path, found, *options)
    elif is_sequence(path):
        frames = _of_sequence(path, max_bytes)
    else:
        frames = _of_animation(path, *options)
    return frames if fps is None else replace(frames, fps=fps)


def checked_fps(fps: float | None) -> float | None:
    """Frames per second, if given; raises InvalidInput unless they are above 0."""
    if fps is not None and not 0 < fps < math.inf:
        raise InvalidInput(f"fps: {fps}, expected more than 0")
    return None if fps is None else float(fps)


def _of_files(
    source: Path, found: Sequence[PurePath], extra: Extra, max_bytes: int | None
) -> Frames:
    for name in (TILESET, STREAMED, UNBUNDLED):
        others = scene_files(source / name)[1:]
        if others and (not found or {*others} & {*found}):
            raise InvalidInput(f"{source}: files of one scene, no frames; expected {source / name}")
    ordered, names = _in_order(source, found)
    paths, stored = list(map(Path, ordered)), 0
    for path in paths:
        with open_scene(path) as file:
            stored, compressed = stored + file.stored_bytes, file.is_compressed

    def read_file(number: int) -> Scene:
        with open_scene(paths[number]) as file:
            return file.scene(extra, max_bytes)

    return Frames(names, stored, None, read_file, paths, compressed)


def _of_zip(source: Path, found: Sequence[PurePath], extra: Extra, max_bytes: int | None) -> Frames:
    found, names = _in_order(source, found)
    with located(source), opened_zip(source) as archive:
        stored = sum(archive.size(str(entry)) for entry in found)

    def read_entry(number: int) -> Scene:
        shown = source / found[number]
        with tempfile.TemporaryFile() as file:
            with located(source), opened_zip(source) as archive:
                name = str(found[number])
                file.write(archive.read(name, archive.size(name)))
            file.flush()
            return SceneFile(shown, FileBytes(shown, file.fileno())).scene(extra, max_bytes)

    return Frames(names, stored, None, read_entry, [source], _suffix(found[0]) != ".ply")


def _of_animation(source: Path, extra: Extra, max_bytes: int | None) -> Frames:
    names, times, fps = list[str](), list[float](), None
    with open_scene(source) as file:
        if file.format == USD.name:
            times, rate = frame_times(source, file.data[:])
            if len(times) > 1:
                names = [f"{number:04d}" for number in range(len(times))]
                fps = rate / float(np.median(np.diff(times)))
        elif file.scene_format is PLY:
            names = frame_names(file.ply.header)
        if not names:
            raise InvalidInput(
                f"{source}: one scene, expected frames: a folder, a pattern such as "
                f"'frames/*.ply', a {ZIP_SUFFIX}, or an animation"
            )
        stored = file.stored_bytes

    def read_in_file(number: int) -> Scene:
        with open_scene(source) as file:
            if times:
                scene = read_usd(source, file.data[:], max_bytes, times[number])
            else:
                scene = read_frame(file.ply, number, extra, max_bytes)
            return with_finite_ends(scene, source)

    return Frames(names, stored, fps, read_in_file, [source], bool(times))


def _of_sequence(source: Path, max_bytes: int | None) -> Frames:
    with opened_sequence(source) as sequence:
        timeline, stored = sequence.timeline, len(sequence.file.data)
    following, rest = 0, _decoded(source, 0, max_bytes)

    def decode_frame(number: int) -> Scene:
        nonlocal following, rest
        if number != following:
            rest = _decoded(source, number, max_bytes)
        following = number + 1
        return next(rest)

    names = [timeline.name_of(number) for number in range(timeline.count)]
    return Frames(names, stored, timeline.fps, decode_frame, [source], is_compressed=True)


def _decoded(source: Path, first: int, max_bytes: int | None) -> Iterator[Scene]:
    """The frames of a sequence from `first` on."""
    with opened_sequence(source) as sequence:
        yield from sequence.frames(first, max_bytes=max_bytes)


def _suffix(path: PurePath) -> str:
    """The longest suffix of a scene in the name of a file; "" if there is none."""
    name = path.name.lower()
    return max((suffix for suffix in _SUFFIXES if name.endswith(suffix)), key=len, default="")


def _in_order(source: Path, paths: Sequence[PurePath]) -> tuple[list[PurePath], list[str]]:
    """Paths in natural order, and the names of their frames; see `open_frames` for errors."""
    if not paths:
        raise InvalidInput(f"{source}: no frames, expected files of one of {', '.join(_SUFFIXES)}")
    kinds = Counter(map(_suffix, paths))
    if len(kinds) > 1 or not all(kinds):
        found = ", ".join(f"{n:,} {suffix or 'of another kind'}" for suffix, n in kinds.items())
        raise InvalidInput(
            f"{source}: {found}; expected frames of one of the formats {', '.join(_SUFFIXES)}, "
            "selected by a pattern such as 'frames/*.ply'"
        )
    ordered = sorted(paths, key=lambda path: [_natural(part) for part in path.parts])
    names = _names([_parts(path) for path in ordered])
    _warn_of_gaps(source, names)
    return ordered, names


def _natural(text: str) -> list[tuple[int, str]]:
    """A key that orders numbers in texts by their value, however long they are."""
    parts = re.split("0*([0-9]+)", text)
    return [(len(each) if k % 2 else 0, each) for k, each in enumerate(parts)]


def _parts(path: PurePath) -> tuple[str, ...]:
    """The folders of a frame and its name without suffix, if that is not all of it."""
    stem = path.name[: len(path.name) - len(_suffix(path))]
    return (*path.parent.parts, stem) if stem else path.parent.parts


def _names(parts: list[tuple[str, ...]]) -> list[str]:
    """The last part of each frame or, where these are alike, all parts that differ."""
    names = [each[-1] for each in parts]
    if len(set(names)) < len(names):
        depth = min(map(len, parts))
        differ = [k for k in range(-depth, 0) if len({each[k] for each in parts}) > 1]
        names = ["_".join(each[k] for k in differ) for each in parts]
    if len(set(names)) < len(names):
        twice = Counter(names).most_common(1)[0][0]
        raise InvalidInput(f"two frames of the same name {twice!a:.60}")
    return names


def _warn_of_gaps(source: Path, names: Sequence[str]) -> None:
    """Warn where the last number in names is not the next one."""
    # Python reads integers of at most 4300 digits.
    numbers = [int(found[-1]) for name in names if (found := re.findall("[0-9]{1,4300}", name))]
    steps = [after - before for before, after in pairwise(numbers)]
    if len(numbers) < len(names) or not steps or min(steps) < 1:
        return
    gaps = [names[k : k + 2] for k, step in enumerate(steps) if step > min(steps)]
    if gaps:
        shown = ", ".join(f"{before} and {after}" for before, after in gaps[:3])
        more = f", and in {len(gaps) - 3:,} other places" if len(gaps) > 3 else ""
        log.warning("%s: frames are missing between %s%s", source, shown, more)
