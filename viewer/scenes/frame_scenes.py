"""Frames of sequences as open scenes, and the same moment in several sequences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gs_codec.files.scenes import turn_scene
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.coordinates import CONVENTION, system_of
from gs_codec.report import Progress
from gs_codec.sequences.frame_sources import has_frames
from viewer.scenes.clip import Clip, Moment
from viewer.scenes.opened import Opened, turned


def open_frame(clip: Clip, number: int, progress: Progress | None = None) -> Opened:
    """A frame as a scene; raises as `Clip.read` does."""
    scene = clip.read(number, progress)
    shown = turn_scene(scene, CONVENTION)
    return Opened(
        f"{clip.name}, frame {number}",
        to_cloud(shown),
        system=system_of(scene),
        path=clip.path,
        comments=shown.comments,
        moment=Moment(clip, number),
    )


def open_clip(source: object, max_bytes: int | None = None) -> Clip | None:
    """The sequence of a path; None if it is another scene, or a cloud."""
    if isinstance(source, str | Path) and has_frames(source):
        return Clip(source, max_bytes)
    return None


def first_moment(scenes: Sequence[Opened]) -> Moment | None:
    """The frame of the first scene that is one."""
    return next((scene.moment for scene in scenes if scene.moment is not None), None)


def at_moment(
    scenes: Sequence[Opened], number: int, progress: Progress | None = None
) -> list[Opened]:
    """The scenes, with all sequences at the moment of frame `number` of the first of them.

    Raises
    ------
    gs_codec.GsCodecError
        As `Clip.read` does.
    """
    lead, found = first_moment(scenes), []
    for scene in scenes:
        if lead is not None and scene.moment is not None:
            clip = scene.moment.clip
            wanted = number if clip is lead.clip else clip.number_at(number, lead.clip)
            if wanted != scene.moment.number:
                opened = open_frame(clip, wanted, progress)
                scene = turned(opened) if scene.system_given else opened
        found.append(scene)
    return found
