"""``python -m gs_codec`` is ``gs-codec``."""

from gs_codec.cli.main import main

main()
