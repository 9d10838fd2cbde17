"""Frames of a sequence, coded after a key frame and decoded. FORMAT.md, section "Sequences"."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.decode import Blocks, empty_groups
from gs_codec.codecs.adaptive.moving_block import AC, GROUP_PARTS, Frame, MovingBlock, contexts_of
from gs_codec.codecs.adaptive.moving_block_encoder import BlockEncoder
from gs_codec.codecs.decode import carried, choose_part
from gs_codec.codecs.pairing import Pairing
from gs_codec.codecs.part import Part
from gs_codec.coding.binary import decode_binary
from gs_codec.coding.clean import finite_ends, sound_gaussians
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.egs.frame_sections import Timeline, open_key_frame, within_frame
from gs_codec.egs.header import Header
from gs_codec.errors import CorruptStream
from gs_codec.formats.limits import most_bytes
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene

#: Runs of neighbouring Gaussians whose order is compared between frames, and their length.
_RUNS, _RUN = 32, 64

#: Minimum share of these that are the same Gaussians in the next frame: in the same order it is
#: at least 0.99, in another at most 0.84; paired with other Gaussians, at most 0.43.
_SAME = 0.95

#: Minimum share of Gaussians with unmistakable partners for which all are paired. If frames were
#: trained one by one, it is at most 0.01 by appearance, 0.03 by centres; else at least 0.55 by one.
_CERTAIN = 0.1

#: Bytes of contexts that any limit on a scene permits.
_CONTEXT_BYTES = 1 << 24


def _moving_blocks(
    key: EgsFile, planes: dict[str, NDArray[np.float32]] | None = None
) -> list[MovingBlock]:
    """The blocks of a key frame, all of whose sections were read; fill its `planes`, if given."""
    header, blocks = key.header, Blocks(key, key.header.sh_degree)

    def decode(block: int) -> MovingBlock:
        if planes is None:
            found = blocks.read(block)
        else:
            found = blocks.fill(block, planes, slice(*header.block_range(block)))
        return MovingBlock(blocks, block, found)

    return run_all(decode, range(header.block_count))


class FrameEncoder:
    """Encodes frames after a key frame, one after another.

    Parameters
    ----------
    key : EgsFile
        The key frame.
    order : ndarray, shape (N,)
        Index in the source of each of its Gaussians.
    source : Scene
        The key frame's source.
    """

    def __init__(self, key: EgsFile, order: NDArray[np.integer], source: Scene) -> None:
        def encoder(block: MovingBlock) -> BlockEncoder:
            members = order[block.start : block.start + block.count]
            return BlockEncoder(block, members, source)

        source, _ = finite_ends(source)
        self._before, self._order = source, order
        self._encoders = run_all(encoder, _moving_blocks(key))
        starts = np.linspace(0, max(len(order) - _RUN, 0), _RUNS).astype(np.int64)
        self._some = order[np.unique(starts[:, None] + np.arange(min(_RUN, len(order))))]

    def ordered(self, source: Scene) -> Scene | None:
        """A frame in the order of the one before; None if it has other or damaged Gaussians."""
        before = self._before
        if (source.count, source.sh_degree) != (before.count, before.sh_degree):
            return None
        source, _ = finite_ends(source)
        if len(self._some) and not self._same(source):
            found = self._paired(source)
            if found is None:
                return None
            source = found
        return source if sound_gaussians(source)[self._order].all() else None

    def _paired(self, source: Scene) -> Scene | None:
        """A frame in the order of the one before, by appearance or else by centres."""
        for by_centres in (False, True):
            pairs = Pairing(self._before, source, by_centres)
            if pairs.certain() >= _CERTAIN:
                found = source.take(pairs.nearest())
                if self._same(found):
                    return found
        return None

    def _same(self, source: Scene) -> bool:
        """Whether the same Gaussians are in the same order as in the frame before."""
        pairs = Pairing(self._before.take(self._some), source.take(self._some))
        return bool(pairs.right(np.arange(len(self._some))).max() >= _SAME)

    def encode(self, source: Scene) -> bytes:
        """The section `motion` of the next frame, whose Gaussians are in order."""
        moved = np.zeros(source.count, np.bool_)
        for group in GROUPS:
            moved |= (getattr(source, group) != getattr(self._before, group)).any(axis=0)
        self._before = source
        coded = run_all(lambda encoder: encoder.encode(source, moved), self._encoders)
        for encoder, (_, frame) in zip(self._encoders, coded, strict=True):
            encoder.block.frame = frame
        sizes = struct.pack(f"<{len(coded)}I", *(len(data) for data, _ in coded))
        return sizes + b"".join(data for data, _ in coded)


def decode_frames(
    file: EgsFile,
    timeline: Timeline,
    first: int = 0,
    stop: int | None = None,
    max_bytes: int | None = None,
) -> Iterator[Scene]:
    """Decode frames `first` to `stop` of a sequence, whose descriptions were read.

    Raises CorruptStream, TruncatedStream or UnsupportedVersion.
    """
    stop = timeline.count if stop is None else stop
    number = timeline.key_of(first)
    while number < stop:
        after = timeline.keys[timeline.keys.index(number) + 1 :]
        end = min(stop, after[0] if after else timeline.count)
        yield from _decode_group(file, number, first, end, max_bytes)
        number = end


def _decode_group(
    file: EgsFile, key: int, first: int, end: int, max_bytes: int | None
) -> Iterator[Scene]:
    """Decode frames of the group of a key frame, from `first` on."""
    found = open_key_frame(file, key)
    with within_frame(key):
        found = choose_part(found, Part(), max_bytes).file
        header, (comments, extra) = found.header, carried(found)
        _check_blocks(header, most_bytes(len(found.data), max_bytes))
        planes: dict[str, Any] = empty_groups(header.sh_degree, header.count)
        blocks = _moving_blocks(found, planes)
    scene = Scene(**planes, has_normals=header.has_normals, comments=comments, extra=extra)
    if key >= first:
        yield scene
    if key + 1 == end:
        return
    planes = {group: plane.copy() for group, plane in planes.items()}
    changed = np.zeros(AC + 1, np.bool_)
    for number in range(key + 1, end):
        with within_frame(number):
            streams = _split(file.only(SectionId.MOTION, number), len(blocks))
            run_all(partial(_decode, planes), zip(blocks, streams, strict=True))
        for block in blocks:
            changed |= block.frame.flags.any(axis=1)
        if number >= first:
            some = [group for group, part in GROUP_PARTS.items() if changed[part]]
            changed[:] = False
            scene = replace(scene, **{group: planes[group].copy() for group in some})
            yield scene


def _check_blocks(header: Header, limit: int) -> None:
    """Refuse blocks so small that contexts take more memory than a scene may."""
    size = 4 * contexts_of(SH_COEFFICIENTS[header.sh_degree]) * header.block_count
    if size > max(limit, _CONTEXT_BYTES):
        raise CorruptStream(
            f"header: contexts of {counted(header.block_count, 'block')} take "
            f"{counted(size, 'byte')}, the limit is {limit:,}"
        )


def _split(data: memoryview, blocks: int) -> list[memoryview]:
    """The streams of blocks in a section `motion`."""
    where = "section 'motion'"
    if len(data) < 4 * blocks:
        raise CorruptStream(f"{where}: {counted(len(data), 'byte')} for {counted(blocks, 'block')}")
    sizes = struct.unpack(f"<{blocks}I", data[: 4 * blocks])
    ends = np.cumsum([4 * blocks, *sizes]).tolist()
    if ends[-1] != len(data):
        raise CorruptStream(f"{where}: {counted(len(data), 'byte')}, expected {ends[-1]:,}")
    return [data[start:stop] for start, stop in zip(ends[:-1], ends[1:], strict=True)]


def _decode(planes: dict[str, NDArray[np.float32]], item: tuple[MovingBlock, memoryview]) -> None:
    """Decode the next frame of a block, and write what changes to the planes."""
    block, stream = item
    found: list[Frame] = []

    def model(state: NDArray, data: NDArray) -> None:
        found.append(block.walk(state, data, None))

    decode_binary(model, stream, f"section 'motion' of {block.where}")
    block.fill(found[0], planes)
