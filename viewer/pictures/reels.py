"""Write frames to an .mp4 file or a folder of pictures, atomically."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from PIL import Image

import gs_codec
from gs_codec.errors import one_line
from gs_codec.runtime.atomic import check_folder, check_writable, temporary_name
from gs_codec.runtime.optional import missing_package, needed
from gs_codec.runtime.programs import how_ended, plain_text

#: Adds a frame; all frames have the same size.
AddFrame = Callable[[Image.Image], None]

#: File names of frames in a folder.
_FRAME = re.compile(r"\d{5,}\.png")

#: x264's constant rate factor: visually lossless.
_QUALITY = 17

#: BT.709 colours, which players assume.
_COLOURS = (
    "scale=out_color_matrix=bt709:out_range=tv,"
    "setparams=colorspace=bt709:color_primaries=bt709:color_trc=bt709:range=tv"
)


def is_folder(path: Path) -> bool:
    """Whether frames go to a folder: an existing one, or a name without a suffix."""
    return path.is_dir() or not path.suffix


def check_reel(path: Path, size: tuple[int, int], overwrite: bool) -> None:
    """Check that frames of a size, pixels, can be written to a path.

    Raises
    ------
    gs_codec.InvalidInput
        If the path is neither an .mp4 file nor a folder, exists without `overwrite`, or cannot be
        written; or if a side is odd for .mp4.
    gs_codec.MissingTool
        For .mp4, if imageio-ffmpeg is not installed.
    """
    if is_folder(path):
        there = path.is_dir()
        if os.path.lexists(path) and not there:
            raise gs_codec.InvalidInput(
                f"{path}: exists and is not a folder, expected .mp4 or a folder"
            )
        check_folder(path, overwrite)
        others = [name for name in os.listdir(path) if not _FRAME.fullmatch(name)] if there else []
        if others:
            raise gs_codec.InvalidInput(f"{path}: contains '{min(others)}', expected only frames")
        check_writable(path / "frame" if there else path)
        return
    if path.suffix.lower() != ".mp4":
        raise gs_codec.InvalidInput(
            f"{path}: expected .mp4, or a folder name without suffix for PNG frames"
        )
    if any(side % 2 for side in size):
        raise gs_codec.InvalidInput(
            f"{path}: size {size[0]}x{size[1]}, expected even sides for .mp4"
        )
    check_writable(path, overwrite)
    _ffmpeg(path)


def _ffmpeg(path: Path) -> str:
    """Path of the program that encodes films."""
    try:
        return needed("imageio_ffmpeg", str(path)).get_ffmpeg_exe()
    except (gs_codec.MissingTool, RuntimeError) as error:
        why = "" if isinstance(error, gs_codec.MissingTool) else one_line(error)
        text = missing_package("imageio_ffmpeg", str(path), why)
        raise gs_codec.MissingTool(f"{text}, or give a folder for PNG frames") from error


@contextmanager
def open_reel(path: Path, size: tuple[int, int], fps: int) -> Iterator[AddFrame]:
    """A function that adds a frame of this size, pixels; `path` is complete after the block.

    Raises
    ------
    gs_codec.GsCodecError
        If frames cannot be written; `path` is then unchanged.
    """
    with _folder(path) if is_folder(path) else _film(path, size, fps) as add:
        yield add


@contextmanager
def _folder(path: Path) -> Iterator[AddFrame]:
    """Write frames 00000.png and so on, replacing those in the folder."""
    there = path.is_dir()
    staged = (path if there else path.parent) / temporary_name(path.name or "frames")
    count = 0

    def add(frame: Image.Image) -> None:
        nonlocal count
        frame.save(staged / f"{count:05d}.png", "PNG")
        count += 1

    try:
        staged.mkdir()
        yield add
        if there:
            _replace_frames(staged, path)
        else:
            os.rename(staged, path)
    except OSError as error:
        raise gs_codec.InvalidInput(f"{path}: {one_line(error)}") from error
    finally:
        shutil.rmtree(staged, ignore_errors=True)


def _replace_frames(staged: Path, folder: Path) -> None:
    """Move frames into a folder, and remove its old frames."""
    new = set(os.listdir(staged))
    for name in os.listdir(folder):
        if _FRAME.fullmatch(name) and name not in new:
            os.unlink(folder / name)
    for name in sorted(new):
        os.replace(staged / name, folder / name)


@contextmanager
def _film(path: Path, size: tuple[int, int], fps: int) -> Iterator[AddFrame]:
    """Write an H.264 film that players and browsers can play."""
    staged = path.with_name(temporary_name(path.name))
    command = [
        _ffmpeg(path), "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(fps),
        "-i", "-", "-vf", _COLOURS, "-c:v", "libx264", "-crf", str(_QUALITY), "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", "-f", "mp4", os.path.abspath(staged),
    ]  # fmt: skip
    try:
        with tempfile.TemporaryFile() as log:
            # In a process group of its own; otherwise Ctrl-C would end it as if the film were
            # complete.
            program = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True
            )
            try:
                with _reported(path, program, log):
                    yield lambda frame: _feed(program, frame)
                    program.stdin.close()  # type: ignore[union-attr]
                    if program.wait():
                        raise BrokenPipeError
            finally:
                program.kill()
                program.wait()
        os.replace(staged, path)
    except OSError as error:
        raise gs_codec.InvalidInput(f"{path}: {one_line(error)}") from error
    finally:
        staged.unlink(missing_ok=True)


def _feed(program: subprocess.Popen, frame: Image.Image) -> None:
    program.stdin.write(frame.tobytes())  # type: ignore[union-attr]


@contextmanager
def _reported(path: Path, program: subprocess.Popen, log: IO[bytes]) -> Iterator[None]:
    """Report a closed pipe as an error, with the reason that the program gave."""
    try:
        yield
    except BrokenPipeError as error:
        status = program.wait()
        log.seek(0)
        lines = [line for line in map(plain_text, log.read().splitlines()) if line]
        full = os.strerror(errno.ENOSPC)
        if any(full in line for line in lines):
            raise gs_codec.InvalidInput(f"{path}: {full}") from error
        reason = "".join(f": {line}" for line in lines[:1])
        raise gs_codec.ToolFailed(f"{path}: ffmpeg {how_ended(status)}{reason}") from error
    finally:
        with contextlib.suppress(OSError):
            program.stdin.close()  # type: ignore[union-attr]
