"""`.egs` files decoded slab by slab, so that a large scene is never in memory as a whole."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from gs_codec.codec.decode import ChosenPart, choose_part
from gs_codec.codec.part import Part
from gs_codec.codec.room import slab_within
from gs_codec.config import check_threads
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.inspection import describe
from gs_codec.io.formats import SceneFile, open_scene
from gs_codec.io.mapped import located
from gs_codec.matching import Order, order_of_file, with_order
from gs_codec.report import Progress
from gs_codec.scene import Scene
from gs_codec.storage import bounded
from gs_codec.workers import available_threads, using_threads

#: Gaussians decoded at once, or as many as give each thread two blocks.
_SLAB = 1 << 19


@dataclass
class Slabs:
    """The Gaussians of a file, in the order of its stream.

    Attributes
    ----------
    path : Path
    chosen : ChosenPart
    progress : callable or None
    seconds : float
        What decoding took so far.
    """

    path: Path
    chosen: ChosenPart
    progress: Progress | None
    seconds: float = field(default=0.0)

    @property
    def sh_degree(self) -> int:
        """SH degree that is decoded."""
        return self.chosen.degree

    @property
    def bytes_read(self) -> int:
        """How much of the file was read."""
        return self.chosen.file.bytes_read

    def counted(self) -> tuple[int, Iterator[Scene]]:
        """How many Gaussians there are, and scenes of some of them, one after another.

        How many are in a box is known once they are decoded: these are held in memory.

        Raises
        ------
        InvalidInput
            If there are none in the box, of a scene that has some.
        """
        scenes = self.scenes()
        if self.chosen.part.box is None:
            return self.chosen.file.header.count, scenes
        found = list(scenes)
        count = sum(scene.count for scene in found)
        if self.chosen.file.header.count and not count:
            corners = describe(self.chosen.file).bounds
            low, high = (" ".join(f"{x:.6g}" for x in corner) for corner in corners)
            raise InvalidInput(f"{self.path}: no Gaussians in the box, bounds {low} to {high}")
        return count, iter(found)

    def scenes(self) -> Iterator[Scene]:
        """Scenes of some Gaussians, one after another; what is whole tells its order."""
        order = None
        start = time.perf_counter()
        with located(self.path):
            if self.chosen.part.box is None:
                order = order_of_file(describe(self.chosen.file))
            for scene in self.chosen.slabs(self._size(), self.progress):
                self.seconds += time.perf_counter() - start
                yield _marked(scene, order)
                start = time.perf_counter()
        self.seconds += time.perf_counter() - start

    def _size(self) -> int:
        header = self.chosen.file.header
        wanted = max(_SLAB, 2 * available_threads() * header.block_size)
        return slab_within(header, self.sh_degree, wanted)


def _marked(scene: Scene, order: Order | None) -> Scene:
    return scene if order is None else with_order(scene, order)


@contextmanager
def opened_slabs(
    path: str | Path,
    part: Part,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    tmc3: str | Path | None = None,
    max_memory: int | None = None,
) -> Iterator[Slabs]:
    """The slabs of a file, or of a part of it, while it is open.

    Raises
    ------
    InvalidInput
        If the file cannot be read.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If it is not a sound `.egs` file; of what is in its blocks, slabs tell.
    MissingTool
        If it uses G-PCC, and the program (`tmc3`, or what the environment says) is not there.
    """
    with using_threads(threads), bounded(max_memory), open_scene(path) as file:
        start = time.perf_counter()
        _check_format(file)
        with located(path):
            check_threads(threads)
            chosen = choose_part(file.data, part, max_bytes, tmc3)
        yield Slabs(Path(path), chosen, progress, time.perf_counter() - start)


def _check_format(file: SceneFile) -> None:
    """Refuse scenes of other formats, and say what reads them."""
    with suppress(InvalidInput):
        if file.format != "egs":
            raise CorruptStream(
                f"{file.path}: {file.format}, not an .egs file; `convert` reads other formats"
            )


@dataclass(frozen=True)
class VerifyReport:
    """What a sound file holds.

    Attributes
    ----------
    count, sh_degree, profile
        As in the header.
    blocks, sections : int
        How many were decoded, and had the checksums that the header says.
    file_bytes : int
    seconds : float
    """

    count: int
    sh_degree: int
    profile: str
    blocks: int
    sections: int
    file_bytes: int
    seconds: float


def verify_file(
    path: str | Path,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    tmc3: str | Path | None = None,
    max_memory: int | None = None,
) -> VerifyReport:
    """Check every checksum of an `.egs` file and decode all of it, writing nothing.

    Raises
    ------
    InvalidInput
        If the file cannot be read.
    CorruptStream, TruncatedStream, UnsupportedVersion
        If it is not a sound `.egs` file.
    MissingTool, ToolFailed
        If it uses G-PCC, and the program (`tmc3`, or what the environment says) is not there or
        does not decode it.
    """
    start = time.perf_counter()
    with opened_slabs(path, Part(), threads, max_bytes, progress, tmc3, max_memory) as slabs:
        with located(path):
            # Those that a decoder passes over too.
            file = slabs.chosen.file.read()
        for _ in slabs.scenes():
            pass
        header = file.header
        return VerifyReport(
            header.count,
            header.sh_degree,
            header.profile,
            header.block_count,
            len(file.table),
            os.path.getsize(path),
            time.perf_counter() - start,
        )
