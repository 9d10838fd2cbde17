"""Zstandard, which knows nothing of scenes: what a general compressor makes of them, bit-exact."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import zstandard

from gs_codec.bench.peers.peer import Extra, Peer, scene_columns, scene_of_columns, scene_of_ply
from gs_codec.io.ply import read_ply, vertex_rows
from gs_codec.scene import Scene
from gs_codec.workers import available_threads

#: A second for 50 MB; level 19 takes 15 to 30 times as long for files up to 13 % smaller.
LEVEL = 9


def zstd_peers(extra: Extra, threads: int | None = None) -> list[Peer]:
    """Zstandard on the PLY's bytes as they are, and on the bytes of each column in planes."""
    version = f"{'.'.join(map(str, zstandard.ZSTD_VERSION))}, level {LEVEL}"
    workers = threads or available_threads()

    def compress(data: bytes) -> bytes:
        return zstandard.ZstdCompressor(level=LEVEL, threads=workers).compress(data)

    def decompress(data: bytes) -> bytes:
        return zstandard.ZstdDecompressor().decompress(data)

    def encode_planes(ply: Path) -> bytes:
        scene = read_ply(ply, extra)
        columns = np.stack(scene_columns(scene)).view(np.uint8)
        planes = columns.reshape(len(columns), scene.count, 4).transpose(0, 2, 1)
        return struct.pack("<2I", len(planes), scene.count) + compress(planes.tobytes())

    def decode_planes(data: bytes) -> Scene:
        number, count = struct.unpack_from("<2I", data)
        planes = np.frombuffer(decompress(data[8:]), np.uint8).reshape(number, 4, count)
        columns = np.ascontiguousarray(planes.transpose(0, 2, 1)).view(np.float32)[..., 0]
        scene = scene_of_columns(columns)
        vertex_rows(scene)
        return scene

    def encode_file(ply: Path) -> bytes:
        return compress(ply.read_bytes())

    def read(data: bytes) -> Scene:
        return scene_of_ply(data, extra)

    return [
        Peer("zstd, PLY", version, encode_file, decompress, read),
        Peer("zstd, byte planes", version, encode_planes, decode_planes, lambda scene: scene),
    ]
