"""Public functions that use cameras: render, compare and prepare scenes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.matching import put_side_by_side
from gs_codec.config import Config, as_config
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import compare_files, read_scene
from gs_codec.formats.cloud import from_cloud, to_cloud
from gs_codec.formats.coordinates import system_of, turn_axes
from gs_codec.metrics.attributes import compare_scenes
from gs_codec.metrics.comparison import Comparison
from gs_codec.metrics.image_quality import LPIPS_VARIABLE
from gs_codec.metrics.views import compare_views
from gs_codec.plan import Plan
from gs_codec.rendering.renderer import RenderedViews, Rendering
from gs_codec.rendering.renderer import render as render_view
from gs_codec.report import Progress
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.atomic import check_folder
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene
from gs_codec.views.find import find_cameras

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

    from gs_codec.preparation.prepare_report import PrepareReport


@checked
def render(
    source: PointCloud | str | Path,
    cameras: str | Path | Sequence[Camera | Mapping[str, Any]] = "auto",
    *,
    split: str = "all",
    width: int | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool | None = None,
    accumulate: bool = False,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> RenderedViews:
    """Render a scene like the 3DGS rasteriser; each view is rendered on demand.

    Parameters
    ----------
    source : open3d.t.geometry.PointCloud, or path of a scene
        The scene; extra properties are ignored.
    cameras : path, "auto", or sequence of Camera or mapping
        A file or folder that `read_cameras` reads; ``auto`` for cameras estimated from the scene;
        or cameras, or entries of ``cameras.json``.
    split : {"all", "held-out", "test", "train"}
        Which cameras to use. ``held-out`` means ``test`` if cameras are marked, else ``all``.
    width : int, optional
        Width of the images, pixels; the height keeps the aspect ratio.
    background : sequence of three float
        RGB behind everything, 0-1.
    antialiased : bool, optional
        Opacity compensation for the low-pass filter (Mip-Splatting); by default as stated in the
        comments of the file.
    accumulate : bool
        Keep the sum of blending weights of each Gaussian.
    device : {"auto", "cpu", "cuda"}
        ``cuda`` renders with gsplat; ``auto`` uses ``cuda`` if possible.
    progress, max_bytes
        As in `read`; `max_bytes` only applies to paths.

    Returns
    -------
    RenderedViews
        Iterates over pairs of a camera and its rendering.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
        As in `read`; or if the cameras cannot be read, or none is in the split.
    MissingTool
        When rendering, if ``cuda`` is requested and not available.

    Examples
    --------
    >>> for camera, rendering in gs_codec.render("scene.ply", "cameras.json", width=48):
    ...     print(camera.name, rendering.colour.shape)
    00000 (32, 48, 3)
    00001 (32, 48, 3)
    """
    scene = scene_of(source, max_bytes)

    def draw(camera: Camera) -> Rendering:
        return render_view(scene, camera, background, antialiased, accumulate, device=device)

    return RenderedViews(
        find_cameras(cameras, scene, split, width, progress=progress), draw, progress
    )


@checked
def compare(
    first: PointCloud | str | Path,
    second: PointCloud | str | Path,
    cameras: str | Path | Sequence[Camera | Mapping[str, Any]] | None = None,
    *,
    split: str = "held-out",
    width: int | None = None,
    gt_images: str | Path | None = None,
    images: str | Path | None = None,
    lpips: str | Path | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
) -> Comparison:
    """Compare two versions of a scene: errors by attribute, or in rendered views.

    Without cameras, Gaussians are matched by the stored order of a decoded version, by index, by
    the order of other formats' writers, or by nearest centre and appearance. Each match is checked
    on a sample of Gaussians.

    Parameters
    ----------
    first, second : open3d.t.geometry.PointCloud, or paths of scenes
        Both clouds or both paths, unless there are cameras.
    cameras, split, width, background, device, progress, max_bytes
        As in `render`; ``auto`` cameras are estimated from the first scene.
    gt_images : path, optional
        Folder of ground-truth images, named like the cameras; views are rendered at their size.
        Transparent parts show the background. Images with lens distortion are undistorted (see
        `Lens`).
    images : path, optional
        Output folder: for each view, both images and their amplified difference.
    lpips : path, optional
        Weights of torchvision's VGG16, AlexNet or SqueezeNet 1.1, as PyTorch stores a state dict:
        also measures LPIPS of views (extra ``lpips``). By default the file is named by the
        environment variable ``GS_CODEC_LPIPS``; without a file, LPIPS is not measured.
    overwrite : bool
        Whether `images` may be a folder that is not empty.

    Returns
    -------
    Comparison
        Without cameras its `groups`: largest and root-mean-square errors of each attribute. With
        cameras its `views`, their `mean` and the `worst`: PSNR, SSIM and, if measured, LPIPS.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
        As in `read`; or if images differ in size or are missing, or, without cameras, if the
        numbers of Gaussians differ, or most Gaussians have no match.
    MissingTool
        If ``cuda`` or LPIPS is requested but not available, or an image must be undistorted and
        OpenCV is not installed.

    Examples
    --------
    >>> errors = gs_codec.compare("scene.ply", "scene.egs")
    >>> errors.matched_by
    'stored order'
    >>> [f"{group.name} ({group.unit})" for group in errors.groups][:3]
    ['positions (scene units)', 'f_dc (SH)', 'f_rest (SH)']

    Compare rendered views:

    >>> seen = gs_codec.compare("scene.ply", "scene.egs", "cameras.json", width=48)
    >>> seen.mean.between.psnr > 35
    True
    """
    if cameras is not None:
        if images is not None:
            check_folder(images, overwrite)
        if gt_images is not None and width is not None:
            raise InvalidInput("width: cannot be combined with ground-truth images, which set it")
        stored = _stored_scene(first, max_bytes), _stored_scene(second, max_bytes)
        systems = system_of(stored[0]), system_of(stored[1])
        scenes = turn_axes(stored[0]), turn_axes(stored[1])
        views = find_cameras(cameras, scenes[0], split, width, progress=progress)
        weights = os.environ.get(LPIPS_VARIABLE) or None if lpips is None else lpips
        seen = compare_views(
            *scenes, views, gt_images, images, background, device, progress, weights
        )
        return replace(seen, systems=systems)
    if isinstance(first, str | Path) and isinstance(second, str | Path):
        return compare_files(first, second, max_bytes)
    if isinstance(first, str | Path) or isinstance(second, str | Path):
        raise InvalidInput("compare: one file and one cloud, expected two files or two clouds")
    clouds = scene_of(first, max_bytes), scene_of(second, max_bytes)
    return compare_scenes(*put_side_by_side(*clouds))


@checked
def prepare(
    source: PointCloud | str | Path,
    plan: Plan,
    config: Config | str | None = None,
    *,
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> tuple[PointCloud, PrepareReport]:
    """Make a scene smaller before it is coded, and report the quality lost (paper, Section 4.2).

    Parameters
    ----------
    source : open3d.t.geometry.PointCloud, or path of a scene
        The input, which is not changed.
    plan : Plan
        Steps of preparation, and the views that guide them.
    config : Config or str, optional
        As in `prepare_file`; only its `threads` is used.
    progress, max_bytes
        As in `read`; `max_bytes` only applies to paths.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The smaller scene, with the attributes from `read`.
    PrepareReport
        A label for each input Gaussian, size and quality after each step, and the loss in crops of
        other views.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion
        As in `read`; or if there are no cameras, or no Gaussian would remain.
    MissingTool
        If Open3D is not installed.

    Examples
    --------
    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=30), "cameras.json", width=48)
    >>> pruned, report = gs_codec.prepare(gs_codec.read("scene.ply"), plan)
    >>> report.removed
    {'importance': 0, 'geometry': 0, 'leave-one-out': 600}
    >>> [step.name for step in report.steps]
    ['original', 'leave-one-out pruning']
    """
    from gs_codec.encoding.retry import loss_by_plan
    from gs_codec.guidance.windows import cleaned
    from gs_codec.preparation.pipeline import prepare_scene

    config = as_config(config)
    with using_threads(config.threads):
        scene = scene_of(source, max_bytes)
        prepared, report = prepare_scene(scene, plan, progress)
        rendered = loss_by_plan(cleaned(scene), prepared, plan, config)
    return to_cloud(prepared).clone(), replace(report, rendered=rendered)


def scene_of(source: PointCloud | str | Path, max_bytes: int | None = None) -> Scene:
    """The scene of a cloud or file in ``RDF``, without extra attributes and properties."""
    return turn_axes(_stored_scene(source, max_bytes))


def _stored_scene(source: PointCloud | str | Path, max_bytes: int | None) -> Scene:
    """The scene of a cloud or file, in the coordinate system of the file."""
    if isinstance(source, str | Path):
        return read_scene(source, "drop", coordinates=None, max_bytes=max_bytes)
    if max_bytes is not None:
        raise InvalidInput("max_bytes: has no effect on a cloud, only on files")
    return from_cloud(source, "drop", tell=False)
