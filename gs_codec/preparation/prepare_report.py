"""Reports of preparation: as objects, as files, and as the paper's ablation table."""

from __future__ import annotations

import io
import json
from collections import Counter
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from crc32c import crc32c
from numpy.typing import NDArray

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.entropygs.section import channel_order
from gs_codec.config import PROFILES, Config
from gs_codec.metrics.image_quality import Quality
from gs_codec.pages.tables import Table
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.report import EncodeReport, RenderedLoss
from gs_codec.runtime.atomic import write_files
from gs_codec.scene import Scene

#: Reasons why an input Gaussian was removed; a label is an index into this tuple.
LABELS = ("kept", "geometry", "importance", "leave-one-out")

#: The reasons in the order of the steps.
_ORDER = ("importance", "geometry", "leave-one-out")


@dataclass(frozen=True)
class StepReport:
    """The scene after a step.

    Attributes
    ----------
    name : str
        Name of the step, or ``original`` for the input.
    count : int
        Number of Gaussians.
    size_bytes : float
        Size of the attributes: as float32, at the quantisation depths, or coded.
    quality : Quality
        Quality of held-out views, against photographs if given, else against renders of the input.
    seconds : float
        Time of the step, without the time to measure quality.
    details : dict
        Further results of the step.

    Examples
    --------
    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=30), "cameras.json", width=48)
    >>> pruned, report = gs_codec.prepare("scene.ply", plan)
    >>> [(step.name, step.count) for step in report.steps]
    [('original', 2000), ('leave-one-out pruning', 1400)]
    """

    name: str
    count: int
    size_bytes: float
    quality: Quality
    seconds: float
    details: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain types for JSON; `count` becomes ``gaussians``."""
        plain = dict(vars(self), quality=self.quality.as_dict())
        return {"name": plain.pop("name"), "gaussians": plain.pop("count"), **plain}


@dataclass(frozen=True)
class PrepareReport:
    """The steps in order, and a label for each input Gaussian.

    Attributes
    ----------
    labels : ndarray, shape (N,), uint8
        In the input's order: 0 kept, 1 pruned by geometry, 2 by importance, 3 by leave-one-out
        error.
    steps : tuple of StepReport
        The first is the input.
    views : ViewSplit
        The views that guided the steps and that measured quality.
    rendered : RenderedLoss, optional
        Loss in crops of other views, from preparation and coding together.
    sh_degree : int
        SH degree of the scene.
    centres : int
        `centres_checksum` of the input, which identifies the scene of the report.

    Examples
    --------
    >>> plan = gs_codec.Plan(gs_codec.Steps(prune=30), "cameras.json", width=48)
    >>> pruned, report = gs_codec.prepare("scene.ply", plan)
    >>> report.labels.shape, int((report.labels == 0).sum())
    ((2000,), 1400)
    """

    labels: NDArray[np.uint8]
    steps: tuple[StepReport, ...]
    views: ViewSplit
    rendered: RenderedLoss | None = None
    sh_degree: int = 0
    centres: int = 0

    @property
    def rejected(self) -> StepReport | None:
        """The optimisation, if its result was rejected."""
        return next((step for step in self.steps if "left_out" in step.details), None)

    @property
    def removed(self) -> dict[str, int]:
        """Number of Gaussians removed for each reason, in the order of the steps."""
        counts = np.bincount(self.labels, minlength=len(LABELS))
        return {label: int(counts[LABELS.index(label)]) for label in _ORDER}

    def as_dict(self) -> dict[str, Any]:
        """Convert everything but the labels to plain types, for JSON."""
        return {
            "input_gaussians": self.steps[0].count,
            "gaussians": self.steps[-1].count,
            "sh_degree": self.sh_degree,
            "centres_crc32c": self.centres,
            "removed": self.removed,
            "views": len(self.views.renders.cameras),
            "held_out": len(self.views.held_out.cameras),
            "photographs": self.views.held_out.photographs,
            "steps": [step.as_dict() for step in self.steps],
            "rendered": None if self.rendered is None else asdict(self.rendered),
        }

    def coded(
        self, scene: Scene, config: Config, data: bytes, report: EncodeReport
    ) -> PrepareReport:
        """Add the steps of coding to the report; see `coding_steps`."""
        coding = coding_steps(scene, config, data, report, self.views.held_out)
        return replace(self, steps=(*self.steps, *coding))


def centres_checksum(positions: NDArray[np.float32]) -> int:
    """CRC-32C of the centres ``(3, N)`` in their order, the same in every coordinate system.

    Systems differ in the signs and the order of coordinates, so sorted magnitudes are the same.
    """
    sizes = np.sort(np.abs(positions), axis=0)
    return int(crc32c(np.ascontiguousarray(sizes.T, "<f4").tobytes()))


def ablation_table(prepared: dict[str, Any]) -> Table:
    """A report's steps as a table like the paper's ablation."""
    rows = []
    for step in prepared["steps"]:
        quality = step["quality"]
        psnr = "inf" if quality["psnr"] is None else f"{quality['psnr']:.3f}"
        size, seconds = f"{step['size_bytes'] / 1e6:.3f}", f"{step['seconds']:.1f}"
        looks = [psnr, f"{quality['ssim']:.4f}"]
        rows.append([step["name"], f"{step['gaussians']:,}", size, *looks, seconds])
    return Table(["step", "Gaussians", "MB", "PSNR dB", "SSIM", "s"], rows)


def save_report(folder: str | Path, report: PrepareReport) -> None:
    """Write ``report.json``, ``ablation.md`` and ``labels.npy``.

    ``labels.npy`` has a uint8 for each input Gaussian, in the input's order: its index in `LABELS`,
    0 for kept ones. Raises InvalidInput if they cannot be written.
    """
    labels = io.BytesIO()
    np.save(labels, report.labels)
    plain = report.as_dict()
    files = {
        "report.json": json.dumps(plain, indent=1).encode() + b"\n",
        "ablation.md": f"{ablation_table(plain).markdown()}\n".encode(),
        "labels.npy": labels.getvalue(),
    }
    write_files(folder, files)


def coding_steps(
    scene: Scene,
    config: Config,
    data: bytes,
    report: EncodeReport,
    held_out: ReferenceViews,
    lpips: str | None = None,
) -> list[StepReport]:
    """Size and quality after quantisation, entropy coding, and coding of the geometry.

    The size after quantisation counts the bits of the depths. Entropy coding codes everything but
    positions and SH-DC; geometry coding codes these too, which gives the size of the file. Only
    quantisation loses quality. Profiles without depths have a single step. `data` and `report` come
    from encoding; with `lpips` weights, quality includes LPIPS.
    """
    quality = held_out.quality(decode_as(config, data), lpips=lpips)
    if config.profile not in PROFILES:
        name, took = f"coding ({config.profile})", sum(report.seconds.values())
        return [StepReport(name, report.count, report.file_bytes, quality, took)]
    # Bytes of each depth group's symbols, packed at its depth.
    rows = Counter(stream for _, _, stream in channel_order(len(scene.f_rest) // 3))
    depths = config.resolved_depths()
    quantised = {name: depths[name] * number * scene.count / 8 for name, number in rows.items()}
    points = ("geometry", "sh-dc", "gpcc", "tool")
    coded = report.file_bytes - sum(report.section_bytes.get(name, 0) for name in points)
    plain = quantised["geometry"] + quantised["sh-dc"]
    steps = (
        ("quantisation", sum(quantised.values()), report.seconds.get("quantise and model", 0.0)),
        ("entropy coding", coded + plain, report.seconds.get("code", 0.0)),
        ("geometry coding", report.file_bytes, 0.0),
    )
    return [StepReport(name, report.count, size, quality, took) for name, size, took in steps]
