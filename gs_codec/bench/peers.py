"""Other codecs to compare with, each through its own library or program."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from gs_codec.bench.host import version_of
from gs_codec.config import PROFILE_CHOICES, Extra
from gs_codec.errors import InvalidInput, MissingTool, ToolFailed
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows
from gs_codec.runtime.optional import is_available
from gs_codec.runtime.programs import Limits, find_program, run_on_files
from gs_codec.runtime.threads import available_threads, run_all
from gs_codec.scene import GROUPS, Scene, channel_count, group_rows


@dataclass(frozen=True)
class Peer:
    """A codec, ours or another, and how to call it.

    Attributes
    ----------
    name : str
    version : str
        Version of the program, and of its file format or level if any.
    encode : callable
        From the path of a PLY to the bytes of the file. Raises `ToolFailed` if it fails or exceeds
        its time; so do the other functions.
    decode : callable
        From these bytes to floats, in the codec's own layout.
    scene : callable
        From the result of `decode` to a `Scene`; not timed.
    once : bool
        Whether it is too slow to be timed more than once.
    own_process : bool
        Whether it is a program that is started each time; its start is part of the time.
    """

    name: str
    version: str
    encode: Callable[[Path], bytes]
    decode: Callable[[bytes], Any]
    scene: Callable[[Any], Scene]
    once: bool = False
    own_process: bool = False


@dataclass(frozen=True)
class AbsentPeer:
    """A codec that cannot be called: its name, the reason, and a remedy."""

    name: str
    absent: str


def scene_of_ply(data: bytes, extra: Extra) -> Scene:
    """The scene in the bytes of a PLY file."""
    with tempfile.TemporaryDirectory(prefix="gs_codec-") as folder:
        path = Path(folder, "decoded.ply")
        path.write_bytes(data)
        return read_ply(path, extra)


#: A second for 50 MB; level 19 takes 15 to 30 times as long for files up to 13 % smaller.
ZSTD_LEVEL = 9


def columns_peer(extra: Extra, threads: int | None = None) -> Peer:
    """Pcodec with its default settings on each column, in file order."""
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
    """Zstandard on the unchanged PLY."""
    version = f"{'.'.join(map(str, zstandard.ZSTD_VERSION))}, level {ZSTD_LEVEL}"
    workers = threads or available_threads()

    def encode(ply: Path) -> bytes:
        return zstandard.ZstdCompressor(level=ZSTD_LEVEL, threads=workers).compress(
            ply.read_bytes()
        )

    def decode(data: bytes) -> bytes:
        return zstandard.ZstdDecompressor().decompress(data)

    return Peer("zstd, PLY", version, encode, decode, lambda data: scene_of_ply(data, extra))


def spz_peer(extra: Extra, module: str = "spz") -> Peer | AbsentPeer:
    """Niantic's spz with its defaults."""
    how = "'make peers', or pip install git+https://github.com/nianticlabs/spz"
    if not is_available(module):
        return AbsentPeer("spz", f"spz: not installed ({how})")
    spz = import_module(module)
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
    """Fill spz's cloud: rows instead of planes; colours of a coefficient together; w last."""
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
    """Invert `_to_cloud`; infinite logits, from alphas of 0 and 255, are clamped."""
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
    """Discard what a library writes to stdout, which is for results."""
    sys.stdout.flush()
    saved, sink = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(sink, 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(sink)


#: Environment variable with the path of the program.
PROGRAM_VARIABLE = "GS_CODEC_SPLAT_TRANSFORM"

_SPLAT_TRANSFORM = "splat-transform"

#: Folder where `make peers` installs it.
_PROGRAM_FOLDER = "peers/node_modules/.bin"

_INSTALL = (
    "'make peers', or npm install -g @playcanvas/splat-transform@3; "
    f"found by {PROGRAM_VARIABLE} or PATH"
)

#: Its formats, by suffix. SOG clusters SH, which takes minutes on a CPU.
_SUFFIXES = {"compressed.ply": ".compressed.ply", "spz": ".spz", "SOG": ".sog"}
_SLOW = "SOG"

#: Time limit in seconds of wall time.
SECONDS = 120.0

_MOST_BYTES = 1 << 36


def find_splat_transform() -> tuple[str, str]:
    """Path and version of the program: from the environment variable, PATH, or this environment.

    Raises MissingTool if there is no such program, or it is a different one.
    """
    given, folder = os.environ.get(PROGRAM_VARIABLE), os.path.join(sys.prefix, _PROGRAM_FOLDER)
    path, line = find_program(_SPLAT_TRANSFORM, given, "--version", _INSTALL, _limits(), folder)
    return path, line.removeprefix(_SPLAT_TRANSFORM).strip()


def splat_transform_peers(threads: int | None = None) -> list[Peer | AbsentPeer]:
    """A peer for each format that the program writes, or the reason why there is none."""
    try:
        path, version = find_splat_transform()
    except MissingTool as error:
        return [AbsentPeer(_SPLAT_TRANSFORM, str(error))]
    command = [path, "--quiet", "--gpu", "cpu"]
    if threads is not None:
        command += ["--max-workers", str(threads)]
    return [_peer(command, version, label, f"coded{end}") for label, end in _SUFFIXES.items()]


def _peer(command: list[str], version: str, label: str, coded: str) -> Peer:
    def convert(source: str, inputs: Mapping[str, bytes], target: str) -> bytes:
        return run_on_files([*command, source, target], inputs, target, _limits(), _MOST_BYTES)

    def encode(ply: Path) -> bytes:
        return convert(str(ply.absolute()), {}, coded)

    def decode(data: bytes) -> bytes:
        return convert(coded, {coded: data}, "decoded.ply")

    name, slow = f"{_SPLAT_TRANSFORM}, {label}", label == _SLOW
    return Peer(name, version, encode, decode, _read, once=slow, own_process=True)


def own_peers(texts: Sequence[str]) -> tuple[Peer, ...]:
    """Codecs that are given by their commands, each as ``NAME: ENCODE; DECODE``.

    Both commands contain ``{in}`` and ``{out}`` and are run by a shell, in a folder of their own.
    The first makes a file of a PLY, whose ``{out}`` may have a suffix; the second makes a PLY of
    that file, whose ``{in}`` has the same suffix. Raises InvalidInput if a text is different, or a
    name is not new.
    """
    peers: dict[str, Peer] = {}
    for text in texts:
        name, _, commands = (part.strip() for part in text.partition(":"))
        encode, *others = commands.split(";")
        if (
            not name
            or len(others) != 1
            or not all(
                field in command for field in ("{in}", "{out}") for command in (encode, *others)
            )
        ):
            raise InvalidInput(
                f"codec '{text}': expected NAME: ENCODE; DECODE, with {{in}} and {{out}} in each "
                "command"
            )
        if name in peers or name.partition(",")[0] in PROFILE_CHOICES:
            raise InvalidInput(f"codec '{text}': the name '{name}' is taken")
        peers[name] = _own_peer(name, encode.strip(), others[0].strip())
    return tuple(peers.values())


def _own_peer(name: str, encode: str, decode: str) -> Peer:
    suffix = re.match(r"[.\w]*", encode.partition("{out}")[2])
    coded = f"coded{suffix[0] if suffix else ''}"

    def run(command: str, source: str, inputs: Mapping[str, bytes], target: str, out: str) -> bytes:
        filled = command.replace("{in}", source).replace("{out}", target)
        return run_on_files(["/bin/sh", "-c", filled], inputs, out, _OWN, _MOST_BYTES)

    return Peer(
        name,
        encode,
        lambda ply: run(encode, shlex.quote(str(ply.absolute())), {}, "coded", coded),
        lambda data: run(decode, "coded", {coded: data}, "decoded.ply", "decoded.ply"),
        _read,
        own_process=True,
    )


#: Limits of codecs that are given by their commands: an hour, and the processor time of eight.
_OWN = Limits(3600.0, 8 * 3600, None)


def _limits() -> Limits:
    return Limits(SECONDS, 3600, None)


def _read(ply: bytes) -> Scene:
    """The scene of a PLY; infinite logits, from alphas of 0 and 255, are clamped."""
    try:
        scene = scene_of_ply(ply, "error")
    except InvalidInput as error:
        raise ToolFailed(f"wrote a PLY that cannot be read: {error}") from error
    return replace(scene, opacity=np.clip(scene.opacity, -30, 30))


def find_peers(extra: Extra, threads: int | None = None) -> list[Peer | AbsentPeer]:
    """All peers, present or absent; `extra` is for the reader of the PLY."""
    return [
        spz_peer(extra),
        *splat_transform_peers(threads),
        columns_peer(extra, threads),
        zstd_peer(extra, threads),
    ]
