"""Tools that select in a region drawn over a pane: box, lasso, polygon, brush."""

from __future__ import annotations

import numpy as np
from open3d.visualization import gui

from viewer.scenes.appearance import which_drawn
from viewer.scenes.region import Region, centres_in, in_region
from viewer.window.mouse import Place
from viewer.window.pane import Pane
from viewer.window.selecting_tool import SelectingTool


class RegionTool(SelectingTool):
    """Draws a region, and selects the Gaussians in it."""

    _region: Region | None = None

    def begin(self, pane: Pane, at: Place, event: gui.MouseEvent) -> bool:
        """Begin a region, or go on to the next corner of a polygon."""
        stage, region = self._viewer.stage, self._region
        if region is not None and (pane, stage.pose) == (self._pane, self._pose):
            if region.closes(at):
                self.finish()
            else:
                region.extend(at)
            return True
        self.hold(pane, event)
        self._region = Region(self.kind, at, self._chooser.selecting.radius)
        if self.kind == "brush" and stage.pose is not None:
            seen = stage.pose.project(pane.scene.positions, *stage.picture_size)
            self._projected = *seen, stage.pose.near
            self._painted = np.zeros(pane.scene.count, bool)
            self._paint(pane, self._region)
        return True

    def move(self, at: Place) -> None:
        """Extend the region, within the pane."""
        pane, region = self._pane, self._region
        if pane is None or region is None:
            return
        at = self.inside(pane, at)
        if self.kind != "polygon" and region.extend(at) and self.kind == "brush":
            self._paint(pane, region)
        self.show(pane, region.lines(at))

    def hover(self, pane: Pane, at: Place) -> None:
        """Show the brush, or the next side of the polygon."""
        if self.kind == "brush":
            if pane is not self._pane:
                self.drop()
            self._pane = pane
            self.show(pane, Region("brush", at, self._chooser.selecting.radius).lines(at))
        elif self._pose is not self._viewer.stage.pose:
            self.drop()
        elif pane is self._pane:
            self.move(at)

    def end(self) -> None:
        """Select in the region, unless more corners follow; a click alone selects nothing."""
        if self.kind != "polygon":
            self.finish()

    def finish(self) -> bool:
        """Select in the region."""
        stage, pane, region = self._viewer.stage, self._pane, self._region
        if region is None:
            return False
        self.drop()
        if pane not in stage.visible or stage.pose is None or stage.pose is not self._pose:
            self._chooser.mark()
            return True
        options, scene, pose = self._chooser.selecting, pane.scene, stage.pose
        look, size = stage.shown.look(scene), stage.picture_size
        if not (options.footprint or options.front):
            chosen = in_region(scene, pose, size, region, look)
            self._chooser.choose(pane, chosen, self._how)
            return True
        exact = options.footprint, options.front
        self.select(pane, lambda: (in_region(scene, pose, size, region, look, *exact), ()))
        return True

    def drop(self) -> bool:
        """Drop the region; return whether there was one."""
        begun, self._region = self._region is not None, None
        super().drop()
        return begun

    def _paint(self, pane: Pane, region: Region) -> None:
        """Show the resulting selection; only the last place of the brush's path is new."""
        drawn = which_drawn(pane.scene, self._viewer.stage.shown.look(pane.scene))
        found = centres_in(region, *self._projected, len(region.path) - 2)
        self._painted |= found if drawn is None else found & drawn
        self._chooser.preview(pane, self._painted, self._how)
