"""A scene that was opened: its Gaussians, and what its file says."""

from __future__ import annotations

import json
import os
import tokenize
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cloud import to_cloud, turn_cloud
from gs_codec.files import read_scene, turn_scene
from gs_codec.scene import SH_C0, SH_COEFFICIENTS, float_bytes
from gs_codec.transform.coordinates import CONVENTION, system_of

if TYPE_CHECKING:
    from open3d.t.geometry import PointCloud

#: Called with what is done, how many steps of it, and of how many.
Progress = Callable[[str, int, int], None]

#: What reading a damaged report may raise.
_DAMAGE = (
    OSError, EOFError, LookupError, ValueError, TypeError, SyntaxError, RecursionError, MemoryError,
    OverflowError, tokenize.TokenError,
)  # fmt: skip

#: Quantiles of the centres along each axis between which a block's box is.
_BOX = (0.02, 0.98)

#: The system that scenes are in most often which do not say theirs and are not as PLY files are.
_OTHER = "RUB"


@dataclass(frozen=True, eq=False)
class Opened:
    """A scene and where it came from.

    Attributes
    ----------
    name : str
        The file's, or what a cloud was called.
    cloud : open3d.t.geometry.PointCloud
        With the attributes that `gs_codec.read` gives: right, down, forward.
    file_bytes : int or None
    info : gs_codec's Info or None
        Of an ``.egs`` file.
    system : str
        The coordinate system that the file is in.
    """

    name: str
    cloud: PointCloud
    file_bytes: int | None = None
    info: Any = None
    system: str = CONVENTION

    @property
    def title(self) -> str:
        """The name, and which coordinate system it was turned from, if it was."""
        return self.name if self.system == CONVENTION else f"{self.name}, turned from {self.system}"

    @property
    def count(self) -> int:
        """Gaussians."""
        return len(self.positions)

    @cached_property
    def positions(self) -> NDArray[np.float32]:
        """Centres ``(N, 3)``."""
        return self._array("positions")

    @cached_property
    def colours(self) -> NDArray[np.float32]:
        """What SH-DC shows, RGB ``(N, 3)``, 0-1."""
        return np.clip(0.5 + SH_C0 * self._array("f_dc"), 0, 1).astype(np.float32)

    @cached_property
    def opacities(self) -> NDArray[np.float32]:
        """``(N,)``, 0-1."""
        return np.float32(1) / (1 + np.exp(-self._array("opacity")[:, 0]))

    @cached_property
    def sizes(self) -> NDArray[np.float32]:
        """Log10 of the longest axis ``(N,)``, scene units."""
        return self._array("log_scale").max(axis=1) / np.float32(np.log(10))

    @property
    def sh_degree(self) -> int:
        """0 to 3."""
        return SH_COEFFICIENTS.index(self.cloud.point["f_rest"].shape[1])

    @property
    def raw_bytes(self) -> int:
        """Size of the attributes as float32."""
        return float_bytes(self.count, self.sh_degree)

    @cached_property
    def blocks(self) -> NDArray[np.float32]:
        """Where most of each block's centres are, ``(blocks, 2, 3)``; blocks decode apart.

        Far ones are left out: they are few, and would make every box as large as the scene. None
        where a file is not ``.egs``, has one block alone, or another order than its blocks'.
        """
        info = self.info
        if info is None or info.keeps_order or self.count <= info.block_size:
            return np.zeros((0, 2, 3), np.float32)
        starts = range(0, self.count, info.block_size)
        blocks = [self.positions[start : start + info.block_size] for start in starts]
        return np.stack([np.quantile(block, _BOX, axis=0) for block in blocks]).astype(np.float32)

    def _array(self, name: str) -> NDArray[np.float32]:
        return np.ascontiguousarray(self.cloud.point[name].numpy())


def open_scene(
    source: Path | str | PointCloud,
    name: str = "",
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> Opened:
    """Read a scene's file, or take a cloud; `progress` and `max_bytes` are as for `gs_codec.read`.

    Raises
    ------
    gs_codec.GsCodecError
    """
    if not isinstance(source, str | Path):
        return Opened(name or "cloud", source)
    scene = read_scene(source, "drop", progress, None, max_bytes)
    cloud = to_cloud(turn_scene(scene, CONVENTION))
    try:
        info = gs_codec.inspect(source)
    except gs_codec.GsCodecError:  # a scene, but no .egs
        info = None
    return Opened(Path(source).name, cloud, os.path.getsize(source), info, system_of(scene))


def turned(scene: Opened) -> Opened:
    """A scene turned as from up and back to down and forward; again, as it was.

    For a file that is in another coordinate system and does not say so.
    """
    was = scene.system == _OTHER
    return replace(
        scene, cloud=turn_cloud(scene.cloud, _OTHER), system=CONVENTION if was else _OTHER
    )


@dataclass(frozen=True, eq=False)
class Pruned:
    """Which Gaussians preparation took out of a scene.

    Attributes
    ----------
    reasons : tuple of str
    labels : ndarray, shape (N,), uint8
        For each Gaussian of the scene 0, or 1 + the place of the reason.
    """

    reasons: tuple[str, ...]
    labels: NDArray[np.uint8]

    @property
    def counts(self) -> dict[str, int]:
        """Gaussians by reason."""
        counts = np.bincount(self.labels, minlength=len(self.reasons) + 1)[1:]
        return dict(zip(self.reasons, counts.tolist(), strict=True))


def read_pruned(folder: Path | str, scene: Opened) -> Pruned:
    """The report of ``gs-codec prepare --report``, about a scene that it was made from.

    Raises
    ------
    gs_codec.GsCodecError
        If there is none, or it is of another scene.
    """
    folder = Path(folder)
    try:
        reasons = tuple(dict(json.loads((folder / "report.json").read_text())["removed"]))
        labels = np.load(folder / "labels.npy", allow_pickle=False)
    except _DAMAGE as error:
        reason = str(error).splitlines()[:1] or [type(error).__name__]
        raise gs_codec.GsCodecError(f"{folder}: no report of prepare ({reason[0]})") from error
    if labels.dtype != np.uint8 or labels.shape != (scene.count,):
        raise gs_codec.GsCodecError(
            f"{folder}: labels of {labels.size:,} Gaussians, {scene.name} has {scene.count:,}"
        )
    if labels.max(initial=0) > len(reasons):
        raise gs_codec.GsCodecError(f"{folder}: label {labels.max()}, expected 0 to {len(reasons)}")
    return Pruned(reasons, labels)
