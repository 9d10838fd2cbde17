"""The suite: every measurement of every scene, in one run."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from gs_codec.bench.apart import measure_scaling
from gs_codec.bench.beside import measure_beside, our_codecs
from gs_codec.bench.host import machine
from gs_codec.bench.measure import measure_memory
from gs_codec.bench.peers import AbsentPeer, find_peers
from gs_codec.bench.suite.points import measure_points
from gs_codec.bench.suite.scenes import MeasuredScene, open_scenes
from gs_codec.config import PROFILE_CHOICES, Config, check_threads
from gs_codec.errors import InvalidInput

Lines = Iterator[dict[str, Any]]

#: Percentages of Gaussians that are pruned before `m` codes the rest.
PRUNED = (39.0, 58.8)

#: Gaussians of the tiled scenes of the scaling.
SIZES = (100_000, 300_000, 1_000_000, 3_000_000)


@dataclass(frozen=True)
class Options:
    """Scenes, and how they are measured.

    Parameters
    ----------
    scenes : tuple of Path
        PLY files; cameras are ``cameras.json`` beside one, else chosen for it, and photographs of
        these are in the folder ``images`` there, if it exists.
    repeats : int
        Timed runs, 1 and up.
    threads : int, optional
        Of encoding and decoding; all processors if None.
    width : int, optional
        Of the views, pixels; those compared with photographs have these' width.
    skip : frozenset of str
        `GROUPS` to leave out.

    Raises
    ------
    InvalidInput
        If there are no scenes, a group is unknown, or a number is out of range.
    """

    scenes: tuple[Path, ...]
    repeats: int = 3
    threads: int | None = None
    width: int | None = None
    skip: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if not self.scenes:
            raise InvalidInput(
                "no scenes given, expected .ply files, each beside its cameras.json; "
                "`make suite` makes two and measures them"
            )
        check_threads(self.threads)
        for group in sorted(self.skip - set(GROUPS)):
            raise InvalidInput(f"--skip {group}: expected one of {', '.join(GROUPS)}")

    def config(self, profile: str) -> Config:
        """A profile as it is measured."""
        return Config(profile, threads=self.threads)


def run_suite(options: Options, command: str, tell: Callable[[str], None]) -> Lines:
    """Result lines as they are measured; NaN and infinity are None.

    Parameters
    ----------
    options : Options
    command : str
        How to run the same again; it stands among the lines.
    tell : callable
        Is told what is measured next.

    Raises
    ------
    InvalidInput
        If a scene, cameras or photographs cannot be used; before anything is measured.
    """
    scenes = open_scenes(options.scenes, options.width)
    return (_finite(line) for line in _measure(options, command, tell, scenes))


def _measure(
    options: Options, command: str, tell: Callable[[str], None], scenes: Sequence[MeasuredScene]
) -> Lines:
    date = datetime.now(timezone.utc).isoformat(timespec="seconds")
    skipped = sorted(options.skip)
    yield machine() | {
        "repeats": options.repeats, "skipped": skipped, "date": date, "command": command,
    }  # fmt: skip
    yield from (measured.line for measured in scenes)
    largest = max(scenes, key=lambda measured: measured.scene.count)
    found: list[dict[str, Any]] = []
    for measured in scenes:
        for group, (title, measure) in STAGES.items():
            if group in options.skip or (group == "scaling" and measured is not largest):
                continue
            tell(f"{measured.name}: {title}")
            for line in measure(measured, options, found):
                found.append(line)
                yield line


def _memory(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    with tempfile.TemporaryDirectory() as folder:
        back = Path(folder) / "back.ply"
        for config in map(options.config, PROFILE_CHOICES):
            yield measure_memory(measured.scene, measured.name, config, measured.path, back)


def _codecs(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    ours = our_codecs(
        [*map(options.config, PROFILE_CHOICES)],
        measured.plan if "guided" not in options.skip else None,
        PRUNED if "pruned" not in options.skip else (),
    )
    others = find_peers("error", options.threads) if "peers" not in options.skip else []
    # Those that take minutes are for `bench peers`.
    codecs = [*ours, *(x for x in others if isinstance(x, AbsentPeer) or not x.once)]
    views = (measured.cameras, measured.truth)
    return measure_beside(measured.scene, measured.name, codecs, options.repeats, *views)


def _curves(measured: MeasuredScene, options: Options, found: Sequence[dict[str, Any]]) -> Lines:
    beside = [x for x in found if x["kind"] == "beside" and x["scene"] == measured.name]
    return measure_points(measured, options.config("m"), "guided" not in options.skip, beside)


def _scaling(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    profiles = ("m", "paper-m")
    return measure_scaling(measured.scene, measured.name, SIZES, profiles, options.threads)


#: What is measured of each scene, of the largest alone for scaling, by the group it is skipped by.
#: Memory comes after what compiles kernels, which takes memory too.
STAGES = {
    "codecs": ("codecs beside each other", _codecs),
    "curves": ("rate-quality curves", _curves),
    "memory": ("memory of each profile", _memory),
    "scaling": ("growing scenes", _scaling),
}

#: What can be left out: stages; and of codecs, others', camera-guided ones, pruned scenes.
GROUPS = (*STAGES, "peers", "guided", "pruned")


def _finite(value: Any) -> Any:
    """A result as JSON can hold it, which has neither infinity nor NaN."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
