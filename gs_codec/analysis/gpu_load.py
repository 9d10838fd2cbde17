"""The load that a scene puts on a GPU: splats per pixel, memory, and which devices can show it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gs_codec.cameras.camera import Camera
from gs_codec.preparation.reference_views import evenly
from gs_codec.rendering.overdraw import count_splats
from gs_codec.report import Progress, step_counter
from gs_codec.scene import SH_COEFFICIENTS, Scene

#: Bytes per Gaussian in textures of the page of ``gs-codec share``: shape and colour, SH-AC as
#: halves in texels of 16 bytes, two projections, and the order.
_TEXEL = 16
_PAGE_TEXELS = 3 + 2

#: Number of views in which splats are counted.
VIEWS = 24


@dataclass(frozen=True)
class Device:
    """Limits of a kind of device.

    Attributes
    ----------
    name : str
    gaussians : int
        Maximum number of Gaussians, as Spark's documentation recommends.
    pixels : int
        Pixels of a picture, both eyes together.
    pictures : int
        Frames per second.
    fragments : float
        Maximum fragments per second: estimated, not measured.
    bytes : int
        Memory that a browser lets one page use.
    """

    name: str
    gaussians: int
    pixels: int
    pictures: int
    fragments: float
    bytes: int


DEVICES = (
    Device("phone", 2_000_000, 1_000_000, 30, 3e9, 500_000_000),
    Device("headset", 1_000_000, 2 * 1032 * 1104, 72, 1e10, 1_000_000_000),
    Device("desktop", 5_000_000, 1920 * 1080, 60, 3e10, 2_000_000_000),
)


@dataclass(frozen=True)
class Verdict:
    """Whether a device can show a scene, and the numbers that decide it.

    Attributes
    ----------
    device : Device
    fragments : float
        Fragments per second in the densest view, if it fills the picture.
    copes : bool
    """

    device: Device
    fragments: float
    copes: bool


@dataclass(frozen=True)
class GpuLoad:
    """The load that a scene puts on a GPU.

    Attributes
    ----------
    count : int
        Number of Gaussians.
    views : int
        Number of views in which splats were counted.
    mean, percentile_95 : float
        Splats per pixel, over all pixels of all views.
    densest : float
        Mean over the pixels of the view that has most.
    page_bytes, float_bytes : int
        Memory for textures of the page, and for float32, as trainers keep the scene.
    verdicts : tuple of Verdict
    """

    count: int
    views: int
    mean: float
    percentile_95: float
    densest: float
    page_bytes: int
    float_bytes: int
    verdicts: tuple[Verdict, ...]

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain types, for JSON."""
        return asdict(self)


def gpu_load(scene: Scene, cameras: list[Camera], progress: Progress | None = None) -> GpuLoad:
    """Count the splats per pixel in some of the views, and compare them with devices' limits."""
    cameras = evenly(cameras, VIEWS)
    step = step_counter(progress, "count", len(cameras))
    counts = []
    for camera in cameras:
        counts.append(count_splats(scene, camera).ravel())
        step()
    densest = max(float(each.mean()) for each in counts)
    every = np.concatenate(counts)
    texels = _PAGE_TEXELS + -(-2 * 3 * SH_COEFFICIENTS[scene.sh_degree] // _TEXEL)
    page_bytes = scene.count * (texels * _TEXEL + 4)
    verdicts = tuple(_judge(each, scene.count, densest, page_bytes) for each in DEVICES)
    mean, high = float(every.mean()), float(np.percentile(every, 95))
    sizes = page_bytes, scene.float_bytes
    return GpuLoad(scene.count, len(cameras), mean, high, densest, *sizes, verdicts)


def _judge(device: Device, count: int, densest: float, page_bytes: int) -> Verdict:
    fragments = densest * device.pixels * device.pictures
    enough = (
        count <= device.gaussians,
        fragments <= device.fragments,
        page_bytes <= device.bytes,
    )
    return Verdict(device, fragments, all(enough))
