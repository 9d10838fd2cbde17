"""Shared behaviour of commands: help, usage line, and shell completion."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any


class Shown:
    """Mixin for commands: switches have no type in the help, hidden options are completed."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, and ``--help``."""
        params = super().get_params(ctx)  # type: ignore[misc]
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
        return params

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The rest of the usage line, after the command's name."""
        if hasattr(self, "subcommand_metavar"):
            return super().collect_usage_pieces(ctx)  # type: ignore[misc]
        return ["[OPTIONS]", *argument_names(self)]

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Completions, including the options at the end of the help."""
        hidden = [p for p in self.get_params(ctx) if getattr(p, "hidden", False)]
        for param in hidden:
            param.hidden = False
        try:
            return super().shell_complete(ctx, incomplete)  # type: ignore[misc]
        finally:
            for param in hidden:
                param.hidden = True


def argument_names(command: Any) -> list[str]:
    """The names of a command's arguments, as in its usage line."""
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    several = {p.metavar for p in arguments if p.nargs == -1 and not p.metavar.endswith("...")}
    return [p.metavar + "..." * (p.metavar in several) for p in arguments]


def usage_of(ctx: Any) -> str:
    """The usage line of a context's command, and where to find help."""
    pieces = " ".join(["gs-codec", *_names(ctx), *ctx.command.collect_usage_pieces(ctx)])
    return f"usage: {pieces} (more: gs-codec help {' '.join(_names(ctx))}".rstrip() + ")"


def _names(ctx: Any) -> list[str]:
    """The names of a command and its groups, without the program's."""
    return [] if ctx.parent is None else [*_names(ctx.parent), ctx.info_name]


def usage_text(error: Any) -> str:
    """The text of a usage error, in one line; if a glob expanded to several files, with a hint."""
    text = message_of(error)
    if "unexpected extra argument" in text:
        return _of_several(error.ctx) or f"{text.replace('(s)', 's')}; {usage_of(error.ctx)}"
    if text == "No such option: -o":  # the output of many programs
        is_named = any("--out" in param.opts for param in error.ctx.command.params)
        return f"{text}; {'write --out' if is_named else usage_of(error.ctx)}"
    # Or the argument after a list is missing.
    if text.startswith("Missing argument") and error.param.nargs == -1:
        return f"Missing argument: expected {' '.join(argument_names(error.ctx.command))}"
    return text


def message_of(error: Any) -> str:
    """The message of Typer's error, in one line; with a hint if a file was taken for an option."""
    text = " ".join(error.format_message().split())
    dashed = [name for name in sys.argv[1:] if name.startswith("-") and os.path.exists(name)]
    if dashed and text.startswith("No such option"):
        return f"{text}; write the name of the file as ./{dashed[0]}"
    return text


def with_hint(text: str, typed: list[str]) -> str:
    """The text of an error; if it names a URL as a file, with a hint."""
    urls = [name for name in typed if "://" in name]
    if any(str(Path(url)) in text for url in urls):
        return f"{text}; only `batch` reads and writes URLs"
    return text


def _of_several(ctx: Any) -> str:
    """A hint if a shell expanded a glob into several files; nothing for other commands."""
    first = str(ctx.params.get("source", ""))
    folder, name = os.path.split(first)
    glob = os.path.join(folder, f"*{os.path.splitext(name)[1]}")
    if ctx.info_name == "batch":
        return f"batch: more than SRC and DST; put a glob in quotes: gs-codec batch '{glob}' DST"
    if ctx.info_name == "encode":
        return (
            "encode: more than IN and OUT; to encode each: "
            f"gs-codec batch '{glob}' DST; to merge all: gs-codec convert {glob} OUT; "
            f"as frames of a sequence: gs-codec encode '{glob}' OUT"
        )
    if ctx.info_name == "decode":
        glob = os.path.join(folder, "*.egs")
        return (
            "decode: more than IN and OUT; to decode each: "
            f"gs-codec batch '{glob}' DST --format ply"
        )
    return ""
