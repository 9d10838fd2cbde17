"""Compare two versions of a sequence in rendered views, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gs_codec.egs.frame_sections import is_sequence
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import turn_axes
from gs_codec.metrics.comparison import Comparison
from gs_codec.metrics.views import compare_views
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene
from gs_codec.sequences.frame_decoding import opened_sequence
from gs_codec.sequences.frame_sources import open_frames
from gs_codec.views.find import find_cameras


def compare_frames(
    sources: Sequence[str | Path],
    cameras: str | Path,
    split: str = "all",
    width: int | None = None,
    progress: Progress | None = None,
    max_bytes: int | None = None,
    **drawn: Any,
) -> Iterator[tuple[str, Comparison]]:
    """Name of each frame, and the comparison of both versions of it in the same views.

    Raises InvalidInput if the numbers of frames differ, or as `compare` does.

    Parameters
    ----------
    sources : sequence of two paths
        Each an `.egs` that is a sequence, or frames as in `open_frames`.
    cameras, split, width
        As in `find_cameras`; ``auto`` cameras are estimated from the first frame.
    progress, max_bytes
        As in `compare`.
    **drawn
        Background and device, as in `compare_views`.
    """
    with ExitStack() as stack:
        names, first = _frames(sources[0], stack, max_bytes)
        others, second = _frames(sources[1], stack, max_bytes)
        if len(names) != len(others):
            raise InvalidInput(
                f"{sources[1]}: {counted(len(others), 'frame')}, expected {len(names):,}, "
                f"as in {sources[0]}"
            )
        advance = step_counter(progress, "frames", len(names))
        views = None
        for name, *pair in zip(names, first, second, strict=True):
            one, other = map(turn_axes, pair)
            views = views or find_cameras(cameras, one, split, width)
            yield name, compare_views(one, other, views, **drawn)
            advance()


def _frames(
    source: str | Path, stack: ExitStack, max_bytes: int | None
) -> tuple[Sequence[str], Iterator[Scene]]:
    """Names of the frames of a source, and the frames."""
    if is_sequence(source):
        sequence = stack.enter_context(opened_sequence(source))
        timeline = sequence.timeline
        names = [timeline.name_of(number) for number in range(timeline.count)]
        return names, sequence.frames(max_bytes=max_bytes)
    frames = open_frames(source, None, "drop", max_bytes)
    return frames.names, iter(frames)
