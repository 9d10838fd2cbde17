"""Encode a sequence as requested: to a size, bit rate or loss, if that is the target."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gs_codec.coding.clean import clean_scene
from gs_codec.config import ADAPTIVE_PROFILES, EGS
from gs_codec.encoding.loss import Check
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import check_target
from gs_codec.guidance.windows import sample_of
from gs_codec.plan import Plan
from gs_codec.preparation.reference_views import ReferenceViews, draw_reference_views, evenly
from gs_codec.preparation.view_selection import checking_cameras
from gs_codec.rate.search import COARSEST, FINEST, search
from gs_codec.report import Progress
from gs_codec.runtime.kept_logs import keeping_new
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene
from gs_codec.sequences.frame_decoding import opened_sequence
from gs_codec.sequences.frame_encoding import (
    GROUP,
    SequenceReport,
    encode_frames,
    rate_of,
)
from gs_codec.sequences.frame_sources import Frames, open_frames

#: A file, and a loss, may be smaller than the target by at most this share. Losses of guided frames
#: change irregularly, by 10 % in a small sequence.
_SIZE_TOLERANCE, _DROP_TOLERANCE = 0.02, 0.15

#: Approximate change of log2 of the size, and of the loss, when step sizes double.
_SIZE_SLOPE, _DROP_SLOPE = -0.6, 1.7

#: Loggers that warn of the cameras whenever frames are encoded.
_OF_CAMERAS = ("gs_codec.cameras.colmap", "gs_codec.preparation.view_selection")

#: Maximum number of frames in which a loss is measured.
_MEASURED = 5


def encode_requested(
    source: str | Path | Frames,
    target: str | Path,
    request: Request,
    group: int = GROUP,
    fps: float | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> SequenceReport:
    """Encode frames as requested; see `encode_sequence` for the arguments."""
    if group < 1:
        raise InvalidInput(f"group: {group}, expected at least 1")
    config = request.config
    if config.format != EGS or config.profile not in ADAPTIVE_PROFILES or config.lod:
        raise InvalidInput(
            f"{target}: frames are encoded to an .egs by profile {', '.join(ADAPTIVE_PROFILES)}, "
            "without levels of detail"
        )
    if config.strict and (request.plan is None or request.rate is not None):
        raise InvalidInput("strict: has no effect on a sequence without cameras, or with a target")
    encode = encode_frames if request.rate is None else _encode_to_target
    if isinstance(source, Frames):
        check_target([], target, (".egs",), overwrite)
        return encode(source, target, request, group, progress)
    check_target([source], target, (".egs",), overwrite)
    frames = open_frames(source, fps, "drop", request.max_bytes)
    with located(source):
        return encode(frames, target, request, group, progress)


def _encode_to_target(
    source: Frames,
    target: str | Path,
    request: Request,
    group: int,
    progress: Progress | None,
) -> SequenceReport:
    """Encode a sequence at the step sizes that meet a target, by trials.

    Raises InvalidInput if the target is not one of a sequence, or is out of reach.
    """
    rate, tried = request.rate, dict[float, SequenceReport]()
    assert rate is not None
    if rate.bits is not None or rate.allow_prune:
        raise InvalidInput("target: bits per Gaussian and pruning have no effect on a sequence")
    most, views = rate.psnr_drop, list[_FrameViews]()
    interval, slope = (1 - _SIZE_TOLERANCE, 1.0), _SIZE_SLOPE
    if most is not None:
        request = replace(request, plan=request.plan or Plan())
        interval, slope = ((1 - _DROP_TOLERANCE) * most, most), _DROP_SLOPE
        views = _views_of_frames(source, request, progress)
    seconds = len(source) / float(rate_of(source))
    made = tempfile.TemporaryDirectory(dir=Path(target).parent, prefix=".")
    with made as folder, keeping_new(_OF_CAMERAS, set()):

        def measure(octaves: float) -> float:
            """The loss, or the size relative to the limit."""
            config = replace(request.config, coarseness=2.0**octaves)
            own, path = replace(request, config=config), Path(folder, f"{octaves}.egs")
            if octaves not in tried:
                tried[octaves] = encode_frames(source, path, own, group, progress, calibrates=False)
                if most is not None:
                    tried[octaves] = _with_loss(tried[octaves], path, views)
            report = tried[octaves]
            if report.psnr_drop is not None:
                return report.psnr_drop
            limit = rate.limit(0, source.ratio_bytes(report.float_bytes), seconds)
            return report.file_bytes / max(limit or 0, 1)

        found = search(measure, *interval, 0.0, slope)
        if found is None:
            ends = (COARSEST, FINEST) if most is None else (FINEST, COARSEST)
            if measure(ends[0]) > interval[1]:
                raise InvalidInput(f"target: unreachable, expected {_least(tried[ends[0]])}")
            measure(found := ends[1])
        os.replace(Path(folder, f"{found}.egs"), target)
    times: dict[str, float] = {}
    for each in tried.values():
        times = {name: times.get(name, 0) + took for name, took in each.seconds.items()}
    return replace(tried[found], seconds=times, encodings=len(tried))


def _least(report: SequenceReport) -> str:
    """The target that is just in reach."""
    if report.psnr_drop is not None:
        return f"at least {report.psnr_drop:.4f} dB"
    size, rate = counted(report.file_bytes, "byte"), report.bits_per_second / 1e6
    return f"at least {size}, {rate:.3g} Mbit/s, or at most {report.ratio:.4g}x"


class _FrameViews(NamedTuple):
    """Held-out views of a frame; with estimated cameras, crops from other places."""

    number: int
    name: str
    views: ReferenceViews
    check: Check | None

    def loss(self, coded: Scene) -> float:
        """PSNR loss of a decoded frame, dB."""
        found = None if self.check is None else self.check.measure(coded)
        return self.views.drop(self.views.errors(coded), 0.0) if found is None else found.loss


def _views_of_frames(
    source: Frames, request: Request, progress: Progress | None
) -> list[_FrameViews]:
    """Held-out views of a few frames; all have the cameras of the first one.

    In views between estimated cameras, which guide the encoder, the loss would seem too small.
    """
    plan, found = request.plan, list[_FrameViews]()
    assert plan is not None
    numbers = evenly(range(len(source)), _MEASURED)
    for number in numbers:
        scene = source.read(number)
        if not found:
            cameras = evenly(checking_cameras(scene, plan), max(plan.views // len(numbers), 1))
        views = draw_reference_views(scene, cameras, plan.background, progress)
        views, check = replace(views, source=None), None  # one scene at a time
        if plan.estimates:
            clean, _ = clean_scene(scene, request.config)
            check = replace(Check.by_plan(clean, plan), scene=sample_of(clean))
        found.append(_FrameViews(number, source.names[number], views, check))
    return found


def _with_loss(
    report: SequenceReport, path: Path, measured: Sequence[_FrameViews]
) -> SequenceReport:
    """The report of a file, with the loss of views."""
    drops = []
    with opened_sequence(path) as sequence:
        for each in measured:
            [scene] = sequence.frames(each.number, each.number + 1)
            drops.append((each.loss(scene), each.name))
    mean = float(np.mean([drop for drop, _ in drops]))
    worst_drop, worst = max(drops)
    return replace(report, psnr_drop=mean, worst_frame=worst, worst_drop=worst_drop)
