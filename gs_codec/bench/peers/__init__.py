"""Other codecs to measure beside ours, each through its own library or program."""

from __future__ import annotations

from gs_codec.bench.peers.exact import columns_peer, zstd_peer
from gs_codec.bench.peers.peer import AbsentPeer, Peer
from gs_codec.bench.peers.splat_transform import splat_transform_peers
from gs_codec.bench.peers.spz import spz_peer
from gs_codec.config import Extra

__all__ = ["AbsentPeer", "Peer", "find_peers"]


def find_peers(extra: Extra, threads: int | None = None) -> list[Peer | AbsentPeer]:
    """All peers, present or not; `extra` is for the reader of the PLY."""
    return [
        spz_peer(extra),
        *splat_transform_peers(threads),
        columns_peer(extra, threads),
        zstd_peer(extra, threads),
    ]
