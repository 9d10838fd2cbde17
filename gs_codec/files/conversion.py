"""Convert scenes between formats, and report what is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.matching import without_order
from gs_codec.coding.clean import drop_nonfinite
from gs_codec.config import LOSSLESS, Config, as_config
from gs_codec.edit.actions import Action
from gs_codec.edit.apply import edit_scenes
from gs_codec.encoding.combinations import check_conversion
from gs_codec.encoding.order import check_by
from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import blocks_in, early_shifts, read_scene, turn_scene
from gs_codec.files.suffixes import check_target
from gs_codec.files.writing import keeps_rounding, write_scene, written_bytes
from gs_codec.format_table import TILESET, format_of
from gs_codec.formats.coordinates import CONVENTION, state_system, system_of, turn_axes
from gs_codec.report import ActionReport, Progress, RenderedLoss, StageTimes
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.arrays import bounded
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene, Shift

if TYPE_CHECKING:
    from gs_codec.plan import Plan


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
        Whether the source uses opacity compensation.
    dropped : int
        Number of removed Gaussians with NaN or infinity.
    actions : tuple of gs_codec.edit.ActionReport
        Report of each action.
    lost : tuple of str
        Sentences on what the target's format cannot represent.
    file_bytes : int
        Size of the output.
    ratio : float
        Compression ratio relative to the floats.
    seconds : dict of str to float
        Wall time of each stage.
    rendered : RenderedLoss, optional
        Loss in rendered views; None for formats with floats.
    float_bytes : int
        Size of the output's floats.

    Examples
    --------
    >>> report = gs_codec.convert_file("scene.ply", "scene.spz")
    >>> report.coordinates, report.turned_from, report.file_bytes < report.float_bytes
    ('RUB', 'RDF', True)
    """

    count: int
    sh_degree: int
    coordinates: str
    turned_from: str | None
    antialiased: bool
    dropped: int
    actions: tuple[ActionReport, ...]
    lost: tuple[str, ...]
    file_bytes: int
    ratio: float
    seconds: dict[str, float]
    rendered: RenderedLoss | None = None
    float_bytes: int = 0


@checked
def convert_file(
    source: str | Path | Sequence[str | Path],
    target: str | Path,
    config: Config | str | None = None,
    coordinates: str = CONVENTION,
    *,
    chosen: NDArray[np.bool_] | None = None,
    actions: Sequence[Action] = (),
    plan: Plan | None = None,
    progress: Progress | None = None,
    max_memory: int | None = None,
    max_bytes: int | None = None,
    overwrite: bool = False,
    by_profile: bool = False,
    at: tuple[float, float, float] | None = None,
    level: int = 0,
) -> ConvertReport:
    """Convert a scene to the format of the target's suffix, atomically.

    Parameters
    ----------
    source : path, or sequence of paths
        Scenes; several are merged; see `gs_codec.edit.merge`.
    target : str or Path
        Its suffix selects the format; ``gs-codec convert --help`` lists them.
    config : Config or str, optional
        How to encode the target. Formats of uncompressed floats use
        only its options for extra properties and NaN.
    coordinates : str
        Coordinate system to convert to, or ``keep``; PLY and ``.splat`` files use ``RDF``, and
        formats with a fixed system always use that. ``RUB:RDF`` converts from
        the first to the second, whatever the source states.
    chosen : ndarray, shape (N,), bool, optional
        Mask of the Gaussians to keep, in the order of the source; only for a single source.
    actions : sequence of gs_codec.edit.Action
        Edits to apply then, in this order. The scene is in ``RDF``.
    plan : Plan, optional
        Its cameras and views guide actions.
    progress, max_bytes
        As in `read`.
    max_memory : int, optional
        Maximum memory, bytes: large arrays are then in temporary files, with the same result. Only
        for `.egs` or binary PLY sources with floats; `.ply`, `.csv`, `.egs`, `.spz`, `.sog` or
        streamed SOG targets; and actions that treat each Gaussian separately or sort them.
    overwrite : bool
        As in `encode_file`.
    by_profile : bool
        Whether values from a format that quantises are rounded to the steps of the profile. By
        default they keep the precision of the output format, unless `config` is a profile name, or
        changes the default profile, coarseness or `strict`.
    at : tuple of three float, optional
        Longitude and latitude in degrees and height in metres of the origin of 3D Tiles, on the
        ellipsoid WGS 84: right becomes east, forward north. Default: not on the earth.
    level : int
        Level of detail of the sources; 1 and more, which are coarser, for `.egs` and 3D Tiles only.

    Returns
    -------
    ConvertReport
        What was written, and what was lost.

    Raises
    ------
    InvalidInput, CorruptStream, TruncatedStream, UnsupportedVersion, MissingTool, ToolFailed
        As in `read` and `write`.

    Examples
    --------
    >>> report = gs_codec.convert_file("scene.ply", "scene.splat")
    >>> report.count, report.lost[0]
    (2000, 'opacity, colour and rotation rounded to 8 bits')
    """
    by_profile |= isinstance(config, str)
    config, actions = as_config(config), tuple(actions)
    sources = [source] if isinstance(source, str | Path) else list(source)
    if not sources:
        raise InvalidInput("source: no scenes, expected at least one")
    suffix = check_target(sources, target, overwrite=overwrite)
    check_conversion(target, suffix, config, plan, actions, max_memory, at)
    stated, _, wanted = coordinates.rpartition(":")
    known = format_of(suffix)
    own = known.system
    if own and wanted.upper() not in ("KEEP", CONVENTION, own):
        raise InvalidInput(f"{target}: coordinates {wanted!a:.20}, expected {own} of its format")
    dropped, times = 0, StageTimes()
    finest = keeps_rounding(sources, suffix, config, by_profile)
    exact = suffix == ".egs" and config.profile == LOSSLESS and not actions
    shifts = early_shifts(sources, actions, stated)
    with using_threads(config.threads), bounded(max_memory):
        with times.stage("read"):
            read = partial(_read, config, stated, progress, max_bytes, exact, level)
            scenes = list(map(read, shifts or repeat(None), sources))
        with located(" + ".join(map(str, sources))):
            before = system_of(scenes[0])
            with times.stage("edit"):
                if chosen is not None:
                    scenes = [_choose(scenes, np.asarray(chosen))]
                scene, done = edit_scenes(
                    scenes, actions, plan, progress, shifts is not None, check_by(plan)
                )
            del scenes
            if suffix != ".egs" or config.profile != LOSSLESS or config.nonfinite == "drop":
                scene, dropped = drop_nonfinite(scene, config)
            if own:
                scene = turn_scene(scene, CONVENTION)
            else:
                scene = turn_scene(scene, before if wanted == "keep" else wanted.upper())
        with times.stage("write"):
            blocks = None
            changes = chosen is not None or actions or level
            if suffix == TILESET and len(sources) == 1 and not changes:
                blocks = blocks_in(sources[0], scene)
            lost, rendered = write_scene(target, scene, config, finest=finest, at=at, blocks=blocks)
    after = own or system_of(scene)
    size = written_bytes(target)
    return ConvertReport(
        scene.count,
        known.sh_degrees.get(suffix, scene.sh_degree),
        after,
        before if before != after else None,
        scene.antialiased,
        dropped,
        done,
        lost,
        size,
        scene.float_bytes / size,
        times.seconds,
        rendered,
        scene.float_bytes,
    )


def _choose(scenes: Sequence[Scene], chosen: NDArray[np.bool_]) -> Scene:
    """The chosen Gaussians of the only scene, in ``RDF``."""
    expected = [(scene.count,) for scene in scenes]
    if [chosen.shape] != expected or chosen.dtype != bool:
        raise InvalidInput(f"chosen: {chosen.dtype} {chosen.shape}, expected bool {expected}")
    if not chosen.any():
        raise InvalidInput("chosen: no Gaussian")
    return without_order(turn_axes(scenes[0])).take(chosen)


def _read(
    config: Config,
    stated: str,
    progress: Progress | None,
    most: int | None,
    exact: bool,
    level: int,
    shift: Shift | None,
    source: str | Path,
) -> Scene:
    """The scene of a file, in the system that the file states or that the caller states for it."""
    extra = config.chosen_extra(keeps=True)
    scene = read_scene(source, extra, progress, None, most, exact, shift, level)
    with located(source):
        return state_system(scene, stated.upper()) if stated else scene
