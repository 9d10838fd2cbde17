"""The tool that moves, turns and scales the selection, or the whole scene, by handles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.pictures.centres import selected_centres
from viewer.scenes.gizmo import COLOURS, Gizmo, Handle
from viewer.scenes.pose import Pose, placed
from viewer.window.editor import Editor
from viewer.window.mouse import Place, Tool
from viewer.window.pane import Pane
from viewer.window.shared import Host

#: Maximum number of points that show a drag.
_MOST = 50_000


class PlaceTool(Tool):
    """Handles in the pane of the edited scene; drags elsewhere move the camera; see `Tool`."""

    def __init__(self, viewer: Host, editor: Editor) -> None:
        self._viewer, self._editor = viewer, editor
        self._handle: Handle | None = None
        self._matrix: NDArray[np.float64] | None = None
        self._known: tuple[object, NDArray[np.float64]] = None, np.zeros(3)
        for axis, colour in enumerate(COLOURS):
            name = f"place {axis}"
            viewer.stage.overlays[name] = lambda *seen, axis=axis: self._lines(axis, *seen)
            viewer.stage.overlay_colours[name] = colour

    @property
    def _centre(self) -> NDArray[np.float64]:
        """The middle of what is placed ``(3,)``."""
        edits = self._editor.edits
        if edits is not None and self._known[0] is not edits.now:
            self._known = edits.now, edits.middle
        return self._known[1]

    def _gizmo(self, pose: Pose, size: tuple[int, int]) -> Gizmo:
        centre = self._centre
        if self._matrix is not None and self._handle is not None:
            centre = placed(centre, self._matrix)
        return Gizmo(centre, pose, size)

    def _lines(self, axis: int, pose: Pose, width: int, height: int) -> list[NDArray]:
        if self._editor.tool != "place" or self._editor.edits is None:
            return []
        return [h.line for h in self._gizmo(pose, (width, height)).handles if h.axis == axis]

    def begin(self, pane: Pane, at: Place, event: gui.MouseEvent) -> bool:
        """Take the handle under the mouse; return whether there is one."""
        stage, edits = self._viewer.stage, self._editor.edits
        if stage.pose is None or edits is None or stage.panes[self._editor.number] is not pane:
            return False
        self._matrix = None
        self._held = self._gizmo(stage.pose, stage.picture_size)
        self._handle, self._start, self._pane = self._held.at(at), at, pane
        if self._handle is not None:
            chosen = edits.selected if edits.count else np.ones(edits.scene.count, bool)
            self._points = selected_centres(edits.scene, chosen, _MOST)
        return self._handle is not None

    def move(self, at: Place) -> None:
        """Show where centres would be."""
        if self._handle is not None:
            self._matrix = self._held.dragged(self._handle, self._start, at)
            centres = placed(self._points.positions, self._matrix)
            points = replace(self._points, positions=centres.astype(np.float32))
            self._pane.show_points("selected", points)
            self._viewer.stage.draw_overlays()

    def end(self) -> None:
        """Move what is placed."""
        matrix = self._matrix
        self._handle = self._matrix = None
        if matrix is not None:
            self._editor.do(lambda edits: edits.move(matrix))

    def drop(self) -> bool:
        """Drop the drag; return whether there was one."""
        dragged, self._matrix = self._matrix is not None, None
        self._handle = None
        return dragged
