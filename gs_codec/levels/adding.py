"""Add coarser levels to an encoded file. FORMAT.md, section "Levels"."""

from __future__ import annotations

import sys
from dataclasses import replace

from gs_codec.codecs.adaptive.encode import encode_level
from gs_codec.codecs.decode import decode_scene
from gs_codec.config import Config, options_of
from gs_codec.egs.egs_file import (
    Section,
    SectionId,
    file_parts,
    in_file_order,
    read_file,
    section_sizes,
)
from gs_codec.egs.header import Header
from gs_codec.egs.index import level_header
from gs_codec.guidance.calibrate import calibrated
from gs_codec.levels.building import Level, build_levels
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.threads import using_threads

#: Factor on the step sizes that a level would have as a separate scene.
COARSER = 2.0

Parts = list[bytes | memoryview]


def add_levels(
    parts: Parts, report: EncodeReport, config: Config, progress: Progress | None = None
) -> tuple[Parts, EncodeReport]:
    """Add coarser levels to a file, if the configuration enables them.

    Parameters
    ----------
    parts : list of bytes
        Consecutive pieces of an `.egs` file of profile ``l``, ``m`` or ``s``. Levels are made from
        the decoded scene, so that they suit any step sizes.
    report : EncodeReport
    config : Config
        The configuration of the file.
    progress : callable, optional

    Returns
    -------
    parts : list of bytes
    report : EncodeReport
        Includes the bytes and the seconds of the levels.
    """
    if not config.lod:
        return parts, report
    times = StageTimes()
    with times.stage("levels"), using_threads(config.threads, report.count):
        data = b"".join(parts)
        file = read_file(data)
        scene = decode_scene(data, max_bytes=sys.maxsize)
        scene = replace(scene, extra={}, has_normals=False)
        levels = build_levels(scene, file.header.block_size, progress)
        sections = [Section(SectionId(s), b, content) for (s, b), content in file.sections.items()]
        sections += _encoded(levels, file.header, config, progress)
        sections = in_file_order(sections)
        parts = file_parts(file.header, sections)
    seconds = report.seconds | times.seconds
    return parts, replace(
        report,
        section_bytes=section_sizes([(each.id, len(each.data)) for each in sections]),
        seconds=seconds,
    )


def _encoded(
    levels: list[Level], header: Header, config: Config, progress: Progress | None
) -> list[Section]:
    """The sections of levels."""
    if not levels:
        return []
    config = replace(config, block_size=Config.block_size)
    config = config_of_levels(calibrated(levels[0].scene, config, progress))
    sections = []
    for number, level in enumerate(levels, 1):
        own = level_header(header, number)
        pieces = encode_level(level.scene, config, own, level.errors, progress)
        sections.append(Section(SectionId.LEVEL, number, b"".join(pieces), optional=True))
    return sections


def config_of_levels(config: Config) -> Config:
    """The configuration of all levels, calibrated on the finest level as a separate scene."""
    most = options_of(Config)["coarseness"].high
    return replace(config, coarseness=min(COARSER * config.coarseness, most))
