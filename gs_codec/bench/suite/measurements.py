"""The suite: every measurement of every scene, in one run."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

from gs_codec.bench.device import measure_device
from gs_codec.bench.geometry import measure_geometry
from gs_codec.bench.host import installed, machine
from gs_codec.bench.measure import measure_memory
from gs_codec.bench.measured_scenes import MeasuredScene, cameras_of, check_names, open_with_cameras
from gs_codec.bench.peers import AbsentPeer, Peer, find_peers
from gs_codec.bench.processes import measure_scaling
from gs_codec.bench.side_by_side import ESTIMATED, guided, measure_alternating, our_codecs
from gs_codec.bench.suite.datasets import models_of, open_model
from gs_codec.bench.suite.points import measure_points
from gs_codec.config import PROFILE_CHOICES, Config, check_threads
from gs_codec.errors import InvalidInput
from gs_codec.runtime.optional import check_installed

Lines = Iterator[dict[str, Any]]

#: Percentages of Gaussians pruned before `m` encodes the rest.
PRUNED = (39.0, 58.8)

#: Compression ratios of scenes with refinement.
REFINED = (35.0, 60.0, 100.0)

#: Numbers of Gaussians of the tiled scenes for scaling.
SIZES = (100_000, 300_000, 1_000_000, 3_000_000)

#: The same on a device: the paper's mean scene, and a large one.
DEVICE_SIZES = (1_120_000, 5_000_000)


@dataclass(frozen=True)
class Options:
    """PLY files, and how to measure them; `skip` lists the omitted `GROUPS`.

    Cameras come from ``cameras.json`` next to a file, otherwise they are estimated. Photographs are
    in the folder ``images`` there, if it exists; `width`, in pixels, applies to views without them.
    With a `dataset`, one of `DATASETS`, the only scene is the folder of its models, of which codecs
    alone are measured; `photographs` are as in `open_model`. `codecs` are measured too. Raises
    InvalidInput if there are no scenes, two have one name, a group is unknown, or a number is out
    of range.
    """

    scenes: tuple[Path, ...]
    repeats: int = 3
    threads: int | None = None
    width: int | None = None
    skip: frozenset[str] = frozenset()
    dataset: str | None = None
    photographs: Path | None = None
    codecs: tuple[Peer, ...] = ()

    def __post_init__(self) -> None:
        if not self.scenes:
            raise InvalidInput(
                "no scenes given, expected .ply files, each in a folder with its cameras.json; "
                "`make suite` generates and measures two"
            )
        check_names(self.paths)
        check_threads(self.threads)
        groups = GROUPS if self.dataset is None else GROUPS[len(STAGES) :]
        for group in sorted(self.skip - set(groups)):
            raise InvalidInput(f"--skip {group}: expected one of {', '.join(groups)}")

    @cached_property
    def paths(self) -> Sequence[Path]:
        """The scenes, or those of the dataset."""
        return self.scenes if self.dataset is None else models_of(self.dataset, *self.scenes)

    def open(self, path: Path) -> MeasuredScene:
        """One of the scenes, with its views."""
        if self.dataset is None:
            return open_with_cameras(path, self.width)
        return open_model(path, self.photographs, self.width)

    def omits(self, group: str) -> bool:
        """Whether one of `STAGES` is omitted."""
        return group in self.skip or (self.dataset is not None and group != "codecs")

    def config(self, profile: str) -> Config:
        """The configuration for measuring a profile."""
        return Config(profile, threads=self.threads)


def run_suite(options: Options, command: str, announce: Callable[[str], None]) -> Lines:
    """Yield result lines as they are measured; `announce` is called with the next step.

    The first line contains the `command` to repeat the measurement. Raises InvalidInput if a scene,
    cameras or photographs cannot be used; raised before measuring.
    """
    check_installed("scipy", "bench suite")
    scenes = list(map(options.open, options.paths))
    return _measure(options, command, announce, scenes)


def scene_line(measured: MeasuredScene) -> dict[str, Any]:
    """The result line of a scene itself."""
    scene, first = measured.scene, measured.cameras[0]
    return {
        "kind": "scene",
        "scene": measured.name,
        "gaussians": scene.count,
        "sh_degree": scene.sh_degree,
        "input_bytes": measured.path.stat().st_size,
        "cameras": Path(cameras_of(measured.path)).name,
        "measured_views": len(measured.cameras),
        "encoded_by_views": min(len(measured.guides), measured.plan.views),
        "width": first.width,
        "height": first.height,
        "photographs": measured.truth is not None,
    }


def _measure(
    options: Options,
    command: str,
    announce: Callable[[str], None],
    scenes: Sequence[MeasuredScene],
) -> Lines:
    date = datetime.now(timezone.utc).isoformat(timespec="seconds")
    skipped = sorted(options.skip)
    yield machine() | {
        "installed": installed(), "repeats": options.repeats, "skipped": skipped, "date": date,
        "command": command, "dataset": options.dataset,
    }  # fmt: skip
    yield from map(scene_line, scenes)
    largest = max(scenes, key=lambda measured: measured.scene.count)
    found: list[dict[str, Any]] = []
    for measured in scenes:
        for group, (title, measure) in STAGES.items():
            if options.omits(group) or (group in ONCE and measured is not largest):
                continue
            announce(f"{measured.name}: {title}")
            for line in measure(measured, options, found):
                found.append(line)
                yield line


def _memory(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    with tempfile.TemporaryDirectory() as folder:
        back = Path(folder) / "back.ply"
        for config in map(options.config, PROFILE_CHOICES):
            yield measure_memory(measured, config, measured.path, back)


def _codecs(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    ours = our_codecs(
        [*map(options.config, PROFILE_CHOICES), *_in_other_formats(options.config("m"))],
        measured.plan if "guided" not in options.skip else None,
        PRUNED if "pruned" not in options.skip else (),
        [*product(measured.refining, REFINED)] if "refined" not in options.skip else (),
    )
    if "guided" not in options.skip:
        plan = replace(measured.plan, cameras="auto")
        ours.append(guided(options.config("m"), plan, ESTIMATED))
    others = find_peers("error", options.threads) if "peers" not in options.skip else []
    # Slow ones are left to `bench peers`.
    quick = [x for x in others if isinstance(x, AbsentPeer) or not x.once]
    return measure_alternating(measured, [*ours, *quick, *options.codecs], options.repeats)


def _in_other_formats(config: Config) -> Iterator[Config]:
    """A profile in the formats that quantise."""
    yield replace(config, format="spz", spz_version=4)
    yield replace(config, format="sog")
    yield replace(config, format="compressed.ply")


def _curves(measured: MeasuredScene, options: Options, found: Sequence[dict[str, Any]]) -> Lines:
    beside = [x for x in found if x["kind"] == "beside" and x["scene"] == measured.name]
    return measure_points(measured, options.config("m"), "guided" not in options.skip, beside)


def _geometry(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    return measure_geometry(measured.scene.positions, measured.name, options.repeats)


def _scaling(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    profiles = ("m", "paper-m")
    return measure_scaling(measured.scene, measured.name, SIZES, profiles, options.threads)


def _device(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    return measure_device(measured, DEVICE_SIZES, options.repeats)


#: Measurements of each scene, or only of the largest (`ONCE`), by group. Memory comes after
#: everything that compiles kernels, which also takes memory.
STAGES = {
    "codecs": ("codecs compared", _codecs),
    "curves": ("rate-quality curves", _curves),
    "memory": ("memory of each profile", _memory),
    "geometry": ("positions compared with Open3D's octree", _geometry),
    "scaling": ("scenes of growing size", _scaling),
    "device": ("a CUDA device", _device),
}
ONCE = ("scaling", "device")

#: Groups that can be skipped: stages; and peers, camera-guided, pruned and refined codecs, which
#: take minutes.
GROUPS = (*STAGES, "peers", "guided", "pruned", "refined")
