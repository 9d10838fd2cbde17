"""Write scenes in any format."""

from __future__ import annotations

import io
import logging
import os
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from gs_codec.codecs import matching
from gs_codec.coding.clean import clean_scene
from gs_codec.config import Config
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.files.suffixes import LEVELLED, check_place, config_for, suffix_of
from gs_codec.format_table import SSOG, STREAMED, TILESET, UNBUNDLED, format_of
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.registry import open_scene, read_written
from gs_codec.formats.tiles.earth import Place
from gs_codec.formats.zip_file import write_zip
from gs_codec.levels.streaming import stream_levels
from gs_codec.levels.tiling import Blocks, tile_levels
from gs_codec.report import RenderedLoss, psnr_loss
from gs_codec.runtime.atomic import atomic_writer, write_files
from gs_codec.runtime.mapped import located
from gs_codec.scene import Scene

log = logging.getLogger(__name__)


class Written(NamedTuple):
    """Losses of a written scene.

    Attributes
    ----------
    lost : tuple of str
        Sentences on what the format cannot represent; also logged as warnings.
    rendered : RenderedLoss or None
        Loss in rendered views; None for formats with floats.
    """

    lost: tuple[str, ...]
    rendered: RenderedLoss | None = None


def write_scene(
    path: str | Path,
    scene: Scene,
    config: Config,
    overwrite: bool = True,
    finest: bool = False,
    at: Place | None = None,
    blocks: Blocks | None = None,
) -> Written:
    """Write a scene in any supported output format.

    If `finest`, it is written as finely as possible, whatever the profile; coarser levels of detail
    still follow the profile. `at` and `blocks` are those of 3D Tiles. Raises InvalidInput if the
    suffix is not supported, or the file cannot be written or, without `overwrite`, exists.
    """
    suffix = suffix_of(path)
    check_place(path, overwrite)
    known = format_of(suffix)
    if known.writes == "floats":
        assert known.writer is not None
        written = Written(known.writer(path, scene))
    elif known.writes == "levels":
        with located(path):
            config = config_for(path, config, LEVELLED)
            config.check_options_of(known)
            if suffix == TILESET:
                files, lost = tile_levels(scene, config, at, finest=finest, blocks=blocks)
            else:
                files, lost = stream_levels(scene, config, finest=finest)
        if suffix == SSOG:
            with atomic_writer(path) as file:
                write_zip(file, {STREAMED: files.pop(STREAMED), **files})
        else:
            write_files(Path(path).parent, files)
        written = Written(lost, measured(path, scene, config, finest))
    else:
        with located(path):
            config = config_for(path, config)
            parts, report = encode(scene, Request(config), finest=finest)
        write_parts(path, parts)
        written = Written(report.lost, report.rendered)
    tell_lost(path, written.lost)
    return written


def keeps_rounding(
    sources: Sequence[str | Path], suffix: str, config: Config, by_profile: bool
) -> bool:
    """Whether quantised values keep the precision of a format with step sizes.

    False if a profile, a coarseness or an aim (`strict`) is requested.
    """
    requested = config.profile, config.coarseness, config.strict
    chosen = by_profile or requested != (Config.profile, 1, False)
    known = format_of(suffix)
    known = known.variants.get(config.gltf_compression, known)
    takes_steps = known.is_rounded and known.writes in ("steps", "levels")
    return not chosen and takes_steps and all(map(is_rounded, sources))


def is_rounded(source: str | Path) -> bool:
    """Whether a file's format rounds nearly all values."""
    with open_scene(source) as file:
        return file.scene_format.is_rounded


def measured(path: str | Path, scene: Scene, config: Config, finest: bool) -> RenderedLoss | None:
    """The loss in rendered views of a written file; warns if it is far above a profile's aim."""
    from gs_codec.encoding.loss import Check
    from gs_codec.encoding.retry import warn_of_loss
    from gs_codec.guidance.calibrate import wanted_error

    clean = turn_axes(matching.without_order(clean_scene(scene, config)[0]))
    loss = Check.by_plan(clean, None).measure(turn_axes(read_written(Path(path))))
    if loss is None or finest:
        return loss
    loss = replace(loss, aimed=psnr_loss(wanted_error(config)))
    warn_of_loss(loss, config, tried=False)
    return loss


def write_parts(path: str | Path, parts: Sequence[bytes | memoryview]) -> None:
    """Write an encoded scene; for `meta.json`, unpack its zip, with `meta.json` last.

    Raises InvalidInput if a file cannot be written.
    """
    if suffix_of(path) != UNBUNDLED:
        with atomic_writer(path) as file:
            file.writelines(parts)
        return
    with zipfile.ZipFile(io.BytesIO(b"".join(parts))) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    last = files.pop(UNBUNDLED)
    write_files(Path(path).parent, files | {UNBUNDLED: last})


def tell_lost(path: str | Path, lost: Sequence[str]) -> None:
    """Log what a format cannot represent."""
    for line in lost:
        log.warning("%s: %s", path, line)


def written_bytes(path: str | Path) -> int:
    """Total bytes of the files of a written scene."""
    if not Path(path).name.endswith((UNBUNDLED, STREAMED, TILESET)):
        return os.path.getsize(path)
    with open_scene(path) as file:
        return file.stored_bytes
