"""Open scenes: their Gaussians, facts about the file, and pruning reports."""

from __future__ import annotations

import json
import logging
import os
import tokenize
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.codecs.matching import without_order
from gs_codec.coding.clean import sound_gaussians
from gs_codec.config import ADAPTIVE_PROFILES
from gs_codec.edit.clusters import linked_neighbours
from gs_codec.edit.join import merge_scenes
from gs_codec.edit.motion import move_rows
from gs_codec.edit.project_file import Move, Source
from gs_codec.egs import frame_sections
from gs_codec.errors import one_line, printable
from gs_codec.files.scenes import (
    gaussian_bits_of_file,
    gaussian_classes_of_file,
    scene_in,
    turn_scene,
)
from gs_codec.formats import registry
from gs_codec.formats.cloud import from_cloud, to_cloud, turn_cloud
from gs_codec.formats.coordinates import CONVENTION, system_of
from gs_codec.preparation.prepare_report import centres_checksum
from gs_codec.runtime.kept_logs import keeping_logs
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_C0, SH_COEFFICIENTS, Scene, float_bytes
from viewer.scenes.clip import Moment

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

log = logging.getLogger(__name__)

#: Called with the stage, the steps done, and the total number of steps.
Progress = Callable[[str, int, int], None]

#: Exceptions that reading a damaged report may raise.
_DAMAGE = (
    OSError, EOFError, LookupError, ValueError, TypeError, SyntaxError, RecursionError, MemoryError,
    OverflowError, tokenize.TokenError,
)  # fmt: skip

#: A block's box spans these quantiles of its centres along each axis.
_BOX = (0.02, 0.98)

#: The most common coordinate system of scenes that state none but are not in that of PLY files.
_OTHER = "RUB"


@dataclass(frozen=True, eq=False)
class Opened:
    """An open scene and its source.

    Attributes
    ----------
    name : str
        Name of the file, or the name given for a cloud.
    cloud : open3d.t.geometry.PointCloud
        Cloud with the attributes from `gs_codec.read`; axes right, down, forward.
    file_bytes : int or None
        Size of all files of the scene.
    info : gs_codec's Info or None
        For an ``.egs`` file.
    system : str
        The coordinate system of the file.
    path : Path
        Path of the file; empty for a cloud.
    comments : tuple of str
        Comments of the file; a comment on the order is kept only if the scene was not turned.
    files : tuple of Path
        All its files, which some formats have several of; empty for a cloud.
    modified : tuple of int or None
        Their modification times before they were read; see `times_of`.
    system_given : bool
        Whether `turned` set `system`, not the file.
    whole : Opened or None
        For an edited scene, the M Gaussians of the file; None if none are deleted.
    left : ndarray, shape (M,), bool, or None
        Mask of those that are not deleted.
    moves : tuple of Move
        How some of the M were moved.
    hidden : ndarray, shape (M,), bool, or None
        Mask of those that are hidden at first.
    sources : tuple of Source
        The files of a scene that joins several; `path` is that of the first.
    moment : Moment or None
        For a frame of a sequence; `path` is that of the sequence.
    """

    name: str
    cloud: PointCloud
    file_bytes: int | None = None
    info: gs_codec.Info | None = None
    system: str = CONVENTION
    path: Path = Path()
    comments: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    modified: tuple[int | None, ...] = ()
    system_given: bool = False
    whole: Opened | None = None
    left: NDArray[np.bool_] | None = None
    moves: tuple[Move, ...] = ()
    hidden: NDArray[np.bool_] | None = None
    sources: tuple[Source, ...] = ()
    moment: Moment | None = None

    @property
    def parts(self) -> tuple[Source, ...]:
        """Its files; a cloud or frame has no path."""
        path = self.path if self.moment is None else Path()
        return self.sources or (Source(path, self.name, self.file_count),)

    @cached_property
    def checksums(self) -> list[int]:
        """`centres_checksum` of each of its files, for a scene that is not edited."""
        ends = np.cumsum([part.gaussians for part in self.parts])
        return [centres_checksum(part.T) for part in np.split(self.positions, ends[:-1])]

    @property
    def paths(self) -> list[Path]:
        """Paths that saving must not replace; empty ones for clouds."""
        return [self.path, *(part.path for part in self.parts)]

    @property
    def title(self) -> str:
        """The name, with notes if it is edited or was converted from another coordinate system."""
        name = self.name if self.whole is None else f"{self.name}, edited"
        return name if self.system == CONVENTION else f"{name}, converted from {self.system}"

    @property
    def is_stored(self) -> bool:
        """Whether the scene equals its file: neither edited nor turned."""
        changed = self.whole is not None or self.system_given or len(self.sources) > 1
        return self.is_file and not changed

    @property
    def is_file(self) -> bool:
        """Whether its Gaussians are those of files, not of clouds or frames."""
        return all(part.path != Path() for part in self.parts)

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return len(self.positions)

    @property
    def file_count(self) -> int:
        """Number of Gaussians in the file."""
        return self.count if self.whole is None else self.whole.count

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Row in the file of each Gaussian ``(N,)``."""
        return np.arange(self.count) if self.left is None else np.flatnonzero(self.left)

    @cached_property
    def gaussians(self) -> Scene:
        """The Gaussians as a `Scene`, with the file's comments; shares memory."""
        return replace(from_cloud(self.cloud, "drop", tell=False), comments=self.comments)

    @property
    def gaussians_with_extra(self) -> Scene:
        """Like `gaussians`, with extra properties."""
        return replace(from_cloud(self.cloud, "keep"), comments=self.comments)

    @cached_property
    def positions(self) -> NDArray[np.float32]:
        """Centres ``(N, 3)``."""
        return self._array("positions")

    @cached_property
    def colours(self) -> NDArray[np.float32]:
        """SH-DC colours, RGB ``(N, 3)``, 0-1."""
        return np.clip(0.5 + SH_C0 * self._array("f_dc"), 0, 1).astype(np.float32)

    @cached_property
    def opacities(self) -> NDArray[np.float32]:
        """Opacities ``(N,)``, 0-1."""
        with np.errstate(over="ignore"):
            return np.float32(1) / (1 + np.exp(-self._array("opacity")[:, 0]))

    @cached_property
    def lengths(self) -> NDArray[np.float64]:
        """Longest axis ``(N,)``, scene units."""
        with np.errstate(over="ignore"):
            return np.exp(self._array("log_scale").max(axis=1).astype(np.float64))

    @cached_property
    def sh_energy(self) -> NDArray[np.float64]:
        """Sum of squares of the SH-AC of each Gaussian ``(N,)``."""
        f_rest = self._array("f_rest")
        return np.einsum("nkc,nkc->n", f_rest, f_rest, dtype=np.float64)

    @cached_property
    def damaged(self) -> int:
        """Number of Gaussians with NaN or infinity, which are not drawn."""
        return int(np.count_nonzero(~sound_gaussians(self.gaussians)))

    @cached_property
    def neighbours(self) -> NDArray[np.int32]:
        """Linked neighbours ``(N, K)`` of each Gaussian; see `linked_neighbours`."""
        if self.whole is None or self.moves:
            return linked_neighbours(self.gaussians)
        places = np.full(self.whole.count, -1, np.int32)
        places[self.rows] = own = np.arange(self.count, dtype=np.int32)
        found = places[self.whole.neighbours[self.rows]]
        return np.where(found < 0, own[:, None], found)

    @property
    def sh_degree(self) -> int:
        """SH degree, 0 to 3."""
        return SH_COEFFICIENTS.index(self.cloud.point["f_rest"].shape[1])

    @property
    def raw_bytes(self) -> int:
        """Size of the attributes as float32."""
        return float_bytes(self.count, self.sh_degree)

    @cached_property
    def blocks(self) -> NDArray[np.float32]:
        """Boxes ``(blocks, 2, 3)`` around most centres of each block of an ``.egs`` file.

        The boxes ignore the few far centres, which would make every box as large as the scene.
        Empty if the file is not ``.egs``, has one block, or restores the original order.
        """
        info = self.info
        if info is None or info.keeps_order or self.file_count <= info.block_size:
            return np.zeros((0, 2, 3), np.float32)
        starts = np.searchsorted(self.rows, range(0, self.file_count, info.block_size))
        blocks = [block for block in np.split(self.positions, starts[1:]) if len(block)]
        if not blocks:
            return np.zeros((0, 2, 3), np.float32)
        return np.stack([np.quantile(block, _BOX, axis=0) for block in blocks]).astype(np.float32)

    @cached_property
    def bits(self) -> NDArray[np.float64] | None:
        """Bits of each Gaussian ``(N,)``, by `gaussian_bits`; None if `bits_unknown`.

        Raises
        ------
        gs_codec.GsCodecError
            If the file has changed.
        """
        if self.bits_unknown:
            return None
        if self.whole is not None:
            bits = self.whole.bits
            return None if bits is None else bits[self.rows]
        self.check_unchanged()
        return gaussian_bits_of_file(self.path)

    @cached_property
    def classes(self) -> NDArray[np.uint8] | None:
        """Classes of shape and of colour ``(2, N)``; None if `unknown`.

        Raises
        ------
        gs_codec.GsCodecError
            If the file has changed.
        """
        if self.unknown("class"):
            return None
        if self.whole is not None:
            classes = self.whole.classes
            return None if classes is None else classes[:, self.rows]
        self.check_unchanged()
        return gaussian_classes_of_file(self.path)

    @property
    def block_numbers(self) -> NDArray[np.int64] | None:
        """Block number of each Gaussian ``(N,)``; None if `unknown`."""
        info = None if self.unknown("block") else self.info
        return None if info is None else self.rows // info.block_size

    def unknown(self, colouring: str) -> str:
        """Why a quantity of `COLOURINGS` is unknown for this scene alone; empty if it is known."""
        if colouring in ("bits", "block", "class") and self.bits_unknown:
            return self.bits_unknown
        profile = self.info.profile if self.info is not None else ""
        if colouring == "class" and profile not in ADAPTIVE_PROFILES:
            return f"of profile {profile}"
        return "of SH degree 0" if colouring == "sh" and not self.sh_degree else ""

    @property
    def bits_unknown(self) -> str:
        """Why the bits of single Gaussians are unknown; empty if they are known."""
        if self.info is None or not self.count:
            return "not an .egs file" if self.count else "without Gaussians"
        return "stored in the original order" if self.info.keeps_order else ""

    @property
    def can_reload(self) -> bool:
        """Whether it can be read again: it is no cloud, and no project or frame."""
        return self.file_bytes is not None and not self.sources

    @property
    def has_changed(self) -> bool:
        """Whether a file has changed since it was opened."""
        return times_of(self.files) != self.modified

    def check_unchanged(self) -> None:
        """Check that no file has changed since it was opened.

        Raises
        ------
        gs_codec.GsCodecError
        """
        if self.has_changed:
            raise gs_codec.GsCodecError(f"{self.path}: changed after it was opened")

    def _array(self, name: str) -> NDArray[np.float32]:
        return np.ascontiguousarray(self.cloud.point[name].numpy())


def thinned(count: int, most: int) -> slice:
    """A slice that selects at most `most` of `count` items, evenly spaced in stored order."""
    return slice(None, None, max(1, -(-count // max(most, 1))))


def open_scene(
    source: Path | str | PointCloud,
    name: str = "",
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> Opened:
    """Read a scene from a file or cloud; `progress` and `max_bytes` are as in `gs_codec.read`.

    Raises
    ------
    gs_codec.GsCodecError
    """
    if not isinstance(source, str | Path):
        return Opened(name or "cloud", source)
    written = times_of([Path(source)])
    with registry.open_scene(source) as file:
        beside = file.files_beside
        written += times_of(beside)
        scene, size = scene_in(file, "drop", progress, None, max_bytes), file.stored_bytes
    shown = turn_scene(scene, CONVENTION)
    cloud = to_cloud(shown)
    info = None
    # Reading has already warned. Others than .egs files fail.
    with keeping_logs([frame_sections.__name__], lambda _: False), suppress(gs_codec.GsCodecError):
        info = gs_codec.inspect(source)
    path, system = Path(source), system_of(scene)
    name, files = printable(path.name), (path, *beside)
    return Opened(name, cloud, size, info, system, path, shown.comments, files, written)


def times_of(files: Sequence[Path]) -> tuple[int | None, ...]:
    """Modification times of files, nanoseconds; None for one that is unknown."""
    return tuple(map(_modified, files))


def _modified(path: Path) -> int | None:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return None


def keep(scene: Opened, left: NDArray[np.bool_], moves: tuple[Move, ...] = ()) -> Opened:
    """The Gaussians of a whole scene in the mask ``(M,)``, moved; the scene itself for all.

    Raises
    ------
    gs_codec.GsCodecError
        If a move shears, or scales axes differently.
    """
    if left.all() and not moves:
        return scene
    cloud = to_cloud(move_rows(from_cloud(scene.cloud, "keep"), moves).take(left))
    comments = without_order(scene.gaussians).comments
    return replace(scene, cloud=cloud, comments=comments, whole=scene, left=left, moves=moves)


def joined(scenes: Sequence[Opened]) -> Opened:
    """Several whole scenes as one, as by `gs_codec.edit.merge`."""
    merged = merge_scenes([scene.gaussians_with_extra for scene in scenes])
    parts = tuple(part for scene in scenes for part in scene.parts)
    return Opened(
        " + ".join(part.name for part in parts),
        to_cloud(merged),
        path=scenes[0].path,
        comments=merged.comments,
        files=tuple(file for scene in scenes for file in scene.files),
        modified=tuple(time for scene in scenes for time in scene.modified),
        sources=parts,
    )


def turned(scene: Opened) -> Opened:
    """The scene converted from ``RUB`` to ``RDF``; a second call undoes it.

    For files that are in another coordinate system but do not state it.
    """
    was = scene.system == _OTHER
    return replace(
        scene,
        cloud=turn_cloud(scene.cloud, _OTHER),
        system=CONVENTION if was else _OTHER,
        comments=without_order(scene.gaussians).comments,
        system_given=not scene.system_given,
    )


@dataclass(frozen=True, eq=False)
class Pruned:
    """The Gaussians of a scene that preparation removed.

    Attributes
    ----------
    reasons : tuple of str
    labels : ndarray, shape (N,), uint8
        For each Gaussian: 0 if kept, otherwise 1 + the index of the reason.
    """

    reasons: tuple[str, ...]
    labels: NDArray[np.uint8]

    @property
    def counts(self) -> dict[str, int]:
        """Number of pruned Gaussians by reason."""
        counts = np.bincount(self.labels, minlength=len(self.reasons) + 1)[1:]
        return dict(zip(self.reasons, counts.tolist(), strict=True))

    def of(self, scene: Opened) -> Pruned:
        """The same for the Gaussians left in an edited scene."""
        return self if scene.whole is None else replace(self, labels=self.labels[scene.rows])


def read_pruned(folder: Path | str, scene: Opened) -> Pruned:
    """Read the report that ``gs-codec prepare --report`` wrote for a scene.

    Raises
    ------
    gs_codec.GsCodecError
        If there is no report, or it is for another scene.
    """
    folder = Path(folder)
    try:
        report = json.loads((folder / "report.json").read_text())
        reasons, centres = tuple(dict(report["removed"])), report.get("centres_crc32c")
        labels = np.load(folder / "labels.npy", allow_pickle=False)
    except _DAMAGE as error:
        reason = one_line(error) if isinstance(error, OSError) else "damaged"
        raise gs_codec.GsCodecError(f"{folder}: no report of prepare ({reason})") from error
    if labels.dtype != np.uint8 or labels.shape != (scene.file_count,):
        raise gs_codec.GsCodecError(
            f"{folder}: labels of {counted(labels.size, 'Gaussian')}, {scene.name} has "
            f"{scene.file_count:,}"
        )
    if centres is None:
        log.warning(
            "%s: no checksum of its scene; only the number of Gaussians was checked", folder
        )
    elif centres != centres_checksum((scene.whole or scene).positions.T):
        raise gs_codec.GsCodecError(
            f"{folder}: report of another scene than {scene.name}, or of another order: "
            "the checksum of centres differs"
        )
    if labels.max(initial=0) > len(reasons):
        raise gs_codec.GsCodecError(f"{folder}: label {labels.max()}, expected 0 to {len(reasons)}")
    return Pruned(reasons, labels)
