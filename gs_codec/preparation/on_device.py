"""Refinement steps on a CUDA device: gsplat differentiates a view, torch does the rest.

Attributes and their means stay on the device; they are copied to the CPU for checkpoints and at the
end.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from gs_codec.preparation.adam import BETA_1, BETA_2, EPSILON, LARGEST, AdamState
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.rendering.gsplat_backend import differentiate, to_device


class DeviceSteps:
    """Steps of Adam by views; ``values``, ``first`` and ``second`` are those of `AdamState`."""

    def __init__(self, views: ReferenceViews, antialiased: bool, state: AdamState) -> None:
        self.values, self.first, self.second = (to_device(plane) for plane in state)
        self.views, self.antialiased = views, antialiased
        self.images = [to_device(image) for image in views.images]

    def take(
        self, order: Sequence[int], step: int, sizes: Sequence[NDArray[np.float64]]
    ) -> list[float]:
        """Take a step for each view index in `order`, numbered from `step`; return errors."""
        pairs = zip(order, sizes, strict=True)
        found = [self._step(view, step + i, rates) for i, (view, rates) in enumerate(pairs)]
        return torch.stack(found).tolist()

    def _step(self, view: int, step: int, rates: NDArray[np.float64]) -> torch.Tensor:
        """One step of `adam_step` on the device."""
        camera, behind = self.views.cameras[view], self.views.background
        slopes, squared_error = differentiate(
            self.values, camera, self.images[view], behind, self.antialiased
        )
        slopes = torch.where(slopes.abs() < LARGEST, slopes, 0)
        self.first.lerp_(slopes, 1 - BETA_1)
        self.second.mul_(BETA_2).addcmul_(slopes, slopes, value=1 - BETA_2)
        scaled = to_device(rates / (1 - BETA_1**step))
        root = (self.second / (1 - BETA_2**step)).sqrt_().add_(EPSILON)
        after = self.values - scaled * self.first / root
        self.values = torch.where(after.isfinite(), after, self.values)
        return squared_error

    def state(self) -> AdamState:
        """The current state, copied to the CPU."""
        planes = self.values, self.first, self.second
        return AdamState(*(plane.cpu().numpy().copy() for plane in planes))
