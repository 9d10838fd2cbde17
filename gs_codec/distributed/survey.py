"""Survey all Gaussians before any is coded: bounds, coarseness, lattices."""

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
from gs_codec.coding.clean import Ends, clean_scene, finite_ends, log_ends, sound_gaussians
from gs_codec.config import Config
from gs_codec.distributed.folder import Folder
from gs_codec.distributed.sources import Gaussians, Span
from gs_codec.distributed.tasks import Crew
from gs_codec.guidance.calibrate import calibrated_by
from gs_codec.guidance.windows import (
    MOST_SHOWN,
    Windows,
    choose_windows,
    find_shown,
    sample_stride,
)
from gs_codec.runtime.mapped import located
from gs_codec.scene import GROUPS, Scene, join_scenes


@dataclass(frozen=True)
class Job:
    """The common data of all tasks that read Gaussians."""

    folder: Folder
    gaussians: Gaussians
    spans: Sequence[Span]
    config: Config

    def clean(self, number: int) -> tuple[Scene, Scene, dict[str, Any]]:
        """A span with finite values, cleaned, and the number of changes."""
        scene, ends = finite_ends(self.gaussians.read(self.spans[number]))
        with located(self.spans[number].source.path):
            clean, changed = clean_scene(scene, self.config, whole=False)
        return scene, clean, {"ends": ends, **changed}

    def save_scene(self, name: str, scene: Scene, **others: NDArray) -> None:
        """Save the floats of a scene, and further arrays, as a result."""
        self.folder.save(name, {group: getattr(scene, group) for group in GROUPS} | others)

    def save_shown(
        self, name: str, scene: Scene, shown: Sequence[NDArray[np.int64]], **others: NDArray
    ) -> None:
        """Save the part of a scene in each window, and further arrays, as a result."""
        sizes = np.array([len(own) for own in shown], np.int64)
        index = np.concatenate([np.empty(0, np.int64), *shown])
        self.save_scene(name, scene.take(index), sizes=sizes, **others)

    def load_scene(self, name: str) -> Scene:
        """The scene of a result."""
        planes: dict[str, Any] = self.folder.load(name, *GROUPS)
        return replace(self.gaussians.head, **planes)

    def load_shown(self, stage: str, number: int) -> tuple[Scene, list[NDArray[np.int64]]]:
        """The Gaussians of all parts in windows, and the indices in each window.

        Parts are concatenated; windows with too many Gaussians in total are dropped.
        """
        sizes = np.array(
            [self.folder.load(f"{stage}-{k}", "sizes")["sizes"] for k in range(number)]
        )
        few = sizes.sum(axis=0) <= MOST_SHOWN
        window = np.concatenate([np.repeat(np.arange(len(few)), each * few) for each in sizes])
        parts = [
            self.load_scene(f"{stage}-{k}").take(np.repeat(few, sizes[k])) for k in range(number)
        ]
        return join_scenes(parts), [np.flatnonzero(window == k) for k in range(len(few))]


class Looked(NamedTuple):
    """Result of the survey of all Gaussians.

    Attributes
    ----------
    windows : Windows
        Windows of the scene, if they were chosen.
    config : Config
        The configuration with the calibrated coarseness.
    dropped : ndarray, shape (D,), int64
        Numbers of the dropped Gaussians.
    zero_quaternions : int
    bounds : tuple of two ndarray, shape (3,)
        Lowest and highest x, y, z of the other Gaussians.
    """

    windows: Windows
    config: Config
    dropped: NDArray[np.int64]
    zero_quaternions: int
    bounds: Bounds


def look(crew: Crew, job: Job, calibrates: bool = True) -> Looked:
    """Survey all Gaussians; without `calibrates`, the coarseness is not changed."""
    number = len(job.spans)
    windows = Windows([], [], False)
    if calibrates:
        crew.do_all(job.folder, "sample", partial(_sample, job), number)
        sample = join_scenes([job.load_scene(f"sample-{k}") for k in range(number)])
        windows = choose_windows(sample, job.gaussians.count)
    crew.do_all(job.folder, "scan", partial(_look, job, windows), number)
    names = ("dropped", "zeros", "bounds", "ends")
    seen = [job.folder.load(f"scan-{k}", *names) for k in range(number)]
    log_ends(Ends(*np.sum([each["ends"] for each in seen], axis=0).tolist()))
    config = job.config
    if windows.choosing:
        config = calibrated_by(sample, windows.choosing, *job.load_shown("scan", number), config)
    bounds = np.stack([each["bounds"] for each in seen])
    return Looked(
        windows,
        config,
        np.concatenate([each["dropped"] for each in seen]),
        int(sum(each["zeros"] for each in seen)),
        (bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)),
    )


def choose_lattice(crew: Crew, job: Job, looked: Looked, may_have_far: bool = True) -> Lattice:
    """The lattices for all Gaussians that are not dropped, as in `arrange_scene`."""
    number = len(job.spans)
    stride = lattice_stride(job.gaussians.count - len(looked.dropped))
    task = partial(_pick, job, stride, looked.dropped)
    crew.do_all(job.folder, "pick", task, number)
    sample = join_scenes([job.load_scene(f"pick-{k}") for k in range(number)])
    return blind_lattice(sample, looked.bounds, looked.config, may_have_far)


def _numbers(span: Span, stride: int, dropped: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers, over all files, of every `stride`-th remaining Gaussian in a span."""
    stop = span.first + span.stop - span.start
    gone = np.searchsorted(dropped, [span.first, stop])
    first, end = span.first - gone[0], stop - gone[1]
    kept = np.arange(-(-first // stride) * stride, end, stride)
    # Add the number of dropped Gaussians before each.
    return kept + np.searchsorted(dropped - np.arange(len(dropped)), kept, "right")


def _sample(job: Job, number: int) -> None:
    stride = sample_stride(job.gaussians.count)
    index = _numbers(job.spans[number], stride, np.empty(0, np.int64))
    job.save_scene(f"sample-{number}", job.gaussians.pick(job.spans[number], index))


def _look(job: Job, windows: Windows, number: int) -> None:
    """Bounds of a span, the changes in it, and its Gaussians in windows."""
    scene, clean, changed = job.clean(number)
    gone = np.empty(0, np.int64)
    if changed["dropped"]:
        gone = job.spans[number].first + np.flatnonzero(~sound_gaussians(scene))
    low = clean.positions.min(axis=1, initial=np.inf)
    high = clean.positions.max(axis=1, initial=-np.inf)
    job.save_shown(f"check-{number}", clean, find_shown(clean, windows.checking))
    job.save_shown(
        f"scan-{number}",
        scene,
        find_shown(scene, windows.choosing),
        bounds=np.stack([low, high]),
        dropped=gone,
        zeros=np.array(changed["zero_quaternions"]),
        ends=np.array(changed["ends"]),
    )


def _pick(job: Job, stride: int, dropped: NDArray[np.int64], number: int) -> None:
    index = _numbers(job.spans[number], stride, dropped)
    scene, _ = clean_scene(job.gaussians.pick(job.spans[number], index), job.config, whole=False)
    job.save_scene(f"pick-{number}", scene)
