"""Options that were typed, and have no effect beside the others."""

from __future__ import annotations

from collections.abc import Iterable

import typer

from gs_codec.errors import InvalidInput


def is_given(ctx: typer.Context, name: str) -> bool:
    """Whether an option was typed, be it with its default."""
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def refuse_given(ctx: typer.Context, names: Iterable[str], why: str) -> None:
    """Refuse options, named as parameters, which would be ignored.

    Raises
    ------
    InvalidInput
        If one was typed; `why` says what it needs.
    """
    for name in names:
        if is_given(ctx, name):
            raise InvalidInput(f"--{name.replace('_', '-')} {why}")
