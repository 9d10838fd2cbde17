"""Convert scenes between formats, and report what is lost."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from gs_codec.coding.clean import drop_nonfinite
from gs_codec.config import LOSSLESS, Config
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import check_target, read_scene, turn_scene, write_scene
from gs_codec.files.suffixes import UNBUNDLED
from gs_codec.formats.coordinates import CONVENTION, OWN_SYSTEMS, state_system, system_of
from gs_codec.formats.registry import open_scene
from gs_codec.report import Progress, StageTimes
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads

#: SH degrees of formats that have but one.
_DEGREES = {".splat": 0, ".ckpt": 3}


@dataclass(frozen=True)
class ConvertReport:
    """Result of converting a file.

    Attributes
    ----------
    count, sh_degree : int
        Number of Gaussians and SH degree of the target.
    coordinates : str
        Coordinate system of the target.
    turned_from : str or None
        Coordinate system of the source, if it was converted.
    antialiased : bool
        Whether the source asks for opacity compensation.
    dropped : int
        Gaussians with NaN or infinity, which were removed.
    lost : tuple of str
        What the target's format cannot hold, in words.
    file_bytes : int
        Size of what was written.
    seconds : dict of str to float
        Wall time of each stage.
    """

    count: int
    sh_degree: int
    coordinates: str
    turned_from: str | None
    antialiased: bool
    dropped: int
    lost: tuple[str, ...]
    file_bytes: int
    seconds: dict[str, float]


def convert_file(
    source: str | Path,
    target: str | Path,
    config: Config | None = None,
    coordinates: str = CONVENTION,
    *,
    progress: Progress | None = None,
    max_bytes: int | None = None,
    overwrite: bool = True,
) -> ConvertReport:
    """Convert a scene to the format of the target's suffix; it appears whole or not at all.

    Parameters
    ----------
    source, target : str or Path
        Scenes; the suffix of the target selects its format, one of `FORMATS`, ``.ply``,
        ``.pt`` (gsplat's checkpoint), ``.ckpt`` (splatfacto's) or ``.csv`` (a table of attributes).
    config : Config, optional
        How to encode the target. The last four use only its options for extra properties and NaN.
    coordinates : str
        Coordinate system to convert to, or ``keep``; PLY and ``.splat`` files use ``RDF``, and
        formats that have a system of their own, as ``.spz`` has, are always in that.
        ``RUB:RDF`` converts from the first to the second, whatever the source states.
    progress, max_bytes
        As for `read`.
    overwrite : bool
        As for `encode_file`.

    Returns
    -------
    ConvertReport
        What was written, and what of the source it does not have.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool, ToolFailed
        As for `read` and `write`.

    Examples
    --------
    >>> report = gs_codec.convert_file("scene.ply", "scene.splat")
    >>> report.count, report.lost[0]
    (2000, 'opacity, colour and rotation rounded to 8 bits')
    """
    config = config or Config(extra="keep")
    suffix = check_target(source, target, overwrite=overwrite)
    stated, _, wanted = coordinates.rpartition(":")
    own = OWN_SYSTEMS.get(suffix)
    if own is not None and wanted.upper() not in ("KEEP", CONVENTION, own):
        raise InvalidInput(f"{target}: coordinates {wanted!a:.20}, expected {own} of its format")
    dropped, times = 0, StageTimes()
    with using_threads(config.threads):
        with times.stage("read"):
            scene = read_scene(source, config.extra, progress, None, max_bytes)
        with located(source):
            if stated:
                scene = state_system(scene, stated.upper())
            before = system_of(scene)
            if suffix != ".egs" or config.profile != LOSSLESS or config.nonfinite == "drop":
                scene, dropped = drop_nonfinite(scene, config)
            if own is not None:
                scene = turn_scene(scene, CONVENTION)
            elif wanted != "keep":
                scene = turn_scene(scene, wanted.upper())
        with times.stage("write"):
            lost = write_scene(target, scene, config)
    after = own or system_of(scene)
    size = os.path.getsize(target)
    if suffix == UNBUNDLED:
        with open_scene(target) as file:
            size = file.stored_bytes
    return ConvertReport(
        scene.count,
        _DEGREES.get(suffix, scene.sh_degree),
        after,
        before if before != after else None,
        scene.antialiased,
        dropped,
        lost,
        size,
        times.seconds,
    )
