"""``gs-codec warm``."""

from __future__ import annotations

from dataclasses import asdict

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import print_text, progress_bar
from gs_codec.cli.typed import Typed, takes
from gs_codec.runtime.threads import using_threads


@takes("threads", "json")
def command(typed: Typed) -> None:
    """Compile all kernels now, so that later commands start without delay."""
    from gs_codec.runtime.kernel_build import warm

    with using_threads(typed["threads"]), progress_bar() as progress:
        report = warm(progress)
    if typed["json"]:
        print_document(**asdict(report) | {"folder": str(report.folder)})
    else:
        print_text(
            f"{report.kernels} kernels, {report.compiled} compiled now; kept in {report.folder}"
        )
