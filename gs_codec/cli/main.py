"""Entry point: the commands, and one line per error."""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from gs_codec import __version__
from gs_codec.cli.command import Shown, usage_of, usage_text, with_hint
from gs_codec.cli.documents import begin_run, print_error
from gs_codec.cli.output import (
    is_verbose,
    log_to_stderr,
    print_problem,
    print_status,
    print_text,
    set_loudness,
)
from gs_codec.errors import GsCodecError, one_line
from gs_codec.runtime.wording import as_typed, size_text

#: Commands in the order of the help, with the first line of their help, because loading it from the
#: modules would double the time of the list; each is a module of this package.
NAMES = {
    "encode": "Encode a scene to .egs, or to a format that other programs read.",
    "decode": "Decode an .egs file to a PLY that other 3DGS tools open.",
    "verify": "Check a whole file: test checksums and decode an .egs, or read another format.",
    "convert": "Convert, merge and edit scenes in any format, and report every loss.",
    "prepare": "Prune, refine or compact a scene before coding, and report the loss.",
    "batch": "Encode or convert every scene in a folder, like `encode` and `convert`.",
    "inspect": "Show the contents of a file; only the header of an .egs is read.",
    "compare": "Compare two versions of a scene: by attribute, or in rendered views.",
    "render": "Render a scene from each camera as 3DGS does, or write only the cameras.",
    "share": "Write a web page that shows a scene, or compares two, in any browser.",
    "analyze": (
        "Report why coding works on a scene: correlations, distributions, entropies, sensitivities."
    ),
    "bench": "Measure time, size, error, memory and rendered quality; print JSON lines.",
    "warm": "Compile all kernels now, so that later commands start without delay.",
}


class _Commands(Shown, TyperGroup):
    """The commands; a command's module is loaded when it is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands: dict[str, Any] = dict.fromkeys(NAMES)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        from gs_codec.cli.options import completed

        if args[:1] == ["help"]:
            args = [*args[1:], "--help"]
        if not args or args[0] in ("-h", "--help"):
            self.commands |= {n: TyperCommand(n, help=NAMES[n]) for n in NAMES}
        return super().parse_args(ctx, completed(args))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in self.commands and self.commands[cmd_name] is None:
            self.commands[cmd_name] = _load_command(cmd_name)
        return super().get_command(ctx, cmd_name)


def _load_command(name: str) -> Any:
    from gs_codec.cli.action_options import InOrder

    module = import_module(f"gs_codec.cli.{name}")
    if hasattr(module, "app"):
        group = typer.main.get_command(module.app)
        group.name = name
        return group
    one = typer.Typer(add_completion=False)
    epilog = getattr(module.command, "epilog", None)
    one.command(name, cls=InOrder, epilog=epilog)(module.command)
    return typer.main.get_command(one)


app = typer.Typer(
    cls=_Commands,
    help="Compress, convert, edit and compare 3D Gaussian Splatting scenes.",
    epilog="gs-codec help COMMAND lists the options of a command.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def _options(
    version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    if version:
        print_text(f"gs-codec {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line; usage and input errors exit with status 2."""
    log_to_stderr("gs-codec")
    set_loudness()
    start = time.perf_counter()
    begin_run(sys.argv[1:], next((text for text in sys.argv[1:] if text in NAMES), None))
    # There is no large linear algebra, so numpy need not start its threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        status = app(standalone_mode=False, prog_name="gs-codec")
        _tell_cost(start)
        _flush_output()
    except (GsCodecError, OSError, MemoryError) as error:
        _tell_error(error, with_hint(describe_error(error), sys.argv[2:]))
        with suppress(OSError):
            _flush_output()
        sys.exit(2)
    except typer.Abort:
        status = 130
    except Exception as error:
        # Usage errors of Typer, whose class is in different modules in different releases.
        if not hasattr(error, "format_message"):
            raise
        if message := usage_text(error):  # otherwise help was shown
            _tell_error(error, message)
            if message.startswith("Missing"):
                print_problem(usage_of(error.ctx))  # type: ignore[attr-defined]
        sys.exit(2)
    if status == 130:
        print_problem("gs-codec: interrupted")
        print_error("Interrupted", "interrupted")
    sys.exit(status)


def _tell_error(error: BaseException, text: str) -> None:
    """Print an error in one line on stderr; with --json, also a document."""
    print_problem(f"gs-codec: error: {text}")
    kind = "Usage"  # an error of Typer
    if isinstance(error, GsCodecError | OSError | MemoryError):
        kind = "InvalidInput" if isinstance(error, OSError) else type(error).__name__
    with suppress(OSError):
        print_error(kind, text)


def _tell_cost(start: float) -> None:
    """Print time and memory of the command, with --verbose."""
    if not is_verbose():
        return
    text = f"{time.perf_counter() - start:.2f} s"
    with suppress(ImportError):  # Windows
        import resource

        text += (
            f", {size_text(1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)} of memory"
        )
    print_status(text)


def _flush_output() -> None:
    try:
        sys.stdout.flush()
    except OSError as error:
        # Otherwise Python would try to write it again on exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(error.errno, error.strerror, "standard output") from error


def _is_folder_removed() -> bool:
    """Whether the working directory was removed."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return True
    return False


def describe_error(error: BaseException) -> str:
    """The error in one line."""
    if isinstance(error, MemoryError):
        return one_line(error) or "not enough memory"
    missing = isinstance(error, FileNotFoundError) and error.filename is None
    if missing and _is_folder_removed():
        return "the working directory was removed"  # os.getcwd names no file
    named = isinstance(error, OSError) and error.strerror and error.filename
    text = as_typed(one_line(error))
    return f"{error.filename}: {text}" if named else text  # type: ignore[attr-defined]
