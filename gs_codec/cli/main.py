"""Entry point: the commands, and one line for every error."""

from __future__ import annotations

import logging
import os
import sys
from contextlib import suppress

import typer

from gs_codec import __version__
from gs_codec.cli import (
    analyze,
    batch,
    bench,
    compare,
    convert,
    decode,
    encode,
    inspect,
    prepare,
    render,
    verify,
)
from gs_codec.errors import GsCodecError, one_line

app = typer.Typer(
    help="Compress 3D Gaussian Splatting scenes (PLY) to small .egs files and back.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for module in (
    encode,
    decode,
    verify,
    convert,
    prepare,
    batch,
    inspect,
    compare,
    render,
    analyze,
):
    app.command(module.__name__.rpartition(".")[2])(module.command)
app.add_typer(bench.app, name="bench")


@app.callback(invoke_without_command=True)
def _options(
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    if version:
        print(f"gs-codec {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line; errors of use and input exit with status 2."""
    logging.basicConfig(format="gs-codec: %(levelname)s: %(message)s", level=logging.WARNING)
    logging.addLevelName(logging.WARNING, "warning")
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        status = app(standalone_mode=False)
        _flush_output()
    except (GsCodecError, OSError, MemoryError) as error:
        print(f"gs-codec: error: {describe_error(error)}", file=sys.stderr)
        with suppress(OSError):
            _flush_output()
        sys.exit(2)
    except typer.Abort:
        status = 130
    except Exception as error:
        # Typer's errors of use; releases differ in where they keep the class.
        if not hasattr(error, "format_message"):
            raise
        if message := " ".join(error.format_message().split()):  # none: help was shown
            print(f"gs-codec: error: {message}", file=sys.stderr)
        sys.exit(2)
    if status == 130:
        print("gs-codec: interrupted", file=sys.stderr)
    sys.exit(status)


def _flush_output() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        # Or Python would fail to write it once more when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(error.errno, error.strerror, "standard output") from error


def describe_error(error: BaseException) -> str:
    """The error on one line."""
    if isinstance(error, MemoryError):
        return one_line(error) or "not enough memory"
    named = isinstance(error, OSError) and error.strerror and error.filename
    return f"{error.filename}: {one_line(error)}" if named else one_line(error)  # type: ignore[attr-defined]
