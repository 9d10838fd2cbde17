"""``-`` as a file name: a scene from stdin, or to stdout."""

from __future__ import annotations

import logging
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path

from gs_codec.errors import GsCodecError, InvalidInput, one_line


@contextmanager
def piped_source(source: Path, form: str | None = None) -> Iterator[Path]:
    """A file to read during the block, in place of ``-`` or a named pipe.

    `form` is its format, if the content does not identify it. Raises InvalidInput if `form` is
    given for a regular file, or contradicts the content.
    """
    _check_format([source], form)
    if not _is_pipe(source):
        yield source
        return
    suffix = source.suffix if form is None else f".{form}"
    with _stand_in(source, f"stdin{suffix}") as file:
        _copy_from(source, file)
        if form is not None:
            _check_content(file, form)
        yield file


def _check_content(file: Path, form: str) -> None:
    from gs_codec.formats.registry import open_scene

    with open_scene(file) as opened:
        if opened.format != form:
            raise InvalidInput(f"{file}: content is {opened.format}, expected {form}")


def _check_format(sources: Sequence[Path], form: str | None) -> None:
    if form is not None and not any(map(_is_pipe, sources)):
        raise InvalidInput(f"--input-format: has no effect on {sources[0]}, expected - or a pipe")


@contextmanager
def piped(
    sources: Sequence[Path], target: Path, suffix: str, form: str | None = None
) -> Iterator[tuple[list[Path], Path]]:
    """Files to read, as in `piped_source`, and to write in place of ``-``.

    The output goes to stdout once it is complete; text printed meanwhile goes to stderr. Raises
    InvalidInput if two sources are ``-``, or if the target is ``-`` and stdout is closed or a
    terminal.
    """
    if list(map(str, sources)).count("-") > 1:
        raise InvalidInput("-: stdin is one scene, expected '-' once")
    _check_format(sources, form)
    with ExitStack() as stack:
        files = [
            stack.enter_context(piped_source(source, form if _is_pipe(source) else None))
            for source in sources
        ]
        if not is_stdout(target):
            yield files, target
            return
        if getattr(sys.stdout, "name", None) == os.devnull:
            raise InvalidInput(f"{target}: stdout is closed, expected a pipe or a file")
        if sys.stdout.isatty():
            raise InvalidInput(f"{target}: stdout is a terminal, expected a pipe or a file")
        stdout = sys.stdout.buffer
        with _stand_in(target, f"stdout{suffix}") as out:
            with redirect_stdout(sys.stderr):
                yield files, out
            with open(out, "rb") as written:
                try:
                    shutil.copyfileobj(written, stdout)
                except OSError as error:
                    raise OSError(error.errno, error.strerror, "standard output") from error


def check_no_pipes(option: str, source: Path, target: Path) -> None:
    """Reject files that other processes cannot open."""
    for path in (source, target):
        if _is_pipe(path) or is_stdout(path):
            raise InvalidInput(f"{path}: a pipe, expected a file with {option}")


def is_stdout(target: str | Path | None) -> bool:
    """Whether a file to write stands for stdout."""
    return str(target) in ("-", "/dev/stdout")


def _is_pipe(path: Path) -> bool:
    try:
        return str(path) == "-" or stat.S_ISFIFO(os.stat(path).st_mode)
    except OSError:  # reported when it is opened
        return False


def _copy_from(source: Path, file: Path) -> None:
    with ExitStack() as stack:
        pipe = sys.stdin.buffer if str(source) == "-" else stack.enter_context(open(source, "rb"))
        try:
            shutil.copyfileobj(pipe, stack.enter_context(open(file, "wb")))
        except OSError as error:
            folder = file.parents[1]
            raise InvalidInput(f"{source}: copying it to {folder}: {one_line(error)}") from error


@contextmanager
def _stand_in(path: Path, name: str) -> Iterator[Path]:
    """A temporary file; errors and warnings show the path that it replaces."""
    from gs_codec.runtime.arrays import folder_on_disk

    with tempfile.TemporaryDirectory(prefix="gs-codec-", dir=folder_on_disk()) as folder:
        file = Path(folder, name)

        def renamed(text: str, shown: str = str(path)) -> str:
            return text.replace(str(file), shown)

        def rename(record: logging.LogRecord) -> bool:
            record.msg, record.args = renamed(record.getMessage()), ()
            return True

        handlers = tuple(logging.getLogger().handlers)
        for handler in handlers:
            handler.addFilter(rename)
        try:
            yield file
        except GsCodecError as error:
            shown = str(path)
            if isinstance(error.__cause__, OSError):
                shown += f": temporary file in {file.parents[1]}"
            raise type(error)(renamed(str(error), shown)) from error
        finally:
            for handler in handlers:
                handler.removeFilter(rename)
