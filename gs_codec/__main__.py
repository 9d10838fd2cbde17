"""The commands' entry point; ``python -m gs_codec`` is ``gs-codec``."""

import sys


def main() -> None:
    """Run the command line, also if it is interrupted before that is there."""
    try:
        from gs_codec.cli.main import main as run

        run()
    except KeyboardInterrupt:
        print("gs-codec: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
