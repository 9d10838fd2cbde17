"""Files to damage, ways to damage them, and checks of the result."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from crc32c import crc32c
from scenes import SmallBlocks, random_scene, seen_from, with_far

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.codecs.moving import decode_frames
from gs_codec.config import LOSSLESS, PROFILE_CHOICES
from gs_codec.egs.egs_file import (
    Section,
    SectionId,
    described,
    in_file_order,
    read_file,
    write_file,
)
from gs_codec.egs.frame_sections import timeline_of
from gs_codec.egs.header import Feature
from gs_codec.errors import CorruptStream, GsCodecError, TruncatedStream, UnsupportedVersion
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import GROUPS

HEADER = 44
ENTRY = 20

#: Offsets in the header: number of Gaussians, of Gaussians in a block, and of sections.
COUNT, BLOCK_SIZE, SECTIONS = 16, 36, 40

#: Errors with which a damaged file may be rejected.
REFUSALS = (CorruptStream, TruncatedStream, UnsupportedVersion)

#: Maximum memory of decoding, from FORMAT.md, "Limits": factors on the size limit and on the file,
#: and bytes per thread.
TIMES_LIMIT, TIMES_FILE, A_THREAD = 3, 64, 32 << 20

#: The factor on the size limit for frames of a sequence.
TIMES_OF_FRAMES = 12


#: Argument of `sample` for a file of profile `m` with far Gaussians.
FAR = "far"

#: Argument of `sample` for a file of profile `m` with SH-AC in local bases.
BASIS = "basis"

#: All arguments of `sample`.
SAMPLES = (*PROFILE_CHOICES, FAR, BASIS)


@cache
def sample(profile: str, count: int = 5, degree: int = 1, block_size: int = 3) -> bytes:
    """A file of several blocks, with a comment and two extra properties."""
    carried = {"label": np.arange(count, dtype="<i4"), "mark": np.zeros(count, "<u2")}
    scene = random_scene(count, degree, seed=60)
    if profile == FAR:
        profile, scene = "m", with_far(scene, 1 + count // 5)
    if profile == BASIS:
        # Values so large that bases pay for a few Gaussians.
        profile, scene = "m", seen_from(scene, 1, scale=100.0)
    scene = replace(scene, extra=carried, comments=("a comment",), has_normals=True)
    # more blocks in fewer bytes to damage
    config = SmallBlocks(profile, extra="keep", block_size=block_size)
    return encode_scene(scene, config)[0]


def with_section(data: bytes, section_id: SectionId, change, block: int = 0) -> bytes:
    """The file with the bytes of a section replaced by `change`; None removes it."""
    file = read_file(data)
    content = change(bytes(file.sections.get((section_id, block), b"")))
    changed = {**file.sections, (section_id, block): content}
    sections = [Section(SectionId(i), b, d) for (i, b), d in changed.items() if d is not None]
    found = {section.id for section in sections}
    needed = {
        SectionId.TOOL: Feature.GPCC,
        SectionId.CODER: Feature.TORCHAC,
        SectionId.FAR: Feature.FAR,
        SectionId.BASIS: Feature.LOCAL_BASIS,
    }
    features = sum(feature for section, feature in needed.items() if section in found)
    header = replace(file.header, features=Feature(features))
    return write_file(header, in_file_order(sections))


def flipped(data: bytes, bit: int) -> bytearray:
    """The bytes with one bit flipped."""
    damaged = bytearray(data)
    damaged[bit >> 3] ^= 1 << (bit & 7)
    return damaged


def changed(data: bytes, rng: np.random.Generator) -> bytearray:
    """The bytes with some changed, one by one or a run of them."""
    damaged = bytearray(data)
    for _ in range(rng.integers(1, 6)):
        # Half of the changes are near the front, where the structure is.
        end = min(len(data), 2000) if rng.random() < 0.5 else len(data)
        start = int(rng.integers(8, end))
        size = int(rng.choice([1, 1, 2, 4, 8, 64]))
        kind = rng.integers(4)
        run = damaged[start : start + size]
        if kind == 0:
            run = bytearray(rng.integers(0, 256, len(run), np.uint8).tobytes())
        elif kind == 1:
            run = bytearray([int(rng.choice([0, 255]))] * len(run))
        elif kind == 2:
            run = bytearray((byte + int(rng.choice([-1, 1]))) & 255 for byte in run)
        else:
            other = int(rng.integers(8, len(data)))
            run = (damaged[other : other + len(run)] + run)[: len(run)]
        damaged[start : start + len(run)] = run
    return damaged


def with_checksums(data: bytes | bytearray) -> bytes:
    """The stream with all checksums corrected, as a hostile writer would do; also in its levels.

    So are those of the key frames of a sequence.
    """
    data = bytearray(data)
    sections = struct.unpack_from("<I", data, SECTIONS)[0]
    size = HEADER + ENTRY * sections
    position = size + 4
    if position > len(data):
        return bytes(data)
    for entry in range(HEADER, size, ENTRY):
        (section,) = struct.unpack_from("<H", data, entry)
        (length,) = struct.unpack_from("<Q", data, entry + 8)
        if length > len(data):
            return bytes(data)
        content = bytes(data[position : position + length])
        if section in (SectionId.LEVEL, SectionId.KEY_FRAME) and len(content) > HEADER:
            content = with_checksums(content)
            data[position : position + length] = content
        struct.pack_into("<I", data, entry + 16, crc32c(content))
        position += -(-length // 4) * 4
    struct.pack_into("<I", data, size, crc32c(bytes(data[:size])))
    return bytes(data)


def survive(data: bytes, max_bytes: int | None = 1 << 20, threads: int = 1) -> bool:
    """Decode and inspect untrusted data; return whether it was accepted as a scene.

    The result must be an error of one line, or a valid scene.
    """
    info = None
    try:
        info = inspect_bytes(data)
        info.as_dict()
    except REFUSALS as error:
        assert "\n" not in str(error)  # noqa: PT017
    try:
        scene = decode_scene(data, threads, max_bytes)
    except GsCodecError as error:
        assert isinstance(error, REFUSALS)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return False
    assert info is not None
    assert (scene.count, scene.sh_degree) == (info.count, info.sh_degree)
    for group in GROUPS:
        assert info.profile == LOSSLESS or np.isfinite(getattr(scene, group)).all()
    return True


def survive_sequence(data: bytes, max_bytes: int | None = 1 << 20, threads: int = 1) -> bool:
    """Decode all frames of an untrusted sequence; return whether it was accepted."""
    try:
        file = read_file(data, described)
        with using_threads(threads):
            for scene in decode_frames(file, timeline_of(file), max_bytes=max_bytes):
                for group in GROUPS:
                    assert np.isfinite(getattr(scene, group)).all()
    except GsCodecError as error:
        assert isinstance(error, REFUSALS)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return False
    return True


def peak_of(work: Callable[[], object]) -> int:
    """Maximum bytes allocated at once during `work`."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def most_memory(
    size: int, max_bytes: int | None = None, threads: int = 1, times: int = TIMES_LIMIT
) -> int:
    """Maximum memory for decoding a file of `size` bytes, according to FORMAT.md."""
    limit = max(1 << 30, 1000 * size) if max_bytes is None else max_bytes
    return times * limit + TIMES_FILE * size + A_THREAD * threads
