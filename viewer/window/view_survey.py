"""What is found out about all views, one after another, while the window rests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from viewer.pictures.drawer import quality, splats
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.window.worker import Stale

#: Height of the pictures of views, pixels.
_HIGH = 150


class Survey:
    """PSNR of B against A in every view, and small pictures of A.

    Views are done one by one, so that pictures of the window need not wait.

    Parameters
    ----------
    viewer : viewer.window.main_window.Viewer
    changed : callable
        Called when there is one more.

    Attributes
    ----------
    decibels : dict of int to float
        By index of the viewpoint.
    pictures : dict of int to ndarray, shape (h, w, 3), float32, 0-1
    """

    def __init__(self, viewer: Any, changed: Callable[[], None]) -> None:
        self._viewer, self._changed = viewer, changed
        self._of: tuple[Opened, ...] = ()
        self._poses: list[Pose] = []
        self._asked: set[str] = set()
        self.decibels: dict[int, float] = {}
        self.pictures: dict[int, NDArray] = {}

    def ask(self, what: str, wanted: bool) -> None:
        """Begin with ``decibels`` or ``pictures``, or leave off; what is found stays."""
        self._forget()
        (self._asked.add if wanted else self._asked.discard)(what)
        if not wanted:
            self._viewer.worker.cancel(f"survey {what}")
        elif f"survey {what}" not in self._viewer.worker.kinds:
            self._next(what)

    def _forget(self) -> None:
        """Forget what was found of other scenes, or from other viewpoints."""
        scenes = tuple(self._viewer.stage.scenes)
        poses = [each.pose for each in self._viewer.visits.viewpoints]
        if scenes != self._of or poses != self._poses:
            if scenes[:1] != self._of[:1] or poses != self._poses:
                self.pictures = {}
            self._of, self._poses, self.decibels = scenes, poses, {}
            for what in ("decibels", "pictures"):
                self._viewer.worker.cancel(f"survey {what}")

    def _next(self, what: str) -> None:
        """Do the next view, if one is left."""
        found: dict[int, Any] = getattr(self, what)
        scenes, poses = self._of, self._poses
        first = self._viewer.visits.views.first if what == "decibels" else 0
        left = [k for k in range(first, len(poses)) if k not in found]
        if not left or not scenes or (what == "decibels" and len(scenes) < 2):
            return
        number = left[0]
        views = self._viewer.stage.views

        def done(value: Any) -> None:
            found[number] = value
            self._changed()
            if what in self._asked:
                self._next(what)

        def job(stale: Stale) -> Any:
            if what == "pictures":
                wide, high = poses[number].frame
                return splats(views, scenes[0], poses[number], round(_HIGH * wide / high), _HIGH)
            measured = quality(views, scenes, poses[number])
            return float("nan") if measured is None else measured.psnr

        self._viewer.worker.submit(f"survey {what}", job, done, self._viewer.fail)
