"""Picking: a click into a pane finds a Gaussian, marks it and describes it."""

from __future__ import annotations

from viewer.scenes.picked import Hit, Picked, Picker
from viewer.scenes.pose import Pose
from viewer.scenes.worker import Stale
from viewer.window.mouse import Place
from viewer.window.pane import Pane
from viewer.window.shared import Host


class Picking:
    """The picked Gaussian.

    Parameters
    ----------
    viewer : Host

    Attributes
    ----------
    hit : Hit or None
    picked : Picked or None
        Information about it, once collected.
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self._picker = Picker(())
        self._pose: Pose | None = None
        self.hit: Hit | None = None
        self.picked: Picked | None = None
        viewer.modal.cancels.append(self.clear)

    def click(self, pane: Pane, at: Place) -> None:
        """Pick the Gaussian at a pixel of a pane's picture; clear the pick if there is none."""
        stage, picker = self._viewer.stage, self._current()
        which, pose, size = stage.panes.index(pane), stage.pose, stage.picture_size
        if pose is None:
            return
        layers, look = frozenset(self._viewer.choice.layers), stage.shown.look(pane.scene)

        def find(stale: Stale) -> Hit | None:
            return picker.pick(which, pose, size, at, layers, look)

        def done(hit: Hit | None) -> None:
            if picker is not self._current():
                return
            self.clear()
            if hit is not None:
                self.hit = hit
                stage.mark((picker.scenes[hit.which], hit.row))
                self._viewer.panel.show("Pick")
                self._describe()

        self._viewer.worker.submit("pick", find, done, self._viewer.fail)

    def clear(self) -> bool:
        """Clear the pick; return whether there was one."""
        before, self.hit, self.picked = self.hit, None, None
        if before is not None:
            self._viewer.worker.cancel("describe")
            self._viewer.stage.mark(None)
            self._viewer.panel.refresh()
        return before is not None

    def follow(self) -> None:
        """Update the Gaussian's contribution when the view comes to rest at another pose."""
        self._current()
        stage = self._viewer.stage
        if self.hit is not None and stage.resting and stage.pose is not self._pose:
            self._describe()

    def _current(self) -> Picker:
        """The picker of the scenes shown; drops picks of other scenes."""
        stage = self._viewer.stage
        of = self._picker.scenes, self._picker.pruned
        if of != (tuple(stage.scenes), stage.pruned):
            self._picker = Picker(stage.scenes, stage.pruned)
            self.hit = self.picked = None
        return self._picker

    def _describe(self) -> None:
        picker, hit, pose = self._picker, self.hit, self._viewer.stage.pose
        if hit is None or pose is None:
            return

        def find(stale: Stale) -> Picked:
            return picker.describe(hit, pose)

        def done(picked: Picked) -> None:
            if hit is self.hit:
                self.picked = picked
                self._viewer.panel.refresh()

        self._pose = pose
        self._viewer.worker.submit("describe", find, done, self._viewer.fail)
