"""Compare two versions of a sequence in rendered views, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from gs_codec.errors import InvalidInput
from gs_codec.metrics.comparison import Comparison
from gs_codec.metrics.views import compare_views
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.wording import counted
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
        Each as in `open_frames`.
    cameras, split, width
        As in `find_cameras`; ``auto`` cameras are estimated from the first frame.
    progress, max_bytes
        As in `compare`.
    **drawn
        Background and device, as in `compare_views`.
    """
    first, second = (open_frames(source, None, "drop", max_bytes) for source in sources)
    if len(first) != len(second):
        raise InvalidInput(
            f"{sources[1]}: {counted(len(second), 'frame')}, expected {len(first):,}, "
            f"as in {sources[0]}"
        )
    advance = step_counter(progress, "frames", len(first))
    views = None
    for name, one, other in zip(first.names, first, second, strict=True):
        views = views or find_cameras(cameras, one, split, width)
        yield name, compare_views(one, other, views, **drawn)
        advance()
