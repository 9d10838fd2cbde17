"""Public functions that read, write, encode and decode Open3D point clouds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, overload

from gs_codec.codecs import decode_part
from gs_codec.codecs.inspection import Info, inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.config import LOSSLESS, Config, Extra, RateTarget, as_config, as_rate_target
from gs_codec.encoding import order
from gs_codec.encoding.request import Request
from gs_codec.files.encode_file import read_source
from gs_codec.files.scenes import inspect_file, read_scene
from gs_codec.files.suffixes import PLAIN
from gs_codec.files.writing import tell_lost, write_scene
from gs_codec.formats.cloud import from_cloud, public_cloud
from gs_codec.formats.ply.writer import vertex_rows
from gs_codec.formats.several_scenes import refuse_several
from gs_codec.plan import Plan
from gs_codec.report import Progress, RateReport
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.mapped import located, opened

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud


@checked
def read(
    path: str | Path,
    extra: Extra = "keep",
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> PointCloud:
    """Read a scene in any supported format, recognised by content.

    ``formats/FORMATS.md`` lists the formats.

    Parameters
    ----------
    path : str or Path
        The suffix matters only if the content does not identify the format.
    extra : {"keep", "drop", "error"}
        Handling of properties beyond the 3DGS layout, such as normals that are not all zero: keep
        them as attributes ``(N, 1)``, drop them, or reject the file. PLY elements other than
        ``vertex`` are never kept. A log message names everything that is dropped.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` in the calling thread; an exception in it aborts
        the work.
    max_bytes : int, optional
        Maximum size of the scene's floats; by default 1 GiB or 1000 times the file size.

    Returns
    -------
    open3d.t.geometry.PointCloud
        Float32 attributes ``positions (N, 3)``, ``f_dc (N, 3)``, ``f_rest (N, K, 3)`` with K = 0,
        3, 8, 15 for SH degree 0 to 3, ``opacity (N, 1)`` (logit), ``log_scale (N, 3)``, ``scale (N,
        3)`` (linear), ``rot (N, 4)`` (wxyz as stored). Coordinates are right, down, forward: a
        scene that states another system is converted. Opacities of 0 and 1 and
        scales of 0, whose logits and logarithms are infinite, are replaced by finite numbers that
        render the same; a warning counts them. Comments are not kept, nor is the antialias flag,
        which a warning says.

    Raises
    ------
    InvalidInput
        If the file cannot be read, is of no known format, decodes to more than `max_bytes`, or has
        properties that `extra` rejects.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If it is an `.egs` file that is damaged, or newer than this version.
    MissingTool, ToolFailed
        If Open3D is not installed; or if its points are coded by G-PCC, and ``tmc3`` is not
        installed or fails.

    Notes
    -----
    A cloud may be edited with Open3D's methods before it is encoded or written. Open3D 0.20 has
    these limits:

    - ``translate``, and the methods that select or append points, are correct.
    - ``scale`` changes ``scale`` but not ``log_scale``, which keeps the exact values of the file.
      Delete the outdated one; otherwise `encode` and `write` raise `InvalidInput`.
    - ``rotate`` is correct for SH degree 0. It rotates ``f_rest`` wrongly, so view-dependent
      colours become wrong. gs_codec cannot detect this.
    - ``transform`` changes only ``positions``, as its warning says. gs_codec cannot detect this.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> cloud.point.positions.shape, cloud.point.f_rest.shape
    (SizeVector[2000, 3], SizeVector[2000, 15, 3])

    Scale a scene by two:

    >>> larger = cloud.clone().scale(2, [0, 0, 0])
    >>> del larger.point["log_scale"]
    >>> gs_codec.write("larger.ply", larger)
    """
    return public_cloud(read_scene(path, extra, progress, max_bytes=max_bytes))


@checked
def write(
    path: str | Path, cloud: PointCloud, config: Config | str | None = None, overwrite: bool = False
) -> None:
    """Write a cloud as ``.ply``, ``.pt`` or, encoded, ``.egs``...; atomically.

    Parameters
    ----------
    path : str or Path
        The suffix selects the format. A PLY has the INRIA trainer's layout, a ``.pt`` is a
        checkpoint of gsplat, a ``.ckpt`` of splatfacto, a ``.csv`` a table of attributes.
    cloud : open3d.t.geometry.PointCloud
        A cloud with the attributes from `read`. One of ``log_scale`` and ``scale`` is enough; if
        both are present, they must agree.
    config : Config or str, optional
        How to encode the file, or the name of a profile. Its `extra` controls additional
        attributes: by default, a PLY, a CSV and profile ``lossless`` keep them. Log messages name
        everything that is dropped.
    overwrite : bool
        Whether to replace an existing file, once the new one is complete. By default, an existing
        file is an error.

    Raises
    ------
    InvalidInput
        If the suffix is unknown, an attribute is missing, ``log_scale`` and ``scale`` disagree, a
        value to be coded is not finite, or the file cannot be written.
    MissingTool, ToolFailed
        If `config` selects G-PCC or torchac, which is not installed or fails.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> gs_codec.write("small.egs", cloud, gs_codec.Config("s"))
    >>> gs_codec.write("small.ply", gs_codec.read("small.egs"))
    """
    config = as_config(config)
    suffix = Path(path).suffix.lower()
    extra = config.chosen_extra(keeps=suffix in PLAIN)
    exact = suffix == ".egs" and config.profile == LOSSLESS
    write_scene(path, from_cloud(cloud, extra, exact=exact), config, overwrite)


@overload
def encode(
    source: PointCloud | str | Path,
    config: Config | str | None = None,
    plan: Plan | None = None,
    rate: None = None,
    *,
    progress: Progress | None = None,
) -> bytes: ...


@overload
def encode(
    source: PointCloud | str | Path,
    config: Config | str | None = None,
    plan: Plan | None = None,
    *,
    rate: RateTarget | Mapping[str, float],
    progress: Progress | None = None,
) -> tuple[bytes, RateReport]: ...


@checked
def encode(
    source: PointCloud | str | Path,
    config: Config | str | None = None,
    plan: Plan | None = None,
    rate: RateTarget | Mapping[str, float] | None = None,
    *,
    progress: Progress | None = None,
) -> bytes | tuple[bytes, RateReport]:
    """Encode a scene as an `.egs` stream, or in another format; `encode_file` has these arguments.

    The same scene, options and version give the same bytes. Log messages name everything that the
    format cannot represent. Profiles ``paper-*`` use the method of EntropyGS (arXiv 2508.10227,
    Section 4); ``l``, ``m`` and ``s`` are smaller at the same quality.

    Parameters
    ----------
    source : open3d.t.geometry.PointCloud, or path of a scene
        A cloud as in `write`, or a file, whose stream equals the output of `encode_file`.
    config : Config or str, optional
        A configuration or the name of a profile, by default ``m``.
    plan : Plan, optional
        Steps of preparation, if any, and views that guide profiles ``l``, ``m`` and ``s``: bits are
        spent where they are visible.
    rate : RateTarget or mapping, optional
        Rate target for profiles ``l``, ``m`` and ``s``: one of ``size`` (bytes), ``ratio``,
        ``bits`` (per Gaussian) and ``psnr_drop`` (dB); and ``allow_prune``. The ratio is relative
        to the PLY written by `write`.
    progress : callable, optional
        As in `read`.

    Returns
    -------
    data : bytes
        The stream, or the content of a file in `config.format`.
    report : RateReport
        Only with a rate target: the step sizes, and the predicted and actual size or quality.

    Raises
    ------
    InvalidInput
        As in `write`; or if the rate target cannot be reached.
    MissingTool, ToolFailed
        As in `write`.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> data = gs_codec.encode(cloud)
    >>> small = gs_codec.encode("scene.ply", "s")
    >>> seen = gs_codec.encode(cloud, plan=gs_codec.Plan(cameras="cameras.json"))

    With a size target, which is never exceeded:

    >>> data, report = gs_codec.encode(cloud, rate={"size": 40_000})
    >>> len(data) == report.file_bytes <= 40_000
    True
    """
    config = as_config(config)
    request = Request(config, plan, as_rate_target(rate))
    exact = config.profile == LOSSLESS and plan is None
    if isinstance(source, str | Path):
        scene, _, ply_bytes = read_source(source, config, None, exact)
    else:
        scene = from_cloud(source, config.chosen_extra(), exact=exact)
        ply_bytes = vertex_rows(scene).nbytes if rate is not None else 0
    parts, report = order.encode(scene, request, progress, ply_bytes)
    data = b"".join(parts)
    tell_lost(f".{config.format}", report.lost)
    return data if report.rate is None else (data, report.rate)


@checked
def decode(
    source: bytes | bytearray | memoryview | str | Path,
    part: Part | None = None,
    *,
    threads: int | None = None,
    tmc3: str | Path | None = None,
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> PointCloud:
    """Decode an `.egs` stream; Gaussians are in Morton order unless their order was stored.

    The same bytes give the same floats on every machine. `decode_file` has the same arguments.

    Parameters
    ----------
    source : bytes, bytearray, memoryview, str or Path
        A complete stream, from `encode` or a file; or the path of a file.
    part : Part, optional
        A box, a lower SH degree, or both; a level of detail; or the blocks for a view.
    threads : int, optional
        Worker threads, 1-256; by default one per available processor, or a single one for fewer
        than 4096 Gaussians.
    tmc3 : str or Path, optional
        MPEG's program, for streams that use G-PCC; by default it is found through the environment
        variable ``GS_CODEC_TMC3`` or PATH.
    progress, max_bytes
        As in `read`.

    Returns
    -------
    open3d.t.geometry.PointCloud
        A cloud with the attributes from `read`.

    Raises
    ------
    InvalidInput
        If a box has no Gaussians, or the stream does not have the level.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If the stream is damaged, decodes to more than `max_bytes`, or is newer than this version.
    MissingTool, ToolFailed
        If Open3D is not installed; or if points are coded by G-PCC, and its program is not
        installed or fails.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> data = gs_codec.encode(cloud, gs_codec.Config("lossless"))
    >>> gs_codec.decode(data).point.rot.shape
    SizeVector[2000, 4]
    >>> gs_codec.decode(data, gs_codec.Part(sh_degree=0)).point.f_rest.shape
    SizeVector[2000, 0, 3]

    Decode the blocks for a camera, with levels of detail and an error of up to 4 pixels:

    >>> data = gs_codec.encode(cloud, gs_codec.Config(lod=True, block_size=1024))
    >>> [camera, _] = gs_codec.read_cameras("cameras.json")
    >>> seen = gs_codec.decode(data, gs_codec.Part(view=camera, tolerance=4))
    >>> gs_codec.decode(data, gs_codec.Part(level=1)).point.positions.shape
    SizeVector[500, 3]
    """
    part = part or Part()
    if isinstance(source, str | Path):
        refuse_several(source)
        with opened(source) as data, located(source):
            return public_cloud(decode_part(data, part, threads, max_bytes, progress, tmc3)[0])
    return public_cloud(decode_part(bytes(source), part, threads, max_bytes, progress, tmc3)[0])


@checked
def inspect(source: bytes | bytearray | memoryview | str | Path) -> Info:
    """Describe an `.egs` file or stream, without decoding it.

    Parameters
    ----------
    source : bytes, bytearray, memoryview, str or Path
        A stream, or the path of a file.

    Returns
    -------
    Info
        Profile, number of Gaussians, bounds, bytes of each attribute, step sizes, models, and
        channels that take no bits.

    Raises
    ------
    InvalidInput
        If the file cannot be read.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If its header or tables are damaged, or it is newer than this version.

    Examples
    --------
    >>> info = gs_codec.inspect("scene.egs")
    >>> info.profile, info.count, info.sh_degree
    ('m', 2000, 3)
    >>> info.file_bytes == sum(stream.bytes for stream in info.streams)
    True
    """
    return inspect_file(source) if isinstance(source, str | Path) else inspect_bytes(bytes(source))
