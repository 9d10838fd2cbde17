"""What has to be known of all Gaussians before any is coded: bounds, coarseness, lattices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Bounds, blind_lattice
from gs_codec.codecs.adaptive.arrange import sample_stride as lattice_stride
from gs_codec.codecs.adaptive.lattice import Lattice
from gs_codec.coding.clean import clean_scene, finite_gaussians
from gs_codec.config import Config
from gs_codec.distributed.folder import Folder
from gs_codec.distributed.sources import Gaussians, Span
from gs_codec.distributed.workers import Workers, do_all
from gs_codec.guidance import calibrate
from gs_codec.rendering.camera import Camera
from gs_codec.runtime.mapped import located
from gs_codec.scene import GROUPS, Scene, join_scenes


@dataclass(frozen=True)
class Job:
    """What all tasks know that read Gaussians."""

    folder: Folder
    gaussians: Gaussians
    spans: Sequence[Span]
    config: Config

    def clean(self, number: int) -> tuple[Scene, Scene, dict[str, Any]]:
        """A span as it is, cleaned, and what was changed."""
        scene = self.gaussians.read(self.spans[number])
        with located(self.spans[number].source.path):
            return scene, *clean_scene(scene, self.config)

    def save_scene(self, name: str, scene: Scene, **others: NDArray) -> None:
        """Keep the floats of a scene, and more, as a result."""
        self.folder.save(name, {group: getattr(scene, group) for group in GROUPS} | others)

    def load_scene(self, name: str) -> Scene:
        """The scene of a result."""
        planes: dict[str, Any] = self.folder.load(name, *GROUPS)
        return replace(self.gaussians.head, **planes)


class Looked(NamedTuple):
    """What was seen of all Gaussians.

    Attributes
    ----------
    config : Config
        With the coarseness that they need.
    dropped : ndarray, shape (D,), int64
        Numbers of those that are left out.
    zero_quaternions : int
    bounds : tuple of two ndarray, shape (3,)
        Lowest and highest x, y, z of the others.
    """

    config: Config
    dropped: NDArray[np.int64]
    zero_quaternions: int
    bounds: Bounds


def look(workers: Workers, job: Job, calibrates: bool = True) -> Looked:
    """Look at all Gaussians; without `calibrates`, the coarseness is kept."""
    number = len(job.spans)
    windows: list[Camera] = []
    if calibrates:
        do_all(workers, job.folder, "sample", partial(_sample, job), number)
        sample = join_scenes([job.load_scene(f"sample-{k}") for k in range(number)])
        windows = calibrate.choose_windows(sample, job.gaussians.count)
    do_all(workers, job.folder, "scan", partial(_look, job, windows), number)
    names = ("dropped", "zeros", "bounds")
    seen = [job.folder.load(f"scan-{k}", *names) for k in range(number)]
    config = job.config
    if windows:
        shown = _shown(job, number, len(windows))
        config = calibrate.calibrated_by(sample, windows, shown, config)
    bounds = np.stack([each["bounds"] for each in seen])
    return Looked(
        config,
        np.concatenate([each["dropped"] for each in seen]),
        int(sum(each["zeros"] for each in seen)),
        (bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)),
    )


def choose_lattice(
    workers: Workers, job: Job, looked: Looked, may_have_far: bool = True
) -> Lattice:
    """The lattices of all Gaussians that are not dropped, as `arrange_scene` chooses them."""
    number = len(job.spans)
    stride = lattice_stride(job.gaussians.count - len(looked.dropped))
    task = partial(_pick, job, stride, looked.dropped)
    do_all(workers, job.folder, "pick", task, number)
    sample = join_scenes([job.load_scene(f"pick-{k}") for k in range(number)])
    return blind_lattice(sample, looked.bounds, looked.config, may_have_far)


def _numbers(span: Span, stride: int, dropped: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers, in all files, of every `stride`-th Gaussian that is not dropped, in a span."""
    stop = span.first + span.stop - span.start
    gone = np.searchsorted(dropped, [span.first, stop])
    first, end = span.first - gone[0], stop - gone[1]
    kept = np.arange(-(-first // stride) * stride, end, stride)
    # So many of those before it were dropped.
    return kept + np.searchsorted(dropped - np.arange(len(dropped)), kept, "right")


def _sample(job: Job, number: int) -> None:
    stride = calibrate.sample_stride(job.gaussians.count)
    index = _numbers(job.spans[number], stride, np.empty(0, np.int64))
    job.save_scene(f"sample-{number}", job.gaussians.pick(job.spans[number], index))


def _look(job: Job, windows: Sequence[Camera], number: int) -> None:
    """Bounds of a span, what is changed in it, and what of it windows show."""
    scene, clean, changed = job.clean(number)
    gone = np.empty(0, np.int64)
    if changed["dropped"]:
        gone = job.spans[number].first + np.flatnonzero(~finite_gaussians(scene))
    low = clean.positions.min(axis=1, initial=np.inf)
    high = clean.positions.max(axis=1, initial=-np.inf)
    found = calibrate.find_shown(scene, windows)
    job.save_scene(
        f"scan-{number}",
        scene.take(np.concatenate([np.empty(0, np.int64), *found])),
        sizes=np.array([len(each) for each in found], np.int64),
        bounds=np.stack([low, high]),
        dropped=gone,
        zeros=np.array(changed["zero_quaternions"]),
    )


def _shown(job: Job, spans: int, windows: int) -> list[Scene]:
    """What each window shows of all spans."""
    parts: list[list[Scene]] = [[] for _ in range(windows)]
    for number in range(spans):
        scene = job.load_scene(f"scan-{number}")
        ends = np.cumsum(job.folder.load(f"scan-{number}", "sizes")["sizes"]).tolist()
        for part, start, stop in zip(parts, [0, *ends], ends, strict=False):
            part.append(scene.between(start, stop))
    return [join_scenes(part) for part in parts]


def _pick(job: Job, stride: int, dropped: NDArray[np.int64], number: int) -> None:
    index = _numbers(job.spans[number], stride, dropped)
    scene, _ = clean_scene(job.gaussians.pick(job.spans[number], index), job.config)
    job.save_scene(f"pick-{number}", scene)
