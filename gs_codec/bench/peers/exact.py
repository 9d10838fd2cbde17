"""General compressors, bit-exact: pcodec on each column, zstd on the bytes of the PLY."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from gs_codec.bench.host import version_of
from gs_codec.bench.peers.peer import Peer, scene_of_ply
from gs_codec.config import Extra
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import GROUPS, Scene, channel_count, group_rows

#: A second for 50 MB; level 19 takes 15 to 30 times as long for files up to 13 % smaller.
LEVEL = 9


def columns_peer(extra: Extra, threads: int | None = None) -> Peer:
    """Pcodec with its default settings on each column, in the order of the file."""
    from pcodec import ChunkConfig, standalone

    config = ChunkConfig()

    def encode(ply: Path) -> bytes:
        scene = read_ply(ply, extra)
        columns = [column for group in GROUPS for column in getattr(scene, group)]
        parts = run_all(lambda column: standalone.simple_compress(column, config), columns, threads)
        sizes = struct.pack(f"<{2 + len(parts)}I", len(parts), scene.count, *map(len, parts))
        return sizes + b"".join(parts)

    def decode(data: bytes) -> Scene:
        number, count = struct.unpack_from("<2I", data)
        bounds = np.cumsum([8 + 4 * number, *struct.unpack_from(f"<{number}I", data, 8)])
        planes = np.empty((number, count), np.float32)

        def unpack(row: int) -> None:
            part = data[bounds[row] : bounds[row + 1]]
            standalone.simple_decompress_into(part, planes[row])

        run_all(unpack, range(number if count else 0), threads)
        rows = group_rows((number - channel_count(0)) // 3)
        ends = np.cumsum([rows[group] for group in GROUPS])
        groups: dict[str, Any] = dict(zip(GROUPS, np.split(planes, ends[:-1]), strict=True))
        scene = Scene(**groups)
        vertex_rows(scene)
        return scene

    return Peer(
        "pcodec, columns", version_of("pcodec") or "unknown", encode, decode, lambda scene: scene
    )


def zstd_peer(extra: Extra, threads: int | None = None) -> Peer:
    """Zstandard on the PLY as it is."""
    version = f"{'.'.join(map(str, zstandard.ZSTD_VERSION))}, level {LEVEL}"
    workers = threads or available_threads()

    def encode(ply: Path) -> bytes:
        return zstandard.ZstdCompressor(level=LEVEL, threads=workers).compress(ply.read_bytes())

    def decode(data: bytes) -> bytes:
        return zstandard.ZstdDecompressor().decompress(data)

    return Peer("zstd, PLY", version, encode, decode, lambda data: scene_of_ply(data, extra))
