"""Public functions for sequences of Open3D point clouds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.config import Config, RateTarget, as_config, as_rate_target
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import config_for
from gs_codec.formats.cloud import from_cloud, public_cloud, to_cloud
from gs_codec.plan import Plan
from gs_codec.report import Progress
from gs_codec.runtime.arguments import checked
from gs_codec.sequences.frame_decoding import opened_sequence
from gs_codec.sequences.frame_encoding import GROUP, SequenceReport
from gs_codec.sequences.frame_sources import Frames, checked_fps
from gs_codec.sequences.frame_targets import encode_requested

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud


@checked
def encode_sequence(
    source: str | Path | Sequence[PointCloud],
    target: str | Path,
    config: Config | str | None = None,
    plan: Plan | None = None,
    rate: RateTarget | Mapping[str, float] | None = None,
    *,
    group: int = GROUP,
    fps: float | None = None,
    progress: Progress | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
) -> SequenceReport:
    """Encode the frames of a sequence to one file.

    Frames with the same Gaussians, in any order, share a key frame, and only changes are coded.
    Frames are read one at a time. An interrupted run on files resumes when it is repeated.

    Parameters
    ----------
    source : str, Path or sequence of open3d.t.geometry.PointCloud
        A folder, a pattern such as ``frames/*.ply``, a zip of frames, an animation, or an `.egs`
        that is a sequence; or clouds as in `encode`, of which only one is accessed at a time.
    target : str or Path
        The `.egs` to write.
    config : Config or str, optional
        With profile ``l``, ``m`` or ``s``.
    plan : Plan, optional
        Cameras that guide step sizes; without other steps.
    rate : RateTarget or mapping, optional
        A size, ratio, bit rate or PSNR loss to meet; the sequence is then encoded several times. A
        loss is the mean over the views of up to five frames.
    group : int
        Maximum number of frames in the group of a key frame; default 30. To show a frame, a reader
        decodes the group up to it.
    fps : float, optional
        Frames per second; by default as stated in the source, or else 30.
    progress : callable, optional
        Called as ``progress("frames", done, total)``.
    max_bytes : int, optional
        Maximum size of a frame's floats, as in `read`.
    overwrite : bool
        As in `encode_file`.

    Returns
    -------
    SequenceReport
        Number of frames and key frames, sizes, and seconds by stage.

    Raises
    ------
    InvalidInput
        If there are no frames, frames differ in SH degree or coordinate system, options have no
        effect on a sequence, or the target cannot be written.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If a frame is damaged.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> report = gs_codec.encode_sequence([cloud, cloud, cloud], "moving.egs", fps=25)
    >>> report.frames, report.key_frames, report.fps
    (3, 1, 25.0)
    """
    frames = source if isinstance(source, str | Path) else _frames_of(source, fps)
    config = config_for(target, as_config(config))
    request = Request(config, plan, as_rate_target(rate), max_bytes=max_bytes)
    if request.prepares:
        raise InvalidInput("steps that prepare a scene have no effect on a sequence")
    return encode_requested(frames, target, request, group, fps, progress, overwrite)


def _frames_of(clouds: Sequence[PointCloud], fps: float | None) -> Frames:
    """Clouds as frames, named by their numbers; raises InvalidInput if there are none."""
    if not (hasattr(clouds, "__len__") and hasattr(clouds, "__getitem__")):
        raise InvalidInput(f"source: {type(clouds).__name__}, expected a path or list of clouds")
    if not len(clouds):
        raise InvalidInput("no frames, expected at least one")
    names = [f"{number:04d}" for number in range(len(clouds))]
    fps = checked_fps(fps)
    return Frames(names, 0, fps, lambda number: from_cloud(clouds[number]), is_compressed=True)


@checked
def decode_sequence(
    source: str | Path,
    first: int = 0,
    stop: int | None = None,
    *,
    max_bytes: int | None = None,
) -> Iterator[PointCloud]:
    """Decode frames of a sequence, one after another.

    Parameters
    ----------
    source : str or Path
        An `.egs` that is a sequence.
    first, stop : int
        The first frame, from 0, and the one after the last; by default all. At most the group of
        the first is decoded before it.
    max_bytes : int, optional
        As in `decode`, of a frame.

    Returns
    -------
    iterator of open3d.t.geometry.PointCloud
        Clouds as `decode` returns. The Gaussians of a group are in the same order in all of its
        frames.

    Raises
    ------
    InvalidInput
        If there are no such frames, or the file is another scene.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the file is damaged.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> report = gs_codec.encode_sequence([cloud, cloud], "turning.egs")
    >>> [len(frame.point.positions) for frame in gs_codec.decode_sequence("turning.egs", 1)]
    [2000]
    """
    with opened_sequence(source) as sequence:
        to_public = public_cloud
        for scene in sequence.frames(first, stop, max_bytes):
            yield to_public(scene)
            to_public = to_cloud
