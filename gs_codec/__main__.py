"""The commands' entry point; ``python -m gs_codec`` is ``gs-codec``."""

import gc
import sys

#: Objects made before garbage is looked for; Python's 700 make the start a tenth slower.
_OBJECTS = 10_000


def main() -> None:
    """Run the command line, also if it is interrupted before that is there."""
    gc.set_threshold(_OBJECTS)
    try:
        from gs_codec.cli.main import main as run

        run()
    except KeyboardInterrupt:
        print("gs-codec: interrupted", file=sys.stderr)
        sys.exit(130)
    finally:
        # When Python ends, it looks once more through all that was imported: 0.1 s, for nothing.
        gc.freeze()


if __name__ == "__main__":
    main()
