"""What coding adds to the steps of preparation: the paper's ablation, to its end."""

from __future__ import annotations

from collections import Counter

from gs_codec.codec import decode_scene
from gs_codec.config import PROFILES, Config
from gs_codec.container.channels import channel_places
from gs_codec.preparation.report import StepReport
from gs_codec.preparation.targets import Targets
from gs_codec.report import EncodeReport
from gs_codec.scene import Scene


def coding_steps(
    scene: Scene, config: Config, data: bytes, report: EncodeReport, held_out: Targets
) -> list[StepReport]:
    """Size and quality after quantisation, entropy coding, and coding of the geometry.

    Quantised attributes take the bits of their depths. Entropy coding then codes all but positions
    and SH-DC; geometry coding codes these too, and gives the size of the file. Only quantisation
    loses quality. Profiles without depths have one step. `data` and `report` are from encoding.
    """
    quality = held_out.quality(decode_scene(data))
    if config.profile not in PROFILES:
        name, took = f"coding ({config.profile})", sum(report.seconds.values())
        return [StepReport(name, report.count, report.file_bytes, quality, took)]
    quantised = _quantised_bytes(scene, config)
    points = ("geometry", "sh-dc", "gpcc", "tool")
    coded = report.file_bytes - sum(report.section_bytes.get(name, 0) for name in points)
    plain = quantised["geometry"] + quantised["sh-dc"]
    sizes = {
        "quantisation": sum(quantised.values()),
        "entropy coding": coded + plain,
        "geometry coding": report.file_bytes,
    }
    seconds = _seconds(report)
    return [
        StepReport(name, report.count, size, quality, seconds[name]) for name, size in sizes.items()
    ]


def _quantised_bytes(scene: Scene, config: Config) -> dict[str, float]:
    """Bytes of each depth group's symbols, packed at its depth."""
    rows = Counter(stream for _, _, stream in channel_places(len(scene.f_rest) // 3))
    depths = config.resolved_depths()
    return {name: depths[name] * number * scene.count / 8 for name, number in rows.items()}


def _seconds(report: EncodeReport) -> dict[str, float]:
    times = report.seconds
    return {
        "quantisation": times.get("quantise and model", 0.0),
        "entropy coding": times.get("code", 0.0),
        "geometry coding": 0.0,
    }
