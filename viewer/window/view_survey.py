"""Results for all views, computed one by one while the window is idle."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from viewer.pictures.drawer import quality, splats
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.scenes.worker import Result, Stale
from viewer.window.shared import Host
from viewer.window.visits import Visits

#: Height of the pictures of views, pixels.
_HIGH = 150


class Survey:
    """PSNR of B against A in every view, and thumbnails of A.

    Views are processed one by one, so that pictures of the window need not wait.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    changed : callable
        Called after each result.

    Attributes
    ----------
    decibels : dict of int to float
        By index of the viewpoint.
    pictures : dict of int to ndarray, shape (h, w, 3), float32, 0-1
    """

    def __init__(self, viewer: Host, visits: Visits, changed: Callable[[], None]) -> None:
        self._viewer, self._visits, self._changed = viewer, visits, changed
        self._of: tuple[Opened, ...] = ()
        self._poses: list[Pose] = []
        self._wanted: set[str] = set()
        self._coming: set[str] = set()  # a running job may be of other scenes
        self.decibels: dict[int, float] = {}
        self.pictures: dict[int, NDArray] = {}

    def ask(self, what: str, wanted: bool) -> None:
        """Start computing ``decibels`` or ``pictures``, or stop; results are kept."""
        self._forget()
        (self._wanted.add if wanted else self._wanted.discard)(what)
        if not wanted:
            self._cancel(what)
        elif what not in self._coming:
            self._next(what)

    def _cancel(self, what: str) -> None:
        self._viewer.worker.cancel(f"survey {what}")
        self._coming.discard(what)

    def _forget(self) -> None:
        """Drop results of other scenes or viewpoints."""
        scenes = tuple(self._viewer.stage.scenes)
        poses = [each.pose for each in self._visits.viewpoints]
        if scenes != self._of or poses != self._poses:
            if scenes[:1] != self._of[:1] or poses != self._poses:
                self.pictures = {}
            self._of, self._poses, self.decibels = scenes, poses, {}
            for what in ("decibels", "pictures"):
                self._cancel(what)

    def _next(self, what: str) -> None:
        """Process the next view, if any."""
        scenes, poses = self._of, self._poses
        first = self._visits.views.first if what == "decibels" else 0
        left = [k for k in range(first, len(poses)) if k not in getattr(self, what)]
        if not left or not scenes or (what == "decibels" and len(scenes) < 2):
            return
        number, pose, views = left[0], poses[left[0]], self._viewer.stage.views

        def draw(stale: Stale) -> NDArray[np.float32]:
            wide, high = pose.frame
            return splats(views, scenes[0], pose, round(_HIGH * wide / high), _HIGH)

        def measure(stale: Stale) -> float:
            measured = quality(views, scenes, pose)
            return float("nan") if measured is None else measured.psnr

        if what == "pictures":
            self._find(what, draw, partial(self.pictures.__setitem__, number))
        else:
            self._find(what, measure, partial(self.decibels.__setitem__, number))

    def _find(
        self, what: str, job: Callable[[Stale], Result], put: Callable[[Result], None]
    ) -> None:
        """Compute a result for a view, then continue with the next."""

        def done(value: Result) -> None:
            self._coming.discard(what)
            put(value)
            self._changed()
            if what in self._wanted:
                self._next(what)

        self._coming.add(what)
        self._viewer.worker.submit(f"survey {what}", job, done, self._viewer.fail)
