"""Encode one scene in tasks, in this process."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from gs_codec.config import Config
from gs_codec.distributed.encoding import encode_in_tasks
from gs_codec.distributed.sources import open_sources
from gs_codec.distributed.tasks import Crew, Numbered
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import Scene
from gs_codec.workers.interface import Done, Serial, Work, Workers


class Lost(Exception):
    """A worker or its task is lost."""


class Here(Serial):
    """Runs tasks in this process, in any order; can fail before the n-th task."""

    def __init__(self, seed: int = 0, fails_at: int = -1) -> None:
        super().__init__("")
        self.random, self.left, self.done = random.Random(seed), fails_at, list[str]()

    def run(self, work: Work, tasks: Sequence[Numbered]) -> Iterator[Done]:
        """See `Workers`."""
        yield from super().run(work, map(self.begun, self.random.sample(tasks, len(tasks))))

    def begun(self, task: Numbered) -> Numbered:
        """A task to run; raises if it is the one that fails."""
        if not self.left:
            raise Lost
        self.left -= 1
        self.done.append(task.name)
        return task


def in_tasks(
    paths: list[Path], target: Path, config: Config, size: int, here: Workers | None = None
) -> tuple[bytes, dict]:
    """The encoded file, and the report without times."""
    sources = open_sources(paths, config.chosen_extra())
    report = encode_in_tasks(Crew(here or Here()), sources, target, config, size)
    assert not target.with_name(f"{target.name}.parts").exists()
    return target.read_bytes(), {**asdict(report), "seconds": None}


def whole(path: Path, target: Path, config: Config) -> tuple[bytes, dict]:
    """The same with `encode_file`."""
    report = encode_file(path, target, config, overwrite=True)
    return target.read_bytes(), {**asdict(report), "seconds": None}


def saved(path: Path, scene: Scene) -> Path:
    write_ply(path, scene)
    return path
