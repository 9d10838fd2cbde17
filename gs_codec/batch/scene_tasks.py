"""The tasks of a batch: its scenes, their outputs, and their options."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from gs_codec.batch.local import LocalStorage, Location, Stamp, file_sha256
from gs_codec.batch.needed_memory import expected_floats, needed_bytes
from gs_codec.batch.remote import Storage
from gs_codec.config import EGS
from gs_codec.encoding.combinations import check_actions
from gs_codec.encoding.request import Request
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.format_table import BATCHED
from gs_codec.runtime.redaction import without_secrets
from gs_codec.runtime.threads import available_threads
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Options(Request):
    """How to encode each scene, or convert it to the `plain` format; its plan then guides actions.

    Raises InvalidInput if an option has no effect in this combination.
    """

    plain: str | None = None

    def __post_init__(self) -> None:
        if self.plain is None:
            super().__post_init__()
        else:
            check_actions(self.actions, self.plan, self.max_memory is not None)

    @property
    def format(self) -> str:
        """Format of the outputs."""
        return self.plain or self.config.format

    @property
    def sources(self) -> tuple[str, ...]:
        """Suffixes of scenes in a folder, including `.egs` unless that is the output format."""
        return BATCHED if self.format == EGS else (*BATCHED, f".{EGS}")

    def digest(self) -> str:
        """Digest of all options that affect the output bytes; excludes threads."""
        parts = {
            "config": asdict(replace(self.config, threads=None)),
            "plan": self.plan and asdict(self.plan),
            "rate": self.rate and asdict(self.rate),
            "actions": [asdict(action) for action in self.actions],
            "format": self.format,
            "by_profile": self.by_profile,
            "files": list(self._files()),
        }
        text = json.dumps(parts, sort_keys=True, default=_text_of)
        return hashlib.sha256(text.encode()).hexdigest()

    def with_share(self, jobs: int) -> Options:
        """The same options, with threads for each of `jobs` concurrent scenes."""
        threads = self.config.threads or max(available_threads() // jobs, 1)
        return replace(self, config=replace(self.config, threads=threads))

    def pixels(self) -> int:
        """Upper bound of the total pixels of all views rendered of a scene."""
        plan, rate = self.plan, self.rate
        if plan is None and (rate is None or not rate.measures):
            return 0
        from gs_codec.cameras.camera_files import read_cameras
        from gs_codec.plan import Plan
        from gs_codec.views.estimate import HEIGHT, SMALL, WIDTH, guiding_number

        plan = plan or Plan()
        views, width = plan.views, plan.width
        if plan.estimates:
            width = width or SMALL
            views, sizes = guiding_number(views, width), [(WIDTH, HEIGHT)]
        else:
            given = plan.cameras
            cameras = read_cameras(given) if isinstance(given, str | Path) else given
            sizes = [(camera.width, camera.height) for camera in cameras]
        areas = [w * h if width is None else width * width * h // w for w, h in sizes]
        return views * max(areas, default=0)

    def absolute(self) -> Options:
        """The same options with absolute paths, for processes with another working folder."""
        plan, config = self.plan, self.config
        if config.tmc3 is not None and os.path.dirname(config.tmc3):  # otherwise it is in PATH
            config = replace(config, tmc3=os.path.abspath(config.tmc3))
        if plan is None:
            return replace(self, config=config)
        cameras, gt_images = plan.cameras, plan.gt_images
        if isinstance(cameras, str | Path) and cameras != "auto":
            cameras = os.path.abspath(cameras)
        if gt_images is not None:
            gt_images = os.path.abspath(gt_images)
        plan = replace(plan, cameras=cameras, gt_images=gt_images)
        return replace(self, config=config, plan=plan)

    def _files(self) -> Iterator[tuple[str, str]]:
        """Name and stamp of each file that the plan uses: cameras and photographs."""
        if self.plan is None:
            return
        for path in (self.plan.cameras, self.plan.gt_images):
            if isinstance(path, str | Path) and os.path.isfile(path):
                yield str(path), file_sha256(path)
            elif isinstance(path, str | Path) and os.path.isdir(path):
                for file in sorted(Path(path).rglob("*")):
                    found = file.stat()
                    yield str(file), f"{found.st_size} {found.st_mtime_ns}"


def _text_of(value: object) -> str:
    """An argument as text; of an array its digest, because the text of a long one is shortened."""
    if isinstance(value, np.ndarray):
        return hashlib.sha256(value.tobytes()).hexdigest()
    return str(value)


@dataclass(frozen=True)
class Task:
    """A scene to encode.

    Parameters
    ----------
    name : str
        Relative to the folder or the fixed part of the glob.
    source, target : Location
    shown : tuple of str
        Names of both for reports, without secrets.
    stamp : Stamp
        Stamp of the source when the batch was planned.
    need : int
        Estimated memory, bytes.
    mark : str
        Marks unfinished uploads of this batch: 8 hexadecimal digits.
    """

    name: str
    source: Location
    target: Location
    shown: tuple[str, str]
    stamp: Stamp
    need: int
    mark: str = ""


def find_tasks(
    source: str, sources: Storage, targets: Storage, options: Options, mark: str
) -> list[Task]:
    """The scenes of a storage, named `source` in errors, with their outputs below the target.

    A scene that is the output of another is skipped. Raises InvalidInput if there are none, if two
    have the same output, or if an output is its own source.
    """
    found = sources.find(options.sources)
    if not found:
        missing = isinstance(sources, LocalStorage) and sources.is_missing()
        text = "no such file or folder" if missing else "no scenes found"
        raise InvalidInput(f"{without_secrets(source)}: {text}")
    tasks, taken, pixels = [], dict[str, str](), options.pixels()
    for name, location, target in _planned(found, sources, targets, options.format):
        shown = sources.shown(location), targets.shown(target)
        drive = os.path.splitdrive(name)[0]  # both are possible in keys of object stores
        if drive or ".." in re.split(r"[/\\]", name):
            text = f"'{drive or '..'}' in its name, expected a path inside the folder"
            raise InvalidInput(f"{shown[0]}: {text}")
        if shown[1] in taken:
            both = f"{taken[shown[1]]} and {shown[0]}"
            raise InvalidInput(f"{both} would both be written to {shown[1]}")
        if shown[0] == shown[1]:
            raise InvalidInput(f"{shown[1]}: input and output are the same file")
        taken[shown[1]] = shown[0]
        try:
            stamp = sources.stamp(location) or Stamp(-1, "")
        except GsCodecError:  # reported when the scene is read
            stamp = Stamp(-1, "")
        floats = _stated(sources, location)
        if floats is None:
            floats = expected_floats(stamp.size, name)
        need = needed_bytes(min(floats, options.max_bytes or floats), pixels)
        need = min(need, options.max_memory or need)
        tasks.append(Task(name, location, target, shown, stamp, need, mark))
    return tasks


def _planned(
    found: Sequence[tuple[str, Location]], sources: Storage, targets: Storage, form: str
) -> list[tuple[str, Location, Location]]:
    """Names, sources and targets of the scenes that are not the output of another.

    An earlier run may have written the others; a warning says how many there are.
    """
    stems = {name: os.path.splitext(name)[0] for name, _ in found}

    def written(outputs: Mapping[str, Location]) -> set[str]:
        """Names of the scenes that are outputs of others."""
        shown = {name: targets.shown(output) for name, output in outputs.items()}
        counts = Counter(shown.values())
        own = ((name, sources.shown(location)) for name, location in found)
        return {name for name, source in own if counts[source] > (shown[name] == source)}

    outputs = {name: targets.location(f"{stem}.{form}") for name, stem in stems.items()}
    perhaps = written(outputs)
    taken = Counter(stem for name, stem in stems.items() if name not in perhaps)
    for name, stem in stems.items():
        if taken[stem] > 1:  # scenes that differ only in their suffix keep it
            outputs[name] = targets.location(f"{name}.{form}")
    left_out = written(outputs)
    if left_out:
        log.warning("skipped %s that this batch writes", counted(len(left_out), "scene"))
    return [(name, location, outputs[name]) for name, location in found if name not in left_out]


def _stated(sources: Storage, location: Location) -> int | None:
    """Bytes of floats stated in the header of a local file; None if remote or unreadable."""
    if not isinstance(sources, LocalStorage) or not os.path.isfile(location.path):
        return None
    from gs_codec.files.scenes import stated_bytes

    try:
        return stated_bytes(location.path)
    except GsCodecError:  # reported when the scene is read
        return None
