"""Encode scenes to other formats with profiles, and decode them for trials."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.step_conversion import camera_free_steps, wanted_steps
from gs_codec.codecs.adaptive.step_sizes import StepSizes
from gs_codec.coding.clean import clean_scene
from gs_codec.coding.morton import spatial_order
from gs_codec.config import Config
from gs_codec.formats.attribute_steps import AttributeSteps, ShGrid
from gs_codec.formats.coordinates import CONVENTION, system_of, turn_axes
from gs_codec.formats.registry import read_written
from gs_codec.report import EncodeReport, StageTimes
from gs_codec.scene import Scene, gather, inverse_of


def pack_by_steps(
    scene: Scene, config: Config, steps: StepSizes | None, times: StageTimes
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene cleaned by `clean_scene`; camera-free if `steps` is None."""
    with times.stage("steps"):
        steps = steps or camera_free_steps(scene, config.adaptive_profile())
        wanted = wanted_steps(scene, steps)
    return _packed(scene, config, wanted, times)


def decoded_as_packed(scene: Scene, config: Config, steps: StepSizes) -> Scene:
    """A cleaned scene as decoded from a file with these step sizes, in its own order."""
    [data], _ = pack_by_steps(scene, config, steps, StageTimes())
    decoded = decode_interchange(data, config, system_of(scene))
    return decoded.take(inverse_of(_file_order(scene, config)))


def pack_finest(scene: Scene, config: Config) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene as finely as the format allows, whatever the profile."""
    clean, changed = clean_scene(scene, config)
    parts, report = _packed(clean, config, None, StageTimes())
    return parts, replace(report, **changed)


def decode_interchange(data: bytes | memoryview, config: Config, system: str = CONVENTION) -> Scene:
    """Decode bytes just encoded in the format of a configuration; to a coordinate system."""
    # The readers of PLY and of zip files need a file.
    with tempfile.TemporaryDirectory(prefix="gs_codec-") as folder:
        path = Path(folder, f"scene.{config.format}")
        path.write_bytes(data)
        return turn_axes(read_written(path), system)


def _packed(
    scene: Scene, config: Config, wanted: AttributeSteps | None, times: StageTimes
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Write a scene with the wanted step sizes, or as finely as the format allows."""
    known, suffix = config.scene_format, f".{config.format}"
    assert known.writer is not None  # .egs is encoded elsewhere
    arguments = {name: getattr(config, field) for field, name in known.options.items() if name}
    if known.writes == "steps":
        arguments["steps"] = wanted
    with times.stage("pack"):
        data, lost = known.writer(scene, **arguments, **known.written[suffix])
    if wanted is not None and known.writes == "steps":
        lost = (f"{lost[0]}, or to the steps of profile {config.profile}", *lost[1:])
    report = EncodeReport(
        scene.count,
        scene.float_bytes,
        {config.format: len(data)},
        costs=[],
        rectified=0,
        seconds=times.seconds,
        lost=lost,
        sh_degree=known.sh_degrees.get(suffix, scene.sh_degree),
    )
    return [data], report


@dataclass(frozen=True)
class RoundedScene:
    """A scene with everything but the colours quantised as in a format.

    Attributes
    ----------
    source : Scene
        The scene before rounding.
    config : Config
    wanted : AttributeSteps
        Step sizes of the source.
    order : ndarray, shape (N,)
        Index in the source of each Gaussian, in file order.
    rounded : Scene
        The rounded scene in file order, without SH-AC.
    """

    source: Scene
    config: Config
    wanted: AttributeSteps
    order: NDArray[np.int64]
    rounded: Scene

    @property
    def is_sparse(self) -> bool:
        """Whether SH-AC of 0 make the file smaller."""
        return self.config.scene_format.writes == "steps"

    def decoded(self) -> Scene:
        """The rounded scene with the source's SH, up to the degree that the format supports."""
        source = self.source.take(self.order)
        degree = self.config.scene_format.sh_degrees.get(f".{self.config.format}", source.sh_degree)
        f_rest = source.f_rest if degree else source.f_rest[:0]
        return replace(self.rounded, f_dc=source.f_dc, f_rest=f_rest)

    def sh_steps(self) -> NDArray[np.float32]:
        """Step sizes of each SH-AC band, ``(3, N)`` in the file's order."""
        return self.wanted.f_rest[:, self.order].astype(np.float32)

    def sh_grid(self) -> ShGrid | None:
        """Levels of SH-AC in file order; None if rounding to the nearest is as good."""
        grid = self.config.scene_format.sh_grid
        return None if grid is None else grid(len(self.order))

    def with_colours(self, coloured: Scene) -> RoundedScene:
        """Replace the SH by that of `coloured`, which is in file order."""
        places = inverse_of(self.order)
        f_dc, f_rest = gather(coloured.f_dc, places), gather(coloured.f_rest, places)
        return replace(self, source=replace(self.source, f_dc=f_dc, f_rest=f_rest))


def round_scene(scene: Scene, config: Config, steps: StepSizes, times: StageTimes) -> RoundedScene:
    """Quantise everything but the colours of a cleaned scene, with given step sizes."""
    wanted = wanted_steps(scene, steps)
    # SH-AC are not needed here, and would take most of the time.
    [data], _ = _packed(replace(scene, f_rest=scene.f_rest[:0]), config, wanted, times)
    rounded = decode_interchange(data, config, system_of(scene))
    return RoundedScene(scene, config, wanted, _file_order(scene, config), rounded)


def _file_order(scene: Scene, config: Config) -> NDArray[np.int64]:
    """Index in a scene of each Gaussian, in file order."""
    if (order := config.scene_format.order) is not None:
        return order(scene)
    if config.scene_format.sorts:
        return spatial_order(scene.positions, scene.log_scale)
    return np.arange(scene.count)


def pack_rounded(
    rounded: RoundedScene, times: StageTimes
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene from `round_scene`, with its current colours."""
    return _packed(rounded.source, rounded.config, rounded.wanted, times)
