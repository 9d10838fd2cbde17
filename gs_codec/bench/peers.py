"""Other codecs to measure beside: spz, and pcodec on each column."""

from __future__ import annotations

import contextlib
import os
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.io.ply import read_ply, vertex_rows
from gs_codec.scene import GROUPS, Scene
from gs_codec.workers import run_all

Extra = Literal["error", "keep", "drop"]


@dataclass(frozen=True)
class Peer:
    """A codec, ours or another, and how it is called.

    Attributes
    ----------
    name : str
    version : str
        Of the program, and of its file format where that has one.
    encode : callable
        From the path of a PLY to the bytes of the file.
    decode : callable
        From these bytes to floats, as the codec lays them out.
    scene : callable
        From what `decode` returned to a `Scene`, which is not timed.
    once : bool
        Whether it is too slow to be timed more than once.
    """

    name: str
    version: str
    encode: Callable[[Path], bytes]
    decode: Callable[[bytes], Any]
    scene: Callable[[Any], Scene]
    once: bool = False


@dataclass(frozen=True)
class AbsentPeer:
    """A codec that cannot be called: its name, why, and what would help."""

    name: str
    absent: str


def find_peers(extra: Extra, threads: int | None = None) -> list[Peer | AbsentPeer]:
    """All peers, present or not; `extra` is for the reader of the PLY."""
    return [spz_peer(extra), columns_peer(extra, threads)]


def spz_peer(extra: Extra, module: str = "spz") -> Peer | AbsentPeer:
    """Niantic's spz as it comes, through the Python module of its own repository."""
    how = "pip install git+https://github.com/nianticlabs/spz"
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
    return Peer(name, _version_of("spz"), encode, decode, _from_cloud)


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


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


def columns_peer(extra: Extra, threads: int | None = None) -> Peer:
    """Pcodec as it comes, bit-exact, on each column in the order of the file."""
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
        scene = _from_planes(planes)
        vertex_rows(scene)
        return scene

    return Peer("pcodec, columns", _version_of("pcodec"), encode, decode, lambda scene: scene)


def _from_planes(planes: NDArray[np.float32]) -> Scene:
    rows = {"positions": 3, "f_dc": 3, "f_rest": 0, "opacity": 1, "log_scale": 3, "rot": 4}
    rows["f_rest"] = len(planes) - sum(rows.values())
    parts = np.split(planes, np.cumsum([rows[group] for group in GROUPS])[:-1])
    groups: dict[str, Any] = dict(zip(GROUPS, parts, strict=True))
    return Scene(**groups)


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
