"""Niantic's spz, through the Python module of its own repository."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.bench.host import version_of
from gs_codec.bench.peers.peer import AbsentPeer, Peer
from gs_codec.config import Extra
from gs_codec.formats.ply.file import read_ply
from gs_codec.scene import Scene


def spz_peer(extra: Extra, module: str = "spz") -> Peer | AbsentPeer:
    """Niantic's spz as it comes."""
    how = "'make peers', or pip install git+https://github.com/nianticlabs/spz"
    try:
        spz = import_module(module)
    except ImportError:
        return AbsentPeer("spz", f"spz: not installed ({how})")
    if not hasattr(spz, "save_spz_to_buffer"):
        return AbsentPeer("spz", f"spz: module '{module}' is not Niantic's ({how})")
    pack, unpack = spz.PackOptions(), spz.UnpackOptions()
    pack.from_coord = unpack.to_coord = spz.CoordinateSystem.RDF

    def encode(ply: Path) -> bytes:
        cloud = _to_cloud(spz.GaussianCloud(), read_ply(ply, extra))
        with _silenced():
            return spz.save_spz_to_buffer(cloud, pack)

    def decode(data: bytes) -> dict[str, Any]:
        with _silenced():
            cloud = spz.load_spz_from_buffer(data, unpack)
        names = ("positions", "colors", "sh", "alphas", "scales", "rotations")
        return {"antialiased": cloud.antialiased} | {name: getattr(cloud, name) for name in names}

    name = f"spz v{pack.version}"
    return Peer(name, version_of("spz") or "unknown", encode, decode, _from_cloud)


def _to_cloud(cloud: Any, scene: Scene) -> Any:
    """Fill spz's cloud: rows, not planes; the colours of a coefficient together; w last."""
    cloud.antialiased = scene.antialiased
    cloud.sh_degree = scene.sh_degree
    cloud.positions = scene.positions.T.ravel()
    cloud.colors = scene.f_dc.T.ravel()
    cloud.sh = scene.f_rest.reshape(3, -1, scene.count).transpose(2, 1, 0).ravel()
    cloud.alphas = scene.opacity[0]
    cloud.scales = scene.log_scale.T.ravel()
    cloud.rotations = scene.rot[[1, 2, 3, 0]].T.ravel()
    return cloud


def _from_cloud(cloud: dict[str, Any]) -> Scene:
    """The inverse of `_to_cloud`; infinite logits, as alphas of 0 and 255 decode to, are cut."""
    count = len(cloud["alphas"])

    def planes(name: str, channels: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(cloud[name].reshape(count, channels).T)

    coefficients = len(cloud["sh"]) // (3 * count) if count else 0
    sh = cloud["sh"].reshape(count, coefficients, 3).transpose(2, 1, 0)
    return Scene(
        positions=planes("positions", 3),
        f_dc=planes("colors", 3),
        f_rest=np.ascontiguousarray(sh).reshape(3 * coefficients, count),
        opacity=np.clip(planes("alphas", 1), -30, 30),
        log_scale=planes("scales", 3),
        rot=planes("rotations", 4)[[3, 0, 1, 2]],
        comments=("SplatRenderMode: mip",) if cloud["antialiased"] else (),
    )


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Drop what a library writes to stdout, where results go."""
    sys.stdout.flush()
    saved, sink = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(sink)
