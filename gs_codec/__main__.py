"""Entry point of the commands; ``python -m gs_codec`` is ``gs-codec``."""

import gc
import os
import sys
from importlib import import_module

#: Allocations between garbage collections; Python's default of 700 slows the start by 10 %.
_OBJECTS = 10_000


def main() -> None:
    """Run the command line."""
    start("gs-codec", "gs_codec.cli.main")


def start(program: str, module: str) -> None:
    """Run `main` of a module; Ctrl-C exits with one line, even while modules load."""
    gc.set_threshold(_OBJECTS)
    _open_standard_streams()
    try:
        import_module(module).main()
    except BaseException as error:
        if isinstance(error, SystemExit) or not _was_interrupted(error):
            raise
        print(f"{program}: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        # Otherwise Python scans all imported objects again on exit, which takes 0.1 s.
        gc.freeze()


def _open_standard_streams() -> None:
    """Open the null device for closed standard streams, so that no file gets their numbers."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error: compiled modules turn it into an ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


if __name__ == "__main__":
    main()
