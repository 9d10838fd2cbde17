"""Measure decoding and refinement on a CUDA device; without one, report that it is absent."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from gs_codec.api.splats import decode_tensors, require_device
from gs_codec.bench.measured_scenes import MeasuredScene, tile_scene
from gs_codec.config import Config
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.errors import MissingTool
from gs_codec.plan import BACKGROUNDS
from gs_codec.preparation.optimise import optimise
from gs_codec.preparation.reference_views import draw_targets, evenly
from gs_codec.rendering.gsplat_backend import is_chosen
from gs_codec.scene import Scene

#: Block sizes in Gaussians: the default, and one that gives more blocks than processors.
BLOCK_SIZES = (16384, 4096)

#: Number of views to refine to.
VIEWS = 32

#: Width of these views, in pixels.
WIDTH = 800

#: Iterations of the refinement.
ITERATIONS = 500

Lines = Iterator[dict[str, Any]]


def measure_device(
    measured: MeasuredScene, sizes: Sequence[int], repeats: int, device: str = "cuda"
) -> Lines:
    """Result lines of a scene and of its tilings to `sizes`: medians of wall times, in seconds.

    Tensors are compared with those of the CPU. If a tool is missing, a line reports that.
    """
    works: tuple[tuple[str, Callable[[], object], Any], ...] = (
        ("decoding", partial(require_device, device), _decoding),
        ("refining", partial(is_chosen, "cuda"), _refining),
    )
    for work, check, measure in works:
        about = {"kind": "device", "scene": measured.name, "work": work}
        try:
            check()
        except MissingTool as error:
            yield about | {"absent": f"{work} on a device: {error}"}
            continue
        about["device"] = _name(device)
        for size in (measured.scene.count, *sizes):
            whole = size == measured.scene.count
            scene = measured.scene if whole else tile_scene(measured.scene, size)
            for line in measure(measured, scene, repeats, device):
                yield about | {"gaussians": scene.count, **line}


def _name(device: str) -> str:
    import torch

    return torch.cuda.get_device_name(device) if device.startswith("cuda") else device


def _decoding(_: MeasuredScene, scene: Scene, repeats: int, device: str) -> Lines:
    """Decode profile `m` from a stream to tensors, on the device and on the CPU."""
    import torch

    for block_size in BLOCK_SIZES:
        config = Config("m", block_size=block_size)
        data = b"".join(encode(scene, Request(config))[0])
        splats, seconds = _timed(partial(decode_tensors, data, device), repeats)
        known, by_cpu = _timed(partial(decode_tensors, data, "cpu"), repeats)
        yield {
            "block_size": block_size,
            "output_bytes": len(data),
            "seconds": seconds,
            "cpu_seconds": by_cpu,
            "same": all(torch.equal(vars(known)[k], v.cpu()) for k, v in vars(splats).items()),
        }


def _refining(measured: MeasuredScene, scene: Scene, _repeats: int, device: str) -> Lines:
    """Iterations that fit 90 % of a scene's Gaussians to its own views."""
    chosen = [*evenly(measured.guides, VIEWS)]
    cameras = [c.resized(WIDTH, max(1, round(WIDTH * c.height / c.width))) for c in chosen]
    views = draw_targets(scene, cameras, BACKGROUNDS["black"], "cuda")
    fewer = scene.take(np.flatnonzero(np.arange(scene.count) % 10))
    curve = optimise(fewer, views, ITERATIONS, device="cuda")[1]["curve"]
    # The first point includes loading and compiling.
    first, last = curve[0], curve[-1]
    rate = (last["iteration"] - first["iteration"]) / (last["seconds"] - first["seconds"])
    yield {
        "width": WIDTH,
        "height": cameras[0].height,
        "iterations": last["iteration"],
        "iterations_per_second": rate,
        "psnr": [first["psnr"], last["psnr"]],
    }


def _timed(function: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """The result of a function, and its median seconds after a first run that compiles."""
    seconds, found = [], function()
    for _ in range(repeats):
        start = time.perf_counter()
        found = function()
        seconds.append(time.perf_counter() - start)
    return found, median(seconds)
