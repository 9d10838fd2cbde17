"""One or several files, read as one scene, span by span."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.matching import without_order
from gs_codec.codecs.part import Part
from gs_codec.codecs.slabs import opened_slabs
from gs_codec.config import Extra
from gs_codec.edit.join import merge_scenes
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.extra_properties import scene_without
from gs_codec.formats.ply.file import scene_of
from gs_codec.formats.registry import open_scene
from gs_codec.runtime.mapped import located
from gs_codec.scene import Scene, join_scenes

#: Number of Gaussians of a PLY that are examined before work begins.
_LOOKED_AT = 4096


@dataclass(frozen=True)
class Source:
    """A file: its number of Gaussians, and the block size of an `.egs` (0 for a PLY)."""

    path: Path
    count: int
    block_size: int = 0

    def read(self, start: int, stop: int, extra: Extra) -> Scene:
        """Gaussians `start` to `stop`, excluding the latter; in an `.egs`, both begin blocks."""
        if not self.block_size:
            return self.pick(slice(start, stop), extra)
        among = range(start // self.block_size, -(-stop // self.block_size))
        with opened_slabs(self.path, Part(), among=among) as slabs:
            scene = join_scenes(list(slabs.scenes()))
        return scene if extra == "keep" else replace(scene, extra={})

    def pick(self, index: slice | NDArray[np.int64], extra: Extra) -> Scene:
        """Some Gaussians of a PLY."""
        with open_scene(self.path) as file:
            return scene_of(file.ply, extra, index=index, tell=False)


@dataclass(frozen=True)
class Span:
    """Gaussians `start` to `stop` of a source; `first` is the index of `start` over all sources."""

    source: Source
    start: int
    stop: int
    first: int


class Gaussians(Protocol):
    """Gaussians that can be read span by span."""

    @property
    def head(self) -> Scene:
        """The scene without Gaussians."""

    @property
    def count(self) -> int:
        """Number of Gaussians."""

    def read(self, span: Span) -> Scene:
        """The Gaussians of a span."""

    def pick(self, span: Span, index: NDArray[np.int64]) -> Scene:
        """The Gaussians of a span with these numbers, counted over all."""


@dataclass(frozen=True)
class Sources:
    """Files that form one scene: their Gaussians, in file order; see `Gaussians`.

    Attributes
    ----------
    listed : tuple of Source
    head : Scene
        The scene without Gaussians.
    extra : {"drop", "error"}
        As in `read_ply`.
    stored_bytes, ratio_bytes : int
        Bytes of the files, and bytes that compression ratios are relative to.
    """

    listed: tuple[Source, ...]
    head: Scene
    extra: Extra
    stored_bytes: int
    ratio_bytes: int

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return sum(source.count for source in self.listed)

    def spans(self, size: int) -> list[Span]:
        """All Gaussians, in spans of about `size`."""
        found, first = [], 0
        for source in self.listed:
            block = max(source.block_size, 1)
            each = max(size // block, 1) * block
            found += [
                Span(source, start, min(start + each, source.count), first + start)
                for start in range(0, source.count, each)
            ]
            first += source.count
        return found

    def read(self, span: Span) -> Scene:
        """The Gaussians of a span."""
        with located(span.source.path):
            return self._fitted(span.source.read(span.start, span.stop, self.extra))

    def pick(self, span: Span, index: NDArray[np.int64]) -> Scene:
        """The Gaussians of a span with these numbers, counted over all."""
        with located(span.source.path):
            if span.source.block_size:
                return self.read(span).take(index - span.first)
            local = index - span.first + span.start
            return self._fitted(span.source.pick(local, self.extra))

    def _fitted(self, scene: Scene) -> Scene:
        """A part, reduced to the properties that all parts have."""
        if len(self.listed) > 1:
            scene = without_order(turn_axes(scene))
        head = self.head
        if scene.sh_degree < head.sh_degree:
            scene = join_scenes([head, scene])
        return replace(scene, comments=head.comments, has_normals=head.has_normals)


def open_sources(paths: Sequence[Path], extra: Extra) -> Sources:
    """Read the headers of files that form one scene; see `merge_scenes`.

    Raises InvalidInput, CorruptStream, TruncatedStream or UnsupportedVersion if a file cannot be
    read in parts, or is not a scene of its format.
    """
    listed, heads, stored, counted = [], [], 0, 0
    for path in paths:
        with open_scene(path) as file:
            if file.format == "egs":
                with opened_slabs(path, Part(), among=()) as slabs:
                    (head,) = slabs.scenes()
                    header = slabs.chosen.file.header
                head = scene_without(path, head, extra)
                source = Source(path, header.count, header.block_size)
                ratio_bytes = header.float_bytes
            elif file.is_read_in_parts:
                # From some Gaussians, which show whether there are normals.
                head = scene_of(file.ply, extra, index=slice(0, _LOOKED_AT)).between(0, 0)
                source = Source(path, file.ply.header.elements["vertex"].count)
                ratio_bytes = file.stored_bytes
            else:
                raise InvalidInput(f"{path}: only .egs and binary PLY of floats are read in parts")
            stored += file.stored_bytes
        listed.append(source)
        heads.append(head)
        counted += ratio_bytes
    if len(heads) > 1:
        heads = [without_order(turn_axes(head)) for head in heads]
    return Sources(tuple(listed), merge_scenes(heads), extra, stored, counted)
