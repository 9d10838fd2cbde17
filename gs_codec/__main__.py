"""The commands' entry point; ``python -m gs_codec`` is ``gs-codec``."""

import gc
import os
import sys
from importlib import import_module

#: Objects made before garbage is looked for; Python's 700 make the start a tenth slower.
_OBJECTS = 10_000


def main() -> None:
    """Run the command line."""
    start("gs-codec", "gs_codec.cli.main")


def start(program: str, module: str) -> None:
    """Run `main` of a module; Ctrl-C ends the program in one line, also while modules load."""
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
        # When Python ends, it looks once more through all that was imported: 0.1 s, for nothing.
        gc.freeze()


def _open_standard_streams() -> None:
    """Open the null device where a stream is closed, so that no file gets its number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is behind an error: compiled modules turn it into an ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


if __name__ == "__main__":
    main()
