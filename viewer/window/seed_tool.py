"""Tools that select around the Gaussian under the mouse: by a sphere, by colour, by flooding."""

from __future__ import annotations

from math import dist

from open3d.visualization import gui

from viewer.scenes.appearance import which_drawn
from viewer.scenes.picked import Hit, Picker
from viewer.scenes.region import circle
from viewer.scenes.selecting import around
from viewer.window.mouse import Place
from viewer.window.pane import Pane
from viewer.window.selecting_tool import Found, SelectingTool


class SeedTool(SelectingTool):
    """Selects around the Gaussian where the mouse goes down; a drag sets a sphere's radius."""

    def begin(self, pane: Pane, at: Place, event: gui.MouseEvent) -> bool:
        """Begin at a Gaussian."""
        self.hold(pane, event)
        self._start = self._at = at
        return True

    def move(self, at: Place) -> None:
        """Show the sphere."""
        if self._pane is not None and self.kind == "sphere":
            self._at = self.inside(self._pane, at)
            self.show(self._pane, [circle(self._start, dist(self._start, self._at))])

    def end(self) -> None:
        """Find the Gaussian, and select."""
        stage, pane, options = self._viewer.stage, self._pane, self._chooser.selecting
        self.drop()
        pose, size = stage.pose, stage.picture_size
        if pane not in stage.visible or pose is None or pose is not self._pose:
            return
        scene, look, layers = pane.scene, stage.shown.look(pane.scene), set(stage.choice.layers)
        kind, start, reach = self.kind, self._start, dist(self._start, self._at)
        which, picker = stage.panes.index(pane), Picker(stage.scenes, stage.pruned)

        def find() -> Found:
            drawn = which_drawn(scene, look)
            hit: Hit | None = picker.pick(which, pose, size, start, layers - {"pruned"}, look)
            if hit is None:
                return scene.opacities < 0, ()
            _, depth = pose.project(scene.positions[hit.row][None], *size)
            radius = reach / pose.lens(*size)[0] * float(depth[0])
            return around(scene, kind, hit.row, radius, options.tolerance, drawn)

        self.select(pane, find)
