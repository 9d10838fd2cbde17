"""What preparation did: how many Gaussians went and why, and what each step cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.metrics.images import Quality
from gs_codec.preparation.targets import Views

#: Why an input Gaussian was removed; its label is the index in this tuple.
LABELS = ("kept", "geometry", "importance", "leave-one-out")


@dataclass(frozen=True)
class StepReport:
    """The scene after a step.

    Attributes
    ----------
    name : str
        The step, ``original`` for the input.
    count : int
        Gaussians.
    size_bytes : float
        Size of their attributes: float32, or at the depths of quantisation, or coded.
    quality : Quality
        Of its held-out views, against photographs if given, else against renders of the input.
    seconds : float
        Time of the step, without the time to measure quality.
    details : dict
        Further results of the step.
    """

    name: str
    count: int
    size_bytes: float
    quality: Quality
    seconds: float
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PrepareReport:
    """The steps, in order, and a label for each input Gaussian.

    Attributes
    ----------
    labels : ndarray, shape (N,), uint8
        In the input's order: 0 kept, 1 pruned by geometry, 2 by importance, 3 by leave-one-out
        error.
    steps : tuple of StepReport
        The first is the input.
    views : Views
        The views that guided the steps and that measured quality.
    """

    labels: NDArray[np.uint8]
    steps: tuple[StepReport, ...]
    views: Views

    @property
    def removed(self) -> dict[str, int]:
        """How many Gaussians were removed for each reason."""
        counts = np.bincount(self.labels, minlength=len(LABELS))
        return {label: int(n) for label, n in zip(LABELS[1:], counts[1:], strict=True)}

    def as_dict(self) -> dict[str, Any]:
        """Everything but the labels as plain types, for JSON."""
        return {
            "gaussians": [self.steps[0].count, self.steps[-1].count],
            "removed": self.removed,
            "views": len(self.views.renders.cameras),
            "held_out": len(self.views.held_out.cameras),
            "photographs": self.views.held_out.photographs,
            "steps": [_plain_step(step) for step in self.steps],
        }

    def table(self) -> list[list[str]]:
        """Rows of the ablation table, in the form of the paper's; the first has the titles."""
        rows = [["step", "Gaussians", "MB", "PSNR dB", "SSIM", "s"]]
        for step in self.steps:
            numbers = (step.size_bytes / 1e6, step.quality.psnr, step.quality.ssim, step.seconds)
            cells = (f"{n:.{digits}f}" for n, digits in zip(numbers, (3, 3, 4, 1), strict=True))
            rows.append([step.name, f"{step.count:,}", *cells])
        return rows


def _plain_step(step: StepReport) -> dict[str, Any]:
    return dict(vars(step), quality=step.quality.as_dict())
