"""The viewer's entry point; ``python -m viewer`` is ``gs-viewer``."""

from gs_codec.__main__ import start


def main() -> None:
    """Run the command."""
    start("gs-viewer", "viewer.main")


if __name__ == "__main__":
    main()
