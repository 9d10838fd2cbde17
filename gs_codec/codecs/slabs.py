"""Decode `.egs` files slab by slab, so that a large scene is never in memory as a whole."""

from __future__ import annotations

import os
import time
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from gs_codec.codecs.decode import ChosenPart, choose_part
from gs_codec.codecs.inspection import describe
from gs_codec.codecs.matching import order_of_file, with_order
from gs_codec.codecs.memory_limit import slab_within
from gs_codec.codecs.part import Part
from gs_codec.coding.extent import box_text
from gs_codec.config import check_threads
from gs_codec.egs.egs_file import MAGIC, EgsFile
from gs_codec.egs.index import bounds_of, check_errors, errors_of, levels_of, open_level, within
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.formats.several_scenes import refuse_several
from gs_codec.report import Progress
from gs_codec.runtime.arrays import bounded
from gs_codec.runtime.mapped import FileBytes, located, opened
from gs_codec.runtime.threads import available_threads, using_threads
from gs_codec.scene import Scene

#: Number of Gaussians decoded at once, or two blocks per thread if that is more.
_SLAB = 1 << 18


@dataclass
class Slabs:
    """An open file that is decoded slab by slab, in stream order.

    ``seconds`` is the time spent on decoding so far.
    """

    path: Path
    chosen: ChosenPart
    progress: Progress | None
    seconds: float

    @property
    def sh_degree(self) -> int:
        """SH degree to which the file is decoded."""
        return self.chosen.degree

    @property
    def bytes_read(self) -> int:
        """Bytes of the file that were read."""
        return self.chosen.bytes_read

    def counted(self) -> tuple[int, Iterator[Scene]]:
        """The number of Gaussians, and the slabs.

        With a box, the number is known only after decoding, so all slabs are kept in memory. Raises
        InvalidInput if the scene has Gaussians, but none are in the box or in view.
        """
        scenes = self.scenes()
        if self.chosen.part.box is None:
            count = self.chosen.count
            if self.chosen.file.header.count and not count:
                raise InvalidInput(f"{self.path}: no Gaussians in view")
            return count, scenes
        found = list(scenes)
        count = sum(scene.count for scene in found)
        bounds = bounds_of(self.chosen.file)
        if bounds is not None and not count:
            raise InvalidInput(f"{self.path}: no Gaussians in the box, {box_text(bounds)}")
        return count, iter(found)

    def scenes(self) -> Iterator[Scene]:
        """Yield one slab after another as a scene; if all are decoded, each states its order."""
        order = None
        start = time.perf_counter()
        with located(self.path):
            if self.chosen.part.whole:
                order = order_of_file(describe(self.chosen.file))
            file = self.chosen.file
            wanted = max(_SLAB, 2 * available_threads() * file.header.block_size)
            size = slab_within(file, self.sh_degree, wanted)
            for scene in self.chosen.slabs(size, self.progress):
                self.seconds += time.perf_counter() - start
                yield with_order(scene, order)
                start = time.perf_counter()
        self.seconds += time.perf_counter() - start


@contextmanager
def opened_slabs(
    path: str | Path,
    part: Part,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    tmc3: str | Path | None = None,
    max_memory: int | None = None,
    among: Container[int] | None = None,
) -> Iterator[Slabs]:
    """Open a file to decode a part of it slab by slab, within the blocks `among` if given.

    Raises InvalidInput if the file cannot be read. Raises CorruptStream, TruncatedStream or
    UnsupportedVersion if it is not a valid `.egs` file; damaged blocks raise when a slab is
    decoded. Raises MissingTool if it needs G-PCC's program (`tmc3`, or from the environment) or
    torchac, and that is not installed.
    """
    refuse_several(path)
    with using_threads(threads), bounded(max_memory), opened(path) as data:
        start = time.perf_counter()
        if bytes(data[: len(MAGIC)]) != MAGIC:
            _refuse_other(Path(path), data)
        with located(path):
            check_threads(threads)
            chosen = choose_part(data, part, max_bytes, tmc3, among)
        yield Slabs(Path(path), chosen, progress, time.perf_counter() - start)


def _refuse_other(path: Path, data: FileBytes) -> None:
    """Report the format of a file that is not `.egs`, if it is a known one."""
    from gs_codec.formats.registry import SceneFile

    with suppress(InvalidInput):
        if (form := SceneFile(path, data).format) != "egs":
            raise CorruptStream(f"{path}: {form}, not an .egs file; `convert` reads other formats")


@dataclass(frozen=True)
class VerifyReport:
    """Result of a successful check: all blocks decode, all sections match their checksums.

    `levels` is the number of coarser levels, which were decoded too.
    """

    count: int
    sh_degree: int
    profile: str
    blocks: int
    sections: int
    file_bytes: int
    seconds: float
    levels: int = 0


def verify_file(
    path: str | Path,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
    tmc3: str | Path | None = None,
    max_memory: int | None = None,
) -> VerifyReport:
    """Check all checksums of an `.egs` file and decode all of it, without writing.

    Raises InvalidInput if the file cannot be read. Raises CorruptStream, TruncatedStream or
    UnsupportedVersion if it is not a valid `.egs` file. Raises MissingTool or ToolFailed if it
    needs G-PCC's program (`tmc3`, or from the environment) or torchac, and that is not installed or
    fails.
    """
    start = time.perf_counter()
    with opened_slabs(path, Part(), threads, max_bytes, progress, tmc3, max_memory) as slabs:
        with located(path):
            # Check all sections, including those that a decoder skips.
            file = slabs.chosen.file.read()
        for _ in slabs.scenes():
            pass
        levels = levels_of(file)
        for level in levels:
            with located(path):
                chosen = choose_part(file.data, Part(level=level), max_bytes)
                _check_all(chosen, file, level)
            for _ in Slabs(slabs.path, chosen, progress, 0.0).scenes():
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
            len(levels),
        )


def _check_all(chosen: ChosenPart, file: EgsFile, level: int) -> None:
    """Check all sections of a level, and its errors against those of the finer level."""
    with within(level):
        chosen.file.read()
        if level > 1:
            check_errors(errors_of(open_level(file, level - 1)), errors_of(chosen.file))
