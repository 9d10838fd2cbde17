"""``gs-codec compare``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.output import print_json, print_table, print_text


def command(
    first: Annotated[Path, typer.Argument(metavar="A", help="A scene, .ply or .egs.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another version of it.")],
    json: Annotated[bool, typer.Option("--json", help="Print the errors as JSON.")] = False,
) -> None:
    """Show how far two versions of a scene are apart, by attribute."""
    from gs_codec.files import compare_files

    comparison = compare_files(first, second)
    if json:
        print_json({"a": str(first), "b": str(second), **asdict(comparison)})
        return
    print_text(f"{comparison.count:,} Gaussians, matched by {comparison.matched_by}")
    print_table(
        ["attribute", "unit", "max error", "rms error"],
        [[g.name, g.unit, f"{g.max:.6g}", f"{g.rms:.6g}"] for g in comparison.groups],
    )
