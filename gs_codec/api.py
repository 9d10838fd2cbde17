"""The public functions that speak Open3D point clouds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from gs_codec import files, planned
from gs_codec.cloud import from_cloud, to_cloud
from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import Config, Target, as_target
from gs_codec.errors import InvalidInput
from gs_codec.inspection import Info, inspect_bytes
from gs_codec.io.ply import vertex_rows
from gs_codec.metrics.attributes import Comparison, compare_scenes
from gs_codec.metrics.images import Quality, compare_images
from gs_codec.metrics.views import RenderedComparison, compare_views
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import as_camera, find_cameras
from gs_codec.rendering.renderer import Rendering
from gs_codec.rendering.renderer import render as render_view
from gs_codec.report import Progress, RateReport, step_counter
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from open3d.t.geometry import PointCloud

    from gs_codec.preparation.report import PrepareReport


def read(
    path: str | Path,
    extra: Literal["error", "keep", "drop"] = "error",
    progress: Progress | None = None,
) -> PointCloud:
    """Read a scene: PLY, `.egs`, `.splat`, `.spz` or SOG, told apart by content.

    Parameters
    ----------
    path : str or Path
    extra : {"error", "keep", "drop"}
        What to do with properties of a PLY beyond the INRIA layout.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` while an `.egs` file is decoded, in the calling
        thread; what it raises ends that.

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
    return to_cloud(files.read_scene(path, extra, progress))


def write(path: str | Path, cloud: PointCloud, config: Config | None = None) -> None:
    """Write a cloud as ``.ply``, ``.splat`` or, encoded with `config`, as ``.egs``.

    Raises
    ------
    InvalidInput
        If the suffix is another, an attribute is missing, or the file cannot be written.
    """
    config = config or Config()
    extra = config.extra if Path(path).suffix.lower() == ".egs" else "keep"
    files.write_scene(path, from_cloud(cloud, extra), config)


@overload
def encode(
    cloud: PointCloud,
    config: Config | None = None,
    cameras: str | Path | Sequence[Camera] | None = None,
    target: None = None,
) -> bytes: ...


@overload
def encode(
    cloud: PointCloud,
    config: Config | None = None,
    cameras: str | Path | Sequence[Camera] | None = None,
    *,
    target: Target | Mapping[str, float],
) -> tuple[bytes, RateReport]: ...


def encode(
    cloud: PointCloud,
    config: Config | None = None,
    cameras: str | Path | Sequence[Camera] | None = None,
    target: Target | Mapping[str, float] | None = None,
) -> bytes | tuple[bytes, RateReport]:
    """Encode a cloud as an `.egs` stream.

    Parameters
    ----------
    cloud : open3d.t.geometry.PointCloud
        With the attributes `read` gives; of ``log_scale`` and ``scale`` one is enough.
    config : Config, optional
    cameras : path, "auto", or sequence of Camera, optional
        As for `render`; profiles ``l``, ``m`` and ``s`` then spend bits where their views see it.
    target : mapping, optional
        One of ``size`` (bytes), ``ratio``, ``bits`` (for each Gaussian) and ``psnr_drop`` (dB) for
        profiles ``l``, ``m`` and ``s`` to come to, and ``allow_prune``; a ratio is to the PLY that
        `write` writes.

    Returns
    -------
    data : bytes
    report : RateReport
        With a target: the steps it led to, and the size or quality expected and reached.

    Raises
    ------
    InvalidInput
        If an attribute is missing or of a wrong type, a value is not finite, or the target is out
        of reach.
    MissingTool, ToolFailed
        If `config` asks for G-PCC, and its program is not there or fails.
    """
    config = config or Config()
    scene = from_cloud(cloud, config.extra)
    plan = None
    if cameras is not None:
        from gs_codec.preparation.pipeline import Plan
        from gs_codec.preparation.steps import Steps

        plan = Plan(Steps(), cameras)
    if target is None:
        guide = None if plan is None else planned.guide_of(scene, plan, config)
        return encode_scene(scene, config, guide=guide)[0]
    ply_bytes = vertex_rows(scene).nbytes
    data, report = planned.encode_goal(scene, scene, ply_bytes, config, as_target(target), plan)
    assert report.rate is not None
    return data, report.rate


def decode(data: bytes, max_bytes: int | None = None) -> PointCloud:
    """Decode an `.egs` stream; the Gaussians come in Morton order, if theirs was not kept.

    Parameters
    ----------
    data : bytes
    max_bytes : int, optional
        Largest size of the decoded floats; by default 1 GiB or 1000 times the stream.

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    MissingTool, ToolFailed
        If points are coded by G-PCC, and its program is not there or does not decode them.
    """
    return to_cloud(decode_scene(data, max_bytes=max_bytes))


def inspect(source: bytes | str | Path) -> Info:
    """What an `.egs` file or stream says of itself, without decoding it.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
    """
    return inspect_bytes(source) if isinstance(source, bytes) else files.inspect_file(source)


def prepare(
    source: PointCloud | str | Path,
    cameras: str | Path | Sequence[Camera] = "auto",
    *,
    photographs: str | Path | None = None,
    width: int | None = None,
    views: int = 64,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    **steps: Any,
) -> tuple[PointCloud, PrepareReport]:
    """Make a scene smaller before it is coded, and say what that cost (paper, Section 4.2).

    Parameters
    ----------
    source : open3d.t.geometry.PointCloud, or path of a scene
    cameras : path, "auto", or sequence of Camera
        As for `render`. Quality is measured in those marked ``test``.
    photographs : path, optional
        Folder of their images, to be matched instead of renders of the input.
    width : int, optional
        Width of the views, pixels.
    views : int
        Most views to work by, evenly spaced.
    background : tuple of three float
        RGB behind the scene.
    checkpoint : path, optional
        Where ``optimise`` keeps its state, and goes on from.
    progress : callable, optional
    **steps
        ``prune_geometry``, ``prune_importance``, ``prune_loo`` (percent), ``max_drop`` (dB),
        ``optimise`` (iterations), ``compact_sh`` (strength), ``refit_colour`` (steps),
        ``rectify`` (bool): see `gs_codec.preparation.steps.Steps`.

    Returns
    -------
    open3d.t.geometry.PointCloud
    PrepareReport
        A label for each input Gaussian, and size and quality after each step.

    Raises
    ------
    InvalidInput
    """
    from gs_codec.preparation.pipeline import Plan, prepare_scene
    from gs_codec.preparation.steps import Steps

    unknown = sorted(set(steps) - set(Steps.__dataclass_fields__))
    if unknown:
        raise InvalidInput(f"step '{unknown[0]}': expected {', '.join(Steps.__dataclass_fields__)}")
    plan = Plan(Steps(**steps), cameras, photographs, width, views, background, checkpoint)
    scene, report = prepare_scene(_scene_of(source), plan, progress)
    return to_cloud(scene), report


class Views:
    """A scene's views, drawn when they are asked for.

    Iterates over ``(Camera, Rendering)``; a `Rendering` has ``colour (H, W, 3)``,
    ``alpha (H, W)`` and ``depth (H, W)``, float32.

    Attributes
    ----------
    cameras : list of Camera
    """

    def __init__(
        self,
        cameras: list[Camera],
        draw: Callable[[Camera], Rendering],
        progress: Progress | None = None,
    ) -> None:
        self.cameras = cameras
        self._draw, self._progress = draw, progress

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[tuple[Camera, Rendering]]:
        advance = step_counter(self._progress, "views", len(self))
        for camera in self.cameras:
            yield camera, self._draw(camera)
            if advance is not None:
                advance()

    def draw(self, camera: Camera | Mapping[str, Any]) -> Rendering:
        """What any camera sees; a mapping is an entry of ``cameras.json``.

        Raises
        ------
        InvalidInput
        """
        return self._draw(as_camera(camera))


def render(
    source: PointCloud | str | Path,
    cameras: str | Path | Sequence[Camera] = "auto",
    *,
    split: str = "all",
    width: int | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool | None = None,
    accumulate: bool = False,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
) -> Views:
    """Draw a scene as the 3DGS rasteriser does, view after view as they are asked for.

    Parameters
    ----------
    source : open3d.t.geometry.PointCloud, or path of a scene
    cameras : path, "auto", or sequence of Camera or mapping
        ``cameras.json`` of the INRIA trainer, the folder of a COLMAP model, cameras chosen
        from the scene itself, or entries of such a ``cameras.json``.
    split : {"all", "held-out", "test", "train"}
        Which of the cameras; ``held-out`` is ``test`` where cameras are marked, else ``all``.
    width : int, optional
        Width of the images, pixels; the height follows.
    background : sequence of three float
        RGB behind everything.
    antialiased : bool, optional
        Opacity compensation for the low-pass; by default as the file's comments say.
    accumulate : bool
        Keep sums of weights for each Gaussian.
    device : {"auto", "cpu", "cuda"}
        ``cuda`` draws with gsplat, ``auto`` does where that is possible.
    progress : callable, optional

    Returns
    -------
    Views
        Iterates over cameras and what they see.

    Raises
    ------
    InvalidInput, MissingTool
    """
    scene = _scene_of(source)

    def draw(camera: Camera) -> Rendering:
        return render_view(scene, camera, background, antialiased, accumulate, device=device)

    return Views(find_cameras(cameras, scene, split, width), draw, progress)


def compare(
    first: PointCloud | str | Path | NDArray,
    second: PointCloud | str | Path | NDArray,
    cameras: str | Path | Sequence[Camera] | None = None,
    *,
    split: str = "held-out",
    width: int | None = None,
    truth: str | Path | None = None,
    images: str | Path | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
) -> Comparison | RenderedComparison | Quality:
    """Errors of one scene against another, by attribute or in what cameras see; or of images.

    Without cameras, files are matched through their stored order: of a scene and its decoded
    version, the first is put in the order of the second. Clouds are compared index by index.

    Parameters
    ----------
    first, second : open3d.t.geometry.PointCloud, or paths of scenes
        Or images ``(H, W, 3)``, 0-1: PSNR and SSIM.
    cameras, split, width, background, device, progress
        As for `render`; ``auto`` cameras are chosen from the first scene.
    truth : path, optional
        Folder of ground-truth images, found by the cameras' names; views take their size.
    images : path, optional
        Folder to write both images and their amplified difference to, for each view.

    Raises
    ------
    InvalidInput, MissingTool
        If a source cannot be read; without cameras, if the numbers of Gaussians differ.
    """
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return compare_images(first, second)
    if cameras is not None:
        if truth is not None and width is not None:
            raise InvalidInput("width: given by the ground-truth images, expected one of the two")
        scenes = _scene_of(first), _scene_of(second)
        views = find_cameras(cameras, scenes[0], split, width)
        return compare_views(*scenes, views, truth, images, background, device, progress)
    if isinstance(first, str | Path) and isinstance(second, str | Path):
        return files.compare_files(first, second)
    if isinstance(first, str | Path) or isinstance(second, str | Path):
        raise InvalidInput("compare: one file and one cloud, expected two of a kind")
    return compare_scenes(_scene_of(first), _scene_of(second))


def _scene_of(source: PointCloud | str | Path) -> Scene:
    if isinstance(source, str | Path):
        return files.read_scene(source, "drop")
    return from_cloud(source, "drop")
