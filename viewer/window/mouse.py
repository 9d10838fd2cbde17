"""Mouse events on the panes: navigation, clicks, and drags with a tool."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Protocol

from open3d.visualization import gui

from viewer.scenes.choice import Choice
from viewer.scenes.pose import Pose
from viewer.window.navigation import DragKind, Navigator
from viewer.window.painter import Painter
from viewer.window.pane import Pane

#: Maximum movement of the mouse in a click, pixels.
_STILL = 3

#: Maximum time between the clicks of a double click, seconds.
_DOUBLE = 0.4

#: A position in a pane's picture, pixels.
Place = tuple[float, float]


class Tool(Protocol):
    """Handles drags with the left button while it is chosen. Positions are pixels of a picture."""

    def begin(self, pane: Pane, at: Place, event: gui.MouseEvent) -> bool:
        """Begin a drag; return whether to take it. `event` has the modifier keys."""

    def move(self, at: Place) -> None:
        """Continue the drag."""

    def end(self) -> None:
        """End the drag."""

    def hover(self, pane: Pane, at: Place) -> None:
        """Follow the mouse while no button is down."""
        return

    def finish(self) -> bool:
        """End what takes several clicks; return whether there was anything to end."""
        return False

    def drop(self) -> bool:
        """Drop what is unfinished; return whether there was anything."""
        return False


class Steered(Protocol):
    """The stage whose panes get mouse events; see `viewer.window.stage.Stage`."""

    pose: Pose | None
    choice: Choice
    navigator: Navigator
    painter: Painter

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height of the picture of each pane, pixels."""

    def place(self, pane: Pane, x: int, y: int) -> Place:
        """The pixel of a pane's picture at a pixel of the window."""

    def steer(self, pose: Pose) -> None:
        """Look from a pose that keeps moving."""


class Mouse:
    """Handles mouse events on panes.

    Open3D's own mouse control is not used, because its camera cannot be set from outside.

    Parameters
    ----------
    stage : Steered
    clicked, focused : callable
        Called with a pane and a `Place` after a click and a double click.

    Attributes
    ----------
    tool : Tool or None
    """

    def __init__(
        self,
        stage: Steered,
        clicked: Callable[[Pane, Place], None],
        focused: Callable[[Pane, Place], None],
    ) -> None:
        self._stage, self._clicked, self._focused = stage, clicked, focused
        self.tool: Tool | None = None
        self._drawing = False
        self._pressed: tuple[int, int] | None = None
        self._last = (0.0, 0, 0)

    def attach(self, pane: Pane) -> None:
        """Handle the mouse events of a pane."""
        pane.widget.set_on_mouse(partial(self._event, pane))

    def _event(self, pane: Pane, event: gui.MouseEvent) -> gui.Widget.EventCallbackResult:
        stage, kind = self._stage, gui.MouseEvent.Type
        pose = stage.pose
        if pose is not None:
            if event.type == kind.BUTTON_DOWN:
                self._press(pane, event, pose)
            elif event.type == kind.DRAG:
                self._drag(pane, event)
            elif event.type == kind.BUTTON_UP:
                self._release(pane, event)
            elif event.type == kind.MOVE and self.tool is not None:
                self.tool.hover(pane, stage.place(pane, event.x, event.y))
            elif event.type == kind.WHEEL:
                self._pressed = None
                stage.steer(stage.navigator.nearer(pose, event.wheel_dy))
        return gui.SceneWidget.EventCallbackResult.CONSUMED

    def _press(self, pane: Pane, event: gui.MouseEvent, pose: Pose) -> None:
        left = event.is_button_down(gui.MouseButton.LEFT)
        if self._drawing and not left:  # its release, after which Open3D sends no drags, ends this
            return
        self._pressed = (event.x, event.y) if left else None
        at = self._stage.place(pane, event.x, event.y)
        self._drawing = left and self.tool is not None and self.tool.begin(pane, at, event)
        if self._drawing:
            return
        kind: DragKind = "look" if self._stage.choice.flying else "turn"
        if not left or event.is_modifier_down(gui.KeyModifier.CTRL):
            kind = "shift"
        self._stage.navigator.hold(pose, event.x, event.y, kind)

    def _drag(self, pane: Pane, event: gui.MouseEvent) -> None:
        if self._pressed is not None:
            distances = abs(event.x - self._pressed[0]), abs(event.y - self._pressed[1])
            if max(distances) > _STILL:
                self._pressed = None
        if self.tool is not None and self._drawing:
            self.tool.move(self._stage.place(pane, event.x, event.y))
        elif self._pressed is None:
            moved = self._stage.navigator.drag(event.x, event.y, *self._stage.picture_size)
            if moved is not None:
                self._stage.steer(moved)

    def _release(self, pane: Pane, event: gui.MouseEvent) -> None:
        self._stage.navigator.release()
        self._stage.painter.rest()
        if self.tool is not None and self._drawing:
            self.tool.end()
        if self._pressed is None or self._drawing:
            self._drawing = False
            return
        self._pressed = None
        at, (before, x, y) = self._stage.place(pane, event.x, event.y), self._last
        now = time.monotonic()
        near = max(abs(event.x - x), abs(event.y - y)) <= _STILL
        if near and now - before < _DOUBLE:
            self._last = (0.0, 0, 0)
            self._focused(pane, at)
        else:
            self._last = (now, event.x, event.y)
            self._clicked(pane, at)
