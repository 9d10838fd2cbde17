"""``--threads``, which ``encode``, ``decode`` and ``bench`` share; `check_threads` checks it."""

from __future__ import annotations

from typing import Annotated

import typer

Threads = Annotated[
    int | None, typer.Option(help="Worker threads, 1-256.", show_default="all processors")
]
