"""The public functions that speak Open3D point clouds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from gs_codec import files
from gs_codec.cloud import from_cloud, to_cloud
from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.inspection import Info, inspect_bytes
from gs_codec.io.atomic import atomic_writer
from gs_codec.io.ply import write_ply
from gs_codec.metrics import Comparison, compare_scenes
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from open3d.t.geometry import PointCloud


def read(path: str | Path, extra: Literal["error", "keep", "drop"] = "error") -> PointCloud:
    """Read a PLY or `.egs` file.

    Parameters
    ----------
    path : str or Path
    extra : {"error", "keep", "drop"}
        What to do with properties beyond the INRIA layout.

    Returns
    -------
    open3d.t.geometry.PointCloud
        Float32 attributes ``positions (N, 3)``, ``f_dc (N, 3)``, ``f_rest (N, K, 3)`` with
        K = 0, 3, 8, 15, ``opacity (N, 1)`` (logit), ``log_scale (N, 3)``, ``scale (N, 3)``
        (linear), ``rot (N, 4)`` (wxyz as stored).

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
    """
    return to_cloud(files.read_scene(path, extra))


def write(path: str | Path, cloud: PointCloud, config: Config | None = None) -> None:
    """Write a cloud as ``.ply`` or, encoded with `config`, as ``.egs``.

    Raises
    ------
    InvalidInput
        If the suffix is neither, an attribute is missing, or the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        write_ply(path, from_cloud(cloud, "keep"))
    elif suffix == ".egs":
        with atomic_writer(path) as file:
            file.write(encode(cloud, config))
    else:
        raise InvalidInput(f"{path}: suffix '{suffix}', expected '.ply' or '.egs'")


def encode(cloud: PointCloud, config: Config | None = None) -> bytes:
    """Encode a cloud as an `.egs` stream.

    Parameters
    ----------
    cloud : open3d.t.geometry.PointCloud
        With the attributes `read` gives; of ``log_scale`` and ``scale`` one is enough.
    config : Config, optional

    Raises
    ------
    InvalidInput
        If an attribute is missing or of a wrong type, or a value is not finite.
    """
    config = config or Config()
    return encode_scene(from_cloud(cloud, config.extra), config)[0]


def decode(data: bytes, max_bytes: int | None = None) -> PointCloud:
    """Decode an `.egs` stream; the Gaussians come in Morton order.

    Parameters
    ----------
    data : bytes
    max_bytes : int, optional
        Largest size of the decoded floats; by default 1 GiB or 1000 times the stream.

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    """
    return to_cloud(decode_scene(data, max_bytes=max_bytes))


def inspect(source: bytes | str | Path) -> Info:
    """What an `.egs` file or stream says of itself, without decoding it.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
    """
    return inspect_bytes(source) if isinstance(source, bytes) else files.inspect_file(source)


def compare(first: PointCloud | str | Path, second: PointCloud | str | Path) -> Comparison:
    """Errors of one scene against another, by attribute.

    Files are matched through their stored order: of a scene and its decoded version, the
    first is put in the order of the second. Clouds are compared index by index.

    Raises
    ------
    InvalidInput
        If the numbers of Gaussians differ, or a source cannot be read.
    """
    paths = [isinstance(source, str | Path) for source in (first, second)]
    if all(paths):
        return files.compare_files(first, second)
    if any(paths):
        raise InvalidInput("compare: one file and one cloud, expected two of a kind")
    return compare_scenes(_any_scene(first), _any_scene(second))


def _any_scene(cloud: PointCloud) -> Scene:
    return from_cloud(cloud, "drop")
