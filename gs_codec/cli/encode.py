"""``gs-codec encode``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.action_options import say_what_was_done
from gs_codec.cli.documents import print_document
from gs_codec.cli.options import ENCODED_SHOWN
from gs_codec.cli.output import (
    SCENES_PIPED,
    print_prepared,
    print_rendered,
    print_status,
    print_text,
    progress_bar,
    smaller,
)
from gs_codec.cli.streams import check_no_pipes, piped, piped_source
from gs_codec.cli.typed import Typed, takes
from gs_codec.cli.typed_request import request_of
from gs_codec.config import ADAPTIVE_PROFILES, Config, RateTarget
from gs_codec.edit.actions import KINDS
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.plan import Plan
from gs_codec.report import EncodeReport, RateReport, bits_per_gaussian, lacks_loss
from gs_codec.runtime.wording import counted, size_text

#: Options of coding, shared with `batch`.
CODING = (
    "profile", "preset", "cameras", "gt_images", "refine", "prune", "gaussians", "target_size",
    "target_ratio", "max_psnr_drop", "threads", "max_memory", "max_bytes", "extra", "overwrite",
)  # fmt: skip
EXPERT = (Config, RateTarget, Plan)

#: Actions of these commands; their --gaussians prunes by views.
ACTIONS = [name for name in KINDS if name != "gaussians"]


@takes(
    *CODING, "json", expert=EXPERT, hidden=["input_format", "dask", "fps", "group"],
    actions=ACTIONS, actions_hidden=True,
)  # fmt: skip
def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help=SCENES_PIPED)],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help=f"File to write: {ENCODED_SHOWN}; - is stdout.")
    ],
    typed: Typed,
) -> None:
    """Encode a scene to .egs, or to a format that other programs read.

    IN may be the frames of a sequence: a folder, a pattern such as 'frames/*.ply' in quotes, a zip
    of them, or an animation. With --dask, the workers of a cluster divide one giant scene; IN may
    be a folder of its tiles.
    """
    if typed["dask"] is not None:
        request = _request_of_scene(source, target, typed)
        typed.refuse(["max_bytes", "input_format"], "has no effect with --dask")
        check_no_pipes("--dask", source, target)
        done = _encode_divided(source, target, request, typed)
        _tell(source, target, request.config, typed, done)
        return
    with piped_source(source, typed["input_format"]) as file:
        from gs_codec.sequences.frame_sources import has_frames

        if has_frames(file):
            from gs_codec.cli import sequence_commands

            sequence_commands.encode(source, file, target, typed)
        else:
            _encode_scene(source, file, target, typed)


def _request_of_scene(source: Path, target: Path, typed: Typed) -> Request:
    why = f"has no effect on {source}, expected frames of a sequence"
    typed.refuse(["fps", "group", "target_bitrate"], why)
    return request_of(typed, target, typed["dask"])


def _encode_scene(source: Path, file: Path, target: Path, typed: Typed) -> None:
    from gs_codec.files.encode_file import encode_requested

    request = _request_of_scene(source, target, typed)
    config = request.config
    with piped([file], target, f".{config.format}") as (_, out):
        with progress_bar() as progress:
            done = encode_requested(file, out, request, progress, typed["overwrite"])
        _tell(source, target, config, typed, done)


def _encode_divided(source: Path, target: Path, request: Request, typed: Typed) -> EncodeReport:
    """Encode a scene, or the tiles of a folder or glob, with the workers of a cluster."""
    from gs_codec.batch.local import LocalStorage
    from gs_codec.distributed.encoding import encode_divided

    tiles = [location.path for _, location in LocalStorage(str(source)).find((".ply", ".egs"))]
    if not tiles:
        raise InvalidInput(f"{source}: no such file, or no .ply or .egs in this folder")
    if len(tiles) > 1:
        print_status(f"{source}: merging {counted(len(tiles), 'file')} (.ply and .egs)")
    with progress_bar() as progress:
        return encode_divided(tiles, target, request, request.dask, progress, typed["overwrite"])


def _tell(source: Path, target: Path, config: Config, typed: Typed, done: EncodeReport) -> None:
    _say_what_changed(done, config.profile in ADAPTIVE_PROFILES)
    if typed["json"]:
        shown = asdict(done)
        print_document(
            input=str(source), output=str(target), profile=config.profile, format=config.format,
            output_bytes=done.file_bytes,
            bits_per_gaussian=bits_per_gaussian(done.file_bytes, done.count),
            stages=shown.pop("seconds"), **shown,
        )  # fmt: skip
    else:
        _print_report(target, done, config)


def _say_what_changed(report: EncodeReport, lattices: bool) -> None:
    say_what_was_done(report.actions)
    if report.dropped:
        print_status(f"dropped {counted(report.dropped, 'Gaussian')} with NaN or infinity")
    if report.zero_quaternions:
        zeros = counted(report.zero_quaternions, "zero quaternion")
        print_status(f"replaced {zeros} by the identity")
    if lattices and report.rectified:
        print_status(f"values clipped to 400: {report.rectified:,}")


def _print_report(target: Path, report: EncodeReport, config: Config) -> None:
    sizes = smaller(report.input_bytes, report.file_bytes, report.ratio)
    print_text(
        f"{target}: {counted(report.count, 'Gaussian')}, {sizes}, "
        f"{8 * report.file_bytes / max(report.count, 1):.1f} bits per Gaussian, "
        f"{sum(report.seconds.values()):.2f} s"
    )
    if levels := report.section_bytes.get("level"):
        print_text(f"including coarser levels of detail: {size_text(levels)}")
    if report.prepared is not None:
        print_prepared(report.prepared)
    if report.rate is not None:
        _print_rate(report.rate)
    elif report.coarseness != 1 and (report.rendered is None or report.rendered.remedy is None):
        print_text(
            f"step sizes {report.coarseness:.2f}x those of profile {config.profile} "
            "(chosen automatically)"
        )
    loss, rate = report.rendered, report.rate
    if loss is None and not lacks_loss(loss, config.profile, report.prepared is not None):
        return
    if rate is not None and rate.psnr_drop is not None and loss and loss.views == "given":
        print_rendered(loss, _CROPS)
    else:
        print_rendered(loss)


#: Description of the crops that are measured in addition to given views with a loss target.
_CROPS = "crops of other views (half show the smallest Gaussians)"


def _print_rate(rate: RateReport) -> None:
    """Print the result of a rate target."""
    text = counted(rate.encodings, "encoding")
    if rate.coarseness != 1:
        text = f"step sizes {rate.coarseness:.3f}x those of the profile, after {text}"
    if rate.pruned or rate.target.allow_prune:
        text += f"; {counted(rate.pruned, 'Gaussian')} pruned"
    if rate.predicted_bytes is not None:
        text += f"; {size_text(rate.predicted_bytes)} expected"
    if rate.psnr_drop is not None:
        most = rate.target.psnr_drop
        text += f"; views lose {rate.psnr_drop:.3f} dB (asked: at most {most:g})"
    if rate.at_end:
        text += f"; there are no {'coarser' if rate.psnr_drop is not None else 'finer'} step sizes"
    print_text(text)
