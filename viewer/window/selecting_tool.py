"""What tools that select share: modifier keys, lines over a pane, work in the background."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.scenes.edits import Options
from viewer.scenes.pose import Pose
from viewer.scenes.selecting import Selecting
from viewer.scenes.worker import Stale, Worker
from viewer.window.mouse import Place, Tool
from viewer.window.pane import Pane
from viewer.window.shared import Host

#: A mask ``(N,)``.
Mask = NDArray[np.bool_]

#: A mask, and options of ``gs-codec convert`` that remove all other Gaussians, if there are any.
Found = tuple[Mask, Options]


class Chooser(Protocol):
    """The editor, for tools that select."""

    worker: Worker
    selecting: Selecting

    def choose(self, pane: Pane, chosen: Mask, how: str, kept: Options = ()) -> None:
        """Combine a mask ``(N,)`` with the selection in a pane's scene; `kept` as in `Found`."""

    def preview(self, pane: Pane, chosen: Mask, how: str) -> None:
        """Only show the selection that `choose` would make."""

    def mark(self) -> None:
        """Show the selections, not previews."""


class SelectingTool(Tool):
    """A tool of a viewer that selects; see `Tool`.

    Parameters
    ----------
    kind : str
        What it selects by.
    viewer : Host
    chooser : Chooser
    """

    def __init__(self, kind: str, viewer: Host, chooser: Chooser) -> None:
        self.kind, self._viewer, self._chooser = kind, viewer, chooser
        self._pane: Pane | None = None
        self._pose: Pose | None = None
        self._how = "replace"

    def hold(self, pane: Pane, event: gui.MouseEvent) -> None:
        """Begin in a pane; shift adds to the selection, ctrl removes, both intersect."""
        self.drop()
        self._pane, self._pose = pane, self._viewer.stage.pose
        added = event.is_modifier_down(gui.KeyModifier.SHIFT)
        removed = event.is_modifier_down(gui.KeyModifier.CTRL)
        names = {(1, 0): "add", (0, 1): "remove", (1, 1): "intersect"}
        self._how = names.get((added, removed), self._chooser.selecting.how)

    def drop(self) -> bool:
        """Drop what is unfinished; return whether there was anything."""
        pane, self._pane = self._pane, None
        if pane is not None:
            self.show(pane, [])
        return pane is not None

    def show(self, pane: Pane, lines: Sequence[NDArray]) -> None:
        """Show closed lines ``(n, 2)`` over a pane, pixels of its picture."""
        stage = self._viewer.stage
        if stage.pose is not None:
            pane.show_lines("tool", list(lines), stage.pose, *stage.picture_size)
            self._viewer.window.post_redraw()

    def inside(self, pane: Pane, at: Place) -> Place:
        """The nearest pixel in a pane."""
        frame, stage = pane.widget.frame, self._viewer.stage
        left, top = stage.place(pane, frame.x, frame.y)
        ends = (left, top), (left + frame.width - 1, top + frame.height - 1)
        x, y = np.clip(at, *ends).tolist()
        return x, y

    def select(self, pane: Pane, find: Callable[[], Found]) -> None:
        """Select what a function finds, in the background."""
        viewer, chooser, how, scene = self._viewer, self._chooser, self._how, pane.scene

        def done(found: Found) -> None:
            viewer.panel.say("")
            if pane.scene is scene and pane in viewer.stage.panes:
                chooser.choose(pane, found[0], how, found[1])

        def work(stale: Stale) -> Found:
            return find()

        viewer.panel.say("selecting ...", progress=0)
        chooser.worker.submit("select", work, done, viewer.fail)
